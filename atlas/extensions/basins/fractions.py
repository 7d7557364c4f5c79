"""Fractions of starts that end in each equilibrium."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import xarray as xr

from ...analysis.metadata import flag_variable
from ...analysis.trust import probability
from .ends import END, NO_END


def basin_fractions(ds: xr.Dataset, over: str | Sequence[str] | None = None) -> xr.Dataset:
    """Fractions of starts that end in each equilibrium, of an atlas that holds `end_equilibrium`.

    Parameters
    ----------
    ds : Dataset
        The atlas; of the method `ds.atlas.basin_fractions` its dataset.
    over : str or sequence of str, optional
        The axes of starts; default all. Points of a list lie along "point".

    Returns
    -------
    Dataset
        `fraction`, `lower` and `upper`, the limits of `probability`, over the other axes and `end_equilibrium`, whose
        coordinate is the positions in `atlas.equilibria` and first -1, not settled.
    """
    every = [str(dim) for dim in flag_variable(ds, END).dims]
    result = probability(ds, END, every if over is None else over).rename(probability="fraction")
    positions = np.arange(result.sizes[END]) + NO_END
    return result.assign_coords({END: (END, positions, ds[END].attrs)})
