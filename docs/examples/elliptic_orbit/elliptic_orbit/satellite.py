"""Attitude of a satellite on an elliptic orbit, over the true anomaly; axes 1 to 3 near radius, velocity and normal."""

import numpy as np

from atlas.systems import Observable, Parameter, System

from . import satellite_equations
from .periodic import odd_solution

ANGLES = ("pitch", "roll", "yaw")
PARAMETERS = (
    *(Parameter(name, "1", f"moment of inertia about axis {i}", 1.0, 0.0, open_low=True) for i, name in enumerate("ABC", 1)),
    Parameter("e", "1", "eccentricity", 0.1, low=0.0, high=0.99),
    Parameter("branch", "1", "periodic pitch: from B = A (0) or from e = 0 (1)", 1.0, 0.0, 1.0),
    *(Parameter(f"{name}0", "rad", f"{name} at the pericentre at the start", start=True) for name in ANGLES),
    Parameter("pitch_rate0", "1", "rate of pitch there; left out: of the periodic pitch", np.nan, start=True),
    *(Parameter(f"{name}_rate0", "1", f"rate of {name} there", start=True) for name in ("roll", "yaw")),
)  # fmt: skip


class EllipticSatellite(System):
    """Turned by the pitch about the normal, then by the roll about its first and the yaw about its second axis."""

    name = "elliptic_satellite"
    title = "attitude of a satellite on an elliptic orbit"
    equations = satellite_equations
    parameters = {parameter.name: parameter for parameter in PARAMETERS}
    observables = (
        Observable("cos_tilt", "1", "cosine of the angle between third axis and normal", tolerance=np.inf),
        *(
            Observable(f"{name}_at_pericentre", "rad", f"{name} at the pericentre", every="2*pi")
            for name in ANGLES
        ),
    )

    def possible_start(self, points):
        """Everywhere: maps ask at many points. Where the branch has no solution the state is not finite."""
        return np.ones(np.shape(points["e"]), bool)

    def initial_state(self, points):
        ratio = (points["B"] - points["A"]) / points["C"]
        periodic = odd_solution({"e": points["e"], "K": ratio, "branch": points["branch"]})[0]
        rate = np.where(np.isnan(points["pitch_rate0"]), periodic, points["pitch_rate0"])
        starts = (points[name] for name in ("pitch0", "roll0", "yaw0"))
        return np.array([*starts, 0 * rate, rate, points["roll_rate0"], points["yaw_rate0"], 1 + 0 * rate])
