"""Motions that start near a steady motion: their labels from the linear equations.

The steady motion theta = theta0, psi' = n, phi' = m of a start, x0(t), solves the equations of motion x' = F(x) up to the
residual acceleration f(t) = F(x0) - x0'. To first order in f and in theta' of the start, the motion is x0 + d with

    d' = F'(x0(t)) d + f(t),    d(0) = start - x0(0),

by variation of constants. The forced and the free oscillations, secular drifts and the growth beside an unstable motion are
all parts of d.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..flags import Label
from ..scene.model import Tolerances
from ..systems.base import Array, Flags, Mask, Points, System, TwoAxes, motion_about_axes
from ..systems.jacobian import jacobian
from . import labels

# Starts with larger residuals are far from every steady motion; they are not looked at.
MAX_RESIDUAL = 1e-2
# A start is far, too, where its rates change at first by more than this, in units of the rate tolerance.
_FAR = 10.0
# Distance from the steady motion beyond which the linear equations are not used: angles in rad, rates over the frequency
# bound.
_LINEAR = 1e-2
# Relative error that is assumed of every deviation from the steady motion.
_MARGIN = 0.1
# Terms of second order over the squared deviation, an estimate: where linear theory gives a steady label, and where it gives
# drift. Of 95 in 100 random offsets they are below 0.03; slow turns of x0 away from the motion cause the largest.
_SECOND_ORDER = 0.25, 1.0
# Of the classical Runge-Kutta method, in radians of the frequency bound. Damping in a hundred radians: 2 %.
_STEP = 0.4
_MIN_STEPS, _MAX_STEPS = 64, 2**16  # in a run
_TOGETHER = 16384  # matrices that are computed together, a power of two
_RATES = ("theta_dot", "psi_dot", "phi_dot", "normal_rate")
_BLOCK = 64  # samples that are evaluated together


def describes(system: System) -> bool:
    """Whether the states of a system are an angular velocity and vectors at rest in the frame."""
    states = [
        *system.rate_states,
        *(name for v in getattr(system.equations, "FRAME_VECTORS", ()) for name in v),
    ]
    return len(system.rate_states) == 3 and sorted(states) == sorted(system.equations.STATE)


def off_family_labels(
    system: System,
    points: Points,
    duration: Array,
    tolerances: Tolerances,
    frames: Mapping[str, Array],
    pause: Callable[[], None] = lambda: None,
) -> dict[str, Flags]:
    """Labels of starts that are on no family's motion and may be near one, from linear theory.

    Parameters
    ----------
    system : System
        A body in a frame, see `describes`.
    points : mapping of str to ndarray of float64, shape (points,)
        The points that are integrated.
    duration : ndarray of float64, shape (points,)
        In time units.
    tolerances : Tolerances
    frames : mapping of str to ndarray of float64, shape (points,)
        Rate of each frame, which is added to psi', rad per time unit.
    pause : callable
        Called again and again; it raises an exception where the run was interrupted.

    Returns
    -------
    dict of ndarray of int8, shape (points,)
        For each frame values of `flags.Label`: not_computed where a change of a tenth, or terms of second order, could
        change the label, and where the run is too long for the linear equations.
    """
    result = {name: np.full(duration.shape, Label.DRIFTING, np.int8) for name in frames}
    with np.errstate(all="ignore"):
        bound = system.frequency_bound(points)
        start = _SteadyMotions.of(system, points)
        near = np.flatnonzero(_near(start, bound, duration, tolerances))
        for name in frames:
            result[name][near] = Label.NOT_COMPUTED
        steps = _Steps.of(start.subset(near), bound[near], duration[near])
        for members in steps.groups():
            pause()
            where = near[members]
            sums = _sums(start.subset(where), bound[where], steps.subset(members), tolerances.angle)
            for name, rate in frames.items():
                result[name][where] = sums.label(tolerances, rate[where])
    return result


@dataclass(frozen=True)
class _SteadyMotions:
    """The motion x0(t) of each point, and how its start differs from it; vectors (3, points)."""

    system: System
    constants: Array
    state: Array  # at the start, (states, points)
    n: Array
    m: Array
    offset: Array  # of the angular velocity

    @classmethod
    def of(cls, system: System, points: Points) -> _SteadyMotions:
        """The motions of some points."""
        constants, state = system.constants(points), np.array(system.initial_state(points))
        _, n, m = (np.array(value, float) for value in system.steady_rates(points))
        u, g = np.split(np.array(system.equations.frame_motion(state, constants)), 2)
        offset = u - n * g
        offset[2] -= m
        state[_indices(system, system.rate_states)] -= offset
        return cls(system, constants, state, n, m, offset)

    def subset(self, where: NDArray[np.int64]) -> _SteadyMotions:
        """Some of them, by their indices."""
        arrays = (values[..., where] for values in (self.constants, self.state, self.n, self.m, self.offset))
        return _SteadyMotions(self.system, *arrays)

    def at(self, t: Array) -> Array:
        """States at times of shape (times, points), (states, times, points)."""
        equations = self.system.equations
        g = np.array(equations.frame_motion(self.state, self.constants))[3:]
        third = np.zeros_like(g)
        third[2] = 1.0
        axes, state = TwoAxes(third, self.m, g, self.n), np.zeros((len(self.state), *t.shape))
        for names in equations.FRAME_VECTORS:
            vector = _indices(self.system, names)
            u, state[vector] = motion_about_axes(axes, self.state[vector], t)
        # The rate relative to the frame is the sum of w and terms of the frame's vectors.
        shift = np.array(equations.frame_motion(state, self.constants[:, None]))[:3]
        state[_indices(self.system, self.system.rate_states)] = u - shift
        return state

    def acceleration(self, state: Array, constants: Array, turn: Array) -> Array:
        """f at states of x0: u' - n m gamma x e3 with u' from the equations, (3, ...); turn: n m."""
        equations = self.system.equations
        g = equations.frame_motion(state, constants)[3:]
        slope = np.array(equations.rhs(state, constants))
        result = np.array(equations.frame_motion(slope, constants)[:3])
        result[0] -= turn * g[1]
        result[1] += turn * g[0]
        return result

    def linear(self, state: Array) -> Array:
        """Matrices of (d, 1)' = G (d, 1) at states of x0, (times, points, states + 1, states + 1)."""
        size, times, points = state.shape
        flat = state.reshape(size, -1)
        constants = np.repeat(self.constants[:, None], times, axis=1).reshape(len(self.constants), -1)
        turn = np.tile(self.n * self.m, times)
        result = np.zeros((times * points, size + 1, size + 1))
        result[:, :size, :size] = jacobian(self.system.equations, flat, constants)
        rates = _indices(self.system, self.system.rate_states)
        result[:, rates, size] = self.acceleration(flat, constants, turn).T
        return result.reshape(times, points, size + 1, size + 1)


def _indices(system: System, names: Iterable[str]) -> list[int]:
    """Indices of states."""
    return [system.equations.STATE.index(name) for name in names]


def _near(start: _SteadyMotions, bound: Array, duration: Array, tolerances: Tolerances) -> Mask:
    """Whether the rates of a start change so slowly that the motion may count as steady.

    An oscillation of a frequency of at most the bound that begins with an acceleration f changes rates by |f| / bound
    or more. Inside the cylinder only the rate about the vertical counts.
    """
    g = start.system.equations.frame_motion(start.state, start.constants)[3:]
    acceleration = _length(start.acceleration(start.state, start.constants, start.n * start.m))
    change = np.fmax(acceleration * np.fmin(1.0 / bound, duration), _length(start.offset))
    return np.asarray((change <= _FAR * tolerances.rate) | (np.hypot(g[0], g[1]) < tolerances.angle))


def _length(vector: Array) -> Array:
    """Euclidean length over the first axis."""
    return np.asarray(np.sqrt((vector**2).sum(0)))


@dataclass(frozen=True)
class _Steps:
    """Steps of the linear equations; arrays (points,)."""

    size: Array  # time units
    count: NDArray[np.int64]
    matrices: NDArray[np.int64]  # different steps, which recur

    @classmethod
    def of(cls, motions: _SteadyMotions, bound: Array, duration: Array) -> _Steps:
        """Powers of two in a run, or in a period of x0 where that is shorter."""
        n, m = np.abs(motions.n), np.abs(motions.m)
        if len(motions.system.equations.FRAME_VECTORS) == 1:
            n = np.zeros_like(n)  # the vertical turns at -m about the third axis
        rate = np.where((n > 0) & (m > 0), 0.0, n + m)
        longest = np.fmin(_STEP / np.fmax(bound, n + m), duration / _MIN_STEPS)
        period = np.where(rate > 0, 2 * np.pi / rate, np.inf)
        recurs = period < duration
        span = np.where(recurs, period, duration)
        steps = np.fmin(2.0 ** np.ceil(np.log2(np.fmax(span / longest, 1.0))), 2.0**62)
        size = span / steps
        count = np.round(np.where(recurs, duration / size, steps))
        matrices = np.where((n == 0) & (m == 0), 1.0, steps)
        possible = count <= _MAX_STEPS
        count, matrices = np.where(possible, count, 0), np.where(possible, matrices, 0)
        return cls(size, count.astype(np.int64), matrices.astype(np.int64))

    def subset(self, where: NDArray[np.int64]) -> _Steps:
        """Some of them, by their indices."""
        return _Steps(self.size[where], self.count[where], self.matrices[where])

    def groups(self) -> Iterator[NDArray[np.int64]]:
        """Indices of points that are integrated together, those whose steps are not too many."""
        for number in np.unique(self.matrices[self.matrices > 0]):
            members = np.flatnonzero(self.matrices == number)
            members = members[np.argsort(self.count[members], kind="stable")]
            together = max(1, min(_TOGETHER // number, _TOGETHER // 4))  # the second for the samples
            yield from (members[i : i + together] for i in range(0, members.size, together))


def _propagators(motions: _SteadyMotions, steps: _Steps, first: int, number: int) -> tuple[Array, Array]:
    """States of x0 at the beginnings of some steps, (states, times, points), and their affine maps.

    The maps of (d, 1), (times, points, states + 1, states + 1), are those of the classical Runge-Kutta method.
    """
    h = steps.size[:, None, None]
    index = first + np.arange(number + 1)[:, None]
    nodes, middles = motions.at(index * steps.size), motions.at((index[:-1] + 0.5) * steps.size)
    slope, middle = motions.linear(nodes), motions.linear(middles)
    begin, end = slope[:-1], slope[1:]
    b = middle + 0.5 * h * middle @ begin
    c = middle + 0.5 * h * middle @ b
    d = end + h * end @ c
    maps = h / 6 * (begin + 2 * (b + c) + d)
    diagonal = np.arange(maps.shape[-1])
    maps[..., diagonal, diagonal] += 1.0
    return nodes[:, :-1], maps


def _sums(motions: _SteadyMotions, bound: Array, steps: _Steps, angle: float) -> _Sums:
    """Sums over the samples of x0 + d in the runs."""
    size, matrices = len(motions.state), int(steps.matrices[0])
    z = np.zeros((len(bound), size + 1, 1))
    z[:, _indices(motions.system, motions.system.rate_states), 0] = motions.offset.T
    z[:, size] = 1.0
    result = _Sums(motions, bound, angle, steps.count + 1)
    number = min(matrices, _TOGETHER)
    block = max(number, _BLOCK)
    last = int(steps.count.max())
    for first in range(0, last + 1, block):
        if first == 0 or matrices > number:
            states, maps = _propagators(motions, steps, first % matrices, number)
        for start in range(first, min(first + block, last + 1), _BLOCK):
            index = np.arange(start, min(start + _BLOCK, last + 1))
            d = np.empty((size, index.size, len(bound)))
            for i, k in enumerate(index % number):
                d[:, i] = z[:, :size, 0].T
                z = maps[k] @ z
            result.add(states[:, index % number], d, index)
            if not result.linear.any():
                return result
    return result


class _Sums:
    """Sums over the samples of some motions x0 + d as long as d is small; arrays (points,)."""

    def __init__(
        self, motions: _SteadyMotions, bound: Array, angle: float, samples: NDArray[np.int64]
    ) -> None:
        self.motions, self.bound, self.angle, self.samples = motions, bound, angle, samples
        self.largest = np.zeros_like(bound)  # distance from x0
        self.linear = np.ones(bound.shape, bool)  # whether it has been small
        self.sums = {name: np.zeros_like(bound) for name in _RATES}
        self.squares = {name: np.zeros_like(bound) for name in _RATES}
        self.tilt = {"theta_min": np.full_like(bound, np.inf), "theta_max": np.zeros_like(bound),
                     "sine_max": np.zeros_like(bound)}  # fmt: skip
        u, g = np.split(self._motion(motions.state[:, None]), 2)
        self.normal_rate = (u * g).sum(0)
        # psi' and phi' depend on the direction of the tilt, except inside the cylinder, where they do not count.
        sine = np.hypot(g[0], g[1])
        self.direction = np.where(sine < angle, 0.0, 1.0 / sine)

    def _motion(self, state: Array) -> Array:
        """Angular velocity and vertical of the frame, (6, samples, points)."""
        return np.array(self.motions.system.equations.frame_motion(state, self.motions.constants[:, None]))

    def add(self, state: Array, d: Array, index: NDArray[np.int64]) -> None:
        """Add samples of x0 and d, (states, samples, points), of these indices."""
        scale = np.ones((len(d), 1, self.bound.size))
        scale[_indices(self.motions.system, self.motions.system.rate_states)] = 1.0 / self.bound
        across = np.hypot(*self._motion(d)[3:5])
        distance = np.fmax(np.abs(d * scale).max(0), across * self.direction)
        used = index[:, None] < self.samples
        linear = self.linear & np.logical_and.accumulate((distance <= _LINEAR) | ~used)
        self.linear, used = linear[-1], used & linear
        self.largest = np.fmax(self.largest, np.where(used, distance, 0.0).max(0))
        u1, u2, u3, g1, g2, g3 = self._motion(state + d)
        sine = np.hypot(g1, g2)
        along, outside = u1 * g1 + u2 * g2, used & (sine >= self.angle)
        psi_dot = along / sine**2
        values = {
            "theta_dot": np.where(used & (sine > 0), (u1 * g2 - u2 * g1) / sine, 0.0),
            "psi_dot": np.where(outside, psi_dot - self.motions.n, 0.0),
            "phi_dot": np.where(outside, u3 - psi_dot * g3 - self.motions.m, 0.0),
            "normal_rate": np.where(used, along + u3 * g3 - self.normal_rate, 0.0),
        }
        for name, value in values.items():
            # One by one: the order of the additions in `sum` depends on the number of points.
            self.sums[name] += np.add.accumulate(value)[-1]
            self.squares[name] += np.add.accumulate(value**2)[-1]
        theta = np.arctan2(sine, g3)
        self.tilt["theta_min"] = np.fmin(self.tilt["theta_min"], np.where(used, theta, np.inf).min(0))
        self.tilt["theta_max"] = np.fmax(self.tilt["theta_max"], np.where(used, theta, 0.0).max(0))
        self.tilt["sine_max"] = np.fmax(self.tilt["sine_max"], np.where(used, sine, 0.0).max(0))

    def label(self, tolerances: Tolerances, frame_rate: Array) -> Flags:
        """Values of flags.Label; not_computed where the linear equations do not decide."""
        mean = {name: total / self.samples for name, total in self.sums.items()}
        square = {name: total / self.samples for name, total in self.squares.items()}
        measured = {"theta_dot_rms": np.sqrt(square["theta_dot"]), **self.tilt}
        for name in ("psi_dot", "phi_dot", "normal_rate"):
            measured[f"{name}_std"] = np.sqrt(np.maximum(square[name] - mean[name] ** 2, 0.0))
        error = {name: _MARGIN * value for name, value in measured.items()}
        for name, rate in (("psi_dot", self.motions.n), ("phi_dot", self.motions.m)):
            measured[f"{name}_mean"] = rate + mean[name]
            error[f"{name}_mean"] = _MARGIN * np.abs(mean[name])
        swing = _MARGIN * (measured["theta_max"] - measured["theta_min"])
        error |= {"theta_min": swing, "theta_max": swing, "sine_max": swing}
        label = labels.label(measured, tolerances, frame_rate)
        unsure = labels.unsure(measured, error, tolerances, frame_rate)
        # Terms of second order decide nothing; a motion that has left the linear range drifts if it drifted before.
        steady = label != Label.DRIFTING
        second_order = np.where(steady, *_SECOND_ORDER) * self.largest**2
        error = {
            name: value + second_order * (1.0 if name in self.tilt else self.bound)
            for name, value in error.items()
        }
        within = labels.unsure(measured, error, tolerances, frame_rate)
        unsure |= np.where(self.linear, within, steady)
        return np.where(unsure, Label.NOT_COMPUTED, label).astype(np.int8)
