"""Closed forms of the linear stability of steady motions, each derived for its family alone: lambda^4 + P lambda^2 + Q = 0."""

from __future__ import annotations

import numpy as np
from family_starts import STARTS
from strategies import fixed_points_on_family, symmetric_fixed_points

from atlas.systems.fixed_point import FIXED_POINT, initial
from atlas.systems.satellite import SATELLITE
from atlas.systems.satellite.initial import body_vectors


def tilted(p):
    """P and Q of a symmetric satellite with rotor, magnet and drag along its axis, which rests in the orbital frame.

    With the axial momentum p = (C w3 + k3) / A constant the axis moves like a charge on the sphere:
    U = -Omega^2 s^2/2 - Omega p c + (3/2) D Omega^2 s^2 sin^2 psi + mu3 (h1 s sin psi + h3 c) / A - drag3 s cos psi / A,
    D = C/A - 1,
    P = U_tt + U_pp / s^2 + (2 Omega c - p)^2 and Q = (U_tt U_pp - U_tp^2) / s^2.
    """
    s, c, sp, cp = (f(p[name]) for name in ("theta0", "psi0") for f in (np.sin, np.cos))
    square, momentum = p["Omega"] ** 2, (p["C"] * (p["Omega"] * c + p["m"]) + p["k3"]) / p["A"]
    D, radial, normal = p["C"] / p["A"] - 1, p["mu3"] * p["h1"] / p["A"], p["mu3"] * p["h3"] / p["A"]
    drag = p["drag3"] / p["A"]
    tt = (
        (c**2 - s**2) * square * (3 * D * sp**2 - 1)
        + p["Omega"] * momentum * c
        - radial * s * sp
        - normal * c
        + drag * s * cp
    )
    tp = (6 * D * square * s * c * sp * cp + radial * c * cp + drag * c * sp) / s
    pp = 3 * D * square * (cp**2 - sp**2) - radial * sp / s + drag * cp / s
    return tt + pp + (2 * p["Omega"] * c - momentum) ** 2, tt * pp - tp**2


def about_normal(p):
    """P and Q of a satellite that turns about an axis of symmetry, with rotor and magnet along it, on the normal.

    With J the moment about that axis, T across it, nu the rate in the orbital frame: p = (J (Omega + nu) + k.gamma) / T,
    U_2 = Omega p - Omega^2 - h3 mu.gamma / T, U_1 = U_2 + 3 Omega^2 (J/T - 1), P = U_1 + U_2 + (2 Omega - p)^2, Q = U_1 U_2.
    """
    inertia, k, mu = body_vectors(p)
    gamma, Omega = SATELLITE.initial_state(p)[6:], p["Omega"]
    along = (inertia * gamma**2).sum(0)
    across = 0.5 * (inertia.sum(0) - along)
    momentum = (along * (Omega + p["n"] + p["m"] * gamma[2]) + (k * gamma).sum(0)) / across
    second = Omega * momentum - Omega**2 - p["h3"] * (mu * gamma).sum(0) / across
    first = second + 3 * Omega**2 * (along / across - 1)
    return first + second + (2 * Omega - momentum) ** 2, first * second


def axis_of_symmetry(p):
    """A principal axis of two equal moments across it, (3, points)."""
    moments = np.array([p[name] for name in "ABC"])
    return np.eye(3)[np.abs(np.roll(moments, -1, 0) - np.roll(moments, -2, 0)).argmin(0)].T


def nutation(p):
    """Squared frequency of nutation of a heavy symmetric gyrostat in the field N, of the effective potential; P with Q = 0.

    (n^2 + N (C - A)/A) sin^2 theta + ((C r + l)/A - 2 n cos theta)^2, C and l about the axis of symmetry.
    """
    inertia, rotor, _, N = initial.bodies(p)
    w, gamma, s = *np.split(FIXED_POINT.initial_state(p), 2), axis_of_symmetry(p)
    C, cosine = (inertia * s).sum(0), (gamma * s).sum(0)
    A, normal = 0.5 * (inertia.sum(0) - C), gamma - cosine * s
    n = (w * normal).sum(0) / (normal**2).sum(0)
    spin = (C * (w * s).sum(0) + (rotor * s).sum(0)) / A
    return (n**2 + N * (C - A) / A) * (normal**2).sum(0) + (spin - 2 * n * cosine) ** 2, 0.0


def upright(p):
    """P and Q of a symmetric gyrostat on the vertical, of lambda^2 + i p lambda + q = 0 for the tilt in space.

    p = (C r + l3)/A and q = -(s Mg z0 - N (C - A))/A, s = cos theta: unstable where p^2 < 4 (N (C - A) - s Mg z0)/A.
    """
    Mg, N = initial.fields(p)
    spin = (p["C"] * FIXED_POINT.initial_state(p)[2] + p["l3"]) / p["A"]
    side = np.sign(initial.vertical(p)[2])
    slope = (N * (p["C"] - p["A"]) - side * Mg * p["z0"]) / p["A"]
    return spin**2 - 2 * slope, slope**2


def free_rotation(p):
    """Sum of the principal minors of I x' = (I x) x w + (I w + l) x x, whose exponents are 0 and +-sqrt(-P)."""
    inertia, rotor, _, _ = (value.T for value in initial.bodies(p))
    w = FIXED_POINT.initial_state(p)[:3].T
    rows = [(np.cross(inertia * e, w) + np.cross(inertia * w + rotor, e)) / inertia for e in np.eye(3)]
    minors = [
        rows[i][:, i] * rows[j][:, j] - rows[i][:, j] * rows[j][:, i] for i, j in ((0, 1), (0, 2), (1, 2))
    ]
    return sum(minors), 0.0


def neutral(p):
    """P and Q of motions whose neighbours are steady: distances grow like the time at most."""
    return np.ones_like(p["A"]), 0.0


def loaded(name):
    """Starts of the family with rotor and magnet along the normal."""

    def draw(rng, count):
        points = STARTS["satellite"][name](rng, count)
        gamma = SATELLITE.initial_state(points)[6:]
        for names in (("k1", "k2", "k3"), ("mu1", "mu2", "mu3")):
            points |= dict(zip(names, rng.normal(size=count) * gamma, strict=True))
        return points

    return draw


def symmetric(name, *solved, **given):
    """Starts of symmetric bodies with rotor and centre of mass on the axis."""
    return lambda rng, count: fixed_points_on_family(
        name, symmetric_fixed_points(rng, count, **given), *solved
    )


def stability(P, Q):
    """Whether the motion is unstable, and its growth rate; where Q is 0 throughout, as of an ignorable coordinate, P alone decides."""
    root = np.sqrt(0.25 * P**2 - Q + 0j)
    growth = np.sqrt(np.array([-0.5 * P + root, -0.5 * P - root])).real.max(0)
    return growth > 1e-6 * np.sqrt(np.abs(P) + np.sqrt(np.abs(Q))), growth


# System, family, function that draws starts on the family, and closed form.
ROWS = {
    "cylindrical": (SATELLITE, "cylindrical", loaded("cylindrical"), about_normal),
    "perp_radius": (SATELLITE, "perp_radius", STARTS["satellite"]["perp_radius"], tilted),
    "perp_velocity": (SATELLITE, "perp_velocity", STARTS["satellite"]["perp_velocity"], tilted),
    "oblique": (SATELLITE, "oblique", STARTS["satellite"]["oblique"], tilted),
    "spherical": (SATELLITE, "spherical", STARTS["satellite"]["spherical"], neutral),
    "other_axis": (SATELLITE, "other_axis", loaded("other_axis"), about_normal),
    "spherical_any_axis": (
        SATELLITE,
        "spherical_any_axis",
        STARTS["satellite"]["spherical_any_axis"],
        neutral,
    ),
    "conical": (FIXED_POINT, "conical", symmetric("conical", "m"), nutation),
    "conical, slow": (FIXED_POINT, "conical", symmetric("conical", "n", n=0.0), nutation),
    "conical, fast": (FIXED_POINT, "conical", symmetric("conical", "n", n=50.0), nutation),
    "sleeping": (FIXED_POINT, "sleeping", symmetric("sleeping", "theta0", n=0.0), upright),
    "staude": (FIXED_POINT, "staude", symmetric("staude", "l3", m=0.0), nutation),
    "rest": (FIXED_POINT, "rest", symmetric("rest", "z0", n=0.0), nutation),
    "rest, free": (FIXED_POINT, "rest", STARTS["fixed_point"]["rest, free"], free_rotation),
    "free_rotation": (FIXED_POINT, "free_rotation", STARTS["fixed_point"]["free_rotation"], free_rotation),
    "free_precession": (FIXED_POINT, "free_precession", STARTS["fixed_point"]["free_precession"], neutral),
    "top, other_axis": (FIXED_POINT, "other_axis", STARTS["fixed_point"]["other_axis"], nutation),
}
