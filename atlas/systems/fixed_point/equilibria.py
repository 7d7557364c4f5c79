"""All permanent rotations of a gyrostat about the vertical, of one body or of many at once."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...flags import Completeness, Stability
from ..base import Array, Mask, Points, subset
from ..oscillations import FREQUENCIES
from ..vectors import length, unit
from .initial import VECTORS, bodies
from .oscillations import frequencies
from .stability import ROUNDING, amended_hessian, sleeping_stability, staude_stability

_PLACES = 12  # columns of permanent_rotations
_NEAR_BIFURCATION = 1e-9  # determinant of the amended potential's Hessian, relative to its terms


class _SecularEquation:
    """sum b_i^2 / (d_i - L)^2 = 1 for L, as origin + shift with the origin at a pole d_i; arrays (3, points)."""

    def __init__(self, d: Array, b: Array):
        self.d, self.b = d, b
        active = b != 0
        self.exists = active.any(0)
        # A pole without residue is moved onto one that has it: the empty interval between them has no root.
        anchor = np.take_along_axis(d, active.argmax(0)[None], 0)
        self.poles = np.sort(np.where(active, d, anchor), axis=0)
        self.total = length(b)

    def sum(self, shift: Array, origin: Array, power: int = 2) -> Array:
        return (self.b**2 / (self.d - origin - shift) ** power).sum(0)

    def direction(self, shift: Array, origin: Array) -> Array:
        return unit(-self.b / (self.d - origin - shift))

    def residue(self, origin: Array) -> Array:
        return np.where(self.d == origin, np.abs(self.b), 0.0).max(0)

    def root(self, near: Array, far: Array, origin: Array) -> Array:
        """Bisection in the logarithm of the distance from the pole: the sum is above 1 at near, below it at far."""
        side = np.sign(far)
        near, far = np.abs(near), np.abs(far)
        for _ in range(64):
            middle = np.sqrt(near) * np.sqrt(far)
            inside = self.sum(side * middle, origin) > 1
            near, far = np.where(inside, middle, near), np.where(inside, far, middle)
        return side * far

    def minimum(self, low: Array, high: Array) -> Array:
        """Distance from the pole low, towards the pole high, at which the sum is least."""
        near, far = np.zeros_like(low), high - low
        for _ in range(60):
            middle = 0.5 * (near + far)
            rising = self.sum(middle, low, 3) > 0
            near, far = np.where(rising, near, middle), np.where(rising, middle, far)
        return near


def permanent_rotations(
    points: Points, n: Array, towards: Array | None = None
) -> tuple[Array, NDArray[np.int8]]:
    """All permanent rotations w = n g about the vertical, the directions g of the vertical in the body.

    g = -b / (d - L) with d = (n^2 - N) I, b = n l + Mg r_c, and L a root of the secular equation
    sum b_i^2 / (d_i - L)^2 = 1, which has one root outside each end pole and none or two between
    neighbours; a component with b_i = 0 also allows L = d_i with g_i free.

    n: rate in rad per time unit; 0 gives the positions of rest. towards: direction that selects the member of
    a circle of solutions, (3, points). Returns g, directions, nan in unused columns. There are 2, 4 or 6
    isolated ones unless some family is degenerate, (3, 12, points); dimension, dimension of the set that each
    belongs to: 0 isolated, 1 a circle, 2 every direction, -1 unused, (12, points).
    """
    inertia, rotor, weight, N = bodies(points)
    d, b = (n**2 - N) * inertia, n * rotor + weight
    order = np.argsort(d, axis=0, kind="stable")
    d, b = np.take_along_axis(d, order, 0), np.take_along_axis(b, order, 0)
    towards = np.ones_like(d) if towards is None else np.take_along_axis(towards, order, 0)
    g, dimension = np.full((3, _PLACES, *n.shape), np.nan), np.full((_PLACES, *n.shape), -1, np.int8)
    with np.errstate(all="ignore"):
        _roots_of_secular_equation(_SecularEquation(d, b), g, dimension)
        _free_components(d, b, towards, g, dimension)
    inverse = np.argsort(order, axis=0)
    return np.take_along_axis(g, np.broadcast_to(inverse[:, None], g.shape), 0), dimension


def _roots_of_secular_equation(equation: _SecularEquation, g: Array, dimension: NDArray[np.int8]) -> None:
    """Write the directions of the roots into columns 0 to 5."""

    def write(column: int, shift: Array, origin: Array, exists: Mask) -> None:
        g[:, column] = np.where(exists, equation.direction(shift, origin), np.nan)
        dimension[column] = np.where(exists, 0, -1)

    for column, end, side in ((0, 0, -1.0), (1, 2, 1.0)):
        origin = equation.poles[end]
        shift = equation.root(side * equation.residue(origin), side * equation.total, origin)
        write(column, shift, origin, equation.exists)
    for column, left in ((2, 0), (4, 1)):
        low, high = equation.poles[left], equation.poles[left + 1]
        width, minimum = high - low, equation.minimum(low, high)
        exists = equation.exists & (width > 0) & (equation.sum(minimum, low) < 1)
        write(column, equation.root(equation.residue(low), minimum, low), low, exists)
        write(column + 1, equation.root(-equation.residue(high), minimum - width, high), high, exists)


def _free_components(d: Array, b: Array, towards: Array, g: Array, dimension: NDArray[np.int8]) -> None:
    """Write the solutions L = d_i, of which the components g_i are free, into columns 6 to 11."""
    for i in range(3):
        group = d == d[i]
        free = ~(group & (b != 0)).any(0) & (group.argmax(0) == i)
        fixed = np.where(group, 0.0, -b / (d - d[i]))
        remainder = 1 - (fixed**2).sum(0)
        size = group.sum(0)
        inside = np.where(group, towards, 0.0)
        inside = unit(np.where(length(inside) > 0, inside, group)) * np.sqrt(remainder)
        for column, side in ((6 + 2 * i, 1.0), (7 + 2 * i, -1.0)):
            exists = free & (remainder > 0) & ((size == 1) | (side > 0))
            g[:, column] = np.where(exists, fixed + side * inside, np.nan)
            dimension[column] = np.where(exists, size - 1, -1)


def equilibria(body: Points, n: float = 0.0) -> dict[str, np.ndarray]:
    """All permanent rotations of one body about the vertical at the rate n (0: positions of rest).

    body: every parameter, arrays of shape (1,); n: rate in rad per time unit. Returns a set of solutions is
    represented by one member. theta, phi (rad); g1, g2, g3; dimension (0 isolated, 1 a circle, 2 every
    direction); index (number of directions in which the amended potential decreases; 0 is stable); stable,
    growth_rate as System.linear_stability; frequency_1 to frequency_3, see oscillations.frequencies.
    """
    rate = np.full(1, float(n))
    directions, dimension = permanent_rotations(body, rate)
    used = dimension[:, 0] >= 0
    g, dimension = directions[:, used, 0], dimension[used, 0]
    order = np.lexsort([g[0], np.arctan2(np.hypot(g[0], g[1]), g[2])])
    g, dimension = g[:, order], dimension[order]
    members = {name: np.repeat(values, dimension.size) for name, values in body.items()}
    return {
        name: values for name, values in _described(members, g, dimension, float(n)).items() if name != "flat"
    }


def equilibria_of_bodies(points: Points) -> dict[str, NDArray[Any]]:
    """All permanent rotations of many bodies about the vertical, each at its rate n.

    points: every parameter, arrays of shape (bodies,). Returns the variables of `equilibria`, those of each
    body in the order of theta, with unused places at the end: nan, index and dimension -1, stable 0.
    completeness (bodies,) int8, values of flags.Completeness.
    """
    count = points["A"].size
    directions, dimensions = permanent_rotations(points, points["n"])
    column, body = np.nonzero(dimensions >= 0)
    g = directions[:, column, body]
    order = np.lexsort([g[0], np.arctan2(np.hypot(g[0], g[1]), g[2]), body])
    g, body, column = g[:, order], body[order], column[order]
    members = subset(points, body)
    described = _described(members, g, dimensions[column, body], points["n"][body])
    place = np.arange(body.size) - np.searchsorted(body, body)
    result: dict[str, NDArray[Any]] = {}
    unused = {"index": -1, "dimension": -1, "stable": Stability.UNKNOWN, "flat": False}
    for name, values in described.items():
        result[name] = np.full((count, _PLACES), unused.get(name, np.nan), values.dtype)
        result[name][body, place] = values
    near = (result.pop("flat") & (result["dimension"] == 0)).any(1)
    flags = np.where(near, Completeness.NEAR_BIFURCATION, Completeness.COMPLETE)
    flags = np.where((result["dimension"] > 0).any(1), Completeness.NOT_ISOLATED, flags)
    result["completeness"] = flags.astype(np.int8)
    return result


def _described(
    body: Points, g: Array, dimension: NDArray[np.int8], n: Array | float
) -> dict[str, NDArray[Any]]:
    """Angles, index and stability of rotations about g (3, E), each of the body in the same place of body.

    flat: where an eigenvalue of the amended potential's Hessian is zero but for _NEAR_BIFURCATION.
    """
    theta, phi = np.arctan2(np.hypot(g[0], g[1]), g[2]), np.arctan2(g[0], g[1])
    members = dict(body)
    for name in VECTORS:
        members[name] = np.full(theta.size, np.nan)
    members |= {"theta0": theta, "phi0": phi, "n": np.broadcast_to(n, theta.shape)}
    members |= {name: np.zeros(theta.size) for name in ("m", "theta_dot0")}
    upright = np.hypot(g[0], g[1]) == 0
    stable, growth = staude_stability(members)
    sleeping, sleeping_growth = sleeping_stability(members)
    determinant, trace, size = amended_hessian(members, members["n"], g)
    values = frequencies(members, np.ones(theta.size, np.int8)).T
    index = np.where(determinant < 0, 1, np.where(trace < 0, 2, 0))
    index = np.where(np.abs(determinant) <= ROUNDING * size, np.where(trace < 0, 1, 0), index)
    return {
        "theta": theta, "phi": phi, "g1": g[0], "g2": g[1], "g3": g[2],
        "dimension": dimension, "index": index.astype(np.int8),
        "stable": np.where(upright, sleeping, stable).astype(np.int8),
        "growth_rate": np.where(upright, sleeping_growth, growth),
        **dict(zip(FREQUENCIES, values, strict=True)),
        "flat": np.abs(determinant) <= _NEAR_BIFURCATION * size,
    }  # fmt: skip
