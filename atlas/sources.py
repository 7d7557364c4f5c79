"""A record of the source files on which the numbers of an atlas depend, made when this process imported the package."""

from __future__ import annotations

import hashlib
from collections.abc import Iterable
from pathlib import Path

PACKAGE = Path(__file__).parent
# Modules that compute tiles from a scene and thereby determine numbers. Modules that only read finished tiles are left out.
NUMERIC_SOURCES = (
    "flags.py", "variables.py", "kernel/**/*.py", "systems/**/*.py", "measure/**/*.py", "scene/**/*.py", "theory/**/*.py", "label/**/*.py",
    "store/dataset.py", "store/tile.py", "store/tiling.py", "runs/memory.py", "runs/folder.py", "runs/reuse.py", "runs/levels.py", "runs/refine.py",
    "runs/plan.py",
)  # fmt: skip
EVERY_MODULE = ("**/*.py",)

# The time of the last change, in ns, and the hash of each file in a folder, by the name of the file.
Files = dict[str, tuple[int, str]]


def read(folder: Path | None = None) -> Files:
    """Read the modules of a folder, by default the modules on which the numbers of an atlas depend."""
    files, root = {}, PACKAGE if folder is None else folder
    patterns = NUMERIC_SOURCES if folder is None else EVERY_MODULE
    for path in sorted(path for pattern in patterns for path in root.glob(pattern)):
        content = hashlib.sha256(path.read_bytes()).hexdigest()
        files[path.relative_to(root).as_posix()] = path.stat().st_mtime_ns, content
    return files


# The package imports this module before all others, so that no loaded module is older than this record.
AT_IMPORT = read()
# Files of each folder that `of_folder` was called with, as they were at the first call.
OF_FOLDERS: dict[Path, Files] = {}


def of_folder(folder: Path) -> Files:
    """Return the files of a folder, as they were at the first call."""
    if folder not in OF_FOLDERS:
        OF_FOLDERS[folder] = read(folder)
    return OF_FOLDERS[folder]


def changed(folders: Iterable[Path] = ()) -> list[Path]:
    """Return the files of this package and of `folders` that changed since the first reading. Loaded modules may lack the changes."""
    states = [(PACKAGE, AT_IMPORT, read()), *((each, of_folder(each), read(each)) for each in folders)]
    return sorted(
        folder / name
        for folder, before, now in states
        for name in before.keys() | now
        if before.get(name) != now.get(name)
    )


def code(files: Files | None = None) -> str:
    """Return the hash of files, by default of the files of this package as they were at the import."""
    files = AT_IMPORT if files is None else files
    text = "\n".join(f"{name} {content}" for name, (_, content) in files.items())
    return hashlib.sha256(text.encode()).hexdigest()[:16]
