"""Differentiation of functions for the variational equations, and simplification of functions in which terms vanish.

`simplify` removes x * 0, x + 0, x - x and x * 1, and turns x * y - x * z into x * (y - z). The result is equal up to rounding.
LLVM may not do this itself, because x * 0 is not 0 if x is NaN or infinite.
"""

from __future__ import annotations

import ast
from collections.abc import Collection, Mapping
from functools import reduce

from ..systems import arithmetic

PREFIX = "d_"  # added in front of a name to name the differential

# Derivatives, as text, of functions of one argument x.
_DERIVATIVES = {
    "sqrt": "0.5 / {function}({x})",
    "sin": "{module}cos({x})",
    "cos": "-{module}sin({x})",
    "tan": "1.0 + {function}({x}) * {function}({x})",
    "asin": "1.0 / {module}sqrt(1.0 - ({x}) * ({x}))",
    "acos": "-1.0 / {module}sqrt(1.0 - ({x}) * ({x}))",
    "atan": "1.0 / (1.0 + ({x}) * ({x}))",
    "sinh": "{module}cosh({x})",
    "cosh": "{module}sinh({x})",
    "tanh": "1.0 - {function}({x}) * {function}({x})",
    "exp": "{function}({x})",
    "log": "1.0 / ({x})",
}


def function_tree(text: str) -> ast.FunctionDef:
    """Return the syntax tree of the source of a function."""
    function = ast.parse(text).body[0]
    assert isinstance(function, ast.FunctionDef)
    return function


def differential(text: str, name: str) -> str:
    """Return the source of ``name(state, constants, change)``, the differential of the function in `text` for a `change` of the state.

    The function in `text` assigns names or tuples of names, and returns a tuple. It may use + - * /, powers whose exponents do
    not depend on the state, and `systems.arithmetic.FUNCTIONS`. Everything else raises ValueError.
    """
    function = function_tree(text)
    active: set[str] = set()  # names that depend on the state
    body: list[ast.stmt] = []
    for statement in function.body:
        match statement:
            case ast.Assign(targets=[ast.Tuple(elts=names)], value=ast.Name(id="state")):
                active |= {element.id for element in names if isinstance(element, ast.Name)}
                changes = ", ".join(f"{PREFIX}{ast.unparse(element)}" for element in names)
                body += [statement, *ast.parse(f"{changes}, = change").body]
            case ast.Assign(targets=[target], value=value):
                # The differential comes first, because it needs the values that names have before the assignment.
                pairs = [(target, value)]
                if isinstance(target, ast.Tuple) and isinstance(value, ast.Tuple):
                    pairs = list(zip(target.elts, value.elts, strict=True))
                differentials = {ast.unparse(left): _differential(right, active) for left, right in pairs}
                for assigned, change in differentials.items():
                    (active.discard if change is None else active.add)(assigned)
                changes = ", ".join(f"{PREFIX}{assigned}" for assigned in differentials if assigned in active)
                if changes:
                    slopes = ", ".join(map(ast.unparse, filter(None, differentials.values())))
                    body += ast.parse(f"{changes}, = {slopes},").body
                body.append(statement)
            case ast.Return(value=ast.Tuple(elts=values)):
                all_changes = (_differential(value, active) for value in values)
                texts = ("0.0" if change is None else ast.unparse(change) for change in all_changes)
                body += ast.parse(f"return ({', '.join(texts)},)").body
            case ast.Expr(value=ast.Constant()):  # the docstring
                pass
            case _:
                raise ValueError(f"{function.name} cannot be differentiated: {ast.unparse(statement)}")
    arguments = function_tree("def _(state, constants, change): pass").args
    new = ast.FunctionDef(name, arguments, body, [], lineno=1)
    return ast.unparse(ast.fix_missing_locations(ast.Module([new], [])))


def _differential(node: ast.expr, active: set[str]) -> ast.expr | None:
    """Return the differential of an expression, or None if the expression does not depend on the state."""
    if not arithmetic.names_in(node) & active:
        return None
    match node:
        case ast.Name(id=name):
            return ast.Name(f"{PREFIX}{name}")
        case ast.UnaryOp(op=ast.USub() | ast.UAdd() as sign, operand=operand):
            return ast.UnaryOp(sign, _nonzero(_differential(operand, active)))
        case ast.BinOp(left=left, op=ast.Add() | ast.Sub() as op, right=right):
            return _sum(_differential(left, active), _differential(right, active), op)
        case ast.BinOp(left=left, op=ast.Mult(), right=right):
            # Factors that do not depend on the state are taken out of the sum.
            changes = [(factor, _differential(factor, active)) for factor in _factors(left) + _factors(right)]
            constant = [factor for factor, change in changes if change is None]
            variable = [(factor, change) for factor, change in changes if change is not None]
            terms = [
                reduce(_times, [change if i == j else factor for j, (factor, _) in enumerate(variable)])
                for i, (_, change) in enumerate(variable)
            ]
            return reduce(_times, [*constant, reduce(lambda x, y: ast.BinOp(x, ast.Add(), y), terms)])
        case ast.BinOp(left=left, op=ast.Div(), right=right):
            dx, dy = _differential(left, active), _differential(right, active)
            quotient = None if dy is None else _times(ast.BinOp(left, ast.Div(), right), dy)
            return ast.BinOp(_sum(dx, quotient, ast.Sub()), ast.Div(), right)
        case ast.BinOp(left=left, op=ast.Pow(), right=right) if _differential(right, active) is None:
            lower = ast.BinOp(left, ast.Pow(), ast.BinOp(right, ast.Sub(), ast.Constant(1.0)))
            return _times(_times(right, lower), _nonzero(_differential(left, active)))
        case ast.Call(func=function, args=[x]):  # such as sin(x) or np.sin(x)
            text = ast.unparse(function)
            module, _, name = text.rpartition(".")
            if name not in _DERIVATIVES:
                raise ValueError(f"cannot be differentiated: {ast.unparse(node)}")
            derivative = _DERIVATIVES[name].format(
                function=text, module=f"{module}." if module else "", x=ast.unparse(x)
            )
            return _times(ast.parse(derivative, mode="eval").body, _nonzero(_differential(x, active)))
        case _:
            raise ValueError(f"cannot be differentiated: {ast.unparse(node)}")


def _nonzero(change: ast.expr | None) -> ast.expr:
    assert change is not None
    return change


def _sum(x: ast.expr | None, y: ast.expr | None, op: ast.operator) -> ast.expr:
    """Return the sum or difference of two terms, one of which may be None."""
    if y is None:
        return _nonzero(x)
    if x is None:
        return ast.UnaryOp(ast.USub(), y) if isinstance(op, ast.Sub) else y
    return ast.BinOp(x, op, y)


def _factors(node: ast.expr) -> list[ast.expr]:
    """Return all factors of a product."""
    if isinstance(node, ast.BinOp) and isinstance(node.op, ast.Mult):
        return _factors(node.left) + _factors(node.right)
    return [node]


def _times(x: ast.expr, y: ast.expr) -> ast.expr:
    return ast.BinOp(x, ast.Mult(), y)


def simplify(text: str, zero: Collection[str], equal: Mapping[str, str], ones: Collection[str] = ()) -> str:
    """Return the source of a function, simplified for names that are 0, 1 or equal to another name."""
    tree = ast.parse(text)
    simplifier = _Simplifier(set(zero), dict(equal), set(ones))
    return ast.unparse(ast.fix_missing_locations(simplifier.visit(tree)))


def _is(node: ast.expr, value: float) -> bool:
    return isinstance(node, ast.Constant) and node.value == value


class _Simplifier(ast.NodeTransformer):
    def __init__(self, zero: set[str], equal: dict[str, str], ones: set[str]):
        self.zero, self.equal, self.ones = zero, equal, ones

    def visit_Name(self, node: ast.Name) -> ast.expr:
        if isinstance(node.ctx, ast.Load):
            if node.id in self.zero:
                return ast.Constant(0.0)
            if node.id in self.ones:
                return ast.Constant(1.0)
            return ast.Name(self.equal.get(node.id, node.id), node.ctx)
        return node

    def visit_Assign(self, node: ast.Assign) -> ast.Assign:
        """Simplify the right side. A name that is assigned 0 counts as 0 in the lines that follow."""
        node.value = self.visit(node.value)
        target = node.targets[0]
        if isinstance(target, ast.Tuple) and isinstance(node.value, ast.Tuple):
            pairs = list(zip(target.elts, node.value.elts, strict=True))
        else:
            pairs = [(target, node.value)]
        self.zero |= {name.id for name, value in pairs if isinstance(name, ast.Name) and _is(value, 0.0)}
        return node

    def visit_UnaryOp(self, node: ast.UnaryOp) -> ast.expr:
        node.operand = self.visit(node.operand)
        return node.operand if _is(node.operand, 0.0) else node

    def visit_BinOp(self, node: ast.BinOp) -> ast.expr:
        left, right = self.visit(node.left), self.visit(node.right)
        match node.op:
            case ast.Mult() if _is(left, 0.0) or _is(right, 0.0):
                return ast.Constant(0.0)
            case ast.Mult() if _is(left, 1.0):
                return right
            case ast.Mult() if _is(right, 1.0):
                return left
            case ast.Add() if _is(left, 0.0):
                return right
            case ast.Add() | ast.Sub() if _is(right, 0.0):
                return left
            case ast.Sub() if _is(left, 0.0):
                return ast.UnaryOp(ast.USub(), right)
            case ast.Sub() if ast.dump(left) == ast.dump(right):
                return ast.Constant(0.0)
            case ast.Sub():
                (first, *y), (second, *z) = _left_factors(left), _left_factors(right)
                if y and z and isinstance(first, ast.Name) and ast.dump(first) == ast.dump(second):
                    return _times(first, ast.BinOp(reduce(_times, y), ast.Sub(), reduce(_times, z)))
        return ast.BinOp(left, node.op, right)


def _left_factors(node: ast.expr) -> list[ast.expr]:
    """Return the factors of a product from left to right. A product in parentheses on the right counts as one factor."""
    if isinstance(node, ast.BinOp) and isinstance(node.op, ast.Mult):
        return [*_left_factors(node.left), node.right]
    return [node]
