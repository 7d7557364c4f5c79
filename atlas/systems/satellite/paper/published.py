"""The equations of Yehia & El-kenani 2021 as printed and as true, each with its measured residual.

doi 10.22055/JACM.2021.37913.3113. Every row measures both readings on a random draw (Omega = 1, the rest
of order 1, so that the residual of a wrong equation is of order 1 and that of a true one is round-off).
Where brackets do not match they are read to the letter of the line; n*, m* and tau of (11)-(31) are read
as n, m and t, because as defined they are not rates in the time they multiply. The rows of section 4.2 are in
`irrational`.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from ...base import Array, PublishedEquation
from ..equations import rhs
from ..families import FAMILIES, steady_motion
from ..initial import constants, directions
from . import irrational, lagrange
from .draws import Draw, Measure, Point, euler_state, random_point

# alpha, beta, gamma, w' in body axes at a time that may be complex
Form = Callable[[Point, Any], Sequence[Sequence[Any]]]

_EQUATION = "left side at a random state and its true accelerations"
_IDENTITY = "left side at a random time, less that of the true equation"
_CONDITION = "largest |rate - right-hand side| along the motion under the condition"
_CLOSED = "largest |rate - right-hand side| of the closed form, or |beta - gamma x alpha|"


def residual(point: Point) -> float:
    """Largest error of the acceleration over 13 times of the steady motion w' = n gamma + m e3 of one point."""
    t = np.linspace(0.0, 13.0, 13)
    state = steady_motion(point, t)
    rates = np.array(rhs(state, constants(point)[:, None]))
    zero = np.zeros_like(state[6])
    needed = (point["n"] + point["Omega"]) * point["m"] * np.array([state[7], -state[6], zero])
    return float(np.abs(rates[:3] - needed).max())


def _form_residual(point: Point, form: Form) -> float:
    """Largest error of the rates, and of beta = gamma x alpha, along a closed form of the motion."""
    t = np.linspace(0.0, 13.0, 13)

    def evaluate(time: Any) -> list[Any]:
        alpha, beta, gamma, turn = (
            np.array([entry + 0 * time for entry in vector]) for vector in form(point, time)
        )
        return [turn + point["Omega"] * gamma, alpha, gamma, beta]

    w, alpha, gamma, beta = evaluate(t)
    # A derivative by a complex step is exact to round-off.
    slopes = [part.imag / 1e-30 for part in evaluate(t + 1e-30j)[:3]]
    rates = np.array(rhs(np.concatenate([w, alpha, gamma]), constants(point)))
    orientation = np.abs(beta - np.cross(gamma, alpha, axis=0)).max()
    return float(max(np.abs(np.concatenate(slopes) - rates).max(), orientation))


# The Lagrangian and Lagrange's equations.


def _free(rng: np.random.Generator) -> Point:
    """A random state of any body with sin theta not small."""
    rate, angle = rng.uniform(0.4, 1.2, 1), rng.uniform(0, 2 * np.pi, 1)
    return {**random_point(rng), "theta_dot0": rate, "phi0": angle}


def _lagrangian_terms(p: Point, sign: float) -> Array:
    """(4) with its two questionable signs; sign = 1 as printed, -1 as they follow from (2) and (3)."""
    psi, theta, phi, psi_dot, theta_dot, phi_dot = euler_state(p)
    s, c, sf, cf, sp, cp = np.sin(theta), np.cos(theta), np.sin(phi), np.cos(phi), np.sin(psi), np.cos(psi)
    rate = psi_dot + p["Omega"]
    w1, w2, w3 = rate * s * sf + theta_dot * cf, rate * s * cf - theta_dot * sf, phi_dot + rate * c
    kinetic = 0.5 * (p["A"] * w1**2 + p["B"] * w2**2 + p["C"] * w3**2)
    rotor = p["k1"] * w1 + p["k2"] * w2 + p["k3"] * w3
    first, second = cp * cf - c * sf * sp, cp * sf + c * cf * sp
    gravity = p["A"] * first**2 - sign * p["B"] * second**2 + p["C"] * s**2 * sp**2
    magnet = p["mu1"] * (p["h1"] * first + p["h3"] * s * sf)
    magnet = magnet + p["mu2"] * (sign * p["h1"] * second + p["h3"] * s * cf)
    magnet = magnet + p["mu3"] * (p["h1"] * s * sp + p["h3"] * c)
    return kinetic + rotor - 1.5 * p["Omega"] ** 2 * gravity - magnet


def _lagrangian(p: Point) -> Array:
    """(2) with (3), by the vectors of (1)."""
    alpha, gamma = directions(p)
    inertia, k, mu = (
        np.array([p[i] for i in names.split()]) for names in ("A B C", "k1 k2 k3", "mu1 mu2 mu3")
    )
    node = np.array([np.cos(p["phi0"]), -np.sin(p["phi0"]), np.zeros(1)])
    w = (p["n"] + p["Omega"]) * gamma + p["theta_dot0"] * node + p["m"] * np.array([[0.0], [0.0], [1.0]])
    potential = 1.5 * p["Omega"] ** 2 * inertia * alpha**2 + mu * (p["h1"] * alpha + p["h3"] * gamma)
    return (0.5 * inertia * w**2 + k * w - potential).sum(0)


def _lagrangian_row() -> PublishedEquation:
    def residual(sign: float) -> Measure:
        def measured(rng: np.random.Generator) -> float:
            point = _free(rng)
            return float(np.abs(_lagrangian_terms(point, sign) - _lagrangian(point))[0])

        return measured

    return PublishedEquation(
        "(4)", "", "-3/2 Omega^2 [... - B (cos psi sin phi + ...)^2 ...], -mu2 [h1 (cos psi sin phi + ...) + ...]",
        "+B (...)^2 and -mu2 [-h1 (...) + ...]", "misprint", "L at a random state, less (2) with (3)",
        residual(1.0), residual(-1.0),
    )  # fmt: skip


def _motion_row(index: int, printed: str, true: str) -> PublishedEquation:
    def residual(equations: Callable[..., Any]) -> Measure:
        def measured(rng: np.random.Generator) -> float:
            point = _free(rng)
            accelerations = lagrange.rhs(euler_state(point), constants(point))[3:]
            return float(np.abs(equations(euler_state(point), accelerations, constants(point))[index])[0])

        return measured

    return PublishedEquation(
        f"({5 + index})", "", printed, true, "misprint" if index != 1 else "false", _EQUATION,
        residual(lagrange.equations_printed), residual(lagrange.equations),
    )  # fmt: skip


# The identities (8)-(13) that theta = theta0, psi = n t + psi0, phi = m t has to satisfy.


def _identity_parts(p: Point, t: float) -> dict[str, Array]:
    u1, u2 = np.cos(p["theta0"]), np.sin(p["theta0"])
    minus = (p["m"] - p["n"]) * t - p["psi0"]
    plus = (p["m"] + p["n"]) * t + p["psi0"]
    square = p["Omega"] ** 2
    return {
        **p, "u1": u1, "u2": u2, "minus": minus, "plus": plus, "psi": p["n"] * t + p["psi0"], "mt": p["m"] * t,
        "psi_wrong": p["n"] * t - p["psi0"], "N": p["n"] + p["Omega"], "square": square, "D": p["A"] - p["B"],
        "sum": p["A"] + p["B"] - 2 * p["C"],
        "quadratic": square + 0.8 * p["Omega"] * p["n"] + 0.4 * p["n"] ** 2,
    }  # fmt: skip


def _eight(q: dict[str, Array], reading: str) -> Array:
    sin, cos, u1, u2 = np.sin, np.cos, q["u1"], q["u2"]
    first = (u1 - 1) ** 2 * sin(2 * q["minus"])
    second = (u1 + 1) ** 2 * sin(2 * q["plus"])
    pair2 = (u1 - 1) * cos(q["minus"]), (u1 + 1) * cos(q["plus"])
    sign = 1 if reading == "true" else -1
    if reading == "(8)":
        gravity, magnet = first * u1**2 * sin(2 * q["plus"]), -0.5 * q["h1"] * q["mu2"] * pair2[0] + pair2[1]
    else:
        gravity, magnet = first - second, -0.5 * q["h1"] * q["mu2"] * (pair2[0] + pair2[1])
    pair1 = (u1 - 1) * sin(q["minus"]) + (u1 + 1) * sin(q["plus"])
    rest = q["h1"] * q["mu3"] * cos(q["psi"]) + q["m"] * u2 * q["N"] * q["D"] * sin(2 * q["mt"])
    rest = rest + sign * q["m"] * q["k1"] * cos(q["mt"]) - q["m"] * q["k2"] * sin(q["mt"])
    return (
        3 / 8 * q["square"] * q["D"] * gravity + magnet - 0.5 * q["h1"] * q["mu1"] * pair1
        - 0.75 * u2**2 * q["square"] * q["sum"] * sin(2 * q["psi"]) + u2 * rest
    )  # fmt: skip


def _nine(q: dict[str, Array], reading: str) -> Array:
    sin, cos, u1, u2 = np.sin, np.cos, q["u1"], q["u2"]
    sign = -1 if reading == "(12)" else 1
    gravity = (u1 - 1) * cos(2 * q["minus"]) + sign * (u1 + 1) * cos(2 * q["plus"])
    psi = q["psi"] if reading == "true" else q["psi_wrong"]
    rotor2, rotor1 = (q[f"mu{i}"] * q["h3"] * u1 - q["N"] * q[f"k{i}"] * u1 for i in (2, 1))
    steady = 0.4 * q["n"] ** 2 * q["sum"] * u1, -0.8 * q["m"] * q["C"] * q["N"] + 0.8 * q["mu3"] * q["h3"]
    if reading == "(9)":
        turning = (rotor2 + rotor1 - q["m"] * q["k1"]) * sin(q["mt"])
        inner = (q["square"] + 0.8 * q["Omega"] * q["n"] - q["m"] * q["k2"]) * cos(q["mt"]) + steady[0]
    else:
        turning = (rotor2 - q["m"] * q["k2"]) * cos(q["mt"]) + (rotor1 - q["m"] * q["k1"]) * sin(q["mt"])
        inner = q["quadratic"] * q["sum"] * u1
    return (
        -3 / 8 * q["square"] * u2 * q["D"] * gravity
        + 0.5 * u2 * q["mu1"] * q["h1"] * (cos(q["minus"]) - cos(q["plus"]))
        - 0.5 * u2 * q["mu2"] * q["h1"] * (sin(q["minus"]) - sin(q["plus"]))
        + 0.75 * q["square"] * u2 * u1 * q["sum"] * cos(2 * q["psi"]) + u1 * q["mu3"] * q["h1"] * sin(psi)
        + 1.25 * u2 * q["D"] * (q["quadratic"] * u1 + 0.8 * q["m"] * q["N"]) * cos(2 * q["mt"])
        + turning + u2 * q["N"] * q["k3"] - 1.25 * u2 * (inner + steady[1])
    )  # fmt: skip


def _ten(q: dict[str, Array], reading: str) -> Array:
    sin, cos, u1, u2 = np.sin, np.cos, q["u1"], q["u2"]
    true = reading == "true"
    gravity = (u1 - 1) ** 2 * sin(2 * q["minus"]) + (u1 + 1) ** 2 * sin(2 * q["plus"])
    sign = -1 if true else 1
    pair1 = (u1 - 1) * sin(q["minus"]) + sign * (u1 + 1) * sin(q["plus"])
    pair2 = (u1 - 1) * cos(q["minus"]) - (u1 + 1) * cos(q["plus"])
    spin = (5 / 3 if true else 5 / 2) * q["square"] + 4 / 3 * q["Omega"] * q["n"] + 2 / 3 * q["n"] ** 2
    less = q["Omega"] - q["n"]
    if true:
        turning = u2 * ((q["mu1"] * q["h3"] - q["N"] * q["k1"]) * cos(q["mt"]))
        turning = turning + u2 * (q["N"] * q["k2"] - q["mu2"] * q["h3"]) * sin(q["mt"])
    else:
        turning = u2 * (less * q["k1"] + q["mu1"] * q["h3"]) * cos(q["mt"])
        if reading == "(10)":
            turning = turning + (q["N"] * q["k2"] - q["mu2"] * q["h3"]) * sin(q["mt"])
        else:
            turning = turning - (less * q["k2"] + q["mu2"] * q["h3"]) * sin(q["mt"])
    return (
        -3 / 8 * q["square"] * q["D"] * gravity + 0.5 * q["mu2"] * q["h1"] * pair2 + 0.5 * q["mu1"] * q["h1"] * pair1
        - 0.75 * u2**2 * q["D"] * spin * sin(2 * q["mt"]) + turning
    )  # fmt: skip


def _identity_row(number: str, printed: str, true: str) -> PublishedEquation:
    index = (int(number[1:-1]) - 8) % 3
    form = (_eight, _nine, _ten)[index]

    def residual(reading: str) -> Measure:
        def measured(rng: np.random.Generator) -> float:
            point, t = random_point(rng), rng.uniform(0.5, 5.0)
            needed = irrational.true_left_side(point, t, index)
            return float(np.abs(form(_identity_parts(point, t), reading) - needed)[0])

        return measured

    return PublishedEquation(
        number, "", printed, true, "misprint", _IDENTITY, residual(number), residual("true")
    )


# Conditions and closed forms.


def _condition_row(
    number: str,
    family: str,
    printed: str,
    true: str,
    verdict: str,
    drawn: Draw,
    corrected: Draw | None = None,
) -> PublishedEquation:
    """Row of a printed condition; corrected: draw that satisfies the true one, None where the printed one is true."""
    true_draw = corrected or drawn
    return PublishedEquation(
        number, family, printed, true, verdict, _CONDITION,
        lambda rng: residual(drawn(rng)), lambda rng: residual(true_draw(rng)),
    )  # fmt: skip


def _form_row(
    number: str, family: str, printed: str, true: str, verdict: str, drawn: Draw, form: Form, corrected: Form | None = None
) -> PublishedEquation:  # fmt: skip
    """Row of a printed closed form; corrected: the true form, None where the printed one is true."""
    true_form = corrected or form
    return PublishedEquation(
        number, family, printed, true, verdict, _CLOSED,
        lambda rng: _form_residual(drawn(rng), form), lambda rng: _form_residual(drawn(rng), true_form),
    )  # fmt: skip


_AXIAL: dict[str, float | str] = {"k1": 0, "k2": 0, "mu1": 0, "mu2": 0}
_FREE_MAGNET: dict[str, float | str] = {"mu1": 0, "mu2": 0, "mu3": 0}


def _rotor(point: Point, rate: Array) -> Point:
    """k1,2 = h3 mu1,2 / rate."""
    return {**point, "k1": point["h3"] * point["mu1"] / rate, "k2": point["h3"] * point["mu2"] / rate}


def _upright(
    rng: np.random.Generator, theta0: float, rotor_rate: Callable[[Point], Array], **given: float | str
) -> Point:
    point = random_point(rng, B="A", theta0=theta0, h1=0, **given)
    return _rotor(point, rotor_rate(point))


def _tilted(rng: np.random.Generator, k3: Callable[[Point], Array], **given: float | str) -> Point:
    point = random_point(rng, **{"n": 0, **_AXIAL, **given})
    return {**point, "k3": k3(point)}


def _k3_17(p: Point) -> Array:
    gravity = p["Omega"] ** 2 * (p["B"] - p["C"]) * np.cos(p["theta0"])
    return (gravity - p["m"] * p["Omega"] * p["C"] + p["mu3"] * p["h3"]) / p["Omega"]


def _k3_24(p: Point) -> Array:
    s, c, Omega = np.sin(p["theta0"]), np.cos(p["theta0"]), p["Omega"]
    inner = 4 * c * (p["B"] - p["C"]) * Omega**2 - p["C"] * Omega * p["m"] + p["mu3"] * p["h3"]
    return (s * inner - p["mu3"] * p["h1"] * c) / (Omega * s)


def _k3_19(p: Point, printed: bool) -> Array:
    root, gravity = np.sqrt(3), p["Omega"] ** 2 * (p["A"] + p["B"] - p["C"]) + p["mu3"] * p["h3"]
    radial = -p["mu3"] * p["h1"]
    return (radial * root * gravity if printed else radial + root * gravity) / (root * p["Omega"])


_SIXTY: dict[str, float | str] = {"theta0": np.pi / 3, "psi0": np.pi / 2, "m": -1, "n": 0}


def _nineteen_two(rng: np.random.Generator) -> Point:
    p = random_point(rng, **_SIXTY)
    Omega = p["Omega"]
    p["h1"] = -np.sqrt(3) * p["h3"]
    p = {**p, "k1": 2 * p["mu1"] * p["h3"] / Omega, "k2": 2 * p["mu2"] * p["h3"] / Omega}
    return {**p, "k3": (Omega**2 * (p["A"] + p["B"] - p["C"]) + 2 * p["mu3"] * p["h3"]) / Omega}


def _twenty_seven(rng: np.random.Generator) -> Point:
    p = random_point(rng, theta0=np.pi, m="n")
    sp, cp, Omega = np.sin(p["psi0"]), np.cos(p["psi0"]), p["Omega"]
    sine = np.sin(2 * p["psi0"])
    p["h1"] = -1.5 * Omega**2 * (p["A"] - p["B"]) * sine / (p["mu1"] * sp - p["mu2"] * cp)
    radial = p["mu3"] * p["h1"]
    p["k1"] = (radial * cp + p["mu1"] * p["h3"]) / Omega
    return {**p, "k2": (radial * sp + p["mu2"] * p["h3"]) / Omega}


def _twenty_nine_one(rng: np.random.Generator) -> Point:
    p = random_point(rng, B="A", theta0=0, m="n", mu1=0, mu2=0)
    radial, rate = p["mu3"] * p["h1"], p["Omega"] + 2 * p["n"]
    return {**p, "k1": radial * np.cos(p["psi0"]) / rate, "k2": radial * np.sin(p["psi0"]) / rate}


def _thirty_one(rng: np.random.Generator) -> Point:
    p = random_point(rng, B="A", theta0=np.pi, h1=0)
    p["m"] = 2 * p["n"]
    return _rotor(p, p["Omega"] - p["n"])


def _thirty_one_two(rng: np.random.Generator) -> Point:
    """Either of the two alternatives."""
    if rng.random() < 0.5:
        return random_point(rng, B="A", theta0=np.pi, n=1, m=2, **_FREE_MAGNET)
    p = random_point(rng, B="A", theta0=np.pi, mu3=0, **_AXIAL)
    return {**p, "m": 2 * p["n"]}


def _forty_four_three(side: float) -> Draw:
    def drawn(rng: np.random.Generator) -> Point:
        p = random_point(rng, B="A", theta0=np.pi, **_FREE_MAGNET)
        return {**p, "m": side * (p["n"] + p["Omega"])}

    return drawn


def _spherical(rng: np.random.Generator) -> Point:
    p = random_point(rng, B="A", C="A", h1=0, **_AXIAL)
    return {**p, "k3": p["h3"] * p["mu3"] / (p["n"] + p["Omega"]) - p["C"] * p["m"]}


def _turning(angle: Callable[[Point, Any], Any], rate: Callable[[Point], Any]) -> Form:
    """alpha = (cos x, -sin x, 0), beta = (sin x, cos x, 0), gamma = e3, w' = rate e3."""

    def form(p: Point, t: Any) -> Sequence[Sequence[Any]]:
        x = angle(p, t)
        return (
            (np.cos(x), -np.sin(x), 0.0), (np.sin(x), np.cos(x), 0.0), (0.0, 0.0, 1.0), (0.0, 0.0, rate(p)),
        )  # fmt: skip

    return form


def _form_16(p: Point, t: Any) -> Sequence[Sequence[Any]]:
    x = p["Omega"] * t
    return (np.cos(x), np.sin(x), 0), (-np.sin(x), np.cos(x), 0), (0, 0, 1), (0, 0, -p["Omega"])


def _form_18(p: Point, t: Any) -> Sequence[Sequence[Any]]:
    x, s, c = p["m"] * t, np.sin(p["theta0"]), np.cos(p["theta0"])
    return (
        (np.cos(x), -np.sin(x), 0), (c * np.sin(x), c * np.cos(x), -s), (s * np.sin(x), s * np.cos(x), c),
        (0, 0, p["m"]),
    )  # fmt: skip


def _form_20(p: Point, t: Any) -> Sequence[Sequence[Any]]:
    x, root = p["Omega"] * t, np.sqrt(3) / 2
    return (
        (np.sin(x) / 2, -np.cos(x) / 2, root), (np.cos(x), np.sin(x), 0),
        (-root * np.sin(x), root * np.cos(x), 0.5), (0, 0, -p["Omega"]),
    )  # fmt: skip


def _form_21(sign: float) -> Form:
    def form(p: Point, t: Any) -> Sequence[Sequence[Any]]:
        x = p["m"] * t
        return (sign * np.sin(x), sign * np.cos(x), 0), (np.cos(x), -np.sin(x), 0), (0, 0, 1), (0, 0, p["m"])

    return form


def _form_25(p: Point, t: Any) -> Sequence[Sequence[Any]]:
    x, s, c = p["m"] * t, np.sin(p["theta0"]), np.cos(p["theta0"])
    return (
        (-c * np.sin(x), -c * np.cos(x), s), (np.cos(x), -np.sin(x), 0), (s * np.sin(x), s * np.cos(x), c),
        (0, 0, p["m"]),
    )  # fmt: skip


def _form_28(p: Point, t: Any) -> Sequence[Sequence[Any]]:
    sp, cp = np.sin(p["psi0"]), np.cos(p["psi0"])
    return (cp, sp, 0), (sp, -cp, 0), (0, 0, -1), (0, 0, 0)


def _form_31b(sign: float) -> Form:
    def form(p: Point, t: Any) -> Sequence[Sequence[Any]]:
        x = p["n"] * t - p["psi0"]
        return (np.cos(x), sign * np.sin(x), 0), (sign * np.sin(x), -np.cos(x), 0), (0, 0, -1), (0, 0, p["n"])

    return form


def _apex_distance(psi0: float) -> Measure:
    """Least distance of the line along e3 through the satellite from the Earth's normal, over the orbit's radius."""

    def measured(rng: np.random.Generator) -> float:
        p = random_point(rng, psi0=psi0, n=0)
        alpha, gamma = directions(p)
        across = np.array([alpha[2, 0], -np.sin(p["theta0"][0]) * np.cos(psi0)])
        along = -across[0] / (across @ across)
        return float(np.hypot(1 + along * across[0], along * across[1]))

    return measured


def _asymmetric_upright(rng: np.random.Generator) -> Point:
    """A steady motion with n not 0, A != B and theta0 = 0: (27) turned over."""
    p = random_point(rng, theta0=0)
    sp, cp, Omega = np.sin(p["psi0"]), np.cos(p["psi0"]), p["Omega"]
    p["m"] = -p["n"]
    p["h1"] = -1.5 * Omega**2 * (p["A"] - p["B"]) * np.sin(2 * p["psi0"]) / (p["mu2"] * cp + p["mu1"] * sp)
    p["k1"] = (p["h3"] * p["mu1"] - p["h1"] * p["mu3"] * cp) / Omega
    return {**p, "k2": (p["h3"] * p["mu2"] + p["h1"] * p["mu3"] * sp) / Omega}


def _violation_26(rng: np.random.Generator) -> float:
    p = _asymmetric_upright(rng)
    return float(min(np.abs(p["A"] - p["B"])[0], np.abs(p["theta0"] - np.pi)[0]))


def _beyond(family: str, *solved: str, **given: float | str) -> Draw:
    """A random motion of a family that the paper does not have."""

    def drawn(rng: np.random.Generator) -> Point:
        point = random_point(rng, **{"n": 0, **given})
        for name in solved:
            point[name] = FAMILIES[family].solve[name](point)
        return point

    return drawn


def _beyond_row(
    number: str, family: str, printed: str, true: str, drawn: Draw, breaks: Callable[[Point], Any]
) -> PublishedEquation:
    """breaks: by how much a motion breaks what the paper allows."""
    return PublishedEquation(
        number, family, printed, true, "incomplete", "by how much a true motion breaks the printed limits; its defect",
        lambda rng: float(np.abs(breaks(drawn(rng)))[0]), lambda rng: residual(drawn(rng)),
    )  # fmt: skip


_K_UPRIGHT = "k1,2 = h3 mu1,2 / (m + Omega)"

PUBLISHED: tuple[PublishedEquation, ...] = (
    _lagrangian_row(),
    _motion_row(0, "{... + (k2 cos phi + k1 sin phi) theta'}; -h1 (mu2 sin psi cos theta + mu1 sin psi) cos phi",
                "{... + cos theta (k2 cos phi + k1 sin phi)} theta'; -h1 (mu2 cos psi cos theta + mu1 sin psi) cos phi"),
    _motion_row(1, "-Omega^2 (B + A - C) cos theta (3 sin^2 psi + 1); terms 1/2 (A - B) sin 2phi cos theta theta' (psi' + "
                "Omega); {...} without psi'; -h1 mu3 sin psi",
                "-Omega^2 (A sin^2 phi + B cos^2 phi - C) cos theta (3 sin^2 psi + 1); no term in theta' psi' or Omega theta'; "
                "{...} psi'; -cos theta [... - h1 mu3 sin psi]"),
    _motion_row(2, "C cos theta phi''; sin 2psi cos theta cos 2phi - (cos^2 psi - sin^2 psi cos^2 theta) sin 2phi; "
                "-h1 mu1 sin psi cos phi cos theta + cos psi sin phi",
                "C cos theta psi''; sin 2psi cos theta cos 2phi + (...) sin 2phi; -h1 mu1 (sin psi cos phi cos theta + "
                "cos psi sin phi); braces closed before psi' and theta'"),
    _identity_row("(8)", "(u1 - 1)^2 sin(...) (u1)^2 sin(...); -1/2 h1 mu2 (u1 - 1) cos(...) + ...; -m k1 cos mt",
                  "(u1 - 1)^2 sin(...) - (u1 + 1)^2 sin(...); -1/2 h1 mu2 [(u1 - 1) cos(...) + ...]; +m k1 cos mt"),
    _identity_row("(9)", "sin(nt - psi0); terms in k1, k2, cos mt scrambled",
                  "sin(nt + psi0); [(mu2 h3 - N k2) u1 - m k2] cos mt + [(mu1 h3 - N k1) u1 - m k1] sin mt, as in (12)"),
    _identity_row("(10)", "mu1 [(u1 - 1) sin(...) + (u1 + 1) sin(...)]; 5/2 Omega^2; (-n + Omega) k1; u2 on cos mt only",
                  "mu1 [(u1 - 1) sin(...) - (u1 + 1) sin(...)]; 5/3 Omega^2; -(n + Omega) k1; u2 on cos mt and sin mt"),
    _identity_row("(11)", "-m k1 cos mt", "+m k1 cos mt"),
    _identity_row("(12)", "-3/8 Omega^2 u2 (A - B) [(u1 - 1) cos(...) - (u1 + 1) cos(...)]; sin(nt - psi0)",
                  "[(u1 - 1) cos(...) + (u1 + 1) cos(...)]; sin(nt + psi0)"),
    _identity_row("(13)", "as (10), with -((-n + Omega) k2 + mu2 h3) sin mt",
                  "as (10), with u2 ((n + Omega) k2 - mu2 h3) sin mt"),
    _condition_row(
        "(14)1", "cylindrical", "mu1 = mu2 = 0, k1 = k2 = 0", "and h1 mu3 = 0", "false",
        lambda rng: random_point(rng, B="A", theta0=0, psi0=0, n=0, **_AXIAL),
        lambda rng: random_point(rng, B="A", theta0=0, psi0=0, n=0, h1=0, **_AXIAL)),
    _condition_row(
        "(14)2", "cylindrical", "mu1 = mu2 = 0, m = -Omega", "and h1 mu3 = 0", "false",
        lambda rng: random_point(rng, B="A", theta0=0, psi0=0, n=0, m=-1, mu1=0, mu2=0),
        lambda rng: random_point(rng, B="A", theta0=0, psi0=0, n=0, m=-1, mu1=0, mu2=0, h1=0)),
    _condition_row(
        "(14)3", "cylindrical", "h1 = 0, " + _K_UPRIGHT + " at theta0 = 0 and pi",
        "at theta0 = pi: k1,2 = h3 mu1,2 / (Omega - m)", "true at theta0 = 0, false at pi",
        lambda rng: _upright(rng, np.pi, lambda p: p["m"] + p["Omega"], psi0=0, n=0),
        lambda rng: _upright(rng, np.pi, lambda p: p["Omega"] - p["m"], psi0=0, n=0)),
    _form_row("(15)", "cylindrical", "alpha = (cos mt, -sin mt, 0), ...", "the same", "true",
              lambda rng: _upright(rng, 0, lambda p: p["m"] + p["Omega"], psi0=0, n=0),
              _turning(lambda p, t: p["m"] * t, lambda p: p["m"])),
    _form_row("(16)", "cylindrical", "alpha = (cos Omega t, sin Omega t, 0), ...", "the same", "true",
              lambda rng: random_point(rng, B="A", theta0=0, psi0=0, n=0, m=-1, mu1=0, mu2=0, h1=0), _form_16),
    _condition_row(
        "(17)1", "perp_radius", "h1 = 0, mu1 = mu2 = k1 = k2 = 0, k3 = (Omega^2 (B - C) cos theta0 - m Omega C + mu3 h3)/Omega",
        "the same", "true", lambda rng: _tilted(rng, _k3_17, B="A", psi0=0, h1=0)),
    _condition_row(
        "(17)2", "perp_radius", "mu = 0, k1 = k2 = 0, k3 = cos theta0 (B - C) Omega - C m", "the same", "true",
        lambda rng: _tilted(rng, _k3_17, B="A", psi0=0, mu3=0)),
    _form_row("(18)", "perp_radius", "alpha = (cos mt, -sin mt, 0), ...", "the same", "true",
              lambda rng: _tilted(rng, _k3_17, B="A", psi0=0, h1=0), _form_18),
    _condition_row(
        "(19)1", "asymmetric_tilt", "k3 = -mu3 h1 sqrt(3) (Omega^2 (A + B - C) + mu3 h3) / (sqrt(3) Omega)",
        "k3 = [-mu3 h1 + sqrt(3) (Omega^2 (A + B - C) + mu3 h3)] / (sqrt(3) Omega)", "misprint",
        lambda rng: _tilted(rng, lambda p: _k3_19(p, True), **_SIXTY),
        lambda rng: _tilted(rng, lambda p: _k3_19(p, False), **_SIXTY)),
    _condition_row("(19)2", "asymmetric_tilt", "h1 = -sqrt(3) h3, k1,2 = 2 mu1,2 h3 / Omega, k3 = (...)/Omega",
                   "the same", "true", _nineteen_two),
    _form_row("(20)", "asymmetric_tilt", "alpha = (sin Omega t / 2, -cos Omega t / 2, sqrt(3)/2), ...", "the same", "true",
              _nineteen_two, _form_20),
    _form_row("(21)", "cylindrical", "alpha = (sin mt, cos mt, 0)", "alpha = (-sin mt, -cos mt, 0)", "false",
              lambda rng: _upright(rng, 0, lambda p: p["m"] + p["Omega"], psi0=np.pi / 2, n=0),
              _form_21(1.0), _form_21(-1.0)),
    _condition_row("(22)", "cylindrical", "mu = 0, k1 = k2 = 0", "the same", "true",
                   lambda rng: random_point(rng, B="A", theta0=0, psi0=np.pi / 2, n=0, mu3=0, **_AXIAL)),
    _condition_row("(23)", "cylindrical", "h1 = 0, " + _K_UPRIGHT, "the same", "true",
                   lambda rng: _upright(rng, 0, lambda p: p["m"] + p["Omega"], psi0=np.pi / 2, n=0)),
    _condition_row("after (23)", "cylindrical", "k3 is arbitrary", "the same (for cylindrical motions only)", "true",
                   lambda rng: _upright(rng, 0, lambda p: p["m"] + p["Omega"], psi0=np.pi / 2, n=0, k3=5)),
    _condition_row(
        "(24)", "perp_velocity", "k3 = [sin theta0 (4 cos theta0 (B - C) Omega^2 - C Omega m + mu3 h3) - mu3 h1 cos theta0]"
        " / (Omega sin theta0)", "the same (psi0 = pi/2; h1 -> -h1 at psi0 = -pi/2)", "true",
        lambda rng: _tilted(rng, _k3_24, B="A", psi0=np.pi / 2)),
    _form_row("(25)", "perp_velocity", "alpha = (-cos theta0 sin mt, -cos theta0 cos mt, sin theta0), ...", "the same", "true",
              lambda rng: _tilted(rng, _k3_24, B="A", psi0=np.pi / 2), _form_25),
    PublishedEquation(
        "(26)", "equilibrium", "n != 0 needs A = B or theta0 = pi",
        "A = B, or theta0 = 0 with m = -n, or theta0 = pi with m = n, or m = 0 about another axis of symmetry", "incomplete",
        "by how much a true motion at theta0 = 0, m = -n breaks the printed condition; its defect",
        _violation_26, lambda rng: residual(_asymmetric_upright(rng))),
    _condition_row(
        "(27)", "equilibrium", "k1 = (mu3 h1 cos psi0 + mu1 h3)/Omega, k2 = (mu3 h1 sin psi0 + mu2 h3)/Omega, h1 = "
        "-(3/2) Omega^2 (A - B) sin 2psi0 / (mu1 sin psi0 - mu2 cos psi0)",
        "the same; where mu1 sin psi0 = mu2 cos psi0: (A - B) sin 2psi0 = 0 and h1 free", "true", _twenty_seven),
    _form_row("(28)", "equilibrium", "alpha = (cos psi0, sin psi0, 0), ...", "the same", "true", _twenty_seven, _form_28),
    _condition_row(
        "(29)1", "cylindrical", "mu1 = mu2 = 0, k1 = mu3 h1 cos psi0 / (Omega + 2n), k2 = mu3 h1 sin psi0 / (Omega + 2n)",
        "h1 mu3 = 0, (Omega + 2n) k1,2 = 0", "false", _twenty_nine_one,
        lambda rng: random_point(rng, B="A", theta0=0, m="n", h1=0, **_AXIAL)),
    _condition_row("(29)2", "cylindrical", "h1 = 0, k1,2 = mu1,2 h3 / (Omega + 2n)", "the same", "true",
                   lambda rng: _upright(rng, 0, lambda p: p["Omega"] + 2 * p["n"], m="n")),
    _form_row("(30)", "cylindrical", "alpha = (cos(2nt + psi0), -sin(2nt + psi0), 0), ...", "the same", "true",
              lambda rng: _upright(rng, 0, lambda p: p["Omega"] + 2 * p["n"], m="n"),
              _turning(lambda p, t: 2 * p["n"] * t + p["psi0"], lambda p: 2 * p["n"])),
    _condition_row("(31)1", "cylindrical", "h1 = 0, k1,2 = -mu1,2 h3 / (n - Omega)", "the same", "true", _thirty_one),
    _condition_row("(31)2", "cylindrical", "mu = 0, (k1 = k2 = 0 or n = Omega)", "the same", "true", _thirty_one_two),
    _form_row("(31b)", "cylindrical", "alpha = (cos(nt - psi0), sin(nt - psi0), 0), beta = (sin(nt - psi0), -cos(...), 0); "
              "inertial rate n + Omega", "alpha = (cos(nt - psi0), -sin(nt - psi0), 0), beta = (-sin(nt - psi0), -cos(...), 0); "
              "inertial rate n - Omega about e3", "false", _thirty_one, _form_31b(1.0), _form_31b(-1.0)),
    _condition_row("after (31)", "spherical", "theta0 != 0, pi: spherical symmetry (is enough)",
                   "A = B = C, k1 = k2 = 0, h1 mu = 0, h3 mu1 = h3 mu2 = 0, (n + Omega)(C m + k3) = h3 mu3", "incomplete",
                   lambda rng: random_point(rng, B="A", C="A", **_AXIAL), _spherical),
    *irrational.ROWS,
    _condition_row("(44)1", "cylindrical", "h1 = 0, mu1,2 = (Omega + m + n) k1,2 / h3; the same at theta0 = pi",
                   "at theta0 = pi: mu1,2 = (Omega + n - m) k1,2 / h3", "true at theta0 = 0, false at pi",
                   lambda rng: _upright(rng, np.pi, lambda p: p["Omega"] + p["m"] + p["n"]),
                   lambda rng: _upright(rng, np.pi, lambda p: p["Omega"] + p["n"] - p["m"])),
    _condition_row("(44)2", "cylindrical", "mu = 0, k1 = k2 = 0", "the same", "true",
                   lambda rng: random_point(rng, B="A", theta0=0, mu3=0, **_AXIAL)),
    _condition_row("(44)3", "cylindrical", "mu = 0, n + Omega + m = 0; the same at theta0 = pi",
                   "at theta0 = pi: n + Omega - m = 0", "true at theta0 = 0, false at pi",
                   _forty_four_three(-1.0), _forty_four_three(1.0)),
    _form_row("(45)", "cylindrical", "alpha = (cos(nt + psi0 + mt), -sin(nt + psi0 + mt), 0), ...", "the same", "true",
              lambda rng: _upright(rng, 0, lambda p: p["Omega"] + p["m"] + p["n"]),
              _turning(lambda p, t: (p["n"] + p["m"]) * t + p["psi0"], lambda p: p["n"] + p["m"])),
    _beyond_row("beyond (19)", "asymmetric_tilt", "A != B: theta0 = pi/3 only", "theta0 = 2 pi/3 with m = Omega too",
                _beyond("asymmetric_tilt", "h1", "k1", "k2", "k3", theta0=2 * np.pi / 3, psi0=np.pi / 2, m=1),
                lambda p: p["theta0"] - np.pi / 3),
    _beyond_row("beyond (17), (24)", "oblique", "n = 0, tilted axis: psi0 = 0 or pi/2",
                "and sin psi0 = h1 mu3 / (3 Omega^2 sin theta0 (A - C))",
                _beyond("oblique", "h1", "k3", B="A", **_AXIAL), lambda p: np.sin(2 * p["psi0"]) / 2),
    _beyond_row("beyond (24), psi0 = pi/2", "transverse_magnet", "A = B: mu1 = mu2 = k1 = k2 = 0",
                "or h1 (Omega + m cos theta0) = m sin theta0 h3, k1,2 = mu1,2 (h3 s - h1 c) / (Omega s)",
                _beyond("transverse_magnet", "h1", "k1", "k2", "k3", B="A", psi0=np.pi / 2),
                lambda p: np.hypot(p["mu1"], p["mu2"])),
    _beyond_row("beyond (24), w3 = 0", "despun_transverse", "A = B: mu1 = mu2 = k1 = k2 = 0",
                "or m = -Omega cos theta0, h3 c = -h1 s sin psi0, Omega s (k1 + i k2) = (H2 + i H1) (mu1 + i mu2)",
                _beyond("despun_transverse", "m", "h3", "mu3", "k1", "k2", "k3", B="A"),
                lambda p: np.hypot(p["mu1"], p["mu2"])),
    _beyond_row("beyond (26)", "other_axis", "n != 0, tilted axis: spherical symmetry only",
                "or m = 0 and an axis of symmetry other than the third along the normal",
                _beyond("other_axis", "k1", "k3", C="A", h1=0, m=0, n=0.6, theta0=np.pi / 2), lambda p: p["A"] - p["B"]),
    PublishedEquation(
        "names", "perp_radius", "(17) conical, (24) hyperboloidal",
        "in inertial space the axis of (17) sweeps a one-sheet hyperboloid, that of (24) a cone", "false",
        "distance of the axis of the motion called conical from the apex of a cone, over the orbit's radius",
        _apex_distance(0.0), _apex_distance(np.pi / 2)),
)  # fmt: skip
