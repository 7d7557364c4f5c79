"""Steps of runs with tangent vectors, what follows from their growth, and its flags; by numbers, no run."""

from types import SimpleNamespace

import numpy as np
import pytest

from atlas.flags import Label, Regularity, Status
from atlas.kernel import tangent
from atlas.kernel.blocks import ALL_THREADS, Threads
from atlas.kernel.tableaux import TANGENT_METHOD
from atlas.measure import tangent_runs
from atlas.measure.tangent_runs import Separation, TangentRuns, TangentSteps, rate_unit, regularity
from atlas.systems import SYSTEMS


@pytest.mark.parametrize(
    ("label", "megno", "expected", "on_unstable"),
    [
        (1, 2.0, "STEADY", "STEADY"), (2, -0.3, "STEADY", "STEADY"), (2, 4.9, "STEADY", "STEADY"),
        (1, 5.1, "HYPERBOLIC", "HYPERBOLIC"), (3, 2.4, "REGULAR", "REGULAR"), (3, -1.0, "REGULAR", "REGULAR"),
        (3, 2.6, "UNDECIDED", "UNDECIDED"), (3, 4.9, "UNDECIDED", "UNDECIDED"), (3, 5.1, "CHAOTIC", "HYPERBOLIC"),
        (3, np.nan, "NOT_COMPUTED", "NOT_COMPUTED"), (4, 2.0, "NOT_COMPUTED", "NOT_COMPUTED"),
        (4, 9.0, "NOT_COMPUTED", "NOT_COMPUTED"), (0, np.nan, "NOT_COMPUTED", "NOT_COMPUTED"),
    ],
)  # fmt: skip
def test_flag(label, megno, expected, on_unstable):
    flags = regularity(np.array(2 * [label], np.int8), np.array(2 * [megno]), np.array([False, True]))
    assert flags.dtype == np.int8
    np.testing.assert_array_equal(flags, [Regularity[expected], Regularity[on_unstable]])


def test_step_sizes():
    bound, duration = np.array([1.0, 10.0, np.inf, 0.0]), np.full(4, 300.0)
    sizes = tangent_runs.TangentSteps.of(bound, duration, None, 10**9)
    assert sizes.resolved.tolist() == [True, True, False, True]
    assert (sizes.step_size[:2] * bound[:2] <= 0.3).all()
    assert (sizes.nodes <= sizes.steps).all()
    long = tangent_runs.TangentSteps.of(np.array([1.0]), np.array([1e7]), None, 10**9)
    assert long.resolved.all()
    assert (long.steps <= tangent_runs.MAX_STEPS_PER_NODE * long.nodes).all()
    for step, resolved in ((0.29, True), (0.31, False)):
        assert tangent_runs.TangentSteps.of(bound[:1], duration[:1], step, 10**9).resolved.all() == resolved
    assert not tangent_runs.TangentSteps.of(bound[:1], duration[:1], None, 100).resolved.any()


def test_steps_that_a_loss_or_an_error_allows():
    """In a run of 1e5 radians: a loss of a hundredth, dissipation y^9 for each radian; errors of 1e-6 and three times their step."""
    bound, duration = np.array([2.0]), np.array([5e4])
    lossless = (0.01 / (TANGENT_METHOD.dissipation * 1e5)) ** (1 / (TANGENT_METHOD.dissipation_order - 1))
    assert lossless > 0.3  # or it would not be the limit of 0.3 that counts
    few = TangentSteps.of(bound, duration, None, 10**9)
    assert 0.25 < 1e5 / few.steps[0] <= 0.3
    assert few.step_size * few.steps == pytest.approx(5e4)
    longer = TangentSteps.of(bound, 1e9 * duration, None, 10**18)
    y = 1e14 / longer.steps[0]
    allowed = (0.01 / (TANGENT_METHOD.dissipation * 1e14)) ** (1 / (TANGENT_METHOD.dissipation_order - 1))
    assert 0.8 * allowed < y <= allowed < 0.2
    assert longer.resolved
    for error in (1e-10, 1e-9):
        growth = TangentSteps.of(bound, duration, None, 10**9, np.array([error]))
        y = 3 * (error / (TANGENT_METHOD.dispersion * 1e5)) ** (1 / TANGENT_METHOD.order)
        assert y < 1.5
        assert 0.8 * y < 1e5 / growth.steps[0] <= y * (1 + 1e-9)
        assert growth.resolved
    coarse = TangentSteps.of(bound, duration, None, 10**9, np.array([1e9]))
    assert 1.2 < 1e5 / coarse.steps[0] <= 1.5
    assert not TangentSteps.of(bound, duration, None, 50_000, np.array([1e9])).resolved


def test_a_loss_beyond_a_hundredth_is_not_resolved():
    """Of steps of 0.2 rad by dissipation x 0.2^9 for each radian."""
    each = TANGENT_METHOD.dissipation * 0.2 ** (TANGENT_METHOD.dissipation_order - 1)
    for radians, resolved in ((0.009 / each, True), (0.011 / each, False)):
        steps = TangentSteps.of(np.array([1.0]), np.array([radians]), 0.2, 10**18)
        assert steps.resolved.tolist() == [resolved]


def test_nodes_and_parts_of_steps():
    count = np.array([500, 2000, 3_000_000])
    steps = TangentSteps(count, 1.0 / count, np.array([True, True, False]))
    assert steps.nodes.tolist() == [500, 1024, 3000]
    part = steps.subset(np.array([2, 0]))
    assert (part.steps.tolist(), part.resolved.tolist()) == ([3_000_000, 500], [False, True])


def test_indicators_of_sums():
    """Mean MEGNO over all steps until now, the growth over the time."""
    separation = Separation.__new__(Separation)
    separation.sums = np.zeros((len(tangent.Growth), 2))
    separation.sums[tangent.Growth.MEGNO_INTEGRAL] = 60.0, 80.0
    separation.sums[tangent.Growth.LOG_GROWTH] = 6.0, 9.0
    separation.durations = np.array([1, 2])
    separation.steps = TangentSteps(np.array([20, 10]), np.array([0.1, 0.5]), np.ones(2, bool))
    np.testing.assert_allclose(separation.megno, [3.0, 4.0])
    np.testing.assert_allclose(separation.lyapunov, [3.0, 0.9])


def test_unit_of_angular_velocities():
    points = {name: np.full(3, p.default) for name, p in SYSTEMS["satellite"].parameters.items()}
    points["Omega"] = np.array([2.0, -3.0, 0.0])
    assert rate_unit(SYSTEMS["satellite"], points, 7.0).tolist() == [2.0, 3.0, 7.0]


class Growing:
    """In place of tangent vectors: their growth doubles in each further duration."""

    def __init__(self, megno, growth, drawdown):
        self.megno, self.lyapunov = np.array(megno), np.full(len(megno), 0.25)
        self.sums = np.zeros((len(tangent.Growth), len(megno)))
        self.sums[tangent.Growth.LOG_GROWTH], self.sums[tangent.Growth.DRAWDOWN] = growth, drawdown
        self.sums[tangent.Growth.HIGHEST] = self.sums[tangent.Growth.LOG_GROWTH] + drawdown
        self.calls = []

    def integrate(self, active=None, *, threads):
        if active is not None:  # beyond the run
            self.sums[tangent.Growth.LOG_GROWTH, active] *= 2.0
            self.calls.append(active.tolist())


def test_what_is_called_chaotic(monkeypatch):
    """Growth beyond that of one passage of an unstable motion, in up to 16 durations, without a large drawdown."""
    kinds = {  # label, MEGNO, growth in the run, drawdown, unstable start
        "REGULAR": (Label.DRIFTING, 2.0, 3.0, 1.0, False), "STEADY": (Label.REGULAR_PRECESSION, 2.0, 3.0, 20.0, False),
        "CHAOTIC": (Label.DRIFTING, 9.0, 40.0, 1.0, False), "UNDECIDED": (Label.DRIFTING, 9.0, 40.0, 11.0, False),
        "HYPERBOLIC": (Label.DRIFTING, 9.0, 40.0, 20.0, True), "NOT_COMPUTED": (Label.DRIFTING, np.inf, 40.0, 1.0, False),
    }  # fmt: skip
    slow = (Label.DRIFTING, 9.0, 1e-4, 1.0, False)  # 1e-4 times 2^15 is 3.3
    large = (Label.DRIFTING, 9.0, 60.0, 1.0, False)  # at once
    regular = (Label.DRIFTING, 2.0, 3.0, 11.0, False)  # near an unstable motion: the number says nothing
    steady_loss = (Label.DRIFTING, 2.0, -30.0, 11.0, False)  # all neighbours approach
    label, megno, growth, drawdown, unstable = zip(
        *kinds.values(), slow, large, regular, steady_loss, (Label.DRIFTING, 9.0, 60.0, 1.0, False), strict=True
    )  # fmt: skip
    size = len(label)
    status = np.array([Status.OK] * (size - 1) + [Status.DRIFT_EXCEEDED])
    growing = Growing(megno[:-1], np.array(growth[:-1]), np.array(drawdown[:-1]))
    steps = TangentSteps(np.full(size, 100), np.full(size, 0.1), np.ones(size, bool))
    runs = TangentRuns(
        SYSTEMS["satellite"], None, SimpleNamespace(subset=lambda where: None), steps, np.ones(size), 0.5
    )
    monkeypatch.setattr(tangent_runs, "Separation", lambda *arguments: growing)
    columns = {"label": np.array(label), "status": status}
    found = runs.variables(columns, np.array(unstable), ALL_THREADS)
    names = [Regularity(flag).name for flag in found["regularity"]]
    assert names == [*kinds, "UNDECIDED", "CHAOTIC", "REGULAR", "REGULAR", "NOT_COMPUTED"]
    known = [True, True, True, False, True, False, False, True, False, True, False]
    assert np.isfinite(found["megno"]).tolist() == np.isfinite(found["lyapunov"]).tolist() == known
    chaotic, slow = 2, 6
    assert growing.calls == [[chaotic, slow], *14 * [[slow]]]
    done = []
    none = runs.variables(columns | {"status": 0 * status}, np.array(unstable), Threads(None, done.append))
    assert done == [0.5 * size]
    assert (none["regularity"] == Regularity.NOT_COMPUTED).all()
    assert np.isnan(none["megno"]).all()


def test_the_share_of_the_work():
    """Of tangent vectors: 1.5 times the cost of a step of rk8 over that of the run."""
    system = SYSTEMS["satellite"]
    points = {name: np.full(2, p.default) for name, p in system.parameters.items()}
    ensemble = SimpleNamespace(frequency_bound=np.array([1.0, np.inf]))
    sizes = SimpleNamespace(without_unresolved=lambda: SimpleNamespace(whole_steps=np.array([300, 100])))
    settings = SimpleNamespace(step=None, max_steps=10**9, method="rk8")
    runs = TangentRuns.of(system, None, ensemble, points, np.full(2, 300.0), settings, sizes, has_chaos=True)
    work = 1.5 * runs.steps.steps[0]
    assert runs.share == pytest.approx(work / (work + 400))
