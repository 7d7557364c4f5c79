"""All relative equilibria of one gyrostat, or of many gyrostats at once."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...errors import BadInput
from ...flags import Completeness, EnergyStability, Stability, StabilityKind
from ...systems.base import Array, Mask, Points, subset
from ...systems.fixed_point.system import FixedPoint
from ...systems.gyrostat import Gyrostat
from ...systems.gyrostat.body import Body, cross_matrix, transverse_axes
from ...systems.gyrostat.secular import NEARLY, critical_directions
from ...systems.gyrostat.system import FREQUENCIES, stability_kind
from . import homotopy

_STARTS = 200  # number of random orientations from which the first search begins
# Eigenvalues of the Hessian are compared with fractions of `_scale`. Two below `_FLAT` mean a surface of equilibria. One below
# `_DEGENERATE` means a degenerate equilibrium. One below `_UNCERTAIN`, or on circles of equilibria below `_UNCERTAIN_CIRCLE`, makes
# the number of equilibria uncertain. If one is below `_MISSED`, the search may miss equilibria.
_FLAT, _DEGENERATE, _UNCERTAIN, _UNCERTAIN_CIRCLE, _MISSED = 1e-6, 1e-4, 1e-14, 1e-7, 1e-3
_ON_CIRCLE = 1e-13  # largest gradient along a circle of equilibria, as a fraction of `_scale`
_SAME = 1e-4  # Rotation matrices count as equal if their distance is smaller.
# Potentials within `_SAME_POTENTIAL` times `_scale` count as equal. Unit vectors count as equal if `_DECIMALS` decimals agree.
_SAME_POTENTIAL, _DECIMALS = 1e-9, 6
_MAX_SCALE = 1e60  # Nonzero moments, rates and torques are from 1 / _MAX_SCALE to _MAX_SCALE. Products of a few of them are finite.
_BLOCK = 512  # number of bodies that are computed together
NOT_CERTAIN = (
    "equilibria: their number or index is not certain at a bifurcation, or so near to a symmetry;"
    " change a parameter, or make the symmetry exact"
)
ANGLES = ("theta0", "psi0", "phi0")
STABILITY = ("stable", "growth_rate", "energy_stable", "stability_kind", *FREQUENCIES)
_VARIABLES = (*ANGLES, "alpha", "gamma", "potential", "index", "circle", "axis", "degenerate", *STABILITY)
# Unused places of padded arrays have these values, or nan if the variable is not listed here.
_UNUSED = {
    "index": np.int8(-1), "dimension": np.int8(-1), "circle": False, "degenerate": False, "flat": False,
    "stable": np.int8(Stability.UNKNOWN), "energy_stable": np.int8(EnergyStability.UNKNOWN),
    "stability_kind": np.int8(StabilityKind.UNKNOWN),
}  # fmt: skip


def equilibria(system: Gyrostat, points: Points) -> dict[str, NDArray[Any]]:
    """Return all relative equilibria of one body, which are the orientations at rest in the frame.

    `points` maps every parameter to an array (1,), and start values are ignored. The methods are those of `equilibria_of_bodies`.
    Scalar results have the shape (E,). They are theta0, psi0, phi0 (rad), potential (amended), index (Morse index), circle (whether
    the solution stands for a circle of equilibria), degenerate (always False) and `STABILITY`. Vectors in body axes have the shape
    (E, 3). They are alpha, gamma and the axis of the rotations that lead around a circle (nan for isolated equilibria). BadInput is
    raised where a surface of orientations is in equilibrium, where the numbers of the body differ too much in magnitude, and where the
    number of equilibria is not certain.
    """
    (flag,), _, columns = _at_once(system, points, stability=True, ordered=False)
    if flag == Completeness.NOT_LISTED:
        flag, columns = _list_by_search(system, points)
    if flag == Completeness.NEAR_BIFURCATION:
        raise BadInput(NOT_CERTAIN)
    return {name: columns[name] for name in _VARIABLES}


def _list_by_search(system: Gyrostat, points: Points) -> tuple[Completeness, dict[str, NDArray[Any]]]:
    """Find the equilibria of one body by Newton's method from many orientations, or raise BadInput if the list is not complete."""
    given = system.body(points)
    rate = np.where(given.turn == 0, 1.0, given.turn)
    with np.errstate(all="ignore"):
        body = given.scaled(rate)
        scale = float(_scale(body)[0])
    if scale == 0:
        raise BadInput("equilibria: without orbit and field the body can rest in any orientation")
    units = [float(np.abs(value)) for value in (*given.inertia[0], rate[0])]
    if not (min(scale, *units) > 1 / _MAX_SCALE and max(scale, *units) < _MAX_SCALE):
        raise BadInput("equilibria: the numbers of the body differ too much in magnitude")
    frames = _search(body, scale)
    index, axis, _ = _classify(body, frames, scale)
    scaled, circle = body.potential(frames[:, 0], frames[:, 2]), ~np.isnan(axis[:, 0])
    order = _order(np.zeros(len(frames)), scaled / scale, frames, axis)
    result = attitudes(frames) | {
        "potential": scaled * given.inertia.max() * rate**2, "index": index.astype(np.int8), "circle": circle, "axis": axis,
        "degenerate": np.zeros(len(frames), bool),
    }  # fmt: skip
    members = {name: np.full(len(frames), value[0]) for name, value in points.items()}
    result |= stability_at_rest(system, members, {name: result[name] for name in ANGLES})
    flag = Completeness.NOT_ISOLATED if circle.any() else Completeness.COMPLETE
    return flag, {name: values[order] for name, values in result.items()}


def _order(body: NDArray[Any], potential: Array, frames: Array, axis: Array) -> NDArray[np.int64]:
    """Return the order of equilibria by body, by potential as a fraction of `_scale`, and by alpha and gamma.

    On a circle of equilibria the means of alpha and gamma decide. Potentials and components that differ by rounding alone count as
    equal, so that rounding does not decide the order.
    """
    by_potential = np.lexsort((potential, body))
    steps = np.diff(potential[by_potential], prepend=0.0) > _SAME_POTENTIAL
    level = np.empty(body.size, np.int64)
    level[by_potential] = np.cumsum(steps | (np.diff(body[by_potential], prepend=0) > 0))
    vectors = frames[:, [0, 2]]
    mean = (vectors * axis[:, None]).sum(-1, keepdims=True) * axis[:, None]
    components = np.round(np.where(np.isnan(mean), vectors, mean), _DECIMALS).reshape(-1, 6)
    return np.lexsort((*components.T[::-1], level))


def _scale(body: Body) -> Array:
    """Return the size of the gradient of the potential, (bodies,)."""
    vectors = (
        np.abs(body.rotor) + np.abs(body.alpha.field) + np.abs(body.gamma.field) + np.abs(body.beta.field)
    )
    return np.abs(body.alpha.gradient) + np.abs(body.gamma.gradient) + vectors.sum(-1)


def body_at_rest(system: Gyrostat, points: Points) -> Body:
    """Return the body in the frame in which its relative equilibria rest. About a fixed point the frame turns at the rate n."""
    body = system.body(points)
    return body._replace(turn=points["n"]) if isinstance(system, FixedPoint) else body


def frames_of(alpha: Array, gamma: Array) -> Array:
    """Return frames with the rows alpha, gamma x alpha and gamma, (..., 3, 3)."""
    return np.stack([alpha, np.cross(gamma, alpha), gamma], -2)


def rotated(frames: Array, xi: Array) -> Array:
    """Return the frames after the body has turned by the rotation vectors `xi`, given in body axes."""
    angle = np.linalg.norm(xi, axis=-1)[..., None, None]
    hat = cross_matrix(xi)
    turn = np.eye(3) + np.sinc(angle / np.pi) * hat + 0.5 * np.sinc(angle / (2 * np.pi)) ** 2 * (hat @ hat)
    return frames @ turn


def attitudes(frames: Array) -> dict[str, Any]:
    """Return Euler angles, alpha and gamma of frames (..., 3, 3). Where only psi +- phi is defined, psi0 is 0."""
    alpha, beta, gamma = np.moveaxis(frames, -2, 0)
    sine = np.hypot(gamma[..., 0], gamma[..., 1])
    upright = sine < 1e-9
    turn = np.arctan2(-alpha[..., 1], alpha[..., 0])
    return {
        "theta0": np.arctan2(sine, gamma[..., 2]),
        "psi0": np.where(upright, 0.0, np.arctan2(alpha[..., 2], -beta[..., 2])),
        "phi0": np.where(upright, turn, np.arctan2(gamma[..., 0], gamma[..., 1])),
        "alpha": alpha, "gamma": gamma,
    }  # fmt: skip


def stability_at_rest(
    system: Gyrostat, members: Points, start: Mapping[str, Array]
) -> dict[str, NDArray[Any]]:
    """Return stability and frequencies of E equilibria. `members` has their bodies, and `start` has their angles and rates."""
    rest = {name: np.zeros_like(members["A"]) for name in ("n", "m", "theta_dot0")}
    points = {**members, **rest, **start}
    stable, growth = system.stability(points)
    every = np.ones_like(stable)
    energy, (_, axial) = system.energy_stability(points, every), system.conservative_stability(points, every)
    return {
        "stable": stable, "growth_rate": growth, "energy_stable": energy,
        "stability_kind": stability_kind(stable, growth, energy, axial),
        **dict(zip(FREQUENCIES, system.frequencies(points, every).T, strict=True)),
    }  # fmt: skip


def equilibria_of_bodies(
    system: Gyrostat,
    points: Points,
    pause: Callable[[], None] = lambda: None,
    stability: bool = True,
    ordered: bool = False,
) -> dict[str, NDArray[Any]]:
    """Return all relative equilibria of many bodies. Homotopy continuation finds those of bodies on an orbit (see `homotopy`).

    A secular equation gives the equilibria of bodies whose symmetry about an axis is exact to the last bit. A complete list passes two
    tests. The sum of (-1)^index is that of Poincare and Hopf's theorem, 0 on SO(3) and 2 on the sphere of an axis of symmetry. The sign
    of every eigenvalue of the Hessian is certain. Near a symmetry, moments must therefore differ by at least 1e-12 of the largest one.
    Near a bifurcation, solutions must be at least 1e-5 apart. Else completeness is NEAR_BIFURCATION, and solutions that merge are
    listed once, as degenerate. Bodies with A = B = C, without an orbit, or with a lost path are searched one by one, in about 70 ms each.

    `pause` is called at least once a second and may raise an exception. `stability` asks for the variables `STABILITY`. `ordered`
    adds attitudes near complex solutions, with index -1 (see `homotopy.solve`). Arrays (bodies, places) are in the order of the
    potential and then of the attitude. Unused places are last. They have nan, index -1 and stable 0. completeness (bodies,) has values
    of `flags.Completeness`.
    """
    count = points["A"].size
    completeness = np.empty(count, np.int8)
    parts = []
    for first in range(0, count, _BLOCK):
        pause()
        block = np.arange(first, min(first + _BLOCK, count))
        flags, row, columns = _at_once(system, subset(points, block), stability, ordered)
        parts.append({"row": block[row], **columns})
        for i in np.flatnonzero(flags == Completeness.NOT_LISTED):
            pause()
            try:
                flags[i], solutions = _list_by_search(system, subset(points, block[[i]]))
            except BadInput:
                continue
            parts.append({"row": np.full(solutions["index"].size, block[i]), **solutions})
        completeness[block] = flags
    names = [name for name in _VARIABLES if stability or name not in STABILITY]
    columns = {name: np.concatenate([part[name] for part in parts]) for name in ("row", *names)}
    return padded(columns, count, homotopy.PATHS) | {"completeness": completeness}


def numbers(equilibria: Mapping[str, NDArray[Any]]) -> dict[str, Array]:
    """Count all equilibria, linearly stable equilibria and minima of each body. Counts are nan for lists that are not complete."""
    complete = equilibria["completeness"] == Completeness.COMPLETE
    masks = {
        "equilibrium_count": equilibria["index"] >= 0,
        "equilibrium_stable_count": equilibria["stable"] == Stability.STABLE,
        "equilibrium_energy_stable_count": equilibria["index"] == 0,
    }
    return {name: np.where(complete, mask.sum(1), np.nan) for name, mask in masks.items()}


def padded(columns: Mapping[str, NDArray[Any]], count: int, places: int) -> dict[str, NDArray[Any]]:
    """Return columns over all equilibria as arrays (bodies, places). The column "row" tells the body of each equilibrium."""
    order = np.argsort(columns["row"], kind="stable")
    row = columns["row"][order]
    place = np.arange(row.size) - np.searchsorted(row, row)
    result = {}
    for name, values in columns.items():
        if name != "row":
            shape = (count, places, *values.shape[1:])
            result[name] = np.full(shape, _UNUSED.get(name, np.nan), values.dtype)
            result[name][row, place] = values[order]
    return result


def _at_once(
    system: Gyrostat, points: Points, stability: bool, ordered: bool
) -> tuple[NDArray[np.int8], NDArray[np.int64], dict[str, NDArray[Any]]]:
    """List the equilibria of all bodies. Return the `Completeness` of each body, and the body and the variables of each equilibrium."""
    given = system.body(points)
    rate = np.where(given.turn == 0, 1.0, given.turn)
    with np.errstate(all="ignore"):
        bodies = given.scaled(rate)
        alpha, gamma = bodies.amended()
        units = np.concatenate([given.inertia, given.turn[:, None]], 1)
        usable = ((units > 1 / _MAX_SCALE) & (units < _MAX_SCALE)).all(1)
        vectors = np.concatenate([bodies.rotor, alpha.field, bodies.beta.field, gamma.field], -1)
        size = np.abs(vectors)
        usable &= ((size == 0) | ((size > 1 / _MAX_SCALE) & (size < _MAX_SCALE))).all(-1)
        usable &= (np.abs(alpha.gradient - 3) < 1e-9) & (np.abs(gamma.gradient + 1) < 1e-9)
    axes = np.stack([given.symmetric_about(i) for i in range(3)], 1)
    symmetric = np.asarray(axes.any(1))
    general, single = np.flatnonzero(usable & ~symmetric), np.flatnonzero(usable & (axes.sum(1) == 1))
    p, r, q = (direction.field[general].T for direction in (alpha, bodies.beta, gamma))
    a, g, real, nearly, complete = homotopy.solve(bodies.inertia[general].T, p, r, q, ordered)
    body, path = np.nonzero((real | nearly & ordered).T)
    a, g = a[:, path, body].T, g[:, path, body].T
    row, frames, known = _by_symmetry(bodies.subset(single), axes[single].argmax(1), ordered)
    row = np.concatenate([general[body], single[row]])
    frames = np.concatenate([frames_of(a, g), frames])
    real = np.concatenate([real[path, body], known])
    bodies, circle = bodies.subset(row), symmetric[row]
    scale, values = _scale(bodies), np.linalg.eigvalsh(bodies.hessian(frames[:, 0], frames[:, 2]))
    # Rounding errors alone make the eigenvalue along a circle differ from 0.
    values[circle, np.abs(values[circle]).argmin(1)] = np.inf
    least = np.abs(values).min(1) / scale
    index = np.where(real, (values < 0).sum(1), -1)

    def some(of_solutions: Mask) -> Mask:
        return np.bincount(row[real & of_solutions], minlength=rate.size) > 0

    sums = np.bincount(row[real], (-1.0) ** index[real], rate.size)
    uncertain = some(least < np.where(circle, _UNCERTAIN_CIRCLE, _UNCERTAIN)) | (sums != 2 * symmetric)
    uncertain[general[~complete]] = True
    flags = np.where(symmetric, Completeness.NOT_ISOLATED, Completeness.COMPLETE).astype(np.int8)
    flags[uncertain] = Completeness.NEAR_BIFURCATION
    degenerate = uncertain[row] & (least < _DEGENERATE)
    flags[(uncertain & ~some(degenerate)) | ~some(real)] = Completeness.NOT_LISTED
    scaled = bodies.potential(frames[:, 0], frames[:, 2])
    potential = scaled * given.inertia.max(1)[row] * rate[row] ** 2
    axis = np.where(circle[:, None], axes[row], np.nan)
    order = _order(row, scaled / scale, frames, axis)
    order = order[flags[row[order]] != Completeness.NOT_LISTED]
    row = row[order]
    result = attitudes(frames[order]) | {
        "potential": potential[order], "index": index[order].astype(np.int8), "circle": circle[order], "axis": axis[order],
        "degenerate": degenerate[order],
    }  # fmt: skip
    if stability:
        angles = {name: result[name] for name in ANGLES}
        result |= stability_at_rest(system, subset(points, row), angles)
    return flags, row, result


def _by_symmetry(bodies: Body, i: NDArray[np.int64], ordered: bool) -> tuple[NDArray[np.int64], Array, Mask]:
    """Return the body and the frame of each solution, and whether the solution is real. The bodies are symmetric about the axes `i`."""
    own = np.arange(i.size)
    excess, none = bodies.inertia[own, i] - bodies.inertia[own, (i + 1) % 3], np.zeros(i.size)
    alpha, gamma = bodies.amended()
    d = np.array([alpha.gradient * excess, none, gamma.gradient * excess])
    b = np.array([alpha.field[own, i], bodies.beta.field[own, i], gamma.field[own, i]])
    components, dimension = critical_directions(d, b, nearly=ordered)
    column, body = np.nonzero(((dimension == 0) | (dimension == NEARLY)) & ~(dimension > 0).any(0))
    axis = components[:, column, body].T
    frames, columns = np.empty((body.size, 3, 3)), (i[body, None] + np.arange(3)) % 3
    vectors = np.concatenate([axis[:, None], transverse_axes(axis)], 1)
    np.put_along_axis(frames, columns[:, None], np.swapaxes(vectors, 1, 2), 2)
    return body, frames, dimension[column, body] == 0


def _search(bodies: Body, scale: float) -> Array:
    """Return frames (E, 3, 3) of the equilibria, one for each circle of equilibria."""
    generator = np.random.default_rng(0)
    frames, starts, previous_count, is_whole = np.empty((0, 3, 3)), _STARTS, -1, False
    while len(frames) != previous_count or not is_whole:
        if starts > 64 * _STARTS:
            raise BadInput(NOT_CERTAIN)
        previous_count = len(frames)
        # The orientations are uniform, with the rows alpha, beta and gamma in body axes.
        w, x, y, z = np.moveaxis(generator.normal(size=(starts, 4)), -1, 0)
        first = np.stack([w * w + x * x - y * y - z * z, 2 * (x * y + w * z), 2 * (x * z - w * y)], -1)
        second = np.stack([2 * (x * y - w * z), w * w - x * x + y * y - z * z, 2 * (y * z + w * x)], -1)
        third = np.cross(first, second) / (w * w + x * x + y * y + z * z)[:, None]
        rows = np.stack([first, second, third], 1)
        new = _critical(bodies, rows / np.linalg.norm(rows, axis=2, keepdims=True), scale)
        frames = _distinct(bodies, np.concatenate([frames, new]), scale)
        index, axis, degenerate = _classify(bodies, frames, scale)
        # With a symmetry every equilibrium is on a circle.
        circle = ~np.isnan(axis[:, 0])
        total = 2 * circle.any()
        if degenerate.any():
            raise BadInput(NOT_CERTAIN)
        whole = circle.all() == circle.any() and len(frames) >= 4 - total and ((-1) ** index).sum() == total
        is_whole = bool(whole)
        starts *= 2
    return frames


def _critical(bodies: Body, frames: Array, scale: float) -> Array:
    """Return the orientations to which Newton's method converges from the given orientations."""
    frames, active = frames.copy(), np.arange(len(frames))
    for _ in range(40):
        gradient, hessian = bodies.gradient(frames[active, 0], frames[active, 2])
        # With a symmetry, `hessian` has rank 2 at every orientation. So least-squares steps converge fast to circles of equilibria.
        left, values, right = np.linalg.svd(hessian)
        inverse = values / (values**2 + (1e-7 * scale) ** 2)
        step = -np.einsum("nji,nj,nkj,nk->ni", right, inverse, left, gradient)
        length = np.linalg.norm(step, axis=1)
        step *= np.minimum(1.0, 0.5 / np.maximum(length, 0.5))[:, None]
        frames[active] = rotated(frames[active], step)
        active = active[length > 1e-9]
    gradient, _ = bodies.gradient(frames[:, 0], frames[:, 2])
    return frames[np.linalg.norm(gradient, axis=1) < 1e-11 * scale]


def _classify(bodies: Body, frames: Array, scale: float) -> tuple[NDArray[np.int64], Array, Mask]:
    """Return Morse indices, axes of rotations that lead around circles of equilibria (or nan), and whether equilibria are degenerate."""
    values, vectors = np.linalg.eigh(bodies.hessian(frames[:, 0], frames[:, 2]))
    flat = np.abs(values) < _MISSED * scale
    if ((np.abs(values) < _FLAT * scale).sum(1) > 1).any():
        raise BadInput(
            "equilibria: this body has a surface of equilibria, not single ones or circles of them"
        )
    axis = np.take_along_axis(vectors, np.abs(values).argmin(1)[:, None, None], 2)[..., 0]
    # Rotations about a symmetry axis of the body, or about gamma, lead around a circle of equilibria.
    turned = rotated(frames, np.array([0.3, 1.1, 2.5, 4.0])[:, None, None] * axis)
    gradient, _ = bodies.gradient(turned[:, :, 0], turned[:, :, 2])
    circle = flat.any(1) & (np.linalg.norm(gradient, axis=2).max(0) < _ON_CIRCLE * scale)
    return ((values < 0) & ~flat).sum(1), np.where(circle[:, None], axis, np.nan), flat.sum(1) > circle


def _distinct(bodies: Body, frames: Array, scale: float) -> Array:
    """Return the frames without repetitions. Frames on one circle of equilibria count as equal."""
    _, axis, _ = _classify(bodies, frames, scale)
    kept: list[int] = []
    for i, frame in enumerate(frames):
        rotation = np.swapaxes(frames[kept], 1, 2) @ frame
        distance = np.linalg.norm(rotation - np.eye(3), axis=(1, 2))
        axis_distance = np.linalg.norm(rotation @ axis[i] - axis[i], axis=1)
        if not ((distance < _SAME) | (axis_distance < _SAME)).any():
            kept.append(i)
    return frames[kept]
