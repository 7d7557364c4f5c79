"""Stress cases of motions in the plane, and their exact motions."""

from __future__ import annotations

import numpy as np

from ...systems.base import FAMILY_TOLERANCE, Array, Points, StressCase, System
from ...systems.gyrostat import Gyrostat
from ..plane.families import CONDITIONS, motions
from . import cases
from .cases import LOGARITHMS, OFFSET, OFFSETS
from .exact import EulerMotion

OFF_SEPARATRIX = np.array([-0.65, -0.1, -1e-3, -1e-6, 1e-6, 1e-3, 0.1, 2.0])


class PlaneMotion:
    """Exact motion of a satellite in the plane, with the third axis along the normal. A rotor along this axis has no effect."""

    def __init__(self, points: Points):
        failing = [c.text for c in CONDITIONS if not np.abs(c.residual(points)).max() <= FAMILY_TOLERANCE]
        if failing or (points["theta0"] != 0).any():
            raise ValueError(
                f"a point has no exact motion in the plane: {'; '.join(failing) or 'theta0 = 0'}"
            )
        motion = self.motion = motions(points)
        self.rate = 2 * abs(float((motion.frequency * motion.unit)[0]))
        self.period = float((motion.period() * np.where(motion.rotates, 0.5, 1.0))[0])

    def __call__(self, time: Array) -> EulerMotion:
        """Return angles and rates at the times. psi' and phi' are nan, because theta is 0."""
        rate = self.motion.pitch(np.asarray(time, float)[..., None])[1][..., 0]
        zero, nan = np.zeros_like(rate), np.full_like(rate, np.nan)
        return EulerMotion(zero, zero, nan, nan, rate, zero)


def plane_cases(system: System) -> tuple[StressCase, ...]:
    """Return librations and rotations, some of them close to the separatrix, and small offsets from the unstable equilibrium."""
    pitch = {"A": 1.2, "B": 1.0, "C": 0.9}
    pitch_growth = np.sqrt(3 * (pitch["A"] - pitch["B"]) / pitch["C"])
    # The rates are on both sides of 0.75, which is the rate on the separatrix.
    body, rates = {"A": 1.0, "B": 1.3, "C": 1.6, "k3": -0.5, "mu3": 1.0, "h3": 0.4}, 0.75 + OFF_SEPARATRIX
    points = {name: np.full(rates.size, body.get(name, p.default)) for name, p in system.parameters.items()}
    period = motions(points | {"n": rates}).period()
    return (
        StressCase("pitch", "libration and rotation in the plane of the orbit", 20.0,
                   {"A": [1.0, 1.0, 1.0, 1.2, 1.2], "B": [1.3, 1.3, 1.3, 1.0, 1.0], "psi0": [0.1, 1.5, 0.1, 1.5, 0.3],
                    "n": [0.0, 0.0, 2.0, 0.0, -1.0], "k3": 0.5},
                   truth=PlaneMotion),
        *(StressCase(f"pitch, {part} of the period", "its mean rate is the pitch at the end, with rotor and magnet",
                     share * period, {**body, "n": rates}, truth=PlaneMotion)
          for part, share in (("a tenth", 0.1), ("half", 0.5), ("all", 1.0))),
        StressCase("unstable pitch, offset", "on the normal, beside the unstable direction", LOGARITHMS / pitch_growth,
                   {**pitch, "psi0": OFFSETS}, may_stay_unresolved=OFFSET, truth=PlaneMotion),
        StressCase("unstable pitch, long", "the same over and over again", 100.0, {**pitch, "psi0": [2e-14, 1e-11]},
                   may_stay_unresolved=OFFSET, truth=PlaneMotion),
    )  # fmt: skip


def satellite_cases(system: Gyrostat) -> tuple[StressCase, ...]:
    """Return all cases of satellites."""
    return (*cases.satellite_cases(system), *plane_cases(system))
