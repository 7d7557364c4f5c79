"""Equations with more states: the losses of first integrals, a direction at rest in the frame, a tangent vector.

Where dissipation changes a first integral I at the rate -R, the equations name R in LOSSES. A kernel then has one more state
for I, its loss L, with L' = R and L = 0 at the start. I + L is a first integral of the equations with this state, so that its
change measures the error of the integration: L comes from the same Runge-Kutta steps as the motion.

A tangent vector obeys the variational equations. The equations may name unit vectors v at rest in the frame (`FRAME_VECTORS`,
components along body axes: v' = v x u, u the angular velocity relative to the frame). With two or more of them a change of the
attitude is a rotation by a small vector eta of the body's axes: dv = v x eta, and, by the Jacobi identity,

    eta' = du + eta x u.

Three components thus replace the changes of all vectors, and keep lengths and angles; every other state has one component.
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

# Names under which `with_losses` keeps the functions `scaled` and `unscaled` of the motion alone.
SCALED, UNSCALED = "scaled_motion", "unscaled_motion"


def losses_of(equations: ModuleType, zero: Collection[str], equal: Mapping[str, str]) -> dict[str, str]:
    """First integral -> name of the function of its loss, for losses that do not vanish identically."""
    sources, losses = arithmetic.functions(equations), {}
    for integral, function in getattr(equations, "LOSSES", {}).items():
        match function_tree(simplify(sources[function], zero, equal)).body[-1]:
            case ast.Return(value=ast.Constant(value=0)):
                pass
            case _:
                losses[integral] = function
    return losses


def with_losses(equations: ModuleType, losses: Mapping[str, str]) -> ModuleType:
    """Equations with a state for each of these losses, and without the functions of other losses."""
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
    """Equations of a body with `axis_in_frame`; equations without a frame are returned unchanged.

    Where it is missing, three more states hold the first axis of the frame in body axes, x' = x x u with the angular velocity u
    of ``frame_motion``. Unlike psi they are regular everywhere.
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
    """The names, with underscores added until no function uses them."""
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
    """Functions with new states, whose units contain `powers` of a rate; an integral gets its loss as one more term."""
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


# Initial tangent vector, not normalised, for states and for the rotation; it is in no plane of symmetry.
START, START_OF_ROTATION = (5.0, -4.0, 6.0), (3.0, 4.0, -3.0)


def frame_vectors(equations: ModuleType) -> tuple[tuple[str, str, str], ...]:
    """Triples of states that are vectors at rest in the frame."""
    return getattr(equations, "FRAME_VECTORS", ())


def rotates(equations: ModuleType) -> bool:
    """Whether the tangent vector contains a rotation instead of the changes of the frame's vectors."""
    return len(frame_vectors(equations)) > 1


def own_components(equations: ModuleType) -> list[int]:
    """Indices of the states with a component in the tangent vector; the rotation replaces the others."""
    rotated = (
        {name for vector in frame_vectors(equations) for name in vector} if rotates(equations) else set()
    )
    return [i for i, name in enumerate(equations.STATE) if name not in rotated]


def tangent_size(equations: ModuleType) -> int:
    return len(own_components(equations)) + (3 if rotates(equations) else 0)


def variation(equations: ModuleType, rhs: str) -> dict[str, str]:
    """Sources by name of ``rhs_change(state, constants, change)`` and ``variation(state, constants, tangent)``.

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
    """Tangent vectors of norm 1 at the start, (size, points), with rates in the unit in which the norm takes them."""
    names, own = list(equations.STATE), own_components(equations)
    pattern = (*START, *START_OF_ROTATION)
    vectors = frame_vectors(equations)
    length = len(START if vectors else pattern)
    rows = [np.full(state.shape[1], pattern[j % length]) for j in range(len(own))]
    if rotates(equations):
        rows += [np.full(state.shape[1], value) for value in START_OF_ROTATION]
    elif vectors:  # a change of a unit vector is normal to it
        indices = [names.index(name) for name in vectors[0]]
        for i, row in zip(indices, np.cross(state[indices].T, START_OF_ROTATION).T, strict=True):
            rows[own.index(i)] = row
    tangent = np.array(rows)
    return np.ascontiguousarray(tangent / np.sqrt((tangent * tangent).sum(0)))
