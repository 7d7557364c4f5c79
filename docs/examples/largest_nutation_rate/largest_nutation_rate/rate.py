"""A statistic of one's own: the largest |theta'| of each motion."""

import numpy as np

from atlas.kernel.poles import place_of_turn
from atlas.kernel.statistics import Node
from atlas.measure.instrument import Instrument, Variable


def nutation_rate(nodes, slot, l, spacing):
    """theta' at a node, and its change by the next node at the present rate."""
    u1, d1, u2, d2 = nodes[slot, Node.U1, l], nodes[slot, Node.DU1, l], nodes[slot, Node.U2, l], nodes[slot, Node.DU2, l]  # fmt: skip
    g1, e1, g2, e2 = nodes[slot, Node.G1, l], nodes[slot, Node.DG1, l], nodes[slot, Node.G2, l], nodes[slot, Node.DG2, l]  # fmt: skip
    sine = max(np.sqrt(g1 * g1 + g2 * g2), 1e-150)
    rate = (u1 * g2 - u2 * g1) / sine
    change = (d1 * g2 + u1 * e2 - d2 * g1 - u2 * e1) - rate * (g1 * e1 + g2 * e2) / sine
    return rate, spacing * change / sine


def extend_largest(sums, s, given, g, l, nodes, i, intervals, spacing, inverse_unit):
    """Extend the largest |theta'| of lane l to node i and to the turn of the cubic between it and the one before."""
    f0, s0 = nutation_rate(nodes, max(i - 1, 0) & 3, l, spacing)
    f1, s1 = nutation_rate(nodes, i & 3, l, spacing)
    x = place_of_turn(f0, f1, s0, s1)
    between = (1.0 - x) * (1.0 - x) * (f0 + x * (2.0 * f0 + s0)) + x * x * (f1 + (1.0 - x) * (2.0 * f1 - s1))
    sums[s, l] = max(sums[s, l], max(abs(f1), abs(between)))


class LargestNutationRate(Instrument):
    """Makes `theta_dot_max` of bodies in a frame, for scenes that ask for it; no other kernel contains it."""

    sums, add_node = 1, staticmethod(extend_largest)

    def variables(self, system):
        variable = Variable("theta_dot_max", "float64", "rad s-1", "largest nutation rate", optional=True)
        return () if system.observables else (variable,)

    def measurements(self, run, measured):
        return {"theta_dot_max": run.plugged(self)[0][0]}

    def relative_error(self, run):
        return (run.bound * run.step_sizes.sample_spacing) ** 4 / 384  # of the cubics


RATE = LargestNutationRate()
