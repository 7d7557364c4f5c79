"""The fast-spin solution of Amer, Abo Essa, Ibrahim & Amer as it follows from the equations of motion.

A body with A = B has its centre of mass on the third axis and spins about this axis at a fast rate r0. The rotor (l1, l2, l3)
is arbitrary. The small parameter is eps = c sqrt(gamma0'') / r0, with c^2 = Mg |z0| / C. Numbers in brackets are the paper's
equations. `published` has the same quantities in the paper's printed form, and `published.PUBLISHED` lists the differences. The
dimensionless state is y = (p1, q1, r1, g1, g1', g1''), where primes belong to names. Other primes below are d/dtau, tau = r0 t.
A1, a, k and z are in `FastSpin`. With w = p1 + i q1, G = g1 + i g1' and mu = (l1 + i l2) / (A c sqrt(gamma0'')) the equations are

    w'   = i (A1 r1 + s) w - i mu r1 + i eps (z/a - k A1 g1'') G        s = l3 / (A r0)
    G'   = -i r1 G + i eps w g1''
    r1'  = eps^2 a Im(w conj(mu)),      g1''' = eps Im(w conj(G))

so that w turns at the rate Omega = A1 + s (exactly at eps = 0) about mu / Omega. The term mu / Omega is not small; the
paper's (19), (20) and (33) lack it.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, fields
from functools import cache
from types import SimpleNamespace
from typing import Any

import numpy as np

from ...errors import BadInput
from ...systems.base import Array, Mask, Points, subset
from ...systems.fixed_point import equations, initial
from ...systems.fixed_point.initial import bodies, initial_state
from . import MAX_RADIANS

# Data of section VI in SI units; PAPER_BODIES has the moments A and C of the two bodies.
PAPER_BODIES = {"A < C": (22.49, 35.6), "A > C": (50.32, 33.4)}
PAPER_ROTORS = (0.0, 10.0, 20.0, 30.0, 40.0, 50.0)
PAPER_DATA = {"r0": 1000.0, "R": 2000.0, "lambda": 0.6, "M": 30.0, "z0": 5.0, "gamma0": 0.352}


@dataclass(eq=False)
class FastSpin:
    """A gyrostat with the numbers of equations (4), (5), (10) and (30) of Amer et al. Raise BadInput where a formula is undefined."""

    A: Any  # equal to B, kg m2; every field is kept as an array
    C: Any  # kg m2
    weight: Any  # Mg z0, N m
    N: Any  # gradient of the Newtonian field, s-2
    l1: Any  # l1, l2 and l3 are the angular momentum of the rotor, N m s
    l2: Any
    l3: Any
    r0: Any  # rad s-1
    gamma0: Any  # gamma0'' = cos theta0

    @np.errstate(all="ignore")
    def __post_init__(self) -> None:
        for each in fields(self):
            setattr(self, each.name, np.asarray(getattr(self, each.name), float))
        A, C, r0 = self.A, self.C, self.r0
        _raise_where(r0 == 0, "r0 = 0: the small parameter eps = c sqrt(gamma0'') / r0 does not exist")
        _raise_where(
            ~((self.gamma0 > 0) & (self.gamma0 < 1)),
            "gamma0'' = cos theta0 outside (0, 1): the scaling (4) divides by it and takes its root, and"
            " psi' in (34) divides by sin theta0",
        )
        _raise_where(self.weight == 0, "Mg z0 = 0: the unit c sqrt(gamma0'') of p and q in (4) vanishes")
        _raise_where(C * r0 + self.l3 == 0, "C r0 + l3 = 0: chi1 and nu of (10) divide by 1 + Omega")
        self.scale = np.sqrt(np.abs(self.weight) / C * self.gamma0)  # c sqrt(gamma0''); c^2 = |Mg z0| / C
        self.eps = self.scale / r0
        self.a, self.A1 = A / C, (C - A) / A
        self.k = self.N * C / np.abs(self.weight) * self.gamma0  # N gamma0'' / c^2; (4) prints N / c^2
        self.z = np.sign(self.weight)  # z0' = +-1
        unit = C * self.scale
        self.y = self.l1 / unit, self.l2 / unit, self.l3 / unit  # y_i = l_i / (c C sqrt(gamma0''))
        # mu = (l1 + i l2) / (A c sqrt(gamma0'')) = (y1 + i y2) C / A. The point p1 + i q1 turns about the centre mu / Omega.
        self.mu = (self.l1 + 1j * self.l2) / (A * self.scale)
        self.Omega = ((C - A) * r0 + self.l3) / (A * r0)  # frequency of p1 and q1 in tau, exact at eps = 0
        _raise_where(
            (self.Omega == 0) & (self.mu != 0),
            "A1 + l3 / (A r0) = 0: the forced part mu / Omega of p1, q1 is resonant",
        )
        self.forced = np.where(self.mu == 0, 0.0, self.mu / np.where(self.Omega == 0, 1.0, self.Omega))
        self.G0 = self.z / self.a - self.k * self.A1
        self.chi1, self.nu = -self.G0 / (1 + self.Omega), 1 / (1 + self.Omega)
        self.M3 = np.sqrt(1 - self.gamma0**2) / self.gamma0  # tan theta0 of equation (30)

    def of_shape(self, shape: tuple[int, ...]) -> FastSpin:
        """Return the body with all fields broadcast to one shape."""
        return FastSpin(*(np.broadcast_to(getattr(self, each.name), shape) for each in fields(self)))


def _raise_where(bad: Mask, reason: str) -> None:
    if np.any(bad):
        raise BadInput(reason)


def fast_spin(points: Points) -> FastSpin:
    """Return the paper's body at each point, with r0 and gamma0'' from the start. Raise BadInput unless A = B and Mg x0 = Mg y0 = 0."""
    inertia, rotor, weight, N = bodies(points)
    _raise_where(inertia[0] != inertia[1], "A != B: the paper's (5) and all that follows need A = B")
    _raise_where(weight[:2] != 0, "Mg x0 or Mg y0 is not 0: (1) needs the centre of mass on the third axis")
    state = initial_state(points)
    return FastSpin(inertia[0], inertia[2], weight[2], N, rotor[0], rotor[1], rotor[2], state[2], state[5])


def dimensional(spin: FastSpin, y: Array) -> Array:
    """Convert y by (4) to the state (p, q, r, gamma) of the equations of motion. The shape stays the same."""
    p, q, r, g1, g2, g3 = y
    unit, tilt = spin.scale, spin.gamma0
    return np.array([unit * p, unit * q, spin.r0 * r, tilt * g1, tilt * g2, tilt * g3])


def dimensionless(spin: FastSpin, state: Array) -> Array:
    """Convert the state (p, q, r, gamma) of the equations of motion to y by (4). The shape stays the same."""
    p, q, r, g1, g2, g3 = state
    unit, tilt = spin.scale, spin.gamma0
    return np.array([p / unit, q / unit, r / spin.r0, g1 / tilt, g2 / tilt, g3 / tilt])


def rhs(spin: FastSpin, y: Array) -> Array:
    """Return dy/dtau from (1), in the shape of y."""
    w, G, r, g3 = y[0] + 1j * y[1], y[3] + 1j * y[4], y[2], y[5]
    eps = spin.eps
    turn = spin.A1 * r + spin.l3 / (spin.A * spin.r0)
    dw = 1j * (turn * w - spin.mu * r + eps * (spin.z / spin.a - spin.k * spin.A1 * g3) * G)
    dG = -1j * r * G + 1j * eps * w * g3
    dr = eps**2 * spin.a * (w * spin.mu.conjugate()).imag
    return np.array([dw.real, dw.imag, dr, dG.real, dG.imag, eps * (w * G.conjugate()).imag])


def rate_of(spin: FastSpin) -> Callable[[float, Array], Array]:
    """Return `rhs` of one body as a function of time and state. Python's numbers are used, because they are faster than NumPy's."""
    numbers = {name: value.item() for name, value in vars(spin).items() if not isinstance(value, tuple)}
    one: Any = SimpleNamespace(**numbers)
    return lambda _, y: rhs(one, y.tolist())


def integrals(spin: FastSpin, y: Array) -> Array:
    """Return the first integrals from which (2) and (3) follow. They are the energy, the area integral and |gamma|^2, shape (3, ...)."""
    p, q, r, g1, g2, g3 = y
    y1, y2, y3 = spin.y
    transverse = g1**2 + g2**2
    potential = spin.k * (spin.a * transverse + g3**2) - 2 * spin.z * g3
    energy = r**2 + spin.eps**2 * (spin.a * (p**2 + q**2) + potential)
    area = r * g3 + spin.eps * (spin.a * (p * g1 + q * g2) + y1 * g1 + y2 * g2 + y3 * g3)
    return np.array([energy, area, transverse + g3**2])


def p2_gamma2(spin: FastSpin, y: Array) -> tuple[Array, Array]:
    """Return p2 = p1 - eps chi1 gamma2 and gamma2 = g1 - eps nu p2, which is (10) for chi = 0. If `y` is dy/dtau, return p2', gamma2'."""
    gamma2 = (y[3] - spin.eps * spin.nu * y[0]) / (1 - spin.eps**2 * spin.nu * spin.chi1)
    return y[0] - spin.eps * spin.chi1 * gamma2, gamma2


def to_quasilinear(spin: FastSpin, y: Array) -> Array:
    """Return (p2, p2', gamma2, gamma2') for y."""
    (p2, gamma2), (p2_dot, gamma2_dot) = p2_gamma2(spin, y), p2_gamma2(spin, rhs(spin, y))
    return np.array([p2, p2_dot, gamma2, gamma2_dot])


def quasilinear(spin: FastSpin, x: Array) -> Array:
    """Return dx/dtau from (15) to first order in eps. The forcing is Omega Re(mu) for p2'' and eps Re(mu) / (1 + Omega) for gamma2''."""
    p, p_dot, g, g_dot = x
    forcing = spin.Omega * spin.mu.real
    return np.array([p_dot, forcing - spin.Omega**2 * p, g_dot, spin.eps * spin.nu * spin.mu.real - g])


def frequency_shift(spin: FastSpin) -> Array:
    """Return the relative shift of the frequency of the periodic solution, which is of order eps^2."""
    return spin.eps**2 * (spin.G0 / (1 + spin.Omega) + 0.5 * np.abs(spin.forced) ** 2)


def period_correction(spin: FastSpin, turns: int = 1) -> Array:
    """Return alpha(eps) of (33). The periodic solution returns to its start at tau = T0 + alpha, where T0 is 2 pi times `turns`."""
    return -2 * np.pi * turns * frequency_shift(spin)


def first_order(spin: FastSpin, tau: Array) -> Array:
    """Return y, (6, ...), of the periodic solution (33) to first order in eps. The frequency includes the shift `frequency_shift`."""
    T = (1 + frequency_shift(spin)) * tau
    eps, M3, f = spin.eps, spin.M3, spin.forced
    cosine, sine = np.cos(T), np.sin(T)
    swing = f.real * (1 - cosine) + f.imag * sine
    return np.array(
        np.broadcast_arrays(
            f.real + eps * spin.chi1 * M3 * cosine,
            f.imag - eps * spin.chi1 * M3 * sine,
            1 - eps**3 * spin.a * spin.chi1 * M3 * spin.Omega * swing,
            M3 * cosine + eps * f.real * (1 - cosine),
            -M3 * sine + eps * (f.real * sine + f.imag),
            1 + eps * M3 * swing,
        )
    )


def general(spin: FastSpin, y0: Array, tau: Array) -> Array:
    """Return y, (6, ...), from any start y0 with r1 = g1'' = 1. The result is correct to first order in eps if tau is of order 1.

    The solution is w = mu/Omega + W exp(i Omega tau) + eps chi1 M exp(-i tau), G = M exp(-i tau) + eps (mu/Omega + nu W
    exp(i Omega tau)). W and M follow from the start.
    """
    eps, Omega, f = spin.eps, spin.Omega, spin.forced
    u, v = y0[0] + 1j * y0[1] - f, y0[3] + 1j * y0[4] - eps * f
    determinant = 1 - eps**2 * spin.chi1 * spin.nu
    W, M = (u - eps * spin.chi1 * v) / determinant, (v - eps * spin.nu * u) / determinant
    fast, spin_phase = np.exp(1j * Omega * tau), np.exp(-1j * tau)
    w = f + W * fast + eps * spin.chi1 * M * spin_phase
    G = M * spin_phase + eps * (f + spin.nu * W * fast)
    lag = spin_phase.conj() - 1
    g3 = y0[5] - eps * (M.conj() * f * lag + spin.nu * W * M.conj() * (fast * spin_phase.conj() - 1)).real
    r = y0[2] + eps**2 * spin.a * (W * f.conj() * (fast - 1) / 1j).imag
    return np.array(np.broadcast_arrays(w.real, w.imag, r, G.real, G.imag, g3))


def angles(spin: FastSpin, t: Array, h: float = 0.0, psi0: float = 0.0) -> Array:
    """Return theta, psi and phi of `first_order` at times t in s, by (34). The time `h` shifts the phase.

    Errors are of order eps^2 for tau = r0 t of order 1, and of order eps^3 in the secular rates.
    """
    theta0 = np.arccos(spin.gamma0)
    fast_rate = spin.r0 * (1 + frequency_shift(spin))
    f = spin.forced

    def swing(T: Array) -> Array:
        return -f.real * np.cos(T) + f.imag * np.sin(T)

    def sway(T: Array) -> Array:
        return f.real * np.sin(T) + f.imag * np.cos(T)

    T0, T = fast_rate * h, fast_rate * (np.asarray(t, float) + h)
    theta = theta0 - spin.eps * (swing(T) - swing(T0))
    psi = psi0 + secular_rate(spin) * t + spin.eps / np.sin(theta0) * (sway(T) - sway(T0))
    phi = np.pi / 2 + T - spin.eps / np.tan(theta0) * sway(T)
    return np.array(np.broadcast_arrays(theta, psi, phi))


def secular_rate(spin: FastSpin) -> Array:
    """Return the mean of psi' to the lowest order, -(Mg z0 - N (C - A) cos theta0) / (C r0 + l3), in rad per time unit."""
    return -(spin.weight - spin.N * (spin.C - spin.A) * spin.gamma0) / (spin.C * spin.r0 + spin.l3)


def dop853(
    rate: Callable[[float, Array], Array], span: tuple[float, float], y0: Array, **options: Any
) -> Any:
    """Return the result of solve_ivp by DOP853 at the tightest tolerances. `options` are passed to solve_ivp."""
    # scipy is imported here, because its import is slow and reading a scene needs the formulas alone.
    from scipy.integrate import solve_ivp

    return solve_ivp(rate, span, y0, **({"method": "DOP853", "rtol": 1e-13, "atol": 1e-14} | options))


def integrate(spin: FastSpin, y0: Array, tau: Array, **options: Any) -> Array:
    """Integrate the full equations (1) from y0, (6,), by `dop853`, and return y at the times tau, (6, k)."""
    span = (float(tau[0]), float(tau[-1]))
    return dop853(rate_of(spin), span, y0, t_eval=tau, **options).y


def paper_body(name: str, rotor: float | Array) -> FastSpin:
    """Return the body of section VI that has the key `name` in PAPER_BODIES, with l1 = l2 = l3 = `rotor` in N m s."""
    A, C = PAPER_BODIES[name]
    d = PAPER_DATA
    weight = d["M"] * d["lambda"] / d["R"] ** 2 * d["z0"]
    N = 3 * d["lambda"] / d["R"] ** 3
    return FastSpin(A, C, weight, N, rotor, rotor, rotor, d["r0"], d["gamma0"])


def paper_start(spin: FastSpin) -> Array:
    """Return y, (6,), at tau = 0 for the start (18), where p2 = C A1 y1 / A, p2' = gamma2' = 0 and r1 = g1'' = 1."""
    eps, p2 = spin.eps, spin.A1 * spin.mu.real
    q1 = spin.mu.imag / (spin.Omega + eps**2 * spin.G0)
    g2 = eps * q1
    g1 = np.sqrt(spin.M3**2 - g2**2)
    gamma2 = g1 - eps * spin.nu * p2
    ones = np.ones_like(p2)
    return np.array([p2 + eps * spin.chi1 * gamma2, q1, ones, g1, g2, ones])


def random_spin(rng: np.random.Generator, **given: float) -> FastSpin:
    """Return a random body in strong fields of force with a moderate spin. `given` replaces random values of attributes."""
    values = {
        "A": 1.0, "C": rng.uniform(1.2, 1.8), "weight": rng.uniform(1, 2), "N": rng.uniform(2, 4),
        "l1": rng.uniform(0.5, 1), "l2": rng.uniform(0.5, 1), "l3": rng.uniform(0.5, 1),
        "r0": rng.uniform(4, 8), "gamma0": rng.uniform(0.3, 0.7),
    }  # fmt: skip
    return FastSpin(*(values | given).values())


def paper_spin(rng: np.random.Generator) -> FastSpin:
    """Return a random one of the two bodies of section VI. The random rotor of 10 to 25 N m s keeps eps |mu / Omega| below 5e-3."""
    return _paper_spin(str(rng.choice(list(PAPER_BODIES))), rng.uniform(10, 25))


_paper_spin = cache(paper_body)  # one object for each body, so that results for its motion can be cached


def true_rate(spin: FastSpin, y: Array) -> Array:
    """Return dy/dtau from the equations of motion for a real or complex y, (6,)."""
    points = {name: np.full(1, parameter.default) for name, parameter in initial.PARAMETERS.items()}
    numbers = {
        "A": spin.A, "B": spin.A, "C": spin.C, "Mg": np.abs(spin.weight), "z0": spin.z, "N": spin.N,
        "l1": spin.l1, "l2": spin.l2, "l3": spin.l3,
    }  # fmt: skip
    points |= {name: np.full(1, float(value)) for name, value in numbers.items()}
    state = dimensional(spin, y)
    rate = equations.rhs(state, initial.constants(points)[:, 0])
    return dimensionless(spin, np.array(rate)) / spin.r0


def true_acceleration(spin: FastSpin, y: Array) -> Array:
    """Return d^2 y/dtau^2, (6,), from the equations of motion by a complex step, which is exact to rounding errors."""
    return true_rate(spin, y + 1e-30j * true_rate(spin, y)).imag / 1e-30


# The following functions compare the solution (33), printed or true, with the full equations at points of an atlas.

SAMPLES = 201  # number of instants of a run at which errors are computed
# Number of points that are integrated together. More points share the overhead of a step, but need more memory.
CHUNK = 512
# Largest number of evaluations of the equations for a chunk of points. The longest runs, of MAX_RADIANS, need less than half as many.
MAX_EVALUATIONS = 200_000


class _TooManyEvaluations(Exception):
    """Raised to end an integration that takes far more steps than the frequencies of its points explain."""


def errors(
    points: Points,
    duration: Array,
    solution: Callable[[FastSpin, Array], Array],
    pause: Callable[[], None] = lambda: None,
) -> tuple[Array, Array]:
    """Return the largest errors of gamma and of p + i q in a run. `solution` returns the states y of a body at times tau.

    An error of gamma is the distance of the solution's gamma from the exact gamma. A small error of gamma is an angle in rad. An
    error of p + i q is divided by the largest |p + i q|. Errors are nan where the run is longer than MAX_RADIANS, or a chunk cannot
    be integrated. The full equations are integrated from the initial value of the solution, with r0 and gamma0'' of the point. Thus
    errors are due to the formula. Points of a chunk share steps, so that digits of an error near 1e-12 depend on the other points.
    """
    angle, rate = np.full(duration.shape, np.nan), np.full(duration.shape, np.nan)
    with np.errstate(all="ignore"):
        for first in range(0, duration.size, CHUNK):
            part = np.arange(first, min(first + CHUNK, duration.size))
            chunk = subset(points, part)
            spin = fast_spin(chunk)
            state = dimensional(spin, solution(spin, np.zeros(part.shape)))
            from_solution = {**chunk, **dict(zip(initial.VECTORS, state, strict=True))}
            lengths = [radians(starts, duration[part]) for starts in (chunk, from_solution)]
            part = part[np.maximum(*lengths) <= MAX_RADIANS]
            if not part.size:
                continue
            spin = fast_spin(subset(points, part))
            tau = np.linspace(0.0, 1.0, SAMPLES)[:, None] * (spin.r0 * duration[part])
            approximate = solution(spin, tau)
            exact = _full(spin, approximate[:, 0], tau[-1], pause)
            angle[part] = (spin.gamma0 * np.sqrt(((approximate - exact)[3:] ** 2).sum(0))).max(0)
            size = np.hypot(exact[0], exact[1]).max(0)
            rate[part] = np.hypot(*(approximate - exact)[:2]).max(0) / size
    return angle, rate


def radians(points: Points, duration: Array) -> Array:
    """Return the duration times a bound of the fastest frequency, rad, (points,). The cost of a run is proportional to this product."""
    with np.errstate(all="ignore"):
        return np.asarray(initial.frequency_bound(points) * duration)


def _full(spin: FastSpin, y0: Array, end: Array, pause: Callable[[], None]) -> Array:
    """Integrate the full equations (1) for many points. Return y at SAMPLES instants up to tau = `end`, (6, SAMPLES, points)."""
    shape = y0.shape
    # Each point has a separate level of rounding errors, because p and q may be as large as 1e3 or as small as 1e-6.
    size = np.ones(shape)
    size[:2] = np.abs(spin.forced) + np.abs(spin.eps * spin.chi1) * spin.M3
    evaluations = 0

    def rate(_: float, y: Array) -> Array:
        nonlocal evaluations
        evaluations += 1
        if evaluations > MAX_EVALUATIONS:
            raise _TooManyEvaluations
        pause()
        return (end * rhs(spin, y.reshape(shape))).ravel()

    instants = np.linspace(0.0, 1.0, SAMPLES)
    try:
        solution = dop853(rate, (0.0, 1.0), y0.ravel(), atol=1e-14 * size.ravel(), t_eval=instants)
    except _TooManyEvaluations:
        solution = None
    if solution is None or not solution.success:
        return np.full((shape[0], SAMPLES, shape[1]), np.nan)
    return np.moveaxis(solution.y.reshape(*shape, SAMPLES), -1, 1)


def check(points: Points, duration: Array) -> None:
    """Raise BadInput for points at which the solution does not exist, and for runs longer than MAX_RADIANS."""
    with np.errstate(all="ignore"):
        fast_spin(points)
    length = radians(points, duration)
    too_long = ~(length <= MAX_RADIANS)
    if too_long.any():
        raise BadInput(
            f"the full equations are integrated for at most {MAX_RADIANS:g} rad of their fastest frequency, and"
            f" {too_long.sum()} of {too_long.size} points turn by up to {length.max():.3g}; shorten the duration"
        )
