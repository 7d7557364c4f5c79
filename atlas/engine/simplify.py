"""Equations without terms that vanish in a whole scene: x * 0, x + 0, x - x and x * 1, on the syntax tree.

x * y - x * z becomes x * (y - z). The result is the same to round-off; LLVM may not do this itself, because x
* 0 is not 0 for a NaN or an infinity.
"""

from __future__ import annotations

import ast
from collections.abc import Collection, Mapping
from functools import reduce


def simplify(text: str, zero: Collection[str], equal: Mapping[str, str], ones: Collection[str] = ()) -> str:
    """Source of a function for names that are 0 (which comes first), 1, or equal to another name."""
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
                (first, *y), (second, *z) = _factors(left), _factors(right)
                if y and z and isinstance(first, ast.Name) and ast.dump(first) == ast.dump(second):
                    return ast.BinOp(first, ast.Mult(), ast.BinOp(_product(y), ast.Sub(), _product(z)))
        return ast.BinOp(left, node.op, right)


def _factors(node: ast.expr) -> list[ast.expr]:
    if isinstance(node, ast.BinOp) and isinstance(node.op, ast.Mult):
        return [*_factors(node.left), node.right]
    return [node]


def _product(factors: list[ast.expr]) -> ast.expr:
    return reduce(lambda x, y: ast.BinOp(x, ast.Mult(), y), factors)
