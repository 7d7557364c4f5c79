"""Atlases joined along a new dimension of names. The attributes of each part, and thereby the scenes, are kept."""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import Any

import xarray as xr

from ..errors import BadInput, shown
from ..scene.checks import typed
from ..variables import POINT
from .dataset import VERSION, without_fill_values

PARTS = "atlas_parts"  # attribute with the JSON text {dimension: {name: attributes of the part}}
COMMON = ("Conventions", "atlas_system", "atlas_system_package", "atlas_system_code", VERSION)


@typed
def concat(parts: Mapping[str, xr.Dataset], dim: str) -> xr.Dataset:
    """Join atlases along a new dimension of names, and keep the scene of each atlas.

    `xarray.concat` keeps only the first scene, so that motions and theory of the other atlases are refused.

    Parameters
    ----------
    parts : mapping of str to Dataset
        Atlases by name. All have the same system, axes, variables and version of the program. Scenes may differ in parameters,
        families, nudges and durations.
    dim : str
        Name of the new dimension. The coordinate contains the names of the parts.

    Returns
    -------
    xarray.Dataset
        The joined dataset, with the new dimension first. Parts that were opened lazily stay lazy. A part, such as
        ``joined.sel(kind="r")``, has all methods of `ds.atlas`. The joined dataset only has methods that need no scene, such as
        `fractions` and `select`, and can be written and opened like an atlas.

    Raises
    ------
    BadInput
        If the atlases differ in more than their scenes, or the name of the dimension is taken.

    Examples
    --------
    >>> joined = atlas.concat({"r": atlas.run("radius.toml"), "v": atlas.run("velocity.toml")}, "kind")
    >>> joined.atlas.fractions(along="kind")
    >>> joined.sel(kind="r").atlas.map()
    """
    datasets: list[xr.Dataset] = []
    for name, part in dict[Any, Any](parts).items():
        if not isinstance(name, str) or not name:
            raise BadInput(f"parts: the name {shown(name)} must be a text of at least one letter")
        if not isinstance(part, xr.Dataset) or "atlas_system" not in part.attrs:
            raise BadInput(f"parts: {name} = {shown(part)}: must be the dataset of an atlas")
        datasets.append(ds := part_of(part).copy())
        if PARTS in ds.attrs:
            raise BadInput(f"parts: {name} is joined itself: choose one of its parts by sel")
        if difference := _difference(datasets[0], ds):
            raise BadInput(f"parts: {next(iter(parts))} and {name} cannot be joined: {difference}")
        for key, variable in ds.variables.items():
            if key not in ds.xindexes and not variable._in_memory:
                ds[key] = variable.chunk()  # `xr.concat` loads arrays that are not dask arrays
    if not datasets:
        raise BadInput("parts: must have at least one atlas")
    first = datasets[0]
    if not dim.isidentifier() or dim in {*first.variables, *first.dims, POINT}:
        raise BadInput(f"dim = {shown(dim)}: must be a name of letters that these atlases do not use")
    coordinates = [key for key in first.coords if key not in first.xindexes]
    names = xr.Variable(dim, list(parts))
    joined = xr.concat(datasets, names, "all", coordinates, compat="override", join="override")
    own = {dim: {name: ds.attrs for name, ds in zip(parts, datasets, strict=True)}}
    joined.attrs = {key: first.attrs[key] for key in COMMON if key in first.attrs}
    joined.attrs[PARTS] = json.dumps(own, default=lambda value: getattr(value, "tolist", value.__str__)())
    return without_fill_values(joined)


def _difference(first: xr.Dataset, ds: xr.Dataset) -> str:
    """Return the reason why two atlases cannot be joined, or an empty text if they can be joined."""
    for key in COMMON:
        if (values := [each.attrs.get(key) for each in (first, ds)])[0] != values[1]:
            return f"{key} is {' and '.join(map(shown, values))}"
    if names := (first.sizes.keys() ^ ds.sizes.keys()) | (first.variables.keys() ^ ds.variables.keys()):
        return f"only one of them has {', '.join(sorted(map(str, names)))}"
    for dim in first.dims:
        if not first[dim].variable.equals(ds[dim].variable):
            return f"{dim} has other values"
    for name, variable in first.variables.items():
        attributes = [xr.Variable((), 0, each.attrs) for each in (variable, ds.variables[name])]
        if not attributes[0].identical(attributes[1]):
            return f"{name} has other attributes, such as units or flags"
    return ""


def part_of(ds: xr.Dataset, *, needed: bool = False) -> xr.Dataset:
    """Return a part of joined atlases with the part's attributes, and any other dataset unchanged. If `needed`, refuse joined atlases."""
    if PARTS not in ds.attrs:
        return ds
    try:
        ((dim, parts),) = json.loads(ds.attrs[PARTS]).items()
        names = ", ".join(parts)
        if dim in ds.coords and not ds[dim].ndim:
            part = ds.drop_vars(dim)
            part.attrs = {k: v for k, v in ds.attrs.items() if k != PARTS} | parts[str(ds[dim].values)]
            part.set_close(ds.close)
            return part
    except (AttributeError, KeyError, TypeError, ValueError):
        raise BadInput(f"damaged: the attribute {PARTS} does not name this part of joined atlases") from None
    if needed:
        raise BadInput(
            f"{dim}: joined atlases ({names}) have a scene each; choose one by .sel({dim}=NAME) first"
        )
    return ds


def subject_of(ds: xr.Dataset) -> xr.Dataset:
    """Return `ds`, prepared for `ds.atlas`. A part of joined atlases gets its own attributes. Listed points get the dimension "point"."""
    ds = part_of(ds)
    dims = [dim for dim in ds.dims if dim not in ds.coords or ds[dim].dtype.kind not in "iuf"]
    if len(dims) == len(ds.dims) == 1 and {*dims, *ds.variables, *ds.attrs}.isdisjoint({POINT, PARTS}):
        return ds.rename({dims[0]: POINT})  # a list of points whose dimension has another name
    return ds
