"""Predict labels of one start by these rules, in this order (docs/methods.md has the reasons):

1. Nothing is predicted beyond the range of the formulas.
2. The equations say whether the start before a nudge is exactly on, near, or far from a steady motion (`steady`).
3. A start on a family with a varying rate about the vertical is exact despite rule 2 if it is nudged or if rounding explains the residual.
4. A far start drifts, a near start has no label, and an exact start has the label of the exact statistics.
5. If a nudge leads to no other steady motion, stable motions keep the label, unstable motions drift, and others lose the label.
6. If a nudge leads far from every steady motion, even a near start drifts. If a nudge changes rates by more than KEPT tolerances,
   the label is lost. This rule does not hold for motions with a varying rate, nor beyond the range.
7. If a motion with a varying rate drifts, growth does not change the label.
8. Growth begins at the residual of the equations, or of the family if the rate varies or the motion is about other axes.
9. Without a nudge, an exact start whose residual grows beyond the tolerances becomes near and loses any label but drifting.
10. Labels about any axes follow from the answer after rules 3 and 9.

The function `find` applies rules 1 and 2, `predict` applies rules 3 to 9, and `predict_circle` applies rule 10.
"""

from __future__ import annotations

import numpy as np

from ..flags import Label, Stability
from ..kernel.stepsize import ROUNDING
from ..systems.base import FAMILY_TOLERANCE
from .generated import derivatives, frame_motion, frame_motion_change
from .point import StartLabels, SteadyTest, fmax, larger, length, minus, over, scaled, smaller
from .steady import FAR, Existence, departure, exact_motion, motion_about_third, start_on_axis, steady_motion

# Dimensionless residuals of steady motions up to this value count as rounding errors. Actual errors are below 1 % of this value.
ROUNDING_RESIDUAL = 1e-13
# A start with a larger residual is on no family of motions about the third axis and the vertical.
NEARBY = 1e-6
# A stable motion keeps the label if a nudge changes the rates by at most this many tolerances.
KEPT = 1 / 3


def find(before, after, duration, rate_tolerance, angle_tolerance, nudged, lacks_theory):
    """Return the steady motion of a start and a `SteadyTest`. A start that is not steady gets the motion about third axis and vertical.

    If `lacks_theory` is true, the start may be on a family of a missing extension.
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
        # Only a start with a residual of at most FAMILY_TOLERANCE may be on a steady motion after the nudge.
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
    """Return the dimensionless residual of a steady motion about the third axis and the vertical, 0 for an exact motion.

    Let u be the angular velocity relative to the frame and U the unit of rates. The residual is the larger of
    r = |u' - n m gamma x e3| / U^2 and |e3 x (u - n gamma)| / U. If e3 is vertical, r is at most the residual of a rotation about e3.
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
    """Return the largest change of the rates of a steady motion by a nudge, and `departure` after the nudge, in units of the tolerance.

    The departure is a lower bound of the oscillation of rates. The largest change is departure / sin(theta), which psi' may reach, or
    the change of the angular velocity if e3 is within `angle_tolerance` of the vertical. The argument `start` belongs to `after`.
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
    """Return the labels that theory predicts for a start.

    The labels `exact` and `exact_inertial` belong to the exact motion. If `by_equations` is true, `find` tested the equations.
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
    """Return the label of a start in one frame by rules 4 to 6 of the module docstring."""
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
    """Return the label of a motion about any two axes by rule 10 of the module docstring.

    The argument `exact` is the label of the exact motion, and `own` is the label that `predict` returned. If the motion is exact about
    other axes than the third and the vertical, the result is `exact` or follows from `exact` after a nudge. Otherwise the result is `own`.
    If `near` is true, the angular velocity may stay on a circle in the body. Drifting is then predicted only for exact motions.
    """
    elsewhere, label = test.elsewhere and answer == Existence.EXACT, own
    if elsewhere:
        label = after_nudge(exact, stable) if nudged and not test.kept else exact
    # `beside` is false where a nudge of a stable motion about the third axis may lead to a motion about other axes.
    beside = elsewhere or not nudged or stable != Stability.STABLE
    if label != Label.DRIFTING or (answer == Existence.EXACT and beside) or not in_range or not near:
        return label
    return Label.NOT_COMPUTED


def after_nudge(label, stable):
    """Return the label of a nudged start near a steady motion with the given label and stability."""
    if label == Label.DRIFTING or stable == Stability.STABLE:
        return label
    return Label.DRIFTING if stable == Stability.UNSTABLE else Label.NOT_COMPUTED


def rounding_limit(residual, bound, rate_tolerance, angle_tolerance):
    """Return the logarithm of the factor from a residual to the smaller tolerance. A residual below ROUNDING counts as ROUNDING.

    Rounding errors of rates are relative to the frequency bound, and rounding errors of angles are relative to 1.
    """
    return np.log(np.minimum(rate_tolerance / bound, angle_tolerance) / np.fmax(residual, ROUNDING))
