"""Places of runs and atlases. A place is a folder, or an address of an object store.

Folders and object stores have the same methods, in which a file means a file or an object. A file appears whole or not at all.
"""

from __future__ import annotations

import errno
import logging
import os
import re
import shutil
import time
from collections.abc import Callable
from contextlib import suppress
from functools import lru_cache
from pathlib import Path
from typing import Any, TypeAlias
from urllib.parse import unquote

from ..errors import BadInput, one_line
from ..files import MAX_JSON_BYTES, age, atomic_write, read_bytes, remove_leftovers, temporary_path

ADDRESS = re.compile(r"[a-z][a-z0-9+]+://")
# A request is repeated after FIRST_PAUSE to LONGEST_PAUSE seconds, with a warning after QUIET, and given up after PATIENCE seconds.
PATIENCE, FIRST_PAUSE, LONGEST_PAUSE, QUIET = 600.0, 0.2, 5.0, 10.0
# Answers of a server that another attempt would not change.
FINAL = re.compile(r"status code: 4(?!08|09|25|29)\d\d")
CLOCK = "clock"  # name of an empty file that is written to read the clock of the storage


def located(path: str | Path) -> Path | str:
    """Return an absolute path, or the address of an object store without a final /."""
    text = str(path)
    if text.startswith("file://"):
        path = unquote(text.removeprefix("file://"))
    elif ADDRESS.match(text):
        return text.rstrip("/")
    return Path(path).absolute()


def place_at(path: Path | str) -> Place:
    """Return the place at a path or address from `located`."""
    return Folder(path) if isinstance(path, Path) else Objects(path)


class Folder:
    """A place that is a folder."""

    def __init__(self, path: Path):
        self.path = path

    def inside(self, name: str) -> Folder:
        """Return the place with the given name inside this place."""
        return Folder(self.path / name)

    def read(self, name: str, most: int = MAX_JSON_BYTES) -> bytes:
        """Return a file's content. Raise FileNotFoundError if the file is missing, or ValueError if the file is too long or not regular."""
        return read_bytes(os.path.join(self.path, name), most)

    def write(self, name: str, content: bytes, *, durable: bool = True) -> None:
        """Write a file, or replace the content of an existing file."""
        with atomic_write(self._file(name), durable=durable) as temporary:
            temporary.write_bytes(content)

    def create(self, name: str, content: bytes) -> bool:
        """Write a file unless the name exists, and return whether the file was written. Only one of several processes succeeds."""
        path = self._file(name)
        try:
            with atomic_write(path, durable=False, new=True) as temporary:
                temporary.write_bytes(content)
        except FileExistsError:
            return False
        except OSError:  # Without hard links, the file is written in place. A kill may leave an empty file.
            with suppress(FileExistsError), path.open("xb", buffering=0) as file:
                try:
                    file.write(content)
                except BaseException:
                    path.unlink()
                    raise
                return True
            return False
        return True

    def _file(self, name: str) -> Path:
        """Return the path of a file and make the parent folder, unless another process has removed the whole place."""
        path = self.path / name
        if not path.parent.is_dir() and self.path.is_dir():
            path.parent.mkdir(parents=True, exist_ok=True)
        return path

    def make(self) -> None:
        self.path.mkdir(exist_ok=True)

    def names(self, folder: str = "") -> list[str]:
        """Return the names in a folder, or no names if there is no folder."""
        with suppress(FileNotFoundError, NotADirectoryError):
            return os.listdir(self.path / folder)
        return []

    def walk(self) -> list[str]:
        """Return the names of all files in this folder and its subfolders."""
        start = len(str(self.path)) + 1
        return [f"{where}/{name}"[start:] for where, _, names in os.walk(self.path) for name in names]

    def remove(self, name: str) -> None:
        """Remove a file, if it exists."""
        (self.path / name).unlink(missing_ok=True)

    def clear(self) -> None:
        """Remove the whole folder in one move, so that a process at work cannot leave files behind."""
        removed = temporary_path(self.path)
        with suppress(FileNotFoundError):
            os.rename(self.path, removed)
            shutil.rmtree(removed, ignore_errors=True)

    def stamp(self, name: str) -> object:
        """Return a value that changes when a file is replaced, or None if the file is missing."""
        with suppress(OSError):  # A path that is too long also raises OSError.
            status = os.stat(self.path / name)
            return status.st_ino, status.st_mtime_ns
        return None

    def age(self, name: str) -> float:
        """Return the seconds since a file was written, by the clock of the storage."""
        return age(self.path / name)

    def remove_leftovers(self) -> None:
        """Remove temporary files of killed processes in this folder and its subfolders."""
        for folder, _, _ in os.walk(self.path):
            remove_leftovers(Path(folder))

    def __str__(self) -> str:
        return str(self.path)


@lru_cache
def _store(address: str) -> Any:
    """Return the object store at an address. The store makes no retries, because `Objects._answer` repeats requests."""
    try:
        from obstore.store import MemoryStore, from_url
    except ImportError:
        raise BadInput(f"{address}: needs the package obstore: python -m pip install obstore") from None
    try:
        if address.startswith("memory://"):
            return MemoryStore()
        return from_url(address, retry_config={"max_retries": 0})
    except Exception as error:  # The package obstore raises several types of errors.
        raise BadInput(f"{address}: no address of an object store ({one_line(error)})") from None


class Objects:
    """A place in an object store, with the methods of `Folder`."""

    def __init__(self, address: str, prefix: str = ""):
        self.address, self.prefix, self.store = address, prefix, _store(address)

    def __reduce__(self) -> Any:
        return Objects, (self.address, self.prefix)

    def inside(self, name: str) -> Objects:
        return Objects(self.address, f"{self.prefix}{name}/")

    def read(self, name: str, most: int = MAX_JSON_BYTES) -> bytes:
        def content(path: str, obstore: Any) -> bytes:
            result = obstore.get(self.store, path)
            if result.meta["size"] > most:
                raise ValueError(f"more than {most} bytes")
            content = bytes(result.bytes())
            if len(content) != result.meta["size"]:
                raise obstore.exceptions.GenericError("the answer ended early")
            return content

        return self._answer(content, name)

    def write(self, name: str, content: bytes, *, durable: bool = True) -> None:
        self._answer("put", name, content)

    def create(self, name: str, content: bytes) -> bool:
        with suppress(FileExistsError):
            self._answer("put", name, content, mode="create")
            return True
        return False

    def walk(self) -> list[str]:
        listing = self._answer(lambda path, obstore: obstore.list(self.store, path).collect())
        return [each["path"].removeprefix(self.prefix) for each in listing]

    def remove(self, name: str) -> None:
        with suppress(FileNotFoundError):
            self._answer("delete", name)

    def clear(self, *, but: str = "") -> None:
        """Remove all objects except the object with the name `but`."""
        if names := [self.prefix + name for name in self.walk() if name != but]:
            self._answer(lambda path, obstore: obstore.delete(self.store, names))

    def make(self) -> None:
        pass

    def names(self, folder: str = "") -> list[str]:
        listing = self._answer("list_with_delimiter", folder)
        return [each["path"].rpartition("/")[2] for each in listing["objects"]]

    def stamp(self, name: str) -> object:
        with suppress(FileNotFoundError):
            head = self._answer("head", name)
            return head["e_tag"], head["last_modified"]
        return None

    def age(self, name: str) -> float:
        self.write(CLOCK, b"")
        written, now = (self._answer("head", each)["last_modified"] for each in (name, CLOCK))
        return float((now - written).total_seconds())

    def remove_leftovers(self) -> None:
        pass  # An unfinished put leaves no object.

    def __str__(self) -> str:
        return f"{self.address}/{self.prefix}".rstrip("/")

    def _answer(
        self, request: str | Callable[[str, Any], Any], name: str = "", *arguments: Any, **options: Any
    ) -> Any:
        """Call a function of obstore and return the result. Calls are repeated while the store does not answer. Failures raise OSError."""
        import obstore

        path, began, pause, warned = self.prefix + name, time.monotonic(), FIRST_PAUSE, False
        while True:
            try:
                if callable(request):
                    return request(path, obstore)
                return getattr(obstore, request)(self.store, path, *arguments, **options)
            except obstore.exceptions.AlreadyExistsError:
                raise FileExistsError(errno.EEXIST, os.strerror(errno.EEXIST), name) from None
            except obstore.exceptions.BaseError as error:
                reason = one_line(Exception(str(error).partition("\n\n")[0]))
                waited = time.monotonic() - began
                final = not isinstance(error, obstore.exceptions.GenericError) or FINAL.search(str(error))
                if final or waited > PATIENCE:
                    raise OSError(
                        errno.EIO, f"the object store does not do what is asked ({reason}); what is finished is kept, and the"
                        " same command continues", f"{self.address}/{path}",
                    ) from None  # fmt: skip
                if waited > QUIET and not warned:
                    warned = True
                    logging.getLogger("atlas").warning(
                        "%s does not answer, and is asked again for %.0f minutes (%s)",
                        self.address, PATIENCE / 60, reason,
                    )  # fmt: skip
            time.sleep(pause)
            pause = min(2 * pause, LONGEST_PAUSE)


Place: TypeAlias = Folder | Objects
