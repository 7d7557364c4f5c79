"""Run tests in a copy of the checkout without extensions: python scripts/tools/without_extension.py plane [tests/scene ...]

Arguments after the names of the extensions go to pytest. This checkout is not changed.
"""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import tempfile
from importlib.metadata import distribution
from pathlib import Path

ROOT = Path(__file__).parents[2]
EXTENSIONS = {each.parent.name for each in (ROOT / "atlas" / "extensions").glob("*/__init__.py")}


def files() -> list[str]:
    """Files of the checkout that Git does not ignore, relative to it."""
    command = ["git", "ls-files", "--cached", "--others", "--exclude-standard"]
    listed = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=True).stdout.splitlines()
    return [name for name in listed if (ROOT / name).is_file()]


def copy_without(names: set[str], folder: Path) -> None:
    """Copy the checkout and its installed metadata into a folder, without these extensions, their tests and entry points."""
    left_out = tuple(f"{room}/extensions/{name}/" for room in ("atlas", "tests") for name in names)
    for name in files():
        if not name.startswith(left_out):
            (folder / name).parent.mkdir(parents=True, exist_ok=True)
            shutil.copy2(ROOT / name, folder / name)
    # Python uses the metadata that comes first on its path, so that the copy needs no environment of its own.
    installed = distribution("precession-atlas")
    metadata = folder / f"precession_atlas-{installed.version}.dist-info"
    metadata.mkdir()
    for name in ("METADATA", "entry_points.txt"):
        lines = (installed.read_text(name) or "").splitlines(keepends=True)
        (metadata / name).write_text(
            "".join(
                line for line in lines if not line.startswith(tuple(f"{name} = atlas." for name in names))
            )
        )


def main() -> int:
    """Exit status of pytest in the copy."""
    arguments, names = sys.argv[1:], set()
    while arguments and arguments[0] in EXTENSIONS:
        names.add(arguments.pop(0))
    if not names:
        print(f"name at least one extension: {', '.join(sorted(EXTENSIONS))}", file=sys.stderr)
        return 2
    with tempfile.TemporaryDirectory(prefix="without_") as folder:
        copy_without(names, Path(folder))
        tests = arguments or ["tests", "--ignore=tests/extensions"]
        return subprocess.run(
            [sys.executable, "-m", "pytest", *tests],
            cwd=folder,
            env={**os.environ, "PYTHONPATH": folder},
            check=False,
        ).returncode


if __name__ == "__main__":
    sys.exit(main())
