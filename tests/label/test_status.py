"""Status and agreement of points, by flags and numbers; no run."""

from dataclasses import dataclass, replace

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from atlas.flags import Agreement, Label, Status
from atlas.label import pipeline
from atlas.label.theory import agreement
from atlas.systems import SYSTEMS


@given(
    st.booleans(), st.sampled_from([0.0, 1e-3]), st.booleans(), st.sampled_from([0.0, 30.0])
)  # fmt: skip
def test_status_is_the_first_that_applies(finite, drift, resolved, growth):
    result = pipeline.label_status(
        np.array([finite]), np.array([drift]), 1e-5, np.array([resolved]), np.array([growth]), 25.0
    )[0]
    order = [
        (not finite, "not_finite"), (drift > 1e-5, "drift_exceeded"),
        (not resolved, "under_resolved"), (growth > 25.0, "roundoff_decided"), (True, "ok"),
    ]  # fmt: skip
    assert list(Status.meanings())[result] == next(name for applies, name in order if applies)


def test_status_at_its_limits():
    """A drift equal to the tolerance is within it; growth counts above its limit, whatever its sign, but not none."""
    yes = np.ones(5, bool)
    drift, growth = np.array([1e-5, 0, 0, 0, 0]), np.array([0.0, 0.5, 0.0, 0.5, 0.5])
    result = pipeline.label_status(yes, drift, 1e-5, yes, growth, np.array([25.0, 0.4, -1.0, 0.5, -1.0]))
    decided = Status.ROUNDOFF_DECIDED
    assert result.tolist() == [Status.OK, decided, Status.OK, Status.OK, decided]


def test_status_by_each_reason_alone():
    """And what else decides: a step, or rounding, whatever grows; an earlier reason wins."""
    yes, no = np.ones(1, bool), np.zeros(1, bool)

    def status(finite=yes, drift=0.0, resolved=yes, growth=0.0, step=no, rounding=no):
        return Status(
            pipeline.label_status(
                finite, np.array([drift]), 0.1, resolved, np.array([growth]), 3.0, step, rounding
            )[0]
        )

    reasons = {
        Status.NOT_FINITE: {"finite": no}, Status.DRIFT_EXCEEDED: {"drift": 0.2}, Status.UNDER_RESOLVED: {"resolved": no},
        Status.STEP_SENSITIVE: {"step": yes}, Status.ROUNDOFF_DECIDED: {"rounding": yes},
    }  # fmt: skip
    later = {}
    for expected, reason in reversed(reasons.items()):
        assert status(**reason) == expected
        later |= reason
        assert status(**later) == expected
    assert status(growth=3.1) == Status.ROUNDOFF_DECIDED
    assert status(growth=3.0) == status() == Status.OK


def test_agreement_of_each_pair():
    drifting, regular, permanent = Label.DRIFTING, Label.REGULAR_PRECESSION, Label.PERMANENT_ROTATION
    for label, predicted, expected in (
        (regular, regular, Agreement.AGREE), (drifting, drifting, Agreement.AGREE), (regular, permanent, Agreement.DIFFER),
        (drifting, regular, Agreement.THEORY_ONLY), (regular, drifting, Agreement.NUMERICS_ONLY),
        (Label.UNRESOLVED, drifting, Agreement.NOT_COMPARED), (regular, Label.NOT_COMPUTED, Agreement.NOT_COMPARED),
        (Label.NOT_COMPUTED, Label.NOT_COMPUTED, Agreement.NOT_COMPARED),
    ):  # fmt: skip
        assert agreement(np.array([label]), np.array([predicted])).tolist() == [expected]


@dataclass
class Start:
    """Starts beside each other, (states, points)."""

    origin: np.ndarray
    constants: np.ndarray


@dataclass
class Moved:
    """A run by numbers alone: by how much its statistics differ from those of the run at hand, and its expected error."""

    ensemble: Start
    changed: np.ndarray
    error: float
    points: np.ndarray
    system: object = SYSTEMS["fixed_point"]
    bound: float = 2.0
    step_sizes: object = None

    def subset(self, where):
        ensemble = Start(self.ensemble.origin[:, where], self.ensemble.constants[:, where])
        return replace(self, ensemble=ensemble, changed=self.changed[where], points=self.points[where])

    def errors(self):
        return {}, np.full(self.points.size, self.error)

    def change(self, other):
        return other.changed


def test_the_step_decides_where_a_neighbouring_start_differs_less_than_another_step():
    """Of a statistic that changes by more than a hundredth; in chaos the neighbour has grown as much."""
    changed = np.array([0.009, 0.02, 0.02, 0.02, 0.02])
    of_neighbour = np.array(
        [0.0, 0.0, 1e-3, 1.9e-3, 2.1e-3]
    )  # errors of the longer step are ten times as large
    start = Start(np.full((6, 5), 0.3), np.ones((16, 5)))
    run = Moved(start, np.zeros(5), 1e-6, np.arange(5))
    coarse = Moved(start, changed, 1e-5, np.arange(5))

    class Runs:
        def by_steps(self, beside, step_sizes):
            distance = np.abs(beside.ensemble.origin - 0.3)
            assert (distance < 1e-5).all()
            assert (distance.max(0) > 1e-7).all()
            return replace(beside, changed=of_neighbour[beside.points])

    assert pipeline._step_decides(Runs(), run, coarse).tolist() == [False, True, True, True, False]
