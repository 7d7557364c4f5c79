"""The finished atlas: one NetCDF file, or one Zarr store in a folder or below an address of an object store."""

from __future__ import annotations

import json
import re
from collections.abc import Iterable, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

import netCDF4

from ..errors import BadInput
from ..files import TEMPORARY, check_not_input, exists_message, foreign_message
from . import netcdf
from .dataset import EARLIER_HASHES, HASH, METADATA, VERSION
from .place import Folder, Place, place_at

SUFFIX = ".zarr"
# Names in a store; the group `atlas` is of version 0.1.0.
OWN = re.compile(r"atlas/([\w/-]+\.(json|claim|pack|nc|bin)|clock)|[^/]+/(zarr\.json|c(/\d+)*)|zarr\.json")


def is_store(path: Path | str) -> bool:
    """Whether a result of `located` has the name of a Zarr store."""
    return str(path).lower().endswith(SUFFIX)


def is_finished(path: Path | str) -> bool:
    """Whether a result of `located` is a finished atlas, a file or a store of any name, and not a run."""
    return (isinstance(path, Path) and path.is_file()) or METADATA in place_at(path).names()


def form(path: Path | str) -> Any:
    """The module for an atlas in a NetCDF file or a Zarr store; BadInput if the package zarr is not installed."""
    if isinstance(path, Path) and not is_store(path) and not path.is_dir():
        return netcdf
    try:
        from . import zarr_store
    except ImportError:
        raise BadInput("Zarr stores need the package zarr: python -m pip install zarr") from None
    return zarr_store


def attributes_of(place: Place) -> dict[str, Any]:
    """Attributes of a Zarr store, empty if there is none, or if they cannot be read."""
    try:
        return dict(json.loads(place.read(METADATA))["attributes"])
    except (FileNotFoundError, NotADirectoryError, LookupError, TypeError, ValueError, RecursionError):
        return {}


def has_hash(path: Path | str) -> bool:
    """Whether an atlas has its hash, unlike a copy by xarray."""
    if form(path) is not netcdf:
        return HASH in attributes_of(place_at(path))
    with netcdf.NETCDF_LOCK, netCDF4.Dataset(Path(path)) as file:
        return HASH in file.ncattrs()


def stamp(path: Path | str) -> object:
    """A value that changes when an atlas is replaced; None without a whole atlas."""
    if is_store(path):
        place, attributes = place_at(path), attributes_of(place_at(path))
        is_whole = HASH in attributes or not EARLIER_HASHES.isdisjoint(attributes)
        return place.stamp(METADATA) if is_whole else None
    return Folder(Path(path).parent).stamp(Path(path).name)


def writable(
    path: Path | str, suffixes: Sequence[str], *, force: bool, inputs: Iterable[str | Path] = ()
) -> Path | str:
    """Check the place of an atlas to write; BadInput as `files.writable`, and if the place holds anything but an atlas or part of one."""
    form(path)  # BadInput if it is not installed
    if isinstance(path, Path) and not (is_store(path) and path.is_dir()):
        return netcdf.writable(path, suffixes, force=force, inputs=inputs)
    if not is_store(path):
        raise BadInput(f"{path}: the name must end in {SUFFIX}")
    check_not_input(Path(path), inputs)
    place, contents = place_at(path), place_at(path).walk()
    is_own = not contents or f"atlas/{METADATA}" in contents
    with suppress(FileNotFoundError, ValueError):
        # Damaged metadata contain the name of this attribute as well.
        is_own = VERSION.encode() in place.read(METADATA)
    if not is_own or not all(
        OWN.fullmatch(each) or TEMPORARY.fullmatch(each.rpartition("/")[2]) for each in contents
    ):
        raise BadInput(foreign_message(path))
    if stamp(path) is not None and not force:
        raise BadInput(exists_message(path))
    return path
