"""Parameters of the gyrostat about a fixed point, and the initial state from angles, rates or vectors."""

from __future__ import annotations

from collections.abc import Set

import numpy as np

from ...errors import BadInput
from ..base import FAMILY_TOLERANCE, Array, Mask, Parameter, Points, shared
from ..gyrostat import Body, Direction
from ..gyrostat.body import gyration, perron_root
from ..gyrostat.motions import angular_velocity, directions
from ..vectors import length

_TABLE = (
    # name, unit, symbol, default, low, open_low, start, meaning
    ("A", "kg m2", "$A$", 1.0, 0.0, True, False, "moment of inertia about the first principal axis at the fixed point"),
    ("B", "kg m2", "$B$", 1.0, 0.0, True, False, "moment of inertia about the second principal axis at the fixed point"),
    ("C", "kg m2", "$C$", 1.2, 0.0, True, False, "moment of inertia about the third principal axis at the fixed point"),
    ("Mg", "N", "$Mg$", 0.0, -np.inf, False, False, "weight; it acts along gamma, towards the attracting centre"),
    ("x0", "m", "$x_0$", 0.0, -np.inf, False, False, "centre of mass along the first body axis"),
    ("y0", "m", "$y_0$", 0.0, -np.inf, False, False, "centre of mass along the second body axis"),
    ("z0", "m", "$z_0$", 0.0, -np.inf, False, False, "centre of mass along the third body axis"),
    ("N", "s-2", "$N$", 0.0, -np.inf, False, False, "gradient of the Newtonian field, 3 g / R = 3 lambda / R^3"),
    ("l1", "N m s", r"$\ell_1$", 0.0, -np.inf, False, False, "gyrostatic momentum along the first body axis"),
    ("l2", "N m s", r"$\ell_2$", 0.0, -np.inf, False, False, "gyrostatic momentum along the second body axis"),
    ("l3", "N m s", r"$\ell_3$", 0.0, -np.inf, False, False, "gyrostatic momentum along the third body axis"),
    ("M", "kg", "$M$", np.nan, 0.0, True, False, "mass; with lambda and R instead of Mg and N"),
    ("lambda", "m3 s-2", r"$\lambda$", np.nan, 0.0, False, False, "coefficient of attraction of the centre, g = lambda / R^2"),
    ("R", "m", "$R$", np.nan, 0.0, True, False, "distance from the fixed point to the attracting centre"),
    ("damping", "N m s", "$D$", 0.0, 0.0, False, False, "viscous damping, a torque of -D times the angular velocity"),
    ("theta0", "rad", r"$\theta_0$", 0.0, -np.inf, False, True, "angle from the vertical (towards the attracting centre) to the third body axis at the start"),
    ("psi0", "rad", r"$\psi_0$", 0.0, -np.inf, False, True, "precession angle at the start; it turns the motion about the vertical and changes nothing else"),
    ("phi0", "rad", r"$\varphi_0$", 0.0, -np.inf, False, True, "angle of proper rotation at the start"),
    ("theta_dot0", "rad s-1", r"$\dot\theta_0$", 0.0, -np.inf, False, True, "rate of the start about the line of nodes"),
    ("n", "rad s-1", "$n$", 0.0, -np.inf, False, True, "precession rate of the start, about the vertical"),
    ("m", "rad s-1", "$m$", 0.0, -np.inf, False, True, "rate of proper rotation of the start, about the third body axis"),
    ("p0", "rad s-1", "$p_0$", np.nan, -np.inf, False, True, "angular velocity about the first body axis, instead of angles and rates"),
    ("q0", "rad s-1", "$q_0$", np.nan, -np.inf, False, True, "angular velocity about the second body axis, instead of angles and rates"),
    ("r0", "rad s-1", "$r_0$", np.nan, -np.inf, False, True, "angular velocity about the third body axis, instead of angles and rates"),
    ("gamma10", "1", r"$\gamma_0$", np.nan, -np.inf, False, True, "first component of the vertical, with p0, q0, r0"),
    ("gamma20", "1", r"$\gamma'_0$", np.nan, -np.inf, False, True, "second component of the vertical, with p0, q0, r0"),
    ("gamma30", "1", r"$\gamma''_0$", np.nan, -np.inf, False, True, "third component of the vertical, with p0, q0, r0"),
)  # fmt: skip

PARAMETERS = {
    name: Parameter(name, unit, meaning, default, low, np.inf, open_low, initial_state, symbol)
    for name, unit, symbol, default, low, open_low, initial_state, meaning in _TABLE
}

VECTORS = ("p0", "q0", "r0", "gamma10", "gamma20", "gamma30")
UNIT_LENGTH = 1e-9  # largest deviation of the length of (gamma10, gamma20, gamma30) from 1
START_CONDITION = f"(gamma10, gamma20, gamma30) must be a unit vector within {UNIT_LENGTH:g}"


@shared
def fields(points: Points) -> tuple[Array, Array]:
    """Return weight Mg and field gradient N, which follow from (4), (5) of the paper where M, lambda and R are given."""
    given = ~np.isnan(points["M"])
    Mg = np.where(given, points["M"] * points["lambda"] / points["R"] ** 2, points["Mg"])
    N = np.where(given, 3 * points["lambda"] / points["R"] ** 3, points["N"])
    return Mg, N


@shared
def bodies(points: Points) -> tuple[Array, Array, Array, Array]:
    """Return inertia I, rotor l and moment of weight Mg r_c, each of shape (3, points), and the field gradient N, (points,)."""
    Mg, N = fields(points)
    inertia = np.array([points["A"], points["B"], points["C"]])
    rotor = np.array([points["l1"], points["l2"], points["l3"]])
    return inertia, rotor, Mg * np.array([points["x0"], points["y0"], points["z0"]]), N


def body(points: Points) -> Body:
    """Return the body in space, with the field gradient N and the weight along the vertical."""
    inertia, rotor, weight, N = bodies(points)
    zero = np.zeros_like(N)
    vertical = Direction(N, -np.moveaxis(weight, 0, -1))
    none = Direction(zero, np.zeros((*N.shape, 3)))
    return Body(inertia.T, rotor.T, zero, none, none, vertical, points["damping"])


def constants(points: Points) -> Array:
    """Return the constants of the equations, shape (constants, points), in the order of equations.CONSTANTS."""
    inertia, rotor, weight, N = bodies(points)
    return np.concatenate([inertia, 1 / inertia, rotor, weight, N * inertia, points["damping"][None]])


@shared
def vertical(points: Points) -> Array:
    """Return gamma in body axes at the start, shape (3, points)."""
    angles = directions(points)[1]
    vector = np.array([points["gamma10"], points["gamma20"], points["gamma30"]])
    size = length(vector)
    # A vector whose length is 1 up to rounding is kept, because a division would only change the last bits.
    vector = np.where(np.abs(size - 1) > 4e-16, vector / size, vector)
    return np.where(np.isnan(points["gamma10"]), angles, vector)


@shared
def rates(points: Points) -> tuple[Array, Array, Array]:
    """Return theta', n and m, the rates about node, vertical and third axis. Where sin theta = 0 and p0 is given, n = 0 and m = r0."""
    gamma = vertical(points)
    p, q, r = points["p0"], points["q0"], points["r0"]
    sine = np.hypot(gamma[0], gamma[1])
    pole = sine <= FAMILY_TOLERANCE
    sine = np.where(pole, 1.0, sine)
    theta_dot = np.where(pole, np.hypot(p, q), (p * gamma[1] - q * gamma[0]) / sine)
    n = np.where(pole, 0.0, (p * gamma[0] + q * gamma[1]) / sine**2)
    given = ~np.isnan(p)
    return (
        np.where(given, theta_dot, points["theta_dot0"]),
        np.where(given, n, points["n"]),
        np.where(given, r - n * gamma[2], points["m"]),
    )


@shared
def initial_state(points: Points) -> Array:
    """Return angular velocity and vertical at t = 0, (6, points). Where p0 is nan, the velocity follows from n, m and theta_dot0."""
    gamma = vertical(points)
    w = angular_velocity(points, points["n"], gamma)
    vector = np.array([points["p0"], points["q0"], points["r0"]])
    return np.concatenate([np.where(np.isnan(vector[0]), w, vector), gamma])


def as_euler_angles(points: Points) -> dict[str, Array]:
    """Return the same starts with theta0 .. m in place of p0 .. gamma30. Where sin theta0 = 0, theta_dot0 is hypot(p0, q0)."""
    given = ~np.isnan(points["p0"])
    if not given.any():
        return dict(points)
    gamma = vertical(points)
    theta_dot, n, m = rates(points)
    sine = np.hypot(gamma[0], gamma[1])
    turning = (sine <= FAMILY_TOLERANCE) & (theta_dot > 0)
    euler = {
        "theta0": np.arctan2(sine, gamma[2]),
        # If the third axis is vertical up to rounding, the node is undefined. Then phi0 puts the node along (p0, q0).
        "phi0": np.where(turning, np.arctan2(-points["q0"], points["p0"]), np.arctan2(gamma[0], gamma[1])),
        "theta_dot0": theta_dot,
        "n": n,
        "m": m,
    }
    euler = {name: np.where(given, values, points[name]) for name, values in euler.items()}
    return {**points, **euler, **{name: np.where(given, np.nan, points[name]) for name in VECTORS}}


def check(points: Points) -> None:
    """Raise BadInput if starts or fields are given incompletely or twice."""
    for names, what, alternatives in (
        (("M", "lambda", "R"), "M, lambda and R", ("Mg", "N")),
        (VECTORS, "p0 .. gamma30", ("theta0", "psi0", "phi0", "theta_dot0", "n", "m")),
    ):
        present = np.array([~np.isnan(points[name]) for name in names])
        given = present.all(0)
        bad = np.flatnonzero(present.any(0) & ~given)
        if bad.size:
            missing = [name for name, here in zip(names, present, strict=True) if not here.flat[bad[0]]]
            raise BadInput(
                f"{', '.join(missing)} missing: {', '.join(names)} must be given together or not at all"
            )
        for name in alternatives:
            bad = np.flatnonzero(given & (points[name] != 0))
            if bad.size:
                value = points[name].flat[bad[0]]
                raise BadInput(
                    f"{name} = {value:g} beside {what} ({bad.size} of {given.size} points): give one or the other"
                )


def possible_start(points: Points) -> Mask:
    """Return where gamma10 .. gamma30 form a unit vector. The result is true where angles give the start."""
    with np.errstate(over="ignore", invalid="ignore"):
        squares = points["gamma10"] ** 2 + points["gamma20"] ** 2 + points["gamma30"] ** 2
        return np.isnan(points["gamma10"]) | (np.abs(np.sqrt(squares) - 1) <= UNIT_LENGTH)


def warnings(points: Points) -> list[str]:
    """Return a sentence for each moment of inertia below M times the squared distance of the centre of mass from the axis."""
    messages = []
    for moment, a, b in (("A", "y0", "z0"), ("B", "x0", "z0"), ("C", "x0", "y0")):
        with np.errstate(over="ignore", invalid="ignore"):  # offsets may be huge, and M may be nan
            least = points["M"] * (points[a] ** 2 + points[b] ** 2)
        bad = np.flatnonzero(points[moment] < least * (1 - 1e-12))
        if bad.size:
            i = bad[0]
            messages.append(
                f"{moment} = {points[moment].flat[i]:g} is below M ({a}^2 + {b}^2) = {least.flat[i]:g}"
                f" ({bad.size} of {least.size} points): no real body has this moment about the fixed point"
            )
    return messages


def symmetric(points: Points) -> Mask:
    """Return where A = B, no rotor is transverse, and the centre of mass is on the third axis."""
    inertia, rotor, weight, _ = bodies(points)
    return (inertia[0] == inertia[1]) & (rotor[:2] == 0).all(0) & (weight[:2] == 0).all(0)


def conserves_axial_momentum(points: Points) -> Mask:
    """Return where Lagrange's integral C r + l3 is conserved."""
    return symmetric(points) & (points["damping"] == 0)


def integral_scales(points: Points) -> dict[str, Array]:
    """Return a lower bound of the scale of each integral, or nan. See `System.integral_scales`."""
    inertia, rotor, weight, N = bodies(points)
    w = initial_state(points)[:3]
    zero = np.zeros_like(points["A"])
    largest = inertia.max(0)
    # The fields change the kinetic energy by this much at most. Terms of the energy that start at 0 may grow to this size.
    potential = length(weight) + 0.5 * np.abs(N) * (largest - inertia.min(0))
    momentum = length(inertia * w) + np.sqrt(2 * largest * potential)
    no_weight, no_rotor = (weight == 0).all(0), (rotor == 0).all(0)
    no_gradient = (N == 0) | (largest == inertia.min(0))
    kovalevskaya = (inertia[0] == inertia[1]) & (inertia[0] == 2 * inertia[2]) & (N == 0) & (weight[2] == 0)
    kovalevskaya = kovalevskaya & (rotor[:2] == 0).all(0)
    transverse = w[0] ** 2 + w[1] ** 2 + 2 * potential / inertia[2]
    conserved = {
        "area": momentum + length(rotor),
        "lagrange": np.where(symmetric(points), momentum, np.nan),
        "clebsch": np.where(no_weight & (no_rotor | no_gradient), momentum**2 + (rotor**2).sum(0), np.nan),
        "kovalevskaya": np.where(kovalevskaya, transverse**2, np.nan),
    }
    damped = points["damping"] > 0
    scales = {name: np.where(damped, np.nan, scale) for name, scale in conserved.items()}
    return {"energy": potential, "length_gamma": zero, **scales}


@shared
def frequency_bound(points: Points) -> Array:
    """Return an upper bound of the fastest frequency. It uses a constant r where C r + l3 is conserved."""
    inertia, rotor, weight, N = bodies(points)
    A, B, C = inertia
    state = initial_state(points)
    w, gamma = state[:3], state[3:]
    fixed, damping = conserves_axial_momentum(points), points["damping"]
    moment = length(weight)

    # Twice the kinetic energy grows by at most `gain`, the sum of 2 (start value - minimum) over the terms of the potential.
    quadratic = (inertia * gamma**2).sum(0)
    gradient = np.where(N > 0, quadratic - inertia.min(0), inertia.max(0) - quadratic)
    gain = 2 * (moment - (weight * gamma).sum(0)) + np.abs(N) * gradient
    gain = np.maximum(gain, 0.0)
    energy = (inertia * w**2).sum(0) + gain
    max_rates = np.sqrt(energy / inertia)
    transverse = np.sqrt(w[0] ** 2 + w[1] ** 2 + gain / A)
    max_rates = np.where(fixed, np.array([transverse, transverse, np.abs(w[2])]), max_rates)
    min_inertia = np.where(fixed, A, inertia.min(0))
    max_turn = np.where(fixed, np.hypot(transverse, w[2]), np.sqrt(energy / min_inertia))

    # `own` bounds the frequencies at which w changes without torques. Where C r + l3 is conserved, r is constant and this bound is exact.
    own = np.where(fixed, np.abs((C - A) * w[2] + rotor[2]) / A, gyration(inertia, rotor, max_rates))
    differences = np.array([C - B, A - C, B - A])
    newtonian = np.where(fixed, np.abs(C - A) / A, np.sqrt((differences**2 / inertia).sum(0) / min_inertia))
    stiffness = np.abs(N) * newtonian + moment / min_inertia
    return perron_root(own + damping / min_inertia, max_turn, stiffness)


def specialization(zero: Set[str], equal: Set[tuple[str, str]]) -> tuple[set[str], set[tuple[str, str]]]:
    """Return `damping` if it is 0 at all points. Other terms that are 0 are kept, because each costs at most 5 % of the time."""
    return {"damping"} & zero, set()
