"""Stiff and extreme points of satellites and of gyrostats about a fixed point. Satellites have Omega = 1 unless a case states Omega."""

from __future__ import annotations

from collections.abc import Mapping
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from ...systems.base import Array, StressCase, System, subset
from ...systems.gyrostat import Gyrostat

OVERFLOW = "the numbers overflow"
GROWN = "the method's own error grows with the motion before rounding does"
OFFSET = "the start is as near an unstable motion as rounding resolves"
FAST, UP = 10.0 ** np.arange(0, 7), 10.0 ** np.arange(-2, -13, -2)
SPINS, FIELDS = 10.0 ** np.arange(-6, 5, 2), 10.0 ** np.arange(-8, 7, 2)
TILTS = np.array([1e-2, 1e-3, 1e-4, 3e-5, 1e-6, 1e-8, 1e-12, 0.0])
WEAK, WEAKER = 10.0 ** np.arange(-12, -3, 2), 10.0 ** np.arange(-2, -9, -2)
# Offsets in rad that are added to exact starts of slowly unstable motions (HIDDEN) and of stable motions (BESIDE).
HIDDEN, BESIDE = {"theta0": [1e-4, 1e-5, 1e-6]}, {"theta0": [0.0, 0.3]}
# Offsets from unstable motions in rad, and natural logarithms of the factors by which the offsets grow.
OFFSETS, LOGARITHMS = np.geomspace(1e-15, 3e-11, 10), np.linspace(20.0, 25.0, 10)
# Least angles between axis and vertical during a passage, in rad, and the angular speed of the axis at the least angle.
SINES, SPEED = np.array([1e-4, 1e-3, 1e-2, 1e-1]), 0.3
# Name -> kind of exact motion and parameters, for bodies whose axis passes the vertical. The satellites in the first table are spheres,
# on which gravity exerts no torque, or do not orbit (Omega = 0). The bodies in the second table turn about a fixed point.
_TOPS_ON_ORBIT: Mapping[str, tuple[str, Mapping[str, float]]] = {
    "sphere": ("symmetric top", {"C": 1.0, "k3": 0.4}),
    "magnetic sphere": ("symmetric top", {"C": 1.0, "k3": 0.4, "mu3": 1.0, "h3": -0.6}),
    "magnetic top": ("symmetric top", {"C": 0.7, "Omega": 0.0, "k3": 0.4, "mu3": 1.0, "h3": -0.6}),
}
_TOPS_IN_SPACE: Mapping[str, tuple[str, Mapping[str, float]]] = {
    "free sphere": ("symmetric top", {"C": 1.0}),
    "free top": ("symmetric top", {"C": 1.6, "l3": -0.5}),
    "heavy top": ("symmetric top", {"C": 0.7, "l3": 0.4, "Mg": 1.0, "z0": 0.8}),
    "heavy top, upside down": ("symmetric top", {"C": 0.7, "l3": 0.4, "Mg": 1.0, "z0": -0.8}),
    "free body": ("free gyrostat", {"B": 1.3, "C": 1.7}),
    "free gyrostat": ("free gyrostat", {"B": 1.3, "C": 1.7, "l1": 0.6}),
}


# Description and duration of cases that satellites and bodies about a fixed point have in common, by name.
_SHARED: Mapping[str, tuple[str, ArrayLike]] = {
    "stiff rotor": ("rotor frequency over the slow one", np.minimum(20, 2e3 / FAST)),
    "stiff spin": ("fast spin with the rotor against it: the axis moves slowly", np.minimum(20, 2e3 / FAST)),
    "stiff steady": ("the same on an exact steady motion", np.minimum(20, 2e3 / FAST)),
    "spin": ("exact regular precession, slow to fast spin", np.minimum(20, 2e3 / SPINS)),
    "needle": ("C towards 0", 20.0),
    "flat body": ("A + B = C", 20.0),
    "needle across": ("A towards 0", [20.0, 5.0, 1.0]),
    "near 0": ("tilts of a stable upright motion", 20.0),
    "near pi": ("the same upside down", 20.0),
    "steep precession": ("exact regular precession close to the vertical", 20.0),
    "through the pole": ("large swings through the vertical", 5.0),
    "field": ("weak to strong fields", np.minimum(20, 30 / np.sqrt(FIELDS))),
    "weak field": ("a steady motion that a field or an offset disturbs", 20.0),
    "racket": ("free body about its middle axis, pushed a little", 60.0),
    "slower than the run": ("weak torques", 4.0),
    "at rest": ("nothing turns at all", 20.0),
    "denormal": ("parameters of 1e-300 and less", 20.0),
    "overflow": ("products of parameters overflow", 20.0),
}


def _shared(name: str, /, **row: Any) -> StressCase:
    """Return the case `name` of _SHARED. `row` contains parameters of one system, and attributes of StressCase."""
    attributes = {key: row.pop(key) for key in ("solve", "additions", "may_stay_unresolved") if key in row}
    return StressCase(name, *_SHARED[name], row, **attributes)


def _passages(
    system: Gyrostat,
    vertical: str,
    bodies: Mapping[str, tuple[str, Mapping[str, float]]],
    parts: Mapping[str, tuple[ArrayLike, ArrayLike]],
) -> list[StressCase]:
    """Return exact motions that start, end or pass beside the vertical.

    `parts` maps "starts", "ends" or "passes" to the times from start to passage, and to the durations of the runs.
    """
    result = []
    for body, (truth, columns) in bodies.items():
        for part, times in parts.items():
            sine, before, duration = (
                values.ravel() for values in np.broadcast_arrays(SINES[:, None], *map(np.asarray, times))
            )
            nearest: dict[str, ArrayLike] = {**columns, "theta0": sine, "phi0": 0.3, "n": SPEED / sine}
            nearest["m"] = 0.5 - SPEED / sine * np.cos(sine)
            start = _earlier_start(system, nearest, before)
            result.append(
                StressCase(f"{body} {part}", f"it {part} beside the {vertical}", duration, start, truth=truth)
            )
    return result


def _earlier_start(system: System, columns: dict[str, ArrayLike], before: Array) -> dict[str, ArrayLike]:
    """Return columns of the same motions that start earlier by the time `before`, or later if `before` is negative.

    `columns` maps names to parameters and start values. Other names have the defaults of the system. psi0 has no effect on the motion.
    The returned columns have other theta0, phi0, theta_dot0, n and m.
    """
    from scipy.integrate import solve_ivp

    points = {
        name: np.broadcast_to(np.asarray(columns.get(name, parameter.default), float), before.shape)
        for name, parameter in system.parameters.items()
    }
    constants, start = tuple(system.constants(points)), system.initial_state(points)

    def slope(_: float, flat: Array) -> Array:
        return (-before * np.array(system.equations.rhs(flat.reshape(start.shape), constants))).ravel()

    run = solve_ivp(slope, (0.0, 1.0), start.ravel(), "DOP853", rtol=1e-13, atol=1e-15)
    state = run.y[:, -1].reshape(start.shape)
    u1, u2, u3, g1, g2, g3 = system.equations.frame_motion(state, constants)
    sine = np.hypot(g1, g2)
    n = (u1 * g1 + u2 * g2) / sine**2
    return columns | {
        "theta0": np.arctan2(sine, g3),
        "phi0": np.arctan2(g1, g2),
        "theta_dot0": (u1 * g2 - u2 * g1) / sine,
        "n": n,
        "m": u3 - n * g3,
    }


def _departure(name: str, description: str, columns: Mapping[str, Array], growth: Array) -> StressCase:
    """Return unstable motions with offsets of 1e-15 to 3e-11 rad. During the runs the offsets grow by factors of exp(20) to exp(25)."""
    return StressCase(name, description, LOGARITHMS / growth, columns,
                      additions={"theta0": OFFSETS}, may_stay_unresolved=OFFSET, truth="departure")  # fmt: skip


def _extreme_bodies(tilted: Mapping[str, ArrayLike]) -> list[StressCase]:
    """Return cases of long, flat and thin bodies."""
    return [
        _shared("needle", C=10.0 ** np.arange(-1, -7, -1), **tilted),
        _shared("flat body", A=[1.0, 0.3, 1e-3], B=[1.0, 0.7, 1.0], C=[2.0, 1.0, 1.001], **tilted),
        _shared("needle across", A=10.0 ** np.arange(-2, -7, -2), C=1.0, **tilted),
    ]


def _unstable_satellites(system: Gyrostat) -> tuple[dict[str, Array], Array]:
    """Return unstable equilibria of random satellites with rotor and magnet, and the growth rates."""
    rng = np.random.default_rng(1)
    size = 8 * OFFSETS.size
    points = {name: np.full(size, parameter.default) for name, parameter in system.parameters.items()}
    points |= {name: rng.normal(size=size) for name in ("k3", "mu1", "mu2", "mu3", "h3")}
    points |= {name: rng.uniform(0.8, 1.5, size) for name in "ABC"}
    points["theta0"] = rng.uniform(0.4, 2.7, size)
    points |= {name: rng.uniform(0, 6, size) for name in ("psi0", "phi0")}
    family = system.families["equilibrium"]
    for name in ("h1", "k1", "k2"):
        points[name] = family.solve[name](points)
    growth = system.linear_stability(points, np.full(size, family.flag, np.int8))[1]
    chosen = np.flatnonzero((growth > 0.3) & (np.abs(points["h1"]) < 5))[: OFFSETS.size]
    return subset(points, chosen), growth[chosen]


@cache  # The search for unstable equilibria takes a second.
def satellite_cases(system: Gyrostat) -> tuple[StressCase, ...]:
    """Return cases of satellites, see System.stress_cases. Motions in the plane of the orbit are in the module `plane_cases`."""
    steady, spherical = ("perp_velocity", "k3"), ("spherical", "k3")
    tilted = {"theta0": 0.6, "psi0": 0.3, "m": 0.5}
    hyperbola = {"theta0": 0.8, "psi0": np.pi / 2, "C": 0.7}  # a stable perp_velocity motion
    unstable: dict[str, ArrayLike] = {"theta0": 1.0, "psi0": np.pi / 2, "C": 1.2, "m": 0.3}
    spun = unstable | {"m": [0.3, 3.0, 30.0]}
    sphere = {"C": 1.0, "n": 0.5}
    flip = {"A": 1.0, "B": 2.0, "C": 1.5, "Omega": 0.0, "m": 1.0}
    m, duration = (values.ravel() for values in np.meshgrid([0.05, 0.02, 0.005], [30.0, 100.0]))
    s, c = np.sin(1.2), np.cos(1.2)
    h1 = m * s / (1 + m * c)
    slow = {"theta0": 1.2, "psi0": np.pi / 2, "C": 1.2, "m": m, "mu1": 1.0, "h3": 1.0, "h1": h1}
    slow |= {"k1": (s - h1 * c) / s, "k3": 4 * (1 - 1.2) * c - 1.2 * m}
    return (
        _shared("stiff rotor", k3=FAST, theta_dot0=0.1, **tilted),
        _shared("stiff spin", k3=0.3 - 1.2 * FAST, theta0=0.6, psi0=0.3, m=FAST),
        _shared("stiff steady", m=FAST, **hyperbola, solve=steady),
        _shared("spin", **sphere, theta0=1.0, m=SPINS, solve=spherical),
        *_extreme_bodies(tilted),
        _shared("near 0", theta0=TILTS, C=1.3, m=1.5),
        _shared("near pi", theta0=np.pi - TILTS, C=1.3, m=-3.5),
        _shared("steep precession", **sphere, m=0.7, theta0=[1e-1, 1e-2, 1e-3, 1e-4], solve=spherical),
        _shared("through the pole", Omega=[0.0, 1.0, 1.0], theta0=0.5, theta_dot0=-3.0, k3=[0.0, 0.0, 0.2]),
        _shared("field", mu3=1.0, mu1=0.2, h1=FIELDS, h3=0.3 * FIELDS, **tilted),
        _shared("weak field", mu1=1.0, m=0.4, **hyperbola, solve=steady, additions={"h1": WEAK}),
        StressCase("separatrix", "beside an unstable motion", 30.0, unstable, steady, {"theta0": UP}),
        _shared("racket", theta_dot0=UP, **flip),
        StressCase("unstable, short", "exactly on an unstable motion", 20.0, spun, steady),
        StressCase("unstable, middle", "the same, longer", 50.0, spun, steady, may_stay_unresolved=GROWN),
        StressCase("unstable, long", "the same, until rounding decides", 500.0, unstable, steady),
        StressCase("hidden growth", "fast spin on top of slow growth", 40.0,
                   unstable | {"m": 60.0}, steady, HIDDEN),
        _shared("slower than the run", **tilted | {"m": -1.0}, C=1.0 + WEAKER),
        StressCase("10 000 orbits", "exactly steady, and drifting", 2e4 * np.pi,
                   {"m": 0.4, **hyperbola}, steady, BESIDE),
        StressCase("Omega = 0", "free and heavy bodies that orbit nothing", 20.0,
                   {"Omega": 0.0, "theta0": [0.0, 0.7, 0.7], "m": 0.5, "n": [0.0, 0.0, 0.4],
                    "h3": [0.0, 0.0, 1.0], "mu3": 1.0}),
        _shared("at rest", Omega=0.0, theta0=[0.0, 0.5]),
        _shared("denormal", theta0=[1e-310, 0.5, 0.5], k1=[1e-310, 0.0, 1e-320], m=[0.5, 1e-300, 1e-310],
                h1=1e-310, mu2=1e-310),
        _shared("overflow", theta0=0.5, k1=[1e200, 0.0, 0.0, 0.0], m=[0.0, 1e300, 0.0, 0.0],
                mu1=[0.0, 0.0, 1e300, 0.0], h1=[0.0, 0.0, 1e300, 0.0], n=[0.0, 0.0, 0.0, 1e160],
                may_stay_unresolved=OVERFLOW),
        # The motions from the starts `slow` are exactly steady. The linear equations have the period 2 pi / m, longer than the run.
        StressCase("slow spin, unstable", "magnet across the axis, so that the linear equations are periodic",
                   duration, slow, may_stay_unresolved=GROWN),
        _departure("unstable rest, offset", "equilibria with rotor and magnet", *_unstable_satellites(system)),
        *_passages(system, "normal", _TOPS_ON_ORBIT, {"starts": ([0.01], [2.0]), "ends": ([2.0], [1.95]), "passes": ([1.5], [3.0])}),
    )  # fmt: skip


def _unstable_rotations(system: Gyrostat, n: float, seed: int) -> tuple[dict[str, Array], Array]:
    """Return unstable permanent rotations of random bodies at the rate n, and the growth rates."""
    rng, bodies = np.random.default_rng(seed), list[dict[str, float]]()
    while len(bodies) < OFFSETS.size:
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


@cache  # The search for unstable equilibria takes a second.
def fixed_point_cases(system: Gyrostat) -> tuple[StressCase, ...]:
    """Return cases of bodies about a fixed point, see System.stress_cases."""
    conical, unstable = ("conical", "l3"), ("conical", "z0")
    heavy = {"Mg": 1.0, "z0": 0.5, "N": 0.1}
    tilted = {"theta0": 0.6, "m": 0.5, "n": 0.2} | heavy
    cone = {"theta0": 0.8, "n": 0.5, "C": 0.7} | heavy
    flip = {"A": 1.0, "B": 2.0, "C": 1.5, "m": 1.0}
    middle = {"A": 1.0, "B": 1.5, "C": 2.0, "theta0": np.pi / 2, "n": 1.0}
    # Conical motions are unstable only where N (A - C) > A n^2 and the axial momentum C r + l3 is small.
    steep = {"A": 1.0, "C": 0.4, "N": 3.0, "n": 0.5, "theta0": 1.0, "Mg": 1.0}
    spun: dict[str, ArrayLike] = {**steep, "m": [0.3, 3.0]}
    paper = {"A": [22.49, 50.32], "B": [22.49, 50.32], "C": [35.6, 33.4]}
    return (
        _shared("stiff rotor", l3=FAST, theta_dot0=0.1, **tilted),
        _shared("stiff spin", l3=0.6 - 1.2 * FAST, **tilted | {"m": FAST}),
        _shared("stiff steady", m=FAST, **cone, solve=conical),
        _shared("spin", m=SPINS, **cone, solve=conical),
        StressCase("r0 = 1000", "the paper's bodies and spin", 2.0,
                   {"Mg": 294.3, "z0": 5.0, "theta0": 0.5, "m": 1000.0, "l3": [0.0, 50.0], **paper}),
        *_extreme_bodies(tilted),
        _shared("near 0", theta0=TILTS, m=1.5, **heavy),
        _shared("near pi", theta0=np.pi - TILTS, m=3.5, **heavy),
        _shared("steep precession", m=0.7, **cone | {"theta0": [1e-1, 1e-2, 1e-3, 1e-4]}, solve=conical),
        _shared("through the pole", theta0=0.5, theta_dot0=-3.0, l3=[0.0, 0.2], **heavy),
        _shared("field", Mg=FIELDS, N=0.3 * FIELDS, x0=0.2, z0=0.5, theta0=0.6, m=0.5),
        _shared("weak field", m=0.4, **cone, solve=conical, additions={"x0": WEAK}),
        StressCase("separatrix", "a pendulum beside its upper rest", 15.0, {"theta0": np.pi - UP, **heavy}),
        _shared("racket", theta_dot0=UP, **flip),
        StressCase("unstable, short", "exactly on an unstable motion", 12.0, {**middle, "n": [1.0, 0.3]}),
        StressCase("unstable cone, short", "exactly on an unstable regular precession", 8.0, spun, unstable),
        StressCase("unstable cone, middle", "the same, longer", 20.0, spun, unstable, may_stay_unresolved=GROWN),
        StressCase("unstable, long", "until rounding decides", 200.0, middle),
        StressCase("hidden growth", "fast spin on top of slow growth", 15.0,
                   {"m": 60.0, "l3": 0.4 * (0.3 - 60.0), **steep}, unstable, HIDDEN),
        _shared("slower than the run", Mg=WEAKER, z0=1.0, theta0=0.6),
        StressCase("long", "exactly steady, and drifting, for 10 000 turns", 4e4 * np.pi,
                   {"m": 0.4, **cone}, conical, BESIDE),
        _shared("at rest", theta0=[0.0, 0.5]),
        _shared("denormal", theta0=[1e-310, 0.5, 0.5], l1=[1e-310, 0.0, 1e-320], m=[0.5, 1e-300, 1e-310],
                Mg=1e-310, x0=1e-310),
        _shared("overflow", theta0=0.5, l1=[1e200, 0.0, 0.0, 0.0], theta_dot0=0.1, m=[0.0, 1e300, 0.0, 0.0],
                Mg=[0.0, 0.0, 1e300, 0.0], x0=[0.0, 0.0, 1e300, 0.0], n=[0.0, 0.0, 0.0, 1e160],
                may_stay_unresolved=OVERFLOW),
        _departure("unstable rest, offset", "offsets that grow by exp(20) to exp(25)",
                   *_unstable_rotations(system, 0.0, 1)),
        _departure("unstable rotation, offset", "offsets that grow by exp(20) to exp(25)",
                   *_unstable_rotations(system, 0.7, 2)),
        *_passages(
            system, "vertical", _TOPS_IN_SPACE,
            {"starts": ([0.0, 0.01], [2.0, 2.0]), "ends": ([2.0, 2.0], [2.0, 1.95]), "passes": ([1.5], [3.0])},
        ),
    )  # fmt: skip
