"""Wells of an energy, which hold a motion near a minimum for all time.

In a frame that turns at the rate n about the vertical, J = u.I u / 2 + W is constant, or falls with damping in the frame, where
u is the angular velocity relative to it. So where W >= W* along the motion, u.I u <= 2 (J - W*). A symmetric satellite without
damping also keeps S = C w3 + k3, and the energy A u_perp^2 / 2 + W_S of its third axis.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ...systems.base import Array
from ...systems.gyrostat.body import Body, length
from ...systems.gyrostat.equilibria import frames_of, rotated
from ...systems.vectors import cross, dot, principal, unit
from ...systems.vectors import length as norm
from .bounds import ROUNDING, Bounds, reach, sine_range

_STEPS = 5  # of Newton's method; a minimum that is not found proves nothing
_FLAT = 1e-6  # share of the largest second derivative below which Newton's method takes a gradient step
_EIGENVALUE, _GRADIENT = 1e-13, 1e-14  # rounding errors, relative to the largest second derivative


class Well(NamedTuple):
    """Limits of a motion in a well, arrays (points,)."""

    theta: Array  # at the minimum
    angle: Array  # by which theta can differ from it
    square: Array  # of the rates, in the metric of the inertia


def rigid(body: Body, well: Well, n: Array) -> Bounds:
    """Bounds of a body that can move in a well of the frame that turns at the rate n, by the inequality of Schwarz."""
    least, largest = sine = sine_range(well.theta, well.angle)
    across, third = body.inertia[:, :2].min(-1), 1 / body.inertia[:, 2]
    theta_dot = np.sqrt(well.square / across)
    phi_dot = np.sqrt(well.square * (third + (1 / least**2 - 1) / across))
    normal_rate = np.sqrt(well.square * (third + largest**2 / across))
    return Bounds(sine, theta_dot, (n, theta_dot / least), (np.zeros_like(n), phi_dot), normal_rate)


def in_space(body: Body, w: Array, gamma: Array) -> Bounds:
    """About a fixed point, near a rotation about the vertical; any n may be taken, and with damping only 0."""
    inertia, rotor, w, z = body.inertia.T, body.rotor.T, w.T, gamma.T
    momentum, n = dot(inertia * w + rotor, z), dot(inertia * w, z) / dot(inertia * z, z)
    for last in (False, False, True):
        n = np.where(body.damping > 0, 0.0, n)
        Q, c = (body.gamma.gradient - n**2) * inertia, body.gamma.field.T - n * rotor
        z = _minimum(Q, c, z)
        if not last:  # The n with which the minimum has the momentum of the start leaves the least energy.
            slope = 2 * n * inertia * z + rotor
            change = dot(inertia * z, z) + dot(slope, _solved(Q, c, z, slope))
            n = n + (momentum - dot(n * inertia * z + rotor, z)) / change
    square = dot(inertia * (w - n * gamma.T), w - n * gamma.T)
    terms = dot(inertia, w**2 + n**2 * gamma.T**2)
    return rigid(body, _on_sphere(Q, c, gamma.T, z, square, terms), n)


def symmetric(body: Body, w: Array, alpha: Array, gamma: Array) -> Bounds:
    """Of a symmetric body in a frame of two directions, by its third axis in that frame, with the S of the start."""
    (A, _, C), turn, w3 = body.inertia.T, body.turn, w[:, 2]
    start = np.array([alpha[:, 2], np.cross(gamma, alpha)[:, 2], gamma[:, 2]])
    momentum, zero = C * w3 + body.rotor[:, 2], np.zeros_like(turn)
    Q = np.array([body.alpha.gradient * (C - A), zero, turn**2 * A + body.gamma.gradient * (C - A)])
    c = np.array([body.alpha.field[:, 2], zero, body.gamma.field[:, 2] - turn * momentum])
    across = (w - turn[:, None] * gamma)[:, :2]
    square, terms = A * (across**2).sum(-1), A * ((w[:, :2] ** 2).sum(-1) + turn**2)
    well = _on_sphere(Q, c, start, _minimum(Q, c, start), square, terms)
    least, largest = sine = sine_range(well.theta, well.angle)
    theta_dot = np.sqrt(well.square / A)
    psi_dot, cosine = theta_dot / least, np.cos(well.theta)
    ends = np.cos(np.clip([well.theta - well.angle, well.theta + well.angle], 0.0, np.pi))
    phi_dot = np.abs(turn) * np.abs(ends - cosine).max(0) + np.abs(ends).max(0) * psi_dot
    sinking = largest**2 / (1 + np.sqrt(1 - largest**2))
    normal_rate = theta_dot * largest + np.abs(w3) * sinking + np.abs(turn) * largest**2
    return Bounds(sine, theta_dot, (zero, psi_dot), (w3 - turn * cosine, phi_dot), normal_rate)


def upright(body: Body, w: Array, alpha: Array, gamma: Array) -> Bounds:
    """With the third axis near the vertical, and rotor and fields along it: W - W* >= a x - b x^2 / 2, x = 1 - |cos(theta)|."""
    radius, normal = body.amended()
    least, largest = np.sort(body.inertia[:, :2]).T
    third, (_, _, z), sign = body.inertia[:, 2], gamma.T, np.sign(gamma[:, 2])
    along = np.where(
        body.inertia[:, 0] > body.inertia[:, 1], alpha[:, 0], alpha[:, 1]
    )  # of the larger moment
    b = np.minimum(-normal.gradient * (third - least), -normal.gradient * (third - largest))
    b = b + np.minimum(0.0, radius.gradient * (third - least))
    a, x = b - sign * normal.field[:, 2], (gamma[:, :2] ** 2).sum(-1) / (1 + np.abs(z))
    u = w - body.turn[:, None] * gamma
    energy = [
        0.5 * (body.inertia * u**2).sum(-1),
        0.5 * radius.gradient * (largest - least) * along**2,
        0.5 * radius.gradient * (third - least) * alpha[:, 2] ** 2,
        -0.5 * normal.gradient * ((third[:, None] - body.inertia[:, :2]) * gamma[:, :2] ** 2).sum(-1),
        -sign * normal.field[:, 2] * x,
    ]
    terms = np.abs(energy).sum(0) + (body.inertia * (w**2 + (body.turn[:, None] * gamma) ** 2)).sum(-1)
    energy = np.sum(energy, 0) + ROUNDING * terms
    known = (
        (a > 0)
        & (radius.field == 0).all(-1)
        & (normal.field[:, :2] == 0).all(-1)
        & (body.rotor[:, :2] == 0).all(-1)
    )
    limit = np.where(known, np.minimum(1.0, a / np.maximum(b, a)), np.nan)
    x = reach([energy, -a, b / 2], limit, x)
    angle = 2 * np.arcsin(np.sqrt(x / 2))
    return rigid(body, Well(np.where(sign > 0, 0.0, np.pi), angle, 2 * energy), np.zeros_like(x))


def attitude(body: Body, w: Array, alpha: Array, gamma: Array) -> Bounds:
    """Near any minimum of a frame of two directions: W - W* >= l d^2 / 2 - M d^3 / 6 - g d under a rotation by an angle d."""
    frames = start = frames_of(alpha, gamma)
    size = body.steepness()
    for _ in range(_STEPS):
        gradient, hessian = body.gradient(frames[:, 0], frames[:, 2])
        hessian = 0.5 * (hessian + np.swapaxes(hessian, 1, 2)) + _GRADIENT * size[:, None, None] * np.eye(3)
        step = np.linalg.solve(hessian, -gradient[..., None])[..., 0]
        frames = rotated(frames, step / np.maximum(1.0, np.linalg.norm(step, axis=1))[:, None])
    g = length(body.gradient(frames[:, 0], frames[:, 2])[0]) + _GRADIENT * size
    least = np.linalg.eigvalsh(body.hessian(frames[:, 0], frames[:, 2]))[:, 0] - _EIGENVALUE * size
    directions, spread = body.amended(), np.ptp(body.inertia, axis=-1)
    M = sum((1 + 17**0.5 / 4) * np.abs(d.gradient) * spread + length(d.field) for d in directions)
    u = w - body.turn[:, None] * gamma
    energy = 0.5 * (body.inertia * u**2).sum(-1)
    energy = energy + body.potential(alpha, gamma) - body.potential(frames[:, 0], frames[:, 2])
    moments = (body.inertia * (w**2 + (body.turn[:, None] * gamma) ** 2)).sum(-1)
    terms = moments + sum(np.abs(d.gradient) * body.inertia.max(-1) + 2 * length(d.field) for d in directions)
    energy = energy + ROUNDING * (terms + np.abs(body.turn) * length(body.rotor))
    limit = np.minimum(np.pi, (least + np.sqrt(least**2 - 2 * M * g)) / M)
    distance = 2 * np.arcsin(np.sqrt(((frames - start) ** 2).sum((1, 2)) / 8))
    angle = reach([energy, g, -least / 2, M / 6], np.where(least > 0, limit, np.nan), distance)
    theta = np.arctan2(np.hypot(frames[:, 2, 0], frames[:, 2, 1]), frames[:, 2, 2])
    return rigid(body, Well(theta, angle, 2 * (energy + g**2 / least)), np.zeros_like(theta))


def _on_sphere(Q: Array, c: Array, start: Array, z: Array, square: Array, terms: Array) -> Well:
    """The well of W = z.Q z / 2 + c.z, |z| = 1, about a minimum z, of a start with a square of the rates.

    With Q z + c = L z, W(x) - W(z) = (x - z).(Q - L)(x - z) / 2 exactly. The whole sphere is the well where Q - L is positive;
    else W - W(z) is bounded by the distance r = |x - z| alone. terms: magnitudes of the terms of the square.
    """
    slope, offset = Q * z + c, start - z
    L, distance, size = dot(z, slope), norm(offset), np.abs(Q).max(0) + norm(c)
    g = norm(slope - L * z) + _GRADIENT * size
    energy = 0.5 * square + 0.5 * dot((Q - L) * offset, offset) + g * distance + ROUNDING * (terms + 2 * size)
    least = _second(Q - L, *_across(z))[-1] - _EIGENVALUE * size
    bend, height = norm(Q * z - dot(z, Q * z) * z), np.maximum(0.0, least - dot((Q - L) * z, z))
    limit = 2 * least / (1.5 * bend + np.sqrt(2.25 * bend**2 + 2 * height * least))
    limit = np.where(least > 0, np.minimum(2.0, limit), np.nan)
    r = reach([energy, g, -least / 2, bend / 2, height / 8], limit, distance)
    lowest = (Q - L).min(0) - _EIGENVALUE * size
    whole = np.where(lowest > 0, (g + np.sqrt(g**2 + 2 * lowest * energy)) / lowest, np.nan)
    least = np.where(whole <= r, lowest, np.where(np.isnan(r), lowest, least))
    r = np.fmin(r, whole)
    theta = np.arctan2(np.hypot(z[0], z[1]), z[2])
    return Well(theta, 2 * np.arcsin(0.5 * r), 2 * (energy + g**2 / least))


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
