"""Checks of HDF5 files of unknown origin, made with h5py before the NetCDF library opens a file.

The NetCDF library would follow every reference, even to another file or to a group that contains itself.
"""

from __future__ import annotations

import fcntl
import math
import mmap
import os
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from functools import lru_cache
from pathlib import Path
from typing import Any

from .errors import BadInput, one_line

MAX_NAMES = 2000  # largest number of variables and groups of a file
MAX_CHUNK_BYTES = 1 << 26  # a chunk that is larger than its array may have this many bytes
SIGNATURES = b"\x89HDF\r\n\x1a\n", b"CDF"  # first bytes of NetCDF 4 and of classic NetCDF
# Names of the attribute that marks an atlas, and of the group that marks an atlas from a version before 0.1.0.
OWN = b"atlas_version", b"checksums"


def locked_text(path: Path | str) -> str:
    """Return a text which says that another program writes or has locked the file. If none does, the text is empty."""
    with suppress(OSError), open(path, "rb") as file:
        try:
            fcntl.flock(file, fcntl.LOCK_SH | fcntl.LOCK_NB)
        except BlockingIOError:
            return "another program writes it, or has locked it (HDF5_USE_FILE_LOCKING=FALSE reads it all the same)"
    return ""


def check_path(path: Path | str) -> None:
    """Raise BadInput for a path that the NetCDF library cannot open or would take for another path."""
    whole = os.path.abspath(path)
    if "\\" in whole or any("\ud800" <= character <= "\udfff" for character in whole):
        raise BadInput(
            f"{path}: the NetCDF library opens no path with a backslash or with bytes that are not UTF-8 ({whole})"
        )


def unreadable(
    path: Path | str, error: Exception, what: str = "not a NetCDF file that can be read"
) -> BadInput:
    """Return BadInput for a file that could not be read. The message says that the file is locked, or else `what`."""
    if isinstance(error, BadInput):
        return error
    return BadInput(f"{path}: {locked_text(path) or f'{what} ({one_line(error)})'}")


@contextmanager
def _opened(path: Path | str) -> Iterator[Any]:
    """Open an HDF5 file for reading, and ignore locks."""
    from h5py import h5f, h5p

    access = h5p.create(h5p.FILE_ACCESS)
    access.set_file_locking(False, True)
    file = h5f.open(str(path).encode(), h5f.ACC_RDONLY, access)
    try:
        yield file
    finally:
        file.close()


def check_contained(path: Path | str) -> None:
    """Raise ValueError if a file has numbers in other files, or cannot be read in bounded time and memory.

    Raise BadInput if the NetCDF library cannot open the path.
    """
    check_path(path)
    with open(path, "rb") as file:
        status = os.fstat(file.fileno())
        if file.read(3) != b"CDF":  # a classic NetCDF file refers to no other file
            _check_objects(str(path), status.st_dev, status.st_ino, status.st_size, status.st_ctime_ns)


@lru_cache(maxsize=256)
def _check_objects(path: str, *_: int) -> None:
    """Check an HDF5 file for `check_contained`. The other arguments identify the file, so that it is checked once."""
    from h5py import h5d, h5g, h5l, h5o, h5t

    with _opened(path) as file:
        groups, known, count = [h5g.open(file, b"/")], set[int](), 0
        while groups:
            group = groups.pop()
            if (address := h5o.get_info(group).addr) in known:
                raise ValueError("a group of it has two names, or contains itself")
            known.add(address)
            for name in group:
                text = name.decode("utf-8", "replace")
                count += 1
                if count > MAX_NAMES:
                    raise ValueError(f"it has more than {MAX_NAMES} variables and groups")
                kind = group.links.get_info(name).type
                if kind == h5l.TYPE_SOFT:  # a soft link points into the same file
                    continue
                if kind != h5l.TYPE_HARD:
                    raise ValueError(f"{text} is a link to another file")
                item = h5o.open(group, name)
                if isinstance(item, h5g.GroupID):
                    groups.append(item)
                if not isinstance(item, h5d.DatasetID):
                    continue
                plan, kept = item.get_create_plist(), item.get_type()
                if plan.get_external_count() or plan.get_layout() == h5d.VIRTUAL:
                    raise ValueError(f"the values of {text} are in other files")
                if isinstance(kept, h5t.TypeFloatID) and kept.get_size() < 4:
                    raise ValueError(f"{text} has floats of 2 bytes, which the NetCDF library cannot read")
                if plan.get_layout() == h5d.CHUNKED:
                    chunk, size = (math.prod(s) * kept.get_size() for s in (plan.get_chunk(), item.shape))
                    if chunk > max(MAX_CHUNK_BYTES, size):
                        raise ValueError(f"the chunks of {text} are larger than the array")


def is_own(path: Path) -> bool:
    """Whether a file has the attribute OWN[0] or the group OWN[1]. A file that cannot be opened is searched for the bytes of OWN[0]."""
    from h5py import h5a, h5g

    try:
        with _opened(path) as file:
            root = h5g.open(file, b"/")
            return bool(h5a.exists(root, OWN[0]) or OWN[1] in root)
    except Exception:  # the file is a classic NetCDF file, or damaged
        with suppress(ValueError), path.open("rb") as content:  # an empty file raises ValueError
            return mmap.mmap(content.fileno(), 0, access=mmap.ACCESS_READ).find(OWN[0]) >= 0
        return False
