"""Equations with additional states for losses of first integrals, a direction at rest in the frame, or a tangent vector.

If dissipation changes a first integral I at the rate -R, the equations name R in LOSSES. A kernel then has an additional state
L, the loss of I, with L' = R and L = 0 at the start. I + L is a first integral of the extended equations. The change of I + L
measures the error of the integration, because the same Runge-Kutta steps integrate L and the motion.

A tangent vector obeys the variational equations. The equations may name in FRAME_VECTORS unit vectors v that are at rest in the
frame. The components of v are along body axes, so that v' = v x u with the angular velocity u relative to the frame. If there
are two or more such vectors, a small vector eta describes a change of the attitude as a rotation. Then dv = v x eta, and the
Jacobi identity gives

    eta' = du + eta x u.

Three components thus replace the changes of all vectors, and preserve lengths and angles. Every other state has one component.
"""

from __future__ import annotations

import ast
from collections.abc import Collection, Iterable, Mapping
from functools import cache
from types import ModuleType

import numpy as np

from ..systems import arithmetic
from ..systems.base import Array
from .differentiate import PREFIX, differential, function_tree, simplify

# `_with_states` keeps the functions `scaled` and `unscaled` of the original states under these names.
SCALED, UNSCALED = "scaled_motion", "unscaled_motion"


def losses_of(equations: ModuleType, zero: Collection[str], equal: Mapping[str, str]) -> dict[str, str]:
    """Return the name of the loss function of each first integral whose loss does not vanish identically."""
    sources, losses = arithmetic.functions(equations), {}
    for integral, function in getattr(equations, "LOSSES", {}).items():
        match function_tree(simplify(sources[function], zero, equal)).body[-1]:
            case ast.Return(value=ast.Constant(value=0)):
                pass
            case _:
                losses[integral] = function
    return losses


def with_losses(equations: ModuleType, losses: Mapping[str, str]) -> ModuleType:
    """Return the equations with an additional state for each of these losses. Functions of other losses are removed."""
    unused = {*getattr(equations, "LOSSES", {}).values()} - {*losses.values()}
    sources = {name: text for name, text in arithmetic.functions(equations).items() if name not in unused}
    names = {name: value for name, value in vars(equations).items() if name.isupper()} | {"LOSSES": losses}
    if losses:
        sum_names = _new_names([f"{integral}_lost" for integral in losses], sources)
        sums = dict(zip(losses, sum_names, strict=True))
        names["STATE"] = (*equations.STATE, *sums.values())
        powers = [equations.INTEGRALS[integral] for integral in losses]
        sources = _with_states(sources, len(equations.STATE), losses, sums, powers)
    return arithmetic.module_of(equations, names, sources)


@cache
def with_frame_vector(equations: ModuleType) -> ModuleType:
    """Return the equations with a function `axis_in_frame`. Equations without a frame are returned unchanged.

    If the function is missing, three states are added. They are the components of the frame's first axis a in body axes, so that
    a' = a x u with the angular velocity u from ``frame_motion``. Unlike psi, these states are regular everywhere.
    """
    sources = arithmetic.functions(equations)
    if "axis_in_frame" in sources or "frame_motion" not in sources:
        return equations
    names = _new_names(["x1", "x2", "x3"], sources)
    x1, x2, x3 = names
    state, motion = ", ".join(equations.STATE), "u1, u2, u3, g1, g2, g3 = frame_motion(state, constants)"
    rates = {x1: f"{x2} * u3 - {x3} * u2", x2: f"{x3} * u1 - {x1} * u3", x3: f"{x1} * u2 - {x2} * u1"}
    texts = {f"{name}_rate": rate for name, rate in rates.items()}
    texts["axis_in_frame"] = f"{x3}, g1 * {x2} - g2 * {x1}"
    for name, text in texts.items():
        sources[name] = (
            f"def {name}(state, constants):\n    {state}, = state\n    {motion}\n    return {text}"
        )
    functions, keys = {name: f"{name}_rate" for name in names}, dict(zip(names, names, strict=True))
    sources = _with_states(sources, len(equations.STATE), functions, keys, [0, 0, 0])
    capitals = {name: value for name, value in vars(equations).items() if name.isupper()}
    return arithmetic.module_of(
        equations, capitals | {"STATE": (*equations.STATE, *names), "LOSSES": {}}, sources
    )


def _new_names(names: Iterable[str], sources: Mapping[str, str]) -> list[str]:
    """Return the names, each with as many underscores as it takes to differ from all names in `sources`."""
    occupied, result = arithmetic.names_in(*sources.values()), []
    for name in names:
        while name in occupied:
            name += "_"
        result.append(name)
    return result


def _with_states(
    sources: Mapping[str, str],
    states: int,
    rates: Mapping[str, str],
    names: Mapping[str, str],
    powers: list[int],
) -> dict[str, str]:
    """Return sources with added states. `scaled` multiplies state i by (time unit)^powers[i]. Integrals in `names` gain a state."""
    scaled, unscaled = sources["scaled"], sources["unscaled"]
    extended = {}
    for name, text in sources.items():
        if name in ("scaled", "unscaled"):
            continue
        function = function_tree(text)
        for statement in function.body:
            match statement:
                case ast.Assign(targets=[ast.Tuple(elts=elements)], value=ast.Name(id="state")):
                    elements += [ast.Name(new) for new in names.values()]
                case ast.Return(value=ast.Tuple(elts=values)) if name == "rhs":
                    arguments: list[ast.expr] = [ast.Name("state"), ast.Name("constants")]
                    values += [ast.Call(ast.Name(rate), arguments, []) for rate in rates.values()]
                case ast.Return(value=ast.Tuple(elts=values)) if name in names:
                    values.append(ast.Name(names[name]))
        extended[name] = ast.unparse(ast.fix_missing_locations(function))
    state = ", ".join(f"y{i}" for i in range(states))
    sums = [f"lost{i}" for i in range(len(powers))]
    times = ", ".join(name + " * h" * power for name, power in zip(sums, powers, strict=True))
    over = ", ".join(name + " / h" * power for name, power in zip(sums, powers, strict=True))
    unpacked = f"    {state}, {', '.join(sums)}, = state\n"
    return extended | {
        SCALED: scaled.replace("def scaled(", f"def {SCALED}(", 1),
        UNSCALED: unscaled.replace("def unscaled(", f"def {UNSCALED}(", 1),
        "scaled": f"def scaled(state, constants, h):\n{unpacked}"
        f"    y, c = {SCALED}(({state},), constants, h)\n"
        f"    {state}, = y\n"
        f"    return ({state}, {times},), c",
        "unscaled": f"def unscaled(state, constants, h):\n{unpacked}"
        f"    {state}, = {UNSCALED}(({state},), constants, h)\n"
        f"    return ({state}, {over},)",
    }


# Components of the initial tangent vector before it is normalised. The vector lies in no plane of symmetry.
START, START_OF_ROTATION = (5.0, -4.0, 6.0), (3.0, 4.0, -3.0)


def frame_vectors(equations: ModuleType) -> tuple[tuple[str, str, str], ...]:
    """Return the triples of states that form vectors at rest in the frame."""
    return getattr(equations, "FRAME_VECTORS", ())


def rotates(equations: ModuleType) -> bool:
    """Whether the tangent vector contains a rotation instead of the changes of the frame's vectors."""
    return len(frame_vectors(equations)) > 1


def own_components(equations: ModuleType) -> list[int]:
    """Return the indices of the states whose changes are components of the tangent vector. A rotation stands for the other changes."""
    rotated = (
        {name for vector in frame_vectors(equations) for name in vector} if rotates(equations) else set()
    )
    return [i for i, name in enumerate(equations.STATE) if name not in rotated]


def tangent_size(equations: ModuleType) -> int:
    return len(own_components(equations)) + (3 if rotates(equations) else 0)


def variation(equations: ModuleType, rhs: str) -> dict[str, str]:
    """Return the sources of ``rhs_change(state, constants, change)`` and ``variation(state, constants, tangent)`` by name.

    ``variation`` is the time derivative of the tangent vector.
    """
    own, names = own_components(equations), list(equations.STATE)
    changes = [f"t{j}" for j in range(len(own))]
    lines = [f"{', '.join(names)}, = state"]
    if rotates(equations):
        lines.append(f"{', '.join([*changes, 'e1', 'e2', 'e3'])}, = tangent")
        change = {names[i]: f"t{j}" for j, i in enumerate(own)}
        for x, y, z in frame_vectors(equations):
            change |= {x: f"{y} * e3 - {z} * e2", y: f"{z} * e1 - {x} * e3", z: f"{x} * e2 - {y} * e1"}
        lines.append(f"change = ({', '.join(change[name] for name in names)},)")
        slopes = [f"{PREFIX}{i}" for i in range(len(names))]
        lines += [
            f"{', '.join(slopes)}, = rhs_change(state, constants, change)",
            "u1, u2, u3, v1, v2, v3 = frame_motion(state, constants)",
            "du1, du2, du3, dv1, dv2, dv3 = frame_motion(change, constants)",  # frame_motion is linear
        ]
        rotation = ["du1 + e2 * u3 - e3 * u2", "du2 + e3 * u1 - e1 * u3", "du3 + e1 * u2 - e2 * u1"]
        lines.append(f"return ({', '.join([*(slopes[i] for i in own), *rotation])},)")
    else:
        lines.append("return rhs_change(state, constants, tangent)")
    return {
        "rhs_change": differential(rhs, "rhs_change"),
        "variation": "\n    ".join(["def variation(state, constants, tangent):", *lines]),
    }


def tangent_start(equations: ModuleType, state: Array) -> Array:
    """Return tangent vectors of norm 1 at the start, (size, points). Rates are in the unit in which the norm is taken."""
    names, own = list(equations.STATE), own_components(equations)
    pattern = (*START, *START_OF_ROTATION)
    vectors = frame_vectors(equations)
    length = len(START if vectors else pattern)
    rows = [np.full(state.shape[1], pattern[j % length]) for j in range(len(own))]
    if rotates(equations):
        rows += [np.full(state.shape[1], value) for value in START_OF_ROTATION]
    elif vectors:  # the change of a unit vector is normal to the vector
        indices = [names.index(name) for name in vectors[0]]
        for i, row in zip(indices, np.cross(state[indices].T, START_OF_ROTATION).T, strict=True):
            rows[own.index(i)] = row
    tangent = np.array(rows)
    return np.ascontiguousarray(tangent / np.sqrt((tangent * tangent).sum(0)))
