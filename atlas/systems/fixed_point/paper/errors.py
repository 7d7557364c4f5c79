"""Errors of the paper's solution (33), as printed and as true, against the full equations at points of an atlas."""

from __future__ import annotations

from collections.abc import Callable, Collection

import numpy as np

from ....errors import BadInput
from ...base import Array, DerivedVariable, Mask, Points
from ..initial import VECTORS, frequency_bound
from . import published
from .fast_spin import FastSpin, dimensional, dop853, fast_spin, first_order, rhs

SAMPLES = 201  # instants of a run at which the errors are taken
CHUNK = (
    512  # points integrated together: enough to share the overhead of a step, few enough for little memory
)
# Longest run that is integrated, in radians of its fastest frequency: some seconds for a chunk.
MAX_RADIANS = 1000.0
# Evaluations of the equations for a chunk; more than twice what a run of MAX_RADIANS needs.
MAX_EVALUATIONS = 200_000

Solution = Callable[[FastSpin, Array], Array]


def _go_on() -> None:
    """No interruption."""


class _TooManyEvaluationsError(Exception):
    """Ends an integration that takes far more steps than the frequencies of its points explain."""


def errors(
    points: Points, duration: Array, solution: Solution, pause: Callable[[], None] = _go_on
) -> tuple[Array, Array]:
    """Largest errors of a solution of (1) over a run, each of shape (points,).

    The full equations are integrated from the initial value of the solution, with r0 and gamma0'' from the
    point, so that the error is that of the formula. DOP853 with a relative tolerance of 1e-13 takes about
    0.1 ms per point and turn; the points of a chunk share their steps, so that the digits of an error near
    1e-12 depend on the other points.

    Parameters
    ----------
    duration : array (points,)
        Time units.
    solution : callable
        (spin, tau) -> y, as `fast_spin.first_order`.
    pause : callable
        Called at every step; an exception that it raises ends the integration.

    Returns
    -------
    angle, rate : arrays (points,)
        Error of gamma, a unit vector (rad while small), and of p + i q relative to the largest |p + i q| of
        the run. nan where the run, from there or from the point's own start, is longer than MAX_RADIANS.

    Raises
    ------
    BadInput
        As `fast_spin.fast_spin`.
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
            raise _TooManyEvaluationsError
        pause()
        return (end * rhs(spin, y.reshape(shape))).ravel()

    instants = np.linspace(0.0, 1.0, SAMPLES)
    unknown = np.full((shape[0], SAMPLES, shape[1]), np.nan)
    try:
        solution = dop853(rate, (0.0, 1.0), y0.ravel(), atol=1e-14 * size.ravel(), t_eval=instants)
    except _TooManyEvaluationsError:
        return unknown
    if not solution.success:
        return unknown
    return np.moveaxis(solution.y.reshape(*shape, SAMPLES), -1, 1)


def _check_length(points: Points, duration: Array) -> None:
    """Raise BadInput for runs too long to be integrated to these errors."""
    length = radians(points, duration)
    too_long = ~(length <= MAX_RADIANS)
    if too_long.any():
        raise BadInput(
            f"the full equations are integrated for at most {MAX_RADIANS:g} rad of their fastest frequency, and"
            f" {too_long.sum()} of {too_long.size} points turn by up to {length.max():.3g}; shorten the duration"
        )


def _error_variables(
    form: str, solution: Solution, check: Callable[[Points], object]
) -> list[DerivedVariable]:
    """Errors of the solution in one form, "true" or "printed", as variables of an atlas."""
    suffix = "" if form == "true" else f"_{form}"
    note = (
        "against the full equations from the formula's own start, with r0 and gamma0'' of the point; over the"
        f" duration of the run; nan beyond {MAX_RADIANS:g} rad of the fastest frequency"
    )

    def check_points(points: Points, duration: Array) -> None:
        with np.errstate(all="ignore"):
            check(points)
        _check_length(points, duration)

    names = f"first_order_error{suffix}", f"first_order_rate_error{suffix}"

    def together(
        _: Collection[str], points: Points, duration: Array, pause: Callable[[], None]
    ) -> dict[str, Array]:
        return dict(zip(names, errors(points, duration, solution, pause), strict=True))

    return [
        DerivedVariable.of_group(
            together, names[0], "rad", f"largest error of gamma in the first-order solution (33), {form}", note,
            check=check_points,
        ),
        DerivedVariable.of_group(
            together, names[1], "1",
            f"largest error of p + i q in the first-order solution (33), {form}, over its largest magnitude", note,
            check=check_points,
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
