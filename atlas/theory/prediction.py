"""Prediction of theory for one start, by these rules in this order (docs/methods.md has the reasons):

1. Beyond the range of the formulas nothing is predicted.
2. The equations classify the start before a nudge (`steady`): exactly a steady motion, far from all of them, or near one.
3. A start on a family in the plane is exact, if it is nudged or on the family to rounding, whatever the equations say.
4. A far start drifts, a near one has no label, an exact one has the label of its exact statistics.
5. After a nudge that leads to no other steady motion, a stable motion keeps its label, an unstable one drifts, others lose it.
6. After a nudge that leads far from every steady motion a start drifts, also a near one; if the nudge changes rates by more than
   KEPT tolerances, the label is lost. This does not hold for motions in the plane and beyond the range.
7. Growth does not change the label of a motion in the plane that drifts.
8. Growth begins at the residual of the equations, but in the plane and about other axes at the residual of the family.
9. Without a nudge, an exact start whose residual grows beyond the tolerances becomes near; it keeps no label but drifting.
10. Labels about any axes follow from the answer after 3 and 9.

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

# Largest residual (dimensionless) of a steady motion that rounding explains; rounding changes a larger one by less than 1 %.
ROUNDING_RESIDUAL = 1e-13
# Residual above which a start is on no family about the third axis and the vertical.
NEARBY = 1e-6
# Largest change of rates by a nudge, in tolerances, with which a stable motion keeps its label.
KEPT = 1 / 3


def find(before, after, duration, rate_tolerance, angle_tolerance, nudged, lacks_theory):
    """Steady motion of a start, or without one the motion about third axis and vertical, and the test of the start by the equations.

    lacks_theory: whether the start may be on a family of a missing extension.
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
        # Only a start with a residual of at most FAMILY_TOLERANCE may be on a steady motion again.
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
    """Residual (dimensionless) of a steady motion about the third axis and the vertical, 0 on an exact one.

    The larger of |u' - n m gamma x e3| / unit^2, u the angular velocity relative to the frame, and the part of u - n gamma across
    e3, divided by unit, the unit of rates. Near the vertical a smaller residual of a rotation about e3 replaces the first.
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
    """Largest change of the rates of a steady motion by a nudge, and `departure` after the nudge, in tolerances.

    The departure bounds the oscillation of rates from below; the oscillation of psi' may be larger by 1 / sin(theta). Inside the
    cone the change of the angular velocity counts instead. start: of `after`.
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
    """Labels that theory predicts for a start.

    exact, exact_inertial: labels of the exact motion, by its statistics; by_equations: whether `find` tested the equations.
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
    """Label of a start in one frame, without rule 9 on growth."""
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
    """Label about any axes: of the exact motion about other axes, else `own`; near a circle, drifting is not predicted.

    own, answer: from `predict`; exact: label of the circle of the exact motion; near: whether the start may stay on a circle.
    """
    elsewhere, label = test.elsewhere and answer == Existence.EXACT, own
    if elsewhere:
        label = after_nudge(exact, stable) if nudged and not test.kept else exact
    # Beside a stable motion about the third axis a nudge may lead to a motion about other axes.
    beside = elsewhere or not nudged or stable != Stability.STABLE
    if label != Label.DRIFTING or (answer == Existence.EXACT and beside) or not in_range or not near:
        return label
    return Label.NOT_COMPUTED


def after_nudge(label, stable):
    """Label of a nudged start near a steady motion with this label and stability."""
    if label == Label.DRIFTING or stable == Stability.STABLE:
        return label
    return Label.DRIFTING if stable == Stability.UNSTABLE else Label.NOT_COMPUTED


def rounding_limit(residual, bound, rate_tolerance, angle_tolerance):
    """Logarithm of the growth with which the residual of a steady start, or rounding if larger, reaches a tolerance.

    Rounding errors of rates are relative to the frequency bound, errors of angles to 1.
    """
    return np.log(np.minimum(rate_tolerance / bound, angle_tolerance) / np.fmax(residual, ROUNDING))
