"""The source files that the numbers of an atlas depend on, at the import of the package."""

from __future__ import annotations

import hashlib
from pathlib import Path

PACKAGE = Path(__file__).parent
# All modules from the scene to the tile, which decide on its points, variables and numbers; not the readers of finished tiles.
NUMERIC_SOURCES = (
    "flags.py", "variables.py", "kernel/**/*.py", "systems/**/*.py", "measure/**/*.py", "scene/**/*.py", "label/**/*.py",
    "store/dataset.py", "store/tile.py", "store/tiling.py", "runs/execution.py", "runs/reuse.py", "runs/levels.py", "runs/refine.py",
    "runs/plan.py", "extensions/**/*.py",
    "validation/half_step.py",
)  # fmt: skip


def read() -> dict[str, tuple[int, str]]:
    """Time of the last change, in ns, and hash of each of these files, by its name in the package."""
    files = {}
    for path in sorted(path for pattern in NUMERIC_SOURCES for path in PACKAGE.glob(pattern)):
        content = hashlib.sha256(path.read_bytes()).hexdigest()
        files[path.relative_to(PACKAGE).as_posix()] = path.stat().st_mtime_ns, content
    return files


# The package imports this module before all others, which are at least as new.
AT_IMPORT = read()


def changed() -> list[str]:
    """Names of the files written since the import: modules loaded before and after may not fit together."""
    now = read()
    return sorted(name for name in AT_IMPORT.keys() | now if AT_IMPORT.get(name) != now.get(name))


def code() -> str:
    """Hash of these files as they were at the import."""
    text = "\n".join(f"{name} {content}" for name, (_, content) in AT_IMPORT.items())
    return hashlib.sha256(text.encode()).hexdigest()[:16]
