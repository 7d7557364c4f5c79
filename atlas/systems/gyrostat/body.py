"""A gyrostat in a frame that turns uniformly, with an amended potential and linear equations.

The frame turns at the rate Omega about the vertical gamma. The directions alpha, normal to gamma, and beta = gamma x alpha are
also at rest in the frame. A direction d has the potential (gradient d.I d) / 2 + field.d, where the gradient of beta is 0.
Vectors, including fields, are in body axes and have the shape (..., 3).
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..base import Array, Mask

# Differences of moments of inertia up to this fraction of the largest moment J are rounding errors. So are transverse momenta up to this
# fraction of J U and transverse torques up to this fraction of J U^2, where U is the unit of rates.
NEGLIGIBLE = 1e-13
# The natural rate ignores rates of frame and fields that are below this fraction of the rate of the free body.
SLOW = 1e-4
_DOUBLE = 8 * np.finfo(float).eps  # two roots count as equal up to this relative discriminant


class Direction(NamedTuple):
    """The potential (gradient d.I d) / 2 + field.d of a direction d that is at rest in the frame."""

    gradient: Array  # squared rate, (...,)
    field: Array  # torque, (..., 3)


class Body(NamedTuple):
    """A gyrostat with the frame in which it moves and with the potentials and damping that act on it."""

    inertia: Array  # (..., 3)
    rotor: Array  # (..., 3)
    turn: Array  # angular velocity Omega of the frame about gamma, (...,)
    alpha: Direction
    beta: Direction
    gamma: Direction
    damping: Array  # torque divided by angular velocity relative to the frame, (...,)

    def subset(self, where: Any) -> Body:
        """Return the bodies that the indices or the mask `where` select."""
        each = (self.alpha, self.beta, self.gamma)
        alpha, beta, gamma = (Direction(*(x[where] for x in d)) for d in each)
        inertia, rotor, turn, damping = (
            x[where] for x in (self.inertia, self.rotor, self.turn, self.damping)
        )
        return Body(inertia, rotor, turn, alpha, beta, gamma, damping)

    def scaled(self, rate: Array) -> Body:
        """Return the bodies in units of `rate` and of the largest moment of inertia of each body."""
        moment = self.inertia.max(-1)
        torque = (moment * rate**2)[..., None]
        each = (self.alpha, self.beta, self.gamma)
        alpha, beta, gamma = (Direction(d.gradient / rate**2, d.field / torque) for d in each)
        momentum = moment * rate
        return Body(
            self.inertia / moment[..., None], self.rotor / momentum[..., None], self.turn / rate, alpha, beta, gamma,
            self.damping / momentum,
        )  # fmt: skip

    def rate(self, w: Array) -> Array:
        """Return the unit of rates of a motion with the angular velocity `w`. It is the sum of all rates, or 1 if all are 0."""
        squares = [
            np.abs(d.gradient) + length(d.field) / self.inertia.max(-1)
            for d in (self.alpha, self.gamma, self.beta)
        ]
        rate = np.abs(self.turn) + length(w)
        for square in squares:
            rate = rate + np.sqrt(square)
        return np.where(rate == 0, 1.0, rate)

    def natural_rate(self, w: Array) -> Array:
        """Return |turn|, or the fields' frequency if turn = 0. If this rate is negligible, return the free body's, or 1 if all are 0."""
        moment = self.inertia.max(-1)
        squares = sum(
            length(d.field) / moment + np.where(self.spherical(), 0.0, np.abs(d.gradient))
            for d in (self.alpha, self.gamma, self.beta)
        )
        free = length(w) + length(self.rotor) / moment
        rates = [np.where(self.turn == 0, np.sqrt(squares), np.abs(self.turn)), free]
        return np.select([np.isfinite(rate) & (rate > SLOW * free) for rate in rates], rates, 1.0)

    def spherical(self) -> Mask:
        """Return where all moments are equal up to rounding."""
        return np.ptp(self.inertia, axis=-1) <= NEGLIGIBLE * self.inertia.max(-1)

    def acts_along(self, direction: Direction) -> Mask:
        """Return where `direction` exerts a torque on the body in some orientation."""
        return ((direction.gradient != 0) & ~self.spherical()) | (direction.field != 0).any(-1)

    def acts_across(self) -> Mask:
        """Return where alpha or beta exerts a torque on the body in some orientation."""
        return self.acts_along(self.alpha) | self.acts_along(self.beta)

    def symmetric_about(self, i: int, rate: Array | float = 0.0) -> Mask:
        """Return where the i-th axis is an axis of symmetry of the moments, and rotor and fields are along this axis.

        Where `rate`, the unit of rates, is above 0, differences from symmetry that may be rounding errors are ignored.
        """
        j, k = (i + 1) % 3, (i + 2) % 3
        limit = np.where(rate > 0, NEGLIGIBLE, 0.0) * self.inertia.max(-1)
        symmetric = np.abs(self.inertia[..., j] - self.inertia[..., k]) <= limit
        torque = limit * rate**2
        for vector, bound in (
            (self.rotor, limit * rate),
            (self.alpha.field, torque),
            (self.beta.field, torque),
            (self.gamma.field, torque),
        ):
            symmetric &= (np.abs(vector[..., j]) <= bound) & (np.abs(vector[..., k]) <= bound)
        return symmetric

    def amended(self) -> tuple[Direction, Direction]:
        """Return alpha and gamma of the amended potential W = V - Omega k.gamma - Omega^2 gamma.I gamma / 2."""
        field = self.gamma.field - self.turn[..., None] * self.rotor
        return self.alpha, Direction(self.gamma.gradient - self.turn**2, field)

    def potential(self, alpha: Array, gamma: Array) -> Array:
        """Return the amended potential W."""
        parts = (
            0.5 * d.gradient[..., None] * self.inertia * v**2 + d.field * v
            for d, v in self._along(self.amended(), alpha, gamma)
        )
        return sum(parts).sum(-1)  # type: ignore[union-attr]

    def gradient(self, alpha: Array, gamma: Array) -> tuple[Array, Array]:
        """Return the gradient of W with respect to rotations, which is minus the torque at rest, and the Hessian of W."""
        return self._variations(self.amended(), alpha, gamma)

    def hessian(self, alpha: Array, gamma: Array) -> Array:
        """Return the symmetric part of the Hessian of the potential W with respect to rotations."""
        result = np.zeros((*np.broadcast_shapes(alpha.shape, self.inertia.shape), 3))
        for d, v in self._along(self.amended(), alpha, gamma):
            moments = np.moveaxis(d.gradient[..., None] * self.inertia, -1, 0)
            f, v = np.moveaxis(d.field, -1, 0), np.moveaxis(v, -1, 0)
            for i, j, k in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):
                tilt = (moments[j] - moments[k]) * (v[k] ** 2 - v[j] ** 2)
                result[..., i, i] += tilt - f[j] * v[j] - f[k] * v[k]
                mixed = (moments[i] + moments[j] - 2 * moments[k]) * v[i] * v[j]
                result[..., i, j] += 0.5 * (mixed + f[i] * v[j] + f[j] * v[i])
                result[..., j, i] = result[..., i, j]
        return result

    def steepness(self) -> Array:
        """Return an upper bound of the second derivatives of the potential W with respect to rotations, (...,)."""
        spread = np.ptp(self.inertia, axis=-1)
        return sum(np.abs(d.gradient) * spread + length(d.field) for d in (*self.amended(), self.beta))

    def _along(
        self, directions: tuple[Direction, Direction], alpha: Array, gamma: Array
    ) -> list[tuple[Direction, Array]]:
        """Return pairs of a direction and a vector for alpha and gamma, and for beta if beta has a field."""
        pairs = list(zip(directions, (alpha, gamma), strict=True))
        return pairs + [(self.beta, np.cross(gamma, alpha))] * bool(self.beta.field.any())

    def _variations(
        self, directions: tuple[Direction, Direction], alpha: Array, gamma: Array
    ) -> tuple[Array, Array]:
        """Return the gradient and the Hessian of the potential of `directions` and beta with respect to rotations of the body."""
        gradient, hessian = np.zeros(1), np.zeros(1)
        for d, v in self._along(directions, alpha, gamma):
            slope = d.gradient[..., None] * self.inertia * v + d.field
            hat = cross_matrix(v)
            gradient = gradient + np.cross(slope, v)
            square = d.gradient[..., None, None] * hat @ (self.inertia[..., None] * hat)
            hessian = hessian + cross_matrix(slope) @ hat - square
        return gradient, hessian

    def frequency_bound(self, w: Array, alpha: Array, gamma: Array) -> Array:
        """Return an upper bound of the fastest frequency of the motion with this start, rad per time unit, (...,).

        The energy u.I u / 2 + W, where u is the rotation relative to the frame, never grows. The ranges of the terms of W
        therefore bound u and every |w_i|. These rates bound the norms of the blocks of the frozen linearised equations in the
        coordinates sqrt(I) w. The Perron root of the 2 x 2 matrix of the norms bounds the frequencies.
        """
        inertia, turn, least = self.inertia.T, np.abs(self.turn), self.inertia.min(-1)
        energy = (self.inertia * (w - self.turn[..., None] * gamma) ** 2).sum(-1)
        for d, v in self._along(self.amended(), alpha, gamma):
            square = (self.inertia * v**2).sum(-1)
            gain = np.where(d.gradient > 0, square - least, self.inertia.max(-1) - square)
            energy = energy + np.abs(d.gradient) * gain + 2 * (length(d.field) + (d.field * v).sum(-1))
        energy = np.maximum(energy, 0.0)
        rates = np.sqrt(energy / inertia) + turn
        damping = self.damping / least
        size = np.sqrt((((np.roll(inertia, 1, 0) - np.roll(inertia, -1, 0)) ** 2) / inertia).sum(0) / least)
        forces = [np.abs(d.gradient) * size + length(d.field) / least for d in (self.alpha, self.gamma)]
        # beta changes by at most the sum of the changes of alpha and gamma.
        across = np.sqrt(2) * length(self.beta.field) / least
        stiffness = np.sqrt(2) * (np.hypot(*forces) + across + damping * turn)
        return perron_root(
            gyration(inertia, self.rotor.T, rates) + damping, np.sqrt(energy / least) + turn, stiffness
        )

    def turns_steadily(self, w: Array, alpha: Array, gamma: Array) -> Mask:
        """Return where the rotation relative to the frame is constant in the body."""
        torque = np.cross(self.inertia * w + self.rotor, w)
        torque = torque - self._variations((self.alpha, self.gamma), alpha, gamma)[0]
        excess = torque / self.inertia - self.turn[..., None] * np.cross(gamma, w)
        return length(excess) <= 1e-8 * self.rate(w) ** 2 * self.inertia.max(-1) / self.inertia.min(-1)

    def gyroscopic(self, w: Array) -> Array:
        """Return v = k + 2 I w - tr(I) w. The matrix D = hat(v) multiplies the rates in the linear system."""
        return self.rotor + (2 * self.inertia - self.inertia.sum(-1, keepdims=True)) * w

    def across_rotation(self, w: Array, u: Array, alpha: Array, gamma: Array) -> Array:
        """Return the matrix (..., 4, 4) of the linear equations for a small rotation xi and a momentum p~ in the plane normal to `u`."""
        inertia, W = self.inertia[..., None], cross_matrix(w)
        acceleration = self.turn[..., None] * np.cross(gamma, u)
        E = cross_matrix(self.inertia * w + self.rotor) @ W - W @ (inertia * W)
        E = E - inertia * cross_matrix(acceleration)
        E = E - self._variations((self.alpha, self.gamma), alpha, gamma)[1]
        P = 0.5 * (E + np.swapaxes(E, -1, -2))
        v = self.gyroscopic(w)
        v_dot = (2 * self.inertia - self.inertia.sum(-1, keepdims=True)) * acceleration
        along = u / length(u)[..., None]
        rows = transverse_axes(along)

        def symmetric(d: Array) -> Array:
            product = d[..., :, None] * along[..., None, :]
            return product + np.swapaxes(product, -1, -2)

        shift, shift_dot = symmetric(0.5 * np.cross(v, along)), symmetric(0.5 * np.cross(v_dot, along))
        # Equations of floquet.py with S = `shift`: xi' = I^-1 (G xi + p~), p~' = (P + S' - G^T I^-1 G) xi - G^T I^-1 p~.
        G = 0.5 * cross_matrix(v) - shift
        transposed = np.swapaxes(rows, -1, -2)
        left = G / self.inertia[..., None]
        blocks = (
            (left, np.broadcast_to(np.eye(3) / self.inertia[..., None], left.shape)),
            (P + shift_dot - np.swapaxes(G, -1, -2) @ left, -np.swapaxes(left, -1, -2)),
        )
        return np.concatenate(
            [np.concatenate([rows @ block @ transposed for block in row], -1) for row in blocks], -2
        )


def gyration(inertia: Array, rotor: Array, max_rates: Array, third_alone: Mask | bool = False) -> Array:
    """Return a bound of the spectral norm of sqrt(I) M sqrt(I)^-1, where I M v = (I w + k) x v - w x I v.

    The bound sqrt(norm_1 norm_inf) holds for all rates up to `max_rates`. The mask `third_alone` is true where w is along e3.
    """
    rows, columns = np.zeros_like(inertia), np.zeros_like(inertia)
    for i, j, axis in ((0, 1, 2), (1, 0, 2), (0, 2, 1), (2, 0, 1), (1, 2, 0), (2, 1, 0)):
        entry = np.abs(inertia[axis] - inertia[j]) * max_rates[axis] + np.abs(rotor[axis])
        entry = entry / np.sqrt(inertia[i] * inertia[j])
        entry = np.where(third_alone & (axis != 2), 0.0, entry)
        rows[i] += entry
        columns[j] += entry
    return np.sqrt(rows.max(0) * columns.max(0))


def perron_root(first: Array, second: Array, product: Array) -> Array:
    """Return the larger eigenvalue of 2 x 2 matrices with diagonal (first, second) whose other entries multiply to `product`."""
    return 0.5 * (first + second) + np.sqrt((0.5 * (first - second)) ** 2 + product)


def quadratic_roots(P: Array, Q: Array) -> tuple[NDArray[np.complex128], NDArray[np.complex128]]:
    """Return the roots of x^2 + P x + Q = 0. The larger root avoids cancellation. The other root is Q divided by the larger."""
    square = 0.25 * P**2
    square = np.where(np.abs(square - Q) <= _DOUBLE * square, 0.0, square - Q)
    root = np.sqrt(square + 0j)
    larger: NDArray[np.complex128] = -0.5 * P - np.copysign(root.real, P) + 1j * root.imag
    return larger, np.divide(Q, larger, out=np.zeros_like(larger), where=larger != 0)


def length(v: Array) -> Array:
    """Return the Euclidean length of vectors (..., 3)."""
    return np.sqrt((v**2).sum(-1))


def transverse_axes(v: Array) -> Array:
    """Return two unit vectors, rows of (..., 2, 3), that complete unit vectors `v` (..., 3) to right-handed axes."""
    first = np.cross(v, np.eye(3)[np.abs(v).argmin(-1)])
    first = first / length(first)[..., None]
    return np.stack([first, np.cross(v, first)], -2)


def cross_matrix(v: Array) -> Array:
    """Return the matrices (..., 3, 3) that map a vector a to v x a."""
    zero = np.zeros_like(v[..., 0])
    rows = ((zero, -v[..., 2], v[..., 1]), (v[..., 2], zero, -v[..., 0]), (-v[..., 1], v[..., 0], zero))
    return np.stack([np.stack(row, -1) for row in rows], -2)
