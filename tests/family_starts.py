"""Random starts on every family of steady motions of both systems, by the families' own formulas."""

from __future__ import annotations

import numpy as np
from strategies import (
    default_points,
    fixed_points_on_family,
    random_fixed_points,
    satellite_on_family,
    select,
    symmetric_fixed_points,
)

from atlas.systems.fixed_point import any_axis, families, initial
from atlas.systems.satellite import SATELLITE
from atlas.systems.satellite import families as satellite_families
from atlas.systems.satellite.initial import PARAMETERS

FAMILIES = any_axis.FAMILIES
VECTORS = ("p0", "q0", "r0", "gamma10", "gamma20", "gamma30")
ROTORS = ("l1", "l2", "l3")


def stack(points):
    return {name: np.concatenate([point[name] for point in points]) for name in PARAMETERS}


def rotation_rate(point):
    """Rate of the steady rotation relative to the orbital frame."""
    tilt, n, m = point["theta0"], point["n"], point["m"]
    return np.hypot(n * np.sin(tilt), n * np.cos(tilt) + m)


def points_of_family(name, count, seed=0, min_rate=0.15, slower=1.0):
    """The points whose first family is the named one and whose rotation rate is at least a given rate."""
    rng, points = np.random.default_rng(seed), []
    while len(points) < count:
        point = satellite_on_family(name, rng, slower)
        if point is None or SATELLITE.identify_family(point)[0][0] != SATELLITE.families[name].flag:
            continue
        if rotation_rate(point)[0] > min_rate or name == "equilibrium":
            points.append(point)
    return stack(points)


def satellite_start(points, w, alpha, gamma):
    """Points with these vectors at the start, (3, points) each in body axes, as Euler angles and rates."""
    sine = np.hypot(gamma[0], gamma[1])
    beta = np.cross(gamma, alpha, axis=0)
    theta, phi, psi = (
        np.arctan2(sine, gamma[2]),
        np.arctan2(gamma[0], gamma[1]),
        np.arctan2(alpha[2], -beta[2]),
    )
    u = w - points["Omega"] * gamma
    n = (u[0] * gamma[0] + u[1] * gamma[1]) / sine**2
    theta_dot = u[0] * np.cos(phi) - u[1] * np.sin(phi)
    angles = {"theta0": theta, "phi0": phi, "psi0": psi, "n": n, "m": u[2] - n * gamma[2]}
    return points | angles | {"theta_dot0": theta_dot}


def spheres(rng, count):
    """Rotor and magnet along one random axis of each body, or neither."""
    axis, alpha = rng.normal(size=(2, 3, count))
    axis /= np.sqrt((axis**2).sum(0))
    gamma = np.cross(alpha, rng.normal(size=(3, count)), axis=0)
    alpha, gamma = (v / np.sqrt((v**2).sum(0)) for v in (alpha, gamma))
    loaded = np.arange(count) % 3 > 0
    rotor, moment = rng.normal(size=(2, count)) * loaded
    C, h3 = rng.uniform(0.5, 2, count), rng.normal(size=count)
    rate = np.where(loaded, rng.normal(size=count), 0.0)
    spin = np.where(loaded, (h3 * moment / np.where(loaded, rate, 1.0) - rotor) / C, rng.normal(size=count))
    vectors = {f"k{i + 1}": rotor * axis[i] for i in range(3)} | {
        f"mu{i + 1}": moment * axis[i] for i in range(3)
    }
    points = default_points(
        "satellite", count, A=C, B=C, C=C, h3=h3, Omega=rng.uniform(0.3, 1.5, count), **vectors
    )
    return satellite_start(points, rate * gamma + spin * axis, alpha, gamma)


def exact_starts(seed=0, size=12):
    """Points on each family about the third axis, by the family's name and, after a comma, the case."""
    rng = np.random.default_rng(seed)
    general = random_fixed_points(rng, size, theta_dot0=0.0, m=0.0)
    resting = random_fixed_points(rng, size, theta_dot0=0.0, m=0.0, n=0.0)
    free = random_fixed_points(rng, size, theta_dot0=0.0, n=0.0, N=0.0, Mg=0.0, l1=0.0, l2=0.0)
    upright = random_fixed_points(rng, size, theta_dot0=0.0, n=0.0, theta0=rng.choice([0.0, np.pi], size))
    return {
        "conical": fixed_points_on_family("conical", symmetric_fixed_points(rng, size), "m"),
        "conical, slow": fixed_points_on_family("conical", symmetric_fixed_points(rng, 4 * size, n=0.0), "n"),
        "conical, fast": fixed_points_on_family(
            "conical", symmetric_fixed_points(rng, 4 * size, n=50.0), "n"
        ),
        "conical, n = 0": fixed_points_on_family(
            "rest", symmetric_fixed_points(rng, size, n=0.0, N=3.0, Mg=0.3), "theta0"
        ),
        "sleeping": fixed_points_on_family("sleeping", upright, "l1", "y0"),
        "staude": fixed_points_on_family("staude", general, "theta0", "phi0"),
        "staude, rotor": fixed_points_on_family("staude", general, "l1", "l2"),
        "rest": fixed_points_on_family("rest", resting, "theta0", "phi0"),
        "rest, free": free,
    }


def random_moments(rng, count):
    parts = rng.uniform(0.02, 1.0, (3, count)) ** 2
    return dict(zip("ABC", parts.sum(0) - parts, strict=True))


def grioli_points(rng, count, rotor=1.0, **given):
    """Random bodies on Grioli's family: centre of mass and rotor on one of the two normals, with either sign."""
    points = default_points("fixed_point", count, **{**random_moments(rng, count), "Mg": 1.0, **given})
    normal = any_axis.section_normals(np.array([points[name] for name in "ABC"]))
    normal *= rng.choice([-1.0, 1.0], (3, count))
    along = rng.normal(size=count) * rotor
    points |= dict(zip(("x0", "y0", "z0"), normal * rng.uniform(0.3, 1.5, count), strict=True))
    points |= dict(zip(("l1", "l2", "l3"), normal * along, strict=True))
    return fixed_start(points, {name: FAMILIES["grioli"].solve[name](points) for name in VECTORS})


def fixed_start(points, start):
    """The points of bodies that have a start by this formula, with the start."""
    points = points | start
    return select(points, np.isfinite(points["p0"]))


def balanced_points(rng, count):
    """Random bodies on the family in which field and centrifugal torque cancel."""
    points = default_points("fixed_point", count, **random_moments(rng, count), N=rng.uniform(0.3, 2, count))
    s = any_axis.section_normals(np.array([points[name] for name in "ABC"])) * rng.choice(
        [-1.0, 1.0], (3, count)
    )
    gamma = rng.normal(size=(3, count))
    gamma /= np.sqrt((gamma**2).sum(0))
    n = np.sqrt(points["N"]) * rng.choice([-1.0, 1.0], count)
    rates = n * gamma + rng.uniform(0.3, 2, count) * s
    points |= dict(zip(VECTORS, (*rates, *gamma), strict=True))
    points["Mg"] = np.ones(count)
    points = with_rotor(FAMILIES["balanced_field"], points, s, rng)
    return points | {name: FAMILIES["balanced_field"].solve[name](points) for name in ("x0", "y0", "z0")}


def with_rotor(family, points, axis, rng):
    """Points with a random rotor along the largest component of an axis, the others by the family's formulas."""
    given = np.abs(axis).argmax(0)
    points = points | {
        name: np.where(given == i, rng.normal(size=given.size), 0.0) for i, name in enumerate(ROTORS)
    }
    solved = {name: family.solve[name](points) for name in ROTORS}
    return points | {name: np.where(given == i, points[name], solved[name]) for i, name in enumerate(ROTORS)}


def free_precessions(rng, count):
    """Symmetric bodies about one of the three axes with a rotor along it, and spherical ones with any rotor."""
    points = random_fixed_points(rng, count, Mg=0.0, N=0.0)
    for i in range(count):
        if i % 4 == 3:
            points["B"][i] = points["C"][i] = points["A"][i]
            continue
        names = "ABC"[i % 4 :] + "ABC"[: i % 4]
        points[names[2]][i] = points[names[1]][i]
        if points[names[0]][i] > 2 * points[names[1]][i]:
            points[names[0]][i] = points[names[1]][i]
        for j in (1, 2):
            points[f"l{(i % 4 + j) % 3 + 1}"][i] = 0.0
    return points


def free_rotations(rng, count):
    points = random_fixed_points(rng, count, Mg=0.0, N=0.0)
    return with_rotor(FAMILIES["free_rotation"], points, initial.initial_state(points)[:3], rng)


def other_axes(rng, count):
    """Lagrange's case about the first or second axis, by a relabelling of the axes of points of the family conical."""
    points = random_fixed_points(rng, count, theta_dot0=0.0, l1=0.0, l2=0.0, x0=0.0, y0=0.0)
    points["B"] = points["A"]
    points["C"] = np.minimum(points["C"], 2 * points["A"])
    points["m"] = families.FAMILIES["conical"].solve["m"](points)
    state = initial.initial_state(points)
    turn = rng.integers(1, 3, count)

    def turned(vector):
        return np.take_along_axis(np.array(vector), (np.arange(3)[:, None] + turn) % 3, 0)

    moved = {}
    for names in ("ABC", ("l1", "l2", "l3"), ("x0", "y0", "z0")):
        moved |= dict(zip(names, turned([points[name] for name in names]), strict=True))
    moved |= dict(zip(VECTORS, (*turned(state[:3]), *turned(state[3:])), strict=True))
    moved |= {name: points[name] for name in ("Mg", "N")}
    return default_points("fixed_point", count, **moved)


def satellites_on_family(name):
    """A function that draws satellites on a family, which may be on an earlier family as well."""

    def draw(rng, count):
        drawn = (satellite_on_family(name, rng) for _ in iter(int, 1))
        points = (point for point in drawn if point is not None)
        return stack([next(points) for _ in range(count)])

    return draw


def third_axis(kind):
    """A function that draws starts of one of the cases of `exact_starts`."""
    return lambda rng, count: exact_starts(rng, count)[kind]


# Starts of every family, by system and the family's name; after a comma, the case.
STARTS = {
    "satellite": {name: satellites_on_family(name) for name in satellite_families.FAMILIES}
    | {"spherical_any_axis": spheres},
    "fixed_point": {
        **{kind: third_axis(kind) for kind in exact_starts()},
        "grioli": grioli_points,
        "balanced_field": balanced_points,
        "free_rotation": free_rotations,
        "free_precession": free_precessions,
        "other_axis": other_axes,
    },
}
DRAWS = {name: STARTS["fixed_point"][name] for name in FAMILIES}
