"""Find systems of other installed packages by their entry points in the group `atlas.systems`."""

from __future__ import annotations

import hashlib
import inspect
import sys
from dataclasses import dataclass
from importlib.metadata import entry_points
from pathlib import Path
from types import ModuleType

from ..errors import BadInput, shown
from .base import System

GROUP = "atlas.systems"


@dataclass(frozen=True)
class Origin:
    """Origin of a system that is not built in."""

    package: str  # name and version of the installed package; empty for a system registered in this process
    # Hash of the source files at registration. A system without files has the hash of its bytecode.
    code: str
    files: tuple[Path, ...]  # source files of the system

    def changed(self) -> Path | None:
        """Return the file, or the folder of several files, if a file has changed since the registration of the system, else None."""
        if self.files and _hash_of_files(self.files) != self.code:
            return self.files[0].parent if len(self.files) > 1 else self.files[0]
        return None


def names() -> list[str]:
    """Return the sorted names of the systems of installed packages without importing any of them."""
    return sorted({entry.name for entry in entry_points(group=GROUP)})


def load(name: str) -> tuple[object, str] | None:
    """Return the object of the entry point `name` and its package, or None if there is no such entry point.

    Raise BadInput if the object cannot be imported, or if two packages use the name.
    """
    entries = list(entry_points(group=GROUP, name=name))
    if not entries:
        return None
    packages = sorted({f"{e.dist.name} {e.dist.version}" if e.dist is not None else e.value for e in entries})
    if len(packages) > 1:
        raise BadInput(
            f"system = {shown(name)}: several packages have this system: {', '.join(packages)}; remove all but one"
        )
    try:
        value = entries[0].load()
    except (Exception, SystemExit) as error:  # the package's code may raise anything
        text = f"{type(error).__name__}: {' '.join(str(error).split())}"
        raise BadInput(
            f"system = {shown(name)} of {packages[0]} ({entries[0].value}): cannot be imported: {text}"
        ) from None
    return value, packages[0]


def origin(system: System, package: str) -> Origin:
    """Return the origin of a system, with the files of all packages or modules that define its classes and equations."""
    classes, equations = type(system).__mro__[: type(system).__mro__.index(System)], system.equations
    modules = {cls.__module__ for cls in classes}
    modules.add(equations.__name__ if isinstance(equations, ModuleType) else equations.__module__)
    paths = set[Path]()
    for name in modules:
        top = sys.modules.get(name.partition(".")[0])
        for folder in getattr(top, "__path__", ()):
            paths.update(Path(folder).rglob("*.py"))
        file = getattr(sys.modules.get(name), "__file__", None)
        if file is not None and not hasattr(top, "__path__"):
            paths.add(Path(file))
    files = tuple(sorted(paths))
    if files:
        return Origin(package, _hash_of_files(files), files)
    texts = []  # texts that describe a system without files, as in a notebook
    for owner in (*classes, equations):
        for name, value in sorted(vars(owner).items()):
            function = getattr(value, "__func__", value)
            if inspect.isfunction(function):
                code = function.__code__
                texts.append(f"{name} {code.co_code.hex()} {code.co_consts!r} {code.co_names!r}")
            elif name.isupper():
                texts.append(f"{name} {value!r}")
    return Origin(package, hashlib.sha256("\n".join(texts).encode()).hexdigest()[:16], ())


def _hash_of_files(files: tuple[Path, ...]) -> str:
    """Return a hash of the names and contents of files. A missing file counts as empty."""
    content = hashlib.sha256()
    for file in files:
        content.update(file.name.encode() + b"\0" + (file.read_bytes() if file.is_file() else b"") + b"\0")
    return content.hexdigest()[:16]
