"""Formats of finished atlases, by the suffix of the file name; a format writes, reads and verifies atlases."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol

from .. import files
from ..errors import BadInput
from ..extension import load, parts
from .place import Folder, place_at

if TYPE_CHECKING:
    import xarray as xr

    from .dataset import Block

FILE, STORE = ".nc", ".zarr"
# Suffix -> module of the `FORMAT`, imported on use, and the purpose of the suffix. Extensions add formats of single files.
FORMATS = {FILE: ("netcdf", "for one file"), STORE: ("zarr_store", "for a Zarr store")}
METADATA = "zarr.json"  # root metadata of a Zarr store


@dataclass(frozen=True, eq=False)
class Content:
    """An atlas to write, which may be larger than memory."""

    # Without attributes; the variables `names` are zeros, to be replaced by `blocks`; large parameters are dask arrays.
    ds: xr.Dataset
    names: Collection[str]
    chunk: Mapping[str, int]  # length of a block along each dimension
    blocks: Iterator[Block]  # boxes that together cover the grid, with the values of the variables `names`
    # Attributes contain sums over all blocks, so call this after the last block.
    attributes: Callable[[], Mapping[str, Any]]


class Format(Protocol):
    """A format of finished atlases: a subclass defines the abstract methods.

    Only Zarr stores get the address of an object store (a str) in place of a path.
    """

    @abstractmethod
    def write(self, content: Content, path: Path | str) -> None:
        """Write an atlas, whole or not at all; an earlier file at `path` is replaced, as by `files.atomic_write`."""

    @abstractmethod
    def open_dataset(self, path: Path | str) -> xr.Dataset:
        """Open an atlas with the variables, coordinates and attributes that were written; BadInput if it cannot be read.

        An implementation must execute nothing in the file, and must not allocate more memory than the file can fill.
        """

    @abstractmethod
    def verify(self, path: Path | str) -> None:
        """Read all of an atlas; BadInput if it has changed since it was written, or has no hash."""

    @abstractmethod
    def has_hash(self, path: Path | str) -> bool:
        """Whether an atlas has the hash that `verify` compares; False for a copy by another program or an unreadable file."""

    def writable(self, path: Path | str, *, force: bool, inputs: Iterable[str | Path] = ()) -> Path | str:
        """Path for a new atlas; BadInput as by `files.writable`, or if the path holds anything but an atlas."""
        path = files.writable(path, suffixes(), force=force, inputs=inputs)
        if path.exists() and not self.has_hash(path):
            raise BadInput(files.foreign_message(path))
        return path

    def stamp(self, path: Path | str) -> object:
        """A value that changes when an atlas is replaced; None if there is no whole atlas."""
        return Folder(Path(path).parent).stamp(Path(path).name)


def suffixes() -> dict[str, str]:
    """Suffix -> its purpose, for all formats; BadInput if the suffix of an extension is taken or not in lower case."""
    all_suffixes = {suffix: atlases for suffix, (_, atlases) in FORMATS.items()}
    for suffix, (extension, _) in parts("formats").items():
        if suffix in all_suffixes or suffix != Path(f"a{suffix}").suffix.lower():
            raise BadInput(f"the extension {extension.name}: {suffix} must be a new suffix in lower case")
        all_suffixes[suffix] = f"of the extension {extension.name}"
    return all_suffixes


def is_store(path: Path | str) -> bool:
    """Whether a path or address (a result of `located`) has the name of a Zarr store."""
    return str(path).lower().endswith(STORE)


def is_finished(path: Path | str) -> bool:
    """Whether a path or address (a result of `located`) is a finished atlas (a file or store of any name), not a run."""
    return (isinstance(path, Path) and path.is_file()) or METADATA in place_at(path).names()


def format_of(path: Path | str) -> Format:
    """The format of an atlas by its suffix; for unknown suffixes Zarr if the path is a folder or address, else NetCDF."""
    is_file = isinstance(path, Path) and not is_store(path) and not path.is_dir()
    suffix = path.suffix.lower() if isinstance(path, Path) and is_file else STORE
    given: Format | None = None if suffix in FORMATS else load("formats", suffix)
    if given is not None:
        return given
    module, _ = FORMATS.get(suffix, FORMATS[FILE])
    own: Format = import_module(f".{module}", __package__).FORMAT
    return own
