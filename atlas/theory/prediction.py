"""What theory predicts of one start, in this order, whose reasons are in docs/methods.md:

1. Beyond the range of the formulas nothing is predicted.
2. The equations say of the start before a nudge whether it is a steady motion (`steady`): exact, far from all, or near one.
3. A start on a family in the plane is exact, before a nudge or to rounding, whatever the equations say.
4. What is far drifts, what is near has no label, what is exact has that of its exact statistics.
5. A nudge that leads to no other steady motion leaves the label of a stable motion, drifting for an unstable one, else none.
6. A nudge that leads far from every steady motion drifts, of near starts as well; one that changes rates by a good part of the
   tolerances leaves no label. Not so of motions in the plane and beyond the range.
7. A motion in the plane that drifts does so however it grows.
8. The distance that grows is that of the family's own conditions in the plane and about other axes.
9. Without a nudge an exact start whose distance grows beyond the tolerances becomes near, and keeps drifting alone.
10. Labels about any axes follow from the motion after 3 and 9.

`find` is 1 and 2, `predict` 3 to 9, `predict_circle` 10.
"""

from __future__ import annotations

import numpy as np

from ..flags import Label, Stability
from ..kernel.stepsize import ROUNDING
from ..systems.base import FAMILY_TOLERANCE
from .generated import derivatives, frame_motion, frame_motion_change
from .point import StartLabels, SteadyTest, fmax, larger, length, minus, over, scaled, smaller
from .steady import (
    FAR,
    Existence,
    departure,
    exact_motion,
    motion_about_third,
    start_on_axis,
    steady_motion,
)

# The conditions of a steady motion are satisfied as well as rounding allows where their residual is at most this: of a
# larger distance from the motion, rounding errors change less than a hundredth.
ROUNDING_RESIDUAL = 1e-13
# Residual of a start about the third axis and the vertical beyond which it is on no family about these.
NEARBY = 1e-6
# A nudged start keeps the label of a stable motion up to this change of its rates, in tolerances.
KEPT = 1 / 3


def find(before, after, duration, rate_tolerance, angle_tolerance, nudged, lacks_theory):
    """The steady motion that a start is, or would be, and what the equations say of it before and after a nudge.

    lacks_theory: whether a family of a missing extension may decide on it.
    """
    answer, motion = steady_motion(
        before.w, before.vectors, before.constants, before.rates, before.bound, duration, rate_tolerance, angle_tolerance
    )  # fmt: skip
    if not before.in_range or (lacks_theory and answer != Existence.EXACT):
        answer = Existence.NEAR
    _, vertical = frame_motion(before.w, before.vectors, before.constants)
    elsewhere = answer == Existence.EXACT and (motion.s[2] != 1.0 or motion.nu != vertical)
    residual = residual_of(after)
    upright = abs(before.rates[0]) <= FAMILY_TOLERANCE
    may_be_member = nudged or answer != Existence.FAR or residual <= NEARBY or upright
    kept, pushed, change, away = not nudged, False, 0.0, 0.0
    if nudged:
        # Only a start that fails by at most the tolerance of families may be on a motion again.
        beside = residual <= FAMILY_TOLERANCE
        start = start_on_axis(after.w, after.vectors, after.constants, after.rates)
        if elsewhere or beside:
            kept, _ = exact_motion(start, after.constants, after.rates, after.bound)
        kept = kept and after.in_range
        pushed = not (beside and kept)
        if after.in_range:
            change, away = changes(before, after, start, duration, rate_tolerance, angle_tolerance)
    return motion, SteadyTest(answer, elsewhere, may_be_member, kept, pushed, residual, change, away)


def residual_of(body):
    """How far a start is from a steady motion about the third axis and the vertical, 0 on an exact one.

    The larger of |u' - n m gamma x e3| over the squared unit of rates, u the angular velocity in the frame, and what of u across
    e3 is not n gamma, over the unit. Beside the vertical, if less, that of a rotation about e3.
    """
    _, n, m = body.rates
    u, g = frame_motion(body.w, body.vectors, body.constants)
    slope, slopes = derivatives(body.w, body.vectors, body.constants)
    bend = frame_motion_change(body.w, body.vectors, body.constants, slope, slopes)
    sine, unit = np.hypot(g[0], g[1]), np.sqrt(body.square)
    change = over(length(minus(bend, scaled(n * m, (g[1], -g[0], 0.0)))), body.square)
    if sine <= FAMILY_TOLERANCE:
        change = smaller(change, larger(over(length(bend), body.square), over(np.hypot(u[0], u[1]), unit)))
    rest = np.hypot(u[0] - n * g[0], u[1] - n * g[1])
    if rest <= 2.0**-50 * (abs(n) * sine + np.hypot(body.w[0], body.w[1])):
        rest = 0.0
    return larger(change, over(rest, unit))


def changes(before, after, start, duration, rate_tolerance, angle_tolerance):
    """By how much a nudge changes rates at most from a steady motion, and the departure to first order, in tolerances.

    The departure is the least change of the rates; the oscillation may be some times as large, that of psi' by 1 / sin(theta).
    Inside the cone the tilt is no measure of it, but the change of the angular velocity. start: of `after`.
    """
    motion = motion_about_third(start, after.rates)
    away = departure(start, after.constants, motion, after.bound, duration, rate_tolerance, angle_tolerance)
    u, vertical = frame_motion(after.w, after.vectors, after.constants)
    sine = np.hypot(vertical[0], vertical[1])
    if not sine < angle_tolerance:
        return away / sine, away
    old, _ = frame_motion(before.w, before.vectors, before.constants)
    return length(minus(u, old)) / rate_tolerance, away


def predict(
    test, membership, exact, exact_inertial, bound, rate_tolerance, angle_tolerance, nudged, by_equations
):
    """What theory predicts of a start.

    exact: the labels of the statistics of the exact motion; by_equations: whether the answer of `find` is that of the equations.
    """
    answer = test.answer
    if membership.varies and (nudged or membership.residual <= ROUNDING_RESIDUAL):
        answer = Existence.EXACT
    label = label_of(test, membership, answer, exact, nudged)
    inertial = label_of(test, membership, answer, exact_inertial, nudged)
    growth = membership.growth
    if growth != growth or (membership.varies and label == Label.DRIFTING):
        growth = 0.0
    residual = membership.nudged_residual if membership.varies or membership.elsewhere else test.residual
    limit = fmax(0.0, rounding_limit(residual, bound, rate_tolerance, angle_tolerance))
    is_near = residual > ROUNDING_RESIDUAL and growth > limit
    if by_equations and not nudged and answer == Existence.EXACT and is_near:
        answer = Existence.NEAR
        label = label if label == Label.DRIFTING else Label.NOT_COMPUTED
        inertial = inertial if inertial == Label.DRIFTING else Label.NOT_COMPUTED
    return StartLabels(label, inertial, answer, growth)


def label_of(test, membership, answer, exact, nudged):
    """The label of a start in one frame, before growth decides."""
    if answer == Existence.EXACT:
        label = after_nudge(exact, membership.stable) if test.pushed else exact
    else:
        label = Label.DRIFTING if answer == Existence.FAR else Label.NOT_COMPUTED
    if not nudged or membership.varies or label == Label.DRIFTING:
        return label
    if test.away > FAR:
        return Label.DRIFTING
    return Label.NOT_COMPUTED if test.change > KEPT else label


def predict_circle(test, own, exact, answer, stable, near, in_range, nudged):
    """The label about any axes: of the exact motion about other axes, else its own; a start near a circle does not drift.

    own, answer: of `predict`; exact: of the circle of the exact motion; near: whether the start may stay on a circle.
    """
    elsewhere, label = test.elsewhere and answer == Existence.EXACT, own
    if elsewhere:
        label = after_nudge(exact, stable) if nudged and not test.kept else exact
    # Beside a stable motion about the third axis a nudge may lead to one about other axes.
    beside = elsewhere or not nudged or stable != Stability.STABLE
    if label != Label.DRIFTING or (answer == Existence.EXACT and beside) or not in_range or not near:
        return label
    return Label.NOT_COMPUTED


def after_nudge(label, stable):
    """Label of a steady motion beside which a nudged start is."""
    if label == Label.DRIFTING or stable == Stability.STABLE:
        return label
    return Label.DRIFTING if stable == Stability.UNSTABLE else Label.NOT_COMPUTED


def rounding_limit(residual, bound, rate_tolerance, angle_tolerance):
    """Growth, as a logarithm, by which rounding errors reach a tolerance, by the residual of a steady start.

    Rounding errors of rates are relative to the frequency bound, errors of angles to 1.
    """
    return np.log(np.minimum(rate_tolerance / bound, angle_tolerance) / np.fmax(residual, ROUNDING))
