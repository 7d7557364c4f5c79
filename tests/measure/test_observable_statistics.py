"""Statistics of observables from sums over nodes, their errors and labels, by numbers; against sums of NumPy."""

from types import SimpleNamespace

import numpy as np
import pytest

from atlas.flags import Steadiness
from atlas.kernel import observe
from atlas.kernel.stepsize import INTERPOLATION_ERROR
from atlas.measure.observables import Observables, is_strobed, label, sizes, std_tolerances, whole_periods
from atlas.systems import Observable

TIMES = np.linspace(0, 1, 41)
VALUES = {"x": 3.0 + np.sin(5 * TIMES), "y": -8.0 + TIMES**2}  # along the run
STROBED = 2.0 + 0.3 * np.arange(12) + np.cos(np.arange(12.0))  # once a period


def system_of(*observables):
    """A pendulum x' = v / 2, v' = -x with these observables, of which "y" is a function."""
    equations = SimpleNamespace(
        STATE=("x", "v"), CONSTANTS=("w",), y=lambda state, constants: state[0] * state[1],
        rhs=lambda state, constants: (state[1] / 2, -state[0]),
    )  # fmt: skip
    return SimpleNamespace(observables=observables, equations=equations)


X, Y = Observable("x", "1", "x", tolerance=0.5), Observable("y", "1", "y")
Z = Observable("z", "1", "z", every="w")


def rows(values, weight):
    """Rows of the kernel of one observable: changes from the start, summed."""
    change = values - values[0]
    trend = np.linspace(-0.5, 0.5, values.size)  # place in the run
    return [
        values[0],
        weight @ change,
        weight @ change**2,
        weight @ (change * trend),
        values.min(),
        values.max(),
        0.0,
    ]


def test_statistics_from_sums():
    """Mean, deviation, extremes, and the change along the line of least squares; strobed observables come last."""
    weight = np.full(41, 1.0)
    weight[[0, -1]] = 0.5
    sums = np.zeros((observe.FIRST_ROW + 3 * len(observe.Field), 1))
    sums[observe.CHANGE] = 1e-9
    sums[observe.FIRST_ROW :, 0] = [
        *rows(VALUES["x"], weight), *rows(VALUES["y"], weight), *rows(STROBED, np.ones(12))
    ]  # fmt: skip
    run = SimpleNamespace(
        system=system_of(Z, X, Y), step_sizes=SimpleNamespace(periods=np.array([11])),
        integration=SimpleNamespace(sums=sums, intervals=np.array([40])),
    )  # fmt: skip
    found = Observables().measurements(run, {})
    assert found["integral_drift"] == 1e-9
    for name, values, w in (*((n, v, weight) for n, v in VALUES.items()), ("z", STROBED, np.ones(12))):
        mean = np.average(values, weights=w)
        assert found[f"{name}_mean"] == pytest.approx(mean, rel=1e-12)
        assert found[f"{name}_std"] == pytest.approx(np.sqrt(np.average((values - mean) ** 2, weights=w)))
        assert (found[f"{name}_min"], found[f"{name}_max"]) == (values.min(), values.max())
        place = np.linspace(0, 1, values.size)
        if name == "z":
            slope = np.polyfit(place, values, 1)[0]
            assert found["z_drift"] == pytest.approx(slope, rel=1e-12)
        else:  # an integral over the run: the nodes are 1/40 apart
            slope = np.average((values - mean) * (place - 0.5), weights=w) * 12
            assert found[f"{name}_drift"] == pytest.approx(slope, rel=1e-12)


MEASURED = {
    name: np.array([value]) for name, value in {
        "x_mean": 2.0, "x_std": 0.4, "x_min": -3.0, "x_max": 1.0, "x_drift": 0.5,
        "y_mean": 5.0, "y_std": 0.2, "y_min": 1.0, "y_max": 8.0, "y_drift": 0.1,
    }.items()
}  # fmt: skip
STEPS = SimpleNamespace(
    dispersion_error=np.array([3e-4]), dissipation_error=np.array([2e-4]), sample_spacing=np.array([1 / 6]), whole_steps=np.array([10_000]),
    steps=np.array([200]),
)  # fmt: skip


def run_of(measured=MEASURED, steps=STEPS, **more):
    return SimpleNamespace(
        system=system_of(X, Y), measured=measured, step_sizes=steps, bound=np.array([2.0]),
        settings=SimpleNamespace(std_tolerance=None, rate_tolerance=0.3, method="rk4"), **more,
    )  # fmt: skip


def test_sizes_and_errors():
    run = run_of()
    assert sizes(run.system, MEASURED) == {"x": 3.0, "y": 8.0}
    # 3 times the bound times the distance of nodes is 1.
    relative = Observables().relative_error(run)
    assert relative == pytest.approx(3e-4 + INTERPOLATION_ERROR)
    dissipates = SimpleNamespace(**vars(STEPS) | {"dissipation_error": np.array([7e-4])})
    assert Observables().relative_error(run_of(steps=dissipates)) == pytest.approx(7e-4 + INTERPOLATION_ERROR)
    none = dict.fromkeys(("dispersion_error", "dissipation_error", "sample_spacing"), np.zeros(1))
    exact = run_of(steps=SimpleNamespace(**vars(STEPS) | none))
    assert Observables().relative_error(exact) == pytest.approx(4e-14, abs=0)
    errors = Observables().errors(run, np.array([1e-3]))
    assert errors["x_std"] == pytest.approx(4e-3 + 3e-15, rel=1e-15)
    assert errors["y_std"] == pytest.approx(7e-3 + 8e-15, rel=1e-15)
    assert Observables().errors(run, np.zeros(1))["y_std"] == pytest.approx(8e-15)
    each = {f"{name}_{s}": np.zeros(1) for name in "xy" for s in ("mean", "std", "min", "max", "drift")}
    assert Observables().largest(run.system, MEASURED, each | {"y_min": np.array([4.0])}, None) == 0.5


def test_rounding_of_a_product():
    """Of x v at (2, 3), with slopes (1.5, -2) over the bound: each state changes by its size and its slope."""
    state, relative = np.array([[2.0], [3.0]]), np.array([1e-12])
    run = run_of(ensemble=SimpleNamespace(state=state, constants=np.zeros((1, 1))))
    sizes_of = Observables().rounding(run, relative)
    # x: 2 + 0.75, v: 3 + 1; the product changes by 2.75 x 3 + 4 x 2, more than its largest value 8.
    assert sizes_of["y_std"] == pytest.approx(16.25e-12, rel=1e-3)
    assert sizes_of["x_std"] == pytest.approx(3e-12, rel=1e-3)  # at most 2.75 at the start, 3 in the run


def test_labels_by_tolerances_of_the_observables():
    system = system_of(X, Y, Z)
    limits = std_tolerances(system, None, 0.3)
    assert limits == {"x": 0.5, "y": 0.3, "z": 0.3}
    assert std_tolerances(system, {"y": 0.1, "other": 9.0}, 0.3) == {"x": 0.5, "y": 0.1, "z": 0.3}
    spread = {"x_std": np.array([0.5, 0.51, 0.0, 0.6]), "y_std": np.array([0.3, 0.0, 0.31, 0.0])}
    limits = {"x": 0.5, "y": 0.3}
    expected = [Steadiness.STEADY, *3 * [Steadiness.DRIFTING]]
    assert label(spread, limits).tolist() == expected
    rule = Observables().rules(run_of(), {})["label"]
    assert rule.statistics == ("x_std", "y_std")
    assert rule.label(spread).tolist() == expected
    settings = SimpleNamespace(std_tolerance=None, rate_tolerance=0.3)
    assert Observables().unsteadiness(system_of(X, Y), MEASURED, settings) == pytest.approx(0.8)


def test_differences_of_two_runs():
    """Statistics over the size of their observable; integrals by their order, 4, and states by that of the method."""
    other = {name: value + 0.0 for name, value in MEASURED.items()}
    coarse_steps = SimpleNamespace(**vars(STEPS) | {"steps": np.array([100])})
    final = np.array([[1.0], [3.0]])
    integration = SimpleNamespace(final_state=final)
    run = run_of(integration=integration)

    def changes(expected=0.0, state=final, **given):
        coarse = run_of(
            other | {k: np.array([v]) for k, v in given.items()}, coarse_steps, integration=SimpleNamespace(final_state=state)
        )  # fmt: skip
        return Observables().rate_change(run, coarse)[0], Observables().pair_error(
            run, coarse, np.array([expected])
        )[0]

    assert changes(y_mean=4.2) == pytest.approx((0.1, 0.1 / 15))
    assert changes(x_min=-2.4) == pytest.approx((0.2, 0.2))
    assert changes(expected=0.5) == pytest.approx((0.0, 0.15))
    # A state counts by its size, at least the mean size of all: 2.
    assert changes(state=np.array([[1.3], [3.0]])) == pytest.approx((0.0, 0.15 / 15))
    assert changes(state=np.array([[1.0], [3.9]])) == pytest.approx((0.0, 0.3 / 15))


@pytest.mark.parametrize(
    ("least", "largest", "distance", "radians", "resolved"),
    [
        (0.0, 2.0, 0.59, 0.0, True), (0.0, 2.0, 0.61, 0.0, False), (1.0, 3.0, 0.61, 0.0, False),
        (0.0, 2.0, 0.76, 1.0, True), (0.0, 2.0, 0.78, 1.0, False),  # radians^4 / 12 more of the range
        (-5.0, -5.0, 4e-9, 0.0, True), (-5.0, -5.0, 6e-9, 0.0, False),  # rounding of a constant
    ],
)  # fmt: skip
def test_jumps_between_nodes(least, largest, distance, radians, resolved):
    sums = np.zeros((observe.FIRST_ROW + 2 * len(observe.Field), 1))
    sums[observe.FIRST_ROW + len(observe.Field) + observe.Field.LEAST :, 0] = least, largest, distance
    steps = SimpleNamespace(sample_spacing=np.array([radians / 2]))
    run = run_of(steps=steps, integration=SimpleNamespace(sums=sums, finite=np.array([True])))
    run.ensemble = SimpleNamespace(size=1)
    assert Observables().resolved(run).tolist() == [resolved]
    run.integration.finite = np.array([False])
    assert Observables().resolved(run).all()


def test_whole_periods():
    """At least one of any duration; a period may lack a thousandth of itself."""
    constants = np.array([[2.0, 2.0, 2.0, 2.0, -2.0, np.nan]])
    duration = np.array([7.0, 7.9985, 7.997, 0.5, 6.1, 3.0])
    periods, length = whole_periods(system_of(X, Z), constants, duration)
    assert periods.tolist() == [3, 4, 3, 1, 3, 1]
    np.testing.assert_array_equal(length, [6.0, 8.0, 6.0, 2.0, 6.0, np.nan])
    none, same = whole_periods(system_of(X, Y), constants, duration)
    assert none is None
    assert same is duration
    assert [is_strobed(each) for each in (X, Z)] == [False, True]
