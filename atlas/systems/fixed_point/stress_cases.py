"""Stiff and extreme points of the gyrostat about a fixed point."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import ArrayLike

from ..base import Array, StressCase
from ..gyrostat import Gyrostat
from ..gyrostat.motions import earlier_start

OVERFLOW = "the numbers overflow"
GROWN = "the method's own error grows with the motion before rounding does"
OFFSET = "the start is as near an unstable motion as rounding resolves"

# Distances at which the axis passes the vertical, rad, and its speed there.
SINES, SPEED = np.array([1e-4, 1e-3, 1e-2, 1e-1]), 0.3
# By part of the run in which the axis passes: start of the run before the passage, and length of the run.
PASSAGES = {
    "starts": (np.array([0.0, 0.01]), np.array([2.0, 2.0])),
    "ends": (np.array([2.0, 2.0]), np.array([2.0, 1.95])),
    "passes": (np.array([1.5]), np.array([3.0])),
}
# Bodies with exact motions that pass the vertical, with the kind of motion.
BODIES: Mapping[str, tuple[str, Mapping[str, float]]] = {
    "free sphere": ("symmetric top", {"A": 1.0, "C": 1.0}),
    "free top": ("symmetric top", {"A": 1.0, "C": 1.6, "l3": -0.5}),
    "heavy top": ("symmetric top", {"A": 1.0, "C": 0.7, "l3": 0.4, "Mg": 1.0, "z0": 0.8}),
    "heavy top, upside down": ("symmetric top", {"A": 1.0, "C": 0.7, "l3": 0.4, "Mg": 1.0, "z0": -0.8}),
    "free body": ("free gyrostat", {"A": 1.0, "B": 1.3, "C": 1.7}),
    "free gyrostat": ("free gyrostat", {"A": 1.0, "B": 1.3, "C": 1.7, "l1": 0.6}),
}


def passages(system: Gyrostat) -> list[StressCase]:
    """Exact motions that start, end or pass beside the vertical."""
    result = []
    for body, (truth, columns) in BODIES.items():
        for part, (before, duration) in PASSAGES.items():
            sine, before, duration = (
                values.ravel() for values in np.broadcast_arrays(SINES[:, None], before, duration)
            )
            nearest: dict[str, ArrayLike] = {"B": columns["A"], **columns, "theta0": sine, "phi0": 0.3}
            nearest |= {"n": SPEED / sine, "m": 0.5 - SPEED / sine * np.cos(sine)}
            result.append(
                StressCase(f"{body} {part}", f"it {part} beside the vertical", duration,
                           earlier_start(system, nearest, before), truth=truth)
            )  # fmt: skip
    return result


def unstable_rotations(
    system: Gyrostat, n: float, seed: int, count: int = 10
) -> tuple[dict[str, Array], Array]:
    """Unstable permanent rotations of random bodies at the rate n, and their growth rates."""
    rng, bodies = np.random.default_rng(seed), list[dict[str, float]]()
    while len(bodies) < count:
        parts = rng.uniform(0.3, 1.0, 3)
        body = dict(zip("ABC", parts.sum() - parts, strict=True)) | {"Mg": 1.0}
        body |= dict(zip(("x0", "y0", "z0", "l1", "l2", "l3"), rng.normal(size=6), strict=True))
        all_ = system.equilibria(body | {"n": n})
        tilted = np.minimum(all_["theta0"], np.pi - all_["theta0"]) > 0.2
        growth = np.where(tilted, np.nan_to_num(all_["growth_rate"]), 0.0)
        i = growth.argmax()
        if growth[i] > 0.3:
            bodies.append(
                body | {"theta0": all_["theta0"][i], "phi0": all_["phi0"][i], "n": n, "growth": growth[i]}
            )
    columns = {name: np.array([body[name] for body in bodies]) for name in bodies[0]}
    return columns, columns.pop("growth")


def departures(system: Gyrostat) -> list[StressCase]:
    """Unstable positions of rest and permanent rotations with offsets of 1e-15 to 3e-11 rad."""
    result = []
    for name, n, seed in (("unstable rest", 0.0, 1), ("unstable rotation", 0.7, 2)):
        columns, growth = unstable_rotations(system, n, seed)
        offset, logarithm = np.geomspace(1e-15, 3e-11, growth.size), np.linspace(20.0, 25.0, growth.size)
        result.append(
            StressCase(f"{name}, offset", "offsets that grow by exp(20) to exp(25)", logarithm / growth, columns,
                       additions={"theta0": offset}, may_stay_unresolved=OFFSET, truth="departure")
        )  # fmt: skip
    return result


def cases(system: Gyrostat) -> tuple[StressCase, ...]:
    """The cases, see System.stress_cases."""
    heavy = {"Mg": 1.0, "z0": 0.5, "N": 0.1}
    tilted = {"theta0": 0.6, "m": 0.5, "n": 0.2} | heavy
    cone = {"theta0": 0.8, "n": 0.5, "C": 0.7} | heavy
    fast, up = 10.0 ** np.arange(0, 7), 10.0 ** np.arange(-2, -13, -2)
    spins, fields = 10.0 ** np.arange(-6, 5, 2), 10.0 ** np.arange(-8, 7, 2)
    tilts = np.array([1e-2, 1e-3, 1e-4, 3e-5, 1e-6, 1e-8, 1e-12, 0.0])
    flip = {"A": 1.0, "B": 2.0, "C": 1.5, "m": 1.0}
    middle = {"A": 1.0, "B": 1.5, "C": 2.0, "theta0": np.pi / 2, "n": 1.0}
    # conical motions are unstable where N (A - C) > A n^2 only, at small C r + l3
    steep = {"A": 1.0, "C": 0.4, "N": 3.0, "n": 0.5, "theta0": 1.0, "Mg": 1.0}
    paper = {"A": [22.49, 50.32], "B": [22.49, 50.32], "C": [35.6, 33.4]}
    return (
        StressCase("stiff rotor", "rotor frequency over the slow one", np.minimum(20, 2e3 / fast),
                   {"l3": fast, "theta_dot0": 0.1, **tilted}),
        StressCase("stiff spin", "fast spin with the rotor against it: the axis moves slowly",
                   np.minimum(20, 2e3 / fast),
                   {"l3": 0.6 - 1.2 * fast, **tilted, "m": fast}),
        StressCase("stiff steady", "the same on an exact regular precession", np.minimum(20, 2e3 / fast),
                   {"m": fast, **cone}, solve=("conical", "l3")),
        StressCase("spin", "exact regular precession, slow to fast spin", np.minimum(20, 2e3 / spins),
                   {"m": spins, **cone}, solve=("conical", "l3")),
        StressCase("r0 = 1000", "the paper's bodies and spin", 2.0,
                   {"Mg": 294.3, "z0": 5.0, "theta0": 0.5, "m": 1000.0, "l3": [0.0, 50.0], **paper}),
        StressCase("needle", "C towards 0", 20.0, {"C": 10.0 ** np.arange(-1, -7, -1), **tilted}),
        StressCase("flat body", "A + B = C", 20.0,
                   {"A": [1.0, 0.3, 1e-3], "B": [1.0, 0.7, 1.0], "C": [2.0, 1.0, 1.001], **tilted}),
        StressCase("needle across", "A towards 0", [20.0, 5.0, 1.0],
                   {"A": 10.0 ** np.arange(-2, -7, -2), "C": 1.0, **tilted}),
        StressCase("near 0", "tilts of a stable sleeping top", 20.0, {"theta0": tilts, "m": 1.5, **heavy}),
        StressCase("near pi", "the same upside down", 20.0, {"theta0": np.pi - tilts, "m": 3.5, **heavy}),
        StressCase("steep precession", "exact regular precession close to the vertical", 20.0,
                   {"m": 0.7, **cone, "theta0": [1e-1, 1e-2, 1e-3, 1e-4]}, solve=("conical", "l3")),
        StressCase("through the pole", "planar pendulum and fast tops through the vertical", 5.0,
                   {"theta0": 0.5, "theta_dot0": -3.0, "l3": [0.0, 0.2], **heavy}),
        StressCase("field", "weak to strong weight and gradient", np.minimum(20, 30 / np.sqrt(fields)),
                   {"Mg": fields, "N": 0.3 * fields, "x0": 0.2, "z0": 0.5, "theta0": 0.6, "m": 0.5}),
        StressCase("weak field", "a steady motion that an offset disturbs", 20.0,
                   {"m": 0.4, **cone},
                   solve=("conical", "l3"), additions={"x0": 10.0 ** np.arange(-12, -3, 2)}),
        StressCase("separatrix", "a pendulum beside its upper rest", 15.0, {"theta0": np.pi - up, **heavy}),
        StressCase("racket", "free body about its middle axis, pushed a little", 60.0,
                   {"theta_dot0": up, **flip}),
        StressCase("unstable, short", "exactly on an unstable motion", 12.0, {**middle, "n": [1.0, 0.3]}),
        StressCase("unstable cone, short", "exactly on an unstable regular precession", 8.0,
                   {**steep, "m": [0.3, 3.0]}, solve=("conical", "z0")),
        StressCase("unstable cone, middle", "the same, longer", 20.0,
                   {**steep, "m": [0.3, 3.0]}, solve=("conical", "z0"), may_stay_unresolved=GROWN),
        StressCase("unstable, long", "until rounding decides", 200.0, middle),
        StressCase("hidden growth", "fast spin on top of slow growth", 15.0,
                   {"m": 60.0, "l3": 0.4 * (0.3 - 60.0), **steep},
                   solve=("conical", "z0"), additions={"theta0": [1e-4, 1e-5, 1e-6]}),
        StressCase("slower than the run", "weak weight", 4.0,
                   {"Mg": 10.0 ** np.arange(-2, -9, -2), "z0": 1.0, "theta0": 0.6}),
        StressCase("long", "exactly steady, and drifting, for 10 000 turns", 4e4 * np.pi,
                   {"m": 0.4, **cone}, solve=("conical", "l3"), additions={"theta0": [0.0, 0.3]}),
        StressCase("at rest", "nothing turns at all", 20.0, {"theta0": [0.0, 0.5]}),
        StressCase("denormal", "parameters of 1e-300 and less", 20.0,
                   {"theta0": [1e-310, 0.5, 0.5], "l1": [1e-310, 0.0, 1e-320], "m": [0.5, 1e-300, 1e-310],
                    "Mg": 1e-310, "x0": 1e-310}),
        StressCase("overflow", "products of parameters overflow", 20.0,
                   {"theta0": 0.5, "l1": [1e200, 0.0, 0.0, 0.0], "theta_dot0": 0.1,
                    "m": [0.0, 1e300, 0.0, 0.0], "Mg": [0.0, 0.0, 1e300, 0.0], "x0": [0.0, 0.0, 1e300, 0.0],
                    "n": [0.0, 0.0, 0.0, 1e160]},
                   may_stay_unresolved=OVERFLOW),
        *departures(system), *passages(system),
    )  # fmt: skip
