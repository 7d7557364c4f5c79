"""Resonances and zeros of the normal form's determinant D, as lines on a map, except where the energy proves stability."""

from __future__ import annotations

import numpy as np
import xarray as xr

from ...analysis.boundary import RESONANCE_SAMPLES, borders, not_unstable, resonance_lines
from ...analysis.plane import Plane
from ...analysis.tracer import (
    TRISECTIONS,
    Lines,
    cached_lines,
    narrowed_lines,
    on_axes,
    values_at,
    without_poles,
)
from ...flags import NonlinearStability
from ...systems.base import Array

DETERMINANT_ZERO = "D = 0 of the normal form"
STYLE = {"color": "#e6007e", "linestyle": "-", "linewidth": 0.8}
_VERDICT, _DETERMINANT = "nonlinear_stability", "birkhoff_determinant"


def lines(plane: Plane, ds: xr.Dataset) -> Lines:
    """Return borders of motions and, on two axes, lines of nonlinear stability."""
    two_axes = len(plane.extent) == 2
    return borders(plane) | (
        cached_lines(lambda: nonlinear_lines(plane), plane, _VERDICT) if two_axes else {}
    )


def nonlinear_lines(plane: Plane) -> Lines:
    """Return resonances and, as DETERMINANT_ZERO, zeros of the normal form's determinant D, except where the energy proves stability."""
    axes, coordinates = plane.lattice(RESONANCE_SAMPLES)
    columns = plane.derived(coordinates, (_VERDICT, _DETERMINANT))
    shown = not_unstable(plane, coordinates) & (columns[_VERDICT] != NonlinearStability.ENERGY)

    def determinant(positions: Array) -> Array:
        """Return the determinant D of the normal form at positions, which are fractional indices of the lattice."""
        coordinates = dict(zip(plane.extent, values_at(positions, axes).T, strict=True))
        return plane.derived(coordinates, (_DETERMINANT,))[_DETERMINANT]

    values = on_axes(columns[_DETERMINANT], shown, axes)
    zeros, edges = narrowed_lines(values, 0.0, lambda positions: determinant(positions) > 0, TRISECTIONS)
    zeros = without_poles(lambda positions: np.abs(determinant(positions)), edges, zeros)
    result = resonance_lines(plane, axes, coordinates, shown)
    if zeros := [values_at(line, axes) for line in zeros if len(line) > 1]:
        result[DETERMINANT_ZERO] = zeros
    return result
