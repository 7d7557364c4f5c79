"""All relative equilibria of one satellite-gyrostat."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from ...errors import BadInput
from ..base import Array
from .initial import PARAMETERS
from .stability import Bodies, cross_matrix, exponents

# Search of equilibria: orientations to begin with, eigenvalues that count as 0 (over the scale of
# the Hessian), distance of matrices that counts as none.
_STARTS, _FLAT, _SAME = 200, 1e-6, 1e-4


def equilibria(body: Mapping[str, float]) -> dict[str, NDArray]:
    """All relative equilibria of one body: every orientation that can rest in the orbital frame.

    body: A, B, C, Omega, k1..k3, mu1..mu3, h1, h3 (the defaults of start.PARAMETERS where left out);
    start values are ignored. Returns arrays over the E equilibria, in the order of the potential:
    theta0, psi0, phi0 (E,) rad; alpha, gamma (E, 3), radius and normal in body axes; potential (E,),
    V - Omega k.gamma - Omega^2 gamma.I gamma / 2; index (E,), the Morse index of that potential;
    circle (E,), true where the equilibrium stands for a circle of them, then axis (E, 3) is the unit
    axis, in the body, about which the body may be turned by any angle (nan elsewhere); degenerate (E,), true for
    an isolated one with a zero eigenvalue (on the bifurcation set: the index counts the negative ones);
    stable (E,) int8 and growth_rate (E,), as linear_stability.

    Newton's method from _STARTS orientations, doubled until nothing new is found and, where none
    is degenerate, the isolated ones satisfy the Poincare-Hopf sum (-1)^index = 0 of SO(3).
    Raises BadInput where every orientation, or a surface of them, is an equilibrium, and
    RuntimeError if the sum cannot be met.
    """
    names = ("A", "B", "C", "Omega", "k1", "k2", "k3", "mu1", "mu2", "mu3", "h1", "h3")
    point = {name: np.array(float(body.get(name, PARAMETERS[name].default))) for name in names}
    rate = np.where(point["Omega"] == 0, 1.0, point["Omega"])
    one = Bodies(point, rate)
    scale = float(
        3 * one.Omega[0] ** 2 + np.abs(one.k).sum() + np.abs(one.radial).sum() + np.abs(one.normal).sum()
    )
    if scale == 0:
        raise BadInput("equilibria: without orbit and field the body can rest in any orientation")
    generator = np.random.default_rng(0)
    frames, starts, known, total = np.empty((0, 3, 3)), _STARTS, -1, 0
    while len(frames) != known or total != 0:
        if starts > 64 * _STARTS:
            raise RuntimeError(f"equilibria: signed sum of Morse indices {total}, not 0: some were missed")
        known = len(frames)
        frames = _distinct(
            one, np.concatenate([frames, _critical(one, _orientations(generator, starts), scale)]), scale
        )
        index, axis, degenerate = _shape(one, frames, scale)
        circle = ~np.isnan(axis[:, 0])
        total = 0 if degenerate.any() else int(((-1) ** index * ~circle).sum())
        starts *= 2
    alpha, gamma = frames[:, 0], frames[:, 2]
    potential = (
        one.potential(alpha, gamma) * float(max(point["A"], point["B"], point["C"])) * float(rate) ** 2
    )
    order = np.argsort(potential, kind="stable")
    angles = dict(zip(("theta0", "psi0", "phi0"), _angles(frames), strict=True))
    points = {name: np.full(len(frames), value) for name, value in point.items()}
    points |= angles | {name: np.zeros(len(frames)) for name in ("n", "m", "theta_dot0")}
    stable, growth = exponents(points)
    result = {
        **angles, "alpha": alpha, "gamma": gamma, "potential": potential,
        "index": index, "circle": circle, "axis": axis,
        "degenerate": degenerate, "stable": stable, "growth_rate": growth,
    }  # fmt: skip
    return {name: value[order] for name, value in result.items()}


def _orientations(generator: np.random.Generator, count: int) -> Array:
    """Uniform orientations, rows alpha, beta, gamma in body axes, shape (count, 3, 3)."""
    w, x, y, z = np.moveaxis(generator.normal(size=(count, 4)), -1, 0)
    first = np.stack([w * w + x * x - y * y - z * z, 2 * (x * y + w * z), 2 * (x * z - w * y)], -1)
    second = np.stack([2 * (x * y - w * z), w * w - x * x + y * y - z * z, 2 * (y * z + w * x)], -1)
    rows = np.stack([first, second, np.cross(first, second) / (w * w + x * x + y * y + z * z)[:, None]], 1)
    return rows / np.linalg.norm(rows, axis=2, keepdims=True)


def _rotated(frames: Array, xi: Array) -> Array:
    """Frames after the body turned by the rotation vectors xi (body axes)."""
    angle = np.linalg.norm(xi, axis=-1)[..., None, None]
    hat = cross_matrix(xi)
    turn = np.eye(3) + np.sinc(angle / np.pi) * hat + 0.5 * np.sinc(angle / (2 * np.pi)) ** 2 * (hat @ hat)
    return frames @ turn


def _critical(one: Bodies, frames: Array, scale: float) -> Array:
    """Orientations that Newton's method finds from the given ones."""
    frames, active = frames.copy(), np.arange(len(frames))
    for _ in range(40):
        gradient, hessian = one.gradient(frames[active, 0], frames[active, 2])
        # least squares with the Jacobian as it is, not made symmetric: a symmetry of the body makes one
        # of its rows vanish everywhere, and Newton's method across the circles stays quadratic
        left, values, right = np.linalg.svd(hessian)
        inverse = values / (values**2 + (1e-7 * scale) ** 2)
        step = -np.einsum("nji,nj,nkj,nk->ni", right, inverse, left, gradient)
        length = np.linalg.norm(step, axis=1)
        frames[active] = _rotated(
            frames[active], step * np.minimum(1.0, 0.5 / np.maximum(length, 0.5))[:, None]
        )
        active = active[length > 1e-9]
    gradient, _ = one.gradient(frames[:, 0], frames[:, 2])
    return frames[np.linalg.norm(gradient, axis=1) < 1e-11 * scale]


def _shape(one: Bodies, frames: Array, scale: float) -> tuple[NDArray[np.int64], Array, NDArray[np.bool_]]:
    """Morse index, axis of the circle of equilibria through each frame (nan: none), degenerate point."""
    _, hessian = one.gradient(frames[:, 0], frames[:, 2])
    values, vectors = np.linalg.eigh(0.5 * (hessian + np.swapaxes(hessian, 1, 2)))
    flat = np.abs(values) < _FLAT * scale
    if (flat.sum(1) > 1).any():
        raise BadInput(
            "equilibria: this body has a surface of equilibria, not single ones or circles of them"
        )
    axis = np.einsum("nij,nj->ni", vectors, flat.astype(float))
    # a circle is the orbit of a symmetry: of the body about an axis of its own, or about the normal
    turned = _rotated(frames, np.array([0.3, 1.1, 2.5, 4.0])[:, None, None] * axis)
    gradient, _ = one.gradient(turned[:, :, 0], turned[:, :, 2])
    circle = flat.any(1) & (np.linalg.norm(gradient, axis=2).max(0) < _FLAT * scale)
    return ((values < 0) & ~flat).sum(1), np.where(circle[:, None], axis, np.nan), flat.any(1) & ~circle


def _distinct(one: Bodies, frames: Array, scale: float) -> Array:
    """One frame for each equilibrium and each circle of them, the first of every kind."""
    _, axis, _ = _shape(one, frames, scale)
    kept: list[int] = []
    for i, frame in enumerate(frames):
        apart = np.swapaxes(frames[kept], 1, 2) @ frame
        distance = np.linalg.norm(apart - np.eye(3), axis=(1, 2))
        around = np.linalg.norm(apart @ axis[i] - axis[i], axis=1)
        if not ((distance < _SAME) | (around < _SAME)).any():
            kept.append(i)
    return frames[kept]


def _angles(frames: Array) -> tuple[Array, Array, Array]:
    """theta, psi, phi of frames; psi = 0 where only psi +- phi is defined."""
    alpha, beta, gamma = frames[:, 0], frames[:, 1], frames[:, 2]
    upright = np.hypot(gamma[:, 0], gamma[:, 1]) < 1e-9
    psi = np.where(upright, 0.0, np.arctan2(alpha[:, 2], -beta[:, 2]))
    phi = np.where(upright, np.arctan2(-alpha[:, 1], alpha[:, 0]), np.arctan2(gamma[:, 0], gamma[:, 1]))
    return np.arctan2(np.hypot(gamma[:, 0], gamma[:, 1]), gamma[:, 2]), psi, phi
