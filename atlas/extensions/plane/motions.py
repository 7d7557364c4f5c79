"""Motions in the plane, where the third axis stays on the vertical and the body librates or rotates about it like a pendulum.

Let alpha = (cos x, -sin x, 0), where x is the pitch. The rotor and the field of gamma lie along the third axis e3. The vector alpha
has no field, and a gradient g > 0. Then C x'' = -g (B - A) sin x cos x. For A < B the pitch may librate about 0, with
sin x = k sn(f t), x' = f k cn(f t) and f^2 = g (B - A)/C. Otherwise the body rotates, with x = am(f t), x' = f dn(f t) and
k^2 f^2 = g (B - A)/C. For B < A the first two axes change places, and x is counted from pi/2.

A small rotation xi = (xi_1, xi_2) out of the plane and p = I xi' - D xi / 2 obey the equations of `gyrostat.floquet`, which hold
along any motion. Let w3 be the angular velocity along e3, v = k3 + (C - A - B) w3, h = (field of gamma).gamma and alpha = (a1, a2, 0). Then

    xi_1' = (p_1 - v xi_2 / 2)/A,    p_1' = P11 xi_1 + P12 xi_2 - v xi_2'/2,    P11 = (B - C)(w3^2 + g a2^2) - k3 w3 + h,
    xi_2' = (p_2 + v xi_1 / 2)/B,    p_2' = P12 xi_1 + P22 xi_2 + v xi_1'/2,    P22 = (A - C)(w3^2 + g a1^2) - k3 w3 + h,
    P12 = g a1 a2 (2 C - A - B - (B - A)^2 / C) / 2.

Only P12 is odd in x. If H maps deviations at x = 0 to deviations a time t later, R H^-1 R with R = diag(-1, 1, 1, -1) maps
deviations a time t earlier to deviations at x = 0. For a libration and t = half a period the eigenvalues of R H^-1 R H are the
multipliers. For a rotation and t = a quarter of a turn the squares of the eigenvalues are the multipliers. H is symplectic, so
that H^-1 = -J H^T J loses no digits.
"""

from __future__ import annotations

from itertools import product
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...flags import Stability
from ...systems.base import Array, Flags, Mask
from ...systems.gyrostat.body import Body, length
from ...systems.gyrostat.fundamental import GAUSS, LANES, of_steps
from .elliptic import EllipticFunctions


class _Steps(NamedTuple):
    """Numbers of steps in a quarter of the period. `multiplier_sums` extrapolates from these numbers to infinitely many steps."""

    shortest: float  # length of the shortest steps times the norm of the matrix of the linear equations
    counts: tuple[int, ...]  # ratio of each number of steps to the least number of steps
    most: int  # `multiplier_sums` is nan if the least number of steps exceeds `most`

    def weights(self) -> Array:
        """Return the weights of the sums in two extrapolations, one with all numbers of steps, and one without the least number."""
        size, result = len(self.counts), np.zeros((2, len(self.counts)))
        for k, weights in enumerate(result):
            errors = np.array(self.counts[k:]) ** -np.array([[0.0], [6], [8], [10]])[: size - k]
            weights[k:] = np.linalg.solve(errors, np.eye(size - k)[0])
        return result


# The errors of `multiplier_sums` are about 1e-7 with _ROUGH and 1e-15 with _FINE.
_ROUGH, _FINE = _Steps(1.2, (1, 2), 725), _Steps(0.283, (1, 2, 3, 4), 182)
_MIN_STEPS = 4
_MAX_LOG_SUM = 170.0  # exp(4 * 170) is a finite float
_MAX_ROUNDING = 1e-7  # The period is unknown where 1 - k^2 has a larger relative error, near the separatrix.
_TOLERANCE = 1e-11  # relative error that short steps leave in expressions that vanish on borders of stability
# The error of a sum is taken as _CHANGE times the change of the sum if the longest steps are left out. Measured factors are below 0.3.
_CHANGE = 3.2
# For R H^-1 R of the module's text, exchange the upper and lower half of H^T, then the left and right half, and multiply by _SIGNS.
_SIGNS = np.kron([[1.0, -1.0], [-1.0, 1.0]], np.ones((2, 2))) * np.outer([-1, 1, 1, -1], [-1, 1, 1, -1])


class PlaneMotions(NamedTuple):
    """Motions of bodies in the plane, as arrays (points,). The units of moments and of rates are powers of 2."""

    unit: Array  # unit of rates
    low: Array  # A, the moment of inertia about the axis that is along alpha at the pitch x = 0
    high: Array  # B, the moment of inertia about the axis normal to the axes of A and C
    axial: Array  # C, the moment of inertia about the third axis e3
    rotor: Array
    gradient: Array
    field: Array  # h, the component of the field along the vertical gamma
    frame: Array  # angular velocity along e3 of a body at rest in the frame
    symmetric: Mask  # whether the first or second axis is an axis of symmetry, so that two multipliers are 1
    rotates: Mask
    frequency: Array  # f, which has the sign of the pitch rate x' in a rotation
    modulus: Array  # k^2
    complement: Array  # 1 - k^2, which is 0 on the separatrix
    rounding: Array  # relative rounding error of 1 - k^2
    sine: Array  # sine of the pitch x at the start
    cosine: Array  # cosine of the pitch x at the start
    start_rate: Array  # rate x' of the pitch at the start

    @classmethod
    def of(cls, body: Body, w: Array, alpha: Array, gamma: Array) -> PlaneMotions:
        """Return the motions from starts with the vectors `w`, `alpha` and `gamma`, (points, 3)."""
        moment, unit = (
            np.exp2(np.round(np.log2(each))) for each in (body.inertia.max(-1), np.abs(body.turn) + length(w))
        )
        A, B, C = body.inertia.T / moment
        frame, gradient = body.turn / unit * gamma[:, 2], body.alpha.gradient / unit**2
        rate, (first, second, _) = w[:, 2] / unit - frame, alpha.T
        sine, cosine = np.where(A < B, (-second, first), (first, second))
        stiffness = gradient * np.abs(B - A) / C
        kinetic, up, down = rate**2, stiffness * cosine**2, stiffness * sine**2
        rotates = kinetic > up
        square = np.where(rotates, kinetic + down, stiffness)
        return cls(
            unit, np.minimum(A, B), np.maximum(A, B), C, body.rotor[:, 2] / (moment * unit), gradient,
            body.gamma.field[:, 2] * gamma[:, 2] / (moment * unit**2), frame,
            body.symmetric_about(0) | body.symmetric_about(1), rotates,
            np.where(rotates, np.sign(rate), 1.0) * np.sqrt(square),
            np.where(rotates, stiffness, kinetic + down) / square, np.abs(up - kinetic) / square,
            np.finfo(float).eps * (up + kinetic) / np.abs(up - kinetic), sine, cosine, rate,
        )  # fmt: skip

    def subset(self, where: NDArray[np.int64]) -> PlaneMotions:
        return PlaneMotions._make(values[where] for values in self)

    @property
    def mean(self) -> EllipticFunctions:
        """The elliptic functions with the moduli of the motions."""
        return EllipticFunctions.of(self.modulus, self.complement)

    def period(self) -> Array:
        """Return the period 4 K/f of a libration or a whole turn, in time units. K is the complete elliptic integral, f = |frequency|."""
        return 2 * np.pi / (self.mean.a[-1] * np.abs(self.frequency) * self.unit)

    def start_turns(self) -> Array:
        """Return the time from x = 0 (or x = pi, for librations about pi) to the start, in periods."""
        from scipy.special import elliprf

        k, sign = np.sqrt(self.modulus), np.sign(np.where(self.rotates, self.frequency, self.cosine))
        sn = sign * self.sine / np.where(self.rotates, 1.0, k)
        cn = np.where(self.rotates, self.cosine, self.start_rate / (k * self.frequency))
        time = sn * elliprf(cn**2, self.complement + self.modulus * cn**2, 1.0)
        turns = time * self.mean.a[-1] / (2 * np.pi)
        return np.where(cn < 0, np.copysign(0.5, sn) - turns, turns)

    def at(self, turns: Array) -> tuple[Array, Array, Array]:
        """Return values `turns` periods after x = 0: x without its mean rotation, x' divided by `frequency`, and Jacobi's zeta function."""
        (sn, cn, dn), (amplitude, zeta) = self.mean.functions(turns), self.mean.periodic(turns)
        k = np.sqrt(self.modulus)
        angle = np.where(self.rotates, amplitude, np.arctan2(k * sn, dn))
        return angle, np.where(self.rotates, dn, k * cn), zeta

    def pitch(self, time: Array) -> tuple[Array, Array]:
        """Return x in rad, not reduced to a turn, and x' in rad per time unit, at times (..., points) or (..., 1) in time units."""
        turns = self.start_turns() + time / self.period()
        angle, rate, _ = self.at(turns)
        turned = np.sign(self.frequency) * (2 * np.pi * turns + angle)
        swung = angle + np.where(self.cosine < 0, np.pi, 0.0)
        return np.where(self.rotates, turned, swung), self.frequency * self.unit * rate

    def rate_std(self, duration: Array) -> Array:
        """Return the standard deviation of x' over runs, in rad per time unit. The duration inf stands for whole periods."""
        f, mean, span = np.abs(self.frequency), self.mean, duration * self.unit
        start, turns = self.start_turns(), np.where(np.isfinite(duration), duration / self.period(), 0.0)
        angles, _, zeta = self.at(np.array([start, start + turns]))
        # `square` is the variance of x' over whole periods. A part of a period adds `slope` to mean x' and `ends` to mean x'^2.
        square = np.where(self.rotates, mean.squares(1.5), 0.5 * self.modulus + mean.squares(0.0)) * f**2
        slope, ends = (angles[1] - angles[0]) / span, f * (zeta[1] - zeta[0]) / span
        variance = square + ends - np.where(self.rotates, 2 * mean.a[-1] * f * slope, 0.0) - slope**2
        return np.sqrt(np.maximum(variance, 0.0)) * self.unit

    def stability(self, rough: bool = False) -> tuple[Flags, Array]:
        """Return stability out of the plane and growth rates. With `rough`, multipliers far from stability borders have errors up to 1e-7.

        Let t be the sum of the multipliers, and u the sum of the products of two multipliers. The sums rho = multiplier + 1/multiplier obey
        rho^2 - t rho + u - 2 = 0. All rho are real and in (-2, 2) if and only if t^2/4 - u + 2, u + 2 -+ 2 t and 16 - t^2 are positive.
        """
        stable, exponent = self._verdict(_ROUGH)
        # As in `multipliers`, multiplier sums with the steps _FINE give the verdicts near borders and, unless `rough`, all growth rates.
        undecided = (stable == Stability.UNKNOWN) | ((not rough) & (stable == Stability.UNSTABLE))
        finer = np.flatnonzero(undecided & ~np.isnan(exponent))
        flags, exponents = self.subset(finer)._verdict(_FINE)
        in_time = ~np.isnan(exponents) | (stable[finer] == Stability.UNKNOWN)
        stable[finer[in_time]], exponent[finer[in_time]] = flags[in_time], exponents[in_time]
        return stable, exponent / self.period()

    def _verdict(self, steps: _Steps) -> tuple[Flags, Array]:
        """Return stability and the growth's logarithm over a period. The logarithm is 0 unless growth is certain, and nan if unknown."""
        t, u, log_scale, *changes = self.multiplier_sums(steps)
        one = np.exp(-log_scale)  # This is 1 / c. `multiplier_sums` divides t by c and u by c^2.
        square, middle = one**2, u + 2 * one**2
        positive = np.array(
            [t**2 / 4 - u + 2 * square, middle - 2 * t * one, middle + 2 * t * one, 16 * square - t**2]
        )
        positive = np.where(self.symmetric, np.array([4 * one - t, t, t, t]) * one, positive)
        size = np.maximum(one, np.abs(t))
        error = _TOLERANCE * size**2 + _CHANGE * (4 * size * changes[0] + changes[1])
        unstable = (positive < -error).any(0)
        flags = np.select([unstable, (positive > error).all(0)], [Stability.UNSTABLE, Stability.STABLE])
        t, s, log_scale = self._over_period(t, u, log_scale)
        one = np.exp(-log_scale)
        root = np.sqrt(t**2 / 4 - s + 2 * one**2 + 0j)
        rho = np.where(self.symmetric, (2 * one, t - 2 * one), (t / 2 + root, t / 2 - root))
        # The larger multiplier is (rho + r)/2 with r = sqrt(rho - 2) sqrt(rho + 2). For rho < -2, sqrt(rho^2 - 4) is -r.
        doubled = np.abs(rho + np.sqrt(rho - 2 * one) * np.sqrt(rho + 2 * one)).max(0)
        exponent = np.maximum(log_scale + np.log(doubled / 2), 0.0)
        return flags.astype(np.int8), np.where(unstable | np.isnan(t), exponent, 0.0)

    def multipliers(self) -> tuple[Array, Array]:
        """Return t and s of rho^2 - t rho + s - 2 = 0. The roots are rho = mu + 1/mu for the multipliers mu over a period."""
        t, s, log_scale = self._over_period(*self.multiplier_sums(_FINE)[:3])
        return t * np.exp(log_scale), s * np.exp(2 * log_scale)

    def _over_period(self, t: Array, u: Array, log_scale: Array) -> Array:
        """Return t / c, s / c^2 and log(c) for t and s of `multipliers`, from `multiplier_sums`. The scale c prevents overflow."""
        kept = np.where(log_scale < _MAX_LOG_SUM, 0.0, log_scale)
        t, u, one = t * np.exp(log_scale - kept), u * np.exp(2 * (log_scale - kept)), np.exp(-kept)
        # If half a turn has rho = mu + 1/mu for a multiplier mu, the whole turn has mu^2 + 1/mu^2 = rho^2 - 2.
        turn = t**2 - 2 * u, u**2 - 2 * (t * one) ** 2 + 2 * one**4, 2 * kept
        return np.where(self.rotates, turn, (t, u, kept))

    def multiplier_sums(self, steps: _Steps) -> Array:
        """Return t / c, u / c^2, log(c), and the changes of t / c and u / c^2 if the longest steps are left out, (5, points).

        t is the trace of the matrix over a libration or half a turn, u the second characteristic coefficient of the matrix, and c a scale.
        All are nan near the separatrix and if too many steps are needed.
        """
        A, B, C, g, f = self.low, self.high, self.axial, self.gradient, np.abs(self.frequency)
        fastest = np.abs(self.frame) + f * np.where(self.rotates, 1.0, np.sqrt(self.modulus))
        stiffness = np.maximum(np.abs(B - C), np.abs(A - C)) * (fastest**2 + g) + np.abs(self.field)
        stiffness = np.sqrt((stiffness + np.abs(self.rotor) * fastest) / A)
        norm = stiffness + 0.5 * (np.abs(self.rotor) + np.abs(C - A - B) * fastest) / A
        longest = (
            np.maximum(0.25 * self.period() * self.unit * norm / steps.shortest, _MIN_STEPS)
            / steps.counts[-1]
        )
        longest = np.ceil(2.0 ** (np.ceil(4 * np.log2(longest)) / 4))
        longest[~(self.rounding < _MAX_ROUNDING)] = np.nan
        weights = steps.weights()[..., None, None]
        result = np.full((5, f.size), np.nan)
        for least, rotates in product(np.unique(longest[longest <= steps.most]).astype(int), (False, True)):
            members = np.flatnonzero((longest == least) & (self.rotates == rotates))
            width = min(members.size, LANES)
            nodes = [np.zeros((n * least * (1 if rotates else 2), 3, 4, 4, width)) for n in steps.counts]
            for first in range(0, members.size, LANES):
                some = members[first : first + LANES]
                lanes = self.subset(np.resize(some, width))
                mean = lanes.mean
                sums = np.array([lanes._sums(rotates, mean, each) for each in nodes])
                log_scale = sums[-1:, 2]
                sums[:, :2] *= np.exp((sums[:, 2:] - log_scale) * np.array([[1.0], [2.0]]))
                value, shorter = (weights * sums[:, :2]).sum(1)
                result[:, some] = np.concatenate([value, log_scale, np.abs(value - shorter)])[:, : some.size]
        return result

    def _sums(self, rotates: bool, mean: EllipticFunctions, matrices: Array) -> Array:
        """Return t / c, u / c^2 and log(c) of `multiplier_sums`, (3, LANES). Write the coefficients of the equations into `matrices`."""
        A, B, C, g, f = self.low, self.high, self.axial, self.gradient, self.frequency
        count = len(matrices) // (1 if rotates else 2)
        nodes = np.arange(count)[:, None] + 0.5 + GAUSS * np.array([-1, 0, 1])
        sn, cn, dn = mean.functions(nodes[..., None] / (4 * count))
        if rotates:
            a1, a2, w3 = cn, -np.sign(f) * sn, self.frame + f * dn
        else:  # In the second quarter of a period, sn and dn run backwards. So does cn, with the opposite sign.
            k = np.sqrt(self.modulus)
            a1, a2, rate = dn, -k * sn, f * k * cn
            w3 = np.concatenate([self.frame + rate, self.frame - rate[::-1, ::-1]])
            a1, a2 = (np.concatenate([x, x[::-1, ::-1]]) for x in (a1, a2))
        step = 0.5 * np.pi / (mean.a[-1] * np.abs(f) * count)
        half = 0.5 * (self.rotor + (C - A - B) * w3)
        square, both, common = w3 * w3, half * half, self.field - self.rotor * w3
        matrices[:, :, 0, 2], matrices[:, :, 1, 3] = step / A, step / B
        for value, places in (
            (half, ((0, 1, -step / A), (1, 0, step / B), (2, 3, -step / B), (3, 2, step / A))),
            ((B - C) * (square + g * a2 * a2) + common - both / B, ((2, 0, step),)),
            ((A - C) * (square + g * a1 * a1) + common - both / A, ((3, 1, step),)),
            (a1 * a2 * (0.5 * g * (2 * C - A - B - (B - A) ** 2 / C)), ((2, 1, step), (3, 0, step))),
        ):
            for i, j, factor in places:
                np.multiply(value, factor, out=matrices[:, :, i, j])
        # There are always LANES points, because the order of the sums below may depend on the number of points.
        H, log_scale = (np.resize(each, (LANES, *each.shape[1:])) for each in of_steps(matrices))
        matrix = (np.swapaxes(H, 1, 2)[:, [[2], [3], [0], [1]], [2, 3, 0, 1]] * _SIGNS) @ H
        trace = np.trace(matrix, axis1=1, axis2=2)
        return np.array([trace, 0.5 * (trace**2 - np.einsum("nij,nji->n", matrix, matrix)), 2 * log_scale])
