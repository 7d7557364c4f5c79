"""Test whether the theorem of theory/steady.py applies to a system. Compute the growth rate of the angle about a vertical third axis."""

from __future__ import annotations

import ast
from functools import cache

import numpy as np

from ..flags import reserved_families
from . import arithmetic
from .base import FAMILY_TOLERANCE, Array, Mask, Points, System, families_of, shape_of, subset
from .jacobian import STEP
from .vectors import cross, dot, length, principal

# Largest rounding error of a sum as a fraction of the magnitudes of its terms, if each term has fewer than 40 roundings.
TERM_ROUNDING = 64 * 2.0**-53
# A start is surely no steady motion if the residual of the equations, over the squared frequency bound, exceeds this value.
GATE = 1e-6


@cache
def polynomial_degree(system: System) -> int | str:
    """Return the degree of the right-hand side in the states, or a text on why the theorem of theory/steady.py does not apply."""
    equations = system.equations
    vectors = {name for triple in getattr(equations, "FRAME_VECTORS", ()) for name in triple}
    if system.observables or len(system.rate_states) != 3 or not vectors:
        return "its states are no angular velocity (rate_states) and vectors at rest in the frame (FRAME_VECTORS)"
    for name in equations.STATE:
        if name not in vectors and name not in system.rate_states:
            return f"the state {name} is neither an angular velocity nor a vector at rest in the frame"
    degrees = {"state": 1}

    def degree(expression: ast.expr) -> int:
        match expression:
            case ast.Name(id=name):
                return degrees.get(name, 0)
            case ast.Tuple(elts=values):
                return max(map(degree, values))
            case ast.UnaryOp(operand=operand):
                return degree(operand)
            case ast.BinOp(left=a, op=ast.Add() | ast.Sub(), right=b):
                return max(degree(a), degree(b))
            case ast.BinOp(left=a, op=ast.Mult(), right=b):
                return degree(a) + degree(b)
            case ast.BinOp(left=a, op=ast.Div(), right=b) if degree(b) == 0:
                return degree(a)
            case ast.BinOp(left=a, op=ast.Pow(), right=ast.Constant(value=int(power))) if power >= 0:
                return power * degree(a)
        if any(degrees.get(node.id, 0) for node in ast.walk(expression) if isinstance(node, ast.Name)):
            raise ValueError(f"{ast.unparse(expression)} is no polynomial in the states")
        return 0

    (function,) = ast.parse(arithmetic.functions(equations)["rhs"]).body
    try:
        for statement in function.body:  # type: ignore[attr-defined]
            match statement:
                case ast.Assign(targets=[ast.Tuple(elts=names)], value=ast.Tuple(elts=values)):
                    degrees |= {ast.unparse(k): degree(v) for k, v in zip(names, values, strict=True)}
                case ast.Assign(targets=[target], value=value):
                    names = target.elts if isinstance(target, ast.Tuple) else [target]
                    degrees |= dict.fromkeys(map(ast.unparse, names), degree(value))
                case ast.Return(value=ast.expr() as value):
                    return degree(value)
    except ValueError as error:
        return str(error)
    return "rhs returns nothing"


@np.errstate(all="ignore")
def growth_about_vertical(system: System, points: Points) -> Array:
    """Return the growth rate, (points,), of the angle about the third axis while this axis stays exactly on the vertical.

    A change delta of this angle obeys delta'' = a delta + b delta', where a and b are derivatives of r' by the angle and by the rate r.
    Where the growth rate is 0, rounding decides no label. The growth rate is nan if the axis is not vertical or the theorem of
    theory/steady.py does not apply.
    """
    growth = np.full(shape_of(points), np.nan)
    if isinstance(polynomial_degree(system), str):
        return growth
    where = np.flatnonzero(np.abs(system.steady_rates(points)[0]) <= FAMILY_TOLERANCE)
    if not where.size:
        return growth
    equations, place = system.equations, system.equations.STATE.index
    state, constants = _start(system, subset(points, where))
    third = principal(np.full(where.size, 2))
    turn, spin = np.zeros((2, *state.shape))
    for names in equations.FRAME_VECTORS:
        triple = list(map(place, names))
        turn[triple] = cross(state[triple], third)
    about_third = place(system.rate_states[2])
    spin[about_third] = 1.0
    a, b = (
        np.imag(equations.rhs(state + 1j * STEP * change, constants)[about_third]) / STEP
        for change in (turn, spin)
    )
    growth[where] = np.hypot(b / 2, np.sqrt(np.fmax(a, 0.0))) + b / 2
    return growth


@np.errstate(all="ignore")
def lacks_theory(system: System, points: Points) -> Mask:
    """Return whether each start may be on a family of an extension that is not installed, (points,).

    This is possible where the third axis stays on the vertical at first while the rate about the vertical changes.
    """
    is_complete = reserved_families(system.name).keys() <= families_of(system).keys()
    if is_complete or isinstance(polynomial_degree(system), str):
        return np.zeros(shape_of(points), bool)
    state, constants = _start(system, points)
    rates = [system.equations.STATE.index(name) for name in system.rate_states]
    u, vertical = np.split(np.array(system.equations.frame_motion(state, constants)), 2)
    slope = np.array(np.broadcast_arrays(*system.equations.rhs(state, constants)))[rates]
    acceleration = slope - cross(state[rates] - u, u)
    along, square = dot(acceleration, vertical), system.frequency_bound(points) ** 2
    across = length(acceleration - along * vertical)
    upright = np.hypot(*vertical[:2]) <= FAMILY_TOLERANCE
    return np.asarray(upright & (np.abs(along) > TERM_ROUNDING * square) & (across <= GATE * square))


def _start(system: System, points: Points) -> tuple[Array, Array]:
    """Return states and constants. If the third axis is vertical, transverse rates that are rounding errors of fast precession become 0."""
    state, constants = np.array(system.initial_state(points), float), system.constants(points)
    sine, n, _ = system.steady_rates(points)
    across = np.array(system.equations.frame_motion(state, constants)[:2])
    upright = (np.abs(sine) <= TERM_ROUNDING) & (np.hypot(*across) <= TERM_ROUNDING * np.abs(n))
    places = [system.equations.STATE.index(name) for name in system.rate_states[:2]]
    state[places] -= np.where(upright, across, 0.0)
    return state, constants
