"""All relative equilibria of a satellite-gyrostat, of one body or of many at once."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...errors import BadInput
from ...flags import Completeness, Stability
from ..base import Array, Points, subset
from ..oscillations import FREQUENCIES
from . import homotopy
from .initial import PARAMETERS
from .oscillations import frequencies
from .stability import Bodies, cross_matrix, exponents

_STARTS = 200  # orientations from which the search begins
_ZERO_EIGENVALUE = 1e-6  # of the Hessian, relative to its scale
_SAME = 1e-4  # distance of rotation matrices that are taken as equal
_MAX_SCALE = 1e60  # of units, rates and torques; products of a few of them are finite
_BLOCK = 512  # bodies that are computed together
_NAMES = ("A", "B", "C", "Omega", "k1", "k2", "k3", "mu1", "mu2", "mu3", "h1", "h3", "damping")


def equilibria(body: Mapping[str, float]) -> dict[str, NDArray[Any]]:
    """All relative equilibria of one body: every orientation that can rest in the orbital frame.

    Newton's method from _STARTS orientations, doubled until no new equilibria appear and, where none
    is degenerate, the isolated ones satisfy the Poincare-Hopf sum (-1)^index = 0 of SO(3).

    body: A, B, C, Omega, k1..k3, mu1..mu3, h1, h3, damping; those left out take their defaults, start values
    are ignored. Returns theta0, psi0, phi0 (E,) rad; alpha, gamma (E, 3), radius and normal in body axes;
    potential (E,), V - Omega k.gamma - Omega^2 gamma.I gamma / 2; index (E,), the Morse index of that
    potential; circle (E,), true where the equilibrium represents a circle of them, and axis (E, 3), the unit
    axis in the body about which the body may then be turned by any angle (nan elsewhere); degenerate (E,),
    true for an isolated one with a zero eigenvalue (on the bifurcation set: the index counts the negative
    ones); stable (E,) int8 and growth_rate (E,), as linear_stability; frequency_1 to frequency_3 (E,), see
    oscillations.frequencies. Raises BadInput: every orientation, or a surface of them, is an equilibrium; or
    the numbers differ so much in magnitude that the search would overflow. Raises RuntimeError: the
    Poincare-Hopf sum cannot be met.
    """
    point = {name: np.array(float(body.get(name, PARAMETERS[name].default))) for name in _NAMES}
    rate = np.where(point["Omega"] == 0, 1.0, point["Omega"])
    with np.errstate(all="ignore"):
        bodies = Bodies(point, rate)
        scale = float(
            3 * bodies.Omega[0] ** 2
            + np.abs(bodies.k).sum()
            + np.abs(bodies.radial).sum()
            + np.abs(bodies.normal).sum()
        )
    if scale == 0:
        raise BadInput("equilibria: without orbit and field the body can rest in any orientation")
    units = [abs(float(value)) for value in (point["A"], point["B"], point["C"], rate)]
    if not (min(scale, *units) > 1 / _MAX_SCALE and max(scale, *units) < _MAX_SCALE):
        raise BadInput("equilibria: the numbers of the body differ too much in magnitude")
    frames = _search(bodies, scale)
    index, axis, degenerate = _classify(bodies, frames, scale)
    unit = float(max(point["A"], point["B"], point["C"])) * float(rate) ** 2
    potential = bodies.potential(frames[:, 0], frames[:, 2]) * unit
    points = {name: np.full(len(frames), value) for name, value in point.items()}
    result = _described(points, frames, potential, index) | {
        "circle": ~np.isnan(axis[:, 0]), "axis": axis, "degenerate": degenerate,
    }  # fmt: skip
    result |= _stability(points, result)
    order = np.argsort(potential, kind="stable")
    return {name: result[name][order] for name in _VARIABLES}


_VARIABLES = {
    "theta0": np.nan, "psi0": np.nan, "phi0": np.nan, "alpha": np.nan, "gamma": np.nan, "potential": np.nan,
    "index": np.int8(-1), "circle": False, "axis": np.nan, "degenerate": False,
    "stable": np.int8(Stability.UNKNOWN), "growth_rate": np.nan, **dict.fromkeys(FREQUENCIES, np.nan),
}  # fmt: skip
"""Variables of equilibria, in their order, and what stands in the unused places of padded arrays."""


def _described(points: Points, frames: Array, potential: Array, index: NDArray[Any]) -> dict[str, Any]:
    """Orientation, potential and index of equilibria, each of the body in the same place of points."""
    angles = dict(zip(("theta0", "psi0", "phi0"), _angles(frames), strict=True))
    return {**angles, "alpha": frames[:, 0], "gamma": frames[:, 2], "potential": potential, "index": index}


def _stability(points: Points, described: Mapping[str, Any]) -> dict[str, Any]:
    """Linear stability of equilibria, each of the body in the same place of points."""
    starts = {name: described[name] for name in ("theta0", "psi0", "phi0")}
    starts |= {name: np.zeros(described["theta0"].size) for name in ("n", "m", "theta_dot0")}
    stable, growth = exponents({**points, **starts})
    values = frequencies({**points, **starts}, np.ones_like(stable)).T
    return {"stable": stable, "growth_rate": growth, **dict(zip(FREQUENCIES, values, strict=True))}


def equilibria_of_bodies(
    points: Points, pause: Callable[[], None] = lambda: None, stability: bool = True
) -> dict[str, NDArray[Any]]:
    """All relative equilibria of many bodies, by homotopy continuation; see `homotopy`.

    Bodies of which the continuation does not find all equilibria with certainty, those with circles of them and
    those without an orbit are searched one by one, as `equilibria` does, in about 70 ms each.

    points: as of `equilibria`, arrays (bodies,). pause: called at least once a second; it may raise an
    exception. stability: whether to compute stable, growth_rate and the frequencies. Returns the variables of
    `equilibria`, those of each body in the order of the potential, with unused places at the end: nan, index
    -1, stable 0. completeness (bodies,) int8, values of flags.Completeness.
    """
    count = points["A"].size
    names = [name for name in _VARIABLES if stability or name not in ("stable", "growth_rate", *FREQUENCIES)]
    result: dict[str, NDArray[Any]] = {}
    for name in names:
        shape = (count, homotopy.PATHS, 3) if name in ("alpha", "gamma", "axis") else (count, homotopy.PATHS)
        result[name] = np.full(shape, _VARIABLES[name])
    result["completeness"] = np.full(count, Completeness.COMPLETE, np.int8)
    for first in range(0, count, _BLOCK):
        pause()
        block = {name: points[name][first : first + _BLOCK] for name in _NAMES}
        part = {name: values[first : first + _BLOCK] for name, values in result.items()}
        for i in np.flatnonzero(~_write_block(block, part, stability)):
            pause()
            _write_one({name: float(values[i]) for name, values in block.items()}, part, int(i))
    return result


def _write_block(points: Points, result: dict[str, NDArray[Any]], stability: bool) -> NDArray[np.bool_]:
    """Write the equilibria of bodies of which the continuation finds all, and return which these are."""
    rate = np.where(points["Omega"] == 0, 1.0, points["Omega"])
    with np.errstate(all="ignore"):
        bodies = Bodies(points, rate)
        torques = bodies.radial, bodies.normal - bodies.Omega * bodies.k
        units = np.stack([points[name] for name in ("A", "B", "C", "Omega")])
        usable = ((units > 1 / _MAX_SCALE) & (units < _MAX_SCALE)).all(0)
        usable &= (np.abs(np.concatenate([bodies.k, *torques], -1)) < _MAX_SCALE).all(-1)
    alpha, gamma, real, complete = homotopy.solve(
        *(np.where(usable, vectors.T, 0.0) for vectors in (bodies.inertia, *torques))
    )
    complete &= usable
    body, path = np.nonzero(real.T & complete[:, None])
    members = subset(points, body)
    bodies = Bodies(members, rate[body])
    a, g = alpha[:, path, body].T, gamma[:, path, body].T
    _, hessian = bodies.gradient(a, g)
    values = np.linalg.eigvalsh(0.5 * (hessian + np.swapaxes(hessian, 1, 2)))
    scale = 3 + (np.abs(bodies.k) + np.abs(bodies.radial) + np.abs(bodies.normal)).sum(-1)
    index = (values < 0).sum(1)
    flat = (np.abs(values) < _ZERO_EIGENVALUE * scale[:, None]).any(1)
    complete[body[flat]] = False
    complete &= np.bincount(body, (-1.0) ** index, rate.size) == 0
    unit = np.max([members[name] for name in "ABC"], axis=0) * rate[body] ** 2
    potential = bodies.potential(a, g) * unit
    order = np.lexsort((potential, body))
    order = order[complete[body[order]]]
    members = {name: values[order] for name, values in members.items()}
    frames = np.stack([a, np.cross(g, a), g], 1)[order]
    described = _described(members, frames, potential[order], index[order])
    if stability:
        described |= _stability(members, described)
    row = body[order]
    place = np.arange(row.size) - np.searchsorted(row, row)
    for name, values in described.items():
        result[name][row, place] = values
    return complete


def _write_one(body: Mapping[str, float], result: dict[str, NDArray[Any]], row: int) -> None:
    """Write the equilibria of one body by the search of `equilibria`, and how complete they are."""
    try:
        solutions = equilibria(body)
    except (BadInput, RuntimeError):
        result["completeness"][row] = Completeness.NOT_LISTED
        return
    for name in result.keys() & solutions.keys():
        result[name][row, : solutions[name].shape[0]] = solutions[name]
    isolated = not solutions["circle"].any()
    flag = Completeness.NEAR_BIFURCATION if isolated else Completeness.NOT_ISOLATED
    result["completeness"][row] = flag


def _search(bodies: Bodies, scale: float) -> Array:
    """Frames of the equilibria, one of each circle, shape (E, 3, 3)."""
    generator = np.random.default_rng(0)
    frames, starts, previous_count, total = np.empty((0, 3, 3)), _STARTS, -1, 0
    while len(frames) != previous_count or total != 0:
        if starts > 64 * _STARTS:
            raise RuntimeError(f"equilibria: signed sum of Morse indices {total}, not 0: some were missed")
        previous_count = len(frames)
        new = _critical(bodies, _orientations(generator, starts), scale)
        frames = _distinct(bodies, np.concatenate([frames, new]), scale)
        index, axis, degenerate = _classify(bodies, frames, scale)
        isolated = np.isnan(axis[:, 0])
        total = 0 if degenerate.any() else int(((-1) ** index * isolated).sum())
        starts *= 2
    return frames


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


def _critical(bodies: Bodies, frames: Array, scale: float) -> Array:
    """Orientations to which Newton's method converges from the given ones."""
    frames, active = frames.copy(), np.arange(len(frames))
    for _ in range(40):
        gradient, hessian = bodies.gradient(frames[active, 0], frames[active, 2])
        # Least squares with the Jacobian as it is, not symmetrised: a symmetry of the body makes one of its
        # rows vanish everywhere, and Newton's method across the circles converges quadratically.
        left, values, right = np.linalg.svd(hessian)
        inverse = values / (values**2 + (1e-7 * scale) ** 2)
        step = -np.einsum("nji,nj,nkj,nk->ni", right, inverse, left, gradient)
        length = np.linalg.norm(step, axis=1)
        frames[active] = _rotated(
            frames[active], step * np.minimum(1.0, 0.5 / np.maximum(length, 0.5))[:, None]
        )
        active = active[length > 1e-9]
    gradient, _ = bodies.gradient(frames[:, 0], frames[:, 2])
    return frames[np.linalg.norm(gradient, axis=1) < 1e-11 * scale]


def _classify(
    bodies: Bodies, frames: Array, scale: float
) -> tuple[NDArray[np.int64], Array, NDArray[np.bool_]]:
    """Morse index, axis of the circle of equilibria through each frame (nan: isolated), degenerate or not."""
    _, hessian = bodies.gradient(frames[:, 0], frames[:, 2])
    values, vectors = np.linalg.eigh(0.5 * (hessian + np.swapaxes(hessian, 1, 2)))
    flat = np.abs(values) < _ZERO_EIGENVALUE * scale
    if (flat.sum(1) > 1).any():
        raise BadInput(
            "equilibria: this body has a surface of equilibria, not single ones or circles of them"
        )
    axis = np.einsum("nij,nj->ni", vectors, flat.astype(float))
    # A circle is the orbit of a symmetry, of the body about one of its axes or about the normal.
    turned = _rotated(frames, np.array([0.3, 1.1, 2.5, 4.0])[:, None, None] * axis)
    gradient, _ = bodies.gradient(turned[:, :, 0], turned[:, :, 2])
    circle = flat.any(1) & (np.linalg.norm(gradient, axis=2).max(0) < _ZERO_EIGENVALUE * scale)
    return ((values < 0) & ~flat).sum(1), np.where(circle[:, None], axis, np.nan), flat.any(1) & ~circle


def _distinct(bodies: Bodies, frames: Array, scale: float) -> Array:
    """The first frame of each equilibrium and of each circle of them."""
    _, axis, _ = _classify(bodies, frames, scale)
    kept: list[int] = []
    for i, frame in enumerate(frames):
        rotation = np.swapaxes(frames[kept], 1, 2) @ frame
        distance = np.linalg.norm(rotation - np.eye(3), axis=(1, 2))
        axis_distance = np.linalg.norm(rotation @ axis[i] - axis[i], axis=1)
        if not ((distance < _SAME) | (axis_distance < _SAME)).any():
            kept.append(i)
    return frames[kept]


def _angles(frames: Array) -> tuple[Array, Array, Array]:
    """theta, psi, phi of frames; psi = 0 where only psi +- phi is defined."""
    alpha, beta, gamma = frames[:, 0], frames[:, 1], frames[:, 2]
    upright = np.hypot(gamma[:, 0], gamma[:, 1]) < 1e-9
    psi = np.where(upright, 0.0, np.arctan2(alpha[:, 2], -beta[:, 2]))
    phi = np.where(upright, np.arctan2(-alpha[:, 1], alpha[:, 0]), np.arctan2(gamma[:, 0], gamma[:, 1]))
    return np.arctan2(np.hypot(gamma[:, 0], gamma[:, 1]), gamma[:, 2]), psi, phi
