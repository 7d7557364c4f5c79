"""Stiff and extreme points of the satellite; Omega = 1 unless stated otherwise."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import ArrayLike

from ..base import Array, StressCase, subset
from ..gyrostat import Gyrostat
from ..gyrostat.motions import earlier_start

OVERFLOW = "the numbers overflow"
GROWN = "the method's own error grows with the motion before rounding does"
OFFSET = "the start is as near an unstable motion as rounding resolves"

# Distances at which the axis passes the normal, rad, and its speed there.
SINES, SPEED = np.array([1e-4, 1e-3, 1e-2, 1e-1]), 0.3
# By part of the run in which the axis passes: start of the run before the passage, and length of the run.
PASSAGES = {"starts": (0.01, 2.0), "ends": (2.0, 1.95), "passes": (1.5, 3.0)}
# Tops that pass the normal: spherical ones on the orbit, where gravity has no torque, and others without an orbit.
BODIES: Mapping[str, Mapping[str, float]] = {
    "sphere": {"C": 1.0, "k3": 0.4},
    "magnetic sphere": {"C": 1.0, "k3": 0.4, "mu3": 1.0, "h3": -0.6},
    "magnetic top": {"C": 0.7, "Omega": 0.0, "k3": 0.4, "mu3": 1.0, "h3": -0.6},
}


def passages(system: Gyrostat) -> list[StressCase]:
    """Exact motions that start, end or pass beside the normal."""
    result = []
    for body, columns in BODIES.items():
        for part, (before, duration) in PASSAGES.items():
            nearest: dict[str, ArrayLike] = {**columns, "theta0": SINES, "phi0": 0.3, "n": SPEED / SINES}
            nearest["m"] = 0.5 - SPEED / SINES * np.cos(SINES)
            start = earlier_start(system, nearest, np.full(SINES.shape, before))
            result.append(
                StressCase(f"{body} {part}", f"it {part} beside the normal", duration, start, truth="symmetric top")
            )  # fmt: skip
    return result


def unstable_equilibria(system: Gyrostat, seed: int, count: int = 10) -> tuple[dict[str, Array], Array]:
    """Unstable equilibria of random satellites with rotor and magnet, and their growth rates."""
    rng = np.random.default_rng(seed)
    size = 8 * count
    points = {name: np.full(size, parameter.default) for name, parameter in system.parameters.items()}
    points |= {name: rng.normal(size=size) for name in ("k3", "mu1", "mu2", "mu3", "h3")}
    points |= {name: rng.uniform(0.8, 1.5, size) for name in "ABC"}
    points |= {
        "theta0": rng.uniform(0.4, 2.7, size),
        "psi0": rng.uniform(0, 6, size),
        "phi0": rng.uniform(0, 6, size),
    }
    family = system.families["equilibrium"]
    for name in ("h1", "k1", "k2"):
        points[name] = family.solve[name](points)
    growth = system.linear_stability(points, np.full(size, family.flag, np.int8))[1]
    chosen = np.flatnonzero((growth > 0.3) & (np.abs(points["h1"]) < 5))[:count]
    return subset(points, chosen), growth[chosen]


def departures(system: Gyrostat) -> list[StressCase]:
    """Unstable equilibria with offsets of 1e-15 to 3e-11 rad that grow by exp(20) to exp(25)."""
    columns, growth = unstable_equilibria(system, 1)
    offset, logarithm = np.geomspace(1e-15, 3e-11, growth.size), np.linspace(20.0, 25.0, growth.size)
    pitch = {"A": 1.2, "B": 1.0, "C": 0.9}
    pitch_growth = np.sqrt(3 * (pitch["A"] - pitch["B"]) / pitch["C"])
    return [
        StressCase("unstable rest, offset", "equilibria with rotor and magnet", logarithm / growth, columns,
                   additions={"theta0": offset}, may_stay_unresolved=OFFSET, truth="departure"),
        StressCase("unstable pitch, offset", "on the normal, beside the unstable direction", logarithm / pitch_growth,
                   {**pitch, "psi0": offset}, may_stay_unresolved=OFFSET, truth="planar libration"),
        StressCase("unstable pitch, long", "the same over and over again", 100.0, {**pitch, "psi0": [2e-14, 1e-11]},
                   may_stay_unresolved=OFFSET, truth="planar libration"),
    ]  # fmt: skip


def slow_spin() -> StressCase:
    """Exact starts whose linear equations have a period much longer than the run."""
    m, duration = (values.ravel() for values in np.meshgrid([0.05, 0.02, 0.005], [30.0, 100.0]))
    theta, C = 1.2, 1.2
    s, c = np.sin(theta), np.cos(theta)
    h1 = m * s / (1 + m * c)
    columns = {"theta0": theta, "psi0": np.pi / 2, "C": C, "m": m, "mu1": 1.0, "h3": 1.0, "h1": h1}
    columns |= {"k1": (s - h1 * c) / s, "k3": 4 * (1 - C) * c - C * m}
    return StressCase("slow spin, unstable", "magnet across the axis, so that the linear equations are periodic",
                      duration, columns, may_stay_unresolved=GROWN)  # fmt: skip


def cases(system: Gyrostat) -> tuple[StressCase, ...]:
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
        StressCase("pitch", "libration and rotation in the plane of the orbit", 20.0,
                   {"A": [1.0, 1.0, 1.0, 1.2, 1.2], "B": [1.3, 1.3, 1.3, 1.0, 1.0], "psi0": [0.1, 1.5, 0.1, 1.5, 0.3],
                    "n": [0.0, 0.0, 2.0, 0.0, -1.0], "k3": 0.5},
                   truth="planar libration"),
        slow_spin(), *departures(system), *passages(system),
    )  # fmt: skip
