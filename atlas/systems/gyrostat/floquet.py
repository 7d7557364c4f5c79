"""Floquet multipliers of steady motions whose linear equations are periodic in time, for many points at once.

The frame turns at Omega gamma, and the unit vectors alpha and gamma are at rest in the frame. A body with the angular velocity w
turns at u = w - Omega gamma relative to the frame. In a steady motion u is constant in body axes, and alpha, gamma and w turn
about u. A small rotation xi of the body changes these vectors by delta alpha = alpha x xi, delta gamma = gamma x xi and
delta w = xi' + w x xi. The Euler-Poisson equations then give

    I xi'' = D xi' + E xi,    D = hat(k + 2 I w - tr(I) w),    E = P + D'/2,    P symmetric,
    E = hat(I w + k) hat(w) - hat(w) I hat(w) - I hat(w') - the Hessian of the potential,

with the tensor of inertia I, the momentum k of the rotor and hat(v) a = v x a. These are Lagrange's equations for the Lagrangian
(xi'.I xi' - xi'.D xi + xi.P xi) / 2. In the variables xi and p = I xi' - D xi / 2 they are a linear Hamiltonian system of period
2 pi / |u|. Exponents come in pairs +-lambda.

One pair is 0, because xi = u is a solution (a shift in time) and the Jacobi integral is constant. Let e = u / |u|, d = D e / 2
and S = d e^T + e d^T, which is symmetric. The canonical momentum p~ = p + S xi is 0 for xi = u, and e.p~ is constant. The
parts of xi and p~ normal to e therefore form another Hamiltonian system,

    xi' = I^-1 (G xi + p~),    p~' = (P + S' - G^T I^-1 G) xi - G^T I^-1 p~,    G = D/2 - S,    e.p~ = 0,

which has the other pairs of exponents. `tests/systems/test_satellite_stability.py` compares them with the equations of motion.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from ...flags import Stability
from ..base import Array, Flags
from .body import Body, length, quadratic_roots
from .fundamental import of_harmonics

# Largest error, by rounding and integration, of |s| - 2 and (s1 - s2)^2 / 4, where s = multiplier + 1/multiplier. If multipliers
# collide at +-1, a shift of s by 1e-7 appears as growth by 3e-4 over a period.
TRACE_TOLERANCE = 1e-7
_STEP = 1.4  # largest product of step and norm of the system, which gives errors of about 1e-7
_MIN_STEPS, _MAX_STEPS = 64, 8192  # limits of the steps in a period; longer periods are treated as adiabatic
_ADIABATIC_PHASES = 256
# The adiabatic logarithm of the growth over a period is wrong by a few units. A logarithm above this value means instability.
_ADIABATIC_GROWTH = 10.0
# The adiabatic growth is 0 if the exponents at each fixed phase are farther from a collision than this multiple of 2 pi / period.
_ADIABATIC_MARGIN = 4.0
# For motions in closed form, steps = this number * period * largest norm of the matrix. Errors of traces are then below 1e-7.
_STEPS_PER_NORM = 2
_MIN_STEPS_CLOSED = 32


def stability(body: Body, w: Array, alpha: Array, gamma: Array) -> tuple[Flags, Array]:
    """Return stability and growth rate over the period of the rotation, (points,), for vectors of shape (points, 3).

    A motion is stable if all multipliers are simple and on the unit circle. If multipliers collide within numerical errors, the
    stability is unknown and the growth rate is 0. Periods too long to be integrated have the adiabatic growth rate.
    """
    rotation = _Rotation(body, w, alpha, gamma)
    stable, exponent = rotation.by_multipliers()
    slow = np.flatnonzero(np.isinf(rotation.steps))
    if slow.size:
        exponent[slow] = rotation.adiabatic_exponent(slow)
        stable[slow] = np.where(exponent[slow] > 0, Stability.UNSTABLE, Stability.STABLE)
    stable[np.isnan(exponent)] = Stability.UNKNOWN
    return stable, exponent / rotation.period * rotation.rate


def log_growth(body: Body, w: Array, alpha: Array, gamma: Array, duration: Array) -> Array:
    """Return the logarithm of the growth of a small distance over runs, (points,), or nan where too many steps are needed."""
    rotation = _Rotation(body, w, alpha, gamma, duration)
    return rotation.over_spans(np.full(duration.shape, np.nan), lambda _, log_scale: log_scale)


class _Periodic:
    """Periodic linear systems, given by a mean and two harmonics. Spans with infinite `steps` are not integrated."""

    def __init__(self, harmonics: NDArray[np.complex128], period: Array, span: Array, steps: Array):
        self.harmonics, self.period, self.span = harmonics, period, span
        self.steps = 2.0 ** np.ceil(np.log2(steps))

    def over_spans(self, result: Array, of: Callable[[Array, Array], Array]) -> Array:
        """Write into `result` what `of` returns for fundamental matrices and log scale factors of integrated points. Return `result`."""
        for count in np.unique(self.steps[np.isfinite(self.steps)]):
            members = np.flatnonzero(self.steps == count)
            part = self.harmonics[:, members], self.period[members], self.span[members]
            result[..., members] = of(*of_harmonics(*part, int(count)))
        return result

    def by_multipliers(self, ones: int = 0) -> tuple[Flags, Array]:
        """Return stability and the logarithm of the largest multiplier, or nan where the system is not integrated.

        The number of multipliers that are always 1 is `ones`.
        """
        values = np.full((2, *self.period.shape), np.nan)
        self.over_spans(values, lambda matrix, log_scale: np.array(_multipliers(matrix, log_scale, ones)))
        return np.nan_to_num(values[0]).astype(np.int8), values[1]


class _Rotation(_Periodic):
    def __init__(self, body: Body, w: Array, alpha: Array, gamma: Array, duration: Array | None = None):
        self.rate = np.abs(body.turn) + length(w)
        body, w = body.scaled(self.rate), w / self.rate[:, None]
        u = w - body.turn[:, None] * gamma
        size = length(u)
        axis, phases = u / size[:, None], 2 * np.pi * np.arange(5)[:, None, None] / 5

        def turned(v: Array) -> Array:
            along = (axis * v).sum(-1, keepdims=True) * axis
            return along + np.cos(phases) * (v - along) + np.sin(phases) * np.cross(v, axis)

        alpha, gamma = turned(alpha), turned(gamma)
        matrices = body.across_rotation(u + body.turn[:, None] * gamma, u, alpha, gamma)
        harmonics, period = np.fft.rfft(matrices, axis=0) / 5, 2 * np.pi / size
        span = period if duration is None else duration * self.rate
        # Root mean square of the system's norm over the period, in the units of xi and p in which this norm is least.
        square = (np.abs(harmonics) ** 2 * np.array([1, 2, 2])[:, None, None, None]).sum(0)
        square = square.reshape(-1, 2, 2, 2, 2).sum((2, 4))
        product = np.sqrt(square[:, 0, 1] * square[:, 1, 0])
        norm = np.sqrt(square[:, 0, 0] + square[:, 1, 1] + 2 * product)
        super().__init__(harmonics, period, span, np.maximum(span * norm / _STEP, _MIN_STEPS))
        self.steps[self.steps > _MAX_STEPS] = np.inf

    def adiabatic_exponent(self, members: NDArray[np.int64]) -> Array:
        """Return the logarithm of the growth over a period much longer than the oscillations, or nan if uncertain.

        The exponents at a fixed phase are the roots of lambda^4 + P lambda^2 + Q = 0. The logarithm is the integral of their largest
        real part. Where all roots are imaginary and far from a collision, the actions are adiabatic invariants and nothing grows.
        """
        period, harmonics = self.period[members], self.harmonics[:, members]
        total, margin = np.zeros(period.shape), np.full(period.shape, np.inf)
        for phase in np.exp(2j * np.pi * np.arange(_ADIABATIC_PHASES) / _ADIABATIC_PHASES):
            matrix = _matrix_at(harmonics, np.full(period.shape, phase))
            P = -0.5 * np.einsum("nij,nji->n", matrix, matrix)
            Q = np.linalg.det(matrix)
            total += np.sqrt(quadratic_roots(P, Q)).real.max(0)
            with np.errstate(divide="ignore", invalid="ignore"):
                distance = np.minimum(Q, 0.25 * P**2 - Q) / P**1.5 * period / (2 * np.pi)
            margin = np.fmin(margin, np.where(P > 0, distance, -np.inf))
        exponent = total * period / _ADIABATIC_PHASES
        certain = np.where(margin > _ADIABATIC_MARGIN, 0.0, np.nan)
        return np.where(exponent > _ADIABATIC_GROWTH, exponent, certain)


def _matrix_at(harmonics: NDArray[np.complex128], phase: NDArray[np.complex128]) -> Array:
    """Return matrices at the phase factors `phase` = exp(i angle), (..., points), as sums of a mean and two harmonics."""
    mean, first, second = harmonics
    phase = phase[..., None, None]
    return np.asarray(mean.real + 2 * (first * phase + second * phase**2).real)


def _multipliers(monodromy: Array, log_scale: Array, ones: int) -> tuple[Flags, Array]:
    """Return stability and the logarithm of the largest multiplier of the matrices monodromy * exp(log_scale).

    The number of multipliers equal to 1 is `ones`. The others form one or two reciprocal pairs.
    """
    # Traces are accurate for multipliers on the unit circle, but lose small multipliers beside large ones.
    moderate = log_scale < 16
    largest = np.ones(log_scale.shape)
    largest[~moderate] = np.abs(np.linalg.eigvals(monodromy[~moderate])).max(-1)
    matrix = monodromy * np.exp(np.where(moderate, log_scale, 0.0))[:, None, None]
    trace = np.trace(matrix, axis1=1, axis2=2) - ones
    if matrix.shape[1] - ones == 2:
        s, discriminant = trace[None] + 0j, np.full(trace.shape, np.inf)
    else:
        product = 0.5 * (trace**2 - np.einsum("nij,nji->n", matrix, matrix)) - 2
        discriminant = 0.25 * trace**2 - product
        root = np.sqrt(discriminant.astype(complex))
        s = np.array([0.5 * trace + root, 0.5 * trace - root])  # multiplier + 1/multiplier of the two pairs
    with np.errstate(divide="ignore"):
        by_eigenvalue = np.log(largest) + log_scale
    exponent = np.where(moderate, np.abs(np.arccosh(s / 2).real).max(0), by_eigenvalue)
    outside = np.where(discriminant < 0, -discriminant, np.abs(s.real).max(0) - 2)
    inside = (np.abs(s.real).max(0) < 2 - TRACE_TOLERANCE) & (discriminant > TRACE_TOLERANCE)
    unstable = ~moderate | (outside > TRACE_TOLERANCE * np.maximum(1.0, trace**2))
    stable = np.select([unstable, inside], [Stability.UNSTABLE, Stability.STABLE], Stability.UNKNOWN)
    return stable.astype(np.int8), np.where(unstable, exponent, 0.0)


def growth_of_periodic_motion(
    matrix: Callable[[np.ndarray, Array], Array], period: Array
) -> tuple[Flags, Array]:
    """Return stability and the growth rate log |mu| / period of periodic motions with two reduced degrees of freedom.

    The linear system of six equations has four multipliers 1, which belong to a shift in time, the energy and two integrals
    such as the area integral and the length of the vertical. These integrals are linear or quadratic in the state. The other
    multipliers are mu and 1/mu, so that the trace of the monodromy matrix is 4 + mu + 1/mu. The eigenvalue 1 is defective. The trace
    is therefore accurate where eigenvalues are not. A motion is stable if mu is on the unit circle and not real.

    The function `matrix` takes indices of points, and times (samples, points). The result (samples, points, 6, 6) is the matrix of
    the linear system in three rates and the vertical, with harmonics up to the second. Where `period` is nan, stability is unknown.
    """
    stable, growth = np.full(period.shape, Stability.UNKNOWN, np.int8), np.full(period.shape, np.nan)
    where = np.flatnonzero(np.isfinite(period))
    if not where.size:
        return stable, growth
    samples = matrix(where, period[where] * np.arange(5)[:, None] / 5)
    # This unit of time balances the two off-diagonal blocks. It is rounded to a power of 2, so that no bits change.
    square = (samples**2).reshape(5, -1, 2, 3, 2, 3).sum((0, 3, 5))
    rates, vertical = square[:, 0, 1], square[:, 1, 0]
    quotient = np.divide(rates, vertical, out=np.ones_like(rates), where=rates * vertical > 0)
    unit = 2.0 ** np.round(np.log2(quotient) / 4)[:, None, None]
    samples[..., :3, 3:] /= unit
    samples[..., 3:, :3] *= unit
    harmonics, quarters = np.fft.rfft(samples, axis=0) / 5, np.array([1, 1j, -1, -1j])[:, None]
    norms = np.sqrt((_matrix_at(harmonics, np.repeat(quarters, where.size, axis=1)) ** 2).sum((-2, -1)))
    steps = np.maximum(_STEPS_PER_NORM * norms.max(0) * period[where], _MIN_STEPS_CLOSED)
    system = _Periodic(harmonics, period[where], period[where], steps)
    stable[where], growth[where] = system.by_multipliers(ones=4)
    return stable, growth / period
