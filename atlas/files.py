"""Functions that write files whole or not at all, and that check paths.

A file is written under a temporary name in the same folder and then renamed. The temporary name identifies the process that writes, so
that `remove_leftovers` can recognise files of dead processes.
"""

from __future__ import annotations

import errno
import hashlib
import json
import logging
import os
import re
import secrets
import shutil
import stat
import tempfile
from collections.abc import Collection, Iterable, Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

from .errors import BadInput, one_line, option
from .process import PROCESS_NAME, is_running, process_name

FIGURES = (".png", ".pdf", ".svg")  # suffixes of figures
# If a write fails while fewer bytes than this are free, the disk counts as full. Every tile has fewer bytes than this.
MIN_FREE_BYTES = 1 << 25
# A file of unknown origin may contain at most MAX_JSON_BYTES of JSON. If it claims more than MIN_CLAIM bytes of numbers, the
# compression ratio may be at most MAX_RATIO. Sound files reach a ratio of 3000.
MAX_JSON_BYTES = 100_000_000
MAX_RATIO, MIN_CLAIM = 4_000, 1_000_000_000
TEMPORARY = re.compile(rf"\.atlas-({PROCESS_NAME.pattern})-[0-9a-f]{{8}}\.tmp")
# A temporary file of another machine counts as left over this many seconds after the last write.
FOREIGN_LEFTOVER_AGE = 7 * 86400.0
CLOCK_ERROR = 60.0  # seconds by which the clocks of two machines may differ


def exists_message(path: Path | str) -> str:
    return f"{path}: this file exists; {option('force', True)} replaces it"


def damaged_message(path: object, error: Exception) -> str:
    """Return the message that a part of a run is damaged. The next run of the scene replaces the part."""
    return f"{path}: damaged: {one_line(error)}; run the scene again, which writes it anew"


def foreign_message(path: Path | str) -> str:
    """Return the message that this package did not write what is at `path`."""
    return f"{path}: holds something else than an atlas, or is damaged; it is not replaced: remove it or choose another name"


@contextmanager
def atomic_write(path: Path, *, durable: bool = True, new: bool = False) -> Iterator[Path]:
    """Yield the path of an empty file that replaces `path` at the end, either whole or not at all.

    If `durable`, this holds even after a power cut. If `new`, `path` must not exist.
    """
    temporary = temporary_path(path)
    # O_EXCL and O_NOFOLLOW prevent writing through a link that another user has made.
    os.close(os.open(temporary, os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_NOFOLLOW, 0o666))
    try:
        yield temporary
        if durable:
            _sync(temporary)
        (os.link if new else os.replace)(temporary, path)
        if durable:
            _sync(path.parent)  # the new name must survive a power cut
    finally:
        temporary.unlink(missing_ok=True)


@contextmanager
def atomic_folder(path: Path) -> Iterator[Path]:
    """Yield a temporary folder that replaces `path` at the end. A kill between the two renames leaves no folder at `path`."""
    remove_leftovers(path.parent)
    temporary, old = temporary_path(path), temporary_path(path)
    temporary.mkdir()
    try:
        yield temporary
        for file in temporary.rglob("*"):
            _sync(file)
        _sync(temporary)
        with suppress(FileNotFoundError):
            os.rename(path, old)
        os.rename(temporary, path)
        _sync(path.parent)
    finally:
        if old.exists() and not path.exists():
            os.rename(old, path)
        for folder in (temporary, old):
            shutil.rmtree(folder, ignore_errors=True)


def age(path: Path) -> float:
    """Return the seconds since a file was written, by the clock of the file system."""
    with tempfile.TemporaryFile(dir=path.parent) as new:
        return os.fstat(new.fileno()).st_mtime - path.stat().st_mtime


def is_recent(age: float, most: float) -> bool:
    """Whether `age` is at most `most` seconds and not negative. A clock error of up to CLOCK_ERROR is allowed."""
    return -CLOCK_ERROR <= age <= most


def remove_leftovers(folder: Path) -> None:
    """Remove temporary files of dead processes from a folder. Files of other machines stay for FOREIGN_LEFTOVER_AGE seconds."""
    with suppress(OSError), os.scandir(folder) as entries:
        for entry in entries:
            if not (match := TEMPORARY.fullmatch(entry.name)):
                continue
            with suppress(OSError):
                running = is_running(match[1])
                if running is None:  # the process is on another machine
                    running = age(Path(entry)) <= FOREIGN_LEFTOVER_AGE
                if not running and entry.is_dir(follow_symlinks=False):
                    shutil.rmtree(entry, ignore_errors=True)
                elif not running:
                    os.unlink(entry)


def temporary_path(path: Path) -> Path:
    """Return a new name in the folder of `path` that `remove_leftovers` recognises."""
    return path.with_name(f".atlas-{process_name()}-{secrets.token_hex(4)}.tmp")


def sealed(content: Mapping[str, Any]) -> str:
    """Return JSON text of the entries and a checksum, which `parsed` verifies."""
    return json.dumps({**content, "checksum": hash_of(content)}, indent=1)


def parsed(text: str | bytes, *, is_sealed: bool = False) -> dict[str, Any]:
    """Return the entries of a JSON text. Raise ValueError if the text is damaged, or changed since `sealed` made it."""
    try:
        content = json.loads(text)
        if not isinstance(content, dict):
            raise ValueError("it is no table")
        if is_sealed and content.pop("checksum", None) != hash_of(content):
            raise ValueError("its checksum does not match its content")
    except RecursionError:
        raise ValueError("it is nested too deeply") from None
    return content


def read_bytes(path: Path | str, most: int = MAX_JSON_BYTES) -> bytes:
    """Return the content of a file. Raise ValueError if the file is longer than `most` bytes or not a regular file."""
    status = os.stat(path)
    if not stat.S_ISREG(status.st_mode):
        raise ValueError("it is no regular file")
    if status.st_size > most:
        raise ValueError(f"more than {most} bytes")
    with open(path, "rb", buffering=0) as file:
        return file.read()


def cache_folder() -> Path:
    """Return the folder in the environment variable ATLAS_CACHE, or else the user's default cache folder."""
    import platformdirs  # few commands need this import

    return Path(os.environ.get("ATLAS_CACHE") or platformdirs.user_cache_path("precession-atlas", False))


def is_private(folder: Path, instead: str) -> bool:
    """Whether a folder of the cache is readable, and only this user can have written there. If not, log what is done `instead`."""
    if folder != cache_folder() and not is_private(cache_folder(), instead):
        return False
    status = os.lstat(folder)
    danger = _danger(status)
    if stat.S_ISLNK(status.st_mode):
        danger = "is a symbolic link"
    elif not stat.S_ISDIR(status.st_mode):
        danger = "is not a folder"
    elif not danger and not os.access(folder, os.R_OK | os.X_OK):
        danger = "cannot be read"
    if danger:
        complain(
            folder,
            f"{danger}: nothing in it is used, {instead}; remove it, or set ATLAS_CACHE to a folder that only you can write",
        )
    return danger is None


def read_private(path: Path) -> bytes:
    """Return the content of a file of the cache. Raise ValueError if another user may have written the file."""
    # With these flags `open` neither follows a link nor waits for the other end of a pipe.
    flags = os.O_RDONLY | getattr(os, "O_NOFOLLOW", 0) | getattr(os, "O_NONBLOCK", 0)
    with open(path, "rb", opener=lambda name, _: os.open(name, flags)) as file:
        status = os.fstat(file.fileno())
        if not stat.S_ISREG(status.st_mode) or _danger(status):
            raise ValueError(_danger(status) or "it is not a file")
        return file.read()


def _danger(status: os.stat_result) -> str | None:
    """Return the reason why another user may have written a file or folder, or None."""
    if hasattr(os, "geteuid") and status.st_uid != os.geteuid():
        return "belongs to another user"
    if os.name == "posix" and status.st_mode & (stat.S_IWGRP | stat.S_IWOTH):
        return "can be written by other users"
    return None


_complaints: set[Path] = set()


def complain(folder: Path, text: str) -> None:
    """Log a warning about an unusable cache, once for each folder."""
    if folder not in _complaints:
        _complaints.add(folder)
        logging.getLogger("atlas").warning("the cache %s %s", folder, text)


def check_types(content: Mapping[str, Any], types: Mapping[str, Any]) -> None:
    """Raise ValueError unless entries have these types. Refuse bools, numbers of at least 1e18 and texts that UTF-8 cannot encode."""
    for name, kind in types.items():
        value = content.get(name)
        is_number = isinstance(value, int | float)
        if not isinstance(value, kind) or isinstance(value, bool) or (is_number and not abs(value) < 1e18):
            raise ValueError(f"its entry {name} is missing or no value that is allowed")
        if isinstance(value, str):
            value.encode()  # raises UnicodeEncodeError, a ValueError


def check_claim(claimed: int, stored: int) -> None:
    """Raise ValueError if a file of `stored` bytes cannot hold the `claimed` bytes of numbers."""
    if claimed > max(MIN_CLAIM, MAX_RATIO * stored):
        raise ValueError(f"it claims {claimed:.3g} bytes of numbers, more than {stored} bytes can hold")


def hash_of(content: Any) -> str:
    """Return a hash of a value that JSON can represent. The order of entries does not matter."""
    return hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()


def _sync(path: Path) -> None:
    """Flush a file, or the names that a folder contains, to the disk."""
    handle = os.open(path, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)


def disk_error(error: Exception, path: Path) -> OSError:
    """Convert an error of netCDF4 to an OSError. netCDF4 reports a full disk as an HDF error or a permission error."""
    reason = errno.ENOSPC if shutil.disk_usage(path.parent).free < MIN_FREE_BYTES else None
    try:
        with tempfile.TemporaryFile(dir=path.parent) as trial:
            trial.write(bytes(1 << 20))
    except OSError as failed:  # a quota or a limit of the file size is reached
        reason = reason or failed.errno
    if reason is not None:
        return OSError(reason, f"{os.strerror(reason)} ({one_line(error)})", str(path))
    return error if isinstance(error, OSError) else OSError(errno.EIO, str(error), str(path))


def check_name(path: Path, inside: str = "") -> None:
    """Raise BadInput if `path`, or the path of a file `inside` the folder `path`, is too long for the file system."""
    for each in (path, path / inside):
        try:
            os.lstat(each)
        except OSError as error:
            if error.errno == errno.ENAMETOOLONG:
                name = path.name if len(path.name) < 60 else f"{path.name[:60]}..."
                raise BadInput(
                    f"{name}: this name, or the path to it, is too long for the file system"
                ) from None


def check_folder(path: Path) -> None:
    """Raise BadInput unless a file can be written at `path`."""
    check_name(path)
    folder = path.parent
    if not folder.is_dir():
        raise BadInput(f"{path}: there is no folder {folder}")
    try:
        tempfile.TemporaryFile(dir=folder).close()
    except OSError as error:
        raise BadInput(f"{path}: cannot be written: {error.strerror}") from None
    if path.is_dir():
        raise BadInput(f"{path}: this is a folder")


def check_not_input(path: Path, inputs: Iterable[str | Path]) -> None:
    """Raise BadInput if `path` is one of the inputs, or lies in an input that is a folder. Links are resolved."""
    for each in map(Path, inputs):
        with suppress(OSError):  # a path may be missing
            if each.is_dir() and path.resolve().is_relative_to(each.resolve()):
                raise BadInput(f"{path}: in {each}, which is read; choose another place")
            if path.samefile(each):
                raise BadInput(f"{path}: this is the input, which is never replaced; choose another name")


def without_suffix(name: str | Path, *suffixes: str) -> Path:
    """Return a path, or the last part of a web address, without a suffix in `suffixes`. The name k3_0.5 keeps the .5."""
    path = Path(Path(name).name) if "://" in str(name) else Path(name)
    if path.name in ("", ".."):
        path = path.resolve()
    return path.with_suffix("") if path.suffix.lower() in suffixes else path


def either(words: Iterable[str]) -> str:
    """Join the words for a sentence, as in "a, b or c"."""
    *others, last = words
    return " or ".join(filter(None, (", ".join(others), last)))


def writable(
    name: str | Path, suffixes: Collection[str], *, force: bool, inputs: Iterable[str | Path] = ()
) -> Path:
    """Return the path of a file to write. Raise BadInput for a wrong suffix, an input file, and an existing file unless `force`."""
    path = Path(name)
    if path.suffix.lower() not in suffixes:
        raise BadInput(f"{path}: the name must end in {either(suffixes)}")
    check_name(path)
    check_not_input(path, inputs)
    check_folder(path)
    remove_leftovers(path.parent)
    check_replaceable(path)
    if path.exists() and not force:
        raise BadInput(exists_message(path))
    return path


def check_replaceable(path: Path) -> None:
    """Raise BadInput if `path` is a NetCDF, HDF5 or Zarr file that is not known to be an atlas, or a path that NetCDF cannot open."""
    from .hdf5 import SIGNATURES, check_path, is_own, locked_text  # few processes need this import

    if path.suffix.lower() == ".nc":
        check_path(path)
    if not path.is_file():
        return
    with path.open("rb") as file:
        if path.suffix.lower() in (".nc", ".zarr") or file.read(8).startswith(SIGNATURES):
            if text := locked_text(path):
                raise BadInput(f"{path}: {text}; it is not replaced")
            if not is_own(path):
                raise BadInput(foreign_message(path))
