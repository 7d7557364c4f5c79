"""Run the tests of the core in a copy of the checkout that lacks the folders of some extensions.

python scripts/tools/without_extension.py NAME [NAME ...] [--only TESTS ...] [OPTIONS OF PYTEST]

The entry points stay, as where a folder was deleted from an installed package: what an extension gave is refused by name.
Without --only all tests outside tests/extensions run.
"""

from __future__ import annotations

import argparse
import os
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

ROOT = Path(__file__).parents[2]


def copy_without(names: list[str], target: Path) -> None:
    """A copy of the checkout without the folders of these extensions and their tests."""
    ignored = shutil.ignore_patterns("__pycache__", ".*cache", ".venv", ".git", "out", ".hypothesis")
    shutil.copytree(ROOT, target, ignore=ignored, dirs_exist_ok=True)
    for name in names:
        for folder in ("atlas/extensions", "tests/extensions"):
            shutil.rmtree(target / folder / name)


def main() -> int:
    """Exit status of pytest."""
    extensions = sorted(path.parent.name for path in (ROOT / "atlas" / "extensions").glob("*/__init__.py"))
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("names", nargs="+", metavar="NAME", choices=extensions, help=", ".join(extensions))
    parser.add_argument("--only", nargs="+", metavar="TESTS", help="files or folders of tests")
    options, others = parser.parse_known_args()
    with tempfile.TemporaryDirectory() as name:
        copy_without(options.names, target := Path(name) / "checkout")
        tests = options.only or ["tests", "--ignore", "tests/extensions"]
        # The installed package is found by its path; the copy comes first.
        environment = os.environ | {"PYTHONPATH": str(target)}
        return subprocess.run(
            [sys.executable, "-m", "pytest", "-q", *tests, *others], cwd=target, env=environment
        ).returncode


if __name__ == "__main__":
    sys.exit(main())
