"""Equations of families of steady motions: text, residual and the solutions for parameters in one object."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import partial
from typing import Any

import numpy as np

from ..base import Array, Condition, Points, shape_of
from ..jacobian import STEP
from ..vectors import length

Solver = Callable[[Points], Array]


@dataclass(frozen=True, eq=False)
class Equation(Condition):
    """function(points) = 0, a number or components of a vector for each point, (points,) or (components, points).

    The residual is its magnitude in units of `unit`; `solve` gives the parameters in which it is linear.
    """

    residual: Callable[[Points], Array] = field(init=False)
    function: Callable[[Points], Array]
    unit: Callable[[Points], Array] | None = None  # None: it is a pure number of order 1
    # The same equation divided by a factor that may vanish, from which it is solved.
    form: Callable[[Points], Array] | None = None

    def __post_init__(self) -> None:
        object.__setattr__(self, "residual", self._in_units)

    def _in_units(self, points: Points) -> Array:
        value = self.function(points)
        if value.ndim > len(shape_of(points)):
            value = np.hypot(*value) if len(value) == 2 else length(value)
        return value if self.unit is None else relative_to(value, self.unit(points))

    def solve(self, *names: str) -> dict[str, Solver]:
        """Solvers of the parameters of these names, in each of which the equation is linear."""
        return linear(self.form or self.function, *names)


def linear(function: Callable[[Points], Array], *names: str, keep: bool = False) -> dict[str, Solver]:
    """Solvers of function(points) = 0 for each of some parameters, in which it is linear.

    keep: whether a parameter that does not enter keeps its value where the equation holds; else it becomes nan.
    """
    return {name: partial(_solve, function, name, keep) for name in names}


def _solve(function: Callable[[Points], Array], name: str, keep: bool, points: Points) -> Array:
    """The root, by least squares over the components; the slope is that of a complex step, exact but for rounding."""
    zero = np.zeros_like(points[name])
    with np.errstate(all="ignore"):
        offset = np.asarray(function({**points, name: zero}))
        stepped: Any = {**points, name: zero + 1j * STEP}
        slope = np.imag(function(stepped)) / STEP
        if offset.ndim > zero.ndim:
            offset, slope = (slope * offset).sum(0), (slope**2).sum(0)
        held = np.where(offset == 0, points[name], np.nan) if keep else np.nan
        return np.where(slope == 0, held, -offset / slope)


def each(solver: Callable[[str, Points], Array], *names: str) -> Mapping[str, Solver]:
    """The solver of each of these parameters, of a function that takes its name."""
    return {name: partial(solver, name) for name in names}


def relative_to(value: Array, scale: Array) -> Array:
    """value / scale, 0 where value is 0, nan where only scale is."""
    safe = np.where(scale == 0, 1.0, scale)
    return np.where(value == 0, 0.0, np.where(scale == 0, np.nan, value / safe))


def quotient(value: Array, by: Array) -> Array:
    """value / by, nan where by is 0: nothing to solve for."""
    return np.where(by == 0, np.nan, value / np.where(by == 0, 1.0, by))
