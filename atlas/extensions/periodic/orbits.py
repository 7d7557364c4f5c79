"""Periodic motions by multiple shooting, and the small oscillations about steady motions from which families are born.

A motion repeats after a period T up to a turn R(chi) by chi about the third axis, y(T) = R(chi) y(0). The motion is given by m states
a time T/m apart. Newton's method solves for the states, T and chi. Each segment must end at the next state, and the momenta must be
those of the family. The changes of all states together must be orthogonal to the flow and to turns about an axis of symmetry. Along
the family, the arc length or the energy is given. The integrals make some equations redundant. The square of the length of a step is
the mean square of the changes of states, plus the squares of the changes of T (in units of the period at the birth) and of chi.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from scipy.linalg.lapack import dgels

from ...systems.base import Array
from .flow import SIZE, Flow, turn

ROUNDING = 1e-6  # real or imaginary parts of exponents may be rounding errors if smaller than this fraction of the frequency bound
# Newton's method makes at most NEWTON steps and fails at a step above TOO_FAR. It has converged at a step below CONVERGED, or at a
# step below STALLED that hardly shrinks any more.
NEWTON, CONVERGED, STALLED, TOO_FAR = 8, 1e-12, 1e-9, 3.0
# A nearly singular orbit is accepted if residuals are below CLOSED and the step is below ROUNDED. A matrix is singular
# if its QR factor has a diagonal element below SINGULAR times the largest.
CLOSED, ROUNDED, SINGULAR = 1e-13, 1e-6, 1e-14
# A multiplier above LARGE makes the others inaccurate. The others are computed without it if it exceeds them by the factor SEPARATE.
LARGE, SEPARATE = 1e6, 1e4


class Birth(NamedTuple):
    """A small oscillation about a steady motion; `mode` is the complex amplitude of the state's change, (6,)."""

    frequency: float
    mode: Array


@dataclass(frozen=True)
class Orbit:
    """A periodic motion, and the tangent of the family at the motion."""

    states: Array  # m states, `period` / m apart, (m, components of a state)
    period: float
    chi: float
    bound: float  # bound of the fastest frequency
    tangent: Array  # unit vector along the family, with 6 changes of each state, then the changes of period and chi


class Solution(NamedTuple):
    """A periodic motion that Newton's method has found."""

    orbit: Orbit
    matrices: Array  # each maps changes at the start of a segment to changes at the end, (segments, 6, 6)
    closing: float  # largest difference between the end of a segment and the next state
    iterations: int
    distance: float  # distance from the guess


def across(rows: Array) -> Array:
    """Return a basis, (6, n), of the vectors orthogonal to `rows`, which may be linearly dependent."""
    _, size, vectors = np.linalg.svd(np.vstack([np.zeros((1, SIZE)), rows]))
    return vectors[(size > 1e-9 * size.max()).sum() :].T


class SteadyMotion:
    """A steady motion. In the body, the vectors of the state turn about the third axis at the constant rate `spin`."""

    def __init__(self, flow: Flow) -> None:
        self.flow, self.state = flow, flow.start
        slope, self.along = flow.slopes(self.state[None])[0], flow.symmetry(self.state[None])[0]
        self.spin = float(self.along @ slope / max(self.along @ self.along, 1e-300))
        self.residual = float(np.abs(slope - self.spin * self.along).max())

    def births(self) -> tuple[list[Birth], int]:
        """Return the small oscillations that keep all momenta, the fastest first, and the number of exponents that are 0."""
        flow, bound = self.flow, self.flow.bound(self.state)
        time = 0.5 / bound
        matrix = turn(-self.spin * time) @ flow.run(self.state[None], time, bound)[1][0]
        basis = across(np.vstack([flow.gradients(flow.held, self.state), self.along]))
        values, vectors = np.linalg.eig(basis.T @ matrix @ basis)
        exponents, result = np.log(values.astype(complex)) / time, []
        for exponent, vector in zip(exponents, vectors.T, strict=True):
            if exponent.imag > ROUNDING * bound > abs(exponent.real):
                mode, factor = basis @ vector, np.exp(exponent * time)
                # The mode also has a part along turns about the axis of symmetry. `basis` is orthogonal to such turns.
                swing = self.along @ (matrix @ mode - factor * mode) / max(self.along @ self.along, 1e-300)
                mode = mode + self.along * swing / (factor - 1)
                mode = mode * np.exp(-0.5j * np.angle((mode * mode).sum())) / np.linalg.norm(mode)
                result.append(Birth(float(exponent.imag), mode))
        zeros = int((abs(exponents) <= ROUNDING * bound).sum())
        return sorted(result, reverse=True, key=lambda each: each.frequency), zeros


class Family:
    """The equations of a family of periodic motions."""

    def __init__(self, steady: SteadyMotion, birth: Birth) -> None:
        self.flow, self.steady, self.birth = steady.flow, steady, birth
        self.unit = 2 * np.pi / birth.frequency  # unit of the period
        self.level = [self.flow.value(name, steady.state) for name in self.flow.held]
        self.birth_energy = self.flow.value(self.flow.energy, steady.state)

    def scales(self, m: int) -> Array:
        """Return the units of the unknowns of an orbit with `m` states."""
        return np.append(np.full(SIZE * m, np.sqrt(m)), [self.unit, 1.0])

    def born(self, m: int) -> Orbit:
        """Return the orbit of amplitude 0 with `m` states."""
        T, q, w, y = self.unit, self.steady.spin, self.birth.frequency, self.steady.state
        times = np.arange(m) * T / m
        states = np.concatenate([self.flow.turned(y[None], q * t) for t in times])
        changes = [turn(q * t) @ (self.birth.mode * np.exp(1j * w * t)).real for t in times]
        tangent = np.append(np.concatenate(changes), [0.0, 0.0]) / self.scales(m)
        return Orbit(states, T, q * T, self.flow.bound(y), tangent / np.linalg.norm(tangent))

    def moved(self, orbit: Orbit, step: Array) -> Orbit:
        """Return the orbit after a change of its unknowns by `step`, in units of `scales`."""
        change = step * self.scales(len(orbit.states))
        states = self.flow.moved(orbit.states, change[:-2].reshape(-1, SIZE))
        return replace(orbit, states=states, period=orbit.period + change[-2], chi=orbit.chi + change[-1])

    def equations(self, orbit: Orbit) -> tuple[Array, Array, Array]:
        """Return residuals, their derivatives by the scaled unknowns, and segments' matrices. The residuals of segments come first."""
        flow, m, n = self.flow, len(orbit.states), SIZE * len(orbit.states)
        ends, matrices = flow.run(orbit.states, orbit.period / m, orbit.bound)
        ends[-1:], matrices[-1] = flow.turned(ends[-1:], -orbit.chi), turn(-orbit.chi) @ matrices[-1]
        states = np.concatenate([orbit.states, ends[-1:], ends[:-1]])
        slopes, along = flow.slopes(states), flow.symmetry(states)
        jacobian = np.zeros((n + len(flow.held) + 2, n + 2))
        blocks, i, j = jacobian[:n, :n].reshape(m, SIZE, m, SIZE), np.arange(m), (np.arange(m) + 1) % m
        blocks[i, :, i] = matrices
        blocks[i, :, j] -= np.eye(SIZE)
        jacobian[:n, -2] = np.roll(slopes[m:], -1, 0).ravel() / m
        jacobian[n - SIZE : n, -1] = -along[m]
        jacobian[n:-2, :SIZE] = flow.gradients(flow.held, orbit.states[0])
        velocity = slopes[:m] - orbit.chi / orbit.period * along[:m]
        for row, phase in enumerate((velocity, along[:m]), -2):
            jacobian[row, :n] = phase.ravel() / max(float(np.linalg.norm(phase)), 1e-300)
        jacobian[-1, -1] = not flow.symmetric
        residual = flow.difference(ends, orbit.states[j]).ravel()
        held = [flow.value(name, orbit.states[0]) for name in flow.held]
        residual = np.concatenate([residual, np.subtract(held, self.level), [0, 0]])
        return residual, jacobian * self.scales(m), matrices

    def energy(self, orbit: Orbit) -> float:
        return self.flow.value(self.flow.energy, orbit.states[0])

    def energy_row(self, orbit: Orbit) -> Array:
        """Return the derivatives of the energy by the unknowns in units of `scales`."""
        row = np.zeros_like(orbit.tangent)
        row[:SIZE] = self.flow.gradients([self.flow.energy], orbit.states[0])[0] * np.sqrt(len(orbit.states))
        return row

    def corrected(self, guess: Orbit, energy: float | None = None) -> Solution | None:
        """Correct `guess` by Newton's method, at the given `energy` or else orthogonally to the tangent. Return None on failure."""
        orbit, last, total = guess, np.inf, np.zeros_like(guess.tangent)
        for iteration in range(NEWTON):
            residual, jacobian, matrices = self.equations(orbit)
            row, value = guess.tangent, 0.0
            if energy is not None:
                row, value = self.energy_row(orbit), self.energy(orbit) - energy
            right = np.zeros((2, len(residual) + 1))
            right[0, :-1], right[0, -1], right[1, -1] = -residual, -value, 1.0
            step, tangent = _solve(np.vstack([jacobian, row]), right.T).T
            size = float(np.linalg.norm(step))
            if not size < TOO_FAR:
                return None
            closed = np.abs(right[0]).max() < CLOSED and size < ROUNDED
            if size < CONVERGED or closed or 0.1 * last < size < STALLED:
                tangent *= np.sign(tangent @ guess.tangent) / np.linalg.norm(tangent)
                closing = float(np.abs(residual[: SIZE * len(orbit.states)]).max())
                distance, orbit = float(np.linalg.norm(total)), replace(orbit, tangent=tangent)
                return Solution(orbit, matrices, closing, iteration, distance)
            orbit, total, last = self.moved(orbit, step), total + step, size
            if not orbit.period > 0:
                return None
        return None

    def steady_state(self, orbit: Orbit, place: int) -> Array | None:
        """Return the steady motion near state `place` of `orbit`, or None. Newton's method finds it as a motion of short period."""
        time = 0.5 / orbit.bound
        chi = orbit.chi * time / orbit.period
        short = replace(orbit, states=orbit.states[place : place + 1], period=time, chi=chi)
        for _ in range(20):
            residual, jacobian, _ = self.equations(short)
            step = np.linalg.lstsq(np.delete(jacobian[:-2], -2, 1), -residual[:-2], rcond=1e-10)[0]
            if not np.abs(step).max() < TOO_FAR:
                break
            short = self.moved(short, np.insert(step, -1, 0.0))
            if np.abs(step).max() < 1e-11:
                return short.states[0]
        return None

    def meshed(self, orbit: Orbit, m: int) -> Orbit:
        """Return the same orbit and tangent with `m` states."""
        flow, old = self.flow, len(orbit.states)
        change = orbit.tangent * self.scales(old)
        changes, states, tangent = change[:-2].reshape(old, SIZE), [], []
        for place in np.arange(m) * old / m:
            i, share = int(place), place % 1 / old
            y, matrix = flow.run(orbit.states[i : i + 1], max(share, 1e-15) * orbit.period, orbit.bound)
            states.append(y)
            tangent.append(matrix[0] @ changes[i] + flow.slopes(y)[0] * share * change[-2])
        new = np.append(np.concatenate(tangent), change[-2:]) / self.scales(m)
        return replace(orbit, states=np.concatenate(states), tangent=new / np.linalg.norm(new))

    def multipliers(self, orbit: Orbit, matrices: Array) -> Array:
        """Return the multipliers without those that are always 1, in pairs mu, 1/mu with |mu| >= 1."""
        flow, states, names = self.flow, orbit.states, [*self.flow.held, self.flow.energy]

        def basis(i: int) -> Array:
            """Return a basis of changes of state `i` that keep the integrals and are orthogonal to the flow and to turns about the axis."""
            y = states[i : i + 1]
            return across(np.vstack([flow.gradients(names, y[0]), flow.slopes(y), flow.symmetry(y)]))

        first = basis(0)
        matrix = first
        for part in matrices:
            matrix = part @ matrix
        matrix = first.T @ matrix
        large = float(np.abs(matrix).max(initial=0.0)) > LARGE
        if large:
            # Take QR factors of every segment. After three rounds the first directions are those of the largest multipliers.
            bases = [first, *map(basis, range(1, len(states))), first]
            parts = [b.T @ part @ a for a, part, b in zip(bases, matrices, bases[1:], strict=False)]
            final = np.eye(len(matrix))
            for _ in range(3):
                before, product = final, np.eye(len(matrix))
                for part in parts:
                    final, upper = np.linalg.qr(part @ final)
                    product = upper @ product
            matrix = before.T @ final @ product
        values, result = list(np.linalg.eigvals(matrix).astype(complex)), list[complex]()
        while values:
            # The multipliers are pairs mu, 1 / mu. Only the larger multiplier of a pair is accurate, and the other is computed as 1 / mu.
            mu = values.pop(int(np.argmax(np.abs(values))))
            if large and len(values) == 3 and abs(mu) > SEPARATE * np.abs(values).max():
                values = sorted(np.linalg.eigvals(matrix[1:, 1:]).astype(complex), key=abs)[1:]
            else:
                values.pop(int(np.argmin(np.abs(np.array(values) - 1 / mu))))
            result += [mu, 1 / mu]
        return np.array(result)


def _solve(matrix: Array, right: Array) -> Array:
    """Return the least-squares solution for each column of `right`, by a QR factorization. It is infinite if `matrix` is singular."""
    factors, solution, _ = dgels(matrix, right)
    diagonal, size = np.abs(np.diag(factors)), matrix.shape[1]
    regular = diagonal.min() > SINGULAR * diagonal.max()
    return solution[:size] if regular else np.full((size, right.shape[1]), np.inf)
