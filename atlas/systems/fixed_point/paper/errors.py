"""Errors of the paper's solution (33), as printed and as true, against the full equations at points of an atlas."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from ...base import Array, DerivedVariable, Points
from . import published
from .fast_spin import FastSpin, dop853, fast_spin, first_order, rhs

SAMPLES = 201  # instants of a run at which the errors are taken
CHUNK = (
    512  # points integrated together: enough to share the overhead of a step, few enough for little memory
)

Solution = Callable[[FastSpin, Array], Array]


def errors(points: Points, duration: Array, solution: Solution) -> tuple[Array, Array]:
    """Largest errors of a solution of (1) over a run, each of shape (points,).

    The full equations are integrated from the initial value of the solution, with r0 and gamma0'' from the
    point, so that the error is that of the formula. DOP853 with a relative tolerance of 1e-13 takes about
    0.2 ms per point and turn; the points of a chunk share their steps, so that the digits of an error near
    1e-12 depend on the other points.

    Parameters
    ----------
    duration : array (points,)
        Time units.
    solution : callable
        (spin, tau) -> y, as `fast_spin.first_order`.

    Returns
    -------
    angle, rate : arrays (points,)
        Error of gamma, a unit vector (rad while small), and of p + i q relative to the largest |p + i q| of
        the run.

    Raises
    ------
    BadInput
        As `fast_spin.fast_spin`.
    """
    angle, rate = np.empty(duration.shape), np.empty(duration.shape)
    for first in range(0, duration.size, CHUNK):
        part = slice(first, first + CHUNK)
        spin = fast_spin({name: values[part] for name, values in points.items()})
        tau = np.linspace(0.0, 1.0, SAMPLES)[:, None] * (spin.r0 * duration[part])
        approximate = solution(spin, tau)
        exact = _full(spin, approximate[:, 0], tau[-1])
        angle[part] = (spin.gamma0 * np.sqrt(((approximate - exact)[3:] ** 2).sum(0))).max(0)
        size = np.hypot(exact[0], exact[1]).max(0)
        rate[part] = np.hypot(*(approximate - exact)[:2]).max(0) / size
    return angle, rate


def _full(spin: FastSpin, y0: Array, end: Array) -> Array:
    """y of the full equations (1) at SAMPLES instants up to tau = end, for many points: (6, SAMPLES, points)."""
    shape = y0.shape
    # p and q may be 1e3 or 1e-6: each point has its own level of rounding errors.
    size = np.ones(shape)
    size[:2] = np.abs(spin.forced) + np.abs(spin.eps * spin.chi1) * spin.M3

    def rate(_: float, y: Array) -> Array:
        return (end * rhs(spin, y.reshape(shape))).ravel()

    instants = np.linspace(0.0, 1.0, SAMPLES)
    solution = dop853(rate, (0.0, 1.0), y0.ravel(), atol=1e-14 * size.ravel(), t_eval=instants)
    return np.moveaxis(solution.y.reshape(*shape, SAMPLES), -1, 1)


def _error_variables(
    form: str, solution: Solution, check: Callable[[Points], object]
) -> list[DerivedVariable]:
    """Errors of the solution in one form, "true" or "printed", as variables of an atlas."""
    suffix = "" if form == "true" else f"_{form}"
    note = (
        "against the full equations from the formula's own start, with r0 and gamma0'' of the point; over the"
        " duration of the run"
    )
    return [
        DerivedVariable(
            f"first_order_error{suffix}", "rad", f"largest error of gamma in the first-order solution (33), {form}",
            lambda points, duration: errors(points, duration, solution)[0], note, check,
        ),
        DerivedVariable(
            f"first_order_rate_error{suffix}", "1",
            f"largest error of p + i q in the first-order solution (33), {form}, over its largest magnitude",
            lambda points, duration: errors(points, duration, solution)[1], note, check,
        ),
    ]  # fmt: skip


DERIVED = {
    variable.name: variable
    for variable in (
        *_error_variables("true", first_order, fast_spin),
        *_error_variables(
            "printed", published.first_order, lambda points: published.coefficients(fast_spin(points))
        ),
    )
}
