"""Equations that integrate the losses of first integrals together with the motion.

Where dissipation changes a first integral I at the rate -R, the equations name R in LOSSES. A kernel then has one more
state for I, the sum L of what was lost, with L' = R and L = 0 at the start. I + L is a first integral of the equations
with this state, so that its change measures the error of the integration, as that of I does without dissipation. The
sums L come from the same Runge-Kutta steps as the motion and have errors of the same order.
"""

from __future__ import annotations

import ast
from collections.abc import Collection, Mapping
from types import ModuleType

from ..systems import arithmetic
from .simplify import simplify

# Name under which `with_losses` keeps the function `scaled` for the motion alone; of `unscaled` likewise.
SCALED, UNSCALED = "scaled_motion", "unscaled_motion"


def losses_of(equations: ModuleType, zero: Collection[str], equal: Mapping[str, str]) -> dict[str, str]:
    """First integrals that lose anything, and the functions that return their losses.

    Parameters
    ----------
    equations : module
        See `systems.base.System.equations`.
    zero, equal
        As for `assemble.source`.
    """
    given, sources = getattr(equations, "LOSSES", {}), arithmetic.functions(equations)
    return {
        integral: function
        for integral, function in given.items()
        if not _is_zero(simplify(sources[function], zero, equal))
    }


def with_losses(equations: ModuleType, losses: Mapping[str, str]) -> ModuleType:
    """Equations with a state for the loss of each of these integrals, and without the functions of other losses.

    Parameters
    ----------
    equations : module
    losses : mapping of str to str
        First integral -> function; a part of ``equations.LOSSES``.
    """
    unused = {*getattr(equations, "LOSSES", {}).values()} - {*losses.values()}
    sources = {name: text for name, text in arithmetic.functions(equations).items() if name not in unused}
    names = {name: value for name, value in vars(equations).items() if name.isupper()} | {"LOSSES": losses}
    if losses:
        sums = _new_names(losses, sources)
        names["STATE"] = (*equations.STATE, *sums.values())
        powers = [equations.INTEGRALS[integral] for integral in losses]
        scaling = {name: sources.pop(name) for name in ("scaled", "unscaled")}
        sources = {name: _with_sums(text, losses, sums) for name, text in sources.items()}
        sources |= _scaling(scaling, len(equations.STATE), powers)
    return arithmetic.module_of(equations, names, sources)


def _is_zero(text: str) -> bool:
    """Whether a simplified function returns 0."""
    function = ast.parse(text).body[0]
    assert isinstance(function, ast.FunctionDef)
    match function.body[-1]:
        case ast.Return(value=ast.Constant(value=value)):
            return value == 0
    return False


def _new_names(losses: Mapping[str, str], sources: Mapping[str, str]) -> dict[str, str]:
    """Integral -> name of the sum of its losses, which no function uses."""
    nodes = (node for text in sources.values() for node in ast.walk(ast.parse(text)))
    used, result = {node.id for node in nodes if isinstance(node, ast.Name)}, {}
    for integral in losses:
        name = f"{integral}_lost"
        while name in used:
            name += "_"
        result[integral] = name
    return result


def _with_sums(text: str, losses: Mapping[str, str], sums: Mapping[str, str]) -> str:
    """A function of the state and the sums: the right-hand side has theirs, an integral its sum as one more term."""
    function = ast.parse(text).body[0]
    assert isinstance(function, ast.FunctionDef)
    for statement in function.body:
        match statement:
            case ast.Assign(targets=[ast.Tuple(elts=names)], value=ast.Name(id="state")):
                names += [ast.Name(name) for name in sums.values()]
            case ast.Return(value=ast.Tuple(elts=values)) if function.name == "rhs":
                arguments: list[ast.expr] = [ast.Name("state"), ast.Name("constants")]
                values += [ast.Call(ast.Name(loss), arguments, []) for loss in losses.values()]
            case ast.Return(value=ast.Tuple(elts=values)) if function.name in sums:
                values.append(ast.Name(sums[function.name]))
    return ast.unparse(ast.fix_missing_locations(function))


def _scaling(scaling: Mapping[str, str], states: int, powers: list[int]) -> dict[str, str]:
    """Source of `scaled` and `unscaled` for state and sums, which have the units of their integrals."""
    state = ", ".join(f"y{i}" for i in range(states))
    sums = [f"lost{i}" for i in range(len(powers))]
    times = ", ".join(name + " * h" * power for name, power in zip(sums, powers, strict=True))
    over = ", ".join(name + " / h" * power for name, power in zip(sums, powers, strict=True))
    unpacked = f"    {state}, {', '.join(sums)}, = state\n"
    return {
        SCALED: scaling["scaled"].replace("def scaled(", f"def {SCALED}(", 1),
        UNSCALED: scaling["unscaled"].replace("def unscaled(", f"def {UNSCALED}(", 1),
        "scaled": f"def scaled(state, constants, h):\n{unpacked}"
        f"    y, c = {SCALED}(({state},), constants, h)\n"
        f"    {state}, = y\n"
        f"    return ({state}, {times},), c",
        "unscaled": f"def unscaled(state, constants, h):\n{unpacked}"
        f"    {state}, = {UNSCALED}(({state},), constants, h)\n"
        f"    return ({state}, {over},)",
    }
