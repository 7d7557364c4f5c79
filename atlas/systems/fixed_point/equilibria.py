"""All permanent rotations of one gyrostat about the vertical."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..base import Array, Points
from .initial import bodies, length
from .stability import ROUNDING, amended_hessian, sleeping_stability, staude_stability


def permanent_rotations(
    points: Points, n: Array, towards: Array | None = None
) -> tuple[Array, NDArray[np.int8]]:
    """All permanent rotations w = n g about the vertical, the directions g of the vertical in the body.

    n: (points,), rad per time unit; 0 gives the positions of rest. towards: (3, points), chooses the
    member of a circle of solutions. Returns g of shape (3, 12, points), nan in empty places, and the
    dimension of the set each belongs to, int8 (12, points): 0 isolated, 1 a circle, 2 every direction
    (-1: empty). There are 2, 4 or 6 isolated ones unless some family is degenerate.

    g = -b / (d - L) with d = (n^2 - N) I, b = n l + Mg r_c, and L a root of the secular equation
    sum b_i^2 / (d_i - L)^2 = 1, which has one root outside each end pole and none or two between
    neighbours; a component with b_i = 0 also allows L = d_i with g_i free.
    """
    inertia, rotor, weight, N = bodies(points)
    d, b = (n**2 - N) * inertia, n * rotor + weight
    order = np.argsort(d, axis=0, kind="stable")
    d, b = np.take_along_axis(d, order, 0), np.take_along_axis(b, order, 0)
    aim = np.ones_like(d) if towards is None else np.take_along_axis(towards, order, 0)
    found = np.full((3, 12, *n.shape), np.nan)
    dimension = np.full((12, *n.shape), -1, np.int8)

    active = b != 0
    some = active.any(0)
    # A pole without residue is moved onto one that has it: the empty interval between them has no root.
    anchor = np.take_along_axis(d, active.argmax(0)[None], 0)
    poles = np.sort(np.where(active, d, anchor), axis=0)
    strength = np.abs(b)
    total = length(b)

    def secular(shift: Array, origin: Array, power: int = 2) -> Array:
        return (b**2 / (d - origin - shift) ** power).sum(0)

    def keep(place: int, shift: Array, origin: Array, there: Array) -> None:
        g = -b / (d - origin - shift)
        found[:, place] = np.where(there, g / length(g), np.nan)
        dimension[place] = np.where(there, 0, -1)

    def residue(origin: Array) -> Array:
        return np.where(d == origin, strength, 0.0).max(0)

    def root(near: Array, far: Array, origin: Array) -> Array:
        """Bisection in the logarithm of the distance from the pole: near is inside |g| > 1, far outside."""
        side = np.sign(far)
        near, far = np.abs(near), np.abs(far)
        for _ in range(64):
            middle = np.sqrt(near) * np.sqrt(far)
            inside = secular(side * middle, origin) > 1
            near, far = np.where(inside, middle, near), np.where(inside, far, middle)
        return side * far

    with np.errstate(all="ignore"):
        for place, end, side in ((0, 0, -1.0), (1, 2, 1.0)):
            origin = poles[end]
            keep(place, root(side * residue(origin), side * total, origin), origin, some)
        for place, left in ((2, 0), (4, 1)):
            low, high = poles[left], poles[left + 1]
            width = high - low
            near, far = np.zeros_like(width), width
            for _ in range(60):
                middle = 0.5 * (near + far)
                rising = secular(middle, low, 3) > 0
                near, far = np.where(rising, near, middle), np.where(rising, middle, far)
            there = some & (width > 0) & (secular(near, low) < 1)
            keep(place, root(residue(low), near, low), low, there)
            keep(place + 1, root(-residue(high), near - width, high), high, there)
        for i in range(3):
            group = d == d[i]
            free = ~(group & active).any(0) & (group.argmax(0) == i)
            g = np.where(group, 0.0, -b / (d - d[i]))
            rest = 1 - (g**2).sum(0)
            size = group.sum(0)
            inside = np.where(group, aim, 0.0)
            inside = np.where(length(inside) > 0, inside, group)
            inside = inside / length(inside) * np.sqrt(rest)
            for place, side in ((6 + 2 * i, 1.0), (7 + 2 * i, -1.0)):
                there = free & (rest > 0) & ((size == 1) | (side > 0))
                found[:, place] = np.where(there, g + side * inside, np.nan)
                dimension[place] = np.where(there, size - 1, -1)
    back = np.argsort(order, axis=0)
    return np.take_along_axis(found, np.broadcast_to(back[:, None], found.shape), 0), dimension


def equilibria(body: Points, n: float = 0.0) -> dict[str, np.ndarray]:
    """All permanent rotations of one body about the vertical at the rate n (0: positions of rest).

    body: every parameter, arrays of shape (1,). Returns arrays over the k solutions, the sets of
    solutions by one member each: theta, phi (rad), g1, g2, g3, dimension (0 isolated, 1 a circle,
    2 every direction), index (number of directions in which the amended potential falls; 0 is stable),
    stable and growth_rate; in the order of theta.
    """
    rate = np.full(1, float(n))
    found, dimension = permanent_rotations(body, rate)
    there = dimension[:, 0] >= 0
    g, dimension = found[:, there, 0], dimension[there, 0]
    order = np.lexsort([g[0], np.arctan2(np.hypot(g[0], g[1]), g[2])])
    g, dimension = g[:, order], dimension[order]
    theta, phi = np.arctan2(np.hypot(g[0], g[1]), g[2]), np.arctan2(g[0], g[1])
    count = theta.size
    many = {name: np.repeat(values, count) for name, values in body.items()}
    for name in ("p0", "q0", "r0", "gamma10", "gamma20", "gamma30"):
        many[name] = np.full(count, np.nan)
    many |= {"theta0": theta, "phi0": phi, "n": np.repeat(rate, count)}
    many |= {name: np.zeros(count) for name in ("m", "theta_dot0")}
    upright = np.hypot(g[0], g[1]) == 0
    stable, growth = staude_stability(many)
    standing = sleeping_stability(many)
    determinant, trace, size = amended_hessian(many, many["n"], g)
    falling = np.where(determinant < 0, 1, np.where(trace < 0, 2, 0))
    falling = np.where(np.abs(determinant) <= ROUNDING * size, np.where(trace < 0, 1, 0), falling)
    return {
        "theta": theta, "phi": phi, "g1": g[0], "g2": g[1], "g3": g[2],
        "dimension": dimension, "index": falling.astype(np.int8),
        "stable": np.where(upright, standing[0], stable).astype(np.int8),
        "growth_rate": np.where(upright, standing[1], growth),
    }  # fmt: skip
