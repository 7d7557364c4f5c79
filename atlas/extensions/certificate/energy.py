"""Wells of an energy, which hold a motion near a minimum for all time.

In a frame that turns at the rate n about the vertical, J = u.I u / 2 + W is constant, or falls with damping in the frame, where
u is the angular velocity relative to it. So where W >= W* along the motion, u.I u <= 2 (J - W*). A symmetric satellite without
damping also keeps S = C w3 + k3, and the energy A u_perp^2 / 2 + W_S of its third axis. A size is the sum of the magnitudes of the
second derivatives' terms, to which rounding errors are relative.
"""

from __future__ import annotations

import numpy as np

from ...systems.base import Array
from ...systems.gyrostat.body import Body, length
from ...systems.vectors import cross, dot, principal, unit
from ...systems.vectors import length as norm
from ..equilibria.algebra import frames_of, rotated
from .bounds import ROUNDING, Bounds, reach, sine_range

_STEPS = 5  # of Newton's method; a minimum that is not found proves nothing
_FLAT = 1e-6  # share of the size below which Newton's method takes a gradient step
_EIGENVALUE, _GRADIENT = 1e-13, 1e-14  # rounding errors of second and first derivatives over the size


def in_space(body: Body, w: Array, gamma: Array) -> Bounds:
    """About a fixed point, near a rotation about the vertical; any n may be taken, and with damping only 0."""
    inertia, rotor, z = body.inertia.T, body.rotor.T, gamma.T
    momentum, n = dot(inertia * w.T + rotor, z), dot(inertia * w.T, z) / dot(inertia * z, z)
    for last in (False, False, True):
        n = np.where(body.damping > 0, 0.0, n)
        Q, c = (body.gamma.gradient - n**2) * inertia, body.gamma.field.T - n * rotor
        z = _minimum(Q, c, z)
        if not last:  # The n with which the minimum has the momentum of the start leaves the least energy.
            slope = 2 * n * inertia * z + rotor
            change = dot(inertia * z, z) + dot(slope, _solved(Q, c, z, slope))
            n = n + (momentum - dot(n * inertia * z + rotor, z)) / change
    square = _square(body.inertia, w, n[:, None] * gamma)
    size = (np.abs(body.gamma.gradient) + n**2) * inertia.max(0) + length(body.gamma.field)
    return _rigid(body, *_on_sphere(Q, c, gamma.T, z, square, size + np.abs(n) * norm(rotor)), n)


def symmetric(body: Body, w: Array, alpha: Array, gamma: Array) -> Bounds:
    """Of a symmetric body in a frame of two directions, by its third axis in that frame, with the S of the start."""
    (A, _, C), turn, w3, k3 = body.inertia.T, body.turn, w[:, 2], body.rotor[:, 2]
    start, zero = np.array([alpha[:, 2], np.cross(gamma, alpha)[:, 2], gamma[:, 2]]), np.zeros_like(turn)
    Q = np.array([body.alpha.gradient * (C - A), zero, turn**2 * A + body.gamma.gradient * (C - A)])
    c = np.array([body.alpha.field[:, 2], zero, body.gamma.field[:, 2] - turn * (C * w3 + k3)])
    square = _square(body.inertia[:, :2], w[:, :2], turn[:, None] * gamma[:, :2])
    size = np.abs(turn) * (np.abs(C * w3) + np.abs(k3)) + turn**2 * A
    size = size + sum(np.abs(d.gradient) * (A + C) + length(d.field) for d in (body.alpha, body.gamma))
    theta, angle, square = _on_sphere(Q, c, start, _minimum(Q, c, start), square, size)
    least, largest = sine = sine_range(theta, angle)
    theta_dot, cosine = np.sqrt(square / A), np.cos(theta)
    ends = np.cos(np.clip([theta - angle, theta + angle], 0.0, np.pi))
    phi_dot = np.abs(turn) * np.abs(ends - cosine).max(0) + np.abs(ends).max(0) * theta_dot / least
    sinking = largest**2 / (1 + np.sqrt(1 - largest**2))
    normal_rate = theta_dot * largest + np.abs(w3) * sinking + np.abs(turn) * largest**2
    return Bounds(sine, theta_dot, (zero, theta_dot / least), (w3 - turn * cosine, phi_dot), normal_rate)


def upright(body: Body, w: Array, alpha: Array, gamma: Array) -> Bounds:
    """With the third axis near the vertical, and rotor and fields along it: W - W* >= a x - b x^2 / 2, x = 1 - |cos(theta)|."""
    (radius, normal), inertia, sign = body.amended(), body.inertia, np.sign(gamma[:, 2])
    least, third = inertia[:, :2].min(-1), inertia[:, 2]
    b = (normal.gradient[:, None] * (inertia[:, :2] - third[:, None])).min(-1)
    b = b + np.minimum(0.0, radius.gradient * (third - least))
    frames = frames_of(np.eye(3)[inertia[:, :2].argmin(-1)], sign[:, None] * np.eye(3)[2])
    energy, size = _excess(body, w, frames_of(alpha, gamma), frames)
    a = b - sign * normal.field[:, 2] - _EIGENVALUE * size
    across = [radius.field, normal.field[:, :2], body.rotor[:, :2]]
    known = (a > 0) & ~np.any([vector.any(-1) for vector in across], axis=0)
    x = (gamma[:, :2] ** 2).sum(-1) / (1 + np.abs(gamma[:, 2]))
    x = reach([energy, -a, b / 2], np.where(known, np.minimum(1.0, a / np.maximum(b, a)), np.nan), x)
    return _rigid(body, np.where(sign > 0, 0.0, np.pi), 2 * np.arcsin(np.sqrt(x / 2)), 2 * energy)


def attitude(body: Body, w: Array, alpha: Array, gamma: Array) -> Bounds:
    """Near any minimum of a frame of two directions: W - W* >= l d^2 / 2 - M d^3 / 6 - g d under a rotation by an angle d."""
    frames = start = frames_of(alpha, gamma)

    def slope() -> Array:
        radius, normal = (
            np.cross(d.gradient[:, None] * body.inertia * frames[:, i] + d.field, frames[:, i])
            for i, d in zip((0, 2), body.amended(), strict=True)
        )
        return radius + normal

    # A Hessian that can be inverted, also without torque.
    regular = (_GRADIENT * body.steepness() + np.finfo(float).tiny)[:, None, None] * np.eye(3)
    for _ in range(_STEPS):
        hessian = body.hessian(frames[:, 0], frames[:, 2]) + regular
        step = np.linalg.solve(hessian, -slope()[..., None])[..., 0]
        frames = rotated(frames, step / np.maximum(1.0, np.linalg.norm(step, axis=1))[:, None])
    energy, size = _excess(body, w, start, frames)
    g = length(slope()) + _GRADIENT * size
    least = np.linalg.eigvalsh(body.hessian(frames[:, 0], frames[:, 2]))[:, 0] - _EIGENVALUE * size
    third = (1 + 17**0.5 / 4) * np.ptp(body.inertia, axis=-1)  # derivative of v.I v / 2
    M = sum(third * np.abs(d.gradient) + length(d.field) for d in body.amended()) + _GRADIENT * size
    limit = np.minimum(np.pi, (least + np.sqrt(least**2 - 2 * M * g)) / M)
    distance = 2 * np.arcsin(np.sqrt(((frames - start) ** 2).sum((1, 2)) / 8))
    angle = reach([energy, g, -least / 2, M / 6], np.where(least > 0, limit, np.nan), distance)
    theta = np.arctan2(np.hypot(frames[:, 2, 0], frames[:, 2, 1]), frames[:, 2, 2])
    return _rigid(body, theta, angle, 2 * (energy + g**2 / least))


def _square(inertia: Array, w: Array, turn: Array) -> Array:
    """u.I u of u = w - turn, with the rounding errors of u."""
    return np.asarray((inertia * (np.abs(w - turn) + ROUNDING * (np.abs(w) + np.abs(turn))) ** 2).sum(-1))


def _excess(body: Body, w: Array, start: Array, frames: Array) -> tuple[Array, Array]:
    """J above W in other frames (points, 3, 3), with its rounding error, and the size."""
    energy = 0.5 * _square(body.inertia, w, body.turn[:, None] * start[:, 2])
    size = np.abs(body.turn) * length(body.rotor)
    for i, d in zip((0, 2), body.amended(), strict=True):
        middle, change = 0.5 * (start[:, i] + frames[:, i]), start[:, i] - frames[:, i]
        energy = energy + ((d.gradient[:, None] * body.inertia * middle + d.field) * change).sum(-1)
        size = size + np.abs(d.gradient) * body.inertia.max(-1) + length(d.field)
    return energy + ROUNDING * size, size


def _rigid(body: Body, theta: Array, angle: Array, square: Array, n: Array | float = 0.0) -> Bounds:
    """Bounds of a body within an angle of theta, with u.I u below a square in the frame that turns at the rate n."""
    least, largest = sine = sine_range(theta, angle)
    across, third = body.inertia[:, :2].min(-1), 1 / body.inertia[:, 2]
    theta_dot = np.sqrt(square / across)
    phi_dot = np.sqrt(square * (third + (1 / least**2 - 1) / across))
    normal_rate = np.sqrt(square * (third + largest**2 / across))
    return Bounds(sine, theta_dot, (n + 0 * theta, theta_dot / least), (0 * theta, phi_dot), normal_rate)


def _on_sphere(
    Q: Array, c: Array, start: Array, z: Array, square: Array, size: Array
) -> tuple[Array, Array, Array]:
    """Theta at a minimum z of W = z.Q z / 2 + c.z, |z| = 1, the angle that holds the motion, and the largest square of its rates.

    With Q z + c = L z, W(x) - W(z) = (x - z).(Q - L)(x - z) / 2 exactly. Where Q - L is positive the whole sphere is the well; else W
    is bounded from below by the distance r = |x - z|. square: of the rates at the start.
    """
    slope, offset, curved = Q * z + c, start - z, Q * z
    L, distance = dot(z, slope), norm(offset)
    g = norm(slope - L * z) + _GRADIENT * size
    energy = 0.5 * square + 0.5 * dot((Q - L) * offset, offset) + g * distance + ROUNDING * size
    least, lowest = (v - _EIGENVALUE * size for v in (_second(Q - L, *_across(z))[-1], (Q - L).min(0)))
    bend, height = norm(curved - dot(z, curved) * z), np.maximum(0.0, least - dot(z, curved) + L)
    limit = 2 * least / (1.5 * bend + np.sqrt(2.25 * bend**2 + 2 * height * least))
    limit = np.where(least > 0, np.minimum(2.0, limit), np.nan)
    r = reach([energy, g, -least / 2, bend / 2, height / 8], limit, distance)
    whole = np.where(lowest > 0, (g + np.sqrt(g**2 + 2 * lowest * energy)) / lowest, np.nan)
    square = 2 * (energy + g**2 / np.where(whole <= r, lowest, np.where(np.isnan(r), lowest, least)))
    return np.arctan2(np.hypot(z[0], z[1]), z[2]), 2 * np.arcsin(0.5 * np.fmin(r, whole)), square


def _minimum(Q: Array, c: Array, z: Array) -> Array:
    """A minimum of z.Q z / 2 + c.z on the sphere, where Newton's method finds one from z."""
    for _ in range(_STEPS):
        step = _solved(Q, c, z, Q * z + c)
        z = unit(z - step / np.maximum(1.0, norm(step)))
    return z


def _solved(Q: Array, c: Array, z: Array, vector: Array) -> Array:
    """The inverse of the Hessian on the sphere times a vector; of a gradient step where that is not positive."""
    axes = _across(z)
    (v1, v2), size = (dot(axis, vector) for axis in axes), np.abs(Q).max(0) + norm(c)
    a, b, d, least = _second(Q - dot(z, Q * z + c), *axes)
    convex = least > _FLAT * size
    a, b, d = np.where(convex, [a, b, d], [size, 0.0 * size, size])
    return ((d * v1 - b * v2) * axes[0] + (a * v2 - b * v1) * axes[1]) / (a * d - b**2)


def _across(z: Array) -> tuple[Array, Array]:
    """Two unit vectors that are normal to each other and to z, (3, points)."""
    first = unit(cross(z, principal(np.abs(z).argmin(0))))
    return first, cross(z, first)


def _second(M: Array, first: Array, second: Array) -> tuple[Array, Array, Array, Array]:
    """Entries of a diagonal matrix on two axes, and the smaller eigenvalue there."""
    a, b, d = dot(M * first, first), dot(M * first, second), dot(M * second, second)
    return a, b, d, 0.5 * (a + d) - np.hypot(0.5 * (a - d), b)
