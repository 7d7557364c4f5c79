"""The test of steady motions as arrays of NumPy, the independent reference of theory/steady.py until its successors are built too."""

from __future__ import annotations

from collections.abc import Iterator
from enum import IntEnum
from math import gcd
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from atlas.systems.base import Array, Flags, Mask, Points, System, TwoAxes, shape_of, subset
from atlas.systems.jacobian import STEP
from atlas.systems.steady import polynomial_degree
from atlas.systems.vectors import cross, dot, length, principal, turned, unit

# Residuals within this many units of rounding of their terms vanish.
ROUNDING = 64 * 2.0**-53
# A start whose equations fail by more than this of the squared frequency bound is no steady motion, whatever rounding does.
GATE = 1e-6
RATIO = 1e-9
# Largest error of axes from derivatives, in units of rounding, with which they may be a motion's.
MAX_ERROR = 1e4
# A start is far from every steady motion where rates change to first order by more than this, in tolerances: of 30 000
# starts beside steady motions none with a steady label changed by more than 2.4.
FAR = 5.0
_CHUNK = 16384


class Existence(IntEnum):
    """Whether a start is a steady motion."""

    NEAR = 0  # as near one as rounding or the tolerances of labels cannot tell from it
    EXACT = 1  # as exactly as rounding allows
    FAR = 2  # its rates vary by more than the tolerance


class SteadyMotion(NamedTuple):
    """The steady motion that each start is, or would be."""

    axes: TwoAxes  # relative to the frame; the third axis and the vertical where it is none
    answer: Flags  # values of Existence


class _Magnitudes(np.ndarray):
    """Numbers whose differences are sums, so that arithmetic gives the sum of the magnitudes of its terms."""

    def __array_ufunc__(self, ufunc: Any, method: str, *inputs: Any, **options: Any) -> Any:
        ufunc = {np.subtract: np.add, np.negative: np.positive}.get(ufunc, ufunc)
        plain = [x.view(np.ndarray) if isinstance(x, _Magnitudes) else np.abs(x) for x in inputs]
        return np.asarray(getattr(ufunc, method)(*plain, **options)).view(_Magnitudes)


class _Starts(NamedTuple):
    """The equations and the states of some points; vectors (3, points)."""

    equations: Any
    rates: NDArray[np.intp]  # places of the angular velocity among the states, (3,)
    vectors: NDArray[np.intp]  # places of the vectors at rest in the frame, (vectors, 3)
    constants: Array
    bound: Array  # of frequencies
    state: Array
    slope: Array
    u: Array  # angular velocity relative to the frame

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
        empty = np.empty(0)
        return cls(equations, rates, vectors, constants, system.frequency_bound(points), *[empty] * 3).at(
            state
        )

    def at(self, state: Array) -> _Starts:
        """The same bodies in other states."""
        slope = np.array(np.broadcast_arrays(*self.equations.rhs(state, self.constants)), float)
        u = np.array(self.equations.frame_motion(state, self.constants)[:3])
        return self._replace(state=state, slope=slope, u=u)

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

    def along(self, axes: TwoAxes, alpha: Array, beta: Array) -> tuple[_Starts, TwoAxes]:
        """The motion about these axes at phases of n t and m t."""
        s, m, nu, n = axes
        state, fixed = np.empty_like(self.state), turned(nu, s, -beta)
        for triple, vector in (
            (self.rates, self.frame),
            *((each, self.state[each]) for each in self.vectors),
        ):
            state[triple] = turned(turned(vector, nu, -alpha), s, -beta)
        state[self.rates] += n * fixed + m * s
        return self.at(state), axes._replace(fixed_axis=fixed)

    def residual(self, axes: TwoAxes) -> Array:
        """Magnitude of the residual of the equations, (3, points); infinite where v' = v x u fails."""
        rate, change = self.rest(axes)
        wrong = length(rate) + sum(length(self.slope[i] - cross(self.state[i], self.u)) for i in self.vectors)
        return np.where(wrong > 1e-9 * (length(self.u) + length(self.frame)), np.inf, np.abs(change))

    def rounding(self, axes: TwoAxes) -> Array:
        """Sum of the magnitudes of its terms and of their changes by errors of the states, relative to 1 in unit vectors."""
        s, m, nu, n = (np.abs(values).view(_Magnitudes) for values in axes)
        frame, size = np.abs(self.frame).view(_Magnitudes), np.ones_like(self.state)
        size[self.rates] = n + length(self.frame) + m * s
        sized = (np.abs(self.state) + 1j * STEP * size).view(_Magnitudes)
        slope = np.broadcast_arrays(*self.equations.rhs(sized, np.abs(self.constants).view(_Magnitudes)))
        terms = np.asarray([slope[i] for i in self.rates])
        return np.asarray(
            np.abs(terms.real) + terms.imag / STEP + n * m * cross(nu, s) + cross(frame, size[self.rates])
        )

    def is_steady(self, axes: TwoAxes, degree: int, derived: bool) -> Mask:
        """Whether the residual vanishes along a candidate, by its nodes up to the first that fails.

        derived: whether the axes come from derivatives, with their errors.
        """
        s, m, nu, n = axes
        loose = np.max([length(cross(self.state[triple], nu)) for triple in self.vectors], axis=0) > ROUNDING
        p = np.where((n != 0) & loose, 1, 0)
        q = np.where(m != 0, np.where(p == 1, 2 * degree + 1, 1), 0)
        two = (p == 1) & (m != 0)
        for a, b in np.ndindex(2 * degree + 1, 2 * degree + 1):
            if gcd(a, b) == 1 and a * b:
                at_ratio = two & (np.abs(np.abs(n) * b - np.abs(m) * a) <= RATIO * np.abs(n) * b)
                p, q = np.where(at_ratio, a, p), np.where(at_ratio, b, q)
        nodes = 2 * degree * (p + q) + 1
        p, q = np.sign(n) * p, np.sign(m) * q
        size = np.abs(n) + length(self.frame) + np.abs(m * s)
        steady = np.asarray((np.abs(self.rest(axes)[0]) <= ROUNDING * size).all(0))
        terms = np.zeros_like(size)
        # From the last node back: there both phases have changed, which is enough for most.
        for j in range(1, nodes.max(initial=0) + 1):
            if not (at := np.flatnonzero(steady & (j <= nodes))).size:
                break
            angle = -2 * np.pi * j / nodes[at]
            node, its_axes = self.subset(at).along(axes.subset(at), p[at] * angle, q[at] * angle)
            residual = node.residual(its_axes)
            if j == 1:
                passes = length(residual) <= GATE * self.bound[at] ** 2
                steady[:], at, residual = False, at[passes], residual[:, passes]
                start = self.subset(at)
                terms[:, at] = start.rounding(axes.subset(at))
                if derived:
                    error = length(terms[:, at]) / length(start.acceleration)
                    error *= np.fmax(np.abs(m / n), np.abs(n / m))[at]
                    terms[:, at] *= 1 + np.where(two[at] & (error < MAX_ERROR), error, 0.0)
            steady[at] = (residual <= ROUNDING * terms[:, at]).all(0)
        return steady

    def undamped(self, duration: Array) -> Array:
        """Root of the share of a run in which damping leaves an oscillation, by the divergence of the equations."""
        divergence = np.zeros(duration.shape)
        for i in self.rates:
            state = self.state.astype(complex)
            state[i] += 1j * STEP
            divergence += np.imag(self.equations.rhs(state, self.constants)[i]) / STEP
        return np.sqrt(1 / np.fmax(1.0, np.abs(divergence) * duration))


def steady_motions(
    system: System,
    points: Points,
    duration: Array | float,
    rate_tolerance: Array | float,
    angle_tolerance: float,
) -> SteadyMotion:
    """Whether each start is a steady motion about any axes, or drifts about the third axis and the vertical; see Existence.

    Of a system of a `polynomial_degree`. Inside a cone of angle_tolerance about the vertical, rad, only the tilt and the rate about
    the vertical count.
    """
    degree, times = polynomial_degree(system), np.broadcast_to(duration, shape_of(points))
    assert isinstance(degree, int)
    rates = np.broadcast_to(rate_tolerance, times.shape)
    with np.errstate(all="ignore"):
        chunks = [slice(first, first + _CHUNK) for first in range(0, times.size, _CHUNK)]
        parts = [
            _of_chunk(system, subset(points, each), times[each], (rates[each], angle_tolerance), degree)
            for each in chunks
        ]
    *axes, answer = (np.concatenate(column, -1) for column in zip(*parts, strict=True))
    return SteadyMotion(TwoAxes(*axes), answer)


def _of_chunk(
    system: System, points: Points, duration: Array, tolerances: tuple[Array, float], degree: int
) -> tuple[NDArray[Any], ...]:
    """The fields of TwoAxes, and the answer."""
    start = _Starts.of(system, points)
    axes = _about_third(system, points, start)
    answer = np.full(duration.shape, Existence.NEAR, np.int8)
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
            steady = own.subset(near).is_steady(part, degree, derived)
            members = among[near[steady]]
            for values, new in zip(axes, part, strict=True):
                values[..., members] = new[..., steady]
            answer[members] = Existence.EXACT
    others = np.flatnonzero(answer != Existence.EXACT)
    rate, angle = tolerances
    departs = _departure(start.subset(others), axes.subset(others), duration[others], (rate[others], angle))
    answer[others[departs > FAR]] = Existence.FAR
    return *axes, answer


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


def departure(
    system: System, points: Points, duration: Array, tolerances: tuple[Array | float, float]
) -> Array:
    """How far each start is from a steady motion about the third axis and the vertical, in tolerances of labels; see _departure."""
    start = _Starts.of(system, points)
    return _departure(start, _about_third(system, points, start), duration, tolerances)


def _departure(
    start: _Starts, axes: TwoAxes, duration: Array, tolerances: tuple[Array | float, float]
) -> Array:
    """Change of theta', psi' and phi' to first order, in tolerances; inside the cone that of the tilt and the rate about the vertical.

    A change x of the start begins as x' = A x + f, and an oscillation at most as fast as the bound changes rates by |f| / bound or
    more, unless damping takes that away.
    """
    (s, m, g, n), (rate, angle) = axes, tolerances
    sine = np.hypot(g[0], g[1])
    inside = sine < angle
    # Inside the cone n and m are any with this angular velocity: without n the axes rest in the frame.
    offset, f = start.rest(TwoAxes(s, np.where(inside, start.u[2], m), g, np.where(inside, 0.0, n)))
    time = np.fmin(1 / start.bound, duration)
    change = np.fmax(length(f) * time, length(offset))
    within = np.fmax(np.fmin(change / rate, change * time / angle), np.abs(dot(f, g)) * time / rate)
    result = np.where(inside, within, change / rate)
    lasting = result * np.sqrt(time / duration)
    where = np.flatnonzero((lasting <= FAR) & (result > lasting))
    lasting[where] = np.fmax(lasting[where], result[where] * start.subset(where).undamped(duration[where]))
    return lasting
