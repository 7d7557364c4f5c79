"""Linear stability, small oscillations and stability by the energy of motions that are equilibria in some frame.

A motion that is no equilibrium may be equivalent to an equilibrium of another body. Let a body turn about an axis of symmetry,
with rotor and fields along this axis and the rotation u relative to the frame. It is equivalent to a body at rest with the
rotor k_i + I_i u_i, because I_i enters the motion of the axis only through the constant momentum I_i w_i + k_i. Where nothing
acts along alpha, the rate of the frame about gamma may be chosen. Where nothing acts at all, the vertical is chosen along the
angular momentum. Other turning bodies have periodic linear equations (`floquet`). The frequencies of these equations are
defined only up to multiples of the rate of rotation and are not given.

At an equilibrium a small turn xi of the body (delta d = d x xi for both directions d of the frame) obeys

    I xi'' = v x xi' - W'' xi,    v = k + 2 I w - tr(I) w,    w = Omega gamma,

where W is the amended potential. The squares x of the characteristic exponents are therefore the roots of the cubic

    det(x I + W'') + x v.(x I + W'') v = 0.

If a turn xi = e about the vertical or the axis of symmetry changes nothing, e is a cyclic direction. Then xi = e is a solution
and the momentum e.(I xi' - v x xi) is constant, so that two exponents are 0. Both belong to neighbouring steady motions with
other momenta and do not concern stability, but rounding would turn them into a pair +-1e-8. For each cyclic direction the
lowest coefficient of the cubic, which is 0, is therefore left out with the root 0.

The Jacobi integral is xi'.I xi' / 2 + W, so that an equilibrium is stable by energy where W'' is positive definite (Lagrange,
Dirichlet). If the momenta about cyclic directions E are constant, the Hessian at fixed momenta decides instead. It is
W'' + F (E^T I E)^-1 F^T with F = v x E (Routh, Rumyantsev). Damping destroys the momenta and does not change W. Dissipation
inside the body conserves the momentum about an axis of symmetry of the frame, but not of the body (see `energy_minima`).
Frequencies are computed without damping.
P. C. Hughes, Spacecraft Attitude Dynamics (1986), chapters 9 and 10; V. V. Rumyantsev, J. Appl. Math. Mech. 30 (1966) 1090;
N. G. Chetaev, The Stability of Motion, Pergamon 1961.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...flags import EnergyStability, Stability
from ..base import FAMILY_TOLERANCE, Array, Flags, Mask
from .body import Body, cross_matrix, length, quadratic_roots, transverse_axes

# Exponents that differ by less than this, in units of Body.rate, count as equal. Rounding by r changes a double root by sqrt(r).
GROWTH_TOLERANCE = 1e-6
_PARALLEL = 1e-9  # largest sine of the angle between axes that count as parallel
_ZERO = 1e-6  # frequencies and real parts below this fraction of the largest exponent are zero


class Equilibria(NamedTuple):
    """Motions that are equilibria in some frame, in units of the largest moment of inertia and of `rate`."""

    points: NDArray[np.int64]  # indices of the given motions that are equilibria
    body: Body
    alpha: Array  # (points, 3)
    gamma: Array
    rate: Array  # unit of rates, rad per time unit, (points,)
    # Vertical and axis of symmetry, (points, 3, 2). Directions about which turns change the energy are 0. A repeated direction is 0.
    cyclic: Array
    free: Mask  # where nothing acts and gamma is chosen along the angular momentum

    @classmethod
    def of(cls, body: Body, w: Array, alpha: Array, gamma: Array, from_space: bool = True) -> Equilibria:
        """Return the equilibria among motions whose vectors at the start are `w`, `alpha` and `gamma`, (points, 3).

        Where the axis of symmetry is vertical and nothing acts along alpha, the frame rests in space if `from_space` is true. If
        `from_space` is false, the frame turns so that the two oscillations of the axis are equally fast and the Hessian is largest.
        """
        body, w, alpha, gamma = _redrawn(body, w, alpha, gamma)
        rate = body.rate(w)
        any_frame = ~body.acts_across()
        turn, axis, exists = _turn_and_axis(body, w, gamma, rate, any_frame, from_space)
        free = any_frame & ~exists & ~body.acts_along(body.gamma)
        if free.any():
            momentum = body.inertia * w + body.rotor
            size = length(momentum)[:, None]
            along = np.where(size > 0, momentum / np.where(size > 0, size, 1.0), w / rate[:, None])
            gamma = np.where(free[:, None], along, gamma)
            other = _turn_and_axis(body, w, gamma, rate, any_frame, from_space)
            turn, axis, exists = (
                np.where(free, b, a) for a, b in zip((turn, axis, exists), other, strict=True)
            )
        points = np.flatnonzero(exists)
        unit = np.eye(3)[axis] * (axis >= 0)[:, None]
        rotor = body.rotor + unit * body.inertia * (w - turn[:, None] * gamma)
        asleep = any_frame & (length(gamma * (1 - unit)) <= FAMILY_TOLERANCE)
        free |= asleep & ~body.acts_along(body.gamma)
        vertical = np.where(any_frame[:, None], gamma, 0.0)
        cyclic = np.stack([vertical, np.where(asleep[:, None], 0.0, unit)], -1)
        some = points if points.size < rate.size else slice(None)
        equivalent = body._replace(turn=turn, rotor=rotor).subset(some).scaled(rate[some])
        return cls(points, equivalent, alpha[some], gamma[some], rate[some], cyclic[some], free[some])

    def squared_exponents(self) -> NDArray[np.complex128]:
        """Return squared characteristic exponents without damping, (points, 3), nan for cyclic directions, inf after overflows."""
        inertia, v = self.body.inertia, self.body.gyroscopic(self.body.turn[:, None] * self.gamma)
        hessian = self.body.hessian(self.alpha, self.gamma)
        diagonal = np.diagonal(hessian, axis1=1, axis2=2)
        following = [1, 2, 0], [2, 0, 1]
        minors = diagonal[:, following[0]] * diagonal[:, following[1]] - hessian[:, *following] ** 2
        products = inertia[:, following[0]] * inertia[:, following[1]]
        volume = inertia.prod(1)
        P = (diagonal * products + inertia * v**2).sum(1) / volume
        Q = ((inertia * minors).sum(1) + (v * (hessian @ v[..., None])[..., 0]).sum(1)) / volume
        degree = 3 - (self.cyclic != 0).any(1).sum(1)
        Q = np.where(degree == 1, 0.0, Q)
        result = np.full((len(v), 3), np.nan, complex)
        result[:, 0], second = quadratic_roots(P, Q)
        result[degree > 1, 1] = second[degree > 1]
        cubic = np.flatnonzero(degree == 3)
        companion = np.zeros((cubic.size, 3, 3))
        companion[:, (1, 2), (0, 1)] = 1.0
        companion[:, :, -1] = -np.stack(
            [np.linalg.det(hessian[cubic]) / volume[cubic], Q[cubic], P[cubic]], 1
        )
        finite = np.asarray(np.isfinite(companion).all((1, 2)))  # squares of small rates may underflow
        result[cubic[finite]] = np.linalg.eigvals(companion[finite])
        result[cubic[~finite]] = result[~np.isfinite(P + Q)] = np.inf
        # A free body's angular momentum rests in space. The root x = -Omega^2 is due to the rotation of the frame and is no oscillation.
        free = np.flatnonzero(self.free & (degree > 0))
        result[free, 0] = -P[free] + self.body.turn[free] ** 2
        result[free, 1] = np.nan
        result[np.flatnonzero(self.free & (degree == 1)), 0] = np.nan
        return result

    def exponents(self) -> NDArray[np.complex128]:
        """Return characteristic exponents in units of `rate`, (points, 6), with nan and inf as in `squared_exponents`."""
        roots = np.sqrt(self.squared_exponents())
        exponents = np.concatenate([roots, -roots], 1)
        damped = np.flatnonzero(self.body.damping > 0)
        if damped.size:
            body, inertia = self.body.subset(damped), self.body.inertia[damped, :, None]
            D = cross_matrix(body.gyroscopic(body.turn[:, None] * self.gamma[damped]))
            rates = (D - body.damping[:, None, None] * np.eye(3)) / inertia
            matrix = np.zeros((damped.size, 6, 6))
            matrix[:, :3, 3:] = np.eye(3)
            hessian = body.hessian(self.alpha[damped], self.gamma[damped])
            matrix[:, 3:, :3], matrix[:, 3:, 3:] = -hessian / inertia, rates
            finite = np.asarray(np.isfinite(matrix).all((1, 2)))
            exponents[damped[finite]] = np.linalg.eigvals(matrix[finite])
        return exponents

    def stability(self) -> tuple[Flags, Array]:
        """Return what System.linear_stability returns: spectral stability and growth rate (rad per time unit), both (points,)."""
        with np.errstate(all="ignore"):
            exponents = self.exponents()
        finite = np.logical_not(np.isinf(exponents.real).any(1))
        growth = np.fmax.reduce(exponents.real, axis=1, initial=-np.inf)
        unstable = growth > GROWTH_TOLERANCE
        on_axis = np.sort(
            np.where(exponents.real >= -GROWTH_TOLERANCE, exponents.imag, np.nan), axis=1
        )  # nan is sorted last
        stable = finite & ~unstable & ~(np.diff(on_axis, axis=1) <= GROWTH_TOLERANCE).any(1)
        undecided = np.flatnonzero(finite & ~unstable & ~stable)
        if undecided.size:
            others = {name: getattr(self, name)[undecided] for name in self._fields if name != "body"}
            part = self._replace(body=self.body.subset(undecided), **others)
            stable[undecided] = part.hessian_eigenvalues()[:, 0] > FAMILY_TOLERANCE
        flags = np.select(
            [finite & unstable, stable], [Stability.UNSTABLE, Stability.STABLE], Stability.UNKNOWN
        )
        return flags.astype(np.int8), np.where(finite, np.where(unstable, growth * self.rate, 0.0), np.nan)

    def frequencies(self) -> Array:
        """Return frequencies, rad per time unit, (points, 3), the largest first. Exponents of 0 or with a real part give nan."""
        exponents = np.sqrt(self.squared_exponents())
        scale = np.fmax.reduce(np.abs(exponents), axis=1)[:, None]
        oscillating = (np.abs(exponents.imag) > _ZERO * scale) & (exponents.real <= _ZERO * scale)
        values = np.where(oscillating, np.abs(exponents.imag), np.nan) * self.rate[:, None]
        return -np.sort(-values, axis=-1)  # nan is sorted last

    def hessian_eigenvalues(self) -> Array:
        """Return ascending eigenvalues of the scaled Hessian of the potential W at fixed momenta, with 1 for cyclic directions."""
        E = self.cyclic
        forces = cross_matrix(self.body.gyroscopic(self.body.turn[:, None] * self.gamma)) @ E
        moments = np.swapaxes(E, 1, 2) @ (self.body.inertia[..., None] * E)
        stiffness = forces @ np.linalg.pinv(moments, hermitian=True) @ np.swapaxes(forces, 1, 2)
        hessian = self.body.hessian(self.alpha, self.gamma)
        return _eigenvalues(hessian + np.where(self.body.damping[:, None, None] > 0, 0.0, stiffness), E)

    def symmetric(self) -> Mask:
        """Return where the body has an axis of symmetry, (points,)."""
        return np.any([self.body.symmetric_about(i) for i in range(3)], axis=0)

    def energy_stability(self) -> Flags:
        """Return stability by the energy at fixed momenta, as values of flags.EnergyStability, (points,)."""
        with np.errstate(all="ignore"):
            least = self.hessian_eigenvalues()[:, 0]
            # For a free body, a maximum of the energy at fixed angular momentum proves stability as a minimum does.
            polhode = -self.squared_exponents()[:, 0].real
            least = np.where(self.free, np.where(np.isnan(polhode), 1.0, polhode), least)
            return _verdict(least)


def energy_minima(body: Body, w: Array, alpha: Array, gamma: Array) -> Flags:
    """Return whether motions are minima of the energy at fixed values of the momenta that internal dissipation conserves.

    The vectors `w`, `alpha` and `gamma` (points, 3) are at the start. Results are values of flags.EnergyStability, (points,).
    """
    body, w, alpha, gamma = _redrawn(body, w, alpha, gamma)
    rate = body.rate(w)
    body, w = body.scaled(rate), w / rate[:, None]
    axes = np.stack([body.symmetric_about(i, np.ones_like(rate)) for i in range(3)], -1)[:, None]
    any_frame = ~body.acts_across()
    free = any_frame & ~body.acts_along(body.gamma)
    with np.errstate(all="ignore"):
        # Hessian of W. Where nothing acts across gamma, the momentum about gamma is fixed, and the frame turns at w.gamma.
        turn = np.where(any_frame, (w * gamma).sum(-1), body.turn)
        force = np.cross(body.gyroscopic(turn[:, None] * gamma), gamma)
        kept = np.where(any_frame & (body.damping == 0), 1.0 / (body.inertia * gamma**2).sum(-1), 0.0)
        hessian = body._replace(turn=turn).hessian(alpha, gamma)
        hessian += kept[:, None, None] * force[:, :, None] * force[:, None, :]
        moving = w - turn[:, None] * gamma
        vertical = np.where(any_frame[:, None], gamma, 0.0)
        hat = cross_matrix(vertical)
        turns = np.where(axes & ~(any_frame[:, None] & (length(hat) <= _PARALLEL))[:, None], np.eye(3), 0.0)
        # Where nothing acts, the energy (M - k).I^-1 (M - k) / 2 at fixed angular momentum M gives the Hessian.
        momentum = body.inertia * w + body.rotor
        square = (momentum**2).sum(-1)
        share = np.where(square > 0, (w * momentum).sum(-1) / square, 0.0)
        hat = cross_matrix(momentum)
        of_momentum = np.where(axes & (length(hat) > _PARALLEL * np.sqrt(square)[:, None])[:, None], hat, 0.0)
        of_momentum = np.where((square > 0)[:, None, None], of_momentum, np.eye(3))

        def chosen(of_free: Array, others: Array) -> Array:
            return np.where(free.reshape(-1, *(1,) * (others.ndim - 1)), of_free, others)

        hessian = chosen((1.0 / body.inertia - share[:, None])[:, None] * np.eye(3), hessian)
        still = np.concatenate([chosen(of_momentum, turns), chosen(momentum, vertical)[:, :, None]], 2)
        flags = _verdict(_eigenvalues(hessian, still)[:, 0])
        critical = length(chosen(w - share[:, None] * momentum, moving)) <= FAMILY_TOLERANCE
    return np.where(critical, flags, np.int8(EnergyStability.NO))


def _eigenvalues(hessian: Array, still: Array) -> Array:
    """Divide each Hessian by its largest entry and return ascending eigenvalues. Vectors in the span of `still` get the eigenvalue 1."""
    scale = np.abs(hessian).max((1, 2))
    projection = still @ np.linalg.pinv(still, rcond=1e-12)
    complement = np.eye(3) - projection
    hessian = complement @ hessian @ complement / np.where(scale > 0, scale, 1.0)[:, None, None] + projection
    finite = np.asarray(np.isfinite(hessian).all((1, 2)))
    values = np.full(hessian.shape[:2], np.nan)
    values[finite] = np.linalg.eigvalsh(hessian[finite])
    return values


def _verdict(least: Array) -> Flags:
    """Return values of flags.EnergyStability from the least eigenvalue of a second variation."""
    flags = np.where(least > 0, EnergyStability.YES, EnergyStability.NO).astype(np.int8)
    return np.where(np.abs(least) > FAMILY_TOLERANCE, flags, np.int8(EnergyStability.UNKNOWN))


def _redrawn(body: Body, w: Array, alpha: Array, gamma: Array) -> tuple[Body, Array, Array, Array]:
    """Return body and motion in new axes if the body is a sphere and if rotor and fields are along one line.

    The new first axis, an axis of symmetry, is along this line, or normal to `w` if rotor and fields are 0.
    """
    spheres = body.spherical()
    if not spheres.any():
        return body, w, alpha, gamma
    carried = np.stack([body.rotor, body.alpha.field, body.beta.field, body.gamma.field])
    size, moving = length(carried), np.where((length(w) > 0)[:, None], w, gamma)
    bare = size.max(0) == 0
    axis = np.where(bare[:, None], transverse_axes(moving)[:, 0], carried[size.argmax(0), np.arange(len(w))])
    axis = axis / length(axis)[:, None]
    one_line = (length(np.cross(carried, axis)) <= FAMILY_TOLERANCE * size).all(0)
    turned = spheres & one_line & (bare | ((axis != 0).sum(1) > 1))
    rows = np.where(
        turned[:, None, None], np.concatenate([axis[:, None], transverse_axes(axis)], 1), np.eye(3)
    )
    along = np.where(turned[:, None], (carried * axis).sum(-1)[..., None] * np.eye(3)[0], carried)
    alpha_, beta_, gamma_ = (
        d._replace(field=field)
        for d, field in zip((body.alpha, body.beta, body.gamma), along[1:], strict=True)
    )
    w, alpha, gamma = ((rows @ v[..., None])[..., 0] for v in (w, alpha, gamma))
    return body._replace(rotor=along[0], alpha=alpha_, beta=beta_, gamma=gamma_), w, alpha, gamma


def _turn_and_axis(
    body: Body, w: Array, gamma: Array, rate: Array, any_frame: Mask, from_space: bool
) -> tuple[Array, NDArray[np.int64], Mask]:
    """Return a frame's rate, an axis of symmetry or -1, and a mask of bodies that rest in the frame, turn about the axis or are damped."""
    turn = np.where(any_frame, (w * gamma).sum(-1), body.turn)
    axis, exists = np.full(rate.shape, -1), np.zeros(rate.shape, bool)
    tolerance = FAMILY_TOLERANCE * rate
    for i in (0, 1, 2):
        across = [(i + 1) % 3, (i + 2) % 3]
        square = (gamma[:, across] ** 2).sum(-1)
        asleep = square <= FAMILY_TOLERANCE**2
        chosen = (w[:, across] * gamma[:, across]).sum(-1) / np.where(asleep, 1.0, square)
        momentum = body.inertia[:, i] * w[:, i] + body.rotor[:, i]
        balanced = 0.0 if from_space else gamma[:, i] * momentum / (2 * body.inertia[:, across[0]])
        own = np.where(any_frame, np.where(asleep, balanced, chosen), body.turn)
        turning = length((w - own[:, None] * gamma)[:, across])
        steady = (turning <= tolerance) | (body.damping > 0)
        symmetric = body.symmetric_about(i, rate) & ~exists & steady
        turn, axis = np.where(symmetric, own, turn), np.where(symmetric, i, axis)
        exists |= symmetric
    rest = (length(w - turn[:, None] * gamma) <= tolerance) | (body.damping > 0)
    return turn, axis, exists | rest
