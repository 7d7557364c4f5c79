"""Bind functions of the theory to the equations of a system. The results run in plain Python or in machine code."""

from __future__ import annotations

import ast
from collections.abc import Callable
from functools import cache
from math import gcd
from types import FunctionType
from typing import Any

import numpy as np

from ..kernel.assemble import reachable
from ..kernel.differentiate import differential
from ..systems import arithmetic
from ..systems.base import System
from ..systems.steady import polynomial_degree
from . import generated

# Up to this number of points, plain Python takes less time than loading machine code.
FEW_POINTS = 100


@cache
def of_system(function: FunctionType, system: System, in_machine_code: bool) -> Callable[..., Any]:
    """Bind a function of theory to a system. If the function uses `generated`, the system needs a `polynomial_degree`."""
    with arithmetic.PARSING:
        objects, sources, values = reachable((function,), generated)
        globals_of = [(each.__globals__, each.__code__.co_names) for each in objects.values()]
        names = {name: namespace.get(name) for namespace, each in globals_of for name in each}
        texts = {} if names.keys().isdisjoint(vars(generated)) else _equations(system)
    if texts:
        degree = polynomial_degree(system)
        assert isinstance(degree, int)
        pairs = ((p, q) for p in range(1, 2 * degree + 1) for q in range(1, 2 * degree + 1))
        values |= {"DEGREE": degree, "PERIODS": tuple((p, q) for p, q in pairs if gcd(p, q) == 1)}
    if in_machine_code:
        from ..kernel import machine_code  # imported here, because plain Python needs no compiler

        lines = {name: repr(value) for name, value in values.items()}
        lines |= {name: f"np.{numpy_name}" for name, numpy_name in arithmetic.FUNCTIONS.items()}
        tuples = {name: each for name, each in sorted(names.items()) if hasattr(each, "_fields")}
        # The text contains the fields of named tuples, because the cache would not notice a change of fields otherwise.
        lines |= {f"{name}_FIELDS": repr(each._fields) for name, each in tuples.items()}
        imports = [f"from {each.__module__} import {name}\n" for name, each in tuples.items()]
        text = machine_code.module_text(
            lines, texts | sources, machine_code.UNFUSED, "".join(["import math\n", *imports])
        )
        return getattr(machine_code.load(text), function.__name__)
    namespace: dict[str, Any] = {}
    for each in objects.values():
        namespace |= each.__globals__
    namespace |= arithmetic.numpy_functions() | values
    for name, text in texts.items():
        exec(compile(text, f"<{name} of {system.name}>", "exec"), namespace)
    # The copies have other globals but the same code, so that a debugger steps through the original files.
    namespace |= {name: FunctionType(each.__code__, namespace, name) for name, each in objects.items()}
    return np.errstate(all="ignore")(namespace[function.__name__])


@cache
def _equations(system: System) -> dict[str, str]:
    """Return by name the source of the functions that `generated` declares, and of functions that these call."""
    equations, texts = system.equations, arithmetic.functions(system.equations)
    places = {name: i for i, name in enumerate(equations.STATE)}
    of_w = [places[name] for name in system.rate_states]
    of_vectors = [[places[name] for name in triple] for triple in equations.FRAME_VECTORS]
    component = {k: f"w[{i}]" for i, k in enumerate(of_w)}
    component |= {
        k: f"vectors[{j}][{i}]" for j, triple in enumerate(of_vectors) for i, k in enumerate(triple)
    }
    states = [component[k] for k in range(len(places))]
    changes = [text.replace("vectors", "changes").replace("w[", "dw[") for text in states]
    sizes = [text.replace("w[", "size[") if text.startswith("w") else "1.0" for text in states]

    def items(form: str, values: Any) -> str:
        return f"({', '.join(form.format(value) for value in values)},)"

    every = range(len(of_vectors))
    constants = items("abs(constants[{}])", range(len(equations.CONSTANTS)))
    bodies = {
        "load_state(block, i)": [
            f"return {items('block[{}, i]', of_w)}, {items('{}', [items('block[{}, i]', each) for each in of_vectors])}"
        ],
        "load_constants(block, i)": [f"return {items('block[{}, i]', range(len(equations.CONSTANTS)))}"],
        "derivatives(w, vectors, constants)": [
            f"d = rhs({items('{}', states)}, constants)",
            f"return {items('d[{}]', of_w)}, {items('{}', [items('d[{}]', each) for each in of_vectors])}",
        ],
        "derivatives_change(w, vectors, constants, dw, changes)": [
            f"d = rhs_change({items('{}', states)}, constants, {items('{}', changes)})",
            f"return {items('d[{}]', of_w)}",
        ],
        "magnitudes(w, vectors, constants, size)": [
            f"sizes, constants = {items('abs({})', states)}, {constants}",
            f"a, b = rhs_sum(sizes, constants), rhs_sum_change(sizes, constants, {items('{}', sizes)})",
            f"return {items('a[{0}] + b[{0}]', of_w)}",
        ],
        "frame_motion(w, vectors, constants)": [
            f"x = motion_in_frame({items('{}', states)}, constants)",
            "return (x[0], x[1], x[2]), (x[3], x[4], x[5])",
        ],
        "frame_motion_change(w, vectors, constants, dw, changes)": [
            f"x = motion_in_frame_change({items('{}', states)}, constants, {items('{}', changes)})",
            "return x[0], x[1], x[2]",
        ],
        "rotate_all(vectors, nu, back, s, around)": [
            f"return {items('rotate(rotate(vectors[{}], nu, back[0], back[1]), s, around[0], around[1])', every)}"
        ],
        "turn_all(vectors, u)": [f"return {items('cross(vectors[{}], u)', every)}"],
    }
    frame = texts["frame_motion"].replace("def frame_motion(", "def motion_in_frame(", 1)
    sums = ast.unparse(_Sum().visit(ast.parse(texts["rhs"].replace("def rhs(", "def rhs_sum(", 1))))
    sources = {
        "rhs": texts["rhs"],
        "rhs_change": differential(texts["rhs"], "rhs_change"),
        "rhs_sum": sums,
        "rhs_sum_change": differential(sums, "rhs_sum_change"),
        "motion_in_frame": frame,
        "motion_in_frame_change": differential(frame, "motion_in_frame_change"),
    }
    for head, lines in bodies.items():
        sources[head.partition("(")[0]] = "\n    ".join([f"def {head}:", *lines])
    return sources


class _Sum(ast.NodeTransformer):
    """Transformer that replaces - by + and function values by magnitudes, so that the magnitudes of all terms are summed."""

    def visit_BinOp(self, node: ast.BinOp) -> ast.expr:
        self.generic_visit(node)
        return ast.BinOp(node.left, ast.Add() if isinstance(node.op, ast.Sub) else node.op, node.right)

    def visit_UnaryOp(self, node: ast.UnaryOp) -> ast.expr:
        self.generic_visit(node)
        return node.operand

    def visit_Call(self, node: ast.Call) -> ast.expr:
        self.generic_visit(node)
        return ast.Call(ast.Name("abs"), [node], [])
