"""Equations of Yehia & El-kenani 2021 (doi 10.22055/JACM.2021.37913.3113) as printed and as corrected, with residuals."""

from __future__ import annotations

import logging
from collections.abc import Mapping
from typing import Any

import numpy as np

from ...extension import extensions
from ...systems.base import Array
from ...systems.gyrostat.motions import angular_velocity
from ...systems.gyrostat.oscillations import Equilibria
from ...systems.satellite import SATELLITE
from ...systems.satellite.equations import rhs
from ...systems.satellite.families import FAMILIES, steady_motion
from ...systems.satellite.initial import PARAMETERS, body_vectors, constants, directions
from ..catalogue.papers import Entry, EntryMeasure, expression, load, rows, side
from . import lagrange

Point = dict[str, Array]
Values = Mapping[str, float | str]

log = logging.getLogger(__name__)
CONTENT, ENTRIES = load(__package__)
STATE = ("psi0", "theta0", "phi0", "n", "theta_dot0", "m")


def random_point(rng: np.random.Generator) -> Point:
    """Return a random point with parameters of order 1 and Omega = 1."""
    absent = ("drag1", "drag2", "drag3", "damping")  # torques that the paper does not have
    names = [name for name in PARAMETERS if name not in absent]
    point = {name: rng.uniform(0.4, 1.2, 1) * rng.choice([-1, 1], 1) for name in names}
    point |= {name: np.zeros(1) for name in absent}
    point |= {name: rng.uniform(0.7, 1.3, 1) for name in ("A", "B", "C")}
    point |= {"Omega": np.ones(1), "theta0": rng.uniform(0.4, 1.2, 1), "theta_dot0": np.zeros(1)}
    return point | {"phi0": np.zeros(1)}


def with_values(point: Mapping[str, Any], values: Values) -> dict[str, Any]:
    """Return the point with further values. A value is a number, or an expression that may contain names of earlier values."""
    point = dict(point)
    for name, value in values.items():
        point[name] = expression(name, str(value)).value(point) + np.zeros(1)
    return point


def euler_state(point: Point) -> list[Array]:
    """Return psi, theta, phi and the three rates at the start, in the order of lagrange.STATE."""
    return [point[name] for name in STATE]


# The error of a condition is the residual of the motion that satisfies the condition.


def residual(point: Point) -> float:
    """Return the largest error of the acceleration along the steady motion with the relative angular velocity n gamma + m e3."""
    t = np.linspace(0.0, 13.0, 13)
    state = steady_motion(point, t)
    rates = np.array(rhs(state, constants(point)[:, None]))
    zero = np.zeros_like(state[6])
    needed = (point["n"] + point["Omega"]) * point["m"] * np.array([state[7], -state[6], zero])
    return float(np.abs(rates[:3] - needed).max())


def _condition(entry: Entry, reading: str, rng: np.random.Generator) -> float:
    starts = entry["start"] if isinstance(entry["start"], list) else [entry["start"]]
    point = random_point(rng)
    return max(residual(with_values(point, start | entry.get(f"as_{reading}", {}))) for start in starts)


def _beyond(entry: Entry, reading: str, rng: np.random.Generator) -> float:
    """Return by how much a true motion exceeds the printed limits. For the true reading, return the residual of the motion."""
    point = with_values(random_point(rng), entry["start"])
    for name in entry.get("solve", ()):
        point[name] = FAMILIES[entry["family"]].solve[name](point)
    if reading == "true":
        return residual(point)
    return float(np.abs(expression("breaks", entry["breaks"]).value(point))[0])


TIMES = np.linspace(0.0, 13.0, 13)


def _along(entry: Entry, reading: str, point: Mapping[str, Any], step: complex = 0) -> list[Array]:
    """Return w, alpha, gamma and beta of a closed form at the instants TIMES + step."""
    form = entry["form"] | (entry.get("form_true", {}) if reading == "true" else {})
    values = {**point, "t": TIMES + step}
    alpha, beta, gamma, turn = (
        np.array([expression(name, str(entry)).value(values) + 0 * values["t"] for entry in entries])
        for name, entries in {**form, "turn": [0, 0, form["turn"]]}.items()
    )
    return [turn + point["Omega"] * gamma, alpha, gamma, beta]


def _closed_form(entry: Entry, reading: str, rng: np.random.Generator) -> float:
    """Return the largest error of the rates and of beta = gamma x alpha along a closed form of the motion."""
    point = with_values(random_point(rng), entry["start"])
    w, alpha, gamma, beta = _along(entry, reading, point)
    # A derivative by a complex step is exact to round-off.
    slopes = [part.imag / 1e-30 for part in _along(entry, reading, point, 1e-30j)[:3]]
    rates = np.array(rhs(np.concatenate([w, alpha, gamma]), constants(point)))
    orientation = np.abs(beta - np.cross(gamma, alpha, axis=0)).max()
    return float(max(np.abs(np.concatenate(slopes) - rates).max(), orientation))


def _inertial(entry: Entry, reading: str, rng: np.random.Generator) -> float:
    """Return the largest error of the stated precession and spin, against the body's angular velocity w computed from the axes X, Y, Z."""
    motion = ENTRIES[entry["motion"]]
    point = with_values(random_point(rng), motion["start"])

    def axes(step: complex = 0) -> Array:
        _, alpha, gamma, beta = _along(motion, "true", point, step)
        angle = point["Omega"] * (TIMES + step)
        cosine, sine = np.cos(angle), np.sin(angle)
        return np.array([cosine * alpha - sine * beta, sine * alpha + cosine * beta, gamma])

    values, rates = axes(), axes(1e-30j).imag / 1e-30
    w = -0.5 * np.cross(values, rates, axis=1).sum(0)  # solves e' = e x w for the three axes e
    texts = entry.get("inertial_true", entry["inertial"]) if reading == "true" else entry["inertial"]
    precession, spin = (expression(entry["number"], str(text)).value(point) for text in texts)
    return float(np.abs(w - precession * values[2] - spin * np.array([[0.0], [0.0], [1.0]])).max())


# Equations (8)-(13) and those of section 4.2 hold on the motion theta = theta0, psi = psi0 + n t, phi = m t.


def instant(entry: Entry, rng: np.random.Generator, point: Point) -> dict[str, Any]:
    """Return the instant `t` at which an equation is stated, and `even`, which is (-1)^i in (35) and (-1)^j in (39)."""
    if "time" not in entry:
        return {"t": rng.uniform(0.5, 5.0), "even": 1}
    if entry["time"] == 35:
        i = int(rng.integers(1, 11))
        return {"t": np.pi * i / point["m"], "even": (-1) ** i}
    j = int(rng.integers(0, 10))
    return {"t": np.pi / (2 * point["m"]) + np.pi * j / point["m"], "even": (-1) ** j}


def parts(point: Mapping[str, Any]) -> dict[str, Any]:
    """Return the point with the abbreviations of section 4."""
    return with_values(point, CONTENT["abbreviations"])


def left_side(entry: Entry, reading: str, values: Mapping[str, Any]) -> Array:
    """Return the left side of an equation in the reading "printed" or "true"."""
    return side(entry, reading, ENTRIES, lambda term: expression(entry["number"], term).value(values))


def true_left_side(point: Point, t: Any, number: int) -> Array:
    """Return the left side of the corrected equation (5), (6) or (7) on the regular precession."""
    moved = {**point, "psi0": point["psi0"] + point["n"] * t, "phi0": point["m"] * t}
    zero = np.zeros(1)
    return lagrange.equations(euler_state(moved), (zero, zero, zero), constants(moved))[number - 5]


def _equation_on_motion(entry: Entry, reading: str, rng: np.random.Generator) -> float:
    point = random_point(rng)
    at = instant(entry, rng, point)
    left = left_side(entry, reading, parts(point | at))
    return float(np.abs(left - true_left_side(point, at["t"], entry["left_side"]))[0])


def _largest_residual(entry: Entry, reading: str, rng: np.random.Generator) -> float:
    point = random_point(rng)
    values = with_values(
        point | instant(entry, rng, point), entry.get("start", {}) | entry.get(f"as_{reading}", {})
    )
    return max(float(np.abs(expression("vanish", text).value(values)).max()) for text in entry["vanish"])


def _free(rng: np.random.Generator) -> Point:
    """Return a random body in a random state in which sin theta is not small."""
    rate, angle = rng.uniform(0.4, 1.2, 1), rng.uniform(0, 2 * np.pi, 1)
    return {**random_point(rng), "theta_dot0": rate, "phi0": angle}


def _at_state(rng: np.random.Generator) -> dict[str, Any]:
    """Return a random state and the true accelerations, by the names in the table [state]."""
    p = _free(rng)
    state = euler_state(p)
    accelerations = lagrange.rhs(state, constants(p))[3:]
    names = (*lagrange.STATE, "psi_accel", "theta_accel", "phi_accel")
    return with_values(p | dict(zip(names, (*state, *accelerations), strict=True)), CONTENT["state"])


def _lagrangian_error(entry: Entry, reading: str, rng: np.random.Generator) -> float:
    """Return the error of the Lagrangian (4) at a random state. The exact value is (2) with the potential (3)."""
    p = _at_state(rng)
    alpha, gamma = directions(p)
    inertia, k, mu = body_vectors(p)
    w = angular_velocity(p, p["n"] + p["Omega"], gamma)
    potential = 1.5 * p["Omega"] ** 2 * inertia * alpha**2 + mu * (p["h1"] * alpha + p["h3"] * gamma)
    exact = (0.5 * inertia * w**2 + k * w - potential).sum(0)
    return float(np.abs(left_side(entry, reading, p) - exact)[0])


def _equation_of_motion(entry: Entry, reading: str, rng: np.random.Generator) -> float:
    p = _at_state(rng)
    if reading == "printed":
        return float(np.abs(left_side(entry, reading, p))[0])
    accelerations = [p[f"{name}_accel"] for name in ("psi", "theta", "phi")]
    left = lagrange.equations(euler_state(p), accelerations, constants(p))[entry["lagrange"] - 5]
    return float(np.abs(left)[0])


def determinant_quotient(angles: Array) -> float:
    """Return c_* in (43), which is the determinant divided by the product of sines."""
    columns = [np.cos(2 * angles), np.sin(2 * angles), np.cos(angles), np.sin(angles), np.ones(5)]
    pairs = [np.sin((angles[j] - angles[i]) / 2) for i in range(5) for j in range(i + 1, 5)]
    return float(np.linalg.det(np.array(columns).T) / np.prod(pairs))


def _determinant(entry: Entry, reading: str, rng: np.random.Generator) -> float:
    """Return the relative difference of c_* in (43) between two random sets of well separated angles."""
    first, second = (
        determinant_quotient(2 * np.pi / 5 * (np.arange(5) + rng.uniform(0, 0.7, 5))) for _ in range(2)
    )
    return abs(first / second - 1)


def _kinematics(entry: Entry, reading: str, rng: np.random.Generator) -> float:
    """Return the largest error of alpha' = alpha x w, gamma' = gamma x w, |alpha| = 1 and alpha.gamma = 0 at a random state."""
    p = _free(rng)
    moved = {angle: p[angle] + 1e-30j * p[rate] for angle, rate in zip(STATE[:3], STATE[3:], strict=True)}
    still, moving = directions(p), np.imag(directions(p | moved)) / 1e-30
    w = angular_velocity(p, p["n"], still[1])
    turning = max(np.abs(m - np.cross(v, w, axis=0)).max() for v, m in zip(still, moving, strict=True))
    return float(max(turning, abs((still[0] ** 2).sum() - 1), abs((still[0] * still[1]).sum())))


def _both_forms(entry: Entry, reading: str, rng: np.random.Generator) -> float:
    """Return the relative difference between dw/dt by Lagrange's equations and by the Euler-Poisson equations."""
    p = with_values(_free(rng), entry.get(f"as_{reading}", {}))
    state = np.array(euler_state(p))

    def w(state):
        moved = p | dict(zip(STATE, state, strict=True))
        return angular_velocity(moved, moved["n"] + p["Omega"], directions(moved)[1])

    by_lagrange = w(state + 1e-30j * np.array(lagrange.rhs(state, constants(p)))).imag / 1e-30
    exact = np.array(rhs(np.concatenate([w(state), *directions(p)]), constants(p))[:3])
    return float(np.abs(by_lagrange - exact).max() / np.abs(exact).max())


def _shared_conditions(entry: Entry, reading: str, rng: np.random.Generator) -> float:
    """Return the share of corrected conditions whose motions obey the Euler-Poisson equations, or 1 - share for the reading "true"."""
    kept = [row for row in ENTRIES.values() if "start" in row and "vanish" not in row and "breaks" not in row]
    share = np.mean([_condition(row, "true", rng) < 1e-9 for row in kept if "form" not in row])
    return float(share if reading == "printed" else 1 - share)


def _plane(entry: Entry, reading: str, rng: np.random.Generator) -> float:
    """Return the error of `rho` at amplitude 0 if the entry has `rho`, else the largest residual of the equation of pitch."""
    from ..plane.motions import PlaneMotions  # the extension `plane` may be missing

    p = with_values(random_point(rng), entry["plane"])
    motion = PlaneMotions.of(SATELLITE.body(p), *SATELLITE.start(p))
    if "rho" in entry:
        return float(np.abs(motion.multipliers()[0] - 2 - expression("rho", entry["rho"]).value(p))[0])
    x, rate = np.array(motion.pitch(TIMES[:, None, None] / 4 + 0.01 * np.arange(-4, 5)[:, None]))[..., 0]
    slopes = np.array([x, rate]) @ np.array([3, -32, 168, -672, 0, 672, -168, 32, -3]) / 8.4
    needed = rate[:, 4], -1.5 * np.abs(p["B"] - p["A"]) / p["C"] * np.sin(2 * x[:, 4])
    return float(np.abs(slopes - needed).max())


def _normal_form(entry: Entry, reading: str, rng: np.random.Generator) -> float:
    """Return the largest |f^4 - P f^2 + Q| for the frequencies f of the normal form of a random motion. `entry` gives P and Q."""
    from ..normal_form.nonlinear import NormalForm, derivatives  # the extension `normal_form` may be missing

    p = with_values(random_point(rng), entry["normal_form"])
    rest = Equilibria.of(SATELLITE.body(p), *SATELLITE.start(p))
    form = NormalForm.of(*derivatives(rest, np.zeros(1, int)))
    squares = (np.array([form.l1, form.l2]) * rest.rate) ** 2
    P, Q = (expression(name, entry[name]).value(p) for name in "PQ")
    return float(np.abs(squares**2 - P * squares + Q).max())


def _lost_rank(entry: Entry, reading: str, rng: np.random.Generator) -> float:
    """Return 10 minus the rank of equations (36), i = 1 to 10, for an irrational n/m. Even and odd i have different unknowns."""
    i = np.arange(1, 11)
    x = np.pi * i * np.sqrt(2) * (1 + rng.integers(1, 4))
    waves = np.array([np.cos(2 * x), np.sin(2 * x), np.cos(x), np.sin(x), np.ones(10)])
    return float(10 - np.linalg.matrix_rank(np.concatenate([waves * (i % 2), waves * (1 - i % 2)])))


def _apex_distance(entry: Entry, reading: str, rng: np.random.Generator) -> float:
    """Return the distance between the line along the satellite's e3 and the orbit's normal through the Earth, in radii of the orbit."""
    psi0 = 0.0 if reading == "printed" else np.pi / 2
    p = with_values(random_point(rng), {"psi0": psi0, "n": 0})
    alpha, gamma = directions(p)
    across = np.array([alpha[2, 0], -np.sin(p["theta0"][0]) * np.cos(psi0)])
    along = -across[0] / (across @ across)
    return float(np.hypot(1 + along * across[0], along * across[1]))


# Functions that measure the error of an equation, by number of the equation or by a key of the equation's entry.
MEASURES: dict[str, EntryMeasure | None] = {
    "(1)": _kinematics,
    "(2), (3)": _both_forms,
    "(4)": _lagrangian_error,
    "(43)": _determinant,
    "after (43)": _lost_rank,
    "after (45), new solutions": _shared_conditions,
    "abstract, accuracy": _both_forms,
    "names": _apex_distance,
    "lagrange": _equation_of_motion,
    "plane": _plane,
    "normal_form": _normal_form,
    "left_side": _equation_on_motion,
    "vanish": _largest_residual,
    "inertial": _inertial,
    "form": _closed_form,
    "breaks": _beyond,
    "start": _condition,
}

# Each of these keys of MEASURES needs the extension of the same name, which is not installed.
MISSING = [name for name in ("plane", "normal_form") if name not in extensions()]
if MISSING:
    text = " and ".join(MISSING)
    log.warning("conditions: some equations of Yehia & El-kenani are not measured: not installed: %s", text)

PUBLISHED = rows(CONTENT, MEASURES | dict.fromkeys(MISSING))
