"""Expressions of SymPy as functions of state and constants in plain Python arithmetic."""

from __future__ import annotations

import ast
from collections.abc import Iterable, Sequence
from functools import cache
from textwrap import wrap
from typing import Any

from ...errors import BadInput, shown
from ...systems.arithmetic import FUNCTIONS

# This stands for expressions and symbols of SymPy, which is imported only when it is used.
Expression = Any
LINE_LENGTH = 110
MAX_NAME = 30  # largest number of characters of a name made from an expression


def require_arithmetic(what: str, expression: Expression) -> None:
    """Raise BadInput unless an expression consists of numbers, plain symbols, arithmetic and FUNCTIONS."""
    import sympy

    for part in sympy.preorder_traversal(expression):
        if isinstance(part, sympy.Symbol | sympy.Add | sympy.Mul | sympy.Pow):
            continue
        if part.is_number and part.is_Atom and part.is_real and part.is_finite:
            continue
        undefined = isinstance(part, sympy.core.function.AppliedUndef)
        if isinstance(part, sympy.Function) and type(part).__name__ in FUNCTIONS and not undefined:
            continue
        hint = ""
        if undefined or isinstance(part, sympy.Derivative):
            hint = "; write coordinates and velocities as plain symbols, not as functions of the time"
        raise BadInput(
            f"{what} contains {shown(str(part))}; allowed: symbols, real numbers, + - * / **, {', '.join(FUNCTIONS)}{hint}"
        )


@cache
def _printer() -> Any:
    from sympy.printing.pycode import PythonCodePrinter

    class Printer(PythonCodePrinter):  # type: ignore[misc]
        """SymPy's printer, with floats for constants such as pi, and sqrt(x)**n for x**(n/2) with odd n."""

        def _print_NumberSymbol(self, constant: Expression) -> str:
            return repr(float(constant))

        _print_Pi = _print_Exp1 = _print_GoldenRatio = _print_EulerGamma = _print_Catalan = (
            _print_NumberSymbol
        )

        def _print_Pow(self, power: Expression, rational: bool = False) -> str:
            if power.exp.is_Rational and power.exp.q == 2 and abs(power.exp.p) > 1:
                return f"sqrt({self._print(power.base)})**({power.exp.p})"
            return str(super()._print_Pow(power, rational=rational))

    return Printer({"fully_qualified_modules": False})


def text(expression: Expression) -> str:
    """Return an expression as Python source."""
    spaced = ast.unparse(ast.parse(_printer().doprint(expression), mode="eval"))
    return spaced.replace(" ** ", "**")


def lines_of(start: str, body: Any, indent: int = 0) -> list[str]:
    """Return `start` + `body` as lines wrapped at `LINE_LENGTH`. Later lines are indented, by default by the length of `start`."""
    following = " " * (indent or len(start))
    return wrap(
        f"{start}{body}", LINE_LENGTH, subsequent_indent=following, break_long_words=False, break_on_hyphens=False
    )  # fmt: skip


def function_text(
    name: str,
    doc: str,
    value: Any,
    state: Sequence[Expression],
    constants: Sequence[Expression],
    shapes: Iterable[Expression],
) -> str:
    """Return the source of a function that evaluates an expression or a tuple of expressions. Repeated parts get names.

    If an expression contains no state, the term 0.0 * symbol with a symbol from `shapes` gives the value the shape of a state.
    """
    import sympy

    values = list(value) if isinstance(value, tuple) else [value]
    used = {symbol.name for symbol in (*state, *constants)}
    lines = [f"def {name}(state, constants):", *([f'    """{doc}"""'] if doc else [])]
    for symbols, source in ((state, "state"), (constants, "constants")):
        if symbols:
            names = ", ".join(symbol.name for symbol in symbols) + "," * (len(symbols) == 1)
            lines.append(f"    {names} = {source}")
    free = (symbol for symbol in sympy.numbered_symbols("part", start=1) if symbol.name not in used)
    parts, reduced = sympy.cse(values, free, order="canonical", list=True)
    named = dict[Expression, Expression]()
    for symbol, part in parts:
        body = text(part.xreplace(named))
        # sin(a - b) becomes sin_a_minus_b. Operations other than sums and differences make no names.
        words = body.replace(" - ", "_minus_").replace(" + ", "_plus_").replace("(", "_").rstrip(")")
        speaks = words.isidentifier() and len(words) <= MAX_NAME and words not in used
        named[symbol] = sympy.Symbol(words) if speaks else symbol
        used.add(named[symbol].name)
        lines += _statement(f"{named[symbol]} = ", body)
    texts = [
        text(each.xreplace(named)) + ("" if whole.free_symbols & {*state} else f" + 0.0 * {shape.name}")
        for each, whole, shape in zip(reduced, values, shapes, strict=False)
    ]
    if not isinstance(value, tuple):
        return "\n".join([*lines, *_statement("return ", texts[0])])
    result = ", ".join(texts) + "," * (len(texts) == 1)
    if len(result) < LINE_LENGTH - 11:
        return "\n".join([*lines, f"    return {result}"])
    each_alone = [line for each in texts for line in lines_of("        ", f"{each},")]
    return "\n".join([*lines, "    return (", *each_alone, "    )"])


def _statement(start: str, body: str) -> list[str]:
    """Return the lines of a statement in a function. If there are several lines, `body` is in parentheses."""
    if len(start) + len(body) < LINE_LENGTH - 4:
        return [f"    {start}{body}"]
    return lines_of(f"    {start}(", f"{body})", indent=8)
