"""The order of the rules of a prediction, by numbers of one start; see atlas/theory/prediction.py."""

from itertools import product

import numpy as np
import pytest

from atlas.flags import Label, Stability
from atlas.measure.instrument import Tolerances
from atlas.theory.point import Membership, SteadyTest
from atlas.theory.prediction import after_nudge, predict, predict_circle, rounding_limit
from atlas.theory.steady import FAR, Existence

REGULAR, PERMANENT, DRIFTING, NONE = (
    Label.REGULAR_PRECESSION, Label.PERMANENT_ROTATION, Label.DRIFTING, Label.NOT_COMPUTED,
)  # fmt: skip
EXACT = SteadyTest(Existence.EXACT, False, True, True, False, 0.0, 0.0, 0.0)
MEMBER = Membership(False, False, 0.0, 0.0, Stability.STABLE, 0.0)


def predicted(test, membership, exact=REGULAR, inertial=PERMANENT, nudged=False, by_equations=True):
    return predict(test, membership, exact, inertial, 2.0, 1e-5, 1e-3, nudged, by_equations)


@pytest.mark.parametrize(
    ("answer", "labels"),
    [
        (Existence.EXACT, (REGULAR, PERMANENT)),
        (Existence.FAR, (DRIFTING, DRIFTING)),
        (Existence.NEAR, (NONE, NONE)),
    ],
)
def test_the_answer_of_the_equations_gives_the_label(answer, labels):
    assert predicted(EXACT._replace(answer=answer), MEMBER)[:3] == (*labels, answer)


def test_a_motion_in_the_plane_is_exact_before_a_nudge_or_to_rounding():
    far, plane = EXACT._replace(answer=Existence.FAR), MEMBER._replace(varies=True)
    for residual, nudged, label in (
        (1e-14, False, REGULAR),
        (1e-12, False, DRIFTING),
        (1e-12, True, REGULAR),
    ):
        assert predicted(far, plane._replace(residual=residual), nudged=nudged)[0] == label


@pytest.mark.parametrize(
    ("exact", "stable", "label"),
    [
        (REGULAR, Stability.STABLE, REGULAR),
        (REGULAR, Stability.UNSTABLE, DRIFTING),
        (REGULAR, Stability.UNKNOWN, NONE),
        (DRIFTING, Stability.UNKNOWN, DRIFTING),
        (NONE, Stability.UNSTABLE, DRIFTING),  # unstable wins over uncertain statistics
        (NONE, Stability.STABLE, NONE),
    ],
)
def test_beside_a_motion_its_stability_decides(exact, stable, label):
    assert after_nudge(exact, stable) == label
    membership, pushed = MEMBER._replace(stable=stable), EXACT._replace(kept=False, pushed=True)
    assert predicted(pushed, membership, exact, nudged=True)[0] == label
    assert predicted(EXACT, membership, exact, nudged=True)[0] == exact  # on another exact start


def test_the_size_of_a_nudge_is_weighed_but_for_motions_in_the_plane():
    plane = MEMBER._replace(varies=True)
    for change, away, label in (
        (0.3, 0.3, REGULAR), (0.4, 0.3, NONE), (0.4, FAR, NONE), (0.4, 1.01 * FAR, DRIFTING)
    ):  # fmt: skip
        moved = EXACT._replace(change=change, away=away)
        assert predicted(moved, MEMBER, nudged=True)[0] == label
        assert predicted(moved, plane, nudged=True)[0] == REGULAR
    near = EXACT._replace(answer=Existence.NEAR, away=1.01 * FAR)
    assert predicted(near, MEMBER, nudged=True)[0] == DRIFTING


def test_a_distance_that_grows_beyond_the_tolerances_leaves_drifting_alone():
    """By the residual of the motion's own conditions, whatever is asked for; not where a nudge or the families decide."""
    limit = rounding_limit(1e-12, 2.0, 1e-5, 1e-3)
    assert limit == pytest.approx(np.log(5e-6 / 1e-12))
    for elsewhere, exact, growth, residual in product(
        (False, True), (REGULAR, DRIFTING), (0.9, 1.1), (1e-14, 1e-12)
    ):
        test = EXACT._replace(elsewhere=elsewhere, residual=1.0 if elsewhere else residual)
        membership = MEMBER._replace(elsewhere=elsewhere, nudged_residual=residual, growth=growth * limit)
        label, _, answer, kept = predicted(test, membership, exact)
        is_near = growth > 1 and residual > 1e-13
        assert answer == (Existence.NEAR if is_near else Existence.EXACT)
        assert label == (NONE if is_near and exact == REGULAR else exact)
        assert kept == growth * limit
        assert predicted(test, membership, exact, nudged=True)[2] == Existence.EXACT
        assert predicted(test, membership, exact, by_equations=False)[2] == Existence.EXACT


def test_growth_is_none_where_it_is_unknown_and_where_a_motion_in_the_plane_drifts():
    growing, plane = MEMBER._replace(growth=3.0), MEMBER._replace(growth=3.0, varies=True)
    assert predicted(EXACT, growing._replace(growth=np.nan))[3] == 0.0
    assert [predicted(EXACT, plane, exact)[3] for exact in (DRIFTING, PERMANENT)] == [0.0, 3.0]
    assert predicted(EXACT, growing, DRIFTING)[3] == 3.0


@pytest.mark.parametrize(("near", "nudged"), list(product((False, True), (False, True))))
def test_labels_about_any_axes(near, nudged):
    """near: a circle of the angular velocity, beside which nothing drifts."""
    other, far = EXACT._replace(elsewhere=True, kept=False), EXACT._replace(answer=Existence.FAR)
    stable, unstable = Stability.STABLE, Stability.UNSTABLE

    def label(test, own, answer, stability, in_range=True):
        return predict_circle(test, own, REGULAR, answer, stability, near, in_range, nudged)

    assert label(other, DRIFTING, Existence.EXACT, stable) == REGULAR
    assert label(other, DRIFTING, Existence.EXACT, unstable) == (DRIFTING if nudged else REGULAR)
    assert label(other, DRIFTING, Existence.NEAR, stable) == (NONE if near else DRIFTING)
    assert label(EXACT, PERMANENT, Existence.EXACT, stable) == PERMANENT
    assert label(far, DRIFTING, Existence.FAR, stable) == (NONE if near else DRIFTING)
    assert label(far, DRIFTING, Existence.FAR, stable, in_range=False) == DRIFTING
    # Beside a stable motion about the third axis a nudge may lead to one about other axes.
    assert label(EXACT, DRIFTING, Existence.EXACT, stable) == (NONE if near and nudged else DRIFTING)
    assert label(EXACT, DRIFTING, Existence.EXACT, unstable) == DRIFTING


def test_rounding_limit_is_the_growth_that_brings_rounding_errors_to_a_tolerance():
    """Of a rate, relative to the frequency bound, or of the angle: whichever is reached first."""
    residual = np.array([0.0, np.nan, 1e-10, 1e-10])
    bound, tolerances = np.array([2.0, 2.0, 2.0, 1e-3]), Tolerances(1e-5, 1e-3)
    limit = rounding_limit(residual, bound, tolerances.rate, tolerances.angle)
    error = np.array([1e-16, 1e-16, 1e-10, 1e-10]) * np.exp(limit)
    np.testing.assert_allclose(error[:3] * bound[:3], tolerances.rate)
    assert (error[:3] < tolerances.angle).all()
    assert error[3] == pytest.approx(tolerances.angle)
    assert error[3] * bound[3] < tolerances.rate
