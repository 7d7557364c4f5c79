"""Motions that start near a steady motion: their labels from the linear equations.

A start has a steady motion x0(t), theta = theta0, psi' = n, phi' = m, which solves the equations of motion x'
= F(x) up to the residual acceleration f(t) = F(x0) - x0'. To first order in f and in theta' of the start, the
motion is x0 + d with

    d' = F'(x0(t)) d + f(t),    d(0) = start - x0(0),

by variation of constants. The forced and the free oscillations, secular drifts and the growth near an
unstable motion are all parts of d. The kernel of `engine.deviation` integrates it.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from ..engine import blocks, deviation
from ..engine.deviation import Deviation, DeviationArrays
from ..engine.generated import WIDTH
from ..engine.specialization import deviation_kernel
from ..engine.tableaux import METHODS
from ..flags import Label
from ..measure import rates
from ..measure.instrument import Tolerances, could_change
from ..systems import jacobian
from ..systems.base import Array, Flags, Mask, Points, System
from ..systems.vectors import length

# A start is far from every steady motion where its rates change at first by more than this, in units of the rate tolerance:
# where linear theory describes the motion for a while, and where its angles soon change by a share of _REACH of the limit.
# There a uniform change in three directions has standard deviations of a sixth of it.
_FAR, _FAR_BEYOND, _REACH = 10.0, 6.0, 0.25
# Relative error that is assumed of every deviation from the steady motion.
_MARGIN = 0.1
# Terms of second order over the squared deviation, an estimate: where linear theory gives a steady label, and where it gives
# drift. Of 95 in 100 random offsets they are below 0.03; slow turns of x0 away from the motion cause the largest.
_SECOND_ORDER = 0.25, 1.0
# Largest step in radians of the frequency bound, and largest relative loss of an amplitude in a run by the method's damping.
_STEP, _MAX_DAMPING = 0.4, 0.03
_MIN_STEPS, _MAX_STEPS = 64, 2**18  # in a run
_NODES_IN_RANGE, _MAX_REFINEMENT = 4.0, 8.0
# Size of some rounding errors of a start.
_ROUNDING = 1e-15


def describes(system: System) -> bool:
    """Whether the states of a system are an angular velocity, in this order, and vectors at rest in the frame."""
    names = system.equations.STATE
    vectors = {name for v in getattr(system.equations, "FRAME_VECTORS", ()) for name in v}
    others = tuple(name for name in names if name not in vectors)
    return len(others) == 3 and others == tuple(system.rate_states) and vectors <= set(names)


def off_family_labels(
    system: System,
    points: Points,
    duration: Array,
    tolerances: Tolerances,
    frames: Mapping[str, Array],
    pause: Callable[[], None] = lambda: None,
    threads: int | None = None,
) -> dict[str, Flags]:
    """Labels in each frame, from linear theory, of starts that are on no family's motion and may be near one.

    The system is a body in a frame, see `describes`; `frames` are rates that are added to psi', rad per time
    unit. `pause` is called from any thread, and raises an exception where the run was interrupted. The label
    is not_computed where a change of a tenth, or terms of second order, could change it, where rounding
    errors cause the drift, and where the run is too long for the linear equations.
    """
    result = {name: np.full(duration.shape, Label.DRIFTING, np.int8) for name in frames}
    with np.errstate(all="ignore"):
        bound = system.frequency_bound(points)
        start = _SteadyMotions.of(system, points, bound, tolerances.angle)
        near = np.flatnonzero(_near(start, bound, duration, tolerances, points.get("damping", 0.0)))
        for name in frames:
            result[name][near] = Label.NOT_COMPUTED
        steps = _steps(start.subset(near), bound[near], duration[near], tolerances.angle)
        near, steps = near[steps <= _MAX_STEPS], steps[steps <= _MAX_STEPS]
        if near.size:
            motions, step_size = start.subset(near), duration[near] / steps
            # In a run of less than a radian of the bound a rate turns by less than it does at the bound.
            unit = np.fmax(bound[near], 1.0 / duration[near])
            options = tolerances.angle, threads, pause
            size = length(motions.offset) / unit + length(motions.acceleration()) / unit**2
            sums = _integrate(motions, unit, steps, step_size, *options, change=np.fmax(_ROUNDING, size**2))
            for name, rate in frames.items():
                result[name][near] = _label(motions, unit, steps, sums, tolerances, rate[near])
            drifts = np.flatnonzero(
                np.any([label[near] == Label.DRIFTING for label in result.values()], axis=0)
            )
            if drifts.size:
                part = motions.subset(drifts), unit[drifts], steps[drifts], step_size[drifts]
                # Deviations without the terms of second order may differ in size, or in when they leave the linear range.
                own, other = sums[:, drifts], _integrate(*part, *options)
                ratio = own[Deviation.LARGEST_SQUARE] / other[Deviation.LARGEST_SQUARE]
                linear = (own[Deviation.LINEAR] > 0) & (other[Deviation.LINEAR] > 0)
                nodes = np.abs(own[Deviation.NODES] - other[Deviation.NODES])
                other_terms = np.where(linear, np.abs(ratio - 1.0) > _MARGIN, nodes > 1)
                for label in result.values():
                    label[near[drifts[other_terms]]] = Label.NOT_COMPUTED
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
    def of(cls, system: System, points: Points, bound: Array, angle: float) -> _SteadyMotions:
        """Inside the cylinder, where n and m are any with this w, rotations about the third axis if n is beyond the bound."""
        constants, state = system.constants(points), np.array(system.initial_state(points))
        _, n, m = (np.array(value, float) for value in system.steady_rates(points))
        u, g = np.split(np.array(system.equations.frame_motion(state, constants)), 2)
        singular = (np.hypot(g[0], g[1]) < angle) & (np.abs(n) > bound)
        n, m = np.where(singular, 0.0, n), np.where(singular, u[2], m)
        offset = u - n * g
        offset[2] -= m
        state[_indices(system, system.rate_states)] -= offset
        return cls(system, constants, state, n, m, offset)

    def subset(self, where: NDArray[np.int64]) -> _SteadyMotions:
        arrays = (values[..., where] for values in (self.constants, self.state, self.n, self.m, self.offset))
        return _SteadyMotions(self.system, *arrays)

    @property
    def vertical(self) -> Array:
        """Unit vector of the frame's vertical at the start, (3, points)."""
        return np.array(self.system.equations.frame_motion(self.state, self.constants)[3:])

    def harmonics(self) -> Array:
        """The frame's vectors before the turn about the third axis, (9 * vectors, points): see `deviation.integrate`."""
        g, parts = self.vertical, []
        for names in self.system.equations.FRAME_VECTORS:
            vector = self.state[_indices(self.system, names)]
            along = (g * vector).sum(0) * g
            parts += [along, vector - along, np.cross(vector, g, axis=0)]
        return np.concatenate(parts)

    def acceleration(self) -> Array:
        """f at the start: u' - n m gamma x e3 with u' from the equations, (3, points)."""
        equations = self.system.equations
        slope = np.array(equations.rhs(self.state, self.constants))
        result = np.array(equations.frame_motion(slope, self.constants)[:3])
        turn, g = self.n * self.m, self.vertical
        result[0] -= turn * g[1]
        result[1] += turn * g[0]
        return result

    @property
    def rate(self) -> Array:
        """Largest rate of what is of second order in angles: of turns, and by which they change the acceleration."""
        system, changes = self.system, []
        for axis in np.eye(3):
            turn = np.zeros_like(self.state)
            for names in system.equations.FRAME_VECTORS:
                vector = _indices(system, names)
                turn[vector] = np.cross(axis[:, np.newaxis], self.state[vector], axis=0)
            sides = [replace(self, state=self.state + side * turn).acceleration() for side in (-0.5, 0.5)]
            changes.append(length(sides[1] - sides[0]))
        turns = length(self.state[_indices(system, system.rate_states)])
        return np.asarray(turns + np.sqrt(np.max(changes, axis=0)))


def _indices(system: System, names: Iterable[str]) -> list[int]:
    return [system.equations.STATE.index(name) for name in names]


def _near(
    start: _SteadyMotions, bound: Array, duration: Array, tolerances: Tolerances, damping: Array | float = 0.0
) -> Mask:
    """Whether the rates of a start change so slowly that the motion may count as steady.

    An oscillation at most as fast as the bound that begins with an acceleration f changes rates by |f| /
    bound or more, and angles by these rates in a radian of the bound, unless damping takes that away in such
    a time. Inside the cylinder the angles count.
    """
    g, time = start.vertical, np.fmin(1.0 / bound, duration)
    change = np.fmax(length(start.acceleration()) * time, length(start.offset))
    rms = change * np.where(damping > 0, np.sqrt(time / duration), 1.0)
    far = np.where(change * time > _REACH * deviation.LIMIT, _FAR_BEYOND, _FAR)
    inside = np.hypot(g[0], g[1]) < tolerances.angle
    return np.asarray((rms <= far * tolerances.rate) | (inside & (change * time <= _FAR * tolerances.angle)))


def near_circle(system: System, points: Points, duration: Array | float, rate_tolerance: float) -> Mask:
    """Whether the angular velocity of a start may stay on a circle in the body, as it does along steady motions about any axes.

    These have no linear theory. A start is far from all of them where in a radian of the bound the angular velocity changes by
    more than it is allowed to, and deviates as much from the circle of its first derivatives: there v.v' = 0 and
    v'' = -(|v'| / |v|)^2 v for v, the derivative of the angular velocity.
    """
    bound = system.frequency_bound(points)
    state, constants = system.initial_state(points), system.constants(points)
    derivatives = jacobian.derivatives(system.equations, state, constants, bound)
    v, first, second = derivatives[1:, _indices(system, system.rate_states)]
    time, size = np.fmin(1.0, bound * duration), length(v)
    change = size * time + length(first) * time**2 / 2
    speed = np.abs((v * first).sum(0)) / size * time**2 / 2
    bend = length(second + (length(first) / size) ** 2 * v) * time**3 / 6
    return np.asarray(~(np.fmin(change, np.fmax(speed, bend)) > _FAR * rate_tolerance))


def _steps(motions: _SteadyMotions, bound: Array, duration: Array, angle: float) -> NDArray[np.int64]:
    """Steps of the linear equations in each run."""
    method = METHODS["rk4"]
    radians = np.fmax(bound, np.abs(motions.n) + np.abs(motions.m)) * duration
    damped = (_MAX_DAMPING / (method.dissipation * radians)) ** (1 / (method.dissipation_order - 1))
    steps = np.ceil(np.fmin(np.fmax(radians / np.fmin(_STEP, damped), _MIN_STEPS), 2.0 * _MAX_STEPS))
    # A motion that soon leaves the linear range has some nodes in it, so that its rates are known to vary.
    g, limit = motions.vertical, deviation.LIMIT
    sine = np.hypot(g[0], g[1])
    turn = np.where(sine < angle, 1.0, sine)  # an angle over this is one of the direction of the tilt
    leaves = np.fmin(
        np.sqrt(2 * limit * turn / length(motions.acceleration())), limit * turn / length(motions.offset)
    )
    more = np.fmin(_NODES_IN_RANGE * duration / leaves, np.fmin(_MAX_REFINEMENT * steps, _MAX_STEPS))
    return np.fmax(steps, np.ceil(more)).astype(np.int64)


def _integrate(
    motions: _SteadyMotions,
    unit: Array,
    steps: NDArray[np.int64],
    step_size: Array,
    angle: float,
    threads: int | None,
    pause: Callable[[], None],
    change: Array | float = 0.0,
) -> Array:
    """Sums over the nodes of x0 + d, (len(Deviation), points); change: of d at the start, its size."""
    g, rates = motions.vertical, _indices(motions.system, motions.system.rate_states)
    sine = np.hypot(g[0], g[1])
    # psi' and phi' depend on the direction of the tilt, except inside the cylinder, where they do not count.
    direction = np.where(sine < angle, 0.0, 1.0 / sine**2)
    given = np.array([motions.n, motions.m, steps, step_size, direction])
    start, scales = np.zeros(motions.state.shape), np.ones(motions.state.shape)
    start[rates], scales[rates] = motions.offset, 1.0 / unit
    start += change / scales * np.cos(np.arange(len(start)))[:, np.newaxis]
    constants, harmonics = np.ascontiguousarray(motions.constants), motions.harmonics()
    points, sums = blocks.sorted_blocks(steps), np.empty((len(Deviation), steps.size))
    arrays = DeviationArrays(constants, harmonics, given, start, scales, angle, sums)
    call = partial(deviation_kernel(motions.system).integrate, points, arrays)
    # A block is integrated by one call; its first point takes the most steps.
    begin, end = np.zeros(len(points), np.int64), np.ones(len(points), np.int64)
    blocks.call_by_parts(call, WIDTH * steps[points[:, 0]], begin, end, threads, lambda _: pause())
    return sums


def _label(
    motions: _SteadyMotions,
    unit: Array,
    steps: NDArray[np.int64],
    sums: Array,
    tolerances: Tolerances,
    frame_rate: Array,
) -> Flags:
    """Label of motions x0 + d as long as d is small; not_computed where the linear equations do not decide. unit: that of rates."""
    mean = sums / sums[Deviation.NODES]
    # Of a part of the run. Those of the whole one are not smaller than the root of its share times these.
    share = sums[Deviation.NODES] / (steps + 1)
    rows = {"psi_dot": Deviation.PSI_DOT, "phi_dot": Deviation.PHI_DOT, "normal_rate": Deviation.NORMAL_RATE}
    tilt = {
        "theta_min": np.arctan2(1.0, sums[Deviation.LARGEST_COTANGENT]),
        "theta_max": np.arctan2(1.0, sums[Deviation.LEAST_COTANGENT]),
        "sine_max": sums[Deviation.LARGEST_SINE],
    }
    measured = {"theta_dot_rms": np.sqrt(share * mean[Deviation.THETA_DOT_SQUARE])}
    for name, row in rows.items():
        measured[f"{name}_std"] = np.sqrt(share * np.maximum(mean[row + 1] - mean[row] ** 2, 0.0))
    error = {name: _MARGIN * value for name, value in measured.items()}
    for name, rate in (("psi_dot", motions.n), ("phi_dot", motions.m)):
        measured[f"{name}_mean"] = rate + mean[rows[name]]
        error[f"{name}_mean"] = _MARGIN * np.abs(mean[rows[name]])
    measured |= tilt
    error |= dict.fromkeys(tilt, _MARGIN * (tilt["theta_max"] - tilt["theta_min"]))
    rule = rates.rule(tolerances, frame_rate)
    label = rule.label(measured)
    unsure = could_change(rule, measured, error)
    # Terms of second order decide nothing; a motion that has left the linear range drifts if it drifted before.
    steady = label != Label.DRIFTING
    second_order = np.where(steady, *_SECOND_ORDER) * sums[Deviation.LARGEST_SQUARE]
    largest_rate = np.max([measured[name] for name in ("theta_dot_rms", *(f"{n}_std" for n in rows))], axis=0)
    unit = np.fmin(unit, motions.rate + largest_rate / np.sqrt(sums[Deviation.LARGEST_SQUARE]))
    error = {name: value + second_order * (1.0 if name in tilt else unit) for name, value in error.items()}
    within = could_change(rule, measured, error)
    unsure |= np.where(sums[Deviation.LINEAR] > 0, within, steady)
    return np.where(unsure, Label.NOT_COMPUTED, label).astype(np.int8)
