"""Nonlinear stability of equilibria with two degrees of freedom, by Birkhoff's normal form of degree 4.

A gyrostat whose rotation about one direction e is cyclic keeps the momentum about e, and two degrees of freedom remain. If e is an
axis of symmetry of the body, e and the angular momentum m are taken in the frame. If nothing acts along alpha, e = gamma is the
vertical, and both are taken in the body. In both cases |e| = 1, m.e = S is constant, m and e have the brackets of the Euclidean
group, and

    H = m.J m / 2 + b.m + e.G e / 2 + c.e.

For an axis of symmetry, J = 1/I_t with the moment I_t across the axis, b = -Omega gamma, and the potentials of alpha, beta and
gamma give G and c. For the vertical, J = 1/I, b = -k/I, G = gradient I and c = field.

Let e = (cos v cos u, cos v sin u, sin v), where the longitude u and the latitude v are 0 at the equilibrium. With

    m = S (cos u, sin u, 0)/cos v + p_u (-tan v cos u, -tan v sin u, 1) + p_v (sin u, -cos u, 0)

u, v, p_u and p_v are canonical, and regular near the equilibrium. The Taylor polynomials of m and e are the same for all points.
The coefficients of H's polynomial are linear in the products of J, b, G, c and the components of m at the equilibrium.

The normal form is H = l1 J1 + l2 J2 + c20 J1^2 + c11 J1 J2 + c02 J2^2 + ..., with |l1| > |l2| and J = (q^2 + p^2)/2. An equilibrium is
stable for l1 l2 > 0. For l1 l2 < 0 without resonance up to order 4 it is stable if D = c20 l2^2 - c11 l1 l2 + c02 l1^2 is not 0
(V. I. Arnold, Sov. Math. Dokl. 2 (1961) 247; J. Moser, Lectures on Hamiltonian Systems, Mem. AMS 81 (1968)). The resonances follow
A. P. Markeev, Libration Points in Celestial Mechanics and Cosmodynamics (1978). At l1 = -2 l2 the equilibrium is unstable if there
is a resonant cubic term. At l1 = -3 l2 let B sqrt(J1 J2^3) cos(phi1 + 3 phi2 + const) be the resonant term. The equilibrium is then
stable for |c20 + 3 c11 + 9 c02| > 3 sqrt(3) B, else unstable. With three degrees of freedom invariant tori do not separate the
motions (Arnold diffusion), and these criteria do not show stability.
"""

from __future__ import annotations

from collections import Counter
from functools import cache
from itertools import permutations
from math import factorial
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...flags import EnergyStability, NonlinearStability, StabilityKind
from ...systems.base import Array, Flags, Points, subset
from ...systems.gyrostat.body import transverse_axes
from ...systems.gyrostat.oscillations import GROWTH_TOLERANCE, Equilibria
from ...systems.gyrostat.system import conservative, kinds_of_stability, steady_families
from . import RESONANCE_BAND

if TYPE_CHECKING:
    from scipy.sparse import csr_array

    from ...systems.gyrostat import Gyrostat

_ZERO = 1e-9  # A sum counts as different from 0 in a verdict if |sum| exceeds this fraction of the sum of |terms|.
_DEGREE = 4
_EXPONENTS = np.array([e for e in np.ndindex(*4 * [_DEGREE + 1]) if sum(e) <= _DEGREE])
_CHUNK = 256  # number of points computed together, so that arrays stay in the processor's cache
# Monomials of c20, c11, c02 and of the resonance 3:1. Each number is a factor: 0 and 1 mean zeta_1 and zeta_2, and 2 and 3 mean the
# conjugates of zeta_1 and zeta_2. A deviation from the equilibrium is w_1 zeta_1 + w_2 zeta_2 + conjugates, with eigenvectors w_1 and w_2.
_MONOMIALS = (0, 0, 2, 2), (0, 1, 2, 3), (1, 1, 3, 3), (0, 1, 1, 1)


class NormalForm(NamedTuple):
    """Coefficients (points,) of normal forms of degree 4, nan where the characteristic exponents are not imaginary."""

    l1: Array
    l2: Array
    c20: Array
    c11: Array
    c02: Array
    cubic: Array  # magnitude of the coefficient of zeta_1 zeta_2^2, which is resonant at l1 = -2 l2
    quartic: Array  # amplitude of the term sqrt(J1 J2^3) cos(phi1 + 3 phi2 + const) in actions and angles, resonant at l1 = -3 l2

    @classmethod
    def of(cls, second: Array, third: Array, fourth: Array) -> NormalForm:
        """Return normal forms from derivatives of the Hamiltonian by (q1, q2, p1, p2), of shapes (points, 4, 4), (points, 4, 4, 4), ..."""
        frequencies, modes = _modes(second)
        t = (third.reshape(-1, 16, 4) @ modes).reshape(-1, 4, 4, 4)
        transposed = np.swapaxes(modes, 1, 2)
        t = (transposed @ (transposed[:, None] @ t).reshape(-1, 4, 16)).reshape(-1, 4, 4, 4)
        t[np.abs(t) < 1e-12 * np.abs(t).max((1, 2, 3), keepdims=True, initial=0.0)] = 0.0
        first, other = modes[:, :, 0], modes[:, :, 1]
        actions = [_product(w, w.conj()).real for w in (first, other)]
        square = _product(other, other)
        images = np.stack([*actions, square.real, square.imag], 1) @ fourth.reshape(-1, 16, 16)
        # The fourth derivative for a monomial's factors is multiplied by the number of orders of these factors, and divided by 4!.
        direct = [
            (actions[0] * images[:, 0]).sum(1) / 4,
            (actions[0] * images[:, 1]).sum(1),
            (actions[1] * images[:, 1]).sum(1) / 4,
            (_product(first, other) * (images[:, 2] + 1j * images[:, 3])).sum(1) / 6,
        ]
        # This is half of {H3, chi}, where chi solves {H2, chi} = -H3.
        (a, b, c, e, d), weights, starts = _brackets()
        rates = np.concatenate([frequencies, -frequencies], 1)
        products = t[:, a, b, d] * t[:, c, e, (d + 2) % 4] * weights
        with np.errstate(all="ignore"):
            terms = np.where(products == 0, 0.0, products / (rates[:, c] + rates[:, e] - rates[:, d]))
        c20, c11, c02, resonant = np.stack(direct) + np.add.reduceat(terms, starts, axis=1).T
        cubic, quartic = np.abs(t[:, 0, 1, 1]) / 2, 2 * np.abs(resonant)
        l1, l2 = frequencies.T
        return cls(l1, l2, c20.real, c11.real, c02.real, cubic, quartic)

    @property
    def determinant(self) -> Array:
        """The determinant D of Arnold's theorem. Without resonance up to order 4, an equilibrium is stable if D is not 0."""
        return self.c20 * self.l2**2 - self.c11 * self.l1 * self.l2 + self.c02 * self.l1**2

    def verdict(self) -> Flags:
        """Return values of `flags.NonlinearStability`. The value is DEGENERATE where no normal form exists."""
        sizes = [np.abs(c) for c in (self.c20, self.c11, self.c02)]
        ratio = np.abs(self.l1 / self.l2)
        near = {order: np.abs(ratio - order) < RESONANCE_BAND for order in (1, 2, 3)}
        barrier, resonant = np.abs(self.c20 + 3 * self.c11 + 9 * self.c02), 3 * np.sqrt(3) * self.quartic
        margin = _ZERO * (sizes[0] + 3 * sizes[1] + 9 * sizes[2] + resonant)
        terms = sizes[0] * self.l2**2 + sizes[1] * np.abs(self.l1 * self.l2) + sizes[2] * self.l1**2
        rows = (
            (self.l1 * self.l2 > 0, NonlinearStability.ENERGY),
            (near[1], NonlinearStability.DEGENERATE),
            (near[2] & (self.cubic > _ZERO * np.abs(self.l1)), NonlinearStability.RESONANCE_UNSTABLE),
            (near[3] & (barrier > resonant + margin), NonlinearStability.RESONANCE_STABLE),
            (near[3] & (barrier < resonant - margin), NonlinearStability.RESONANCE_UNSTABLE),
            (near[3] | ~(np.abs(self.determinant) > _ZERO * terms), NonlinearStability.DEGENERATE),
            (near[2], NonlinearStability.RESONANCE_STABLE),
        )
        where, values = zip(*rows, strict=True)
        return np.select(where, values, NonlinearStability.ARNOLD_MOSER).astype(np.int8)


def of_points(system: Gyrostat, points: Points) -> tuple[Flags, Array]:
    """Return `NonlinearStability` (points,), and c20, c11, c02 and the normal form's determinant D, (4, points), nan if no form exists."""
    flags, kind = steady_families(system, points), kinds_of_stability(system, points)
    result = np.full(flags.shape, NonlinearStability.UNDECIDED, np.int8)
    values = np.full((4, flags.size), np.nan)
    undecided = ~np.isin(kind, (StabilityKind.UNKNOWN, StabilityKind.UNSTABLE))
    members = np.flatnonzero((flags > 0) & undecided)
    part = subset(points, members)
    body = system.body(part)
    rest = Equilibria.of(body, *system.start(part))
    members = members[rest.points]
    result[members], values[:, members] = stability(rest)
    values[:, members] /= body.inertia[rest.points].max(-1)
    degenerate = (kind == StabilityKind.MARGINAL) & (result != NonlinearStability.UNDECIDED)
    result[degenerate] = NonlinearStability.DEGENERATE
    for linear, verdict in (
        (StabilityKind.UNKNOWN, NonlinearStability.UNKNOWN),
        (StabilityKind.UNSTABLE, NonlinearStability.LINEARLY_UNSTABLE),
    ):
        result[kind == linear] = verdict
    # Without dissipation every momentum is constant, and a motion is stable at a maximum of the energy, as it is at a minimum.
    stable = np.isin(
        kind, (StabilityKind.ENERGY_STABLE, StabilityKind.ENERGY_STABLE_AXIAL, StabilityKind.GYROSCOPIC)
    )
    result[stable & (conservative(system, points)[0] == EnergyStability.YES)] = NonlinearStability.ENERGY
    return result, values


def stability(rest: Equilibria) -> tuple[Flags, Array]:
    """Return verdicts (points,), and c20, c11, c02 and the normal form's determinant D, (4, points), times the unit of moments of inertia.

    Without a normal form the four numbers are nan. With fewer than two degrees of freedom the verdict is DEGENERATE, and the caller takes
    the verdict from the energy. With more than two degrees of freedom the verdict is UNDECIDED.
    """
    count = (rest.cyclic != 0).any(1).sum(1)
    verdicts = np.where(count, NonlinearStability.DEGENERATE, NonlinearStability.UNDECIDED).astype(np.int8)
    values = np.full((4, count.size), np.nan)
    # A body that is symmetric about the vertical, or free, has one degree of freedom less.
    symmetric = rest.symmetric()
    about_axis = (rest.cyclic[..., 1] != 0).any(1)
    members = (count == 1) & (about_axis | ~symmetric) & ~rest.free & (rest.body.damping == 0)
    for first in range(0, count.size, _CHUNK):
        chunk = first + np.flatnonzero(members[first : first + _CHUNK])
        if chunk.size:
            form = NormalForm.of(*derivatives(rest, chunk))
            verdicts[chunk] = form.verdict()
            values[:, chunk] = form.c20, form.c11, form.c02, form.determinant * rest.rate[chunk] ** 2
    return verdicts, values


def derivatives(rest: Equilibria, members: NDArray[np.int64]) -> tuple[Array, Array, Array]:
    """Return the second, third and fourth derivatives of the Hamiltonian by (u, v, p_u, p_v) at the equilibria with indices `members`."""
    body, alpha, gamma = rest.body.subset(members), rest.alpha[members], rest.gamma[members]
    axis, inertia, turn = rest.cyclic[members, :, 1], body.inertia, body.turn[:, None]
    axial = (axis != 0).any(1, keepdims=True)
    e = np.where(axial, axis, gamma)
    along = (inertia * e).sum(1, keepdims=True)
    side = 0.5 * (inertia.sum(1, keepdims=True) - along)
    inverse = np.where(axial, 1 / side, 1 / inertia)
    linear = np.where(axial, -turn * gamma, -body.rotor / inertia)
    square = np.where(axial, 0.0, body.gamma.gradient[:, None] * inertia)[..., None] * np.eye(3)
    force = np.where(axial, 0.0, body.gamma.field)
    beta = np.cross(gamma, alpha)
    for direction, vector in ((body.alpha, alpha), (body.beta, beta), (body.gamma, gamma)):
        weight = np.where(axial, direction.gradient[:, None] * (along - side), 0.0)
        square = square + (weight * vector)[..., None] * vector[:, None]
        force = force + np.where(axial, (direction.field * e).sum(1, keepdims=True), 0.0) * vector
    axes = np.concatenate([e[:, None], transverse_axes(e)], 1)
    transposed = np.swapaxes(axes, 1, 2)
    inverse = (axes * inverse[:, None]) @ transposed
    square = axes @ square @ transposed
    linear, force, momentum = (
        (axes @ vector[..., None])[..., 0] for vector in (linear, force, inertia * turn * gamma + body.rotor)
    )
    S, p_v, p_u = momentum.T * [[1], [-1], [1]]
    weights = np.stack([S, p_u, p_v, np.ones_like(S)], 1)
    squares = weights[:, :, None] * weights[:, None]
    factors = [
        0.5 * inverse[:, :, :, None, None] * squares[:, None, None],
        linear[:, :, None] * weights[:, None],
        0.5 * square,
        force,
    ]
    table, places = _taylor()
    values = (table @ np.concatenate([factor.reshape(members.size, -1) for factor in factors], 1).T).T
    # `np.take` makes the derivatives of one point contiguous in memory, while values[:, place] would make the points contiguous.
    second, third, fourth = (np.take(values, place, axis=1) for place in places)
    return second, third, fourth


@cache
def _taylor() -> tuple[csr_array, list[NDArray[np.int64]]]:
    """Return a table of derivatives at 0 of the Hamiltonian's terms, (monomials, terms), and the row of each derivative of order 2 to 4."""
    from scipy.sparse import csr_array

    cos_u, sin_u = cos_v, sin_v = np.array([[1, 0, -1 / 2, 0, 1 / 24], [0, 1, 0, -1 / 6, 0]])
    one, sec, tan = np.array([[1, 0, 0, 0, 0], [1, 0, 1 / 2, 0, 5 / 24], [0, 1, 0, 1 / 3, 0]])

    def polynomial(*terms: tuple[Array, Array, tuple[int, int]]) -> Array:
        """Return the sum of terms, given by Taylor coefficients in u and in v and by the exponents of p_u and p_v."""
        dense = np.zeros(4 * [_DEGREE + 1])
        for in_u, in_v, momenta in terms:
            dense[(..., *momenta)] += np.outer(in_u, in_v)
        return dense[tuple(_EXPONENTS.T)]

    still, zero = (0, 0), 0 * one
    e = np.array([polynomial((x, y, still)) for x, y in ((cos_u, cos_v), (sin_u, cos_v), (one, sin_v))])
    of_s = [(cos_u, sec), (sin_u, sec), (zero, zero)]
    of_p_u = [(-cos_u, tan), (-sin_u, tan), (one, one)]
    of_p_v = [(sin_u, one), (-cos_u, one), (zero, zero)]
    rows = []
    for parts in zip(of_s, of_p_u, of_p_v, strict=True):
        deviation = polynomial((*parts[1], (1, 0)), (*parts[2], (0, 1)))
        rows.append([*(polynomial((*part, still)) for part in parts), deviation])
    m = np.array(rows)
    functions = [_times(m[:, None, :, None], m[:, None, :]), m, _times(e[:, None], e), e]
    table = np.concatenate([part.reshape(-1, len(_EXPONENTS)) for part in functions])
    table = table * np.vectorize(factorial)(_EXPONENTS).prod(1)
    place = {tuple(exponents): i for i, exponents in enumerate(_EXPONENTS.tolist())}
    places = []
    for order in (2, 3, 4):
        exponents = [tuple(index.count(i) for i in range(4)) for index in np.ndindex(*order * [4])]
        places.append(np.reshape([place[each] for each in exponents], order * [4]))
    return csr_array(table.T), places


def _times(a: Array, b: Array) -> Array:
    """Return products of polynomials (..., monomials), up to the degree `_DEGREE`."""
    sums = _EXPONENTS[:, None] + _EXPONENTS
    i, j = np.nonzero(sums.sum(2) <= _DEGREE)
    result = np.zeros((len(_EXPONENTS), *np.broadcast_shapes(a.shape, b.shape)[:-1]))
    place = (sums[i, j][:, None] == _EXPONENTS).all(2).argmax(1)
    np.add.at(result, place, np.moveaxis(a[..., i] * b[..., j], -1, 0))
    return np.moveaxis(result, 0, -1)


def _product(a: NDArray[np.complex128], b: NDArray[np.complex128]) -> NDArray[np.complex128]:
    """Return the outer products of vectors (points, 4), as rows (points, 16)."""
    return (a[:, :, None] * b[:, None]).reshape(len(a), 16)


def _modes(second: Array) -> tuple[Array, NDArray[np.complex128]]:
    """Return the frequencies l of z' = J H'' z, (points, 2), and eigenvectors w_1, w_2 and their conjugates as columns, (points, 4, 4).

    The eigenvector w of the eigenvalue -i l has w* J w = -i. With z = zeta w + conjugate, |zeta|^2 is the action of a mode.
    """
    A = np.concatenate([second[:, 2:], -second[:, :2]], 1)
    square = A @ A
    half = -0.25 * np.trace(square, axis1=1, axis2=2)
    determinant = np.linalg.det(second)
    with np.errstate(invalid="ignore", divide="ignore"):
        root = np.sqrt(half**2 - determinant)
        # At a resonance 1:1 the modes are not defined.
        large = np.where(root > GROWTH_TOLERANCE * half, half + root, np.nan)
        squares = np.stack([large, determinant / large], 1)
        frequencies = np.sqrt(squares)
        vectors = []
        for i in (0, 1):
            # By Cayley and Hamilton, A^2 + l^2 with the frequency l of the other mode maps every vector into the plane of this mode.
            part = square + squares[:, 1 - i, None, None] * np.eye(4)
            column = np.take_along_axis(part, (part**2).sum(1).argmax(1)[:, None, None], 2)[..., 0]
            vector = (A @ column[..., None])[..., 0] - 1j * frequencies[:, i, None] * column
            norm = -2 * (vector[:, :2].conj() * vector[:, 2:]).imag.sum(1)
            frequencies[:, i] *= np.sign(norm)
            vector = np.where(norm[:, None] > 0, vector, vector.conj())
            vectors.append(vector / np.sqrt(np.abs(norm))[:, None])
    return frequencies, np.stack([*vectors, *(vector.conj() for vector in vectors)], -1)


@cache
def _brackets() -> tuple[NDArray[np.int64], Array, list[int]]:
    """Return the terms of {H3, chi} / 2 as rows of indices a, b, c, e and d, and as factors. Also return where each monomial's terms start.

    The Poisson bracket {H2, chi} is -H3, where H2 and H3 are the terms of degree 2 and 3 of the Hamiltonian. Let t be the third
    derivatives of H3, and d* the index of conj(zeta_d). A term is then factor * t_abd t_ced* / (rate_c + rate_e - rate_d).
    """
    indices: list[tuple[int, ...]] = []
    weights, starts = [], []
    for monomial in _MONOMIALS:
        starts.append(len(indices))
        orders = Counter((*sorted(order[:2]), *sorted(order[2:])) for order in set(permutations(monomial)))
        for d, sign in enumerate((1, 1, -1, -1)):
            indices += [(*order, d) for order in orders]
            weights += [sign * count / 8 for count in orders.values()]
    return np.array(indices).T, np.array(weights), starts
