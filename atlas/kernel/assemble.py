"""Assemble the source of a kernel from `integrate`, the equations of a system, and functions that `generated` declares."""

from __future__ import annotations

import ast
import sys
from collections.abc import Collection, Iterable, Mapping, Sequence
from enum import IntEnum
from functools import cache
from types import FunctionType, ModuleType
from typing import Any

from ..errors import BadInput
from ..systems import arithmetic
from . import augmented, generated, integrate
from .differentiate import differential, simplify
from .ensemble import Plug
from .statistics import Row
from .tableaux import METHODS, Method

# Names of the kernel modules that measure the change of first integrals.
MEASURING = ("integrate", "observe")


@cache
def reachable(
    functions: tuple[Any, ...], stubs: ModuleType = generated, absent: tuple[str, ...] = ()
) -> tuple[dict[str, Any], dict[str, str], dict[str, Any]]:
    """Return the functions that `functions` reach, the sources, and the numbers that the sources use, each by name.

    Callees come first, and names in `stubs` are left out. In the sources, numbers replace the members of enumerations, and
    blocks `if name:` are removed if `absent` contains the name.
    """
    trees: dict[str, dict[str, ast.FunctionDef]] = {}
    objects: dict[str, Any] = {}
    sources: dict[str, str] = {}
    numbers: dict[str, Any] = {}

    def visit(function: Any) -> None:
        module = sys.modules[function.__module__]
        if module.__name__ not in trees:
            trees[module.__name__] = arithmetic.function_trees(module)
        node = _Stripped(vars(module), absent).visit(trees[module.__name__][function.__name__])
        objects[function.__name__] = function
        for name in arithmetic.names_in(node):
            value = vars(module).get(name)
            if name in objects or hasattr(stubs, name):
                continue
            if isinstance(value, FunctionType):
                visit(value)
            elif isinstance(value, int | float | tuple):
                numbers[name] = value
        sources[function.__name__] = ast.unparse(node)

    for function in functions:
        visit(function)
    return objects, sources, numbers


def file_of(of: ModuleType) -> str:
    """Return a kernel module's name without the package. Callers compare names, so that they need not import other kernel modules."""
    return of.__name__.rpartition(".")[2]


def entries(of: ModuleType, plugs: Sequence[Plug]) -> tuple[Any, ...]:
    """Return the functions of `plugs` that a kernel calls, and the function `integrate` of the kernel module."""
    return *dict.fromkeys(plug.add_node for plug in plugs if plug.add_node), of.integrate


class _Stripped(ast.NodeTransformer):
    """Replace members and sizes of enumerations by numbers, and remove the blocks `if name:` whose name is in `absent`."""

    def __init__(self, namespace: Mapping[str, Any], absent: Collection[str]):
        enums = {name: value for name, value in namespace.items() if isinstance(value, type)}
        self.enums = {name: value for name, value in enums.items() if issubclass(value, IntEnum)}
        self.absent = absent

    def visit_Attribute(self, node: ast.Attribute) -> ast.expr:
        match node.value:
            case ast.Name(name) if node.attr in getattr(self.enums.get(name), "__members__", {}):
                return ast.Constant(int(self.enums[name][node.attr]))
        self.generic_visit(node)
        return node

    def visit_Call(self, node: ast.Call) -> ast.expr:
        match node:
            case ast.Call(ast.Name("len"), [ast.Name(name)]) if name in self.enums:
                return ast.Constant(len(self.enums[name]))
        self.generic_visit(node)
        return node

    def visit_If(self, node: ast.If) -> ast.If | None:
        if isinstance(node.test, ast.Name) and node.test.id in self.absent:
            return None
        self.generic_visit(node)
        return node


def source(
    equations: ModuleType,
    method: str,
    zero: Collection[str] = (),
    equal: Mapping[str, str] = {},
    *,
    of: ModuleType = integrate,
    plugs: tuple[Plug, ...] = (),
) -> str:
    """Return the text of a kernel module for a system's equations and a method.

    `zero` and `equal` name constants that are 0 or equal to another constant at every point. Raise BadInput if the equations
    cannot be differentiated, or if a first integral or a loss has the name of a function of the kernel.
    """
    from . import machine_code  # imported here because drawing an atlas needs no compiler

    present = {"PLUGGED": plugs, "STROBED": getattr(equations, "STROBED", ())}
    absent = tuple(name for name, parts in present.items() if not parts)
    _, sources, numbers = reachable(entries(of, plugs), absent=absent)
    measured = augmented.losses_of(equations, zero, equal) if file_of(of) in MEASURING else {}
    equations = augmented.with_losses(equations, measured)
    try:
        texts = generated_functions(equations, METHODS[method], zero, equal, of, plugs)
    except ValueError as error:  # raised by `differential`
        raise BadInput(f"equations: {error}") from None
    names = {"INTEGRALS": equations.INTEGRALS, "LOSSES": equations.LOSSES.values()}
    for key, name in ((key, name) for key, members in names.items() for name in members):
        if name in sources or hasattr(generated, name):
            raise BadInput(f"{key}: {name} is the name of a function of the kernel; choose another name")
    numbers = generated_numbers(equations, METHODS[method], of, plugs) | numbers
    values = {name: repr(number) for name, number in numbers.items()}
    if arithmetic.FUNCTIONS.keys() & arithmetic.names_in(*texts.values()):
        values |= {name: f"np.{numpy_name}" for name, numpy_name in arithmetic.FUNCTIONS.items()}
    return machine_code.module_text(values, texts | sources, machine_code.INLINE)


def generated_numbers(
    equations: ModuleType, method: Method, of: ModuleType, plugs: Sequence[Plug]
) -> dict[str, Any]:
    """Return the numbers that `generated` declares, by name."""
    plugged, observables = sum(plug.sums for plug in plugs), len(observable_names(equations))
    strobed = len(getattr(equations, "STROBED", ()))
    measured = {
        "OBSERVABLES": observables,
        "PLUGGED": plugged,
        "PLUGGED_GIVEN": sum(plug.given for plug in plugs) + (strobed > 0),
        "NODE_ROWS": 2 * integrate.MOTION,
        "SUMS": len(Row) + plugged,
        **({"STROBED": strobed} if strobed else {}),
    }
    if file_of(of) == "observe":
        sums = of.FIRST_ROW + len(of.Field) * (observables + strobed)
        measured |= {"NODE_ROWS": 2 * observables, "SUMS": sums}
    return {
        "WIDTH": generated.WIDTH,
        "STATES": len(equations.STATE),
        "CONSTANTS": len(equations.CONSTANTS),
        "INTEGRALS": len(equations.INTEGRALS),
        "TANGENT": augmented.tangent_size(equations),
        "STEP": method.kernel_step,
        # Storing the slope saves time only in methods with many stages.
        "STORES_SLOPE": method.stages > 4,
        "HAS_AXIS": hasattr(equations, "axis_in_frame"),
        **(measured if file_of(of) in MEASURING else {}),
        **({"LOSSES": tuple(equations.LOSSES)} if equations.LOSSES else {}),
    }


def generated_functions(
    equations: ModuleType,
    method: Method,
    zero: Collection[str],
    equal: Mapping[str, str],
    of: ModuleType,
    plugs: Sequence[Plug],
) -> dict[str, str]:
    """Return the sources, by name, of the simplified equations and of the functions that `generated` declares."""
    states, constants = len(equations.STATE), len(equations.CONSTANTS)
    extended = states + augmented.tangent_size(equations)
    texts = arithmetic.functions(equations)
    in_any_units = texts.keys() if file_of(of) == "quadratures" else ("scaled", augmented.SCALED)
    sources = {
        name: simplify(text, zero, equal, () if name in in_any_units else equations.ONES)
        for name, text in texts.items()
    }
    if "axis_in_frame" not in sources:
        sources["axis_in_frame"] = "def axis_in_frame(state, constants):\n    return 0.0, 0.0"
    generated_lines = {
        **_column_lines("state", states),
        **_column_lines("constants", constants),
        "store_scales(block, l, scales, p, inverse_unit)": [
            f"block[{i}, l] = scales[{i}, p]{' * inverse_unit' * power}"
            for i, power in enumerate(equations.INTEGRALS.values())
        ],
        "step(state, slope, constants)": step_lines(
            method, "extended_rhs" if file_of(of) == "tangent" else "rhs"
        ),
        "store_integrals(block, l, state, constants)": [
            line
            for i, name in enumerate(equations.INTEGRALS)
            for line in (*_integral_lines(equations, name), f"block[{i}, l] = total")
        ],
        "largest_change(first, scales, l, state, constants, largest)": [
            line
            for i, name in enumerate(equations.INTEGRALS)
            for line in (
                *_integral_lines(equations, name),
                f"change = abs(total - first[{i}, l]) * scales[{i}, l]",
                "largest = change if change > largest else largest",
            )
        ]
        + ["return largest"],
    }
    if file_of(of) == "integrate":
        sources["frame_motion_change"] = differential(sources["frame_motion"], "frame_motion_change")
    if plugs:
        signature = "plugged, given, nodes, i, intervals, spacing, inverse_unit, state, constants"
        generated_lines[f"add_to_plugged({signature})"] = _plugged_lines(equations, plugs)
    if file_of(of) == "tangent":
        sources |= augmented.variation(equations, sources["rhs"])
        generated_lines |= {
            **_column_lines("extended", extended),
            "extended_rhs(extended, constants)": _extended_lines(states, extended),
        }
    if file_of(of) == "observe":
        functions_of_observables, callers = _observable_functions(equations, sources)
        sources |= functions_of_observables
        generated_lines |= callers
    for head, lines in generated_lines.items():
        sources[head.partition("(")[0]] = "\n    ".join([f"def {head}:", *(lines or ["pass"])])
    return sources


def observable_names(equations: ModuleType) -> tuple[str, ...]:
    """Return the names of the observables of a system with these equations. A body in a frame has no observables."""
    return getattr(equations, "OBSERVABLES", ())


def _observable_functions(
    equations: ModuleType, sources: dict[str, str]
) -> tuple[dict[str, str], dict[str, list[str]]]:
    """Return sources, by name, of functions for one observable or differential, and lines, by head, of functions for all observables."""
    changes, values, slopes, lines = dict[str, str](), [], [], []

    def value(name: str) -> str:
        """Return an expression for an observable. A function in `sources` that computes the observable moves to `changes`."""
        if name not in sources:
            return f"state[{list(equations.STATE).index(name)}]"
        changes[f"observable_{name}"] = sources.pop(name).replace(
            f"def {name}(", f"def observable_{name}(", 1
        )
        return f"observable_{name}(state, constants)"

    for name in observable_names(equations):
        text, change = sources.get(name), f"change_of_{name}"
        values.append(value(name))
        if text is None:
            slopes.append(f"change[{list(equations.STATE).index(name)}]")
            continue
        head, _, result = text.rpartition("return ")
        changes[change] = differential(f"{head}return ({result},)", change)  # `differential` needs a tuple
        lines.append(f"d_{name}, = {change}(state, constants, change)")
        slopes.append(f"d_{name}")
    rows = ", ".join(f"nodes[slot, row + {k}, l]" for k in range(len(values)))
    strobed = getattr(equations, "STROBED", ())
    lines_of_strobes = [f"block[{k}, l] = {value(name)}" for k, name in enumerate(strobed)]
    of_strobes = {"store_strobes(block, l, state, constants)": lines_of_strobes}
    return changes, (of_strobes if strobed else {}) | {
        "observe(state, constants)": [f"return ({', '.join(values)},)"],
        "observe_change(state, constants, change)": [*lines, f"return ({', '.join(slopes)},)"],
        "store_values(nodes, slot, row, l, values)": [f"{rows}, = values"],
    }


def _extended_lines(states: int, extended: int) -> list[str]:
    """Return the lines of `extended_rhs`, which gives the derivatives of the state and of the tangent vector."""
    names = [f"y{i}" for i in range(extended)]
    slopes = [f"k{i}" for i in range(extended)]
    return [
        f"{', '.join(names)}, = extended",
        f"state = ({', '.join(names[:states])},)",
        f"{', '.join(slopes[:states])}, = rhs(state, constants)",
        f"{', '.join(slopes[states:])}, = variation(state, constants, ({', '.join(names[states:])},))",
        f"return ({', '.join(slopes)},)",
    ]


def _column_lines(name: str, rows: int) -> dict[str, list[str]]:
    """Return the lines of functions that read and write column l of a block as a tuple."""
    column = f"({', '.join(f'block[{i}, l]' for i in range(rows))},)"
    return {
        f"load_{name}(block, l)": [f"return {column}"],
        f"store_{name}(block, l, {name})": [f"{column} = {name}"],
    }


def _terms(equations: ModuleType, name: str) -> list[str]:
    """Return variable names for the terms of a first integral."""
    ones = (1.0,) * len(equations.STATE), (1.0,) * len(equations.CONSTANTS)
    return [f"t{j}" for j in range(len(getattr(equations, name)(*ones)))]


def _integral_lines(equations: ModuleType, name: str) -> list[str]:
    """Return lines that assign the sum of the terms of a first integral to `total`."""
    terms = _terms(equations, name)
    return [f"{', '.join(terms)}, = {name}(state, constants)", f"total = {' + '.join(terms)}"]


def _plugged_lines(equations: ModuleType, plugs: Sequence[Plug]) -> list[str]:
    """Return lines that add a node to the sums of all instruments."""
    lines, row, first = list[str](), 0, 0
    for plug in plugs:
        arguments = f"plugged, {row}, given, {first}, l, nodes, i, intervals, spacing, inverse_unit[l]"
        if plug.add_node is None:
            lines += _level_lines(equations, row, first, plug.sums)
        else:
            lines += ["for l in range(WIDTH):", f"    {plug.add_node.__name__}({arguments})"]
        row, first = row + plug.sums, first + plug.given
    return lines


def _level_lines(equations: ModuleType, row: int, first: int, levels: int) -> list[str]:
    """Return lines that count the nodes whose energy exceeds some levels. The accumulated loss is no part of the energy."""
    name = next(iter(equations.INTEGRALS))
    terms = _terms(equations, name)
    total = " + ".join(terms[:-1] if name in equations.LOSSES else terms)
    return [
        f"if i % {integrate.NODES_PER_LEVEL} == 0:",
        "    for l in range(WIDTH):",
        f"        {', '.join(terms)}, = {name}(load_state(state, l), load_constants(constants, l))",
        f"        total = ({total}) * inverse_unit[l] * inverse_unit[l]",
        *(f"        plugged[{row + k}, l] += 1.0 if total > given[{first + k}, l] else 0.0" for k in range(levels)),
    ]  # fmt: skip


def step_lines(method: Method, rhs_name: str = "rhs") -> list[str]:
    """Return the lines of `step`, which takes one step of length method.kernel_step.

    The first weight is factored out, so that the weights of rk4 become 1, 2, 2, 1. The sum then needs no multiplications, and
    multiplications limit the speed of the processor. The sum grows stage by stage, so that few slopes are kept at a time.
    """
    lines, first = [], method.b[0]
    for stage in range(method.stages):
        moved = _axpy("state", method.a[stage], method.kernel_step)
        lines.append(f"k{stage} = {f'{rhs_name}({moved}, constants)' if stage else 'slope'}")
        if method.b[stage] != 0.0:
            total = _axpy("total", (0.0,) * stage + (method.b[stage] / first,)) if stage else "k0"
            lines.append(f"total = {total}")
    return [*lines, f"return axpy(state, ({first * method.kernel_step!r},), (total,))"]


def _axpy(base: str, coefficients: Iterable[float], factor: float = 1.0) -> str:
    """Return text that adds the slopes k to a tuple, weighted by `factor` times `coefficients`. Weights of 0 are left out."""
    # A slope with the coefficient 2 is added twice, because x + x is cheaper than 2 x.
    pairs = [(a * factor, f"k{j}") for j, a in enumerate(coefficients) if a != 0.0]
    terms = [term for a, k in pairs for term in ([(1.0, k), (1.0, k)] if a == 2.0 else [(a, k)])]
    weights, slopes = (", ".join(str(term[i]) for term in terms) for i in range(2))
    return f"axpy({base}, ({weights},), ({slopes},))" if terms else base
