"""Writing files so that they are whole or absent, and checks of where they go."""

from __future__ import annotations

import errno
import os
import shutil
import tempfile
import uuid
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

from .errors import BadInput

# A write that fails while less than this is free, in bytes, failed because the disk is full. A tile is smaller.
MIN_FREE_BYTES = 1 << 25


@contextmanager
def atomic_write(path: Path, *, exclusive: bool = False) -> Iterator[Path]:
    """Write a file that appears at `path` whole or not at all, also after a power cut.

    The body of the `with` statement creates and closes the file under the temporary name it is given. When
    the body ends, the file is flushed to the disk and moved into place; after an error it is removed.

    Parameters
    ----------
    path : Path
        Where the file goes; an existing file is replaced.
    exclusive : bool
        Keep an existing file and raise FileExistsError instead.

    Yields
    ------
    Path
        Hidden, unique name in the folder of `path`. Nothing exists there yet, so that the file gets the
        permissions of any new file.

    Raises
    ------
    FileExistsError
        If `exclusive` is true and `path` exists.
    OSError
        If the file cannot be flushed or moved.
    """
    temporary = path.with_name(f".{path.name}.{uuid.uuid4().hex}.tmp")
    try:
        yield temporary
        _sync(temporary)
        if exclusive:
            os.link(temporary, path)
        else:
            os.replace(temporary, path)
        _sync(path.parent)  # the new name too must reach the disk
    finally:
        temporary.unlink(missing_ok=True)


def _sync(path: Path) -> None:
    """Flush a file, or the names in a folder, to the disk."""
    handle = os.open(path, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)


def disk_error(error: Exception, path: Path) -> OSError:
    """Convert an error of netCDF4, which reports a full disk as an HDF or permission error, to an OSError."""
    if shutil.disk_usage(path.parent).free < MIN_FREE_BYTES:
        return OSError(errno.ENOSPC, f"{os.strerror(errno.ENOSPC)} ({error})", str(path))
    return error if isinstance(error, OSError) else OSError(errno.EIO, str(error), str(path))


def check_folder(path: Path) -> None:
    """Raise BadInput unless a file can be created in the folder of `path` and `path` is not a folder."""
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


def read_text(path: Path) -> str:
    """Text of a file in UTF-8; BadInput if it cannot be read."""
    try:
        return path.read_text(encoding="utf-8-sig")
    except FileNotFoundError:
        raise BadInput(f"{path}: there is no such file") from None
    except IsADirectoryError:
        raise BadInput(f"{path}: this is a folder") from None
    except UnicodeDecodeError:
        raise BadInput(f"{path}: not a text file in UTF-8") from None
    except OSError as error:
        raise BadInput(f"{path}: cannot be read: {error.strerror}") from None


def writable(name: str | Path, suffixes: Sequence[str], *, force: bool) -> Path:
    """Check the path of a file before anything is computed.

    Parameters
    ----------
    name : str or Path
        The file, in a folder that can be written.
    suffixes : sequence of str
        Allowed ends of the name, in lower case.
    force : bool
        Allow a file that exists.

    Returns
    -------
    Path

    Raises
    ------
    BadInput
        For another suffix, a place that cannot be written, and a file that exists.
    """
    path = Path(name)
    if path.suffix.lower() not in suffixes:
        allowed = " or ".join(filter(None, (", ".join(suffixes[:-1]), suffixes[-1])))
        raise BadInput(f"{path}: the name must end in {allowed}")
    check_folder(path)
    if path.exists() and not force:
        raise BadInput(f"{path}: this file exists; --force (force=True) replaces it")
    return path


def one_line(error: Exception) -> str:
    """Message of an error in one line of at most 200 characters."""
    return " ".join(str(error).split())[:200]
