"""The flow of one body, and the growth of small changes of its states.

A change of a state has three components of the angular velocity w, divided by `Flow.rate`, and three of the attitude. The last three
are d gamma if the state has one direction gamma of the frame. For two directions v they are a rotation eta with dv = v x eta. If the
third axis is an axis of symmetry, a motion turned about this axis is a motion too. A turn by the angle chi is denoted by R(chi).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import cache

import numpy as np
from scipy.spatial.transform import Rotation

from ...kernel import specialization
from ...kernel.augmented import rotates
from ...kernel.blocks import BlockSchedule, pack_blocks
from ...kernel.ensemble import Ensemble
from ...kernel.tableaux import TANGENT_METHOD
from ...kernel.tangent import Growth
from ...measure.tangent_runs import TangentArrays
from ...systems.base import Array, Points
from ...systems.gyrostat import Gyrostat

SIZE = 6  # number of components of a change of a state
RADIANS = 0.3  # largest step times the frequency bound; an integration then has only rounding errors


def cross(a: Array, b: Array) -> Array:
    """Return the vector products of arrays (..., 3). For few vectors `numpy.cross` takes ten times as long."""
    return a[..., [1, 2, 0]] * b[..., [2, 0, 1]] - a[..., [2, 0, 1]] * b[..., [1, 2, 0]]


def turn(chi: float) -> Array:
    """Return the matrix R(chi), which turns a change of a state by the angle chi about the third axis."""
    c, s, matrix = np.cos(chi), np.sin(chi), np.eye(SIZE)
    matrix[:2, :2] = matrix[3:5, 3:5] = [[c, -s], [s, c]]
    return matrix


@cache
def _schedule(lanes: int, steps: int) -> BlockSchedule:
    """Return the blocks of `lanes` lanes. Each lane has `steps` steps and one node."""
    ones = np.ones(lanes, np.int64)
    return pack_blocks(steps * ones, ones)


class Flow:
    """Equations, integrals and symmetry of one body. Arrays of states are (states, components), arrays of their changes (states, 6)."""

    def __init__(self, system: Gyrostat, points: Points) -> None:
        self.system, self.equations, self.ensemble = system, system.equations, Ensemble.of(system, points)
        self.body, self.start = system.body(points), self.ensemble.state[:, 0]
        self.constants = self.ensemble.constants
        self.symmetric = bool(system.conserves_axial_momentum(points)[0])
        self.rotates, self.rate = rotates(self.equations), 1.0
        powers, constant = self.equations.INTEGRALS, system.integral_scales(points)
        self.energy = next(iter(powers))
        self.momenta = [name for name in powers if powers[name] == 1 and not np.isnan(constant[name][0])]
        # Changes of attitude that are rotations keep the length of gamma. For other changes the length is held like a momentum.
        self.held = self.momenta if self.rotates else ["length_gamma", *self.momenta]
        self.tangents = specialization.tangent_kernel(system)
        self.path = specialization.node_kernel(system, TANGENT_METHOD.name)

    def vectors(self, states: Array) -> Array:
        """Return the angular velocity and the directions of the frame in every state, (states, vectors, 3)."""
        return states.reshape(len(states), -1, 3)

    def moved(self, states: Array, changes: Array) -> Array:
        """Return `states` after `changes`. If a change of attitude is a rotation vector, it is applied as a finite rotation."""
        v = self.vectors(states).copy()
        v[:, 0] += self.rate * changes[:, :3]
        if self.rotates:
            v[:, 1:] = v[:, 1:] @ Rotation.from_rotvec(changes[:, 3:]).as_matrix()
            # Rounding errors of many rotations would add up.
            v[:, 2] /= np.linalg.norm(v[:, 2], axis=1)[:, None]
            v[:, 1] -= (v[:, 1] * v[:, 2]).sum(1)[:, None] * v[:, 2]
            v[:, 1] /= np.linalg.norm(v[:, 1], axis=1)[:, None]
        else:
            v[:, 1] += changes[:, 3:]
        return v.reshape(states.shape)

    def difference(self, ends: Array, states: Array) -> Array:
        """Return the changes from `states` to the nearby `ends`, to first order."""
        a, b = self.vectors(ends), self.vectors(states)
        attitude = a[:, 1] - b[:, 1]
        if self.rotates:
            a, b = (np.concatenate([v, cross(v[:, 2:], v[:, 1:2])], 1) for v in (a, b))
            attitude = -0.5 * cross(b[:, 1:], a[:, 1:]).sum(1)
        return np.hstack([(a[:, 0] - b[:, 0]) / self.rate, attitude])

    def value(self, name: str, state: Array) -> float:
        """Return the integral `name` at `state`."""
        return float(sum(getattr(self.equations, name)(state, self.constants[:, 0])))

    def gradients(self, names: Sequence[str], state: Array) -> Array:
        """Return integrals' derivatives by changes of `state`, (names, 6). Central differences are exact for quadratic integrals."""
        v, unit = self.vectors(state[None])[0], np.eye(3)
        moved = np.zeros((SIZE, *v.shape))
        moved[:3, 0] = self.rate * unit
        moved[3:, 1:] = cross(v[None, 1:], unit[:, None]) if self.rotates else unit[:, None]
        step = 1e-3 * moved.reshape(SIZE, -1)
        ahead, behind = (state + step).T, (state - step).T
        integrals = [getattr(self.equations, name) for name in names]
        rows = [sum(each(ahead, self.constants)) - sum(each(behind, self.constants)) for each in integrals]
        return np.reshape(rows, (len(rows), SIZE)) / 2e-3

    def slopes(self, states: Array) -> Array:
        """Return the time derivatives of `states`."""
        derivative = np.array(self.equations.rhs(states.T, self.constants), float).T
        attitude = derivative[:, 3:]
        if self.rotates:
            attitude = np.array(self.equations.frame_motion(states.T, self.constants)[:3]).T
        return np.hstack([derivative[:, :3] / self.rate, attitude])

    def symmetry(self, states: Array) -> Array:
        """Return the derivatives of `states` by the angle of a turn about the axis of symmetry, or zeros for a body without symmetry."""
        if not self.symmetric:
            return np.zeros((len(states), SIZE))
        v, axis = self.vectors(states), np.array([0.0, 0.0, 1.0])
        attitude = np.broadcast_to(-axis, (len(v), 3)) if self.rotates else cross(axis, v[:, 1])
        return np.hstack([cross(axis, v[:, 0]) / self.rate, attitude])

    def speeds(self, states: Array) -> Array:
        """Return the lengths of the time derivatives of `states`, without the components along turns about the axis of symmetry."""
        slopes, along = self.slopes(states), self.symmetry(states)
        shares = (slopes * along).sum(1) / np.maximum((along * along).sum(1), 1e-12)
        return np.linalg.norm(slopes - shares[:, None] * along, axis=1)

    def turned(self, states: Array, chi: float) -> Array:
        """Return `states` turned by the angle `chi` about the third axis."""
        return (self.vectors(states) @ turn(chi)[:3, :3].T).reshape(states.shape)

    def bound(self, state: Array) -> float:
        """Return a bound of the fastest frequency of the motion through `state`."""
        return float(self.body.frequency_bound(*self.system.vectors(state[:, None]))[0])

    def run(self, states: Array, time: float, bound: float) -> tuple[Array, Array]:
        """Return the states after `time`, and the matrices, (states, 6, 6), that map small initial changes to the final changes."""
        count, steps = len(states), _steps(time, bound)
        unit, lanes = time / steps / self.tangents.STEP * self.rate, count * SIZE
        state, constants = np.repeat(states.T, SIZE, axis=1), np.repeat(self.constants, lanes, axis=1)
        changes, sums = np.tile(np.diag([unit] * 3 + [1.0] * 3), (1, count)), np.empty((len(Growth), lanes))
        schedule, weights = _schedule(lanes, steps), np.ones((SIZE, lanes))
        arrays = TangentArrays(np.full(lanes, time / steps), state, constants, changes, weights, sums)
        begin = np.zeros_like(schedule.steps)
        self.tangents.integrate(schedule, arrays, 0, len(begin), begin, begin + 1)
        changes *= np.exp(sums[Growth.LOG_GROWTH])  # the kernel has divided the changes by their growth
        changes[:3] /= unit
        return state[:, ::SIZE].T.copy(), changes.reshape(SIZE, count, SIZE).transpose(1, 0, 2)

    def nodes(self, states: Array, time: float, bound: float, steps: int = 0) -> Array:
        """Return the states at the start and after every step until `time`, (states, steps + 1, components)."""
        count, steps = len(states), steps or _steps(time, bound)
        start = self.ensemble.subset(np.zeros(count, np.int64))
        start = replace(start, state=np.ascontiguousarray(states.T))
        result, _ = start.nodes(self.path, np.ones(count, np.int64), np.full(count, time / steps), steps + 1)
        return result.transpose(2, 1, 0)


def _steps(time: float, bound: float) -> int:
    return max(4, int(np.ceil(min(time * bound / RADIANS, 1e6))))
