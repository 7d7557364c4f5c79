"""Find all critical points of a quadratic function on the unit sphere from the secular equation of the Lagrange multiplier."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..base import Array, Mask
from ..vectors import length, unit
from .body import Body

PLACES = 12  # largest number of critical directions of a body
NEARLY = np.int8(-2)  # mark of a direction near which two complex solutions almost coincide


class SecularEquation:
    """Equation sum b_i^2 / (d_i - L)^2 = 1 for L = origin + shift, where the origin is a pole d_i. Arrays are (3, points)."""

    def __init__(self, d: Array, b: Array):
        active = b != 0
        self.d, self.b = np.where(active, d, np.inf), b  # no pole where b_i = 0
        self.exists = active.any(0)
        # Where b_i = 0, another pole is repeated in place of d_i. The interval between the equal poles is empty and has no root.
        anchor = np.take_along_axis(d, active.argmax(0)[None], 0)
        self.poles = np.sort(np.where(active, d, anchor), axis=0)
        self.total = length(b)

    def sum(self, shift: Array, origin: Array, power: int = 2) -> Array:
        return np.asarray(self.b**2 / (self.d - origin - shift) ** power).sum(0)

    def direction(self, shift: Array, origin: Array) -> Array:
        return unit(-self.b / (self.d - origin - shift))

    def residue(self, origin: Array) -> Array:
        return np.where(self.d == origin, np.abs(self.b), 0.0).max(0)

    def root(self, near: Array, far: Array, origin: Array) -> Array:
        """Return the shift of a root from `origin` by bisection of log |shift|. The sum is above 1 at shift `near` and below 1 at `far`."""
        side = np.sign(far)
        near, far = np.abs(near), np.abs(far)
        for _ in range(64):
            middle = np.sqrt(near) * np.sqrt(far)
            inside = self.sum(side * middle, origin) > 1
            near, far = np.where(inside, middle, near), np.where(inside, far, middle)
        return side * far

    def minimum(self, low: Array, high: Array) -> Array:
        """Return the distance from the pole `low`, towards the pole `high`, at which the sum is least."""
        near, far = np.zeros_like(low), high - low
        for _ in range(60):
            middle = 0.5 * (near + far)
            rising = self.sum(middle, low, 3) > 0
            near, far = np.where(rising, near, middle), np.where(rising, middle, far)
        return near

    def write_directions(self, g: Array, dimension: NDArray[np.int8]) -> None:
        """Write a direction for each root into columns 0 to 5 of `g`. Write 0, -1 (no root) or NEARLY into these columns of `dimension`."""

        def write(column: int, shift: Array, origin: Array, exists: Mask) -> None:
            g[:, column] = self.direction(shift, origin)
            dimension[column] = np.where(exists, 0, -1)

        for column, end, side in ((0, 0, -1.0), (1, 2, 1.0)):
            origin = self.poles[end]
            shift = self.root(side * self.residue(origin), side * self.total, origin)
            write(column, shift, origin, self.exists)
        for column, left in ((2, 0), (4, 1)):
            low, high = self.poles[left], self.poles[left + 1]
            width, minimum = high - low, self.minimum(low, high)
            is_gap = self.exists & (width > 0)
            exists = is_gap & (self.sum(minimum, low) < 1)
            root = self.root(self.residue(low), minimum, low)
            write(column, np.where(exists, root, minimum), low, exists)
            dimension[column, is_gap & ~exists] = NEARLY
            write(column + 1, self.root(-self.residue(high), minimum - width, high), high, exists)


def directions(
    body: Body, towards: Array | None = None, nearly: bool = False
) -> tuple[Array, NDArray[np.int8]]:
    """Return all directions of the vertical in the body at which a body rests in the frame, if nothing acts along alpha.

    The result is described in `critical_directions`. A body about a fixed point has d = (n^2 - N) I and b = n l + Mg r_c.
    """
    d = (body.turn**2 - body.gamma.gradient) * body.inertia.T
    return critical_directions(d, body.turn * body.rotor.T - body.gamma.field.T, towards, nearly)


def critical_directions(
    d: Array, b: Array, towards: Array | None = None, nearly: bool = False
) -> tuple[Array, NDArray[np.int8]]:
    """Return the critical points g of g.(d g) / 2 + b.g on the unit sphere, where d is diagonal. Arrays are (3, points).

    They are g = -b / (d - L), where L is a root of the secular equation sum b_i^2 / (d_i - L)^2 = 1. The d_i with b_i != 0 are poles.
    One root lies below all poles, one above, and none or two between neighbouring poles. If b_i = 0, L may also be d_i, with g_i free.

    From a circle of solutions, the solution nearest to the direction `towards` is taken. The array g, (3, 12, points), is nan in unused
    columns. The second array, (12, points), is the dimension of the set of solutions around each g: 0 for an isolated solution, 1 for
    a circle, 2 for every direction, -1 for an unused column. If `nearly` is true, NEARLY marks g near two almost equal complex solutions.
    """
    order = np.argsort(d, axis=0, kind="stable")
    d, b = np.take_along_axis(d, order, 0), np.take_along_axis(b, order, 0)
    towards = np.ones_like(d) if towards is None else np.take_along_axis(towards, order, 0)
    g, dimension = np.full((3, PLACES, *d.shape[1:]), np.nan), np.full((PLACES, *d.shape[1:]), -1, np.int8)
    with np.errstate(all="ignore"):
        SecularEquation(d, b).write_directions(g, dimension)
        for i in range(3):  # columns 6 to 11 of g are for L = d_i, where g_i is free
            group = d == d[i]
            free = ~(group & (b != 0)).any(0) & (group.argmax(0) == i)
            fixed = np.where(group, 0.0, -b / (d - d[i]))
            remainder = 1 - (fixed**2).sum(0)
            size = group.sum(0)
            inside = np.where(group, towards, 0.0)
            inside = unit(np.where(length(inside) > 0, inside, group)) * np.sqrt(remainder)
            for column, side in ((6 + 2 * i, 1.0), (7 + 2 * i, -1.0)):
                exists = free & (remainder > 0) & ((size == 1) | (side > 0))
                is_near = free & (remainder <= 0) & (size == 1) & (side > 0)
                g[:, column] = np.where(is_near, unit(fixed), fixed + side * inside)
                dimension[column] = np.where(exists, size - 1, np.where(is_near, NEARLY, -1))
    if not nearly:
        dimension[dimension == NEARLY] = -1
    g[:, dimension == -1] = np.nan
    inverse = np.argsort(order, axis=0)
    return np.take_along_axis(g, np.broadcast_to(inverse[:, None], g.shape), 0), dimension
