"""Fractions of starts whose motions end in each equilibrium."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import xarray as xr

from ...analysis.metadata import flag_names, flag_variable
from ...analysis.trust import probability
from ...errors import BadInput
from ...flags import SettledBy
from .ends import END, NO_END


def basin_fractions(
    ds: xr.Dataset, over: str | Sequence[str] | None = None, variable: str = END
) -> xr.Dataset:
    """Fractions of starts that end in each equilibrium (`end_equilibrium` of an atlas) or in each end (of `ends`).

    Parameters
    ----------
    ds : Dataset
        The atlas. `ds.atlas.basin_fractions` passes its dataset.
    over : str or sequence of str, optional
        The axes along which the starts vary, by default all axes. The axis of an atlas of listed points is "point".
    variable : str
        "end_equilibrium", or "end" of the result of `ends`.

    Returns
    -------
    Dataset
        `fraction`, with the limits `lower` and `upper` as in `probability`. The dimensions are the axes that are not in `over`,
        and the variable. Along the variable, -1 means no end, and other values are positions in `atlas.equilibria` or along
        `which` of `ends`. For equilibria, `undecided` is the fraction of starts whose end may change if the start has an
        error as large as the tolerance. In atlases without this check `undecided` is nan.

    Raises
    ------
    BadInput
        For an atlas without the variable, or with `end_equilibrium` but without `settled_by`.
    """
    every = [str(dim) for dim in flag_variable(ds, variable).dims]
    if variable == END and "settled_by" not in ds:
        raise BadInput(
            "settled_by: not in this atlas, so that undecided ends are unknown; run its scene again: it is written with end_equilibrium"
        )
    result = probability(ds, variable, every if over is None else over).rename(probability="fraction")
    if variable == END:
        known = "undecided" in flag_names(ds["settled_by"])
        dims = [dim for dim in every if dim not in result.dims]
        undecided = (ds["settled_by"] == SettledBy.UNDECIDED).mean(dims).where(known)
        result["undecided"] = undecided.assign_attrs(
            long_name="fraction of starts with an undecided end", units="1"
        )
    positions = np.arange(result.sizes[variable]) + NO_END
    return result.assign_coords({variable: (variable, positions, ds[variable].attrs)})
