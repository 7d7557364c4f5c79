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

Of a turning body one pair is 0: xi = u is a solution (a shift in time), and the Jacobi integral is constant.
With e = u / |u|, d = D e / 2 and the symmetric S = d e^T + e d^T, the canonical p~ = p + S xi vanishes on that
solution and keeps e.p~ constant, so the parts of xi and p~ across e form a Hamiltonian system of their own,

    xi' = I^-1 (G xi + p~),    p~' = (P + S' - G^T I^-1 G) xi - G^T I^-1 p~,    G = D/2 - S,    e.p~ = 0,

with the other two pairs of exponents.
`tests/systems/test_satellite_stability.py` compares it with the equations of motion.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ...flags import Stability
from ..base import Array, Flags, Points, stability_by_family, subset
from ..floquet import magnus_propagator
from .closed_stability import classify_growth, quartic_growth
from .families import FAMILIES
from .initial import directions, initial_state

# Multipliers at 1 have the square root of the integration error as their error.
FLOQUET_TOLERANCE = 20.0  # in units of closed_stability.GROWTH_TOLERANCE
_STEP = 1.4  # of the Floquet integration, over the norm of the system: errors of about 1e-7
_MIN_STEPS, _MAX_STEPS = 64, 8192  # in a period of rotation; longer periods are not integrated but adiabatic
# Steps and points that are computed together; the steps are fixed, so that no result depends on the other points.
_BLOCK, _POINTS = 256, 16
_CHUNK = 2048  # points whose exponents are computed together
_ADIABATIC_PHASES = 256
# Growth over a period, as a logarithm, beyond which the adiabatic approximation decides; it is wrong by a few units.
_ADIABATIC_GROWTH = 10.0
# Growth over a run, as a logarithm, up to which amplitudes may change without an instability.
_AMPLITUDE_GROWTH = 10.0
# Distance of the frozen exponents from a collision, over the rate of rotation, beyond which none grows.
_ADIABATIC_MARGIN = 4.0


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
        self.damping = points["damping"] / (largest * rate)

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

    def _forces(self, w: Array, u: Array, alpha: Array, gamma: Array) -> tuple[Array, Array, Array]:
        """Vectors v and v' of D = hat(v) and D' = hat(v'), shape (..., 3), and the matrix P, (..., 3, 3)."""
        inertia = self.inertia[..., None]
        momentum = self.inertia * w + self.k
        W, a = cross_matrix(w), cross_matrix(alpha)
        acceleration = self.Omega * np.cross(gamma, u)
        spread = 2 * self.inertia - self.inertia.sum(-1, keepdims=True)
        E = cross_matrix(momentum) @ W - W @ (inertia * W) - inertia * cross_matrix(acceleration)
        E = E + 3 * self.Omega[..., None] ** 2 * (a @ (inertia * a) - cross_matrix(self.inertia * alpha) @ a)
        # hat(mu) hat(H), with the products h1 mu and h3 mu
        E = E - cross_matrix(self.radial) @ a - cross_matrix(self.normal) @ cross_matrix(gamma)
        P = 0.5 * (E + np.swapaxes(E, -1, -2))
        return self.k + spread * w, spread * acceleration, P

    def linearised(self, w: Array, alpha: Array, gamma: Array) -> Array:
        """Matrix of the linear system of a body at rest in the orbital frame in (xi, p), shape (..., 6, 6)."""
        v, _, P = self._forces(w, np.zeros_like(w), alpha, gamma)
        return _hamiltonian(P, 0.5 * cross_matrix(v), self.inertia, np.eye(3))

    def with_damping(self, matrix: Array) -> Array:
        """The matrix of `linearised` with the torque -damping xi', which acts on p."""
        damping = self.damping[..., None, None]
        torque = np.concatenate([np.zeros_like(matrix[..., :3, :]), matrix[..., :3, :]], -2)
        return np.where(damping > 0, matrix - damping * torque, matrix)

    def reduced(self, w: Array, u: Array, alpha: Array, gamma: Array) -> Array:
        """Matrix of the linear system of a turning body in the parts of (xi, p~) across u, shape (..., 4, 4).

        u is constant, of shape (points, 3).
        """
        v, v_dot, P = self._forces(w, u, alpha, gamma)
        along = u / np.sqrt((u**2).sum(-1, keepdims=True))
        first = np.cross(along, np.eye(3)[np.abs(along).argmin(-1)])
        first = first / np.sqrt((first**2).sum(-1, keepdims=True))
        across = np.stack([first, np.cross(along, first)], -2)

        def symmetric(d: Array) -> Array:
            product = d[..., :, None] * along[..., None, :]
            return product + np.swapaxes(product, -1, -2)

        shift = symmetric(0.5 * np.cross(v, along))
        shift_dot = symmetric(0.5 * np.cross(v_dot, along))
        return _hamiltonian(P + shift_dot, 0.5 * cross_matrix(v) - shift, self.inertia, across)


def _hamiltonian(P: Array, G: Array, inertia: Array, basis: Array) -> Array:
    """Matrix of xi' = I^-1 (G xi + p), p' = (P - G^T I^-1 G) xi - G^T I^-1 p along the rows of a basis."""
    transposed = np.swapaxes(basis, -1, -2)
    left = G / inertia[..., None]
    blocks = (
        (left, np.eye(3) / inertia[..., None]),
        (P - np.swapaxes(G, -1, -2) @ left, -np.swapaxes(left, -1, -2)),
    )
    return np.concatenate(
        [np.concatenate([basis @ block @ transposed for block in row], -1) for row in blocks], -2
    )


def linear_stability(points: Points, flags: Flags) -> tuple[Flags, Array]:
    """Spectral stability of the steady motion that each point starts.

    The closed form of the family is used where it has one and nothing is damped, else the eigenvalues at an equilibrium, else the
    Floquet multipliers over the period of the rotation. A motion is stable if no exponent grows beyond
    round-off, GROWTH_TOLERANCE of the rates of the point (FLOQUET_TOLERANCE times that for multipliers). The
    pair of exponents 0 of a turning body (a shift in time) is removed exactly; any other double root, which
    grows like a power of t, counts as stable. Rotations of which a period contains more oscillations than are
    integrated have the adiabatic growth rate; their stability is unknown where it is close to a boundary.

    points: 1-D arrays of one length; flags: families, as identify_family gives them. Returns stable, values
    of flags.Stability; unknown off every family; growth_rate, largest real part of the characteristic
    exponents, rad per time unit; exactly 0 if stable, nan if unknown.
    """
    stable, growth = stability_by_family(FAMILIES, points, flags)
    damped = points["damping"] > 0  # the closed forms are without it
    stable[damped], growth[damped] = Stability.UNKNOWN, np.nan
    remaining = np.flatnonzero((flags > 0) & (stable == Stability.UNKNOWN))
    for first in range(0, remaining.size, _CHUNK):
        chunk = remaining[first : first + _CHUNK]
        stable[chunk], growth[chunk] = exponents(subset(points, chunk))
    return stable, growth


def growth_about_vertical(points: Points) -> Array:
    """Growth rate of the pitch of a body whose third axis stays on the orbit's normal, see System; (points,).

    C psi'' = -U'(psi) - damping psi' with U = (3 Omega^2 alpha.I alpha) / 2 + h1 mu.alpha. A body that turns there
    has U' = 0 and no damping.
    """
    alpha = directions(points)[0]
    flatness = 3 * points["Omega"] ** 2 * (points["B"] - points["A"])
    magnet = points["h1"] * (points["mu1"] * alpha[0] + points["mu2"] * alpha[1])
    curvature = flatness * (alpha[0] ** 2 - alpha[1] ** 2) - magnet
    undamped = np.sqrt(np.maximum(-curvature / points["C"], 0.0))
    half = 0.5 * points["damping"] / points["C"]
    return np.hypot(half, undamped) - half


def log_growth(points: Points, flags: Flags, growth_rate: Array, duration: Array) -> Array:
    """Growth over a run as System.log_growth.

    A run that is shorter than the period of the linear system may meet its unstable phases alone: there it is the
    growth from the start to the end of the run, where that is larger than changes of the amplitude.
    """
    result = growth_rate * duration
    state, rate, turn_rate = _rotation(points)
    where = np.flatnonzero((flags > 0) & (turn_rate > 1e-12 * rate) & (turn_rate * duration < 2 * np.pi))
    if where.size:
        part = subset(points, where)
        where = where[stability_by_family(FAMILIES, part, flags[where])[0] == Stability.UNKNOWN]
    for first in range(0, where.size, _CHUNK):
        chunk = where[first : first + _CHUNK]
        part = subset(points, chunk)
        phases = _floquet_growth(part, rate[chunk], turn_rate[chunk], duration[chunk]) * duration[chunk]
        result[chunk] = np.where(phases > _AMPLITUDE_GROWTH, np.fmax(result[chunk], phases), result[chunk])
    return result


def _rotation(points: Points) -> tuple[Array, Array, Array]:
    """State (points, 9) of the steady motion, its unit of rates, and the rate of its rotation in the frame."""
    rate = sum(np.abs(points[name]) for name in ("Omega", "n", "m"))
    rate = np.where(rate == 0, 1.0, rate)
    state = np.moveaxis(initial_state({**points, "theta_dot0": np.zeros_like(points["A"])}), 0, -1)
    u = state[:, :3] - points["Omega"][:, None] * state[:, 6:]
    return state, rate, np.sqrt((u**2).sum(-1))


def exponents(points: Points) -> tuple[Flags, Array]:
    """Stability and growth rate as linear_stability, from eigenvalues or multipliers alone; 1-D points."""
    state, rate, turn_rate = _rotation(points)
    growth = np.full(rate.shape, np.nan)
    # With damping a steady motion is at rest but for rounding.
    resting = (turn_rate <= 1e-12 * rate) | (points["damping"] > 0)
    rest = np.flatnonzero(resting)
    if rest.size:
        bodies = Bodies(subset(points, rest), rate[rest])
        w, alpha, gamma = np.split(state[rest], 3, -1)
        w = w / rate[rest, None]
        matrix = bodies.with_damping(bodies.linearised(w, alpha, gamma))
        finite = np.isfinite(matrix).all((1, 2))  # squares of the smallest rates underflow
        growth[rest[finite]] = np.linalg.eigvals(matrix[finite]).real.max(-1) * rate[rest[finite]]
    stable, growth = classify_growth(growth, rate)
    moving = np.flatnonzero(~resting)
    if moving.size:
        part = subset(points, moving)
        floquet = _floquet_growth(part, rate[moving], turn_rate[moving])
        stable[moving], growth[moving] = classify_growth(floquet, FLOQUET_TOLERANCE * rate[moving])
    return stable, growth


def _floquet_growth(points: Points, rate: Array, turn_rate: Array, duration: Array | None = None) -> Array:
    """Growth rate from the Floquet multipliers over the period 2 pi / turn_rate; or the mean one over a duration."""
    phases = 2 * np.pi * np.arange(5) / 5
    harmonics = np.fft.rfft(_system_at(points, rate, turn_rate, phases), axis=0) / 5
    period = 2 * np.pi * rate / turn_rate
    span = period if duration is None else duration * rate
    steps = 2.0 ** np.ceil(np.log2(np.maximum(span * _norm(harmonics) / _STEP, _MIN_STEPS)))
    exponent = np.full(rate.shape, np.nan)  # over the span
    for count in np.unique(steps[steps <= _MAX_STEPS]):
        members = np.flatnonzero(steps == count)
        for first in range(0, members.size, _POINTS):
            part = members[first : first + _POINTS]
            matrix, log_scale = _fundamental_matrix(harmonics[:, part], period[part], span[part], int(count))
            exponent[part] = _exponent(matrix, log_scale) if duration is None else log_scale
    slow = np.flatnonzero(steps > _MAX_STEPS)
    if slow.size and duration is None:
        exponent[slow] = _adiabatic_exponent(harmonics[:, slow], period[slow])
    return exponent / span * rate


def _exponent(monodromy: Array, log_scale: Array) -> Array:
    """Logarithm of the largest multiplier of the fundamental matrix monodromy * exp(log_scale)."""
    largest = np.abs(np.linalg.eigvals(monodromy)).max(-1)
    # Traces give multipliers on the unit circle exactly, and lose the smaller ones beside large ones.
    moderate = log_scale < 16
    traces = _traces(monodromy * np.exp(np.where(moderate, log_scale, 0.0))[:, None, None])
    with np.errstate(divide="ignore"):
        by_eigenvalue = np.log(largest) + log_scale
    return np.where(moderate, np.abs(np.arccosh(traces / 2).real).max(0), by_eigenvalue)


def _adiabatic_exponent(harmonics: NDArray[np.complex128], period: Array) -> Array:
    """Growth over a period that is long against all other times, as a logarithm; nan where it is not certain.

    The integral of the largest real part of the exponents lambda of the system frozen at each phase,
    lambda^4 + P lambda^2 + Q = 0. Where no frozen exponent grows and none comes close to a collision, the actions
    of both oscillations are adiabatic invariants: nothing grows.
    """
    total, margin = np.zeros(period.shape), np.full(period.shape, np.inf)
    for phase in np.exp(2j * np.pi * np.arange(_ADIABATIC_PHASES) / _ADIABATIC_PHASES):
        matrix = harmonics[0].real + 2 * (harmonics[1] * phase + harmonics[2] * phase**2).real
        P = -0.5 * np.einsum("nij,nji->n", matrix, matrix)
        Q = np.linalg.det(matrix)
        total += quartic_growth(P, Q)
        with np.errstate(divide="ignore", invalid="ignore"):
            distance = np.minimum(Q, 0.25 * P**2 - Q) / P**1.5 * period / (2 * np.pi)
        margin = np.fmin(margin, np.where(P > 0, distance, -np.inf))
    exponent = total * period / _ADIABATIC_PHASES
    certain = np.where(margin > _ADIABATIC_MARGIN, 0.0, np.nan)
    return np.where(exponent > _ADIABATIC_GROWTH, exponent, certain)


def _norm(harmonics: NDArray[np.complex128]) -> Array:
    """Root mean square over the period of the system's norm, in units of xi and p that make it least."""
    square = (np.abs(harmonics) ** 2 * np.array([1, 2, 2])[:, None, None, None]).sum(0)
    square = square.reshape(-1, 2, 2, 2, 2).sum((2, 4))
    return np.sqrt(square[:, 0, 0] + square[:, 1, 1] + 2 * np.sqrt(square[:, 0, 1] * square[:, 1, 0]))


def _system_at(points: Points, rate: Array, turn_rate: Array, phases: Array) -> Array:
    """Reduced linear system at phases of the rotation, (phases, points, 4, 4); it consists of a mean and two harmonics."""
    t = phases[:, None] / turn_rate
    moved = {name: np.broadcast_to(value, t.shape) for name, value in points.items()}
    moved["psi0"], moved["phi0"] = points["psi0"] + points["n"] * t, points["phi0"] + points["m"] * t
    moved["theta_dot0"] = np.zeros(t.shape)
    w, alpha, gamma = np.split(np.moveaxis(initial_state(moved), 0, -1), 3, -1)
    scale = rate[:, None]
    u = w[0] - points["Omega"][:, None] * gamma[0]
    bodies = Bodies(moved, np.broadcast_to(rate, t.shape))
    return bodies.reduced(w / scale, u / scale, alpha, gamma)


def _fundamental_matrix(
    harmonics: NDArray[np.complex128], period: Array, span: Array, count: int
) -> tuple[Array, Array]:
    """Fundamental matrix over a span, (points, 4, 4): a matrix of largest entry 1, and the logarithm of its factor."""
    result = np.broadcast_to(np.eye(4), harmonics.shape[1:])
    log_scale = np.zeros(period.shape)
    block = min(count, _BLOCK)  # both are powers of two
    for first in range(0, count, block):
        steps = _propagators(harmonics, period, span / count, np.arange(first, first + block))
        log_scales = np.zeros(steps.shape[:2])
        while len(steps) > 1:
            steps = steps[1::2] @ steps[::2]
            size = np.abs(steps).max((-2, -1))
            steps = steps / size[..., None, None]
            log_scales = log_scales[1::2] + log_scales[::2] + np.log(size)
        result = steps[0] @ result
        size = np.abs(result).max((-2, -1))
        result = result / size[:, None, None]
        log_scale += log_scales[0] + np.log(size)
    return result, log_scale


def _propagators(
    harmonics: NDArray[np.complex128], period: Array, step: Array, index: NDArray[np.int64]
) -> Array:
    """Fundamental matrices over some steps.

    harmonics: mean, first and second, shape (3, points, 4, 4); index of each step; result (steps, points, 4, 4).
    """
    h = step[:, None, None]
    nodes = index + 0.5 + np.sqrt(0.15) * np.array([[-1], [0], [1]])
    phases = np.exp(2j * np.pi * nodes[..., None] * (step / period))
    first, middle, last = (
        h * (harmonics[0].real + 2 * (harmonics[1] * phase + harmonics[2] * phase**2).real)
        for phase in phases[..., None, None]
    )
    return magnus_propagator(first, middle, last)


def _traces(monodromy: Array) -> NDArray[np.complex128]:
    """s = multiplier + 1/multiplier of the two pairs, shape (2, points)."""
    trace = np.trace(monodromy, axis1=1, axis2=2)
    product = 0.5 * (trace**2 - np.einsum("nij,nji->n", monodromy, monodromy)) - 2
    root = np.sqrt((0.25 * trace**2 - product).astype(complex))
    return np.array([0.5 * trace + root, 0.5 * trace - root])
