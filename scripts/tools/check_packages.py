"""Check the contents of the wheel and the source distribution in a folder: python scripts/tools/check_packages.py dist"""

from __future__ import annotations

import sys
import tarfile
import tomllib
import zipfile
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
# Files that the source distribution must have besides the modules of the package.
SOURCES = (
    "pyproject.toml", "README.md", "LICENSE", "CHANGELOG.md", "CITATION.cff", "CODE_OF_CONDUCT.md", "CONTRIBUTING.md", "SECURITY.md",
    "configs/quickstart.toml", "scripts/quickstart.sh", "scripts/test.sh", "tests/conftest.py", "tests/small.toml",
)  # fmt: skip
MAX_SOURCE = 2_000_000  # bytes of the source distribution


def modules() -> set[str]:
    """Files of the package in the repository."""
    files = {path.relative_to(ROOT).as_posix() for path in (ROOT / "atlas").rglob("*.py")}
    page = {
        path.relative_to(ROOT).as_posix()
        for path in (ROOT / "atlas/extensions/page").iterdir()
        if path.is_file()
    }
    return files | page | {"atlas/py.typed"}


def missing(folder: Path) -> list[str]:
    """Files that are missing in the wheel or the source distribution of a folder, and files that the wheel must not have."""
    (wheel,), (source,) = folder.glob("*.whl"), folder.glob("*.tar.gz")
    in_wheel = set(zipfile.ZipFile(wheel).namelist())
    with tarfile.open(source) as archive:
        in_source = {name.partition("/")[2] for name in archive.getnames()}
    problems = [f"{wheel.name}: {name} is missing" for name in sorted(modules() - in_wheel)]
    problems += [
        f"{wheel.name}: {name} does not belong there"
        for name in sorted(in_wheel)
        if not name.startswith(("atlas/", "precession_atlas-"))
    ]
    problems += [f"{source.name}: {name} is missing" for name in sorted({*modules(), *SOURCES} - in_source)]
    if (size := source.stat().st_size) > MAX_SOURCE:
        problems.append(f"{source.name}: {size} bytes; at most {MAX_SOURCE}: leave out pictures")
    (points,) = [name for name in in_wheel if name.endswith("entry_points.txt")]
    text = zipfile.ZipFile(wheel).read(points).decode()
    scripts = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["scripts"]
    problems += [
        f"{wheel.name}: {line!r} is no entry point"
        for line in [*(f"{name} = {value}" for name, value in scripts.items()), "[xarray.backends]"]
        if line not in text
    ]
    return problems


def main() -> int:
    problems = missing(Path(sys.argv[1]))
    print("\n".join(problems) or "wheel and source distribution are complete")
    return int(bool(problems))


if __name__ == "__main__":
    sys.exit(main())
