"""Ties, which are arithmetic expressions in names. The parser of Python parses them, but they never run as Python code."""

from __future__ import annotations

import ast
import math
import operator
import warnings
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from graphlib import CycleError, TopologicalSorter
from typing import Any

import numpy as np

from ..errors import BadInput, allowed_text, shown
from ..systems.base import Array
from .draws import DRAWS

MAX_LENGTH = 500  # largest number of characters of an expression
MAX_DEPTH = 200  # largest number of nested levels of an expression
_OPERATORS: dict[type[ast.AST], Callable[..., Any]] = {
    ast.Add: operator.add,
    ast.Sub: operator.sub,
    ast.Mult: operator.mul,
    ast.Div: np.divide,
    ast.Pow: np.power,
    ast.USub: operator.neg,
    ast.UAdd: operator.pos,
}
FUNCTIONS: dict[str, Callable[..., Any]] = {
    "sqrt": np.sqrt,
    "sin": np.sin,
    "cos": np.cos,
    "tan": np.tan,
    "asin": np.arcsin,
    "acos": np.arccos,
    "atan": np.arctan,
    "exp": np.exp,
    "log": np.log,
    "abs": np.abs,
}
CONSTANTS = {"pi": math.pi, "deg": math.pi / 180}
RESERVED = {*FUNCTIONS, *CONSTANTS}
_HINTS = {
    "^": "powers are **",
    "np.": "functions have no np. before them",
    "arc": "arcsin is asin, and so on",
}
_ALLOWED = f"allowed: + - * / **, {', '.join(FUNCTIONS)}, pi, deg (pi / 180), numbers and other names"
_ALLOWED_DRAWS = "".join(f", {name}(draw)" for name in DRAWS)


class Expression:
    """Parsed arithmetic in names, numbers, CONSTANTS, + - * / ** and FUNCTIONS. Other texts raise BadInput with `key`.

    With a seed the functions DRAWS are allowed. A draw depends on the arguments, the seed, the key and the place in the text.
    """

    def __init__(self, key: str, text: str, seed: int | None = None):
        self.key, self.text, self.seed = key, text.strip(), seed
        if len(text) > MAX_LENGTH:
            raise BadInput(f"{key}: the expression has {len(text)} characters; allowed: at most {MAX_LENGTH}")
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("error")  # Otherwise a text such as 1if would only give a warning.
                tree = ast.parse(self.text, mode="eval").body
        except (SyntaxError, ValueError, RecursionError, MemoryError, Warning):
            raise BadInput(f"{key} = {shown(text)}: not an expression; {_ALLOWED}") from None
        parts, depth = list[ast.AST]([tree]), 0
        while parts and depth < MAX_DEPTH:
            parts, depth = [child for part in parts for child in ast.iter_child_nodes(part)], depth + 1
        if parts:
            raise BadInput(f"{key} = {shown(self.text)}: nested more than {MAX_DEPTH} deep")
        calls = [] if seed is None else [part for part in ast.walk(tree) if isinstance(part, ast.Call)]
        draws = [call for call in calls if isinstance(call.func, ast.Name) and call.func.id in DRAWS]
        # The program is in postfix order. An entry is (number or name, 0) or (function, number of arguments).
        self._program, self.drawn = list[tuple[Any, int]](), set[str]()
        self._compile(tree, draws)
        self.names = frozenset(part for part, _ in self._program if isinstance(part, str))

    def value(self, values: Mapping[str, Array]) -> Array:
        """Return the value of the expression for the given values of the names. The value may be inf or nan."""
        stack: list[Any] = []
        with np.errstate(all="ignore"):
            for part, count in self._program:
                if count:
                    stack[-count:] = [np.asarray(part(*stack[-count:]))]
                else:
                    stack.append(values[part] if isinstance(part, str) else part)
        return stack[0]

    def _compile(self, node: ast.expr, draws: list[ast.Call]) -> None:
        """Append a subexpression to the postfix program. Raise BadInput if the subexpression is not arithmetic."""
        function: Any
        start, arguments = len(self._program), list[ast.expr]()
        match node:
            case ast.Constant(value=value) if type(value) in (int, float):
                function = np.asarray(float(str(value)))  # gives inf where float(value) would overflow
            case ast.Name(id=name):
                function = np.asarray(CONSTANTS[name]) if name in CONSTANTS else name
            case ast.BinOp(left=left, op=op, right=right) if type(op) in _OPERATORS:
                function, arguments = _OPERATORS[type(op)], [left, right]
            case ast.UnaryOp(op=op, operand=operand) if type(op) in _OPERATORS:
                function, arguments = _OPERATORS[type(op)], [operand]
            case ast.Call(func=ast.Name(id=name), args=[argument], keywords=[]) if name in FUNCTIONS:
                function, arguments = FUNCTIONS[name], [argument]
            case ast.Call(func=ast.Name(id=name), args=[_, *_], keywords=[]) if node in draws:
                key = f"{self.seed} {self.key} {draws.index(node)}"
                function, arguments = partial(DRAWS[name], key), node.args
            case _:
                hint = next((f"{sentence}; " for sign, sentence in _HINTS.items() if sign in self.text), "")
                raise BadInput(
                    f"{self.key} = {shown(self.text)}: {shown(ast.get_source_segment(self.text, node))} is not"
                    f" arithmetic; {hint}{_ALLOWED}{_ALLOWED_DRAWS if self.seed is not None else ''}"
                )
        for argument in arguments:
            self._compile(argument, draws)
        if node in draws:
            self.drawn |= {part for part, _ in self._program[start:] if isinstance(part, str)}
        self._program.append((function, len(arguments)))


@dataclass(frozen=True, eq=False)
class PointColumn:
    """A tie with a value for each point of a scene with [points]. The argument of the tie is the number of the point."""

    key: str  # key of the values in the scene, such as "points.values.C"
    column: Array  # the values, float64 of shape (points,)
    text = "one value for each point"
    names = frozenset({"point"})

    def value(self, values: Mapping[str, Array]) -> Array:
        """Return the entries of the column at the positions values["point"]."""
        return self.column[values["point"].astype(np.int64)]


Tie = Expression | PointColumn


def evaluation_order(ties: Mapping[str, Tie], known: set[str]) -> list[str]:
    """Return the ties in an order in which each uses only known names and earlier ties. Raise BadInput if that is impossible."""
    for tie in ties.values():
        for name in sorted(tie.names - known - set(ties)):
            raise BadInput(
                f"{tie.key} = {shown(tie.text)}: {shown(name)} is neither a parameter, an axis nor a tie;"
                f" {allowed_text(name, sorted((known | set(ties)) - {name}))}"
            )
    sorter = TopologicalSorter({name: sorted(tie.names & set(ties)) for name, tie in ties.items()})
    try:
        sorter.prepare()
    except CycleError as error:
        circle = ", ".join(f"{name} = {shown(ties[name].text)}" for name in error.args[1][:-1])
        raise BadInput(f"ties refer to each other in a circle: {circle}") from None
    order: list[str] = []
    while sorter.is_active():
        # Independent ties keep the order of the scene, so that a resolved scene has the same order.
        ready = sorted(sorter.get_ready(), key=list(ties).index)
        order += ready
        sorter.done(*ready)
    return order
