"""Stiff and extreme points of the satellite; Omega = 1 unless stated otherwise."""

from __future__ import annotations

import numpy as np

from ..base import StressCase

OVERFLOW = "the numbers overflow"
GROWN = "the method's own error grows with the motion before rounding does"


def cases() -> tuple[StressCase, ...]:
    """The cases, see System.stress_cases."""
    tilted = {"theta0": 0.6, "psi0": 0.3, "m": 0.5}
    hyperbola = {"theta0": 0.8, "psi0": np.pi / 2, "C": 0.7}  # a stable perp_velocity motion
    unstable = {"theta0": 1.0, "psi0": np.pi / 2, "C": 1.2, "m": 0.3}
    fast, up = 10.0 ** np.arange(0, 7), 10.0 ** np.arange(-2, -13, -2)
    spins, fields = 10.0 ** np.arange(-6, 5, 2), 10.0 ** np.arange(-8, 7, 2)
    tilts = np.array([1e-2, 1e-3, 1e-4, 3e-5, 1e-6, 1e-8, 1e-12, 0.0])
    flip = {"A": 1.0, "B": 2.0, "C": 1.5, "Omega": 0.0, "m": 1.0}
    return (
        StressCase("stiff rotor", "rotor frequency over the slow one", np.minimum(20, 2e3 / fast),
                   {"k3": fast, "theta_dot0": 0.1, **tilted}),
        StressCase("stiff spin", "fast spin with the rotor against it: the axis moves slowly",
                   np.minimum(20, 2e3 / fast),
                   {"k3": 0.3 - 1.2 * fast, "theta0": 0.6, "psi0": 0.3, "m": fast}),
        StressCase("stiff steady", "the same on an exact steady motion", np.minimum(20, 2e3 / fast),
                   {"m": fast, **hyperbola}, solve=("perp_velocity", "k3")),
        StressCase("spin", "exact regular precession of a spherical body, slow to fast spin",
                   np.minimum(20, 2e3 / spins),
                   {"C": 1.0, "n": 0.5, "theta0": 1.0, "m": spins}, solve=("spherical", "k3")),
        StressCase("needle", "C towards 0", 20.0, {"C": 10.0 ** np.arange(-1, -7, -1), **tilted}),
        StressCase("flat body", "A + B = C", 20.0,
                   {"A": [1.0, 0.3, 1e-3], "B": [1.0, 0.7, 1.0], "C": [2.0, 1.0, 1.001], **tilted}),
        StressCase("needle across", "A towards 0", [20.0, 5.0, 1.0],
                   {"A": 10.0 ** np.arange(-2, -7, -2), "C": 1.0, **tilted}),
        StressCase("near 0", "tilts of a stable cylindrical motion", 20.0,
                   {"theta0": tilts, "C": 1.3, "m": 1.5}),
        StressCase("near pi", "the same upside down", 20.0, {"theta0": np.pi - tilts, "C": 1.3, "m": -3.5}),
        StressCase("steep precession", "exact regular precession close to the vertical", 20.0,
                   {"C": 1.0, "n": 0.5, "m": 0.7, "theta0": [1e-1, 1e-2, 1e-3, 1e-4]},
                   solve=("spherical", "k3")),
        StressCase("through the pole", "great circles through the vertical", 5.0,
                   {"Omega": [0.0, 1.0, 1.0], "theta0": 0.5, "theta_dot0": -3.0, "k3": [0.0, 0.0, 0.2]}),
        StressCase("field", "magnet in weak to strong fields", np.minimum(20, 30 / np.sqrt(fields)),
                   {"mu3": 1.0, "mu1": 0.2, "h1": fields, "h3": 0.3 * fields, **tilted}),
        StressCase("weak field", "a steady motion that a field disturbs", 20.0,
                   {"mu1": 1.0, "m": 0.4, **hyperbola},
                   solve=("perp_velocity", "k3"), additions={"h1": 10.0 ** np.arange(-12, -3, 2)}),
        StressCase("separatrix", "beside an unstable motion", 30.0,
                   unstable, solve=("perp_velocity", "k3"), additions={"theta0": up}),
        StressCase("racket", "free body about its middle axis, pushed a little", 60.0,
                   {"theta_dot0": up, **flip}),
        StressCase("unstable, short", "exactly on an unstable motion", 20.0,
                   {**unstable, "m": [0.3, 3.0, 30.0]}, solve=("perp_velocity", "k3")),
        StressCase("unstable, middle", "the same, longer", 50.0,
                   {**unstable, "m": [0.3, 3.0, 30.0]},
                   solve=("perp_velocity", "k3"), may_stay_unresolved=GROWN),
        StressCase("unstable, long", "the same, until rounding decides", 500.0,
                   unstable, solve=("perp_velocity", "k3")),
        StressCase("hidden growth", "fast spin on top of slow growth", 40.0,
                   {**unstable, "m": 60.0},
                   solve=("perp_velocity", "k3"), additions={"theta0": [1e-4, 1e-5, 1e-6]}),
        StressCase("slower than the run", "a weak gravity gradient", 4.0,
                   {"C": 1.0 + 10.0 ** np.arange(-2, -9, -2), **tilted, "m": -1.0}),
        StressCase("10 000 orbits", "exactly steady, and drifting", 2e4 * np.pi,
                   {"m": 0.4, **hyperbola}, solve=("perp_velocity", "k3"), additions={"theta0": [0.0, 0.3]}),
        StressCase("Omega = 0", "free and heavy bodies that orbit nothing", 20.0,
                   {"Omega": 0.0, "theta0": [0.0, 0.7, 0.7], "m": 0.5, "n": [0.0, 0.0, 0.4],
                    "h3": [0.0, 0.0, 1.0], "mu3": 1.0}),
        StressCase("at rest", "nothing turns at all", 20.0, {"Omega": 0.0, "theta0": [0.0, 0.5]}),
        StressCase("denormal", "parameters of 1e-300 and less", 20.0,
                   {"theta0": [1e-310, 0.5, 0.5], "k1": [1e-310, 0.0, 1e-320], "m": [0.5, 1e-300, 1e-310],
                    "h1": 1e-310, "mu2": 1e-310}),
        StressCase("overflow", "products of parameters overflow", 20.0,
                   {"theta0": 0.5, "k1": [1e200, 0.0, 0.0, 0.0], "m": [0.0, 1e300, 0.0, 0.0],
                    "mu1": [0.0, 0.0, 1e300, 0.0], "h1": [0.0, 0.0, 1e300, 0.0],
                    "n": [0.0, 0.0, 0.0, 1e160]},
                   may_stay_unresolved=OVERFLOW),
    )  # fmt: skip
