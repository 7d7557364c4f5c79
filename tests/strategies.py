"""Bodies and starts for tests: defaults, random points, random points on a family of steady motions.

Every function takes the generator that it draws from, so that no test depends on earlier tests.
Points are dictionaries of arrays of one length, as the package takes them.
"""

from __future__ import annotations

from functools import partial
from itertools import combinations
from typing import NamedTuple

import numpy as np
import pytest
from hypothesis import strategies as st

from atlas.kernel.blocks import Threads
from atlas.kernel.specialization import Specialization
from atlas.label import pipeline
from atlas.label.any_axis import predict_any_axis
from atlas.label.plan import Plan
from atlas.label.theory import predict_runs
from atlas.scene.grid import Grid, at_points
from atlas.scene.model import Settings
from atlas.systems import SYSTEMS
from atlas.systems.base import TwoAxes
from atlas.systems.fixed_point.families import FAMILIES as FIXED_POINT_FAMILIES
from atlas.systems.satellite.families import FAMILIES as SATELLITE_FAMILIES
from atlas.theory.motions import find_motions

Points = dict[str, np.ndarray]
DRAG = ("drag1", "drag2", "drag3")

seeds = st.integers(0, 10**6)


def default_points(system: str, count: int | None = None, **given) -> Points:
    """Points of a system with every parameter at its default, except the given ones."""
    defaults = {name: parameter.default for name, parameter in SYSTEMS[system].parameters.items()}
    assert set(given) <= set(defaults)
    if count is None:
        count = max((np.size(value) for value in given.values()), default=1)
    values = defaults | given
    return {
        name: np.broadcast_to(np.asarray(value, float), (count,)).copy() for name, value in values.items()
    }


def in_units(points: Points, time: float, mass: float = 1.0) -> Points:
    """The points in units of time and mass that are smaller by these factors; powers of 4 keep the bits."""
    powers = dict.fromkeys(("Omega", "n", "m", "theta_dot0", "p0", "q0", "r0"), (-1, 0)) | {"N": (-2, 0)}
    powers |= dict.fromkeys("ABC", (0, 1)) | dict.fromkeys((*DRAG, "mu1", "mu2", "mu3", "Mg"), (-2, 1))
    powers |= dict.fromkeys(("k1", "k2", "k3", "l1", "l2", "l3", "damping"), (-1, 1))
    factors = {name: time**of_time * mass**of_mass for name, (of_time, of_mass) in powers.items()}
    return {name: values * factors.get(name, 1.0) for name, values in points.items()}


def in_other_units(points: Points) -> tuple[Points, float]:
    """The points in other units of time and mass, and the new unit of time."""
    return in_units(points, 0.25, 16.0), 0.25


def select(points: Points, index) -> Points:
    """The points at an index, list of indices or mask, as arrays of one dimension."""
    return {name: np.atleast_1d(values[index]) for name, values in points.items()}


def random_satellites(rng: np.random.Generator, count: int, **given) -> Points:
    """Random satellites, starts and fields without any symmetry and damping; theta0 away from 0 and pi."""
    others = ("damping", *DRAG)
    points = {name: rng.normal(size=count) for name in SYSTEMS["satellite"].parameters if name not in others}
    points |= dict(zip(DRAG, rng.spawn(1)[0].normal(size=(3, count)), strict=True))
    points |= {name: rng.uniform(0.8, 1.5, count) for name in ("A", "B", "C")}
    points |= {"Omega": rng.uniform(0.3, 1.5, count), "theta0": rng.uniform(0.3, 2.8, count)}
    return default_points("satellite", count, **points | given)


def random_fixed_points(rng: np.random.Generator, count: int, **given) -> Points:
    """Random bodies about a fixed point, starts and fields without any symmetry; theta0 away from 0 and pi.

    Each moment of inertia is the sum of two of three positive numbers, as for every body with mass.
    """
    parts = rng.uniform(0.3, 1.0, (3, count))
    points = dict(zip("ABC", parts.sum(0) - parts, strict=True))
    names = ("Mg", "x0", "y0", "z0", "N", "l1", "l2", "l3", "theta_dot0", "n", "m")
    points |= {name: rng.normal(size=count) for name in names}
    points |= {"theta0": rng.uniform(0.2, 2.9, count), "phi0": rng.uniform(0, 2 * np.pi, count)}
    return default_points("fixed_point", count, **points | given)


def random_points(system: str, rng: np.random.Generator, count: int, **given) -> Points:
    """Random points of any system: positive parameters about 1, damping and optional parameters at their defaults."""
    points = {}
    for name, parameter in SYSTEMS[system].parameters.items():
        if parameter.low == 0.0 and parameter.open_low:
            points[name] = rng.uniform(0.8, 1.5, count)
        elif parameter.low < 0.0 and not np.isnan(parameter.default):
            points[name] = rng.normal(size=count)
    if "theta0" in points:
        points["theta0"] = rng.uniform(0.3, 2.8, count)
    return default_points(system, count, **points | given)


class BySystem(dict):
    """Values for tests by the name of a system; a test of a system without a value is skipped."""

    def __missing__(self, system: str):
        pytest.skip(f"nothing is given here of the system {system}")


class RandomPoints(dict):
    """Name of a system -> function (rng, count, given) of random points."""

    def __missing__(self, system: str):
        return partial(random_points, system)


RANDOM = RandomPoints(satellite=random_satellites, fixed_point=random_fixed_points)


def symmetric_fixed_points(rng: np.random.Generator, count: int, **given) -> Points:
    """Random bodies with A = B = 1, rotor and centre of mass on the third axis, and theta_dot0 = 0."""
    axial = {"A": 1.0, "B": 1.0, "C": rng.uniform(0.3, 1.9, count)}
    axial |= dict.fromkeys(("x0", "y0", "l1", "l2", "theta_dot0"), 0.0)
    return random_fixed_points(rng, count, **axial | given)


def fixed_points_on_family(family: str, points: Points, *names: str) -> Points:
    """The points with the named parameters from the family's formulas, without points at which these have no solution."""
    points = dict(points)
    for name in names:
        points[name] = FIXED_POINT_FAMILIES[family].solve[name](points)
    exists = np.all([~np.isnan(points[name]) for name in names], axis=0)
    assert exists.any()
    return select(points, exists)


def nonzero_satellite(rng: np.random.Generator, **given) -> Points:
    """A random satellite without drag whose parameters are of order 1 and not near 0; theta_dot0 = 0, arrays of shape (1,)."""
    names = [name for name in SYSTEMS["satellite"].parameters if name not in ("damping", *DRAG)]
    point = {name: rng.uniform(0.3, 1.3, 1) * rng.choice([-1.0, 1.0], 1) for name in names}
    point |= {name: rng.uniform(0.7, 1.3, 1) for name in ("A", "B", "C", "Omega")}
    point |= {"theta0": rng.uniform(-4, 4, 1), "theta_dot0": np.zeros(1)}
    return default_points("satellite", 1, **point | given)


def satellite_for_family(name: str, rng: np.random.Generator) -> Points:
    """A random satellite that meets the conditions that the family's formulas do not solve."""
    point = nonzero_satellite(rng)
    zero = np.zeros(1)
    axial = ("perp_radius", "perp_velocity", "oblique")
    if name in ("cylindrical", "transverse_magnet", "despun_transverse", *axial):
        point |= {"B": point["A"], "n": zero}
    if name in axial:
        point |= dict.fromkeys(("k1", "k2", "mu1", "mu2"), zero)
    if name in ("perp_radius", "cylindrical"):
        point["h1"] = zero
    if name == "cylindrical":
        point["n"] = rng.normal(size=1)
    if name in ("equilibrium", "asymmetric_tilt"):
        point["n"] = zero
    if name == "oblique":
        point["h1"] = point["h1"] * 0.1
    dragged = {"equilibrium": DRAG, "perp_radius": DRAG[2:], "oblique": DRAG[2:]}.get(name, ())
    tilted = np.abs(np.sin(point["theta0"])) > 0.1  # nearer to the normal axial drag needs a large rotor
    point |= {each: 0.2 * tilted * rng.spawn(1)[0].normal(size=1) for each in dragged}
    if name == "spherical":
        point |= {"B": point["A"], "C": point["A"]} | dict.fromkeys(("k1", "k2", "mu1", "mu2", "h1"), zero)
    if name == "other_axis":
        point |= {"m": zero, "h1": zero}
        axis = rng.integers(3)
        upright = np.full(1, np.pi / 2)
        if axis == 0:
            point |= {"C": point["A"], "theta0": upright, "phi0": np.full(1, np.pi * rng.integers(2))}
        elif axis == 1:
            point |= {"C": point["B"], "theta0": upright, "phi0": -upright}
        else:
            point |= {"B": point["A"], "C": point["A"]}
    return point


# Parameters that the formulas of each family solve, in this order, to put a point on the family.
SATELLITE_SOLVED = {
    "cylindrical": ("theta0", "k1", "k2"),
    "equilibrium": ("m", "h1", "k1", "k2"),
    "perp_radius": ("psi0", "k3"),
    "perp_velocity": ("psi0", "k3"),
    "oblique": ("psi0", "k3"),
    "transverse_magnet": ("psi0", "h3", "k1", "k2", "k3"),
    "despun_transverse": ("m", "h3", "mu3", "k1", "k2", "k3"),
    "asymmetric_tilt": ("theta0", "psi0", "m", "h1", "k1", "k2", "k3"),
    "spherical": ("k3",),
    "other_axis": ("k3", "k1", "k2"),
}


def satellite_on_family(name: str, rng: np.random.Generator, slower: float = 1.0) -> Points | None:
    """A random satellite on the family, or None where the drawn parameters admit none; n and m times `slower`."""
    point = satellite_for_family(name, rng)
    point |= {rate: point[rate] * slower for rate in ("n", "m")}
    for parameter in SATELLITE_SOLVED[name]:
        value = SATELLITE_FAMILIES[name].solve[parameter](point)
        if name == "other_axis" and np.isnan(value[0]):  # the component along the axis is free
            continue
        if np.isnan(value[0]) or abs(value[0]) > 50:
            return None
        point[parameter] = value
    return point


def tile_of(system, base, points, duration, settings):
    """Points that start at `points`, and would start at `base` without a nudge."""
    rate_tolerance = at_points(system, settings.rate_tolerance, base)
    return Grid(base, points, np.zeros(len(duration), np.int8), duration, rate_tolerance)


def evaluate(system, base, points, duration, settings, *, halved=False, threads=None, **plan):
    """The variables of `tile_of` these arguments; plan: further fields of a Plan."""
    tile = tile_of(system, base, points, duration, settings)
    return pipeline.evaluate(Plan(system, settings, **plan), tile, halved=halved, threads=Threads(threads))


class SteadyMotion(NamedTuple):
    """The steady motion of each start, and whether the start is on it."""

    axes: TwoAxes
    answer: np.ndarray  # values of Existence


def steady_motions(system, points, duration, rate_tolerance, angle_tolerance, in_machine_code=False):
    """The steady motions of starts without a nudge."""
    settings = duration, rate_tolerance, angle_tolerance, in_machine_code
    axes, found = find_motions(system, points, None, *settings)
    return SteadyMotion(axes, found.answer)


def predictions(system, base, points=None, duration=50.0, tolerances=(1e-5, 1e-5)):
    """The Prediction of theory for starts, nudged to `points` unless None, and the prediction about any axes."""
    settings = Settings(rate_tolerance=tolerances[0], cylinder_tolerance=tolerances[1])
    plan = Plan(system, settings, nudged=points is not None)
    durations = np.broadcast_to(duration, base["A"].shape)
    tile = tile_of(system, base, base if points is None else points, durations, settings)
    prediction = predict_runs(plan, tile)
    return prediction, predict_any_axis(plan, tile, prediction)


def specialization_of(system, points):
    """Terms that vanish, or are equal, at every one of these points."""
    zero = {name for name, values in points.items() if ((values == 0) | np.isnan(values)).all()}
    equal = {(a, b) for a, b in combinations(points, 2) if np.all(points[a] == points[b])}
    return Specialization.of(system, zero, equal)
