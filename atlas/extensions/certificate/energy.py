"""Wells of an energy, which hold a motion near a minimum for all time.

Consider a frame that turns at the rate n about the vertical, and the angular velocity u relative to this frame. With the amended
potential W, the energy J = u.I u / 2 + W is constant, or falls with damping. If W >= W* along the motion, then u.I u <= 2 (J - W*).
A symmetric satellite without damping also keeps S = C w3 + k3, and the energy A u_perp^2 / 2 + W_S of its third axis, where W_S
depends on S. `size` sums the magnitudes of the terms in the second derivatives of W. Rounding errors are relative to `size`.
"""

from __future__ import annotations

import numpy as np

from ...systems.steady import TERM_ROUNDING
from ...theory.point import (
    cross,
    divided,
    dot,
    fmin,
    greatest,
    larger,
    length,
    magnitude,
    minus,
    plus,
    rotate,
    scaled,
    smaller,
    smallest,
    times,
    unit,
)
from .bounds import Bounds, Direction, reach, sine_range, unknown

STEPS = 5  # Nothing is proved if this number of steps of Newton's method does not reach a minimum.
FLAT = 1e-6  # Newton's method takes a gradient step if an eigenvalue of the Hessian is below this fraction of `size`.
EIGENVALUE, GRADIENT = 1e-13, 1e-14  # rounding errors of eigenvalues and gradient, divided by `size`
TINY = 2.0**-1022  # added to the diagonal of a Hessian, which may be 0, to make the Hessian invertible
SWEEPS = 6  # largest number of sweeps of Jacobi's method


def in_space(body, w, gamma):
    """Return bounds of a motion near a rotation at a rate n about the vertical, for a body with a fixed point. With damping n is 0."""
    inertia, rotor, z = body.inertia, body.rotor, gamma
    momentum = dot(plus(times(inertia, w), rotor), z)
    n = dot(times(inertia, w), z) / dot(times(inertia, z), z)
    for step in range(3):
        if body.damping > 0:
            n = 0.0
        Q, c = scaled(body.gamma.gradient - n**2, inertia), minus(body.gamma.field, scaled(n, rotor))
        z = minimum(Q, c, z)
        # Newton's method finds the permanent rotation with the initial momentum about the vertical. The rate n gives the sharpest bound.
        if step < 2:
            slope = plus(times(scaled(2 * n, inertia), z), rotor)
            change = dot(times(inertia, z), z) + dot(slope, solved(Q, c, z, slope))
            n = n + (momentum - dot(plus(times(scaled(n, inertia), z), rotor), z)) / change
    if z[0] != z[0]:
        return unknown()
    square = square_of(inertia, w, scaled(n, gamma), 3)
    size = (abs(body.gamma.gradient) + n**2) * greatest(inertia) + length(body.gamma.field)
    theta, angle, square = on_sphere(Q, c, gamma, z, square, size + abs(n) * length(rotor))
    return rigid(body, theta, angle, square, n)


def symmetric(body, w, alpha, gamma):
    """Return bounds of a symmetric body's motion relative to the frame of alpha and gamma, from the energy of the body's third axis."""
    A, _, C = body.inertia
    turn, w3, k3 = body.turn, w[2], body.rotor[2]
    start = alpha[2], cross(gamma, alpha)[2], gamma[2]
    Q = body.alpha.gradient * (C - A), 0.0, turn**2 * A + body.gamma.gradient * (C - A)
    c = body.alpha.field[2], body.beta.field[2], body.gamma.field[2] - turn * (C * w3 + k3)
    square = square_of(body.inertia, w, scaled(turn, gamma), 2)
    size = abs(turn) * (abs(C * w3) + abs(k3)) + turn**2 * A
    size = size + (size_of(body.alpha, A + C) + size_of(body.gamma, A + C)) + length(body.beta.field)
    theta, angle, square = on_sphere(Q, c, start, minimum(Q, c, start), square, size)
    if angle != angle:
        return unknown()
    least, largest = sine_range(theta, angle)
    theta_dot, cosine = np.sqrt(square / A), np.cos(theta)
    low, high = np.cos(larger(theta - angle, 0.0)), np.cos(smaller(theta + angle, np.pi))
    phi_dot = abs(turn) * larger(abs(low - cosine), abs(high - cosine))
    phi_dot = phi_dot + larger(abs(low), abs(high)) * theta_dot / least
    sinking = largest**2 / (1 + np.sqrt(1 - largest**2))
    normal_rate = theta_dot * largest + abs(w3) * sinking + abs(turn) * largest**2
    return Bounds(least, largest, theta_dot, 0.0, theta_dot / least, w3 - turn * cosine, phi_dot, normal_rate)


def upright(body, w, alpha, gamma):
    """Return `Bounds` near theta = 0 or pi for axial rotor and field. With x = 1 - |cos(theta)|, W rises by at least a x - b x^2 / 2."""
    radius, normal = amended(body)
    across = length(radius.field) + length(body.beta.field) + np.hypot(normal.field[0], normal.field[1])
    if across + np.hypot(body.rotor[0], body.rotor[1]) > 0:
        return unknown()
    first, second, third = body.inertia
    sign = np.sign(gamma[2])
    b = smaller(normal.gradient * (first - third), normal.gradient * (second - third))
    b = b + smaller(0.0, radius.gradient * (third - smaller(first, second)))
    axis = (1.0, 0.0, 0.0) if first <= second else (0.0, 1.0, 0.0)
    energy, size = excess(body, w, alpha, gamma, axis, (0.0, 0.0, sign))
    a = b - sign * normal.field[2] - EIGENVALUE * size
    if not a > 0:
        return unknown()
    x = (gamma[0] ** 2 + gamma[1] ** 2) / (1 + abs(gamma[2]))
    x = reach((energy, -a, b / 2), smaller(1.0, a / larger(b, a)), x)
    return rigid(body, 0.0 if sign > 0 else np.pi, 2 * np.arcsin(np.sqrt(x / 2)), 2 * energy, 0.0)


def attitude(body, w, alpha, gamma):
    """Return `Bounds` near a minimum of W. A turn by d raises W by at least `least` d^2 / 2 - M d^3 / 6 - `slope` d, where M >= |W'''|."""
    radius, normal = amended(body)
    a, b, g = alpha, cross(gamma, alpha), gamma
    spread = greatest(body.inertia) - smallest(body.inertia)
    # The number `regular`, added to the diagonal, keeps the Hessian invertible if no torque acts.
    drag = length(body.beta.field)
    regular = GRADIENT * (size_of(radius, spread) + size_of(normal, spread) + drag) + TINY
    for _ in range(STEPS):
        (xx, yy, zz), mixed = hessian(body, a, g)
        step = solved3((xx + regular, yy + regular, zz + regular), mixed, scaled(-1.0, torque(body, a, g)))
        step = divided(step, larger(1.0, length(step)))
        a, b, g = rotated(a, step), rotated(b, step), rotated(g, step)
    if g[0] != g[0]:
        return unknown()
    energy, size = excess(body, w, alpha, gamma, a, g)
    diagonal, mixed = hessian(body, a, g)
    least = least_eigenvalue(diagonal, mixed) - EIGENVALUE * size
    if not least > 0:
        return unknown()
    slope = length(torque(body, a, g)) + GRADIENT * size
    third = (1 + 17**0.5 / 4) * spread  # bounds |d^3/dt^3 (v.I v / 2)| if a unit vector v turns by an angle t
    M = size_of(radius, third) + size_of(normal, third) + drag + GRADIENT * size
    limit = smaller(np.pi, (least + np.sqrt(least**2 - 2 * M * slope)) / M)
    offsets = minus(a, alpha), minus(b, cross(gamma, alpha)), minus(g, gamma)
    square = dot(offsets[0], offsets[0]) + dot(offsets[1], offsets[1]) + dot(offsets[2], offsets[2])
    distance = 2 * np.arcsin(np.sqrt(square / 8))
    angle = reach((energy, slope, -least / 2, M / 6), limit, distance)
    theta = np.arctan2(np.hypot(g[0], g[1]), g[2])
    return rigid(body, theta, angle, 2 * (energy + slope**2 / least), 0.0)


def amended(body):
    field = minus(body.gamma.field, scaled(body.turn, body.rotor))
    return body.alpha, Direction(body.gamma.gradient - body.turn**2, field)


def size_of(direction, moment):
    """Return the sum of the magnitudes of the terms with `direction` in the second derivatives of the potential."""
    return moment * abs(direction.gradient) + length(direction.field)


def torque(body, a, g):
    """Return the gradient of the amended potential W under rotations of the body."""
    radius, normal = amended(body)
    first = cross(plus(times(scaled(radius.gradient, body.inertia), a), radius.field), a)
    first = plus(first, cross(body.beta.field, cross(g, a)))
    return plus(first, cross(plus(times(scaled(normal.gradient, body.inertia), g), normal.field), g))


def hessian(body, a, g):
    """Return the diagonal of the symmetric part of the Hessian of W, and the entries yz, zx and xy."""
    radius, normal = amended(body)
    diagonal, mixed = hessian_of(body.inertia, radius, a)
    for direction, v in ((body.beta, cross(g, a)), (normal, g)):
        more, others = hessian_of(body.inertia, direction, v)
        diagonal, mixed = plus(diagonal, more), plus(mixed, others)
    return diagonal, mixed


def hessian_of(inertia, direction, v):
    m, f = scaled(direction.gradient, inertia), direction.field
    x = (m[1] - m[2]) * (v[2] ** 2 - v[1] ** 2) - f[1] * v[1] - f[2] * v[2]
    y = (m[2] - m[0]) * (v[0] ** 2 - v[2] ** 2) - f[2] * v[2] - f[0] * v[0]
    z = (m[0] - m[1]) * (v[1] ** 2 - v[0] ** 2) - f[0] * v[0] - f[1] * v[1]
    xy = 0.5 * ((m[0] + m[1] - 2 * m[2]) * v[0] * v[1] + f[0] * v[1] + f[1] * v[0])
    yz = 0.5 * ((m[1] + m[2] - 2 * m[0]) * v[1] * v[2] + f[1] * v[2] + f[2] * v[1])
    zx = 0.5 * ((m[2] + m[0] - 2 * m[1]) * v[2] * v[0] + f[2] * v[0] + f[0] * v[2])
    return (x, y, z), (yz, zx, xy)


def square_of(inertia, w, turn, components):
    """Return an upper bound of u.I u for u = w - turn. The bound includes the rounding errors of u."""
    square = 0.0
    for i in range(components):
        square += inertia[i] * (abs(w[i] - turn[i]) + TERM_ROUNDING * (abs(w[i]) + abs(turn[i]))) ** 2
    return square


def excess(body, w, alpha, gamma, a, g):
    """Return an upper bound of the difference energy - W(a, g), and `size`. The bound allows for rounding errors relative to `size`."""
    radius, normal = amended(body)
    energy = 0.5 * square_of(body.inertia, w, scaled(body.turn, gamma), 3)
    energy = energy + difference(body, radius, alpha, a) + difference(body, normal, gamma, g)
    energy = energy + difference(body, body.beta, cross(gamma, alpha), cross(g, a))
    size = abs(body.turn) * length(body.rotor)
    moment = greatest(body.inertia)
    size = size + abs(radius.gradient) * moment + length(radius.field)
    size = size + abs(normal.gradient) * moment + length(normal.field) + length(body.beta.field)
    return energy + TERM_ROUNDING * size, size


def difference(body, direction, start, v):
    middle, change = scaled(0.5, plus(start, v)), minus(start, v)
    return dot(plus(times(scaled(direction.gradient, body.inertia), middle), direction.field), change)


def rigid(body, theta, angle, square, n):
    """Return `Bounds` of a body within `angle` of theta. The body's angular velocity u in a frame of rate n has u.I u <= `square`."""
    if angle != angle:
        return unknown()
    least, largest = sine_range(theta, angle)
    across, third = smaller(body.inertia[0], body.inertia[1]), 1 / body.inertia[2]
    theta_dot = np.sqrt(square / across)
    phi_dot = np.sqrt(square * (third + (1 / least**2 - 1) / across))
    normal_rate = np.sqrt(square * (third + largest**2 / across))
    return Bounds(least, largest, theta_dot, n, theta_dot / least, 0.0, phi_dot, normal_rate)


def on_sphere(Q, c, start, z, square, size):
    """Return the nutation angle of z, and bounds for all time of the angle between x and z and of twice the relative kinetic energy.

    The unit vector x moves from `start` near a minimum z of W(x) = x.Q x / 2 + c.x. At the start twice the energy is `square`. If
    Q z + c = L z, then W(x) - W(z) = (x - z).(Q - L)(x - z) / 2. If all Q_i > L, the difference is positive. Near z the difference
    exceeds a polynomial of |x - z|.
    """
    curved, offset = times(Q, z), minus(start, z)
    slope = plus(curved, c)
    L, distance = dot(z, slope), length(offset)
    M = Q[0] - L, Q[1] - L, Q[2] - L
    g = length(minus(slope, scaled(L, z))) + GRADIENT * size
    energy = 0.5 * square + 0.5 * dot(times(M, offset), offset) + g * distance + TERM_ROUNDING * size
    first, second = across_axes(z)
    least = second_form(M, first, second)[3] - EIGENVALUE * size
    lowest = smallest(M) - EIGENVALUE * size
    if not (least > 0 or lowest > 0):
        return np.nan, np.nan, np.nan
    r = whole = np.nan
    if least > 0:
        along = dot(z, curved)
        bend, height = length(minus(curved, scaled(along, z))), larger(0.0, least - along + L)
        limit = 2 * least / (1.5 * bend + np.sqrt(2.25 * bend**2 + 2 * height * least))
        r = reach((energy, g, -least / 2, bend / 2, height / 8), smaller(2.0, limit), distance)
    if lowest > 0:
        whole = (g + np.sqrt(g**2 + 2 * lowest * energy)) / lowest
    square = 2 * (energy + g**2 / (lowest if whole <= r or r != r else least))
    return np.arctan2(np.hypot(z[0], z[1]), z[2]), 2 * np.arcsin(0.5 * fmin(r, whole)), square


def minimum(Q, c, z):
    """Return the minimum of z.Q z / 2 + c.z on the unit sphere that Newton's method reaches from z."""
    for _ in range(STEPS):
        step = solved(Q, c, z, plus(times(Q, z), c))
        z = minus(z, divided(step, larger(1.0, length(step))))
        z = unit(z, z)
    return z


def solved(Q, c, z, vector):
    """Multiply a vector by the inverse Hessian of z.Q z / 2 + c.z on the unit sphere, or by 1 / `size` if the Hessian is not positive."""
    first, second = across_axes(z)
    v1, v2 = dot(first, vector), dot(second, vector)
    size = greatest(magnitude(Q)) + length(c)
    L = dot(z, plus(times(Q, z), c))
    a, b, d, least = second_form((Q[0] - L, Q[1] - L, Q[2] - L), first, second)
    if not least > FLAT * size:
        a, b, d = size, 0.0, size
    return divided(plus(scaled(d * v1 - b * v2, first), scaled(a * v2 - b * v1, second)), a * d - b**2)


def across_axes(z):
    """Return two unit vectors that are normal to each other and to z."""
    x, y, t = magnitude(z)
    if x <= y and x <= t:
        first = 0.0, z[2], -z[1]
    elif y <= t:
        first = -z[2], 0.0, z[0]
    else:
        first = z[1], -z[0], 0.0
    first = unit(first, first)
    return first, cross(z, first)


def second_form(M, first, second):
    """Return the entries 11, 12 and 22 of the matrix diag(M) on two orthonormal axes, and the smaller eigenvalue in their plane."""
    a, b, d = dot(times(M, first), first), dot(times(M, first), second), dot(times(M, second), second)
    return a, b, d, 0.5 * (a + d) - np.hypot(0.5 * (a - d), b)


def rotated(v, xi):
    """Return the body components of a vector at rest in the frame after the body has turned by the rotation vector xi."""
    angle = length(xi)
    return rotate(v, unit(xi, xi), np.cos(angle), -np.sin(angle))


def solved3(diagonal, mixed, vector):
    """Solve a symmetric system of three equations. The solution is nan where the matrix is singular."""
    (a, b, c), (f, g, h) = diagonal, mixed
    x, y, z = (a, h, g), (h, b, f), (g, f, c)
    first, second, third = cross(y, z), cross(z, x), cross(x, y)
    return divided((dot(first, vector), dot(second, vector), dot(third, vector)), dot(x, first))


def least_eigenvalue(diagonal, mixed):
    """Return the smallest eigenvalue of a symmetric matrix, found by Jacobi's rotations."""
    (a, b, c), (f, g, h) = diagonal, mixed
    size = abs(a) + abs(b) + abs(c) + abs(f) + abs(g) + abs(h)
    for _ in range(SWEEPS):
        if abs(f) + abs(g) + abs(h) <= 1e-17 * size:
            break
        a, b, h, g, f = jacobi(a, b, h, g, f)
        b, c, f, h, g = jacobi(b, c, f, h, g)
        c, a, g, f, h = jacobi(c, a, g, f, h)
    return smaller(a, smaller(b, c))


def jacobi(a, b, h, g, f):
    """Make h = 0 by a Jacobi rotation. The entry h couples the diagonal entries a and b. The other off-diagonal entries are g and f."""
    if h == 0:
        return a, b, h, g, f
    ratio = (b - a) / (2 * h)
    t = 1 / (abs(ratio) + np.sqrt(1 + ratio * ratio))
    if ratio < 0:
        t = -t
    cosine = 1 / np.sqrt(1 + t * t)
    sine = t * cosine
    return a - t * h, b + t * h, 0.0, cosine * g - sine * f, sine * g + cosine * f
