"""Exact periodic solutions of the paper's equations (1) at any eps, by shooting, with Floquet multipliers. Letters are as in `fast_spin`.

A solution of (1) whose gamma returns after about one turn is fixed by r1 = g1'' = 1 and the phase gamma2' = 0 at tau = 0, as in
(22). The unknowns are eps p1, eps q1, the angle of g1 + i g1' and the period. Four of the six multipliers are 1, because of the
direction of the motion and the three integrals (2). The others are rho and 1/rho, and their sum is the trace of the monodromy
matrix minus 4. The solution is stable where rho is on the unit circle.

Without a field the solution is known. The point p1 + i q1 rests at mu / Omega, and gamma turns about the axis of rotation with
the period 2 pi / |w|, where w is the angular velocity in units of r0. `follow` raises the field from 0 to its value at constant
l / (A r0), which is the same as raising eps from 0. A solution is found if the path does not end before the full field.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from ...flags import PeriodicSolution
from ...kernel.tableaux import RK8
from ...systems.base import Array, Flags, Mask, Points
from .fast_spin import CHUNK, FastSpin, fast_spin, rhs, to_quasilinear

STEPS = 24  # number of steps of rk8 in a period while `follow` raises the field
FINE = 48  # number of steps in a period of final solutions, which makes errors of rk8 as small as rounding errors
# Largest allowed correction of each unknown. A larger correction may lead to another solution.
LARGEST_CORRECTION = np.array([[0.2], [0.2], [0.2], [1.0]])
LEAST_STEP = 0.005  # shortest step of `follow`, as a fraction of the full field; a path that needs a shorter step has a fold
DEFECT = 1e-5  # a step of `follow` fails if the defect before the last correction is larger
MARGIN = 1e-7  # distance of |trace| from 2 within which rounding decides on stability


class Periodic(NamedTuple):
    """Periodic solutions of some points, with nan where no solution is reached."""

    start: Array  # y at tau = 0, (6, points)
    period: Array  # in tau, (points,)
    trace: Array  # sum of the two multipliers that may differ from 1, (points,)

    @property
    def stability(self) -> Flags:
        """Values of PeriodicSolution for the points, (points,)."""
        excess = np.abs(self.trace) - 2
        kinds = (PeriodicSolution.STABLE, PeriodicSolution.UNSTABLE, PeriodicSolution.MARGINAL)
        where = (excess < -MARGIN, excess > MARGIN, ~np.isnan(excess))
        return np.select(where, kinds, PeriodicSolution.NOT_REACHED).astype(np.int8)


def flow(spin: FastSpin, y: Array, directions: Array, period: Array, steps: int) -> tuple[Array, Array]:
    """Return the state after a period, (6, points), and its derivatives along k directions of the start, (6, k, points).

    The right side f of (1) is quadratic, so that its derivative along v is exactly [f(y + v) - f(y - v)] / 2.
    """
    k = directions.shape[1]

    def slope(bundle: Array) -> Array:
        centre, change = bundle[:, :1], bundle[:, 1:]
        rate = rhs(spin, np.concatenate([centre, centre + change, centre - change], 1))
        return np.concatenate([rate[:, :1], 0.5 * (rate[:, 1 : k + 1] - rate[:, k + 1 :])], 1)

    bundle, h = np.concatenate([y[:, None], directions], 1), period / steps
    for _ in range(steps):
        slopes: list[Array] = []
        for row in RK8.a:
            slopes.append(slope(bundle + h * _sum(row, slopes)))
        bundle = bundle + h * _sum(RK8.b, slopes)
    return bundle[:, 0], bundle[:, 1:]


def _sum(weights: tuple[float, ...], slopes: list[Array]) -> Array | float:
    return sum(a * slope for a, slope in zip(weights, slopes, strict=True) if a)


def state(spin: FastSpin, x: Array) -> Array:
    """Return y at tau = 0 from the unknowns x, (4, points), which are eps p1, eps q1, the angle of g1 + i g1' and the period."""
    one = np.ones_like(x[0])
    return np.array(
        [x[0] / spin.eps, x[1] / spin.eps, one, spin.M3 * np.cos(x[2]), spin.M3 * np.sin(x[2]), one]
    )


def correct(spin: FastSpin, x: Array, corrections: int, steps: int = STEPS) -> tuple[Array, Array]:
    """Correct the unknowns by Newton's method. Also return the defect d before the last correction. The final defect is about d^2."""
    unit = np.array([1.0, 1, 0, 0, 0, 0])[:, None] * spin.eps + np.array([0.0, 0, 1, 1, 1, 1])[:, None]
    for _ in range(corrections):
        y, zero = state(spin, x), np.zeros_like(x[0])
        along = np.array(
            [[zero + 1 / spin.eps, zero, zero, zero, zero, zero], [zero, zero + 1 / spin.eps, zero, zero, zero, zero],
             [zero, zero, zero, -y[4], y[3], zero]]
        ).swapaxes(0, 1)  # fmt: skip
        end, changed = flow(spin, y, along, x[3], steps)
        phase, ahead, behind = (
            to_quasilinear(spin, at)[3] for at in (y[:, None], y[:, None] + along, y[:, None] - along)
        )
        defect = np.concatenate([(end - y) * unit, phase])
        columns = np.concatenate([changed - along, rhs(spin, end)[:, None]], 1) * unit[:, None]
        last = np.concatenate([0.5 * (ahead - behind), zero[None]])  # exact, as to_quasilinear is quadratic
        matrix = np.moveaxis(np.concatenate([columns, last[None]]), -1, 0)
        finite = np.isfinite(matrix).all((1, 2)) & np.isfinite(defect).all(0)
        # Three of the seven equations follow from the others, because of the integrals.
        inverse = np.linalg.pinv(np.where(finite[:, None, None], matrix, 0.0))
        x = x - np.where(finite, np.einsum("nij,jn->in", inverse, np.where(finite, defect, 0.0)), np.nan)
    return x, np.abs(defect).max(0)


def follow(spin: FastSpin, pause: Callable[[], None] = lambda: None) -> tuple[Array, Mask]:
    """Return the unknowns of periodic solutions, (4, points), and whether each is reached. Attributes of `spin` are arrays (points,)."""
    free = spin.eps * spin.forced
    angle = np.arcsin(np.clip(free.imag / spin.M3, -1, 1))
    x = np.array([free.real, free.imag, angle, 2 * np.pi / np.sqrt(1 + np.abs(free) ** 2)])
    slope, share, step = np.zeros_like(x), np.zeros_like(angle), np.ones_like(angle)
    step[~(np.abs(free.imag) < spin.M3)] = 0.0  # no solution exists if |g1'| = |eps q1| at tau = 0 exceeds M3
    while (active := np.flatnonzero((share < 1) & (step >= LEAST_STEP))).size:
        pause()
        target = np.minimum(share + step, 1)[active]
        length, before = target - share[active], x[:, active]
        guess = before + slope[:, active] * length
        part = FastSpin(*(getattr(spin, name)[active] for name in spin.__dataclass_fields__))
        after, defect = correct(replace(part, weight=target * part.weight, N=target * part.N), guess, 4)
        accepted = (defect < DEFECT) & (np.abs(after - guess) < LARGEST_CORRECTION).all(0)
        x[:, active] = np.where(accepted, after, before)
        slope[:, active] = np.where(accepted, (after - before) / length, slope[:, active])
        share[active], step[active] = (
            np.where(accepted, target, share[active]),
            np.where(accepted, 2, 0.5) * step[active],
        )
    return x, share >= 1


def of_unknowns(spin: FastSpin, x: Array) -> Periodic:
    """Return the periodic solutions with the unknowns `x`."""
    y, size = state(spin, x), x.shape[1]
    along = np.eye(6)[:, :, None] * np.array([spin.eps**-1, spin.eps**-1, *4 * (np.ones(size),)])[:, None]
    changed = flow(spin, y, along, x[3], FINE)[1]
    trace = (np.einsum("iin->in", changed) / np.einsum("iin->in", along)).sum(0) - 4
    return Periodic(y, x[3], trace)


def solutions(spin: FastSpin, pause: Callable[[], None] = lambda: None) -> Periodic:
    """Find periodic solutions by `follow`. The attributes of `spin` have the shape (points,)."""
    with np.errstate(all="ignore"):
        x, reached = follow(spin, pause)
        x, _ = correct(spin, np.where(reached, x, np.nan), 2, FINE)
        return of_unknowns(spin, x)


def of_points(points: Points, pause: Callable[[], None]) -> tuple[Flags, Array, Array]:
    """Return values of PeriodicSolution, periods in time units, and traces, each (points,). A trace is a sum of two Floquet multipliers."""
    columns = []
    for first in range(0, points["A"].size, CHUNK):
        spin = fast_spin({name: values[first : first + CHUNK] for name, values in points.items()})
        reached = solutions(spin, pause)
        columns.append((reached.stability, reached.period / np.abs(spin.r0), reached.trace))
    stability, period, trace = map(np.concatenate, zip(*columns, strict=True))
    return stability, period, trace
