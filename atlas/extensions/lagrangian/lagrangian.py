"""The module of equations of a mechanical system, written from its Lagrangian.

With coordinates q, velocities v = q', the Lagrangian L(q, v), generalised forces Q and the dissipation
function R the equations of motion are

    M v' = f,    M_ij = d2L/dv_i dv_j,    f_i = dL/dq_i - sum_j v_j d2L/dv_i dq_j + Q_i - dR/dv_i.

The equations are solved for v' symbolically, separately for each group of velocities that M couples. One velocity needs a division,
two need the inverse matrix, and more need the factors M = K D K^T, with K lower triangular and D diagonal. The factors exist
for a positive definite mass matrix, as in mechanics.
"""

from __future__ import annotations

import keyword
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import repeat
from pathlib import Path
from typing import Any

import numpy as np

from ...errors import BadInput, shown
from ...files import atomic_write
from ...systems.arithmetic import FUNCTIONS, TIME_UNIT
from .sympy_text import function_text, lines_of, require_arithmetic

# This stands for expressions and symbols of SymPy, which is imported only when it is used.
Expression = Any
# These names have a meaning in modules of equations, or in kernels that contain the functions of such modules.
RESERVED = frozenset(
    {"state", "constants", "rhs", "energy", TIME_UNIT, *FUNCTIONS}
    | {"STATE", "CONSTANTS", "ONES", "INTEGRALS", "LOSSES", "OBSERVABLES", "SOURCES"}
)
# A mass matrix is singular if its determinant, computed with `DIGITS` digits after rows are divided by their norms, is below
# `SINGULAR`. For a matrix without floats the limit is `SINGULAR_EXACT`.
SINGULAR, SINGULAR_EXACT, DIGITS = 1e-13, 1e-30, 50
MAX_OPERATIONS = 70  # Expressions with more operations are simplified by fast methods only.


def from_lagrangian(
    lagrangian: Expression,
    coordinates: Sequence[Expression],
    velocities: Sequence[Expression],
    parameters: Sequence[Expression],
    *,
    forces: Mapping[Expression, Expression] | None = None,
    dissipation: Expression = 0,
    omit: Sequence[Expression] = (),
    functions: Mapping[str, Expression | Sequence[Expression]] | None = None,
    title: str = "Equations of motion",
    path: str | Path | None = None,
) -> str:
    """Write the module of equations of a system from its Lagrangian.

    All expressions are SymPy's (``pip install sympy``) and consist of plain symbols, numbers,
    arithmetic and the functions of `arithmetic.FUNCTIONS`. The same arguments give the same text.

    Parameters
    ----------
    lagrangian : sympy.Expr
        Kinetic minus potential energy, a function of coordinates, velocities and parameters, not of the time.
    coordinates, velocities : sequence of sympy.Symbol
        Generalised coordinates and their time derivatives, in the same order. The state consists of the coordinates,
        then the velocities.
    parameters : sequence of sympy.Symbol
        Constants of the equations.
    forces : mapping of sympy.Symbol to sympy.Expr, optional
        Generalised forces that the Lagrangian does not contain, by coordinate.
    dissipation : sympy.Expr, optional
        Rayleigh's function. The derivatives of this function by the velocities are subtracted from the forces.
    omit : sequence of sympy.Symbol, optional
        Cyclic coordinates to leave out of the state; their velocities stay.
    functions : mapping of str to sympy.Expr or sequence of sympy.Expr, optional
        More functions of state and constants by name, such as observables or ``frame_motion``.
    title : str, optional
        First line of the module's docstring, without a full stop.
    path : str or Path, optional
        File to write; an existing file is replaced.

    Returns
    -------
    str
        Source of a module with ``STATE``, ``CONSTANTS``, ``INTEGRALS`` and the functions ``rhs``, the first integrals
        and the given `functions`. First integrals are ``energy``, unless a force does work, and ``momentum_NAME`` for every cyclic
        coordinate on which no force acts. If dissipation changes a first integral NAME, the module has a function NAME_loss for
        the rate of decrease, which ``LOSSES`` names.

    Raises
    ------
    BadInput
        If SymPy is not installed; if a symbol is neither coordinate, velocity nor parameter; if an expression is not
        arithmetic; if a coordinate to be omitted is not cyclic; if the mass matrix is singular, or couples more than two
        velocities and has a leading minor that is 0.

    References
    ----------
    H. Goldstein, C. Poole, J. Safko, Classical Mechanics, 3rd ed., sections 1.5, 2.6 and 2.7.
    """
    try:
        import sympy  # noqa: F401
    except ImportError:
        raise BadInput("from_lagrangian: needs SymPy, which is not installed: pip install sympy") from None
    groups = {"coordinates": coordinates, "velocities": velocities, "parameters": parameters, "omit": omit}
    source = _Mechanics.of(lagrangian, groups, forces or {}, dissipation, functions or {}).module(title)
    if path is not None:
        with atomic_write(Path(path)) as temporary:
            temporary.write_text(source, encoding="utf-8")
    return source


@dataclass(frozen=True)
class _Mechanics:
    """Checked arguments of `from_lagrangian`, as expressions of SymPy."""

    lagrangian: Expression
    coordinates: tuple[Expression, ...]
    velocities: tuple[Expression, ...]
    parameters: tuple[Expression, ...]
    forces: tuple[Expression, ...]  # one force for each coordinate
    dissipation: Expression
    omit: tuple[Expression, ...]
    functions: Mapping[str, tuple[Expression, ...] | Expression] = field(default_factory=dict)

    @classmethod
    def of(
        cls,
        lagrangian: Expression,
        groups: Mapping[str, Sequence[Expression]],
        forces: Mapping[Expression, Expression],
        dissipation: Expression,
        functions: Mapping[str, Expression | Sequence[Expression]],
    ) -> _Mechanics:
        """Return the checked arguments. The mass matrix is not checked here. `groups` maps names of arguments to their symbols."""
        import sympy

        for name, group in groups.items():
            if not isinstance(group, Iterable):
                raise BadInput(f"from_lagrangian: {name} = {shown(group)}: must be a sequence of symbols")
            for symbol in group:
                if not isinstance(symbol, sympy.Symbol):
                    raise BadInput(
                        f"from_lagrangian: {name}: {shown(symbol)} is not a symbol; make one by sympy.Symbol('name')"
                    )
        q, v, p, omit = (tuple(group) for group in groups.values())
        if len(q) != len(v) or not q:
            raise BadInput(
                f"from_lagrangian: {len(q)} coordinates and {len(v)} velocities: each coordinate needs one velocity"
            )
        for name, table in (("forces", forces), ("functions", functions)):
            if not isinstance(table, Mapping):
                raise BadInput(f"from_lagrangian: {name} = {shown(table)}: must be a mapping")
        for name, keys in (("forces", forces), ("omit", omit)):
            for coordinate in keys:
                if coordinate not in q:
                    raise BadInput(
                        f"from_lagrangian: {name}: {shown(coordinate)} is not one of the coordinates"
                    )
        allowed = {*q, *v, *p}
        scalar = {"lagrangian": lagrangian, "dissipation": dissipation}
        scalar |= {f"forces[{coordinate}]": force for coordinate, force in forces.items()}
        given = {name: _expression(name, value, allowed) for name, value in scalar.items()}
        own: dict[str, Any] = {}
        for name, value in functions.items():
            several = isinstance(value, Iterable)
            parts = [
                _expression(f"functions[{name!r}]", part, allowed) for part in (value if several else [value])
            ]
            own[name] = tuple(parts) if several else parts[0]
        result = cls(
            given["lagrangian"], q, v, p, tuple(given.get(f"forces[{c}]", sympy.Integer(0)) for c in q),
            given["dissipation"], omit, own,
        )  # fmt: skip
        result._check_names()
        result._check_omitted()
        return result

    def _check_names(self) -> None:
        """Raise BadInput unless the names of functions and symbols differ and can stand in a module."""
        names = [symbol.name for symbol in (*self.coordinates, *self.velocities, *self.parameters)]
        names += [*self.functions, *(f"momentum_{c.name}" for c in self.coordinates)]
        names += ["energy_loss", *(f"momentum_{c.name}_loss" for c in self.coordinates)]
        for name in names:
            if (
                not (isinstance(name, str) and name.isidentifier())
                or keyword.iskeyword(name)
                or name in RESERVED
            ):
                raise BadInput(f"from_lagrangian: {shown(name)} cannot be a name of the equations")
            if names.count(name) > 1:
                raise BadInput(f"from_lagrangian: the name {name} is given twice")

    def _check_omitted(self) -> None:
        """Raise BadInput if the Lagrangian, a force or a function depends on an omitted coordinate."""
        for i, coordinate in enumerate(self.coordinates):
            if coordinate in self.omit and not self.is_cyclic(i):
                raise BadInput(
                    f"from_lagrangian: omit: {coordinate} is not cyclic: the Lagrangian or a force depends on it"
                )
            for name, value in self.functions.items():
                parts = value if isinstance(value, tuple) else (value,)
                if coordinate in self.omit and any(coordinate in part.free_symbols for part in parts):
                    raise BadInput(f"from_lagrangian: omit: the function {name} depends on {coordinate}")

    @property
    def state(self) -> tuple[Expression, ...]:
        """The coordinates that are not omitted, then the velocities."""
        return (*(c for c in self.coordinates if c not in self.omit), *self.velocities)

    def is_cyclic(self, i: int) -> bool:
        """Whether neither the Lagrangian nor a force depends on the coordinate with the index `i`."""
        given = (self.lagrangian, self.dissipation, *self.forces)
        return all(self.coordinates[i] not in expression.free_symbols for expression in given)

    def total_forces(self) -> list[Expression]:
        """Return the generalised forces, dissipation included."""
        pairs = zip(self.forces, self.velocities, strict=True)
        return [force - self.dissipation.diff(velocity) for force, velocity in pairs]

    def mass_matrix(self) -> list[list[Expression]]:
        """Return the second derivatives M of the Lagrangian by the velocities, or raise BadInput if M is singular."""
        momenta = [self.lagrangian.diff(velocity) for velocity in self.velocities]
        for velocity, momentum in zip(self.velocities, momenta, strict=True):
            if momentum == 0:
                raise BadInput(f"from_lagrangian: the velocity {velocity} does not occur in the Lagrangian")
        n = len(momenta)
        half = [[_simplest(momenta[i].diff(self.velocities[j])) for j in range(i + 1)] for i in range(n)]
        matrix = [[half[max(i, j)][min(i, j)] for j in range(n)] for i in range(n)]
        if _is_singular(matrix):
            raise BadInput(
                "from_lagrangian: the mass matrix, the second derivatives of the Lagrangian by the velocities, is"
                " singular: the equations cannot be solved for the accelerations"
            )
        return matrix

    def right_side(self, matrix: list[list[Expression]]) -> list[Expression]:
        """Return f of the equations M v' = f, with M = `matrix` and accelerations v'. Each component has the simpler of two forms."""
        pairs = list(zip(self.coordinates, self.velocities, strict=True))
        total = self.total_forces()
        result = []
        for i, (q, v) in enumerate(pairs):
            forms = []
            for lagrangian in (self.lagrangian, self._by_powers(matrix)):
                momentum = lagrangian.diff(v)
                moving = sum(velocity * momentum.diff(coordinate) for coordinate, velocity in pairs)
                forms.append(_simplest(lagrangian.diff(q) - moving + total[i]))
            result.append(min(forms, key=_cost))
        return result

    def _by_powers(self, matrix: list[list[Expression]]) -> Expression:
        """Return the Lagrangian. Its quadratic part is written as v.M v / 2 with velocities v and M = `matrix`, unless M depends on v."""
        import sympy

        v = sympy.Matrix(self.velocities)
        if sympy.Matrix(matrix).free_symbols & set(self.velocities):
            return self.lagrangian
        at_rest = dict.fromkeys(self.velocities, 0)
        linear = sum(velocity * self.lagrangian.diff(velocity).subs(at_rest) for velocity in self.velocities)
        return (v.T * sympy.Matrix(matrix) * v)[0] / 2 + linear + self.lagrangian.subs(at_rest)

    def integrals(self) -> dict[str, tuple[str, list[Expression]]]:
        """Return the meaning and the terms of each first integral. Each term comes from one term of the Lagrangian."""
        import sympy

        result, balances = {}, self.balances()
        terms = sympy.Add.make_args(sympy.expand_mul(self.lagrangian, deep=False))
        if "energy" in balances:
            energies = []  # A term T of degree 2 in the velocities adds T to the energy. A term T of degree 0 adds -T.
            for term in terms:
                momentum = sum(velocity * term.diff(velocity) for velocity in self.velocities)
                quadratic = momentum != 0 and sympy.expand(momentum - 2 * term) == 0
                part = term if quadratic else momentum - term
                energies.append(-term if momentum == 0 else _simplest(part))
            result["energy"] = ("Energy, sum of v dL/dv - L", [part for part in energies if part != 0])
        for coordinate, velocity in zip(self.coordinates, self.velocities, strict=True):
            if f"momentum_{coordinate.name}" in balances:
                parts = (_simplest(term.diff(velocity)) for term in terms)
                result[f"momentum_{coordinate.name}"] = (
                    f"Momentum dL/d{velocity.name} of the cyclic coordinate {coordinate.name}",
                    [part for part in parts if part != 0],
                )
        return result

    def balances(self) -> dict[str, Expression]:
        """Return the rates at which dissipation decreases the first integrals. The rate of a constant integral is 0."""

        def power(forces: Sequence[Expression]) -> Expression:
            return _simplest(sum(q * v for q, v in zip(forces, self.velocities, strict=True)))

        total, result = self.total_forces(), {}
        lost = -power(total)
        if lost == 0 or power(self.forces) == 0:
            result["energy"] = lost
        for i, coordinate in enumerate(self.coordinates):
            if self.is_cyclic(i) and 0 in (total[i], self.forces[i]):
                result[f"momentum_{coordinate.name}"] = -total[i]
        return result

    def accelerations(self) -> list[Expression]:
        """Return the accelerations as expressions."""
        import sympy

        matrix = self.mass_matrix()
        right_side = self.right_side(matrix)
        result: list[Expression] = [None] * len(right_side)
        for group in map(sorted, sympy.Matrix(matrix).connected_components()):
            part = [[matrix[i][j] for j in group] for i in group]
            for i, acceleration in zip(group, _solution(part, [right_side[i] for i in group]), strict=True):
                result[i] = acceleration
        return result

    def module(self, title: str) -> str:
        """Return the text of the module of equations."""
        pairs = list(zip(self.coordinates, self.velocities, strict=True))
        slopes = tuple(v for q, v in pairs if q not in self.omit) + tuple(self.accelerations())
        integrals = self.integrals()
        losses = {name: loss for name, loss in self.balances().items() if loss != 0}
        returning: list[tuple[str, str, Any]] = [
            (name, f"{meaning}; the tuple of its terms.", tuple(terms))
            for name, (meaning, terms) in integrals.items()
        ]
        returning += [
            (f"{name}_loss", f"What dissipation takes of `{name}` per time.", loss)
            for name, loss in losses.items()
        ]
        returning += [(name, "", value) for name, value in self.functions.items()]
        symbols, shapes = (self.state, self.parameters), repeat(self.state[0])
        functions = [function_text("rhs", "Time derivatives of the state.", slopes, *symbols, self.state)]
        functions += [function_text(*each, *symbols, shapes) for each in returning]
        used = sorted(name for name in FUNCTIONS if re.search(rf"\b{name}\(", "".join(functions)))
        names = [name if FUNCTIONS[name] == name else f"{FUNCTIONS[name]} as {name}" for name in used]
        head = [self.docstring(title), *([f"from numpy import {', '.join(names)}\n"] if used else [])]
        head.append(f"STATE = {_names(self.state)}\nCONSTANTS = {_names(self.parameters)}")
        head[-1] += f"\nINTEGRALS = {_names(list(integrals))}\n"
        if losses:
            head[-1] += "LOSSES = {" + ", ".join(f'"{name}": "{name}_loss"' for name in losses) + "}\n"
        return "\n".join(head) + "\n\n" + "\n\n\n".join(functions) + "\n"

    def docstring(self, title: str) -> str:
        """Return the docstring of the module, with the Lagrangian and the forces."""
        lines = [f'"""{title}.', "", "Written by atlas.systems.from_lagrangian from the Lagrangian", ""]
        lines += lines_of("    L = ", self.lagrangian)
        if self.dissipation != 0:
            lines += ["", "and the dissipation function", "", *lines_of("    R = ", self.dissipation)]
        forces = [pair for pair in zip(self.coordinates, self.forces, strict=True) if pair[1] != 0]
        if forces:
            lines += ["", "and the generalised forces", ""]
            lines += [line for c, force in forces for line in lines_of(f"    Q_{c.name} = ", force)]
        if self.omit:
            names = ", ".join(coordinate.name for coordinate in self.omit)
            lines += ["", f"The state does not contain the cyclic coordinates {names}."]
        return "\n".join([*lines, '"""', ""])


def _expression(name: str, value: Any, allowed: set[Expression]) -> Expression:
    """Return an expression of SymPy that is arithmetic of known symbols, or raise BadInput."""
    import sympy

    if isinstance(value, int | float):
        value = sympy.sympify(value)
    if not isinstance(value, sympy.Expr):
        raise BadInput(f"from_lagrangian: {name} = {shown(value)}: must be an expression of SymPy")
    require_arithmetic(f"from_lagrangian: {name}", value)
    for symbol in sorted(value.free_symbols - allowed, key=str):
        raise BadInput(
            f"from_lagrangian: {name} contains {symbol}, which is neither coordinate, velocity nor parameter"
        )
    return value


def _is_singular(matrix: list[list[Expression]]) -> bool:
    """Whether the determinant vanishes at three random points. The points are complex, so that every root and every logarithm exists."""
    import mpmath
    import sympy

    whole = sympy.Matrix(matrix)
    symbols = sorted(whole.free_symbols, key=str)
    value = sympy.lambdify(symbols, whole, "mpmath")
    limit = SINGULAR if whole.has(sympy.Float) else SINGULAR_EXACT
    rng = np.random.default_rng(0)
    with mpmath.workdps(DIGITS):
        for _ in range(3):
            parts = rng.uniform(0.1, 0.9, (len(symbols), 2))
            rows = value(*(mpmath.mpc(*part) for part in parts))
            norms = [mpmath.norm(rows[i, :]) for i in range(len(matrix))]
            if all(norms) and abs(mpmath.det(rows)) > limit * mpmath.fprod(norms):
                return False
    return True


def _simplest(expression: Expression) -> Expression:
    """Return the form of an expression with the least `_cost`. The first form counts if several have the same cost."""
    import sympy

    forms = [expression, sympy.expand(expression), sympy.factor_terms(expression)]
    if expression.count_ops() <= MAX_OPERATIONS:
        forms.append(sympy.factor(expression))
        if expression.atoms(sympy.Function):
            forms += [sympy.trigsimp(form) for form in dict.fromkeys(forms)]
    functions = set[Expression]().union(*(form.atoms(sympy.Function) for form in forms))
    ordered = sorted(functions, key=sympy.default_sort_key)
    forms += [sympy.collect(sympy.expand(forms[i]), ordered, sympy.factor) for i in (0, -1)]
    return min(dict.fromkeys(forms), key=_cost)


def _cost(expression: Expression) -> tuple[int, int, int, int]:
    """Return four counts: tangents plus multiple angles, functions, operations with repeated parts counted once, and all operations."""
    import sympy

    functions, multiples = expression.atoms(sympy.Function), 0
    for function in functions:
        terms = sympy.Add.make_args(function.args[0])
        multiples += function.func is sympy.tan or any(t.as_coeff_Mul()[0] not in (1, -1) for t in terms)
    replaced, reduced = sympy.cse(expression, order="canonical")
    operations = int(sympy.count_ops([shared for _, shared in replaced] + reduced))
    return multiples, len(functions), operations, int(expression.count_ops())


def _solution(matrix: list[list[Expression]], right_side: Sequence[Expression]) -> list[Expression]:
    """Solve linear equations with a symmetric matrix. The inverse matrix solves up to two equations. The factors K D K^T solve more."""
    import sympy

    n, given = len(matrix), sympy.Matrix(right_side)
    if n == 1:
        return [_simplest(sympy.cancel(given[0] / matrix[0][0]))]
    if n == 2:
        (a, b), (_, c) = matrix
        determinant = _simplest(a * c - b * b)
        p, q, r = (_simplest(sympy.cancel(entry / determinant)) for entry in (c, -b, a))
        return [p * given[0] + q * given[1], q * given[0] + r * given[1]]
    if any(_is_singular([row[:k] for row in matrix[:k]]) for k in range(1, n)):
        raise BadInput(
            "from_lagrangian: the mass matrix has a principal minor that is 0: it must be positive definite where it"
            " couples more than two velocities"
        )
    K, D = sympy.Matrix(matrix).LDLdecomposition(hermitian=False)
    y = K.lower_triangular_solve(given)
    return list(K.T.upper_triangular_solve(sympy.Matrix([y[i] / D[i, i] for i in range(n)])))


def _names(symbols: Sequence[Expression]) -> str:
    """Return the source text of a tuple with the names of `symbols`."""
    return "({})".format(", ".join(f'"{symbol}"' for symbol in symbols) + ("," if len(symbols) == 1 else ""))
