"""Where runs are kept: contents by name in a folder of the file system, or below an address of an object store.

Both have the same methods. A content appears whole or not at all; `create` never replaces one, on which claims are built.
"""

from __future__ import annotations

import errno
import os
import re
import shutil
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from functools import lru_cache
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, TypeAlias
from urllib.parse import unquote

from ..errors import BadInput
from ..files import (
    MAX_JSON_BYTES,
    age,
    atomic_write,
    is_running,
    one_line,
    process_name,
    read_bytes,
    remove_leftovers,
    temporary_path,
)

Stamp: TypeAlias = list[int | str]  # size and version of a content, which differ after a change
ADDRESS = re.compile(r"[a-z][a-z0-9+]+://")
# Seconds without a sign of life after which a claim expires, and between two signs of life of this process.
CLAIM_AGE, CLAIM_INTERVAL = 180.0, 20.0


def located(path: str | Path) -> Path | str:
    """An absolute path, or the address of an object store as it is."""
    text = str(path)
    if text.startswith("file://"):
        path = unquote(text.removeprefix("file://"))
    elif ADDRESS.match(text):
        return text.rstrip("/")
    return Path(path).absolute()


def storage_at(path: Path | str) -> Storage:
    """The storage at what `located` gives."""
    return Folder(path) if isinstance(path, Path) else Objects(path)


class Folder:
    """Contents in the files of a folder."""

    def __init__(self, path: Path):
        self.path = path

    def inside(self, name: str) -> Folder:
        """The part with names that begin so."""
        return Folder(self.path / name)

    def read(self, name: str, most: int = MAX_JSON_BYTES) -> bytes:
        """A content; FileNotFoundError without one, ValueError if it is longer than allowed."""
        return read_bytes(os.path.join(self.path, name), most)

    @contextmanager
    def temporary(self) -> Iterator[Path]:
        """Give the name of a file on the same disk, which is removed in the end."""
        path = temporary_path(self.path)
        try:
            yield path
        finally:
            path.unlink(missing_ok=True)

    def write(self, name: str, content: bytes, *, durable: bool = True) -> None:
        """Write a content, or replace it."""
        with atomic_write(self._place(name), durable=durable) as temporary:
            temporary.write_bytes(content)

    def create(self, name: str, content: bytes) -> bool:
        """Whether this call writes a content, because there was none; others may see a part of it."""
        with suppress(FileExistsError):
            with self._place(name).open("xb") as file:
                file.write(content)
            return True
        return False

    def _place(self, name: str) -> Path:
        """Path of a content, whose folder is made, but not this one, which another process may have removed."""
        path = self.path / name
        if not path.parent.is_dir() and self.path.is_dir():
            path.parent.mkdir(parents=True, exist_ok=True)
        return path

    def make(self) -> None:
        """Make the folder."""
        self.path.mkdir(exist_ok=True)

    def names(self, folder: str = "") -> set[str]:
        """Names in a folder."""
        with suppress(FileNotFoundError, NotADirectoryError):
            return {entry.name for entry in os.scandir(self.path / folder)}
        return set()

    def walk(self) -> list[str]:
        """Names of all contents, also those of folders inside."""
        return [path.relative_to(self.path).as_posix() for path in self.path.rglob("*") if path.is_file()]

    def remove(self, name: str) -> None:
        """Remove a content, if there is one."""
        (self.path / name).unlink(missing_ok=True)

    def clear(self, last: str) -> None:
        """Remove everything; on an object store what is removed last says what a part of it was."""
        removed = temporary_path(self.path)
        os.rename(self.path, removed)  # at once, so that a process at work cannot leave anything behind
        shutil.rmtree(removed, ignore_errors=True)

    def stamps(self, folder: str = "") -> dict[str, Stamp]:
        """Stamps of the files of a folder by their names."""
        stamps = dict[str, Stamp]()
        with suppress(FileNotFoundError, NotADirectoryError), os.scandir(self.path / folder) as entries:
            for entry in entries:
                try:  # `suppress` would take half of the time
                    status = entry.stat()
                    stamps[entry.name] = [status.st_size, status.st_mtime_ns]
                except FileNotFoundError:
                    continue
        return stamps

    def age(self, name: str) -> float:
        """Seconds since a content was written, by the clock of the storage."""
        return age(self.path / name)

    def remove_leftovers(self) -> None:
        """Remove temporary files of processes that were killed, also in folders inside."""
        for folder, _, _ in os.walk(self.path):
            remove_leftovers(Path(folder))

    def __str__(self) -> str:
        return str(self.path)

    def zarr(self, package: Any) -> Any:
        """The storage as the package zarr reads it."""
        return package.storage.LocalStore(self.path, read_only=True)


@lru_cache
def _store(address: str) -> Any:
    """An object store, which all parts of a process share."""
    try:
        from obstore.store import MemoryStore, from_url
    except ImportError:
        raise BadInput(f"{address}: needs the package obstore: python -m pip install obstore") from None
    try:
        return MemoryStore() if address.startswith("memory://") else from_url(address)
    except Exception as error:  # of several kinds
        raise BadInput(f"{address}: no address of an object store ({one_line(error)})") from None


class Objects:
    """Contents in the objects of a store, with the methods of `Folder`."""

    def __init__(self, address: str, prefix: str = ""):
        self.address, self.prefix, self.store = address, prefix, _store(address)

    def inside(self, name: str) -> Objects:
        return Objects(self.address, f"{self.prefix}{name}/")

    def read(self, name: str, most: int = MAX_JSON_BYTES) -> bytes:
        result = self._call("get", name)
        if result.meta["size"] > most:
            raise ValueError(f"more than {most} bytes")
        return bytes(result.bytes())

    @contextmanager
    def temporary(self) -> Iterator[Path]:
        with TemporaryDirectory() as folder:
            yield Path(folder, "content")

    def write(self, name: str, content: bytes, *, durable: bool = True) -> None:
        self._call("put", name, content)

    def create(self, name: str, content: bytes) -> bool:
        with suppress(FileExistsError):
            self._call("put", name, content, mode="create")
            return True
        return False

    def walk(self) -> list[str]:
        return [each["path"].removeprefix(self.prefix) for each in self._call("list", "")]

    def remove(self, name: str) -> None:
        with suppress(FileNotFoundError):
            self._call("delete", name)

    def clear(self, last: str) -> None:
        self._call("delete", [name for name in self.walk() if name != last])
        self.remove(last)

    def make(self) -> None:
        pass

    def names(self, folder: str = "") -> set[str]:
        return set(self.stamps(folder))

    def stamps(self, folder: str = "") -> dict[str, Stamp]:
        listed = self._call("list_with_delimiter", folder)["objects"]
        return {each["path"].rpartition("/")[2]: [each["size"], str(each["e_tag"])] for each in listed}

    def age(self, name: str) -> float:
        self.write("clock", b"")
        written, now = (self._call("head", each)["last_modified"] for each in (name, "clock"))
        return float((now - written).total_seconds())

    def remove_leftovers(self) -> None:
        pass  # a put that was not finished leaves no object

    def zarr(self, package: Any) -> Any:
        return package.storage.ObjectStore(self.store, read_only=True)

    def _call(self, function: str, name: str | list[str], *arguments: Any, **options: Any) -> Any:
        """Call a function of obstore; FileNotFoundError, FileExistsError or another OSError if it fails."""
        import obstore

        place = self.prefix + name if isinstance(name, str) else [self.prefix + each for each in name]
        try:
            result = getattr(obstore, function)(self.store, place, *arguments, **options)
            return result.collect() if function == "list" else result
        except obstore.exceptions.AlreadyExistsError:
            raise FileExistsError(errno.EEXIST, os.strerror(errno.EEXIST), name) from None
        except obstore.exceptions.BaseError as error:
            raise OSError(errno.EIO, one_line(error), f"{self.address}/{self.prefix}{name}") from None


Storage: TypeAlias = Folder | Objects


def claim(storage: Storage, name: str) -> bool:
    """Whether this process may do what a content stands for: it creates the content, or takes over one that expired."""
    process = process_name().encode()
    if storage.create(name, process):
        return True
    if is_claimed(storage, name):
        return False
    storage.write(name, process, durable=False)
    return True


def is_claimed(storage: Storage, name: str) -> bool:
    """Whether another process that made a claim is at work: as far as is known it runs, and it renewed the claim of late."""
    try:
        process = storage.read(name).decode("ascii", "replace")
        return (
            process != process_name() and is_running(process) is not False and storage.age(name) <= CLAIM_AGE
        )
    except (OSError, ValueError):  # it has been removed
        return False
