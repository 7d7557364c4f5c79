"""Expressions of SymPy as plain Python arithmetic, with names for what occurs several times."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

from ...errors import BadInput, shown
from ...systems.arithmetic import FUNCTIONS

# Any expression or symbol of sympy, which is imported only when it is used.
Expression = Any
LINE_LENGTH = 110
MAX_NAME = 30  # characters of a name made from an expression
MAX_FACTORS = 4  # largest power that is written as a product
_WORDS = {" + ": "_plus_", " - ": "_minus_", " * ": "_", " / ": "_over_", "**": "_to_", "-": "minus_"}


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


def text(expression: Expression) -> str:
    """An expression as Python source; small powers of symbols become products, which need no function."""
    if expression.is_Add:
        pairs = []
        for term in expression.as_ordered_terms():
            negative = term.as_coeff_Mul()[0].is_negative
            pairs.append(("-" if negative else "+", text(-term if negative else term)))
        # A positive term comes first where there is one.
        first = next((i for i, (sign, _) in enumerate(pairs) if sign == "+"), 0)
        sign, start = pairs.pop(first)
        return " ".join([f"-{start}" if sign == "-" else start, *(f"{s} {t}" for s, t in pairs)])
    if expression.is_Symbol:
        return str(expression.name)
    if expression.is_Function:
        return f"{type(expression).__name__}({text(expression.args[0])})"
    coefficient, rest = expression.as_coeff_Mul()
    above, below = _number(abs(coefficient))
    for factor in rest.as_ordered_factors() if rest != 1 else []:
        # A function, such as exp(x), is a base.
        base, exponent = (factor, factor**0) if factor.is_Function else factor.as_base_exp()
        if exponent.is_number and exponent.is_negative:
            below += _power(base, -exponent)
        else:
            above += _power(base, exponent)
    result = " * ".join(above) or "1.0"
    if below:
        result += f" / {below[0]}" if len(below) == 1 else f" / ({' * '.join(below)})"
    return f"-{result}" if coefficient.is_negative else result


def _number(value: Expression) -> tuple[list[str], list[str]]:
    """A positive number as factors above and below the line; fractions that binary numbers hold as one number."""
    if value == 1:
        return [], []
    if not value.is_Rational:
        return [repr(float(value))], []
    if value.q & (value.q - 1) == 0 and value.q <= 1024:
        return [str(value.p) if value.q == 1 else repr(value.p / value.q)], []
    return [str(value.p)] if value.p != 1 else [], [str(value.q)]


def _power(base: Expression, exponent: Expression) -> list[str]:
    import sympy

    if base.is_number and not base.is_Rational:
        base = sympy.Symbol(repr(float(base)))
    body = text(base) if base.is_Symbol or base.is_Function or base.is_Integer else f"({text(base)})"
    if exponent == 1:
        return [body]
    if exponent.is_Integer and exponent <= MAX_FACTORS and base.is_Symbol:
        return [body] * int(exponent)
    if exponent == sympy.Rational(1, 2):
        return [f"sqrt({text(base)})"]
    if exponent.is_Rational and exponent.q == 2:
        return [*_power(base, exponent - sympy.Rational(1, 2)), f"sqrt({text(base)})"]
    power = text(exponent) if exponent.is_Symbol or exponent.is_Integer else f"({text(exponent)})"
    return [f"{body}**{power}"]


def lines_of(start: str, expression: Expression) -> list[str]:
    """An expression in mathematical form after `start`, in lines that are short if its terms are."""
    lines, indent = [start.rstrip()], " " * len(start)
    pairs = [(term.as_coeff_Mul()[0].is_negative, term) for term in expression.as_ordered_terms()]
    for i, (negative, term) in enumerate(pairs):
        sign = "- " if negative and i else "-" if negative else "+ " if i else ""
        piece = f"{sign}{-term if negative else term}"
        if i and len(lines[-1]) + 1 + len(piece) > LINE_LENGTH:
            lines.append(indent + piece)
        else:
            lines[-1] += f" {piece}"
    return lines


class Block:
    """Assignments of a function of ``(state, constants)`` and what it returns."""

    def __init__(self, state: Sequence[Expression], constants: Sequence[Expression]):
        self.state, self.constants = tuple(state), tuple(constants)
        self.names = {symbol.name for symbol in (*state, *constants)}
        self.definitions: dict[Expression, Expression] = {}  # name -> expression
        self.functions: list[Expression] = []  # names of the values of functions

    def named(self, name: str, expression: Expression) -> Expression:
        """The symbol of that name, or one like it, for an expression; symbols and numbers stand for themselves."""
        if (-expression if expression.could_extract_minus_sign() else expression).is_Atom:
            return expression
        symbol = self._new(name)
        self.definitions[symbol] = expression
        return symbol

    def _new(self, name: str) -> Expression:
        """A symbol whose name is not in use."""
        import sympy

        stem = name.rstrip("0123456789")
        number = int(name[len(stem) :] or 1)
        while name in self.names:
            number += 1
            name = f"{stem}{number}"
        self.names.add(name)
        return sympy.Symbol(name)

    def function(
        self, name: str, doc: str, first: Sequence[str], slopes: Sequence[tuple[str, Expression, Expression]]
    ) -> str:
        """Text of a function that returns `first` as it stands, then slopes in the shape of their states."""
        reduced, lines, done = self._start([expression for _, expression, _ in slopes])
        values = list(first)
        for (slope, _, like), expression in zip(slopes, reduced, strict=True):
            lines += self._definitions_for(expression, done)
            body = self._in_shape_of(expression, like)
            if expression.is_Symbol:
                values.append(body)
            else:
                values.append(self._new(slope).name)
                lines += _statement(f"{values[-1]} = ", body)
        return self._text(name, doc, [*lines, *_return_statement(values)])

    def returning(self, name: str, doc: str, value: Any) -> str:
        """Text of a function, with a docstring if `doc`, that returns an expression or a tuple of them."""
        reduced, lines, done = self._start(list(value) if isinstance(value, tuple) else [value])
        for expression in reduced:
            lines += self._definitions_for(expression, done)
        values = [self._in_shape_of(expression, self.state[0]) for expression in reduced]
        lines += _return_statement(values) if isinstance(value, tuple) else _statement("return ", values[0])
        return self._text(name, doc, lines)

    def _start(self, expressions: list[Expression]) -> tuple[list[Expression], list[str], set[Expression]]:
        """Expressions with names for what they share, lines that define the values of functions, and the names in these."""
        reduced, done = self._with_common_names(expressions), set[Expression]()
        return (
            reduced,
            [line for symbol in self.functions for line in self._definitions_for(symbol, done)],
            done,
        )

    def _in_shape_of(self, expression: Expression, like: Expression) -> str:
        """Text of an expression; one that depends on no state gets the shape of a state."""
        if self._depends_on_state(expression):
            return text(expression)
        return f"0.0 * {like.name}" if expression == 0 else f"{text(expression)} + 0.0 * {like.name}"

    def _depends_on_state(self, expression: Expression) -> bool:
        """Whether a state occurs in an expression or in the definitions of its names."""
        return any(
            symbol in self.state
            or (symbol in self.definitions and self._depends_on_state(self.definitions[symbol]))
            for symbol in expression.free_symbols
        )

    def _with_common_names(self, expressions: list[Expression]) -> list[Expression]:
        """The expressions with names for functions and for what occurs several times, also in the definitions."""
        import sympy

        symbols, functions = [*self.definitions], dict[Expression, Expression]()
        given = [self._with_functions(e, functions) for e in [*self.definitions.values(), *expressions]]
        self.functions = [*functions.values()]
        replaced, reduced = sympy.cse([*functions, *given], order="canonical", list=True)
        named, new = dict(zip(reduced, self.functions, strict=False)), dict[Expression, Expression]()
        # Each stands for a name, or for itself if it is one operation at most.
        for symbol, expression in replaced:
            part = expression.xreplace(new)
            new[symbol] = named.get(symbol) or (part if part.count_ops() <= 1 else self._new("common1"))
        values = [expression.xreplace(new) for expression in reduced]
        names = [*self.functions, *symbols]
        self.definitions |= dict(zip(names, values, strict=False))
        for symbol, expression in replaced:
            if new[symbol].is_Symbol:
                self.definitions[new[symbol]] = expression.xreplace(new)
        return values[len(names) :]

    def _with_functions(self, expression: Expression, named: dict[Expression, Expression]) -> Expression:
        """The expression with a name for each value of a function and each sum that is raised to a power."""
        import sympy

        if expression.is_Atom:
            return expression
        new = expression.func(*(self._with_functions(part, named) for part in expression.args))
        half = sympy.Rational(1, 2)
        if new.is_Function:
            return self._function_name(new, named)
        if not new.is_Pow or not new.exp.is_Rational or new.base.is_number:
            return new
        if new.exp.q == 2:
            return self._function_name(sympy.sqrt(new.base), named) ** (new.exp / half)
        if new.exp.is_Integer and abs(new.exp) > 1 and not new.base.is_Symbol:
            return self._function_name(new.base, named) ** new.exp
        return new

    def _function_name(self, expression: Expression, named: dict[Expression, Expression]) -> Expression:
        """The name of an expression, made from its text where that is short and it has none yet."""
        if expression not in named:
            kind = type(expression).__name__ if expression.is_Function else "sum"
            function = "sqrt" if expression.is_Pow else kind
            argument = text(expression.args[0] if function != "sum" else expression)
            for sign, word in _WORDS.items():
                argument = argument.replace(sign, word)
            name = argument if function == "sum" else f"{function}_{argument}"
            short = name.isidentifier() and len(name) <= MAX_NAME
            named[expression] = self._new(name if short else f"{function}1")
        return named[expression]

    def _definitions_for(self, expression: Expression, done: set[Expression]) -> Iterator[str]:
        """Lines that define the names in an expression that are not defined yet, in the order of need."""
        for symbol in sorted(expression.free_symbols, key=lambda s: s.name):
            if symbol in self.definitions and symbol not in done:
                definition = self.definitions[symbol]
                yield from self._definitions_for(definition, done)
                done.add(symbol)
                yield from _statement(f"{symbol.name} = ", text(definition))

    def _text(self, name: str, doc: str, lines: Sequence[str]) -> str:
        """The function, with the unpacking of state and constants."""
        head = [f"def {name}(state, constants):"]
        head += [f'    """{doc}"""'] if doc else []
        for names, source in ((self.state, "state"), (self.constants, "constants")):
            if names:
                target = ", ".join(symbol.name for symbol in names) + ("," if len(names) == 1 else "")
                head.append(f"    {target} = {source}")
        return "\n".join([*head, *lines])


def _statement(start: str, body: str) -> list[str]:
    """A statement of a function in one line, or in parentheses and several lines, a term or factor each."""
    if len(f"    {start}{body}") <= LINE_LENGTH:
        return [f"    {start}{body}"]
    return [f"    {start}(", *_lines_in_parentheses(body, ""), "    )"]


def _lines_in_parentheses(body: str, end: str) -> list[str]:
    """An expression in lines of eight blanks more, and its end; one line for each term if it is too long, or each factor."""
    pieces = [body]
    for operators in ((" + ", " - "), (" * ", " / ")):
        if len(f"        {body}{end}") > LINE_LENGTH and len(pieces) == 1:
            starts, depth = [0], 0
            for i, character in enumerate(body):
                depth += (character == "(") - (character == ")")
                if depth == 0 and body[i : i + 3] in operators:
                    starts.append(i + 1)
            pieces = [body[i:j].rstrip() for i, j in zip(starts, [*starts[1:], len(body)], strict=True)]
    return [f"        {piece}" for piece in pieces[:-1]] + [f"        {pieces[-1]}{end}"]


def _return_statement(values: Sequence[str]) -> list[str]:
    line = f"    return ({values[0]},)" if len(values) == 1 else f"    return {', '.join(values)}"
    if len(line) <= LINE_LENGTH:
        return [line]
    return [
        "    return (",
        *(line for value in values for line in _lines_in_parentheses(value, ",")),
        "    )",
    ]
