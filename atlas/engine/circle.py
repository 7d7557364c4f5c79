"""The angular velocity in the body: is it constant, or does it turn on a circle, as in a regular precession about any axis?

A body that turns at the rate m about an axis s at rest in it, while s turns at the rate n about an axis z at rest in the
frame, has the angular velocity u = n z + m s. In the body z turns about s at the rate -m, so that u moves on a circle
about s at constant speed: u' = -m s x u. The converse holds as well. From the radius of the circle, n sin(nutation), the
height of its plane, u . s = m + n cos(nutation), and the speed follow m, n and the nutation, the angle of s and z.

Sums over the nodes give the plane through the angular velocities that fits best, and how far they are from a circle in
it. So that no digits cancel, the sums are about the start, and along axes of which the third is the one about which the
angular velocity turns at the start: on a circle all components along it vanish but for rounding errors. These axes do
not change the result otherwise. The functions of lanes are plain arithmetic that the kernel calls, compiled or not.
"""

from __future__ import annotations

from enum import IntEnum, auto
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from types import ModuleType

    from numpy.typing import NDArray

    Array = NDArray[np.float64]

# Time between the motions whose differences are the derivatives at the start, over the period of the fastest frequency
# / (2 pi). On a circle the error of the second one lies in its plane.
DIFFERENCE_TIME = 1e-2
# Sweeps of Jacobi's method for the axes of a 3 x 3 matrix; it converges quadratically.
SWEEPS = 6


class _Counted(IntEnum):
    """Numbers from 0."""

    @staticmethod
    def _generate_next_value_(name: str, start: int, count: int, last_values: list[int]) -> int:
        return count


class Axis(_Counted):
    """Constants of a point in one frame: axes x, y, z in the body, and the motion at the start."""

    FRAME_RATE = auto()  # the angular velocity is u + FRAME_RATE g
    X1 = auto()
    X2 = auto()
    X3 = auto()
    Y1 = auto()
    Y2 = auto()
    Y3 = auto()
    Z1 = auto()
    Z2 = auto()
    Z3 = auto()
    START_X = auto()  # the angular velocity along x, y and z
    START_Y = auto()
    START_Z = auto()
    START_SPEED_SQUARED = auto()  # square of its derivative
    SLOPE_X = auto()  # its derivative
    SLOPE_Y = auto()
    SLOPE_Z = auto()
    VERTICAL_X = auto()  # the vertical of the frame
    VERTICAL_Y = auto()
    VERTICAL_Z = auto()


class Sum(_Counted):
    """Sums over the nodes, those at both ends counting half.

    Of the change x, y, z of the angular velocity since the start and its products, of the change l of the square of its
    length, and of the change s of the square of its speed.
    """

    X = auto()
    Y = auto()
    Z = auto()
    XX = auto()
    XY = auto()
    YY = auto()
    XZ = auto()
    YZ = auto()
    ZZ = auto()
    L = auto()
    LL = auto()
    LX = auto()
    LY = auto()
    LZ = auto()
    S = auto()
    SS = auto()


def load_circles(points, block, begins, axes, sums, constants0, first_axis, out, first_sum):
    """Bring the axes of a block's points into its lanes, and their sums, or zeros where the runs begin."""
    for l in range(axes.shape[1]):
        p = points[block, l]
        for row in range(axes.shape[0]):
            axes[row, l] = constants0[first_axis + row, p]
        for row in range(sums.shape[0]):
            sums[row, l] = 0.0 if begins else out[first_sum + row, p]


def add_to_circles(axes, sums, nodes, slot, inverse_unit, weight):
    """Add a node to the sums of all frames."""
    for frame in range(axes.shape[0] // len(Axis)):
        for l in range(axes.shape[1]):
            add_to_circle(
                axes, frame * len(Axis), sums, frame * len(Sum), l, nodes, slot, inverse_unit[l], weight
            )


def add_to_circle(axes, a, sums, s, l, nodes, slot, inverse_unit, weight):
    """Add a node to the sums of lane l in the frame whose axes begin at row a, and its sums at row s."""
    rate = axes[a + Axis.FRAME_RATE, l]
    u1 = nodes[slot, 0, l] + rate * nodes[slot, 3, l]
    u2 = nodes[slot, 1, l] + rate * nodes[slot, 4, l]
    u3 = nodes[slot, 2, l] + rate * nodes[slot, 5, l]
    d1 = (nodes[slot, 6, l] + rate * nodes[slot, 9, l]) * inverse_unit
    d2 = (nodes[slot, 7, l] + rate * nodes[slot, 10, l]) * inverse_unit
    d3 = (nodes[slot, 8, l] + rate * nodes[slot, 11, l]) * inverse_unit
    x0, y0, z0 = axes[a + Axis.START_X, l], axes[a + Axis.START_Y, l], axes[a + Axis.START_Z, l]
    x = axes[a + Axis.X1, l] * u1 + axes[a + Axis.X2, l] * u2 + axes[a + Axis.X3, l] * u3 - x0
    y = axes[a + Axis.Y1, l] * u1 + axes[a + Axis.Y2, l] * u2 + axes[a + Axis.Y3, l] * u3 - y0
    z = axes[a + Axis.Z1, l] * u1 + axes[a + Axis.Z2, l] * u2 + axes[a + Axis.Z3, l] * u3 - z0
    length = x * (x + 2.0 * x0) + y * (y + 2.0 * y0) + z * (z + 2.0 * z0)
    speed = d1 * d1 + d2 * d2 + d3 * d3 - axes[a + Axis.START_SPEED_SQUARED, l]
    sums[s + Sum.X, l] += weight * x
    sums[s + Sum.Y, l] += weight * y
    sums[s + Sum.Z, l] += weight * z
    sums[s + Sum.XX, l] += weight * x * x
    sums[s + Sum.XY, l] += weight * x * y
    sums[s + Sum.YY, l] += weight * y * y
    sums[s + Sum.XZ, l] += weight * x * z
    sums[s + Sum.YZ, l] += weight * y * z
    sums[s + Sum.ZZ, l] += weight * z * z
    sums[s + Sum.L, l] += weight * length
    sums[s + Sum.LL, l] += weight * length * length
    sums[s + Sum.LX, l] += weight * length * x
    sums[s + Sum.LY, l] += weight * length * y
    sums[s + Sum.LZ, l] += weight * length * z
    sums[s + Sum.S, l] += weight * speed
    sums[s + Sum.SS, l] += weight * speed * speed


def store_circles(points, block, sums, out, first_sum):
    """Write the sums of a block's points behind those of `statistics`."""
    for l in range(sums.shape[1]):
        for row in range(sums.shape[0]):
            out[first_sum + row, points[block, l]] = sums[row, l]


def circle_axes(
    equations: ModuleType, state: Array, constants: Array, frame_rates: Array, bound: Array
) -> Array:
    """Rows of `Axis` of points for each frame.

    equations: of a system; see `systems.base.System.equations`. state, constants: at the start; frame_rates:
    the angular velocity of each frame is that of the system's frame plus this times the vertical, rad per
    time unit, (frames, points); bound: bound of the fastest frequency, rad per time unit. Returns (frames *
    len(Axis), points).
    """
    with np.errstate(all="ignore"):
        h = DIFFERENCE_TIME / np.where((bound > 0) & np.isfinite(bound), bound, 1.0)
        slope = np.array(equations.rhs(state, constants))
        after, before = (np.array(equations.rhs(state + t * slope, constants)) for t in (h, -h))
        curvature = 0.5 * h * (after - before)  # h^2 times the second derivative
        later, now, earlier = (
            np.array(equations.frame_motion(state + sign * h * slope + sign**2 * 0.5 * curvature, constants))
            for sign in (1.0, 0.0, -1.0)
        )
        motions = now, (later - earlier) / (2.0 * h), (later - 2.0 * now + earlier) / h**2
        return np.concatenate([_axes_in_frame(rate, *motions) for rate in frame_rates])


def _axes_in_frame(rate: Array, motion: Array, slope: Array, second: Array) -> Array:
    """Rows of `Axis` from the motion at the start and its derivatives, each of shape (6, points)."""
    u, du, ddu = (each[:3] + rate * each[3:] for each in (motion, slope, second))
    du = np.where(np.isfinite(du), du, 0.0)  # where it overflows, the run is not resolved
    # u' = u x m s and u'' = u' x m s give u'' x u' = |u'|^2 m s.
    x, y, z = _right_handed(_cross(ddu, du))
    along = [np.array([_dot(axis, vector) for axis in (x, y, z)]) for vector in (u, du, motion[3:])]
    return np.concatenate([[rate], x, y, z, along[0], [_dot(du, du)], along[1], along[2]])


def _right_handed(direction: Array) -> tuple[Array, Array, Array]:
    """Three unit vectors of which the third has this direction, (3, points) each; any where there is none."""
    size = np.sqrt(_dot(direction, direction))
    exists = np.isfinite(size) & (size > 0)
    z = np.where(exists, direction / size, np.array([[0.0], [0.0], [1.0]]))
    x = _cross(np.eye(3)[np.argmin(np.abs(z), axis=0)].T, z)
    x = x / np.sqrt(_dot(x, x))
    return x, _cross(z, x), z


def circle_statistics(sums: Array, axes: Array, weight: NDArray[np.int64]) -> dict[str, Array]:
    """How far the angular velocities of runs in one frame are from one circle, and which one.

    weight: of all nodes together. Returns in rad per time unit: `spread`, the standard deviation of the
    angular velocity; `height_std`, that of its component along the normal s of the plane that fits best;
    `radius`, root mean square of its distance from s, and `radius_std`; `spin`, rate about s of the motion
    that would follow it, `spin_std`; `height`, the mean component along s; `extent`, the standard deviation
    along the shorter axis in the plane; `rate_1`, `rate_2`, `rate_3`, the mean angular velocity in body axes.
    `spin_axis_1`, `spin_axis_2`, `spin_axis_3`: s in body axes, of either sign. In rad, at the start:
    `precession_inclination`, `rotation_inclination` and `tilt`, angles to the vertical of the axis of
    precession (by s and spin), of the angular velocity and of the third axis.
    """
    with np.errstate(all="ignore"):
        mean = sums / weight
        shift = mean[[Sum.X, Sum.Y, Sum.Z]]
        products = mean[[[Sum.XX, Sum.XY, Sum.XZ], [Sum.XY, Sum.YY, Sum.YZ], [Sum.XZ, Sum.YZ, Sum.ZZ]]]
        variances, directions = principal_axes(products - shift[:, None] * shift)
        start = axes[[Axis.START_X, Axis.START_Y, Axis.START_Z]]
        along = np.array([_dot(direction, start + shift) for direction in directions])
        s, height = directions[0], along[0]
        radius = np.sqrt(variances[1] + variances[2] + along[1] ** 2 + along[2] ** 2)
        with_length = mean[[Sum.LX, Sum.LY, Sum.LZ]] - mean[Sum.L] * shift
        of_length = mean[Sum.LL] - mean[Sum.L] ** 2
        of_distance = of_length - 4.0 * height * _dot(s, with_length) + 4.0 * height**2 * variances[0]
        speed = np.sqrt(mean[Sum.S] + axes[Axis.START_SPEED_SQUARED])
        speed_std = np.sqrt(np.maximum(mean[Sum.SS] - mean[Sum.S] ** 2, 0.0)) / (2.0 * speed)
        slope = axes[[Axis.SLOPE_X, Axis.SLOPE_Y, Axis.SLOPE_Z]]
        spin = np.copysign(speed / radius, -_dot(s, _cross(start, slope)))
        vertical = axes[[Axis.VERTICAL_X, Axis.VERTICAL_Y, Axis.VERTICAL_Z]]
        result = {
            "spread": np.sqrt(np.maximum(variances.sum(0), 0.0)),
            "height_std": np.sqrt(np.maximum(variances[0], 0.0)),
            "radius": radius,
            "radius_std": np.sqrt(np.maximum(of_distance, 0.0)) / (2.0 * radius),
            "spin": spin,
            "spin_std": speed_std / radius,
            "height": height,
            "extent": np.sqrt(np.maximum(variances[1], 0.0)),
            "precession_inclination": _angle(start - spin * s, vertical),
            "rotation_inclination": _angle(start, vertical),
        }
        in_body = axes[Axis.X1 : Axis.Z3 + 1].reshape(3, 3, -1)
        result["tilt"] = _angle(in_body[:, 2], vertical)
        for name, vector in (("rate", start + shift), ("spin_axis", s)):
            components = (vector[:, None] * in_body).sum(0)
            result |= {f"{name}_{i + 1}": component for i, component in enumerate(components)}
    return result


def principal_axes(matrix: Array) -> tuple[Array, Array]:
    """Eigenvalues of symmetric matrices, ascending, and unit eigenvectors, by Jacobi's method.

    Small eigenvalues of matrices that are nearly diagonal are accurate relative to themselves, unlike LAPACK's:
    J. Demmel and K. Veselic, SIAM J. Matrix Anal. Appl. 13 (1992) 1204-1245.

    matrix: (3, 3, points). Returns values, vectors, vectors[i] belongs to values[i].
    """
    a = matrix.copy()
    vectors = np.broadcast_to(np.eye(3)[:, :, None], a.shape).copy()
    for _ in range(SWEEPS):
        for p, q in ((0, 1), (0, 2), (1, 2)):
            with np.errstate(all="ignore"):  # of elements that are 0 already
                _rotate(a, vectors, p, q)
    values = np.array([a[0, 0], a[1, 1], a[2, 2]])
    order = np.argsort(values, axis=0, kind="stable")
    return np.take_along_axis(values, order, 0), np.take_along_axis(vectors, order[:, None], 0)


def _rotate(a: Array, vectors: Array, p: int, q: int) -> None:
    """Turn the axes p and q of symmetric matrices so that their element (p, q) vanishes."""
    r = 3 - p - q
    ratio = (a[q, q] - a[p, p]) / (2.0 * a[p, q])
    tangent = np.copysign(1.0, ratio) / (np.abs(ratio) + np.sqrt(1.0 + ratio * ratio))
    tangent = np.where(a[p, q] == 0.0, 0.0, tangent)
    cosine = 1.0 / np.sqrt(1.0 + tangent * tangent)
    sine = tangent * cosine
    a[p, p], a[q, q] = a[p, p] - tangent * a[p, q], a[q, q] + tangent * a[p, q]
    a[p, q] = a[q, p] = 0.0
    a[r, p], a[r, q] = cosine * a[r, p] - sine * a[r, q], sine * a[r, p] + cosine * a[r, q]
    a[p, r], a[q, r] = a[r, p], a[r, q]
    vectors[p], vectors[q] = cosine * vectors[p] - sine * vectors[q], sine * vectors[p] + cosine * vectors[q]


def _dot(a: Array, b: Array) -> Array:
    """Scalar products of vectors, (3, points) each."""
    return np.asarray(a[0] * b[0] + a[1] * b[1] + a[2] * b[2])


def _cross(a: Array, b: Array) -> Array:
    """Vector products of vectors, (3, points) each."""
    return np.array([a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]])


def _angle(a: Array, b: Array) -> Array:
    """Angles of vectors, rad."""
    perpendicular = _cross(a, b)
    return np.asarray(np.arctan2(np.sqrt(_dot(perpendicular, perpendicular)), _dot(a, b)))
