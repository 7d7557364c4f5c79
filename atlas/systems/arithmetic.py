"""Check the equations of a system as source text, and add functions that the author omitted.

The kernels contain this source. The functions may therefore use only the state, the constants, names assigned before
and FUNCTIONS of one number. Mistakes are found in the syntax tree before anything is compiled.
"""

from __future__ import annotations

import ast
import inspect
import textwrap
import threading
from collections.abc import Callable, Collection, KeysView, Mapping, Sequence
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np

from ..errors import BadInput, allowed_text, shown

# Functions that equations may call, with the names that NumPy has for them.
FUNCTIONS = {
    "sqrt": "sqrt", "sin": "sin", "cos": "cos", "tan": "tan", "asin": "arcsin", "acos": "arccos", "atan": "arctan",
    "sinh": "sinh", "cosh": "cosh", "tanh": "tanh", "exp": "exp", "log": "log",
}  # fmt: skip
# Constant that is added to equations without `scaled`. It is the unit of time of a kernel, measured in time units.
TIME_UNIT = "time_unit"
# A thread holds this lock while it parses, so that no other thread sees an unfinished module. Python 3.11 also raises
# SystemError if two threads convert syntax trees at once, because it counts the recursion of all threads together.
PARSING = threading.RLock()
_ALLOWED = f"allowed: the state, the constants, names assigned before, {', '.join(FUNCTIONS)}"
_PLAIN = f"allowed: assignments and one return of + - * / **, numbers, {', '.join(FUNCTIONS)}"


def functions(equations: Any) -> dict[str, str]:
    """Return the sources of all functions of a module or class of equations, by name and without docstrings."""
    return {name: ast.unparse(node) for name, node in function_trees(equations).items()}


def function_trees(equations: Any) -> dict[str, ast.FunctionDef]:
    """Return the syntax trees of all functions of a module or class, by name. Docstrings and decorators are left out.

    A starred name among unpacked constants is replaced by the names of the constants for which it stands.
    """
    constants = getattr(equations, "CONSTANTS", ())
    sources = getattr(equations, "SOURCES", None)
    file = getattr(equations, "__file__", None)
    if sources is not None:
        texts = list(sources.values())
    elif file is not None:
        texts = [Path(file).read_text(encoding="utf-8")]
    else:
        members = [getattr(value, "__func__", value) for value in vars(equations).values()]
        texts = [textwrap.dedent(inspect.getsource(f)) for f in members if inspect.isfunction(f)]
    nodes = [node for text in texts for node in ast.parse(text).body if isinstance(node, ast.FunctionDef)]
    for node in nodes:
        node.decorator_list = []
        if ast.get_docstring(node) is not None:
            node.body = node.body[1:] or [ast.Pass()]
        for statement in node.body:
            match statement:
                case ast.Assign(targets=[ast.Tuple(elts=names)], value=ast.Name(id="constants")):
                    for i in [i for i, name in enumerate(names) if isinstance(name, ast.Starred)]:
                        rest = constants[i : len(constants) - len(names) + i + 1]
                        names[i : i + 1] = [ast.Name(name, ast.Store()) for name in rest]
    return {node.name: node for node in nodes}


def _used(equations: Any, observables: Collection[str]) -> dict[str, ast.FunctionDef]:
    """Return the syntax trees of the functions that belong to the equations. A module may contain other functions."""
    used = {"rhs", "frame_motion", "axis_in_frame", "scaled", "unscaled", *observables}
    used |= {name for name in getattr(equations, "INTEGRALS", ()) if isinstance(name, str)}
    used |= {name for name in getattr(equations, "LOSSES", {}).values() if isinstance(name, str)}
    return {name: node for name, node in function_trees(equations).items() if name in used}


def names_in(*parts: str | ast.AST) -> KeysView[str]:
    """Return the names in texts or syntax trees, each once, in the order of `ast.walk`."""
    trees = (ast.parse(part) if isinstance(part, str) else part for part in parts)
    return dict.fromkeys(
        node.id for tree in trees for node in ast.walk(tree) if isinstance(node, ast.Name)
    ).keys()


def numpy_functions() -> dict[str, Callable[..., Any]]:
    """Return the NumPy functions for FUNCTIONS, by their names in equations."""
    return {name: getattr(np, numpy_name) for name, numpy_name in FUNCTIONS.items()}


def value(key: str, text: str, names: Mapping[str, Any]) -> Any:
    """Evaluate arithmetic with pi, FUNCTIONS and `names`. If the text contains anything else, raise BadInput that begins with `key`."""
    known = {**numpy_functions(), "pi": np.pi, **names}
    try:
        tree = ast.parse(text, mode="eval")
    except SyntaxError:
        raise BadInput(f"{key} = {shown(text)} is not arithmetic; {_PLAIN}") from None
    _check_expression(f"{key} = {shown(text)}", tree.body, {*known})
    with np.errstate(all="ignore"):
        return eval(compile(tree, text, "eval"), known)


def completed(equations: Any, observables: Collection[str]) -> ModuleType:
    """Return equations with every member that kernels read. Functions are compiled from source, so that FUNCTIONS such as sin take arrays.

    Equations without ``scaled`` and ``unscaled`` receive both functions. TIME_UNIT becomes the last constant and multiplies
    the right-hand side, the angular velocity of ``frame_motion`` and the losses. The state keeps its units.
    """
    nodes = _used(equations, observables)
    names = {name: value for name, value in vars(equations).items() if name.isupper() or name == "__file__"}
    names = {"CONSTANTS": (), "ONES": (), "INTEGRALS": {}, "LOSSES": {}} | names
    if "scaled" not in nodes:
        given = len(names["CONSTANTS"])
        names["CONSTANTS"] = (*names["CONSTANTS"], TIME_UNIT)
        names["ONES"], names["INTEGRALS"] = (), dict.fromkeys(names["INTEGRALS"], 0)
        # Number of leading components of each function that are rates. None means all components.
        rates = {"rhs": None, "frame_motion": 3} | dict.fromkeys(names["LOSSES"].values())
        nodes = {name: _with_time_unit(node, given, rates) for name, node in nodes.items()}
        states, constants = ", ".join(names["STATE"]), ", ".join(names["CONSTANTS"])
        text = (
            f"def scaled(state, constants, h):\n    {constants}, = constants\n"
            f"    return state, ({constants.removesuffix(TIME_UNIT)}{TIME_UNIT} * h,)\n"
            f"def unscaled(state, constants, h):\n    {states}, = state\n    return ({states},)\n"
        )
        nodes |= {node.name: node for node in ast.parse(text).body if isinstance(node, ast.FunctionDef)}
    names["OBSERVABLES"] = tuple(observables)
    sources = {name: ast.unparse(ast.fix_missing_locations(node)) for name, node in nodes.items()}
    return module_of(equations, names, sources)


def module_of(equations: Any, names: Mapping[str, Any], sources: Mapping[str, str]) -> ModuleType:
    """Return a module of equations with `names`, such as STATE, and with the functions compiled from `sources`."""
    module = ModuleType(getattr(equations, "__name__", "equations"), getattr(equations, "__doc__", None))
    namespace: dict[str, Any] = dict(numpy_functions())
    for name, text in sources.items():
        exec(compile(text, f"<{name} of {module.__name__}>", "exec"), namespace)
    # A state outside the domain of a function gives nan, and the point gets the status not_finite.
    functions = {name: np.errstate(all="ignore")(namespace[name]) for name in sources}
    vars(module).update({**names, "SOURCES": dict(sources)} | functions)
    return module


def _with_time_unit(node: ast.FunctionDef, given: int, rates: Mapping[str, int | None]) -> ast.FunctionDef:
    """Append TIME_UNIT to the constants that a function unpacks, and multiply the components in `rates` by TIME_UNIT."""
    unpacked = False
    for statement in node.body:
        match statement:
            case ast.Assign(targets=[ast.Tuple(elts=names)], value=ast.Name(id="constants")):
                names.append(ast.Name(TIME_UNIT, ast.Store()))
                unpacked = True
            case ast.Return(value=ast.Tuple(elts=values)) if node.name in rates:
                scaled = slice(rates[node.name])
                values[scaled] = [
                    ast.BinOp(ast.Name(TIME_UNIT), ast.Mult(), value) for value in values[scaled]
                ]
            case ast.Return(value=ast.expr() as value) if node.name in rates:
                statement.value = ast.BinOp(ast.Name(TIME_UNIT), ast.Mult(), value)
    if node.name in rates and not unpacked:
        ignored = ", ".join([*(f"unused_{i}" for i in range(given)), TIME_UNIT])
        node.body = [*ast.parse(f"{ignored}, = constants").body, *node.body]
    return node


def with_unit_row(constants: Callable[[Any], Any]) -> Callable[[Any], Any]:
    """Return the method `constants` extended by a last row of ones for TIME_UNIT."""

    def extended(points: Any) -> Any:
        one = np.ones((1, *np.shape(next(iter(points.values())))))
        return np.concatenate([np.reshape(constants(points), (-1, *one.shape[1:])), one])

    return extended


def check(key: str, equations: Any, observables: Collection[str]) -> None:
    """Raise BadInput with one line that begins with `key` if the kernels cannot use the equations."""
    state, constants = (getattr(equations, which, ()) for which in ("STATE", "CONSTANTS"))
    for which, names in (("STATE", state), ("CONSTANTS", constants)):
        if not isinstance(names, tuple | list) or not all(
            isinstance(n, str) and n.isidentifier() for n in names
        ):
            raise BadInput(f"{key}: {which} = {shown(names)}; allowed: a tuple of names")
    if not state:
        raise BadInput(f"{key}: STATE is missing; allowed: a tuple of the names of the states")
    for name in {*state, *constants}:
        if name in FUNCTIONS or name in (TIME_UNIT, "state", "constants"):
            raise BadInput(
                f"{key}: {shown(name)}: this name has another meaning in equations; choose another one"
            )
        if [*state, *constants].count(name) > 1:
            raise BadInput(f"{key}: {shown(name)} is named twice in STATE and CONSTANTS")
    integrals = getattr(equations, "INTEGRALS", {})
    if not isinstance(integrals, Mapping | tuple | list):
        raise BadInput(
            f"{key}: INTEGRALS = {shown(integrals)}; allowed: a mapping of names to powers of a rate"
        )
    losses = _losses(key, equations, observables)
    try:
        nodes = _used(equations, observables)
    except (OSError, TypeError, SyntaxError) as error:
        raise BadInput(f"{key}: the source of the functions cannot be read ({error})") from None
    if ("scaled" in nodes) != ("unscaled" in nodes):
        raise BadInput(f"{key}: scaled and unscaled belong together; give both of them or none")
    if "scaled" in nodes and not isinstance(integrals, Mapping):
        raise BadInput(f"{key}: with scaled, INTEGRALS must be a mapping of names to powers of a rate")
    frame = () if observables else ("frame_motion",)
    others = (*losses, *(name for name in observables if name not in state))
    for name in ("rhs", *frame, *integrals, *others):
        if name not in nodes:
            more = " (or the system needs observables)" if name == "frame_motion" else ""
            raise BadInput(f"{key}: the function {name}(state, constants) is missing{more}")
    components = (
        {"rhs": len(state), "frame_motion": 6}
        | dict.fromkeys(integrals)
        | dict.fromkeys((*losses, *observables), 0)
    )
    for name, node in nodes.items():
        arguments = ["state", "constants", *(["h"] if name in ("scaled", "unscaled") else [])]
        given = [argument.arg for argument in node.args.args]
        if len(given) != len(arguments) or given[:2] != arguments[:2]:
            raise BadInput(f"{key}: {name}({', '.join(given)}): allowed: {name}({', '.join(arguments)})")
        if name not in ("scaled", "unscaled", "axis_in_frame"):
            _check_function(f"{key}: {name}", node, state, constants, components.get(name))


def _losses(key: str, equations: Any, observables: Collection[str]) -> tuple[str, ...]:
    """Return the names of the functions in LOSSES. Raise BadInput if a function cannot be used."""
    losses, integrals = getattr(equations, "LOSSES", {}), getattr(equations, "INTEGRALS", {})
    if not isinstance(losses, Mapping) or not all(isinstance(name, str) for name in losses.values()):
        raise BadInput(f"{key}: LOSSES = {shown(losses)}; allowed: a mapping of first integrals to functions")
    for name in losses:
        if name not in integrals:
            raise BadInput(
                f"{key}: LOSSES: {shown(name)} is no first integral; {allowed_text(name, integrals)}"
            )
    for name in losses.values():
        if name in observables:  # observables are in the caller's units, but losses in the kernel's
            raise BadInput(f"{key}: LOSSES: {shown(name)} is an observable; choose another function")
    return tuple(losses.values())


def _check_function(
    key: str, node: ast.FunctionDef, state: Sequence[str], constants: Sequence[str], components: int | None
) -> None:
    """Raise BadInput unless a function is arithmetic with `components` results (0 for one number, None for any tuple)."""
    names, returned = {*FUNCTIONS}, None
    targets: list[ast.expr]
    for statement in node.body:
        line = f"{key}: {shown(ast.unparse(statement))}"
        match statement:
            case ast.Assign(
                targets=[ast.Tuple(elts=targets)], value=ast.Name(id="state" | "constants" as what)
            ):
                wanted = state if what == "state" else constants
                given = [ast.unparse(target) for target in targets]
                if len(given) != len(wanted):
                    raise BadInput(
                        f"{line}: {what} has {len(wanted)} components, and {len(given)} names are assigned"
                    )
                if set(given) == set(wanted) and given != list(wanted):
                    raise BadInput(f"{line}: its order is {', '.join(wanted)}")
            case ast.Assign(targets=[ast.Name() as target], value=value):
                targets = [target]
                _check_expression(line, value, names)
            case ast.Assign(targets=[ast.Tuple(elts=targets)], value=ast.Tuple(elts=values)):
                if len(targets) != len(values):
                    raise BadInput(f"{line}: {len(targets)} names are assigned {len(values)} values")
                for value in values:
                    _check_expression(line, value, names)
            case ast.Return(value=value) if value is not None and statement is node.body[-1]:
                targets, returned = [], value
                for each in value.elts if isinstance(value, ast.Tuple) else [value]:
                    _check_expression(line, each, names)
            case _:
                raise BadInput(f"{line} is not plain arithmetic; {_PLAIN}")
        for assigned in targets:
            if not isinstance(assigned, ast.Name):
                raise BadInput(f"{line}: {shown(ast.unparse(assigned))} is not a name")
            names.add(assigned.id)
    if returned is None:
        raise BadInput(f"{key}: it must end with return")
    count = len(returned.elts) if isinstance(returned, ast.Tuple) else 0
    if components == 0 and count:
        raise BadInput(f"{key}: it returns a tuple of {count}; allowed: one number")
    if components and count != components:
        raise BadInput(f"{key}: it returns {count or 1} components; allowed: a tuple of {components}")
    if components is None and not count:
        raise BadInput(f"{key}: it returns one number; allowed: a tuple of terms")


def _check_expression(line: str, expression: ast.expr, names: set[str]) -> None:
    """Raise BadInput unless an expression is arithmetic of `names` and FUNCTIONS."""
    for node in ast.walk(expression):
        match node:
            case ast.Name(id=name) if name not in names:
                raise BadInput(f"{line}: the name {shown(name)} is not defined there; {_ALLOWED}")
            case ast.Constant(value=value) if isinstance(value, bool) or not isinstance(value, int | float):
                raise BadInput(f"{line}: {shown(value)} is no number")
            case ast.Call(func=function, args=arguments, keywords=keywords):
                if not isinstance(function, ast.Name) or function.id not in FUNCTIONS:
                    name = ast.unparse(function)
                    raise BadInput(f"{line}: {shown(name)} cannot be called; {allowed_text(name, FUNCTIONS)}")
                if len(arguments) != 1 or keywords:
                    raise BadInput(f"{line}: {shown(ast.unparse(node))}: {function.id} takes one number")
            case (
                ast.Name() | ast.Constant() | ast.expr_context() | ast.operator() | ast.unaryop()
                | ast.UnaryOp(op=ast.USub() | ast.UAdd())
                | ast.BinOp(op=ast.Add() | ast.Sub() | ast.Mult() | ast.Div() | ast.Pow())
            ):  # fmt: skip
                pass
            case _:
                raise BadInput(f"{line}: {shown(ast.unparse(node))} is not plain arithmetic; {_PLAIN}")
