"""Build families of steady motions, closed forms of motions about two axes, and equations that can be solved for a parameter."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from functools import partial
from typing import Any

import numpy as np

from ..base import Array, Condition, Family, Points, TwoAxes, motion_about_axes, shape_of, shared
from ..jacobian import STEP
from ..vectors import across, dot, length, principal, ratio


@shared
def directions(points: Points) -> tuple[Array, Array]:
    """Return alpha and gamma in body axes at the start, each of shape (3, points), from theta0, psi0 and phi0."""
    st, ct = np.sin(points["theta0"]), np.cos(points["theta0"])
    sp, cp = np.sin(points["psi0"]), np.cos(points["psi0"])
    sf, cf = np.sin(points["phi0"]), np.cos(points["phi0"])
    alpha = np.array([cp * cf - ct * sf * sp, -cp * sf - ct * cf * sp, st * sp])
    return alpha, np.array([st * sf, st * cf, ct])


def angular_velocity(points: Points, rate: Array, gamma: Array) -> Array:
    """Return the angular velocity (3, points) with `rate` about the vertical, m about e3 and theta_dot0 about the node."""
    w = rate * gamma
    w[0] += points["theta_dot0"] * np.cos(points["phi0"])
    w[1] -= points["theta_dot0"] * np.sin(points["phi0"])
    w[2] += points["m"]
    return w


def about_third_axis(points: Points) -> TwoAxes:
    """Return the motion about e3 at the rate m and the vertical at the rate n, for starts given by angles and rates."""
    gamma = directions(points)[1]
    return TwoAxes(principal(np.full(gamma.shape[1:], 2)), points["m"], gamma, points["n"])


def about_axis(s: Array, w: Array, gamma: Array) -> TwoAxes:
    """Return the motion about a body axis `s` and the vertical. The two rates give the part of `w` in the plane of these axes."""
    normal = across(gamma, s)
    n = ratio(dot(w, normal), (normal**2).sum(0))
    return TwoAxes(s, dot(w - n * gamma, s), gamma, n)


# Several families have this stability_text.
NEUTRAL = "Stability, as Family.stability, of motions near which no distance grows faster than t."


class Start(ABC):
    """Body, fields and state at t = 0 of a motion about any axes. Vectors are in body axes, of shape (3, points)."""

    rotor: Array
    w: Array
    gamma: Array
    moment: Array  # moment of inertia that divides torques
    field_torque: Array  # largest torque of the fields
    turn: Array | float = 0.0  # rate of the frame about gamma

    @abstractmethod
    def __init__(self, points: Points): ...

    @abstractmethod
    def axes(self) -> TwoAxes:
        """Return the axes and rates of the motion."""

    @property
    def squared_rate(self) -> Array:
        """Largest of the squared rates of frame and body, and of the torques of fields and rotor divided by `moment`."""
        square = np.maximum((self.w**2).sum(0), np.square(self.turn))
        torque = np.maximum(self.field_torque, length(self.rotor) * np.sqrt(square))
        return np.maximum(square, torque / self.moment)

    def residual(self, torque: Array) -> Array:
        """Return the magnitude of a torque divided by `moment` and by `squared_rate`."""
        size = np.abs(torque) if torque.ndim < self.w.ndim else length(torque)
        return ratio(size / self.moment, self.squared_rate)

    def nutation(self) -> Array:
        """Return |w - (n + turn) gamma - m s| divided by the largest rate."""
        s, m, _, n = self.axes()
        rest = self.w - (n + self.turn) * self.gamma - m * s
        return ratio(length(rest), np.sqrt(self.squared_rate))


def family_about_axes(
    kind: type[Start],
    *,
    conditions: Iterable[tuple[str, Callable[[Any], Array]]],
    directions: Callable[[Points], tuple[Array, ...]],
    turn: Callable[[Points], Array] | None = None,
    **attributes: Any,
) -> Family:
    """Return a family. Axes and residuals are computed from a start, an object of the class `kind`.

    Each of the `conditions` has a text and a function of a start that returns the residual. The functions `directions` and `turn`
    are those of `motion_of`. Further `attributes` are passed to the family.
    """

    def of_points(function: Callable[[Any], Any], points: Points) -> Any:
        return function(kind(points))

    rows = tuple(Condition(text, partial(of_points, residual)) for text, residual in conditions)
    axes = partial(of_points, kind.axes)
    return Family(axes=axes, motion=motion_of(axes, directions, turn), conditions=rows, **attributes)


def motion_of(
    axes: Callable[[Points], TwoAxes],
    directions: Callable[[Points], tuple[Array, ...]],
    turn: Callable[[Points], Array] | None = None,
) -> Callable[[Points, Array], Array]:
    """Return the closed form for Family.motion, if the state consists of w and of directions fixed in the frame.

    The function `directions` returns the directions at the start, each (3, points), the vertical last. The function `turn`
    returns the rate of the frame about the vertical.
    """

    def motion(points: Points, t: Array) -> Array:
        two, vectors = axes(points), directions(points)
        times = np.reshape(np.asarray(t, float), (*np.shape(t), *(1,) * (vectors[0].ndim - 1)))
        rate = np.empty(0)
        moved = []
        for vector in vectors:
            rate, turned = motion_about_axes(two, vector, times)
            moved.append(turned)
        return np.concatenate([rate if turn is None else rate + turn(points) * moved[-1], *moved])

    return motion


Solver = Callable[[Points], Array]


@dataclass(frozen=True, eq=False)
class Equation(Condition):
    """Condition function(points) = 0 for a scalar or vector function. The residual is the magnitude divided by `unit`."""

    residual: Callable[[Points], Array] = field(init=False)
    function: Callable[[Points], Array]
    unit: Callable[[Points], Array] | None = None  # None if `function` is dimensionless and of order 1
    # `function` divided by a factor that may vanish. The method `solve` uses this quotient instead of `function`.
    form: Callable[[Points], Array] | None = None

    def __post_init__(self) -> None:
        def residual(points: Points) -> Array:
            value = self.function(points)
            if value.ndim > len(shape_of(points)):
                value = np.hypot(*value) if len(value) == 2 else length(value)
            return value if self.unit is None else relative_to(value, shared(self.unit)(points))

        object.__setattr__(self, "residual", residual)

    def solve(self, *names: str) -> Mapping[str, Solver]:
        """Return a solver for each of the parameters `names`. The equation must be linear in each of these parameters."""
        return linear(self.form or self.function, *names)


def linear(function: Callable[[Points], Array], *names: str, keep: bool = False) -> Mapping[str, Solver]:
    """Return a solver of function(points) = 0 for each of the parameters `names`. `function` must be linear in each of these parameters.

    Where every value solves the equation, the parameter keeps the given value if `keep` is true, and else becomes nan.
    """
    return each(partial(_solve, function, keep), *names)


def _solve(function: Callable[[Points], Array], keep: bool, name: str, points: Points) -> Array:
    """Return the root of a linear equation by least squares over the components. A complex step gives the slope."""
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
    """Return a solver for each of the parameters `names`. The argument `solver` is a function of name and points."""
    return {name: partial(solver, name) for name in names}


def nearest_root(roots: Array, near: Array) -> Array:
    """Return the root nearest to `near`, else nan. If `near` is inf, return the root farthest from 0, or nan if fewer than two exist."""
    finite = np.isfinite(roots)
    distance = np.where(np.isinf(near), -np.abs(roots), np.abs(roots - near))
    nearest = np.take_along_axis(roots, np.where(finite, distance, np.inf).argmin(0)[None], 0)[0]
    return np.where(finite.sum(0) > np.isinf(near), nearest, np.nan)


def relative_to(value: Array, scale: Array) -> Array:
    """Return value / scale, which is 0 where `value` is 0 and nan where only `scale` is 0."""
    return ratio(value, scale, np.where(value == 0, 0.0, np.nan))
