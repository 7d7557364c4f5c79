"""Errors of the paper's solution (33), as printed and as true, against the full equations at points of an atlas."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from ...errors import BadInput
from ...systems.base import Array, Mask, Points
from ...systems.fixed_point.first_order import MAX_RADIANS
from ...systems.fixed_point.initial import VECTORS, frequency_bound
from . import published
from .fast_spin import FastSpin, dimensional, dop853, fast_spin, first_order, rhs

SAMPLES = 201  # instants of a run at which the errors are taken
CHUNK = (
    512  # points integrated together: enough to share the overhead of a step, few enough for little memory
)
# Evaluations of the equations for a chunk; more than twice what a run of MAX_RADIANS needs.
MAX_EVALUATIONS = 200_000

Solution = Callable[[FastSpin, Array], Array]
SOLUTIONS: dict[str, Solution] = {"true": first_order, "printed": published.first_order}


def _go_on() -> None:
    """No interruption."""


class _TooManyEvaluations(Exception):
    """Ends an integration that takes far more steps than the frequencies of its points explain."""


def errors(
    points: Points, duration: Array, solution: Solution, pause: Callable[[], None] = _go_on
) -> tuple[Array, Array]:
    """Largest errors over a run of a solution (spin, tau) -> y of (1): of gamma, and of p + i q.

    gamma is a unit vector (rad while small), p + i q relative to the largest |p + i q| of the run; nan where
    the run is longer than MAX_RADIANS. The full equations are integrated from the initial value of the
    solution, with r0 and gamma0'' from the point, so that the error is due to the formula. DOP853 with a
    relative tolerance of 1e-13 takes about 0.1 ms per point and turn; the points of a chunk share their
    steps, so that the digits of an error near 1e-12 depend on the other points.
    """
    angle, rate = np.full(duration.shape, np.nan), np.full(duration.shape, np.nan)
    with np.errstate(all="ignore"):
        for first in range(0, duration.size, CHUNK):
            part = np.arange(first, min(first + CHUNK, duration.size))
            chunk = {name: values[part] for name, values in points.items()}
            part = part[_can_be_integrated(chunk, duration[part], solution)]
            if part.size:
                spin = fast_spin({name: values[part] for name, values in points.items()})
                angle[part], rate[part] = _errors_of_chunk(spin, duration[part], solution, pause)
    return angle, rate


def radians(points: Points, duration: Array) -> Array:
    """Bound of the fastest frequency times duration, (points,): what integrating a run costs."""
    with np.errstate(all="ignore"):
        return np.asarray(frequency_bound(points) * duration)


def _can_be_integrated(points: Points, duration: Array, solution: Solution) -> Mask:
    """Where the solution has a start, and the run from there, as from the point's own start, is short enough."""
    spin = fast_spin(points)
    state = dimensional(spin, solution(spin, np.zeros(duration.shape)))
    from_solution = {**points, **dict(zip(VECTORS, state, strict=True))}
    length = np.maximum(radians(points, duration), radians(from_solution, duration))
    return np.asarray(length <= MAX_RADIANS)


def _errors_of_chunk(
    spin: FastSpin, duration: Array, solution: Solution, pause: Callable[[], None]
) -> tuple[Array, Array]:
    """See `errors`; all nan where the points of the chunk cannot be integrated together."""
    tau = np.linspace(0.0, 1.0, SAMPLES)[:, None] * (spin.r0 * duration)
    approximate = solution(spin, tau)
    exact = _full(spin, approximate[:, 0], tau[-1], pause)
    angle = (spin.gamma0 * np.sqrt(((approximate - exact)[3:] ** 2).sum(0))).max(0)
    size = np.hypot(exact[0], exact[1]).max(0)
    return angle, np.hypot(*(approximate - exact)[:2]).max(0) / size


def _full(spin: FastSpin, y0: Array, end: Array, pause: Callable[[], None]) -> Array:
    """y of the full equations (1) at SAMPLES instants up to tau = end, for many points: (6, SAMPLES, points)."""
    shape = y0.shape
    # p and q may be 1e3 or 1e-6: each point has its own level of rounding errors.
    size = np.ones(shape)
    size[:2] = np.abs(spin.forced) + np.abs(spin.eps * spin.chi1) * spin.M3
    evaluations = 0

    def rate(_: float, y: Array) -> Array:
        nonlocal evaluations
        evaluations += 1
        if evaluations > MAX_EVALUATIONS:
            raise _TooManyEvaluations
        pause()
        return (end * rhs(spin, y.reshape(shape))).ravel()

    instants = np.linspace(0.0, 1.0, SAMPLES)
    unknown = np.full((shape[0], SAMPLES, shape[1]), np.nan)
    try:
        solution = dop853(rate, (0.0, 1.0), y0.ravel(), atol=1e-14 * size.ravel(), t_eval=instants)
    except _TooManyEvaluations:
        return unknown
    if not solution.success:
        return unknown
    return np.moveaxis(solution.y.reshape(*shape, SAMPLES), -1, 1)


def check(points: Points, duration: Array, form: str) -> None:
    """Raise BadInput for points without the solution in this form, and for runs too long to be integrated to its errors."""
    with np.errstate(all="ignore"):
        spin = fast_spin(points)
        if form == "printed":
            published.coefficients(spin)
    length = radians(points, duration)
    too_long = ~(length <= MAX_RADIANS)
    if too_long.any():
        raise BadInput(
            f"the full equations are integrated for at most {MAX_RADIANS:g} rad of their fastest frequency, and"
            f" {too_long.sum()} of {too_long.size} points turn by up to {length.max():.3g}; shorten the duration"
        )
