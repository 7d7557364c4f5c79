"""All relative equilibria of many bodies at once, by homotopy continuation from the rigid body without magnet and drag.

An equilibrium is a critical point on the rotation group of

    W = 3/2 alpha.I alpha + p.alpha + r.beta - 1/2 gamma.I gamma + q.gamma,
    p = h1 mu / Omega^2, r = drag / Omega^2, q = h3 mu / Omega^2 - k / Omega.

For p = r = q = 0 and distinct moments, real or complex, the critical points are the 24 orientations with the principal axes
along the axes of the frame. The moments I0 of the start are complex and arbitrary. While (I, p, r, q) goes along a straight line
from (I0, 0, 0, 0) to the body, the path of each orientation is followed. For almost every I0 no two paths meet before the end,
and the ends are all isolated complex equilibria (A. J. Sommese, C. W. Wampler, The Numerical Solution of Systems of
Polynomials, World Scientific 2005, chapters 7 and 8). For general p, r and q there are 24 solutions as well. As a function of a
quaternion, W is a quartic form with 40 eigenvectors (D. Cartwright, B. Sturmfels, Linear Algebra Appl. 438 (2013) 942). Of these
eigenvectors 16 are isotropic and no rotations (`tests/extensions/equilibria/test_satellite_equilibria.py`). The real ends are the
equilibria of the body. If 24 different ends are reached, no equilibrium is missed.

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
Three = Any  # components of vectors, as three arrays (paths,) or as one array (3, paths)

PATHS = 24
AXES = np.eye(3)
# With these arbitrary moments the paths need few steps.
_START_INERTIA = np.array([-0.985 - 0.174j, 0.631 - 0.366j, 0.354 + 0.540j])
# Each attempt has a largest correction by Newton's method (rad, summed over the axes), a largest step, and a number of iterations at
# the end. Later attempts are for bodies with a lost path or with two equal ends. Ends are equal if a path has jumped to another path.
# Later attempts have more iterations, because near a bifurcation each iteration only halves the error.
_ATTEMPTS = ((0.05, 0.25, 6), (0.01, 0.1, 40), (1e-5, 0.1, 40))
# Steps may become short, because paths near a symmetric body turn sharply where 1 - t is as small as the distance from symmetry.
_FIRST_STEP, _MIN_STEP, _MAX_STEPS = 0.1, 1e-16, 600
# A path goes to infinity if alpha or gamma exceeds `_FAR` near the end t = 1, at t > `_FAR_FROM`. The body then has fewer solutions.
_FAR, _FAR_FROM = 100.0, 0.99
_STRIDE = 5  # `_ends_of_neighbours` follows paths for one body out of this many.
_GRADIENT_ROUNDING = 1e-11  # largest rounding error of the gradient at the end of a path
# A solution with imaginary parts below `_REAL` is real. Imaginary parts between `_REAL` and `_DISTINCT`, or distances of solutions
# below `_DISTINCT`, leave the number of real solutions uncertain.
_REAL, _DISTINCT = 1e-9, 1e-5
_MERGED = 1e-4  # If the number of real solutions is uncertain, distances and imaginary parts below this number count as 0.
_NEARLY_REAL = 1.0  # largest imaginary part of a solution that counts as nearly real


def solve(
    inertia: Array, p: Array, r: Array, q: Array, ordered: bool = False
) -> tuple[Array, Array, Mask, Mask, Mask]:
    """Find the critical points of the potential W of some bodies, see the module. A number added to all three moments has no effect.

    If neighbouring bodies are similar, `ordered` lets Newton's method start from the complex solutions of a neighbour. The results
    alpha and gamma (3, 24, bodies) are unit vectors at real critical points, and real parts elsewhere. The mask `real`
    (24, bodies) marks real solutions, and `nearly` marks one of each pair of nearly real conjugates. `complete` (bodies,) tells whether
    every path ends at infinity or at its own solution, which is clearly real or clearly not. For other bodies `real` marks one of
    several merged solutions, and no solution if a path is lost.
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
    """Return alpha and gamma at the ends of paths, (6, 24, bodies), or nan at infinity. Return also whether all paths of a body arrive."""
    count = target[0].shape[1]
    # The second half of the 24 rotations that permute the axes has -alpha instead of alpha.
    pairs = [(AXES[i], sign * AXES[j]) for i, j in permutations(range(3), 2) for sign in (1.0, -1.0)]
    alpha, gamma = (np.array(vectors).T for vectors in zip(*pairs, strict=True))
    starts = np.concatenate([alpha, -alpha], 1), np.concatenate([gamma, gamma], 1)
    # Without p and r, a solution with alpha and beta has a partner with -alpha and -beta. Only one solution of each pair is followed.
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
    """Do the same as `_ends`, but follow paths for every `_STRIDE`-th body only. Newton's method starts at ends of the nearest such body.

    Bodies have at most 24 solutions, so that 24 different results are complete wherever Newton's method starts.
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
    """Whether all finite solutions of a body are clearly different, and each is clearly real or clearly not real."""
    distance = np.full(ends.shape[1:], np.inf)
    for shift in range(1, PATHS // 2 + 1):
        distance = np.fmin(distance, np.abs(ends - np.roll(ends, shift, 1)).max(0))
    imaginary = np.abs(ends.imag).max(0)
    unclear = (imaginary >= _REAL) & (imaginary <= _DISTINCT)
    return np.asarray((~unclear & (distance > _DISTINCT)).all(0))


def _follow(
    target: Three, alpha: Complex, gamma: Complex, tolerance: float, max_step: float, polish: int
) -> tuple[Complex, Complex, Mask]:
    """Follow paths with a midpoint predictor and a Newton corrector. Return the ends, and whether each path arrived."""
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
            """Return the rotation vector of the solution per unit of t, at t = s."""
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
    """Refine solutions by Newton's method. Return also whether each solution is exact up to rounding."""
    for _ in range(iterations):
        xi = _newton(_gradient(target, alpha, gamma), target, alpha, gamma)
        small = _size(xi) < 0.3
        alpha, gamma = _turn(alpha, gamma, [np.where(small, x, 0) for x in xi], 1.0)
    magnitude = (np.abs(alpha).max(0) + np.abs(gamma).max(0)) ** 2
    exact = _size(_gradient(target, alpha, gamma)) < _GRADIENT_ROUNDING * magnitude
    return alpha, gamma, exact


def _size(xi: Three) -> Array:
    return np.abs(xi[0]) + np.abs(xi[1]) + np.abs(xi[2])


def _gradient(body: Sequence[Three], a: Three, g: Three) -> Three:
    """Return the gradient of W under rotations, (3 I alpha + p) x alpha + r x beta + (q - I gamma) x gamma."""
    inertia, p, r, q = body

    def component(j: int, k: int) -> Complex:
        d = inertia[j] - inertia[k]
        return (3 * d * a[j] + p[j]) * a[k] - p[k] * a[j] + (q[j] - d * g[j]) * g[k] - q[k] * g[j]

    result = component(1, 2), component(2, 0), component(0, 1)
    if not np.any(r):
        return result
    return [x + y for x, y in zip(result, _cross(r, _cross(g, a)), strict=True)]


def _newton(gradient: Three, body: Sequence[Three], a: Three, g: Three) -> Three:
    """Return -H^-1 gradient by Cramer's rule, where H is the Jacobian of `gradient`."""
    inertia, p, r, q = body
    b = _cross(g, a) if np.any(r) else None
    by = {}  # (j, k) -> factors of a_i and g_i in the entry H_ij, where i is the third axis
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
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]


def _turn(a: Three, g: Three, xi: Three, length: Array | float) -> tuple[Complex, Complex]:
    """Return alpha and gamma after a turn by length * xi. Cayley's rotation approximates the turn to second order."""
    half = [0.5 * length * x for x in xi]
    factor = 2 / (1 + half[0] ** 2 + half[1] ** 2 + half[2] ** 2)

    def rotated(v: Three) -> Complex:
        first = _cross(v, half)
        second = _cross(first, half)
        return np.stack([v[i] + factor * (first[i] + second[i]) for i in range(3)])

    return rotated(a), rotated(g)
