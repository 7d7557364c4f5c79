"""Equilibria of a damped gyrostat, and the wells of the amended potential W in which the energy holds the gyrostat.

The damping D gives the torque -D u, where u is the angular velocity relative to the frame. The energy J = u.I u / 2 + W then falls
at the rate D u.u, so that the body stays in its component of {W <= J}. If a minimum is the only equilibrium of the component, every
motion in the component ends there (LaSalle). As J rises, the first other equilibrium to join the component is one from which descent
of W reaches the minimum. The rim of the well is therefore the lowest potential of all equilibria with this property.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...flags import Completeness
from ...systems.base import Array, Mask, Points
from ...systems.gyrostat.body import Body
from ...systems.gyrostat.system import Gyrostat
from ..equilibria.algebra import ANGLES, attitudes, frames_of, rotated
from ..equilibria.bodies import bodies_of

Places = NDArray[np.int64]
# Largest angle (rad) of a settled body from its equilibrium, and largest angular velocity in units of `Wells.rate`.
SETTLED = 1e-3
_FLAT = 1e-6  # an eigenvalue of a Hessian counts as 0 below this fraction of the largest eigenvalue at the body's equilibria
_DISPLACED = 1e-2  # a descent begins at this angle from an equilibrium, rad
_SADDLE = 1e-6  # a descent stops when a saddle or maximum is nearer than this angle, rad
# Number of steps of a descent between two searches for the nearest equilibrium, and largest number of steps.
_STEPS, _MAX_STEPS = 16, 4096
_BLOCK = 4096  # number of attitudes that are compared together


@dataclass(frozen=True)
class Wells:
    """Equilibria of bodies, in the places of `System.equilibria_of_bodies`. Arrays are (bodies, places), with nan in unused places."""

    body: Body
    rate: Array  # unit of rates, which is the frame's rate or, if that is 0, the natural rate, (bodies,)
    single: bool  # whether gamma is the only direction of the frame; attitudes that differ by a turn about gamma are then equal
    frames: Array  # rows alpha, beta and gamma in body axes, (bodies, places, 3, 3); if `single`, rows alpha and beta are 0
    axis: Array  # axis about which an equilibrium turns along its circle, in body axes, nan without a circle, (bodies, places, 3)
    angles: dict[str, Array]  # Euler angles by name, nan where an angle varies along a circle of equilibria
    potential: Array
    index: Array  # Morse index
    minimum: Mask
    downhill: Array  # axis of the turn that lowers W most, (bodies, places, 3)
    settled: Array  # energy below which attitude and rates stay within SETTLED of a minimum
    listed: Mask  # whether all equilibria are known and their indices are certain, (bodies,)
    rim: Array  # energies of the rims of wells, nan until they are computed

    @property
    def least(self) -> Array:
        """Lowest potential of an equilibrium that is no minimum, (bodies,)."""
        return np.asarray(np.nanmin(np.where(self.minimum, np.inf, self.potential), axis=1, initial=np.inf))

    def nearest(self, frames: Array, row: Places) -> tuple[Places, Array]:
        """Return the place of the equilibrium nearest to each attitude, and the angle to it in rad. `row` has the numbers of the bodies."""
        place, angle = np.empty(len(row), np.int64), np.empty(len(row))
        directions = 1 if self.single else 3
        for first in range(0, len(row), _BLOCK):
            part = slice(first, first + _BLOCK)
            own, known, axis = frames[part], self.frames[row[part]], self.axis[row[part]]
            trace = np.nan_to_num(np.einsum("nij,npij->np", own, known), nan=-np.inf)
            # The angle to a circle of equilibria is the angle to the nearest equilibrium of the circle.
            n, p = np.nonzero(~np.isnan(axis[..., 0]))
            s, first_vectors, second_vectors = axis[n, p][:, None], own[n], known[n, p]
            along = ((first_vectors * s).sum(-1) * (second_vectors * s).sum(-1)).sum(-1)
            across = (np.cross(first_vectors, second_vectors) * s).sum((-2, -1))
            trace[n, p] = along + np.hypot(trace[n, p] - along, across)
            place[part], largest = trace.argmax(1), trace.max(1)
            angle[part] = 2 * np.arcsin(np.sqrt(np.clip((directions - largest) / (directions + 1), 0.0, 1.0)))
        return place, angle

    def energy(self, frames: Array, rates: Array, row: Places) -> Array:
        """Return the energy J for attitudes and angular velocities relative to the frame."""
        body = self.body.subset(row)
        return body.potential(frames[:, 0], frames[:, 2]) + 0.5 * (body.inertia * rates**2).sum(-1)

    def descend(self, frames: Array, row: Places) -> Places:
        """Descend in W from each attitude. Return the place of the equilibrium that is reached, usually a minimum, or -1 if there is none.

        Each step is -gradient / L, where L is a bound of the second derivatives of W, so that W falls.
        """
        frames, place, active = frames.copy(), np.full(len(row), -1), np.arange(len(row))
        for _ in range(_MAX_STEPS // _STEPS):
            if not active.size:
                break
            nearest, angle = self.nearest(frames[active], row[active])
            arrived = angle < np.where(self.minimum[row[active], nearest], SETTLED, _SADDLE)
            place[active[arrived]] = nearest[arrived]
            active = active[~arrived]
            body = self.body.subset(row[active])
            bound, turned = body.steepness()[:, None], frames[active]
            for _ in range(_STEPS):
                turned = rotated(turned, -body.gradient(turned[:, 0], turned[:, 2])[0] / bound)
            frames[active] = turned
        return place

    def find_rims(self, bodies: Places) -> None:
        """Compute the rims of wells. Descent of W leads from some equilibria to the minimum of a well. The rim is their lowest potential.

        If descent from an equilibrium E reaches no equilibrium, E counts for every rim. If descent from E ends at a saddle, E counts
        for no rim, because the saddle has a lower potential and descent starts from the saddle too.
        """
        bodies = bodies[np.isnan(self.rim[bodies]).all(1)]
        which, place = np.nonzero(~np.isnan(self.potential[bodies]) & ~self.minimum[bodies])
        row = bodies[which]
        rim = np.where(self.minimum[bodies], np.inf, np.nan)
        for sign in (-1.0, 1.0):
            start = rotated(self.frames[row, place], sign * _DISPLACED * self.downhill[row, place])
            for i, end in enumerate(self.descend(start, row)):
                joined = which[i], slice(None) if end < 0 else end
                rim[joined] = np.minimum(rim[joined], self.potential[row[i], place[i]])
        self.rim[bodies] = rim

    def proved(self, frames: Array, energy: Array, row: Places, place: Places, settled: Mask) -> Places:
        """Return the place of the minimum in which every motion with at most the given energy must end, or -1.

        `place` is the place of the nearest equilibrium, and `settled` says whether the attitude is within SETTLED of this equilibrium.
        """
        least = self.least[row]
        decided = self.listed[row] & np.isfinite(energy)
        above = decided & (energy >= least)
        self.find_rims(np.unique(row[above]))
        decided &= ~above | (energy < np.nanmax(self.rim[row], axis=1, initial=-np.inf))
        well = np.where(decided & settled & self.minimum[row, place], place, -1)
        where = np.flatnonzero(decided & (well < 0))
        well[where] = self.descend(frames[where], row[where])
        inside = self.minimum[row, well] & (~above | (energy < self.rim[row, well]))
        return np.where((well >= 0) & inside, well, -1)


def wells_of(system: Any, points: Points) -> tuple[Wells, Places]:
    """Return the wells of the distinct bodies of some points, and the number of the body of each point. The last result is cached."""
    bodies, row = bodies_of(system, {**points, "damping": np.zeros_like(points["damping"])})
    return _wells(system, tuple(bodies), np.stack([*bodies.values()]).tobytes()), row


@lru_cache(maxsize=1)
def _wells(system: Gyrostat, names: tuple[str, ...], numbers: bytes) -> Wells:
    """Return the wells of bodies. `numbers` holds the bytes of an array (parameters, bodies), whose rows are the parameters `names`."""
    points = dict(zip(names, np.frombuffer(numbers).reshape(len(names), -1), strict=True))
    solutions = system.equilibria_of_bodies(points, stability=False)
    body, gamma, index, circle = system.body(points), *(solutions[n] for n in ("gamma", "index", "circle"))
    single = len(system.equations.FRAME_VECTORS) == 1
    alpha = 0.0 * gamma if single else solutions["alpha"]
    frames = frames_of(alpha, gamma)
    each = body.subset(np.arange(len(gamma))[:, None])
    potential = each.potential(alpha, gamma)
    values, directions = np.linalg.eigh(np.nan_to_num(each.hessian(alpha, gamma)))
    flat = np.abs(values) <= _FLAT * np.abs(values).max((1, 2), keepdims=True)
    # W is constant along circles of equilibria. If gamma is the only direction of the frame, W is constant along turns about gamma too.
    regular = flat.sum(-1) == circle.astype(int) + single
    minimum = (index == 0) & regular
    rate = np.where(body.turn == 0, body.natural_rate(np.zeros_like(body.rotor)), np.abs(body.turn))
    stiffness = np.minimum(np.where(flat, np.inf, values).min(-1), each.inertia.min(-1) * rate[:, None] ** 2)
    settled = np.where(minimum, potential + 0.5 * SETTLED**2 * stiffness, np.nan)
    axis = solutions.get("axis", np.full(gamma.shape, np.nan))
    if single:  # the rotor, which may lie off the axis of symmetry, does not act on a body at rest
        still = body._replace(rotor=np.zeros_like(body.rotor))
        for i in range(3):
            axis[circle & still.symmetric_about(i)[:, None]] = np.eye(3)[i]
    listed = np.isin(solutions["completeness"], (Completeness.COMPLETE, Completeness.NOT_ISOLATED))
    listed &= (regular | (index < 0)).all(1) & (index >= 0).any(1)
    own, turned = attitudes(frames), attitudes(rotated(frames, np.nan_to_num(axis)))
    angles = {}
    for name in ANGLES:
        same = np.abs(np.sin(0.5 * (own[name] - turned[name]))) < SETTLED
        positive = own[name] + np.where(own[name] < SETTLED**2 - np.pi, 2 * np.pi, 0.0)
        angles[name] = np.where(same, positive, np.nan)
    return Wells(
        body, rate, single, frames, axis, angles, potential, index, minimum, directions[..., 0], settled, listed,
        np.full(index.shape, np.nan),
    )  # fmt: skip
