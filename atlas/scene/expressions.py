"""Ties: arithmetic of a scene in other names. Read with Python's parser, never executed as Python."""

from __future__ import annotations

import ast
import math
import operator
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..errors import BadInput

MAX_LENGTH = 500  # characters
_BINARY: dict[type[ast.operator], Callable[..., Any]] = {
    ast.Add: operator.add,
    ast.Sub: operator.sub,
    ast.Mult: operator.mul,
    ast.Div: np.divide,
    ast.Pow: np.power,
}
_UNARY: dict[type[ast.unaryop], Callable[..., Any]] = {ast.USub: operator.neg, ast.UAdd: operator.pos}
FUNCTIONS: dict[str, Callable[..., Any]] = {
    "sqrt": np.sqrt, "sin": np.sin, "cos": np.cos, "tan": np.tan, "asin": np.arcsin, "acos": np.arccos,
    "atan": np.arctan, "exp": np.exp, "log": np.log, "abs": np.abs,
}  # fmt: skip
CONSTANTS = {"pi": math.pi}
RESERVED = {*FUNCTIONS, *CONSTANTS}
_ALLOWED = f"allowed: + - * / **, {', '.join(FUNCTIONS)}, pi, numbers and other names"


class Expression:
    """One parsed expression: `names` it refers to, and its value for given names."""

    def __init__(self, key: str, text: str):
        """key: where it stands, for complaints. Raises BadInput for anything but arithmetic."""
        self.key, self.text = key, text
        if len(text) > MAX_LENGTH:
            raise BadInput(f"{key}: the expression has {len(text)} characters; allowed: at most {MAX_LENGTH}")
        try:
            self._tree = ast.parse(text.strip(), mode="eval").body
        except (SyntaxError, ValueError, RecursionError, MemoryError):
            raise BadInput(f"{key} = {text!r}: not an expression; {_ALLOWED}") from None
        self.names: frozenset[str] = frozenset(self._check(self._tree))

    def _check(self, node: ast.expr) -> set[str]:
        match node:
            case ast.Constant(value=value) if type(value) in (int, float):
                return set()
            case ast.Name(id=name):
                return set() if name in CONSTANTS else {name}
            case ast.BinOp(left=left, op=op, right=right) if type(op) in _BINARY:
                return self._check(left) | self._check(right)
            case ast.UnaryOp(op=op, operand=operand) if type(op) in _UNARY:
                return self._check(operand)
            case ast.Call(func=ast.Name(id=name), args=[argument], keywords=[]) if name in FUNCTIONS:
                return self._check(argument)
        raise BadInput(f"{self.key} = {self.text!r}: {ast.unparse(node)!r} is not arithmetic; {_ALLOWED}")

    def value(self, names: Mapping[str, NDArray[np.float64]]) -> NDArray[np.float64]:
        """Value as float64 of the broadcast shape of the names it uses; may be inf or nan."""
        with np.errstate(all="ignore"):
            return self._value(self._tree, names)

    def _value(self, node: ast.expr, names: Mapping[str, NDArray[np.float64]]) -> NDArray[np.float64]:
        match node:
            case ast.Constant(value=value):
                assert isinstance(value, int | float)
                try:
                    return np.asarray(float(value))
                except OverflowError:
                    return np.asarray(math.inf)
            case ast.Name(id=name):
                return np.asarray(CONSTANTS[name]) if name in CONSTANTS else names[name]
            case ast.BinOp(left=left, op=op, right=right):
                return _BINARY[type(op)](self._value(left, names), self._value(right, names))
            case ast.UnaryOp(op=op, operand=operand):
                return _UNARY[type(op)](self._value(operand, names))
            case ast.Call(func=ast.Name(id=name), args=[argument]):
                return FUNCTIONS[name](self._value(argument, names))
        raise AssertionError(node)


class PointColumn(Expression):
    """A tie to the number of the point: one value for each."""

    def __init__(self, key: str, values: NDArray[np.float64]):
        """values: of shape (points,)."""
        self.key, self.text, self.names = key, "one value for each point", frozenset({"point"})
        self.values = values

    def value(self, names: Mapping[str, NDArray[np.float64]]) -> NDArray[np.float64]:
        return self.values[names["point"].astype(np.int64)]


def evaluation_order(ties: Mapping[str, Expression], known: set[str]) -> list[str]:
    """Names of the ties in an order in which each uses only known names and earlier ties.

    Raises BadInput for a tie that refers to nothing or in a circle.
    """
    for tie in ties.values():
        for other in sorted(tie.names - known - set(ties)):
            raise BadInput(f"{tie.key} = {tie.text!r}: {other!r} is neither a parameter, an axis nor a tie")
    done: list[str] = []
    waiting = list(ties)
    while waiting:
        ready = [name for name in waiting if not (ties[name].names & set(waiting))]
        if not ready:
            circle = ", ".join(f"{name} = {ties[name].text!r}" for name in waiting)
            raise BadInput(f"ties refer to each other in a circle: {circle}")
        done += ready
        waiting = [name for name in waiting if name not in ready]
    return done
