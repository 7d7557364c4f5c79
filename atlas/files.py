"""Files written whole: temporary name, sync, move."""

from __future__ import annotations

import errno
import os
import shutil
import tempfile
import uuid
from pathlib import Path

from .errors import BadInput

# Where writing fails with less than this free, in bytes, the disk is full: larger than a tile in memory.
MIN_FREE_BYTES = 1 << 25


def temporary_path(path: Path) -> Path:
    return path.with_name(f".{path.name}.{uuid.uuid4().hex}.tmp")


def write_text(path: Path, content: str, *, once: bool = False) -> None:
    """Write a whole file in one move.

    once: raise FileExistsError, leaving what is there, if the file exists.
    """
    temporary = temporary_path(path)
    try:
        temporary.write_text(content, encoding="utf-8")
        move_into_place(temporary, path, once=once)
    finally:
        temporary.unlink(missing_ok=True)


def move_into_place(temporary: Path, path: Path, *, once: bool = False) -> None:
    """Bring a file to the disk, move it into place, and make the move outlive a power cut."""
    sync(temporary)
    if once:
        os.link(temporary, path)
    else:
        os.replace(temporary, path)
    sync(path.parent)


def sync(path: Path) -> None:
    handle = os.open(path, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)


def disk_error(error: Exception, path: Path) -> OSError:
    """What netCDF4 hides behind an HDF error or a permission when the system cannot write."""
    if shutil.disk_usage(path.parent).free < MIN_FREE_BYTES:
        return OSError(errno.ENOSPC, f"{os.strerror(errno.ENOSPC)} ({error})", str(path))
    return error if isinstance(error, OSError) else OSError(errno.EIO, str(error), str(path))


def check_folder(path: Path) -> None:
    """Raise BadInput unless a file can be made beside where `path` will be, and no folder is in its place."""
    folder = path.parent
    if not folder.is_dir():
        raise BadInput(f"{path}: there is no folder {folder}")
    try:
        with tempfile.TemporaryFile(dir=folder):
            pass
    except OSError as error:
        raise BadInput(f"{path}: cannot be written: {error.strerror}") from None
    if path.is_dir():
        raise BadInput(f"{path}: this is a folder")


def umask() -> int:
    mask = os.umask(0)
    os.umask(mask)
    return mask


def one_line(error: Exception) -> str:
    return " ".join(str(error).split())[:200]
