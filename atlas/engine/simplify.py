"""Leave out of the equations what vanishes in a whole scene: x * 0, x + 0, x - x and x * 1, on the syntax tree.
x * y - x * z becomes x * (y - z).

The result is the same to round-off. LLVM may not do this itself: 0 * x is not 0 for a NaN or an infinity.
"""

from __future__ import annotations

import ast
from collections.abc import Collection, Mapping
from functools import reduce


def simplify(text: str, zero: Collection[str], same: Mapping[str, str], ones: Collection[str] = ()) -> str:
    """Source of a function with the names in `zero` set to 0, those in `ones` to 1, and each key of `same`
    replaced by its value. A name in both is 0.
    """
    tree = ast.parse(text)
    folder = _Folder(set(zero), dict(same), set(ones))
    return ast.unparse(ast.fix_missing_locations(folder.visit(tree)))


def _is(node: ast.expr, value: float) -> bool:
    return isinstance(node, ast.Constant) and node.value == value


class _Folder(ast.NodeTransformer):
    def __init__(self, zero: set[str], same: dict[str, str], ones: set[str]):
        self.zero, self.same, self.ones = zero, same, ones

    def visit_Name(self, node: ast.Name) -> ast.expr:
        if isinstance(node.ctx, ast.Load):
            if node.id in self.zero:
                return ast.Constant(0.0)
            if node.id in self.ones:
                return ast.Constant(1.0)
            return ast.Name(self.same.get(node.id, node.id), node.ctx)
        return node

    def visit_Assign(self, node: ast.Assign) -> ast.Assign:
        """Fold the right side; names that are assigned a plain 0 vanish from there on."""
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
                (one, *y), (two, *z) = _factors(left), _factors(right)
                if y and z and isinstance(one, ast.Name) and ast.dump(one) == ast.dump(two):
                    return ast.BinOp(one, ast.Mult(), ast.BinOp(_product(y), ast.Sub(), _product(z)))
        return ast.BinOp(left, node.op, right)


def _factors(node: ast.expr) -> list[ast.expr]:
    if isinstance(node, ast.BinOp) and isinstance(node.op, ast.Mult):
        return [*_factors(node.left), node.right]
    return [node]


def _product(factors: list[ast.expr]) -> ast.expr:
    return reduce(lambda x, y: ast.BinOp(x, ast.Mult(), y), factors)
