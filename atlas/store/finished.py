"""Formats of finished atlases. The suffix of the file name selects the format, which writes, reads and verifies atlases."""

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
# Module and purpose of each suffix. A module is imported on use, and defines the name `FORMAT`. Extensions add formats of files.
FORMATS = {FILE: ("netcdf", "for one file"), STORE: ("zarr_store", "for a Zarr store")}
METADATA = "zarr.json"  # object with the root metadata of a Zarr store


@dataclass(frozen=True, eq=False)
class Content:
    """An atlas to write, which may be larger than memory."""

    # The dataset has no attributes. Large parameters are dask arrays, and the variables `names` are zeros that `blocks` replace.
    ds: xr.Dataset
    names: Collection[str]
    chunk: Mapping[str, int]  # length of a block along each dimension
    blocks: Iterator[Block]  # boxes that together cover the grid, with the values of the variables `names`
    # To be called after the last block, because attributes contain sums over all blocks.
    attributes: Callable[[], Mapping[str, Any]]


class Format(Protocol):
    """A format of finished atlases. A subclass defines the abstract methods.

    Only the format of Zarr stores gets a str as path, which is the address of an object store.
    """

    @abstractmethod
    def write(self, content: Content, path: Path | str) -> None:
        """Write an atlas, whole or not at all, as `files.atomic_write` does. An earlier file at `path` is replaced."""

    @abstractmethod
    def open_dataset(self, path: Path | str) -> xr.Dataset:
        """Open an atlas with the variables, coordinates and attributes that were written. Raise BadInput if this is impossible.

        An implementation must execute nothing in the file, and must not allocate more memory than the file can fill.
        """

    @abstractmethod
    def verify(self, path: Path | str) -> None:
        """Read a whole atlas. Raise BadInput if the atlas has changed since it was written, or has no hash."""

    @abstractmethod
    def has_hash(self, path: Path | str) -> bool:
        """Whether an atlas has the hash that `verify` checks. A copy by another program and an unreadable file have none."""

    def writable(self, path: Path | str, *, force: bool, inputs: Iterable[str | Path] = ()) -> Path | str:
        """Return the path for a new atlas. Raise BadInput as `files.writable` does, or if an existing file has no hash."""
        path = files.writable(path, suffixes(), force=force, inputs=inputs)
        if path.exists() and not self.has_hash(path):
            raise BadInput(files.foreign_message(path))
        return path

    def stamp(self, path: Path | str) -> object:
        """Return a value that changes when an atlas is replaced, or None if there is no whole atlas."""
        return Folder(Path(path).parent).stamp(Path(path).name)


def suffixes() -> dict[str, str]:
    """Return a text such as "for one file" for each suffix. Raise BadInput if the suffix of an extension is taken or not in lower case."""
    all_suffixes = {suffix: atlases for suffix, (_, atlases) in FORMATS.items()}
    for suffix, (extension, _) in parts("formats").items():
        if suffix in all_suffixes or suffix != Path(f"a{suffix}").suffix.lower():
            raise BadInput(f"the extension {extension.name}: {suffix} must be a new suffix in lower case")
        all_suffixes[suffix] = f"of the extension {extension.name}"
    return all_suffixes


def is_store(path: Path | str) -> bool:
    """Whether a path or address from `located` has the name of a Zarr store."""
    return str(path).lower().endswith(STORE)


def is_finished(path: Path | str) -> bool:
    """Whether a path or address from `located` is a finished atlas and not a run. The atlas is a file, or a store of any name."""
    return (isinstance(path, Path) and path.is_file()) or METADATA in place_at(path).names()


def format_of(path: Path | str) -> Format:
    """Return the format of an atlas by the suffix. An unknown suffix means Zarr for a folder or address, otherwise NetCDF."""
    is_file = isinstance(path, Path) and not is_store(path) and not path.is_dir()
    suffix = path.suffix.lower() if isinstance(path, Path) and is_file else STORE
    given: Format | None = None if suffix in FORMATS else load("formats", suffix)
    if given is not None:
        return given
    module, _ = FORMATS.get(suffix, FORMATS[FILE])
    own: Format = import_module(f".{module}", __package__).FORMAT
    return own
