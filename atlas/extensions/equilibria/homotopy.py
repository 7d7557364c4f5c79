"""All relative equilibria of many bodies at once, by homotopy continuation from the rigid body without magnet and drag.

An equilibrium is a critical point on the rotation group of

    W = 3/2 alpha.I alpha + p.alpha + r.beta - 1/2 gamma.I gamma + q.gamma,
    p = h1 mu / Omega^2, r = drag / Omega^2, q = h3 mu / Omega^2 - k / Omega.

For p = r = q = 0 and distinct moments these are the 24 orientations with the principal axes along the axes of the frame,
for complex moments too. The path of each orientation is followed while (I, p, r, q) goes along a straight line from (I0, 0, 0, 0), I0
complex and arbitrary, to the body: for almost every I0 no two paths meet before the end, and the ends are all
isolated complex equilibria (A. J. Sommese, C. W. Wampler, The Numerical Solution of Systems of Polynomials, World
Scientific 2005, chapters 7 and 8). For general p, r and q there are 24 solutions as well: in a quaternion W is a quartic form with 40 eigenvectors
(D. Cartwright, B. Sturmfels, Linear Algebra Appl. 438 (2013) 942), 16 of which are isotropic and no rotations
(`tests/extensions/equilibria/test_satellite_equilibria.py`). The real ends are the equilibria of the body: if 24 different ends are
reached, none is missed.

Complex orientations have rows alpha, beta, gamma with alpha.alpha = 1 etc., without conjugation. Arrays are (3, paths).
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import permutations
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...systems.base import Array, Mask

Complex = NDArray[np.complex128]
Three = Any  # the components of vectors: three arrays (paths,), or their stack

PATHS = 24
AXES = np.eye(3)
# Arbitrary; a choice that needs few steps.
_START_INERTIA = np.array([-0.985 - 0.174j, 0.631 - 0.366j, 0.354 + 0.540j])
# For each attempt the largest correction by Newton's method (rad, sum over the axes), the largest step and the Newton iterations
# at the end. Later attempts are for bodies with a lost path, or with equal ends because one path jumped to another. Near a
# bifurcation each iteration only halves the error.
_ATTEMPTS = ((0.05, 0.25, 6), (0.01, 0.1, 40), (1e-5, 0.1, 40))
# Near a symmetric body paths turn sharply where 1 - t is as small as the distance from symmetry.
_FIRST_STEP, _MIN_STEP, _MAX_STEPS = 0.1, 1e-16, 600
# A path goes to infinity (the body has fewer than 24 solutions) if a component exceeds _FAR at t > _FAR_FROM.
_FAR, _FAR_FROM = 100.0, 0.99
_STRIDE = 5  # paths are followed for every fifth body
_GRADIENT_ROUNDING = 1e-11  # largest rounding error of the gradient at an end
# A solution with imaginary parts below _REAL is real. Imaginary parts between _REAL and _DISTINCT, or distances of
# solutions below _DISTINCT, leave the number of real solutions uncertain.
_REAL, _DISTINCT = 1e-9, 1e-5
_MERGED = 1e-4  # distance, or imaginary part, below which solutions count as one if their number is uncertain
_NEARLY_REAL = 1.0  # largest imaginary part of solutions that count as nearly real


def solve(
    inertia: Array, p: Array, r: Array, q: Array, ordered: bool = False
) -> tuple[Array, Array, Mask, Mask, Mask]:
    """Critical points of W of some bodies; one number added to all three moments has no effect.

    ordered: whether neighbouring bodies are similar, so that Newton's method may start from the complex solutions of a neighbour.
    Returns alpha and gamma, (3, 24, bodies), unit vectors of real critical points and the real parts of other ones; the masks real
    and nearly (one of each nearly real conjugate pair), (24, bodies); and complete, (bodies,): whether every path ends at infinity
    or at its own solution, clearly real or clearly not. In other bodies one of several merged solutions counts as real,
    and none if a path is lost.
    """
    inertia = inertia - inertia.mean(0)
    sizes = [np.abs(vector).max(0) for vector in (inertia, p, r, q)]
    scale = np.max([*sizes[:3], 0.3 * sizes[3]], axis=0)
    with np.errstate(all="ignore"):
        target = [np.where(scale > 0, values / scale, 0.0) for values in (inertia, p, r, q)]
        ends, arrived = (_ends_of_neighbours if ordered else _ends)(target, *_ATTEMPTS[0])
        complete = arrived & _all_different(ends)
        for attempt in _ATTEMPTS[0 if ordered else 1 :]:
            repeated = np.flatnonzero(~complete)
            if repeated.size:
                part = [values[:, repeated] for values in target]
                ends[:, :, repeated], arrived[repeated] = _ends(part, *attempt)
                complete[repeated] = arrived[repeated] & _all_different(ends[:, :, repeated])
        size = np.abs(ends.imag).max(0)
        upper = np.take_along_axis(ends.imag, np.abs(ends.imag).argmax(0)[None], 0)[0] > 0
        real = (size < np.where(complete, _REAL, _MERGED)) & arrived
        vectors, distinct = ends[:, :, ~complete].real, real[:, ~complete]
        for path in range(1, PATHS):
            merged = np.abs(vectors[:, [path]] - vectors[:, :path]).max(0) < _MERGED
            distinct[path] &= ~(merged & distinct[:path]).any(0)
        real[:, ~complete] = distinct
    nearly = (size >= _REAL) & (size < _NEARLY_REAL) & upper & complete
    return ends[:3].real, ends[3:].real, real, nearly, complete


def _ends(target: Three, *attempt: Any) -> tuple[Complex, Mask]:
    """alpha and gamma at the ends of the paths, nan at infinity, (6, 24, bodies), and whether all paths arrive, (bodies,)."""
    count = target[0].shape[1]
    # Of the 24 rotations that permute the axes the second half has -alpha.
    pairs = [(AXES[i], sign * AXES[j]) for i, j in permutations(range(3), 2) for sign in (1.0, -1.0)]
    alpha, gamma = (np.array(vectors).T for vectors in zip(*pairs, strict=True))
    starts = np.concatenate([alpha, -alpha], 1), np.concatenate([gamma, gamma], 1)
    # Without p and r the solutions come in pairs +-alpha, +-beta: only one of each pair is followed.
    mirrored = not (target[1].any() or target[2].any())
    paths = PATHS // 2 if mirrored else PATHS
    repeated = [np.repeat(values[:, None], paths, 1).reshape(3, -1) for values in target]
    alpha, gamma = (np.repeat(vectors[:, :paths, None] + 0j, count, 2).reshape(3, -1) for vectors in starts)
    alpha, gamma, arrived = _follow(repeated, alpha, gamma, *attempt)
    ends = np.concatenate([alpha, gamma]).reshape(6, paths, count)
    if mirrored:
        ends = np.concatenate([ends, ends * np.array([-1, -1, -1, 1, 1, 1])[:, None, None]], 1)
    return ends, np.asarray(arrived.reshape(paths, count).all(0))


def _ends_of_neighbours(target: Three, *attempt: Any) -> tuple[Complex, Mask]:
    """As `_ends`, with paths only for every _STRIDE-th body, whose solutions start Newton's method for its neighbours.

    Wherever Newton's method starts, 24 different solutions are all that exist.
    """
    count = target[0].shape[1]
    followed = np.arange(0, count, _STRIDE)
    ends, _ = _ends([values[:, followed] for values in target], *attempt)
    nearest = np.minimum((np.arange(count) + _STRIDE // 2) // _STRIDE, followed.size - 1)
    start = ends[:, :, nearest].reshape(6, -1)
    repeated = [np.tile(values, PATHS) for values in target]
    alpha, gamma, exact = _polish(repeated, start[:3], start[3:], attempt[-1])
    ends = np.concatenate([alpha, gamma]).reshape(6, PATHS, count)
    return ends, np.asarray(exact.reshape(PATHS, count).all(0))


def _all_different(ends: Complex) -> Mask:
    """Whether all finite solutions of a body are clearly different, and each is clearly real or clearly not, (bodies,)."""
    distance = np.full(ends.shape[1:], np.inf)
    for shift in range(1, PATHS // 2 + 1):
        distance = np.fmin(distance, np.abs(ends - np.roll(ends, shift, 1)).max(0))
    imaginary = np.abs(ends.imag).max(0)
    unclear = (imaginary >= _REAL) & (imaginary <= _DISTINCT)
    return np.asarray((~unclear & (distance > _DISTINCT)).all(0))


def _follow(
    target: Three, alpha: Complex, gamma: Complex, tolerance: float, max_step: float, polish: int
) -> tuple[Complex, Complex, Mask]:
    """Ends of paths, and which were reached: midpoint predictor and Newton corrector, each path alone with its step size."""
    start = _START_INERTIA[:, None]
    change = (target[0] - start, *target[1:])  # change of inertia, p, r and q along the line
    t, step = np.zeros(alpha.shape[1]), np.full(alpha.shape[1], _FIRST_STEP)
    active = np.arange(t.size)
    for _ in range(_MAX_STEPS):
        if not active.size:
            break
        dI, *dv = (values[:, active] for values in change)
        now, length = t[active], np.minimum(step[active], 1 - t[active])

        def rate(a: Complex, g: Complex, s: Array, dI=dI, dv=dv) -> Three:
            """Rotation vector xi of the solution per unit of t."""
            return _newton(_gradient((dI, *dv), a, g), (start + s * dI, *(s * v for v in dv)), a, g)

        a, g = alpha[:, active], gamma[:, active]
        middle = _turn(a, g, rate(a, g, now), 0.5 * length)
        a, g = _turn(a, g, rate(*middle, now + 0.5 * length), length)
        end = now + length
        body = start + end * dI, *(end * v for v in dv)
        xi = _newton(_gradient(body, a, g), body, a, g)
        a, g = _turn(a, g, xi, 1.0)
        correction = _size(xi)
        accepted = correction < tolerance
        chosen = active[accepted]
        alpha[:, chosen], gamma[:, chosen], t[chosen] = a[:, accepted], g[:, accepted], end[accepted]
        growth = np.clip((0.15 * tolerance / np.maximum(correction, 1e-9)) ** (1 / 3), 0.3, 2.0)
        growth = np.where(accepted, growth, np.minimum(np.nan_to_num(growth, nan=0.3), 0.4))
        step[active] = np.minimum(length * growth, max_step)
        active = active[(t[active] < 1) & (step[active] > _MIN_STEP)]
        ahead = active[t[active] > _FAR_FROM]
        far = ahead[np.abs([alpha[:, ahead], gamma[:, ahead]]).max((0, 1)) > _FAR]
        alpha[:, far] = gamma[:, far] = np.nan
        active = active[~np.isnan(alpha[0, active])]
    alpha, gamma, exact = _polish(target, alpha, gamma, polish)
    return alpha, gamma, (t >= 1) & exact | np.isnan(alpha[0])


def _polish(target: Three, alpha: Complex, gamma: Complex, iterations: int) -> tuple[Complex, Complex, Mask]:
    """Solutions by Newton's method from approximate ones, and which of them are exact up to rounding."""
    for _ in range(iterations):
        xi = _newton(_gradient(target, alpha, gamma), target, alpha, gamma)
        small = _size(xi) < 0.3
        alpha, gamma = _turn(alpha, gamma, [np.where(small, x, 0) for x in xi], 1.0)
    magnitude = (np.abs(alpha).max(0) + np.abs(gamma).max(0)) ** 2
    exact = _size(_gradient(target, alpha, gamma)) < _GRADIENT_ROUNDING * magnitude
    return alpha, gamma, exact


def _size(xi: Three) -> Array:
    """Sum of the magnitudes of three components."""
    return np.abs(xi[0]) + np.abs(xi[1]) + np.abs(xi[2])


def _gradient(body: Sequence[Three], a: Three, g: Three) -> Three:
    """Gradient of W under rotations, body = (I, p, r, q): (3 I alpha + p) x alpha + r x beta + (q - I gamma) x gamma."""
    inertia, p, r, q = body

    def component(j: int, k: int) -> Complex:
        d = inertia[j] - inertia[k]
        return (3 * d * a[j] + p[j]) * a[k] - p[k] * a[j] + (q[j] - d * g[j]) * g[k] - q[k] * g[j]

    result = component(1, 2), component(2, 0), component(0, 1)
    if not np.any(r):
        return result
    return [x + y for x, y in zip(result, _cross(r, _cross(g, a)), strict=True)]


def _newton(gradient: Three, body: Sequence[Three], a: Three, g: Three) -> Three:
    """-H^-1 gradient by Cramer's rule, H the derivatives of the gradient of W."""
    inertia, p, r, q = body
    b = _cross(g, a) if np.any(r) else None
    by = {}  # (j, k) -> the factors of a_i and g_i in H_ij, k the third axis
    for j, k in ((0, 1), (1, 2), (2, 0)):
        d = inertia[j] - inertia[k]
        by[j, k] = 3 * d * a[j] + p[j], q[j] - d * g[j]
        by[k, j] = p[k] - 3 * d * a[k], q[k] + d * g[k]

    def entry(i: int, j: int, k: int) -> Complex:
        u, v = by[j, k]
        value = a[i] * u + g[i] * v
        return value if b is None else value + b[i] * r[j]

    diagonal = [-entry(j, j, k) - entry(k, k, j) for j, k in ((1, 2), (2, 0), (0, 1))]
    rows = (
        (diagonal[0], entry(0, 1, 2), entry(0, 2, 1)),
        (entry(1, 0, 2), diagonal[1], entry(1, 2, 0)),
        (entry(2, 0, 1), entry(2, 1, 0), diagonal[2]),
    )
    columns = list(zip(*rows, strict=True))
    cofactors = [_cross(columns[(i + 1) % 3], columns[(i + 2) % 3]) for i in range(3)]
    determinant = sum(c * x for c, x in zip(cofactors[0], columns[0], strict=True))
    factor = -1 / determinant
    return [factor * (c[0] * gradient[0] + c[1] * gradient[1] + c[2] * gradient[2]) for c in cofactors]


def _cross(a: Three, b: Three) -> Three:
    """Vector product."""
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]


def _turn(a: Three, g: Three, xi: Three, length: Array | float) -> tuple[Complex, Complex]:
    """alpha and gamma after the body turned by length * xi, to second order (Cayley's rotation)."""
    half = [0.5 * length * x for x in xi]
    factor = 2 / (1 + half[0] ** 2 + half[1] ** 2 + half[2] ** 2)

    def rotated(v: Three) -> Complex:
        first = _cross(v, half)
        second = _cross(first, half)
        return np.stack([v[i] + factor * (first[i] + second[i]) for i in range(3)])

    return rotated(a), rotated(g)
