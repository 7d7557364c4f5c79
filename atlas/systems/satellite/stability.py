"""Linear stability of the steady motions of the satellite.

A steady motion turns the body relative to the orbital frame with a constant u = w' in body axes, so
alpha, gamma and w = u + Omega gamma turn about u (they stand still if u = 0). A small rotation xi of the
body (body axes; delta alpha = alpha x xi, delta gamma = gamma x xi) obeys
delta w = xi' + w x xi, and with the Euler-Poisson equations of (1)-(3)

    I xi'' = D xi' + E xi,    D = hat(k + 2 I w - tr(I) w),    E = P + D'/2,    P symmetric,
    E = hat(I w + k) hat(w) - hat(w) I hat(w) - I hat(w') + 3 Omega^2 (hat(a) I hat(a) - hat(I a) hat(a))
        - hat(mu) hat(h1 a + h3 g),

Lagrange's equations of (xi'.I xi' - xi'.D xi + xi.P xi) / 2. In (xi, p), p = I xi' - D xi / 2, this is a
linear Hamiltonian system in the six tangent directions of |alpha| = |gamma| = 1, alpha.gamma = 0:
autonomous at an equilibrium, else of period 2 pi / |u|. Exponents come in pairs +-lambda.
`tests/systems/test_satellite_stability.py` compares it with the equations of motion.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ...flags import Stability
from ..base import Array, Flags, Points, stability_by_family
from .families import FAMILIES, classify_growth
from .initial import initial_state

# Multipliers at 1 have the square root of the integration error as their error.
FLOQUET_TOLERANCE = 20.0  # in units of families.GROWTH_TOLERANCE
_STEP = 0.35  # of the Floquet integration, over the norm of the system: errors of about 1e-9
_MAX_STEPS = 2048  # periods of rotation that need more steps are not integrated
_CHUNK = 2048  # points whose exponents are computed together


def cross_matrix(v: Array) -> Array:
    """Matrices of v x ., shape (..., 3, 3)."""
    zero = np.zeros_like(v[..., 0])
    rows = ((zero, -v[..., 2], v[..., 1]), (v[..., 2], zero, -v[..., 0]), (-v[..., 1], v[..., 0], zero))
    return np.stack([np.stack(row, -1) for row in rows], -2)


class Bodies:
    """Bodies and fields in units of their largest moment of inertia and of a rate: vectors (..., 3)."""

    def __init__(self, points: Points, rate: Array):
        def vectors(*names: str) -> Array:
            return np.stack([points[name] for name in names], -1)

        self.inertia = vectors("A", "B", "C")
        largest = self.inertia.max(-1)
        unit = (largest * rate**2)[..., None]
        self.inertia = self.inertia / largest[..., None]
        self.k = vectors("k1", "k2", "k3") / (largest * rate)[..., None]
        mu = vectors("mu1", "mu2", "mu3")
        self.radial, self.normal = points["h1"][..., None] * mu / unit, points["h3"][..., None] * mu / unit
        self.Omega = (points["Omega"] / rate)[..., None]

    def gradient(self, alpha: Array, gamma: Array) -> tuple[Array, Array]:
        """Gradient and Hessian of the amended potential under rotations xi; the torque at rest is -gradient.

        W = V - Omega k.gamma - Omega^2 gamma.I gamma / 2 with V of (3). The Hessian is symmetric where
        the gradient vanishes.
        """
        by_alpha = 3 * self.Omega**2 * self.inertia * alpha + self.radial
        by_gamma = self.normal - self.Omega * self.k - self.Omega**2 * self.inertia * gamma
        a, g, inertia = cross_matrix(alpha), cross_matrix(gamma), self.inertia[..., None]
        square = self.Omega[..., None] ** 2
        hessian = cross_matrix(by_alpha) @ a + cross_matrix(by_gamma) @ g
        hessian = hessian - square * (3 * a @ (inertia * a) - g @ (inertia * g))
        return np.cross(by_alpha, alpha) + np.cross(by_gamma, gamma), hessian

    def potential(self, alpha: Array, gamma: Array) -> Array:
        """Amended potential, see gradient."""
        square = self.Omega**2
        parts = 1.5 * square * self.inertia * alpha**2 - 0.5 * square * self.inertia * gamma**2
        return (parts + self.radial * alpha + (self.normal - self.Omega * self.k) * gamma).sum(-1)

    def linearised(self, w: Array, u: Array, alpha: Array, gamma: Array) -> Array:
        """Matrix of the linear system in (xi, p), shape (..., 6, 6)."""
        inertia = self.inertia[..., None]
        momentum = self.inertia * w + self.k
        W, a = cross_matrix(w), cross_matrix(alpha)
        accel = cross_matrix(self.Omega * np.cross(gamma, u))
        D = cross_matrix(momentum + self.inertia * w - self.inertia.sum(-1, keepdims=True) * w)
        E = cross_matrix(momentum) @ W - W @ (inertia * W) - inertia * accel
        E = E + 3 * self.Omega[..., None] ** 2 * (a @ (inertia * a) - cross_matrix(self.inertia * alpha) @ a)
        # hat(mu) hat(H), with the products h1 mu and h3 mu
        E = E - cross_matrix(self.radial) @ a - cross_matrix(self.normal) @ cross_matrix(gamma)
        P = 0.5 * (E + np.swapaxes(E, -1, -2))
        left = 0.5 * D / inertia
        right = -np.swapaxes(left, -1, -2)
        inverse = np.broadcast_to(np.eye(3), D.shape) / inertia
        top = np.concatenate([left, inverse], -1)
        return np.concatenate([top, np.concatenate([P + 0.5 * D @ left, right], -1)], -2)


def linear_stability(points: Points, flags: Flags) -> tuple[Flags, Array]:
    """Spectral stability of the steady motion that each point starts.

    The closed form of the family is used where it has one, else the eigenvalues at an equilibrium, else the
    Floquet multipliers over the period of the rotation. A motion is stable if no exponent grows beyond
    round-off, GROWTH_TOLERANCE of the rates of the point (FLOQUET_TOLERANCE times that for multipliers). The
    pair of exponents 0 of a turning body (a shift in time) is removed exactly; any other double root, which
    grows like a power of t, counts as stable. The stability is unknown for rotations so slow that a period
    contains more oscillations than are integrated.

    Parameters
    ----------
    points : mapping
        1-D arrays of one length.
    flags : int8 array (points,)
        Families, as identify_family gives them.

    Returns
    -------
    stable : int8 array (points,)
        Values of flags.Stability; unknown off every family.
    growth_rate : array (points,)
        Largest real part of the characteristic exponents, rad per time unit; exactly 0 if stable, nan if
        unknown.
    """
    stable, growth = stability_by_family(FAMILIES, points, flags)
    remaining = np.flatnonzero((flags > 0) & (stable == Stability.UNKNOWN))
    for first in range(0, remaining.size, _CHUNK):
        chunk = remaining[first : first + _CHUNK]
        stable[chunk], growth[chunk] = exponents({name: value[chunk] for name, value in points.items()})
    return stable, growth


def exponents(points: Points) -> tuple[Flags, Array]:
    """Stability and growth rate as linear_stability, from eigenvalues or multipliers alone; 1-D points."""
    rate = sum(np.abs(points[name]) for name in ("Omega", "n", "m"))
    rate = np.where(rate == 0, 1.0, rate)
    state = np.moveaxis(initial_state({**points, "theta_dot0": np.zeros_like(points["A"])}), 0, -1)
    u = state[:, :3] - points["Omega"][:, None] * state[:, 6:]
    turn_rate = np.sqrt((u**2).sum(-1))
    growth = np.full(rate.shape, np.nan)
    rest = np.flatnonzero(turn_rate <= 1e-12 * rate)
    if rest.size:
        bodies = Bodies({name: value[rest] for name, value in points.items()}, rate[rest])
        w, alpha, gamma = np.split(state[rest], 3, -1)
        w = w / rate[rest, None]
        matrix = bodies.linearised(w, np.zeros_like(w), alpha, gamma)
        finite = np.isfinite(matrix).all((1, 2))  # squares of the smallest rates underflow
        growth[rest[finite]] = np.linalg.eigvals(matrix[finite]).real.max(-1) * rate[rest[finite]]
    stable, growth = classify_growth(growth, rate)
    moving = np.flatnonzero(turn_rate > 1e-12 * rate)
    if moving.size:
        part = {name: value[moving] for name, value in points.items()}
        floquet = _floquet_growth(part, rate[moving], turn_rate[moving])
        stable[moving], growth[moving] = classify_growth(floquet, FLOQUET_TOLERANCE * rate[moving])
    return stable, growth


def _floquet_growth(points: Points, rate: Array, turn_rate: Array) -> Array:
    """Growth rate from the Floquet multipliers over the period 2 pi / turn_rate."""
    phases = 2 * np.pi * np.arange(5) / 5
    harmonics = np.fft.rfft(_system_at(points, rate, turn_rate, phases), axis=0) / 5
    # Root mean square of the norm over the period.
    norm = np.sqrt((np.abs(harmonics) ** 2 * np.array([1, 2, 2])[:, None, None, None]).sum((0, 2, 3)))
    period = 2 * np.pi * rate / turn_rate
    steps = 2.0 ** np.ceil(np.log2(np.maximum(period * norm / _STEP, 16)))
    growth = np.full(rate.shape, np.nan)
    for count in np.unique(steps[steps <= _MAX_STEPS]):
        members = np.flatnonzero(steps == count)
        monodromy = _monodromy(harmonics[:, members], period[members], int(count))
        with np.errstate(over="ignore", invalid="ignore"):
            exponent = np.abs(np.arccosh(_traces(monodromy) / 2).real).max(0)
        # Traces of multipliers beyond the square root of the largest float overflow.
        exponent = np.where(np.isfinite(exponent), exponent, np.log(np.abs(monodromy).max((1, 2))))
        growth[members] = exponent / period[members] * rate[members]
    return growth


def _system_at(points: Points, rate: Array, turn_rate: Array, phases: Array) -> Array:
    """Linear system at phases of the rotation, (phases, points, 6, 6); it consists of a mean and two harmonics."""
    t = phases[:, None] / turn_rate
    moved = {name: np.broadcast_to(value, t.shape) for name, value in points.items()}
    moved["psi0"], moved["phi0"] = points["psi0"] + points["n"] * t, points["phi0"] + points["m"] * t
    moved["theta_dot0"] = np.zeros(t.shape)
    w, alpha, gamma = np.split(np.moveaxis(initial_state(moved), 0, -1), 3, -1)
    u = w - moved["Omega"][..., None] * gamma
    scale = rate[:, None]
    bodies = Bodies(moved, np.broadcast_to(rate, t.shape))
    return bodies.linearised(w / scale, u / scale, alpha, gamma)


def _monodromy(harmonics: NDArray[np.complex128], period: Array, count: int) -> Array:
    """Fundamental matrix over one period: Magnus' series of order 6, symplectic exponentials.

    harmonics: mean, first and second, shape (3, points, 6, 6). The diagonal Pade approximation keeps
    the multipliers of a stable motion on the unit circle. Blanes et al., Phys. Rep. 470 (2009) 151.
    """
    h = (period / count)[:, None, None]
    identity = np.eye(6)
    result = np.broadcast_to(identity, harmonics.shape[1:])
    for i in range(count):
        first, middle, last = (
            h * (harmonics[0].real + 2 * (harmonics[1] * phase + harmonics[2] * phase**2).real)
            for phase in np.exp(2j * np.pi * (i + 0.5 + np.sqrt(0.15) * np.array([-1, 0, 1])) / count)
        )
        b2, b3 = np.sqrt(15) / 3 * (last - first), 10 / 3 * (last - 2 * middle + first)
        c1 = middle @ b2 - b2 @ middle
        inner = 2 * b3 + c1
        c2 = (inner @ middle - middle @ inner) / 60
        x, y = -20 * middle - b3 + c1, b2 + c2
        z = middle + b3 / 12 + (x @ y - y @ x) / 240
        square = z @ z
        even, odd = identity + square / 10, z @ (identity / 2 + square / 120)
        result = np.linalg.solve(even - odd, (even + odd) @ result)
    return result


def _traces(monodromy: Array) -> NDArray[np.complex128]:
    """s = multiplier + 1/multiplier of the two pairs beside the pair at 1, shape (2, points)."""
    first = np.trace(monodromy, axis1=1, axis2=2)
    second = 0.5 * (first**2 - np.einsum("nij,nji->n", monodromy, monodromy))
    half, product = 0.5 * (first - 2), second - 2 * first + 1
    root = np.sqrt((half**2 - product).astype(complex))
    return np.array([half + root, half - root])
