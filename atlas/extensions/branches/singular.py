"""Degenerate critical points of quadratic functions on quadrics, over two parameters.

Relative equilibria are the critical points x of the amended potential x.Qx / 2 + c.x, with a diagonal matrix Q, under the
conditions x.E_k x / 2 = e_k. The vector x is gamma for permanent rotations, (alpha, gamma) for a satellite, (alpha, beta, gamma)
with drag, and the axis of symmetry for a symmetric satellite. Let l be the multipliers of a critical point. The point is
degenerate if there is a null vector (v, m) with

    (Q + l.E) x + c = 0,    x.E x / 2 = e,    (Q + l.E) v + m.E x = 0,    x.E v = 0,    v.v = 1.

These equations of degree 2 in (x, l, v, m) and both parameters define curves of folds, which are smooth at cusps too. The
derivative of the equations is singular at a pitchfork of a symmetric body. There the first equation gets the term s v. The
unknown s is 0 on the curve. A further equation v.dx = 0 keeps changes dx of x in the plane of symmetry.

On limits of stability, P(s) = 0 and P'(s) = 0 replace the equations that contain v and m. P is the characteristic polynomial of
the squares of the exponents. The double root s is an unknown, so that the equations are regular at a triple root.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import suppress
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np
from numpy.polynomial.chebyshev import chebder, chebvander
from numpy.typing import NDArray

from ...errors import BadInput
from ...flags import Flag
from ...systems.base import Array, Mask, Points
from ...systems.gyrostat import Gyrostat
from ...systems.gyrostat.body import Body, length, transverse_axes
from ..equilibria.algebra import body_at_rest

# The number of nodes grows until the last Chebyshev terms are below `_RESOLVED`. Terms below `_NO_TERM` are dropped.
_NODES, _RESOLVED, _NO_TERM = (9, 33, 129), 1e-13, 1e-15
_DAMPING = 1e-14  # damping of least squares, as a fraction of the trace of the normal matrix
_WEIGHT = 100.0  # In least squares, multipliers and null vectors may change by this factor more than critical points.
_MAX_TURN = 0.3  # longest step of Newton's method: angles are in rad, positions are fractions of the box
# A start is dropped if step `_ITERATIONS` of Newton's method exceeds `_NEAR`, which is large because pitchforks converge slowly.
# Points with a force below `_LITTLE_FORCE` may be pitchforks. Regular points have singular values above `_REGULAR` times the largest
# one. Residuals, steps and forces below `_EXACT` count as 0.
_ITERATIONS, _NEAR, _LITTLE_FORCE, _REGULAR, _EXACT = 10, 1e-2, 1e-2, 1e-7, 1e-9
_VANISHES = 1e-7  # The constant term of a characteristic polynomial counts as 0 below this fraction of the largest coefficient.
# Discriminants below this fraction of the sum of their terms' sizes count as 0, because two exponents may be equal on a whole curve.
_DISCRIMINANT_ROUNDING = 1e-13
# `_STEPS_BESIDE` steps of Newton's method find solutions at the distance `_BESIDE` from a pitchfork, to count the stable ones.
# Extrema of the momentum are sought at the distances `_ASIDE` from degenerate solutions.
_BESIDE, _STEPS_BESIDE, _ASIDE = 1e-3, 5, (-0.1, -0.02, 0.02, 0.1)
_ON_SIDE = 5  # number of Newton steps that move a point onto a side of the box
# A vector x consists of two (`FRAMES`) or three (`TRIADS`) unit vectors d_i. For a matrix E in these arrays, x.E x is d_i.d_i or 2 d_i.d_j.
FRAMES = np.array(
    [np.kron(block, np.eye(3)) for block in ([[1, 0], [0, 0]], [[0, 0], [0, 1]], [[0, 1], [1, 0]])]
)
_PAIRS = ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))
TRIADS = np.array([np.kron(np.eye(3)[[i]].T @ np.eye(3)[[j]], np.eye(3)) for i, j in _PAIRS])
TRIADS[3:] += TRIADS[3:].swapaxes(1, 2)


def _solved(matrix: Array, right: Array) -> Array:
    """Solve linear equations. If a matrix is singular to the last bit, all matrices are first changed by the size of a rounding error."""
    with suppress(np.linalg.LinAlgError):
        return np.asarray(np.linalg.solve(matrix, right))
    size = np.abs(matrix).max((1, 2), keepdims=True)
    noise = np.cos(np.arange(matrix.shape[1] ** 2).reshape(matrix.shape[1:]) ** 2)
    return np.linalg.solve(matrix + 1e-15 * (size + (size == 0)) * noise, right)


class BorderKind(Flag):
    """Kinds of borders. No point of a border has the kind 0."""

    NONE = 0, "no border"
    FOLD = 1, "two solutions merge and vanish"
    PITCHFORK = 2, "a solution of a symmetric body changes its stability, and two others merge with it"
    LIMIT_OF_STABILITY = (
        3,
        "two pairs of imaginary exponents meet and leave the axis at a frequency that is not zero",
    )
    EXTREMAL_MOMENTUM = (
        4,
        "a pair of exponents vanishes and leaves the axis, where the momentum has an extremum",
    )


class Potential(NamedTuple):
    """Amended potentials x.Q x / 2 + c.x of bodies over a box of two parameters. Positions in the box are fractions of its sides."""

    terms: Array  # Chebyshev coefficients of (Q, c) and of their derivatives by both parameters, (terms, terms, 6 n) if x has n components
    forms: Array  # matrices E of the conditions x.E x = 1 or x.E x = 0, (conditions, n, n)
    axis: int  # axis of symmetry that all bodies have, -1 if there is none
    upright: bool  # whether nothing acts along alpha and beta
    mirrored: bool  # whether alpha -> -alpha leaves all potentials the same
    bodies: Array  # Chebyshev coefficients of `_linear` and of its derivatives by both parameters, (terms, terms, 3 x 27)

    @classmethod
    def of(cls, system: Gyrostat, points: Callable[[Array], Points]) -> Potential:
        """Return the potentials of the bodies `points(positions)`. Raise BadInput unless the potentials depend smoothly on positions."""
        for count in _NODES:
            nodes = np.cos(np.pi * (np.arange(count) + 0.5) / count)
            grid = np.stack(np.meshgrid(nodes, nodes, indexing="ij"), -1).reshape(-1, 2)
            body = body_at_rest(system, points(0.5 + 0.5 * grid))
            axes = [i for i in range(3) if body.symmetric_about(i).all()]
            upright, axis = not body.acts_across().any(), axes[0] if len(axes) == 1 else -1
            inverse = np.linalg.inv(chebvander(nodes, count - 1))
            values = np.concatenate([_coefficients(body, upright, axis), _linear(body)], 1)
            every = np.einsum("ai,bj,ijk->abk", inverse, inverse, values.reshape(count, count, -1))
            terms, bodies = every[..., :-27], every[..., -27:]
            size = np.abs(terms).max()
            if not np.isfinite(size):
                raise BadInput("borders: a part of the range has no body")
            if size == 0:
                raise BadInput("borders: without orbit and field these bodies rest in any orientation")
            tails = np.abs(terms[count - count // 4 :]).max(), np.abs(terms[:, count - count // 4 :]).max()
            if max(tails) <= _RESOLVED * size:
                break
        else:
            raise BadInput(
                "borders: the bodies are no smooth functions of these parameters in the whole range"
            )
        terms = np.where(np.abs(terms) > _NO_TERM * size, terms, 0.0) / size
        used = [1 + np.flatnonzero(np.abs(terms).max(other))[-1] for other in ((1, 2), (0, 2))]
        terms = terms[: used[0], : used[1]]
        n = terms.shape[2] // 2
        forms = {6: FRAMES, 9: TRIADS}.get(n, np.eye(n)[None])
        mirrored = n == 6 and not terms[..., n : n + 3].any()
        # Inertia and rotor may need more Chebyshev terms than the potential.
        bodies = bodies[: used[0] + 2, : used[1] + 2]
        return cls(_with_derivatives(terms), forms, axis, upright, mirrored, _with_derivatives(bodies))

    @property
    def size(self) -> int:
        """Number n of components of a critical point x."""
        return self.forms.shape[1]

    def at(self, positions: Array) -> Array:
        """Return Q and c of x.Q x / 2 + c.x, and the derivatives of Q and c by both parameters, (3, 2, N, n). Axis 1 separates Q from c."""
        values = _values(self.terms, positions)
        return np.moveaxis(values.reshape(3, len(positions), 2, self.size), 2, 1)

    @property
    def has_beta(self) -> bool:
        """Whether something acts along beta."""
        return bool(self.bodies[..., 18:21].any())

    @property
    def cyclic(self) -> bool:
        """Whether the energy does not change with a turn about an axis, so that two exponents are 0."""
        return self.upright or self.axis >= 0

    def characteristic(self, x: Array, positions: Array) -> tuple[Array, Array]:
        """Return the characteristic polynomial of the squares s of the exponents, and its derivatives by x and position.

        The coefficients (N, 4) are in ascending order. The derivatives have the shape (N, 4, n + 2). Small turns xi of the body obey
        I xi'' + v x xi' + H xi = 0 with the Hessian H and the gyroscopic vector v. The polynomial is det(s I + H) + s v.(s I + H) v.
        A root that is 0 by symmetry is left out.
        """
        alpha, gamma = self.attitudes(x)
        inertia, rotor, turning, *along = np.split(_values(self.bodies, positions), 9, 2)
        vectors = (alpha, np.cross(gamma, alpha), gamma) if self.has_beta else (alpha, gamma)
        along = along if self.has_beta else along[:2] + along[4:]
        fields = list(zip(vectors, along[::2], along[1::2], strict=True))
        hessians = np.sum([_hessian(*field) for field in fields], 0)
        H, I, v = hessians[0], inertia[0, :, None] * np.eye(3), rotor + turning * gamma
        forces, nothing = np.einsum("njik,nk->nji", np.stack([H, I], 1), v[0]), np.zeros((len(x), 1, 3))
        K = np.stack([0.5 * _polar(H, H), _polar(H, I), 0.5 * _polar(I, I), 0 * I], 1)
        by_v = np.concatenate([nothing, 2 * forces, nothing], 1)
        pairs = np.stack([K[:, 0] / 3, K[:, 0], K[:, 2], K[:, 2] / 3], 1), np.stack([H, I, H, I], 1)
        values = (pairs[0] * pairs[1]).sum((2, 3))
        values[:, 1:3] += (forces * v[0, :, None]).sum(2)
        K[:, 1] += v[0, :, :, None] * v[0, :, None]
        by_I = np.concatenate([nothing, np.einsum("njii->nji", K[:, :3])], 1)
        by_position = np.einsum("njik,pnik->njp", K, hessians[1:])
        by_position += np.einsum("nji,pni->njp", by_v, v[1:]) + np.einsum("nji,pni->njp", by_I, inertia[1:])
        by_vectors = [_by_direction(K, d, q[0], c[0]) for d, q, c in fields]
        by_vectors[-1] += turning[0, :, None] * by_v
        if self.axis < 0:
            by_x = by_vectors[-1] if self.upright else np.concatenate(by_vectors, 2)
        else:
            torque = sum(np.cross(by, d[:, None]) for by, d in zip(by_vectors, vectors, strict=True))
            rows = [alpha, gamma] if self.size == 2 else [alpha, np.cross(gamma, alpha), gamma]
            by_x = np.cross(torque, np.eye(3)[self.axis]) @ np.stack(rows, 2)
        slopes = np.concatenate([by_x, by_position], 2)
        if self.cyclic:
            values, slopes = (np.roll(each, -1, 1) for each in (values, slopes))
            values[:, -1], slopes[:, -1] = 0.0, 0.0
        return values, slopes

    def stability_margins(self, coefficients: Array, left_out: Mask | bool = False) -> Array:
        """Return numbers (N, 4), all positive if exponents are imaginary and different. Where `left_out`, two exponents 0 are ignored."""
        c = coefficients.copy()
        # Symmetries about gamma and a body axis make two pairs of exponents 0, but only one pair if gamma is along this axis.
        if self.size == 2:
            left_out = left_out | (np.abs(c[:, 0]) < _VANISHES * np.abs(c).max(1))
        out = np.broadcast_to(left_out, len(c))
        c[out] = np.roll(c[out], -1, 1) * [1.0, 1.0, 1.0, 0.0]
        squares = (c[:, 1] * c[:, 2]) ** 2, -27 * (c[:, 0] * c[:, 3]) ** 2
        terms = *squares, -4 * c[:, 1] ** 3 * c[:, 3], -4 * c[:, 0] * c[:, 2] ** 3, 18 * c.prod(1)
        discriminant, size = np.sum(terms, 0), np.abs(terms).sum(0)
        discriminant[np.abs(discriminant) < _DISCRIMINANT_ROUNDING * size] = 0.0
        degree = 3 - self.cyclic - out
        conditions = np.concatenate([c[:, :3], discriminant[:, None]], 1)
        return np.where(degree[:, None] > [0, 1, 2, 1], conditions, 1.0)

    def constraints(self, x: Array) -> tuple[Array, Array]:
        """Return the gradients B of the conditions on x, and M = (B B^T)^-1 B. Multipliers are minus the product of M and a gradient."""
        B = np.einsum("kij,nj->nki", self.forms, x)
        return B, _solved(B @ np.swapaxes(B, 1, 2), B)

    def none(self) -> Degenerate:
        """Return an object without points."""
        return Degenerate(self, np.zeros((0, self.mirror().size)), np.zeros(0, np.int8))

    def mirror(self) -> Array:
        """Return the factors by which alpha -> -alpha multiplies the unknowns of `Degenerate`. All are 1 unless `mirrored`."""
        n, m = self.forms.shape[1], len(self.forms)
        signs = np.ones(n + m)
        if self.mirrored:
            signs[[0, 1, 2, n + m - 1]] = -1.0
        return np.concatenate([signs, signs, np.ones(3)])

    def attitudes(self, x: Array) -> tuple[Array, Array]:
        """Return alpha and gamma in body axes. If nothing acts across gamma, alpha is an arbitrary normal of gamma."""
        if self.size >= 6:
            return x[:, :3], x[:, -3:]
        if self.size == 2:
            x = np.stack([x[:, 0], 0 * x[:, 0], x[:, 1]], -1)
        if self.axis < 0:
            return transverse_axes(x)[:, 0], x
        frames, columns = np.empty((len(x), 3, 3)), (self.axis + np.arange(3)) % 3
        frames[..., columns] = np.swapaxes(np.concatenate([x[:, None], transverse_axes(x)], 1), 1, 2)
        return frames[:, 0], frames[:, 2]

    def from_attitudes(self, alpha: Array, gamma: Array) -> Array:
        """Return the argument x (..., n) of the potential for directions in body axes. If nothing acts across gamma, alpha is not used."""
        if self.axis < 0:
            vectors = [alpha, np.cross(gamma, alpha), gamma] if self.has_beta else [alpha, gamma]
            return gamma if self.upright else np.concatenate(vectors, -1)
        if self.size == 2:
            return np.stack([length(np.delete(gamma, self.axis, -1)), gamma[..., self.axis]], -1)
        return np.stack([alpha, np.cross(gamma, alpha), gamma], -2)[..., self.axis]


def _with_derivatives(coefficients: Array) -> Array:
    """Return the coefficients (a, b, 3 k) of k Chebyshev series with a x b terms each, and of their derivatives by both variables."""
    a, b, k = coefficients.shape
    every = np.zeros((a, b, 3, k))
    every[:, :, 0] = coefficients
    every[:-1, :, 1], every[:, :-1, 2] = (2 * chebder(coefficients, axis=axis) for axis in (0, 1))
    return every.reshape(a, b, -1)


def _values(coefficients: Array, positions: Array) -> Array:
    """Return values (3, N, series) of Chebyshev series and of derivatives by both variables at N positions. See `_with_derivatives`."""
    a, b, k = coefficients.shape
    u, w = np.moveaxis(chebvander(2 * positions - 1, max(a, b) - 1), 1, 0)
    products = (u[:, :a, None] * w[:, None, :b]).reshape(-1, a * b)
    return np.moveaxis((products @ coefficients.reshape(a * b, k)).reshape(-1, 3, k // 3), 1, 0)


def _polar(a: Array, b: Array) -> Array:
    """Return the polar form of the adjugate of symmetric matrices (..., 3, 3), which is twice the adjugate if a = b."""
    product, traces = a @ b, [np.einsum("...ii->...", each)[..., None, None] for each in (a, b, a @ b)]
    unit = (traces[0] * traces[1] - traces[2]) * np.eye(3)
    return product + np.swapaxes(product, -1, -2) - traces[0] * b - traces[1] * a + unit


def _hessian(d: Array, q: Array, c: Array) -> Array:
    """Return the symmetric part of the Hessian of d.(q d) / 2 + c.d under rotations, for a direction d in body axes."""
    outer, slope = d[:, :, None] * d[:, None], q * d + c
    mixed = 0.5 * slope[..., :, None] * d[:, None]
    tilt = _polar(outer, q[..., None] * np.eye(3))
    return tilt + mixed + np.swapaxes(mixed, -1, -2) - (slope * d).sum(-1)[..., None, None] * np.eye(3)


def _by_direction(K: Array, d: Array, q: Array, c: Array) -> Array:
    """Return the derivative by d of trace(K H) for each symmetric matrix K, (N, matrices, 3). H is the result of `_hessian`."""
    rest = K - np.einsum("njii->nj", K)[..., None, None] * np.eye(3)
    tilt = 2 * _polar(K, q[:, None, :, None] * np.eye(3)) + q[:, None, :, None] * rest
    return np.einsum("njik,nk->nji", tilt, d) + np.einsum("njik,nk->nji", rest, q * d + c)


def _linear(body: Body) -> Array:
    """Return inertia I, rotor, frame rate times (2 I - tr I), and Q and c for each of alpha, beta, gamma, (bodies, 27), in common units."""
    square = float((body.turn**2 + body.steepness() / body.inertia.min(-1)).max()) or 1.0
    I, rate = body.inertia, np.sqrt(square)
    alpha, gamma = body.amended()
    forces = [part for d in (alpha, body.beta, gamma) for part in (d.gradient[:, None] * I, d.field)]
    momenta = [body.rotor, body.gyroscopic(body.turn[:, None] * np.ones(3)) - body.rotor]
    return np.concatenate([I, *(m / rate for m in momenta), *(f / square for f in forces)], 1) / I.max()


def _coefficients(body: Body, upright: bool, axis: int) -> Array:
    """Return the diagonal Q and the vector c of the amended potentials x.Q x / 2 + c.x of bodies, (bodies, 2 n)."""
    alpha, gamma = body.amended()
    if axis < 0:
        across = [alpha, body.beta] if body.beta.field.any() else [alpha]
        directions = [gamma] if upright else [*across, gamma]
        parts = [d.gradient[:, None] * body.inertia for d in directions] + [d.field for d in directions]
        return np.concatenate(parts, 1)
    excess, none = body.inertia[:, axis] - body.inertia[:, (axis + 1) % 3], np.zeros(len(body.inertia))
    (p, r), (q, s) = zip(*((d.gradient * excess, d.field[:, axis]) for d in (alpha, gamma)), strict=True)
    t = body.beta.field[:, axis]
    return np.stack([none, r, none, s] if upright else [p, none, r, q, t, s], -1)


class Degenerate(NamedTuple):
    """Degenerate critical points. Each has a row (x, l, v, m, position, s) of `unknowns`, which the module's docstring explains."""

    potential: Potential
    unknowns: Array
    # At folds s = 0. At pitchforks each change dx of x has v.dx = 0. At limits of stability v = m = 0, and s is a double exponent squared.
    kind: NDArray[np.int8]

    @property
    def pitchfork(self) -> Mask:
        return np.asarray(self.kind == BorderKind.PITCHFORK)

    @property
    def limit(self) -> Mask:
        """Whether each point is a limit of stability. The number of solutions does not change across such a limit."""
        return np.asarray(self.kind >= BorderKind.LIMIT_OF_STABILITY)

    @property
    def excess(self) -> Array:
        """Size |s| of the artificial force along the null vector. The force is 0 on curves."""
        return np.where(self.limit, 0.0, np.abs(self.unknowns[:, -1]))

    @property
    def parts(self) -> list[Array]:
        """The parts x, l, v, m, position and s of `unknowns`, each with the shape (N, components). See the module's docstring."""
        n, size, y = self.potential.size, sum(self.potential.forms.shape[:2]), self.unknowns
        ends = 0, n, size, size + n, 2 * size, 2 * size + 2, 2 * size + 3
        return [y[:, start:end] for start, end in pairwise(ends)]

    @property
    def place(self) -> Array:
        """The unknowns (x, position, s) by which distances and lengths of curves are measured, (N, n + 3)."""
        return np.concatenate([self.unknowns[:, : self.potential.size], self.unknowns[:, -3:]], 1)

    @classmethod
    def joined(cls, parts: Sequence[Degenerate]) -> Degenerate:
        return cls(
            parts[0].potential,
            *(np.concatenate(each) for each in zip(*(part[1:] for part in parts), strict=True)),
        )

    def take(self, where: Any) -> Degenerate:
        """Return the points that a mask or indices select."""
        return Degenerate(self.potential, self.unknowns[where], self.kind[where])

    def matrices(self) -> tuple[Array, Array, Array]:
        """Return the matrix D of the equations D (v, m) = 0, the derivatives of D (v, m) by (x, l), and `Potential.at(position)`."""
        x, l, v, m, position, _ = self.parts
        forms, (N, n) = self.potential.forms, x.shape
        diagonal = self.potential.at(position)
        first, second = np.zeros((2, N, n + l.shape[1], n + l.shape[1]))
        first[:, :n, :n] = np.einsum("nk,kij->nij", l, forms)
        first[:, range(n), range(n)] += diagonal[0, 0]
        second[:, :n, :n] = np.einsum("nk,kij->nij", m, forms)
        for matrix, vector in ((first, x), (second, v)):
            matrix[:, n:, :n] = np.einsum("kij,nj->nki", forms, vector)
            matrix[:, :n, n:] = np.swapaxes(matrix[:, n:, :n], 1, 2)
        return first, second, diagonal

    def equations(self) -> tuple[Array, Array]:
        """Return the residuals of the equations, (N, unknowns - 1), and their derivatives by the unknowns."""
        x, l, v, m, position, s = self.parts
        first, second, (now, *by) = self.matrices()
        N, n, size = len(x), x.shape[1], first.shape[1]
        levels = 0.5 * (np.einsum("kii->k", self.potential.forms) > 0)
        residual = np.zeros((N, 2 * size + 2))
        residual[:, :n] = np.einsum("nij,nj->ni", first[:, :n, :n], x) + now[1] + s * v
        residual[:, n:size] = 0.5 * np.einsum("nij,nj->ni", first[:, n:, :n], x) - levels
        residual[:, size : 2 * size] = np.einsum("nij,nj->ni", first, np.concatenate([v, m], 1))
        residual[:, -2] = 0.5 * ((v**2).sum(1) - 1)
        residual[:, -1] = np.where(self.pitchfork, 0.0, s[:, 0])
        slopes = np.zeros((N, 2 * size + 2, 2 * size + 3))
        slopes[:, :size, :size] = slopes[:, size : 2 * size, size : 2 * size] = first
        slopes[:, size : 2 * size, :size] = second
        slopes[:, range(n), range(size, size + n)] = s
        for i, (q, c) in enumerate(by):
            slopes[:, :n, 2 * size + i] = q * x + c
            slopes[:, size : size + n, 2 * size + i] = q * v
        slopes[:, :n, -1] = slopes[:, -2, size : size + n] = v
        slopes[:, -1, -1] = ~self.pitchfork
        slopes[:, -1, :n] = v * self.pitchfork[:, None]
        if (limit := self.limit).any():
            slopes[limit, size : 2 * size] = np.eye(2 * size + 3)[size : 2 * size]
            residual[limit, size : 2 * size] = self.unknowns[limit, size : 2 * size]
            values, gradients = self.take(limit).characteristic()
            residual[limit, -2:] = values[:, :2]
            slopes[limit, -2:, :n], slopes[limit, -2:, -3:-1] = gradients[..., :n], gradients[..., n:]
            slopes[limit, -2:, -1] = values[:, 1:]
            zero = self.kind == BorderKind.EXTREMAL_MOMENTUM
            residual[zero, -1], slopes[zero, -1] = s[zero, 0], np.eye(2 * size + 3)[-1]
        return residual, slopes

    def characteristic(self) -> tuple[Array, Array]:
        """Return the characteristic polynomial P(s), P'(s) and P''(s), and the derivatives of P and P' by x and position."""
        x, _, _, _, position, s = self.parts
        s = np.where(self.limit[:, None], s, 0.0)
        coefficients, slopes = self.potential.characteristic(x, position)
        one, no = np.ones_like(s), np.zeros_like(s)
        powers = np.array([[one, s, s**2, s**3], [no, one, 2 * s, 3 * s**2], [no, no, 2 * one, 6 * s]])
        values = np.einsum("dkni,nk->nd", powers, coefficients)
        return values, np.einsum("dkni,nkj->ndj", powers[:2], slopes)

    def response(self) -> tuple[Array, Array, Array]:
        """Return the matrix D of `matrices`. Return also how the parameters change the potential's gradient and the solution (x, l)."""
        first, _, (_, *by) = self.matrices()
        forces = np.stack([q * self.parts[0] + c for q, c in by], -1)
        right = np.concatenate([forces, np.zeros((len(first), first.shape[1] - forces.shape[1], 2))], 1)
        return first, forces, -_solved(first + 1e-13 * np.eye(first.shape[1]), right)

    def values_and_rates(self) -> tuple[Array, Array]:
        """Return the characteristic polynomial P(s) and its derivatives by the parameters along solutions. Except on limits, s is 0."""
        n, (*_, moved), (values, slopes) = self.potential.size, self.response(), self.characteristic()
        return values[:, 0], slopes[:, 0, n:] + np.einsum("ni,nif->nf", slopes[:, 0, :n], moved[:, :n])

    def margins(self) -> Array:
        """Return four numbers for each point, (N, 4). They are all positive where every nonzero exponent is imaginary."""
        x, _, _, _, position, _ = self.parts
        coefficients, _ = self.potential.characteristic(x, position)
        left_out = self.pitchfork | self.limit | (not self.potential.cyclic)
        margins = self.potential.stability_margins(coefficients, left_out)
        return np.where(self.limit[:, None], -self.largest_square()[:, None], margins)

    def stable_change(self) -> NDArray[np.int64]:
        """Return how the number of stable solutions changes across curves. The change is valid where all `margins` are positive.

        At a fold one of two merging solutions is stable, or both if an angle is cyclic. At a limit one solution gains or loses stability.
        """
        change, fork = np.where(self.potential.cyclic & ~self.limit, 2, 1), self.pitchfork
        if self.potential.size == 3 and fork.any():
            change[fork] = self.take(fork)._change_at_pitchforks()
        return change

    def _change_at_pitchforks(self) -> NDArray[np.int64]:
        """Return how the number of stable solutions changes across pitchforks, towards the side with more solutions."""
        _, _, toward = self.character()
        toward = toward / np.maximum(length(toward), np.finfo(float).tiny)[:, None]
        _, rates = self.values_and_rates()
        v, n, size = self.parts[2], self.potential.size, sum(self.potential.forms.shape[:2])
        points = self._replace(unknowns=self.unknowns.copy())
        points.unknowns[:, -1] = 0.0
        points.unknowns[:, :n] += _BESIDE * v
        for _ in range(_STEPS_BESIDE):
            residual, slopes = points.equations()
            matrix = np.zeros((len(v), size + 1, size + 1))
            matrix[:, :-1, :-1], matrix[:, -1, :n] = slopes[:, :size, :size], v
            matrix[:, :-1, -1] = np.einsum("nij,nj->ni", slopes[:, :size, -3:-1], toward)
            right = np.concatenate([-residual[:, :size], np.zeros((len(v), 1))], 1)
            change = _solved(matrix, right[..., None])[..., 0]
            points.unknowns[:, :size] += change[:, :-1]
            points.unknowns[:, -3:-1] += change[:, -1:] * toward
        values, _ = points.characteristic()
        return np.where((rates * toward).sum(1) > 0, 1, -1) + 2 * (values[:, 0] > 0)

    def largest_square(self) -> Array:
        """Return the largest squared exponent at limits of stability, and -inf elsewhere. A pair of exponents that are 0 is left out."""
        limits, result = self.take(self.limit), np.full(len(self.kind), -np.inf)
        x, _, _, _, position, s = limits.parts
        (_, first, second, third), s = self.potential.characteristic(x, position)[0].T, s[:, 0]
        with np.errstate(all="ignore"):
            other = s if self.potential.cyclic else -second / third - 2 * s
            single = limits.kind == BorderKind.EXTREMAL_MOMENTUM
            result[self.limit] = np.where(single, -first / second, np.maximum(s, other))
        return result

    def inside(self) -> Mask:
        """Whether each point is in the box, up to rounding errors."""
        return np.asarray((np.abs(self.parts[4] - 0.5) < 0.5 + _EXACT).all(1))

    def moved(self, change: Array) -> Degenerate:
        return self._replace(unknowns=self.unknowns + change)

    def nearest(self, iterations: int) -> tuple[Degenerate, Array]:
        """Find the nearest points of curves by Newton's method with damped least squares. Return also the size of the last steps."""
        size = 2 * np.array(self.potential.forms.shape[:2]).sum()
        n = self.potential.size
        weight = np.ones(size + 3)
        weight[n:size] = weight[-1] = _WEIGHT
        points = self
        for _ in range(iterations):
            residual, slopes = points.equations()
            weighted = slopes * weight
            square = weighted @ np.swapaxes(weighted, 1, 2)
            damping = _DAMPING * np.einsum("nii->n", square)
            square += damping[:, None, None] * np.eye(size + 2)
            change = -weight * np.einsum("nji,nj->ni", weighted, _solved(square, residual[..., None])[..., 0])
            change /= np.maximum(1.0, length(change[:, [*range(n), size, size + 1]]) / _MAX_TURN)[:, None]
            points = points.moved(change)
        return points, np.abs(change).max(1)

    @np.errstate(all="ignore")  # Newton's method diverges where these equations are singular
    def corrected(self, row: Array, iterations: int) -> tuple[Degenerate, Array, Array, Array]:
        """Find where the curves meet hyperplanes. Each hyperplane contains one of these points and has the normal `row`.

        The results are the points, the size of the last steps, unit tangents, and orientations. The equations' derivatives and `row`
        form a square matrix. The sign of the determinant is the orientation. This sign changes along a curve only at crossings.
        """
        points = self
        for _ in range(iterations):
            residual, slopes = points.equations()
            matrix = np.concatenate([slopes, row[:, None]], 1)
            right = np.zeros((*row.shape, 2))
            right[:, :-1, 0], right[:, -1, 1] = -residual, 1.0
            change, tangent = np.moveaxis(_solved(matrix, right), -1, 0)
            points = points.moved(change)
        n = self.potential.size
        tangent = tangent / length(tangent[:, [*range(n), -3, -2, -1]])[:, None]
        return points, np.abs(change).max(1), tangent, np.linalg.slogdet(matrix)[0]

    def condition(self, rows: Array) -> Array:
        """Return the condition numbers of the derivatives of the equations, with one more row from `rows`."""
        return np.linalg.cond(np.concatenate([self.equations()[1], rows[:, None]], 1), 1)

    def onto_sides(self) -> tuple[Degenerate, Array]:
        """Move points outside the box to points of their curves on the sides of the box. Return also the size of the last steps."""
        nearest, row = np.clip(self.parts[4], 0, 1), np.zeros_like(self.unknowns)
        row[:, -3:-1] = np.sign(self.parts[4] - nearest)
        points = self._replace(unknowns=self.unknowns.copy())
        points.unknowns[:, -3:-1] = nearest
        points, step, *_ = points.corrected(row, _ON_SIDE)
        return points, step

    def solves(self) -> Mask:
        """Whether each point is on its curve and in the box."""
        return np.asarray((np.abs(self.equations()[0]).max(1) < _EXACT) & self.inside())

    def flat(self) -> Mask:
        """Whether a pitchfork has no bifurcating solutions, because equilibria of one body form a line."""
        _, (product, bend), _ = self.character()
        return np.asarray(self.pitchfork & (np.abs(bend) <= _EXACT * np.abs(product)))

    def regular(self) -> tuple[Degenerate, Array]:
        """Refine the points by Newton's method. Return the points at which curves are regular, with unit tangents."""
        residual, slopes = self.equations()
        _, sizes, right = np.linalg.svd(slopes)
        good = sizes[:, -1] > _REGULAR * sizes[:, 0]
        points, step, tangent, _ = self.take(good).corrected(right[good, -1], 7)
        good = (step < _EXACT) & (points.excess < _EXACT) & points.inside()
        beyond = np.flatnonzero(good & (points.parts[4] != np.clip(points.parts[4], 0, 1)).any(1))
        onto, step = points.take(beyond).onto_sides()
        points.unknowns[beyond] = onto.unknowns
        good[beyond] = step < _EXACT
        good &= ~points.flat()
        limits = np.flatnonzero(points.limit)  # Newton's method converges fast at singular limits too.
        sizes = np.linalg.svd(points.take(limits).equations()[1], compute_uv=False)
        good[limits] &= sizes[:, -1] > _REGULAR * sizes[:, 0]
        return points.take(good), tangent[good]

    @classmethod
    def near(cls, potential: Potential, x: Array, position: Array, solves: Mask, reach: float) -> Degenerate:
        """Return start values where, to first order, a degenerate point is within `reach` of `position`. `solves` marks solutions `x`."""
        n, (N, m) = potential.size, (len(x), len(potential.forms))
        now, *by = potential.at(position)
        B, onto = potential.constraints(x)
        gradient = now[0] * x + now[1]
        l = -np.einsum("nki,ni->nk", onto, gradient)
        unknowns = np.concatenate([x, l, 0 * x, 0 * l, position, 0 * l[:, :1]], 1)
        first, forces, moved = cls(potential, unknowns, np.full(N, BorderKind.FOLD, np.int8)).response()
        basis = np.linalg.svd(B)[2][:, m:]
        kappa, vectors = np.linalg.eigh(basis @ first[:, :n, :n] @ np.swapaxes(basis, 1, 2))
        v = np.swapaxes(vectors, 1, 2) @ basis  # (points, eigenvalues, components of x)
        mu = -np.einsum("nki,nij,nej->nek", onto, first[:, :n, :n], v)
        bent = (
            np.einsum("nek,kij,nej->nei", 2 * mu, potential.forms, v),
            np.einsum("nei,kij,nej->nek", v, potential.forms, v),
        )
        rates = np.stack([np.einsum("nei,ni,nei->ne", v, q, v) for q, _ in by], -1)
        rates += np.concatenate(bent, 2) @ moved
        slope = np.einsum("nei,nif->nef", v, forces)
        with np.errstate(all="ignore"):  # A derivative may be 0.
            of_solutions = 0.5 * np.abs(kappa) / length(rates)
            of_others = np.abs(np.einsum("nei,ni->ne", v, gradient)) / length(slope)
        distance = np.where(solves[:, None], of_solutions, of_others)
        distance[~solves[:, None] & (np.abs(kappa) > np.abs(kappa).min(1, keepdims=True))] = np.inf
        which, e = np.nonzero(distance < reach)
        parts = [x[which], l[which], v[which, e], mu[which, e], position[which], np.zeros((which.size, 1))]
        return cls(potential, np.concatenate(parts, 1), np.full(which.size, BorderKind.FOLD, np.int8))

    @classmethod
    def near_limits(cls, potential: Potential, x: Array, position: Array, reach: float) -> Degenerate:
        """Return solutions that are, to first order, within `reach` of a limit of stability at which all exponents are imaginary."""
        now, *_ = potential.at(position)
        _, onto = potential.constraints(x)
        l = -np.einsum("nki,ni->nk", onto, now[0] * x + now[1])
        coefficients, _ = potential.characteristic(x, position)
        kinds = [(BorderKind.LIMIT_OF_STABILITY, s) for s in _extrema(coefficients).T]
        if potential.cyclic:
            kinds.append((BorderKind.EXTREMAL_MOMENTUM, np.zeros(len(x))))
        parts = []
        for kind, s in kinds:
            unknowns = np.concatenate([x, l, 0 * x, 0 * l, position, s[:, None]], 1)
            points = cls(potential, unknowns, np.full(len(x), kind, np.int8))
            values, rates = points.values_and_rates()
            parts.append(
                points.take((np.abs(values) < reach * length(rates)) & (points.largest_square() < 0))
            )
        return cls.joined(parts)

    def extremal_momenta(self) -> Degenerate:
        """Return starts of a search for extrema of the momentum. The starts are beside degenerate solutions, where extrema often are."""
        x, l, v, m, position, s = self.parts
        kind = np.full(len(x), BorderKind.EXTREMAL_MOMENTUM, np.int8)
        sides = [np.concatenate([x + size * v, l, 0 * v, 0 * m, position, 0 * s], 1) for size in _ASIDE]
        return Degenerate.joined([Degenerate(self.potential, unknowns, kind) for unknowns in sides])

    def settled(self, reach: float) -> Degenerate:
        """Find points on curves by Newton's method. Points outside the box, or farther than `reach` from their starts, are left out."""
        points, step = self.nearest(_ITERATIONS)
        beyond = np.flatnonzero(~points.inside())  # a curve through a point outside may reach into the box
        onto, step[beyond] = points.take(beyond).onto_sides()
        points.unknowns[beyond] = onto.unknowns
        near = step < _NEAR
        points, starts = points.take(near), self.parts[4][near]
        points = points.take((length(points.parts[4] - starts) < reach) & points.inside())
        candidates = np.flatnonzero(
            (length(points.force()) < _LITTLE_FORCE) & (points.kind == BorderKind.FOLD)
        )
        forks = points.take(candidates)._replace(
            kind=np.full_like(points.kind[candidates], BorderKind.PITCHFORK)
        )
        forks, _ = forks.nearest(_ITERATIONS)
        symmetric = length(forks.force()) < _EXACT
        others = points.take(np.delete(np.arange(len(points.kind)), candidates[symmetric]))
        return Degenerate.joined([others, forks.take(symmetric)])

    def force(self) -> Array:
        """Return the derivatives by both parameters of the potential's slope along the null vector. They are 0 at pitchforks."""
        x, _, v, _, position, _ = self.parts
        _, *by = self.potential.at(position)
        return np.stack([(v * (q * x + c)).sum(1) for q, c in by], -1)

    def character(self) -> tuple[NDArray[np.int64], Array, Array]:
        """Return the number of negative eigenvalues besides the vanishing one, two functions with zeros at special points, and a covector.

        On folds the first function is the potential's third derivative along the null vector, which is 0 at cusps. The second is 1. On
        pitchforks the first is the product of the other eigenvalues, and the second is this product times the fourth derivative. On
        limits of stability the first is P''(s) of the characteristic polynomial P, which is 0 at cusps, or -1 if the momentum is extremal.
        The second is the product of the eigenvalues. The covector (N, 2) points to the side with more solutions. On limits it points to
        the side with a larger number of stable solutions.
        """
        x, _, v, m, position, _ = self.parts
        forms, n = self.potential.forms, x.shape[1]
        first, *_ = self.matrices()
        _, *by = self.potential.at(position)
        basis = np.linalg.svd(first[:, n:, :n])[2][:, len(forms) :]
        values = np.linalg.eigvalsh(basis @ first[:, :n, :n] @ np.swapaxes(basis, 1, 2))
        degenerate = np.flatnonzero(~self.limit)
        values[degenerate, np.abs(values[degenerate]).argmin(1)] = 1.0
        curved = np.einsum("ni,kij,nj->nk", v, forms, v)
        third = 3 * (m * curved).sum(1)
        slope = self.force()
        if (limit := self.limit).any():
            limits = self.take(limit)
            bend = limits.characteristic()[0][:, 2]
            third[limit] = np.where(limits.kind == BorderKind.EXTREMAL_MOMENTUM, -1.0, bend)
            _, slope[limit] = limits.values_and_rates()
        fork = self.pitchfork
        bordered = np.zeros((fork.sum(), first.shape[1] + 1, first.shape[1] + 1))
        bordered[:, :-1, :-1] = first[fork]
        bordered[:, -1, :-1] = bordered[:, :-1, -1] = np.concatenate([v, m], 1)[fork]
        bent = np.concatenate([2 * np.einsum("nk,kij,nj->ni", m, forms, v), curved], 1)[fork]
        right = np.zeros((len(bent), bordered.shape[1], 3))
        right[:, :-1, 0] = bent
        for i, (q, c) in enumerate(by):
            right[:, :n, i + 1] = (q * x + c)[fork]
        reaction = np.einsum("nj,njf->nf", bent, _solved(bordered, right)[:, :-1])
        third[fork] = -3 * reaction[:, 0]
        slope[fork] = np.stack([(q * v**2).sum(1) for q, _ in by], -1)[fork] - reaction[:, 1:]
        product = values.prod(1)
        tests = np.stack(
            [np.where(fork, product, third), np.where(fork, product * third, np.where(limit, product, 1.0))]
        )
        return (values < 0).sum(1), tests, -np.sign(third)[:, None] * slope


def _extrema(coefficients: Array) -> Array:
    """Return the real numbers at which polynomials of degree 2 or 3 have extrema, and nan where there are none, (N, 2)."""
    _, first, second, third = coefficients.T
    with np.errstate(all="ignore"):
        larger = -second - np.copysign(np.sqrt(second**2 - 3 * first * third), second)
        roots = np.stack([larger / (3 * third), first / larger], 1)
    return np.where(np.isfinite(roots), roots, np.nan)
