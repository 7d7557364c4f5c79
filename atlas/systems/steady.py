"""Steady motions by the equations of motion alone: whether a start is one, about which axes and at which rates.

A body in a frame has as states an angular velocity w and vectors v at rest in the frame, v' = v x u, where u is the rotation
relative to the frame and w - u that of the frame. A steady motion u = n nu + m s has an axis s at rest in the body and an
axis nu at rest in the frame. Seen from the body nu turns about s at -m, so that u' = n m nu x s and u'' = m u' x s:

- with s known, m = u'.(u x s) / |u x s|^2 and n nu = u - m s;
- with nu known, n = u'.(nu x u) / |nu x u|^2 and m s = u - n nu;
- with neither, s is along u' x u''.

**Theorem.** Let the right-hand side be a polynomial of degree d in the states. Along a candidate every state is a
trigonometric polynomial of degree 1 in each of the phases n t and m t, and the residual of the equations, w' less what the
candidate needs, is one of degree d. If n : m is no ratio p : q with |p|, |q| <= 2 d, no two of its frequencies coincide, so
that it vanishes for all time exactly if it does on the torus of the phases, that is at the (2d + 1)^2 pairs
2 pi (i, j) / (2d + 1), a discrete Fourier transform of condition 1. At such a ratio in lowest terms the motion is periodic
and the residual of degree d (|p| + |q|) in its phase: 2 d (|p| + |q|) + 1 equidistant instants decide. Where n or m is 0, or
every vector is along nu, one phase is left, and its 2d + 1 values decide. Between the nodes the residual is at most 4 times
its largest value at them for d = 2, the square of Lebesgue's constant; 3.2 times at the ratios.

A ratio counts as p : q within RATIO. What the torus would find beside it grows from what the instants find
in a time of 1 / (RATIO n) only.

The residual vanishes where each component is at most ROUNDING of the magnitudes of its terms, those of the right-hand side with
every difference replaced by a sum, and of what errors of the states change: fast spins are no scale of it. Axes from derivatives
have errors of their own, by the cancellation in u'.
"""

from __future__ import annotations

import ast
from collections.abc import Iterator
from enum import IntEnum
from functools import cache
from math import gcd
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from . import arithmetic
from .base import FAMILY_TOLERANCE, Array, Flags, Mask, Points, System, TwoAxes, shape_of, subset
from .jacobian import STEP, jacobian
from .vectors import cross, dot, length, principal, ratio, turned, unit

# Residuals within this many units of rounding of their terms vanish.
ROUNDING = 64 * 2.0**-53
# A start whose equations fail by more than this of the squared frequency bound is no steady motion, whatever rounding does.
GATE = 1e-6
RATIO = 1e-9
# Share of the squared frequency bound that counts as no difference of linear equations.
SAME = 1e-9
# Largest error of axes from derivatives, in units of rounding, with which they may be a motion's.
MAX_ERROR = 1e4
# A start is far from every steady motion where rates change at first by more than this, in units of the rate tolerance.
FAR = 10.0
# Share by which turning a body about its third axis may change what its acceleration adds up to, of a body that counts as symmetric.
UNEVEN = 0.1
# Part of a radian in which turning changes no linear equations.
LINEAR = 0.3
_CHUNK = 16384
_STEP = 2.0**-100


class Existence(IntEnum):
    """Whether a start is a steady motion."""

    NEAR = 0  # as near one as rounding or the tolerances of labels cannot tell from it
    EXACT = 1  # as exactly as rounding allows
    FAR = 2  # its rates vary by more than the tolerance


class SteadyMotion(NamedTuple):
    """The steady motion that each start is, or would be."""

    axes: TwoAxes  # relative to the frame; the third axis and the vertical where it is none
    residual: Array  # largest one of the equations along it, over the squared frequency bound
    answer: Flags  # values of Existence


@cache
def polynomial_degree(system: System) -> int | str:
    """Degree of the right-hand side in the states, or why the theorem says nothing about the system."""
    equations = system.equations
    vectors = {name for triple in getattr(equations, "FRAME_VECTORS", ()) for name in triple}
    if system.observables or len(system.rate_states) != 3 or not vectors:
        return "its states are no angular velocity (rate_states) and vectors at rest in the frame (FRAME_VECTORS)"
    for name in equations.STATE:
        if name not in vectors and name not in system.rate_states:
            return f"the state {name} is neither an angular velocity nor a vector at rest in the frame"
    degrees: dict[str, int] = {}
    (function,) = ast.parse(arithmetic.functions(equations)["rhs"]).body
    try:
        for statement in function.body:  # type: ignore[attr-defined]
            match statement:
                case ast.Assign(targets=[ast.Tuple(elts=names)], value=ast.Name(id="state")):
                    degrees |= dict.fromkeys(map(ast.unparse, names), 1)
                case ast.Assign(targets=[ast.Tuple(elts=names)], value=ast.Tuple(elts=values)):
                    degrees |= {
                        ast.unparse(k): _degree(v, degrees) for k, v in zip(names, values, strict=True)
                    }
                case ast.Assign(targets=[name], value=value):
                    degrees[ast.unparse(name)] = _degree(value, degrees)
                case ast.Return(value=ast.Tuple(elts=values)):
                    return max(_degree(value, degrees) for value in values)
    except ValueError as error:
        return str(error)
    return "rhs is no tuple"


def _degree(expression: ast.expr, degrees: dict[str, int]) -> int:
    """Degree of an expression in the states by those of the names; ValueError where it is no polynomial."""
    match expression:
        case ast.Name(id=name):
            return degrees.get(name, 0)
        case ast.UnaryOp(operand=operand):
            return _degree(operand, degrees)
        case ast.BinOp(left=a, op=ast.Add() | ast.Sub(), right=b):
            return max(_degree(a, degrees), _degree(b, degrees))
        case ast.BinOp(left=a, op=ast.Mult(), right=b):
            return _degree(a, degrees) + _degree(b, degrees)
        case ast.BinOp(left=a, op=ast.Div(), right=b) if _degree(b, degrees) == 0:
            return _degree(a, degrees)
        case ast.BinOp(left=a, op=ast.Pow(), right=ast.Constant(value=int(power))) if power >= 0:
            return power * _degree(a, degrees)
    if any(degrees.get(node.id, 0) for node in ast.walk(expression) if isinstance(node, ast.Name)):
        raise ValueError(f"{ast.unparse(expression)} is no polynomial in the states")
    return 0


class _Magnitudes(np.ndarray):
    """Numbers whose differences are sums, so that arithmetic gives the sum of the magnitudes of its terms."""

    def __array_ufunc__(self, ufunc: Any, method: str, *inputs: Any, **options: Any) -> Any:
        ufunc = {np.subtract: np.add, np.negative: np.positive}.get(ufunc, ufunc)
        plain = [x.view(np.ndarray) if isinstance(x, _Magnitudes) else np.abs(x) for x in inputs]
        return np.asarray(getattr(ufunc, method)(*plain, **options)).view(_Magnitudes)


def _cross_terms(a: Array, b: Array) -> Array:
    """Magnitudes of the terms of a vector product, (3, points)."""
    return np.abs(cross(np.abs(a).view(_Magnitudes), np.abs(b).view(_Magnitudes)))


class _Node(NamedTuple):
    """State of a steady motion at phases of n t and m t, (states, points); vectors (3, points)."""

    start: _Starts
    axes: TwoAxes
    state: Array
    fixed: Array  # the fixed axis
    u: Array
    frame: Array  # angular velocity of the frame

    @classmethod
    def of(cls, start: _Starts, axes: TwoAxes, alpha: Array, beta: Array) -> _Node:
        s, m, nu, n = axes

        def moved(vector: Array) -> Array:
            return turned(turned(vector, nu, -alpha), s, -beta)

        fixed, frame, state = turned(nu, s, -beta), moved(start.frame), np.empty_like(start.state)
        u = n * fixed + m * s
        state[start.rates] = u + frame
        for triple in start.vectors:
            state[triple] = moved(start.state[triple])
        return cls(start, axes, state, fixed, u, frame)

    def subset(self, where: Any) -> _Node:
        rest = (values[..., where] for values in self[2:])
        return _Node(self.start.subset(where), self.axes.subset(where), *rest)

    def residual(self) -> Array:
        """Magnitude of the residual of the equations for u, (3, points); infinite where v' = v x u fails."""
        (s, m, _, n), equations, state, u = self.axes, self.start.equations, self.state, self.u
        slope = np.array(np.broadcast_arrays(*equations.rhs(state, self.start.constants)))
        wrong = np.abs(np.array(equations.frame_motion(state, self.start.constants)[:3]) - u)
        wrong += sum(np.abs(slope[triple] - cross(state[triple], u)) for triple in self.start.vectors)
        mistaken = np.where(wrong > 1e-9 * (length(u) + length(self.frame)), np.inf, 0.0)
        residual = slope[self.start.rates] - n * m * cross(self.fixed, s) - cross(self.frame, u)
        return np.abs(residual) + mistaken

    def magnitude(self) -> Array:
        """Sum of the magnitudes of its terms and of their changes by errors of the states, relative to 1 in unit vectors."""
        (s, m, _, n), start = self.axes, self.start
        size = np.ones_like(self.state)
        size[start.rates] = np.abs(n) + length(self.frame) + np.abs(m * s)
        sized = (np.abs(self.state) + 1j * STEP * size).view(_Magnitudes)
        slope = np.broadcast_arrays(*start.equations.rhs(sized, np.abs(start.constants).view(_Magnitudes)))
        terms = np.asarray([slope[i] for i in start.rates])
        turns = np.abs(n * m) * _cross_terms(self.fixed, s) + _cross_terms(self.frame, self.u)
        return np.asarray(np.abs(terms.real) + terms.imag / STEP + turns)


class _Starts(NamedTuple):
    """The equations and the states of some points; vectors (3, points)."""

    equations: Any
    rates: NDArray[np.intp]  # places of the angular velocity among the states, (3,)
    vectors: NDArray[np.intp]  # places of the vectors at rest in the frame, (vectors, 3)
    constants: Array
    state: Array
    slope: Array
    u: Array  # angular velocity relative to the frame
    bound: Array  # of frequencies

    @classmethod
    def of(cls, system: System, points: Points) -> _Starts:
        equations, constants = system.equations, system.constants(points)
        state = np.array(system.initial_state(points), float)
        place = equations.STATE.index
        rates = np.array([place(name) for name in system.rate_states])
        vectors = np.array([[place(name) for name in triple] for triple in equations.FRAME_VECTORS])
        # On the vertical to rounding, what a fast precession leaves across it is rounding too.
        sine, n, _ = system.steady_rates(points)
        across = np.array(equations.frame_motion(state, constants)[:2])
        rounded = (np.abs(sine) <= ROUNDING) & (np.hypot(*across) <= ROUNDING * np.abs(n))
        state[rates[:2]] -= np.where(rounded, across, 0.0)
        slope = np.array(np.broadcast_arrays(*equations.rhs(state, constants)), float)
        u = np.array(equations.frame_motion(state, constants)[:3])
        return cls(equations, rates, vectors, constants, state, slope, u, system.frequency_bound(points))

    def subset(self, where: Any) -> _Starts:
        return _Starts(*self[:3], *(values[..., where] for values in self[3:]))

    @property
    def frame(self) -> Array:
        """Angular velocity of the frame, at rest in it."""
        return self.state[self.rates] - self.u

    @property
    def vertical(self) -> Array:
        return np.array(self.equations.frame_motion(self.state, self.constants)[3:])

    @property
    def acceleration(self) -> Array:
        """u'."""
        return self.slope[self.rates] - cross(self.frame, self.u)

    def rest(self, axes: TwoAxes) -> tuple[Array, Array]:
        """u and u' less what a motion about these axes needs, (3, points) each."""
        s, m, nu, n = axes
        return self.u - n * nu - m * s, self.acceleration - n * m * cross(nu, s)

    def distance(self, axes: TwoAxes) -> Array:
        """The larger of both in units of the frequency bound."""
        rate, change = self.rest(axes)
        return np.fmax(length(rate) / self.bound, length(change) / self.bound**2)

    def second_derivative(self) -> Array:
        """u''."""
        bend = np.imag(self.equations.rhs(self.state + 1j * STEP * self.slope, self.constants)) / STEP
        turn = cross(cross(self.frame, self.u), self.u) + cross(self.frame, self.acceleration)
        return bend[self.rates] - turn

    def is_steady(self, axes: TwoAxes, degree: int, derived: bool) -> tuple[Array, Mask]:
        """Largest residual along a candidate, over the nodes up to the first that fails, and whether none does.

        derived: whether the axes come from derivatives, with their errors.
        """
        s, m, nu, n = axes
        loose = np.max([length(cross(self.state[triple], nu)) for triple in self.vectors], axis=0) > ROUNDING
        two, count = (n != 0) & (m != 0) & loose, 2 * degree + 1
        nodes = np.where(two, count**2, np.where(((n != 0) & loose) | (m != 0), count, 1))
        alpha_of = np.broadcast_to(np.where(two, count, 1), n.shape)
        period = np.zeros(n.shape)
        for p, q in (
            (p, q) for p in range(1, 2 * degree + 1) for q in range(1, 2 * degree + 1) if gcd(p, q) == 1
        ):
            at_ratio = two & (np.abs(np.abs(n) * q - np.abs(m) * p) <= RATIO * np.abs(n) * q)
            nodes = np.where(at_ratio, 2 * degree * (p + q) + 1, nodes)
            period = np.where(at_ratio, 2 * np.pi * p / np.where(at_ratio, np.abs(n), 1.0), period)

        def node(j: NDArray[np.intp] | int, at: NDArray[np.intp]) -> _Node:
            instant, angle = period[at] * j / nodes[at], 2 * np.pi / count
            alpha = np.where(period[at] > 0, n[at] * instant, angle * (j // alpha_of[at])) * (n[at] != 0)
            beta = np.where(period[at] > 0, m[at] * instant, angle * j) * (m[at] != 0)
            return _Node.of(self.subset(at), axes.subset(at), alpha, beta)

        rest, rounding = np.abs(self.rest(axes)[0]), np.full(n.size, ROUNDING)
        allowed = ROUNDING * (np.abs(n) + length(self.frame) + np.abs(m * s))
        alive = np.flatnonzero((rest <= allowed).all(0))
        # At the last node both phases have changed: it is enough for most.
        last = node(nodes[alive] - 1, alive)
        residual = last.residual()
        passes = length(residual) <= GATE * self.bound[alive] ** 2
        worst, magnitude = np.zeros((3, n.size)), np.zeros((3, n.size))
        worst[:, alive] = residual
        alive = alive[passes]
        if alive.size:
            first = node(0, alive)
            terms = first.magnitude()
            if derived:
                error = (
                    length(terms)
                    / length(first.start.acceleration)
                    * np.fmax(np.abs(m / n), np.abs(n / m))[alive]
                )
                rounding[alive] *= 1 + np.where(two[alive] & (error < MAX_ERROR), error, 0.0)
            magnitude[:, alive] = rounding[alive] * np.fmax(terms, last.subset(passes).magnitude())
        for j in range(nodes[alive].max(initial=1) - 1):
            at = alive[nodes[alive] > j + 1]
            worst[:, at] = np.fmax(worst[:, at], node(j, at).residual())
            fails = at[(worst[:, at] > magnitude[:, at]).any(0)]
            if fails.size:
                alive = np.setdiff1d(alive, fails, assume_unique=True)
        steady = np.zeros(n.size, bool)
        steady[alive] = (worst[:, alive] <= magnitude[:, alive]).all(0)
        return length(worst), steady

    def departure(self, axes: TwoAxes, duration: Array) -> Array:
        """Largest change of theta', psi' and phi', of the angular velocity, the tilt and the rate about the vertical by the linear equations.

        In axes that turn about the third one at m relative to the body, a steady motion of a symmetric body rests. In the body it
        rests at m = 0, and elsewhere the equations are linear in the first part of a radian.
        """
        third, m, _, n = axes
        triples, size = [self.rates, *self.vectors], len(self.state)
        turn = np.eye(size)
        for triple in triples:
            turn[np.ix_(triple, triple)] = turned(np.eye(3), third[:, :1], np.ones(3))

        def relative(state: Array) -> Array:
            slope = np.array(np.broadcast_arrays(*self.equations.rhs(state, self.constants)))
            for triple in triples:
                slope[triple] += m * cross(third, state[triple])
            return slope

        f, matrix = relative(self.state), jacobian(self.equations, self.state, self.constants)
        other = turn @ self.state
        uneven = length((relative(other) - turn @ f)[self.rates]) * np.fmax(1.0, np.abs(m) * duration)
        changed = turn @ matrix @ turn.T - jacobian(self.equations, other, self.constants)
        symmetric = np.abs(changed[:, self.rates]).max((1, 2)) <= SAME * self.bound**2
        symmetric &= uneven <= UNEVEN * length(f[self.rates])
        reach = np.where(symmetric | (m == 0), duration, np.fmin(duration, LINEAR / np.abs(m)))
        m = np.where(symmetric, m, 0.0)
        f = relative(self.state)
        for i, j, _ in triples:
            matrix[:, i, j] -= m
            matrix[:, j, i] += m
        reach = np.where((n == 0) | (len(self.vectors) == 1), reach, np.fmin(reach, LINEAR / np.abs(n)))
        # The mean of exp(matrix t) over a short step, and then over twice the time again and again.
        radians = np.sqrt((matrix**2).sum((1, 2))) * reach
        halvings = int(np.clip(np.ceil(np.log2(np.nanmax(radians, initial=1.0))), 0, 60)) + 2
        step = reach * 0.5**halvings
        power = flow = mean = np.broadcast_to(np.eye(size), matrix.shape)
        for k in range(1, 10):
            power = power @ (matrix * step[:, None, None]) / k
            flow, mean = flow + power, mean + power / (k + 1)
        x, largest = mean @ (f * step).T[..., None], np.zeros((4, m.size))
        for _ in range(halvings + 1):
            change = x[..., 0].T
            u, v = np.split(
                np.array(self.equations.frame_motion(self.state + 1j * STEP * change, self.constants)), 2
            )
            square = v[0] ** 2 + v[1] ** 2
            psi = (u[0] * v[0] + u[1] * v[1]) / square
            rates = np.array(
                [(u[0] * v[1] - u[1] * v[0]) / np.sqrt(square), psi, u[2] - psi * v[2], dot(u, v)]
            )
            rates, u, v = (values.imag / STEP for values in (rates, u, v))
            sizes = np.array([np.abs(rates[:3]).max(0), length(u), length(v), np.abs(rates[3])])
            largest = np.fmax(largest, np.where(np.isfinite(change).all(0), sizes, np.inf))
            x, flow = x + flow @ x, flow @ flow
        return largest

    def undamped(self, duration: Array) -> Array:
        """Root of the share of a run in which damping leaves an oscillation, by the divergence of the equations."""
        divergence = np.zeros(duration.shape)
        for i in range(len(self.state)):
            state = self.state.astype(complex)
            state[i] += 1j * STEP
            divergence += np.imag(self.equations.rhs(state, self.constants)[i]) / STEP
        return np.sqrt(1 / np.fmax(1.0, np.abs(divergence) * duration))


def steady_motions(
    system: System,
    points: Points,
    duration: Array | float,
    rate_tolerance: float,
    angle_tolerance: float | None = None,
) -> SteadyMotion:
    """Whether each start is a steady motion about any axes, or drifts about the third axis and the vertical; see Existence.

    Of a system of a `polynomial_degree`. Inside a cone of angle_tolerance about the vertical, rad (default: the same number as
    rate_tolerance), only the tilt and the rate about the vertical count.
    """
    degree, shape = polynomial_degree(system), shape_of(points)
    assert isinstance(degree, int)
    angle = rate_tolerance if angle_tolerance is None else angle_tolerance
    flat, times = {k: np.ravel(v) for k, v in points.items()}, np.broadcast_to(duration, shape).ravel()
    parts = []
    with np.errstate(all="ignore"):
        for first in range(0, times.size, _CHUNK):
            chunk = slice(first, first + _CHUNK)
            parts.append(_of_chunk(system, subset(flat, chunk), times[chunk], rate_tolerance, angle, degree))
    columns = [np.concatenate(column, -1) for column in zip(*parts, strict=True)]
    *axes, residual, answer = (x.reshape(*x.shape[:-1], *shape) for x in columns)
    return SteadyMotion(TwoAxes(*axes), residual, answer)


def _of_chunk(
    system: System, points: Points, duration: Array, rate_tolerance: float, angle: float, degree: int
) -> tuple[NDArray[Any], ...]:
    """The fields of TwoAxes, residual and answer."""
    start = _Starts.of(system, points)
    axes = _about_third(system, points, start)
    answer = np.full(duration.shape, Existence.NEAR, np.int8)
    size = start.distance(axes)

    everywhere = np.arange(answer.size)
    slow = np.abs(dot(start.u, start.acceleration)) <= GATE * length(start.u) * start.bound**2
    for derived, among in ((False, everywhere), (True, np.flatnonzero(slow))):
        own = start.subset(among)
        for candidate in _candidates(own) if derived else [TwoAxes(*map(np.copy, axes))]:
            near = (answer[among] != Existence.EXACT) & (own.distance(candidate) <= GATE)
            if derived:  # Rates far beyond the bound cancel, and their errors are as large.
                near &= np.fmax(*np.abs((candidate.spin_rate, candidate.precession_rate))) <= 8 * own.bound
            near = np.flatnonzero(near)
            part = candidate.subset(near)
            worst, steady = own.subset(near).is_steady(part, degree, derived)
            members = among[near[steady]]
            for values, new in zip(axes, part, strict=True):
                values[..., members] = new[..., steady]
            size[members] = worst[steady] / start.bound[members] ** 2
            answer[members] = Existence.EXACT
    others = np.flatnonzero(answer != Existence.EXACT)
    part = axes.subset(others)
    far = _is_far(start.subset(others), part, duration[others], rate_tolerance, angle)
    answer[others[far]] = Existence.FAR
    return *axes, np.nan_to_num(size, nan=0.0), answer


def _about_third(system: System, points: Points, start: _Starts) -> TwoAxes:
    """The third axis and the vertical, with the rates of System.steady_rates, 0 where these are rounding errors of the angular velocity."""
    sine, n, m = (np.array(value) for value in system.steady_rates(points))
    w, frame, g = np.abs(start.state[start.rates]), np.abs(start.frame), start.vertical
    still = np.abs(n * sine) <= 2.0**-51 * np.hypot(*(w + frame)[:2])
    still |= (np.abs(sine) <= ROUNDING) & (np.hypot(*start.u[:2]) <= 2.0**-51 * np.abs(n))
    n[still], m[still] = 0.0, start.u[2][still]
    m[np.abs(m) <= 2.0**-51 * (w[2] + frame[2] + np.abs(n * g[2]))] = 0.0
    return TwoAxes(principal(np.full(n.shape, 2)), m, g, n)


def _candidates(start: _Starts) -> Iterator[TwoAxes]:
    """Axes and rates that u, u' and u'' allow, with what is known of both: one axis, the vertical, the third axis, and nothing."""
    u, first, second, g = start.u, start.acceleration, start.second_derivative(), start.vertical
    third, still = principal(np.full(g.shape[1:], 2)), np.zeros(g.shape[1:])
    axis, least = unit(u, third), ROUNDING * (length(u) + length(start.frame))
    yield TwoAxes(axis, length(u), axis, still)

    def rate(turn: Array) -> Array:
        value = dot(first, turn) / dot(turn, turn)
        value = np.where(length(turn) > GATE * length(u), value, np.nan)
        return np.where(np.abs(value) <= least, 0.0, value)

    def fitting(axes: TwoAxes) -> TwoAxes:
        """Without those that u'' does not allow."""
        s, m, *_ = axes
        excess = length(second - m * cross(first, s))
        return axes._replace(spin_rate=np.where(excess <= GATE * start.bound**3, m, np.nan))

    n = rate(cross(g, u))
    rest = u - n * g
    yield fitting(TwoAxes(unit(rest, third), length(rest), g, n))
    s = unit(cross(second, first), third)
    other = length(cross(s, third)) > GATE
    for spin_axis in (third, np.where(other, s, np.nan)) if other.any() else (third,):
        m = rate(cross(u, spin_axis))
        rest = u - m * spin_axis
        n = np.where(length(rest) > least, length(rest), 0.0)
        yield fitting(TwoAxes(spin_axis, m, unit(rest, g), n))


def _is_far(start: _Starts, axes: TwoAxes, duration: Array, rate_tolerance: float, angle: float) -> Mask:
    """Whether the rates about the third axis and the vertical certainly vary by more than labels allow.

    A change x of the start begins as x' = A x + f, and an oscillation at most as fast as the bound changes rates by |f| / bound or
    more, unless damping takes that away. Where this does not decide, the solution of the linear equations does.
    """
    s, m, g, n = axes
    inside = np.hypot(g[0], g[1]) < angle
    # Inside the cone n and m are any with this angular velocity: without n the axes rest in the frame.
    axes = TwoAxes(s, np.where(inside, start.u[2], m), g, np.where(inside, 0.0, n))
    offset, f = start.rest(axes)
    time = np.fmin(1 / start.bound, duration)
    far = np.zeros(duration.shape, bool)

    def undecided(where: NDArray[np.intp], changes: Array) -> NDArray[np.intp]:
        """The points that these changes leave undecided."""
        rate, turn, tilt, along = changes
        within = ((turn > FAR * rate_tolerance) & (tilt > FAR * angle)) | (along > FAR * rate_tolerance)
        far[where] = np.where(inside[where], within, rate > FAR * rate_tolerance)
        return where[~far[where]]

    change = np.fmax(length(f) * time, length(offset))
    changes = np.array([change, change, change * time, np.abs(dot(f, g)) * time])
    lasting = np.sqrt(time / duration)
    where = undecided(np.arange(far.size), changes * lasting)
    lasting[where] = np.fmax(start.subset(where).undamped(duration[where]), lasting[where])
    where = undecided(where, (changes * lasting)[:, where])
    for first in range(0, where.size, 2048):
        part = where[first : first + 2048]
        departure = start.subset(part).departure(axes.subset(part), duration[part])
        undecided(part, lasting[part] * departure)
    return far


def condition_residual(system: System, points: Points) -> Array:
    """How far each start is from a steady motion about the third axis and the vertical, (points,); 0 on an exact one.

    The larger of |u' - n m gamma x e3| over the largest squared rate, u the angular velocity in the frame, and what of u across
    e3 is not n gamma, over its root. Beside the vertical, if less, that of a rotation about e3. Of systems of which the theorem says
    nothing that of the families, nan without any.
    """
    if isinstance(polynomial_degree(system), str):
        return system.identify_family(points)[1] if system.families else np.full(shape_of(points), np.nan)
    state, constants = system.initial_state(points), system.constants(points)
    _, n, m = system.steady_rates(points)
    slope = np.array(np.broadcast_arrays(*system.equations.rhs(state, constants)))
    # With a power of 2 as the complex step no bit is lost where the motion is linear in the state.
    stepped = np.imag(system.equations.frame_motion(state + 1j * _STEP * slope, constants)) / _STEP
    u, gamma = np.split(np.array(system.equations.frame_motion(state, constants)), 2)
    square, sine = system.squared_rate(points), np.hypot(gamma[0], gamma[1])
    change = ratio(length(stepped[:3] - n * m * np.array([gamma[1], -gamma[0], np.zeros_like(n)])), square)
    about_third = np.maximum(ratio(length(stepped[:3]), square), ratio(np.hypot(u[0], u[1]), np.sqrt(square)))
    change = np.where(sine <= FAMILY_TOLERANCE, np.minimum(change, about_third), change)
    rest = np.hypot(*(u - n * gamma)[:2])
    rest[rest <= 2.0**-50 * (np.abs(n) * sine + np.hypot(*state[:2]))] = 0.0
    return np.maximum(change, ratio(rest, np.sqrt(square)))
