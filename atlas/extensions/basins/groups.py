"""Ends of the motions of any system. Motions have the same end if their statistics agree after a transient."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
import pandas as pd
import xarray as xr
from numpy.typing import NDArray

from ...analysis.metadata import POSITIONS, has_flags
from ...errors import BadInput, allowed_text, shown
from ...flags import Status
from ...scene.checks import positive, texts
from ...store.dataset import TRANSIENT, log_warnings
from ...systems.base import Array

CELLS = 4  # number of cells in one tolerance along each feature; one motion of a cell stands for all motions in the cell


def ends(ds: xr.Dataset, features: str | Sequence[str], tolerance: float | Mapping[str, float]) -> xr.Dataset:
    """Ends of motions of any system after a transient: equilibria, cycles, locked rotations.

    Parameters
    ----------
    ds : Dataset
        An atlas with a transient. `ds.atlas.ends` passes its dataset.
    features : str or sequence of str
        Measured variables that tell the ends apart. Extremes do not depend on the phase of a cycle, but means do.
    tolerance : float or mapping of str to float
        Largest difference of motions with the same end, for every feature or by name.

    Returns
    -------
    Dataset
        `end`, int16, over the dimensions of the atlas, is the position of the end along the dimension `which`. The value is -1 where
        the status is not ok or no other motion has the same end. Two motions have the same end if they differ by at most the tolerance,
        or if a chain of motions with such differences joins them. The comparison is accurate to a quarter of the tolerance. The ends
        along `which`, sorted by the first feature, have the number `count` of motions, the median of each feature, and `spread`. The
        spread is the largest difference divided by the tolerance. A warning names chains, whose spread is above 1.

    Raises
    ------
    BadInput
        For an atlas without transient, for other features and for tolerances that are not positive.
    """
    names = list(dict.fromkeys(texts("features", features)))
    if TRANSIENT not in ds.attrs or "status" not in ds:
        raise BadInput(
            "ends: no atlas with a transient; set [labels] transient, or label_points(transient=...)"
        )
    status = ds["status"]
    alike = {str(name): v for name, v in ds.items() if v.dims == status.dims and not has_flags(v)}
    numbers = [name for name, v in alike.items() if v.dtype.kind == "f"]
    for name in names or [""]:
        if name not in numbers:
            raise BadInput(
                f"features: {shown(name)} is no number measured here; {allowed_text(name, numbers)}"
            )
    limits = tolerance if isinstance(tolerance, Mapping) else dict.fromkeys(names, tolerance)
    for name in {*names} ^ {*limits}:
        raise BadInput(f"tolerance: {shown(name)}: must name the features {', '.join(names)}")
    sizes = np.array([positive(f"tolerance of {name}", limits[name]) for name in names])
    table = pd.DataFrame({name: ds[name].values.ravel() for name in names})
    table = table[(status.values.ravel() == Status.OK) & np.isfinite(table).all(axis=1)]
    motions = table.groupby(group := groups(table.to_numpy() / sizes))
    count, median, width = motions.size(), motions.median(), motions.max() - motions.min()
    listed = median[count > 1].sort_values(names).index[: 2**15].to_numpy()
    place, end = np.full(count.size, -1), np.full(status.size, -1, np.int16)
    place[listed] = np.arange(listed.size)
    end[table.index] = place[group]
    spread = (width.loc[listed] / sizes).max(axis=1).to_numpy()
    if (chains := np.flatnonzero(spread > 1)).size:
        log_warnings(
            [f"ends: motions differ by more than the tolerance in the chains {', '.join(map(str, chains))}"]
        )
    rows = {
        "count": (count[listed], "number of motions"),
        "spread": (spread, "largest difference within the end over the tolerance, above 1 of a chain"),
    }
    result = xr.Dataset(
        {name: ("which", v, {"long_name": text, "units": "1"}) for name, (v, text) in rows.items()}
    )
    result = result.assign({name: ("which", median.loc[listed, name], ds[name].attrs) for name in names})
    attributes = {"long_name": "end of the motion", "units": "1", POSITIONS: "none end"}
    result["end"] = status.dims, end.reshape(status.shape), attributes
    return result.assign_coords({**ds.coords, "which": np.arange(listed.size)}).assign_attrs(ds.attrs)


def groups(values: Array) -> NDArray[np.int64]:
    """Return the group number of each row. A group is a chain of rows, each within 1 of another in every column, to about 1 / CELLS."""
    from scipy.sparse import coo_matrix
    from scipy.sparse.csgraph import connected_components
    from scipy.spatial import cKDTree

    _, first, cell = np.unique(np.floor(values * CELLS), axis=0, return_index=True, return_inverse=True)
    pairs = np.empty((0, 2), int)
    if first.size:
        pairs = cKDTree(values[first]).query_pairs(1.0, np.inf, output_type="ndarray")
    graph = coo_matrix((np.ones(len(pairs)), pairs.T), (first.size, first.size))
    return np.asarray(connected_components(graph)[1][cell], np.int64)
