"""Samples of the Euler rates, and the quadrature rule that averages the samples over a run.

The unit of time is the distance of two nodes. Inside a run the rule is the trapezoidal rule on the nodes, whose error falls
exponentially. Near both ends the variable of integration changes from t to tau(t), which grows like the logarithm of the
distance from the end. Samples that are uniform in tau then crowd geometrically towards the end. A singularity of a rate beyond
an end therefore costs no accuracy, whatever the distance (H. Takahasi and M. Mori, Publ. RIMS 9 (1974) 721-741).
"""

from __future__ import annotations

from functools import cache
from typing import NamedTuple

import numpy as np
from numpy.polynomial import Polynomial
from numpy.typing import NDArray

# At t intervals from an end of a run, the variable of integration is tau(t) = t + CLUSTERING log(1 - exp(-p)), where
# p = t / CLUSTERING + (t / SQUARE)^2 + (t / FOURTH)^4. A singularity of a rate beyond the end lies CLUSTERING pi / 2 or more from
# the real tau axis and causes an error of at most about exp(-pi^2 CLUSTERING).
CLUSTERING = 2.25
SQUARE, FOURTH = 5.0, 9.0
# Samples crowd in the first and the last END intervals of a run. These parts do not overlap if the run has LONG intervals or more.
END = 18
LONG = 2 * END
# Coefficients B_2k / (2k)! of the derivatives of order 1, 3, 5 and 7 in the Euler-Maclaurin formula.
_EULER_MACLAURIN = (1 / 12, -1 / 720, 1 / 30240, -1 / 1209600)
# A run has at least three intervals, because the motion is interpolated between four nodes.
MIN_INTERVALS = 3
# The sample nearest to an end of a run is placed at about this distance from the end, in intervals.
NEAREST = 1e-7
SAME_AS_NODE = 1e-11


def sample(motion, cylinder_squared):
    """Return theta', psi', phi', normal rate, sin^2 theta and `outside` (1.0, or 0.0 in the cylinder, where psi' and phi' become 0)."""
    u1, u2, u3, g1, g2, g3 = motion
    sin2_theta = g1 * g1 + g2 * g2
    inverse = 1.0 / (sin2_theta if sin2_theta > 1e-300 else 1e-300)
    outside = 1.0 if sin2_theta >= cylinder_squared else 0.0
    along = u1 * g1 + u2 * g2
    psi_dot = along * inverse * outside
    phi_dot = (u3 - psi_dot * g3) * outside
    theta_dot = (u1 * g2 - u2 * g1) * np.sqrt(inverse)
    return theta_dot, psi_dot, phi_dot, along + u3 * g3, sin2_theta, outside


def rule_position(i, intervals):
    """Return the index of node or interval i in the rules of `Quadrature`. Nodes in the middle of a long run have the same index."""
    return i - min(max(intervals - LONG, 0), max(i - END, 0))


class Quadrature(NamedTuple):
    """Quadrature rules of runs, indexed by the number of intervals. The last rule is for LONG intervals and more."""

    node_weights: NDArray[np.float64]  # weights, indexed by number of intervals and by `rule_position`
    # In a run of n intervals, the samples from first_sample[n, i] up to first_sample[n, i + 1] - 1 lie between nodes i and i + 1.
    first_sample: NDArray[np.int64]
    samples: NDArray[np.float64]  # weight of each sample, then the sample's `hermite_weights`, (samples, 9)


@cache
def quadrature() -> Quadrature:
    """Return the rules for MIN_INTERVALS intervals and more. Weights are positive; their sum is the number of intervals."""
    node_weights = np.zeros((LONG + 1, LONG + 1))
    first_sample = np.zeros((LONG + 1, LONG + 1), np.int64)
    rows, count = [], 0
    lengths = range(MIN_INTERVALS, LONG + 1)
    for intervals, (t, weight) in zip(lengths, instants(*lengths), strict=True):
        node = np.rint(t)
        at_node = np.abs(t - node) < SAME_AS_NODE
        at_node &= (node > 0) & (node < intervals)
        node_weights[intervals, node[at_node].astype(int)] = weight[at_node]
        node_weights[intervals, [0, intervals]] = 0.5 * (intervals - weight.sum())
        t, weight = t[~at_node], weight[~at_node]
        interval = np.minimum(t.astype(np.int64), intervals - 1)
        first_sample[intervals] = count + np.searchsorted(interval, np.arange(LONG + 1))
        # A sample is interpolated from two nodes before and two after. The first (last) interval of a run uses the first (last) four nodes.
        first_node = np.clip(interval - 1, 0, intervals - 3)
        rows.append(np.column_stack([weight, hermite_weights(t - first_node)]))
        count += t.size
    return Quadrature(node_weights, first_sample, np.concatenate(rows))


def instants(*lengths: int) -> list[tuple[NDArray[np.float64], NDArray[np.float64]]]:
    """Return, for each length of a run, the instants and weights of the samples between the ends, in ascending order."""
    intervals = np.array(lengths)[:, None]
    reach = int(np.ceil(-np.log(NEAREST) * CLUSTERING)) + END
    tau = np.minimum(np.arange(-reach, max(lengths) + reach + 1.0), intervals + reach)
    low, high = np.full(tau.shape, -40.0), np.full(tau.shape, 40.0)  # bounds of x in `_from_both_ends`
    for _ in range(20):
        middle = 0.5 * (low + high)
        too_low = stretched(*_from_both_ends(middle, intervals))[0] < tau
        low, high = np.where(too_low, middle, low), np.where(too_low, high, middle)
    for _ in range(4):  # Newton's method
        start, end = _from_both_ends(middle, intervals)
        value, slope = stretched(start, end)
        middle = np.clip(middle + (tau - value) * intervals / (slope * start * end), low - 1.0, high + 1.0)
    start, end = _from_both_ends(middle, intervals)
    mask = np.minimum(start, end) > 0.5 * NEAREST
    weight = 1.0 / stretched(start, end)[1]
    return [(start[i][mask[i]], weight[i][mask[i]]) for i in range(len(lengths))]


def _from_both_ends(
    x: NDArray[np.float64], intervals: NDArray[np.int64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the distances from the start and from the end of a run at which the quotient start / end is exp(x)."""
    return intervals / (1.0 + np.exp(-x)), intervals / (1.0 + np.exp(x))


def stretched(start, end):
    """Return the variable of integration tau and d tau / dt at the distance `start` from the first node and `end` from the last node."""
    from_start, slope_start = end_stretch(start)
    from_end, slope_end = end_stretch(end)
    return start + from_start - from_end, 1.0 + slope_start + slope_end


def end_stretch(t):
    """Return the term of `stretched` for one end of a run, where t is the distance from this end, and the term's derivative by t."""
    x, y = t * (1.0 / SQUARE), t * (1.0 / FOURTH)
    small = np.exp(-(t * (1.0 / CLUSTERING) + x * x + y * y * y * y))
    slope = 1.0 / CLUSTERING + 2.0 * x * (1.0 / SQUARE) + 4.0 * y * y * y * (1.0 / FOURTH)
    return CLUSTERING * np.log(1.0 - small), CLUSTERING * slope * small / (1.0 - small)


def hermite_weights(x: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the weights of values, then of derivatives, at 0, 1, 2, 3 in Hermite interpolation of degree 7 at x."""
    nodes = np.arange(4.0)
    weights = np.empty((x.size, 8))
    for k in range(4):
        others = np.delete(nodes, k)
        square = np.prod((x[:, None] - others) / (k - others), axis=1) ** 2
        weights[:, k] = (1.0 - 2.0 * np.sum(1.0 / (k - others)) * (x - k)) * square
        weights[:, 4 + k] = (x - k) * square
    return weights


class EndWeights(NamedTuple):
    """Corrections of the trapezoidal rule's weights at the first four nodes. The last four nodes have the corrections in reverse order."""

    values: NDArray[np.float64]  # corrections for values, (4,); the first contains -1/2, for half a step
    slopes: NDArray[np.float64]  # weights of derivatives, (4,); their signs are opposite at the end of a run


@cache
def end_weights() -> EndWeights:
    """Return the corrections of the weights. They are the same for runs of every length.

    By the Euler-Maclaurin formula the integral over a run is the trapezoidal sum plus, for each k, B_2k / (2k)! times the
    derivative of order 2k - 1 at the start minus that at the end. The derivatives are taken from the Hermite interpolation of
    four nodes, so that the rule is exact up to degree 7.
    """
    x = np.linspace(0.0, 3.0, 8)
    basis = [Polynomial.fit(x, column, 7, domain=[-1, 1]) for column in hermite_weights(x).T]
    weights = np.array(
        [
            sum(factor * polynomial.deriv(2 * k + 1)(0.0) for k, factor in enumerate(_EULER_MACLAURIN))
            for polynomial in basis
        ]
    )
    weights[0] -= 0.5
    return EndWeights(weights[:4].copy(), weights[4:].copy())
