"""Linear stability of the steady motions of the satellite, and its relative equilibria.

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
`tests/test_satellite_stability.py` holds it against the equations of motion.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..base import Array, Flags, Points, stability_by_family
from .families import FAMILIES, verdict
from .initial import initial_state

# Multipliers at 1 carry the square root of the integration error.
FLOQUET_TOLERANCE = 20.0  # in units of conditions.GROWTH_TOLERANCE
_STEP = 0.35  # of the Floquet integration, over the norm of the system: errors of about 1e-9
_MAX_STEPS = 2048  # a slower rotation has more libration periods in it than are worth integrating
_BLOCK = 2048


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
        most = self.inertia.max(-1)
        unit = (most * rate**2)[..., None]
        self.inertia = self.inertia / most[..., None]
        self.k = vectors("k1", "k2", "k3") / (most * rate)[..., None]
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


def linear_stability(points: Points, family_flags: Flags) -> tuple[Flags, Array]:
    """Spectral stability of the steady motion that each point starts.

    points: 1-D arrays of one length; family_flags: their families as conditions.recognise gives them.
    Returns (stable, growth_rate): 1 stable, 2 unstable, 0 unknown, and the largest real part of the
    characteristic exponents in rad per time unit (exactly 0 if stable, nan if unknown or off every
    family). Closed forms where the family has one, else the eigenvalues at an equilibrium, else the
    Floquet multipliers over the period of the rotation. Stable is: no exponent grows beyond round-off,
    GROWTH_TOLERANCE of the point's rates (FLOQUET_TOLERANCE times that for multipliers). The pair of
    exponents 0 of a turning body (a shift in time) is taken out exactly and any other double root that
    grows like a power of t counts as stable. Unknown: rotations so slow that a period holds more
    oscillations than are integrated.
    """
    stable, growth = stability_by_family(FAMILIES, points, family_flags)
    left = np.flatnonzero((family_flags > 0) & (stable == 0))
    for first in range(0, left.size, _BLOCK):
        here = left[first : first + _BLOCK]
        stable[here], growth[here] = exponents({name: value[here] for name, value in points.items()})
    return stable, growth


def exponents(points: Points) -> tuple[Flags, Array]:
    """Stability and growth rate of steady motions from eigenvalues or multipliers alone; 1-D points."""
    rate = sum(np.abs(points[name]) for name in ("Omega", "n", "m"))
    rate = np.where(rate == 0, 1.0, rate)
    state = np.moveaxis(initial_state({**points, "theta_dot0": np.zeros_like(points["A"])}), 0, -1)
    u = state[:, :3] - points["Omega"][:, None] * state[:, 6:]
    turn = np.sqrt((u**2).sum(-1))
    growth = np.full(rate.shape, np.nan)
    rest = np.flatnonzero(turn <= 1e-12 * rate)
    if rest.size:
        bodies = Bodies({name: value[rest] for name, value in points.items()}, rate[rest])
        w, alpha, gamma = np.split(state[rest], 3, -1)
        w = w / rate[rest, None]
        matrix = bodies.linearised(w, np.zeros_like(w), alpha, gamma)
        finite = np.isfinite(matrix).all((1, 2))  # squares of the smallest rates underflow
        growth[rest[finite]] = np.linalg.eigvals(matrix[finite]).real.max(-1) * rate[rest[finite]]
    stable, growth_rest = verdict(growth, rate)
    moving = np.flatnonzero(turn > 1e-12 * rate)
    if moving.size:
        part = {name: value[moving] for name, value in points.items()}
        multiplied = _floquet(part, rate[moving], turn[moving])
        stable[moving], growth_rest[moving] = verdict(multiplied, FLOQUET_TOLERANCE * rate[moving])
    return stable, growth_rest


def _floquet(points: Points, rate: Array, turn: Array) -> Array:
    """Growth rate over the period 2 pi / turn."""
    phases = 2 * np.pi * np.arange(5) / 5
    harmonics = np.fft.rfft(_system_at(points, rate, turn, phases), axis=0) / 5
    # The norm over the period, from the mean: the harmonics add to it like perturbations.
    norm = np.sqrt((np.abs(harmonics) ** 2 * np.array([1, 2, 2])[:, None, None, None]).sum((0, 2, 3)))
    period = 2 * np.pi * rate / turn
    steps = 2.0 ** np.ceil(np.log2(np.maximum(period * norm / _STEP, 16)))
    growth = np.full(rate.shape, np.nan)
    for count in np.unique(steps[steps <= _MAX_STEPS]):
        here = np.flatnonzero(steps == count)
        monodromy = _monodromy(harmonics[:, here], period[here], int(count))
        with np.errstate(over="ignore", invalid="ignore"):
            exponent = np.abs(np.arccosh(_traces(monodromy) / 2).real).max(0)
        # multipliers beyond the square root of the largest float
        exponent = np.where(np.isfinite(exponent), exponent, np.log(np.abs(monodromy).max((1, 2))))
        growth[here] = exponent / period[here] * rate[here]
    return growth


def _system_at(points: Points, rate: Array, turn: Array, phases: Array) -> Array:
    """Linear system at phases of the rotation, shape (phases, points, 6, 6); two harmonics and a mean."""
    t = phases[:, None] / turn
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
    one = np.eye(6)
    result = np.broadcast_to(one, harmonics.shape[1:])
    for i in range(count):
        first, middle, last = (
            h * (harmonics[0].real + 2 * (harmonics[1] * turn + harmonics[2] * turn**2).real)
            for turn in np.exp(2j * np.pi * (i + 0.5 + np.sqrt(0.15) * np.array([-1, 0, 1])) / count)
        )
        b2, b3 = np.sqrt(15) / 3 * (last - first), 10 / 3 * (last - 2 * middle + first)
        c1 = middle @ b2 - b2 @ middle
        inner = 2 * b3 + c1
        c2 = (inner @ middle - middle @ inner) / 60
        x, y = -20 * middle - b3 + c1, b2 + c2
        z = middle + b3 / 12 + (x @ y - y @ x) / 240
        square = z @ z
        even, odd = one + square / 10, z @ (one / 2 + square / 120)
        result = np.linalg.solve(even - odd, (even + odd) @ result)
    return result


def _traces(monodromy: Array) -> NDArray[np.complex128]:
    """s = multiplier + 1/multiplier of the two pairs beside the pair at 1, shape (2, points)."""
    first = np.trace(monodromy, axis1=1, axis2=2)
    second = 0.5 * (first**2 - np.einsum("nij,nji->n", monodromy, monodromy))
    half, product = 0.5 * (first - 2), second - 2 * first + 1
    root = np.sqrt((half**2 - product).astype(complex))
    return np.array([half + root, half - root])
