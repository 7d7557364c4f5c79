"""Where damped motions end: against other integrators, and the proof by the energy against closed forms."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import atlas
from atlas.extensions.basins.attitude import texts
from atlas.extensions.basins.wells import SETTLED, wells_of
from atlas.flags import SettledBy, Status
from atlas.systems.satellite import SATELLITE
from atlas.systems.satellite.equations import jacobi, rhs
from atlas.systems.satellite.initial import constants, initial_state

pytestmark = pytest.mark.usefixtures("whole_kernels")

SETS = json.loads((Path(__file__).parents[2] / "reference" / "basins_cases.json").read_text())["sets"]
ANGLES, RATES = ("theta0", "psi0", "phi0"), ("n", "m", "theta_dot0")
VARIABLES = [
    "label", "status", "end_equilibrium", "end_theta0", "end_psi0", "end_phi0", "end_index", "settled_by", "settling_time", "step",
]  # fmt: skip
SKEW = {"A": 1.0, "B": 1.3, "C": 1.6, "k1": 0.05, "k2": 0.1, "k3": 0.3, "damping": 0.2}


def ends(points, duration=400.0, **options):
    """The variables of ends."""
    options = {"method": "rk8", "tolerance": 1e-7, "variables": VARIABLES, "threads": 1} | options
    return atlas.label_points("satellite", points, duration=duration, **options)


def random_starts(rng, count):
    angles = [np.arccos(rng.uniform(-1, 1, count)), *rng.uniform(-np.pi, np.pi, (2, count))]
    rates = [*rng.uniform(-1.5, 1.5, (2, count)), rng.uniform(-0.8, 0.8, count)]
    return dict(zip((*ANGLES, *RATES), [*angles, *rates], strict=True))


def by_dop853(points, times):
    """States at some times, (states, points, times), all starts as one system."""
    size = max(np.size(value) for value in points.values())
    full = SATELLITE.with_defaults({}) | points
    full = {name: np.broadcast_to(value, size).astype(float) for name, value in full.items()}
    state, numbers = initial_state(full), constants(full)

    def slope(_, y):
        return np.array(rhs(y.reshape(state.shape), numbers)).ravel()

    run = solve_ivp(slope, (0, times[-1]), state.ravel(), "DOP853", times, rtol=1e-9, atol=1e-10)
    return run.y.reshape(*state.shape, len(times)), numbers


def vectors_of(equilibria, place):
    return np.concatenate([equilibria[name].values[place] for name in ("alpha", "gamma")], -1)


@pytest.mark.usual("gravity_gradient")
@pytest.mark.parametrize("given", SETS, ids=[each["name"] for each in SETS])
def test_ends_are_those_of_two_other_integrators(given):
    """Among them DOP853 with quaternions; the numbers there are positions in a list of the minima."""
    body = {"damping": given["damping"]} | {name: given[name] for name in "ABC"}
    body |= dict(zip(("k1", "k2", "k3"), given["k"], strict=True))
    starts = {name: np.array([case[name] for case in given["cases"]]) for name in (*ANGLES, *RATES)}
    ds = ends(body | starts, given["duration"])
    assert (ds["settled_by"] == SettledBy.PROVED).all()
    assert (ds["end_index"] == 0).all()
    attitudes = vectors_of(atlas.equilibria("satellite", body), ds["end_equilibrium"].values)
    minima = np.array([[*minimum["alpha"], *minimum["gamma"]] for minimum in given["minima"]])
    np.testing.assert_allclose(attitudes, minima[[case["end"] for case in given["cases"]]], atol=1e-8)
    at_end = {name: ds[f"end_{name}"].values for name in ANGLES}
    state = initial_state(SATELLITE.with_defaults(body) | at_end | {"n": np.zeros(len(attitudes))})
    np.testing.assert_allclose(state[3:].T, attitudes, atol=1e-8)


def test_a_proof_in_a_short_run_holds_in_a_long_one_of_another_integrator():
    """Half of these are proved while the body still moves, and the body stays near its end after the time of settling."""
    starts = random_starts(np.random.default_rng(3), 60)
    short, long = ends(SKEW | starts, 12.0), ends(SKEW | starts, 160.0)
    proved = (short["settled_by"] == SettledBy.PROVED).values
    assert 0.3 < proved.mean() < 1
    assert np.isnan(short["settling_time"]).all()
    assert (long["settled_by"] == SettledBy.PROVED).all()
    times = np.linspace(0, 160.0, 1601)
    states, numbers = by_dop853(SKEW | starts, times)
    equilibria = atlas.equilibria("satellite", SKEW)
    every = vectors_of(equilibria, slice(None))
    end = np.argmin(np.linalg.norm(states[3:, :, -1].T[:, None] - every, axis=-1), 1)
    assert (long["end_equilibrium"].values == end).all()
    assert (short["end_equilibrium"].values[proved] == end[proved]).all()
    assert (short["end_equilibrium"].values[~proved] == -1).all()
    time = long["settling_time"].values
    after, before = times > time[:, None], (times < time[:, None] - 1) & (times > time[:, None] - 6)
    distance = np.linalg.norm(states[3:6] - every[end].T[:3, :, None], axis=0)
    distance = np.maximum(distance, np.linalg.norm(states[6:] - every[end].T[3:, :, None], axis=0))
    rates = np.linalg.norm(states[:3] - states[6:], axis=0)
    assert distance[after].max() < 1.01 * SETTLED
    assert rates[after].max() < 1.01 * SETTLED
    energy = sum(jacobi(states, numbers[:, :, None])) - equilibria["potential"].values[end][:, None]
    assert (energy[before].reshape(-1) > 0).all()
    wells = wells_of(SATELLITE, SATELLITE.with_defaults(SKEW))[0]
    level = (wells.settled - wells.potential)[0, end]
    assert all((energy[i][before[i]] > level[i]).all() for i in range(60))


def test_the_rim_of_a_well_is_its_own_lowest_saddle():
    """With a field along the radius two wells are deeper: the potential of the yaw saddle of each is known in closed form."""
    body = {"A": 1.0, "B": 1.3, "C": 1.6, "mu1": 1.0, "h1": 0.1}
    wells, _ = wells_of(SATELLITE, SATELLITE.with_defaults(body))
    wells.find_rims(np.array([0]))
    minima = np.flatnonzero(wells.minimum[0])
    assert minima.size == 4
    sign = np.sign(wells.frames[0, minima, 0, 0])
    np.testing.assert_allclose(wells.potential[0, minima], 1.5 - 0.8 + 0.1 * sign, rtol=1e-12)
    np.testing.assert_allclose(wells.rim[0, minima], 1.5 - 0.65 + 0.1 * sign, rtol=1e-12)
    # At rest, turned from the shallow minimum about the radius, between the rims: above a saddle of the other wells.
    angle, frame = 0.7, np.eye(3)[None]
    turned = frame.copy()
    turned[0, 1:, 1:] = [[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]]
    row, energy = np.zeros(1, np.int64), wells.energy(turned, np.zeros((1, 3)), np.zeros(1, np.int64))
    place, _ = wells.nearest(turned, row)
    assert wells.rim[0, minima].min() < energy[0] < wells.rim[0, minima].max()
    well = wells.proved(turned, energy, row, place, np.zeros(1, bool))[0]
    np.testing.assert_allclose(wells.frames[0, well], frame[0], atol=1e-9)
    assert wells.proved(turned, energy + 0.1, row, place, np.zeros(1, bool))[0] == -1


def test_wells_of_a_symmetric_body_are_circles():
    """Every turn about the axis of symmetry is the same end: its own angle is not given."""
    body = {"A": 1.0, "B": 1.0, "C": 1.6, "damping": 0.3}
    ds = ends(body | random_starts(np.random.default_rng(4), 20), 200.0)
    assert (ds["settled_by"] == SettledBy.PROVED).all()
    assert set(ds["end_theta0"].values.round(6)) == {0.0, round(np.pi, 6)}
    assert np.isnan(ds["end_phi0"]).all()
    circles = atlas.equilibria("satellite", body)
    assert circles["circle"].values[ds["end_equilibrium"].values].all()
    assert np.isfinite(ds["settling_time"]).all()


def test_rest_at_a_saddle_is_measured_and_without_damping_nothing_is_proved():
    saddle = {"psi0": np.array([np.pi / 2, 0.0, 0.0]), "n": np.array([0.0, 0.0, 0.3])}
    body = {"A": 1.0, "B": 1.3, "C": 1.6}
    points = body | saddle | {"damping": np.array([0.2, 0.0, 0.0])}
    # An error of 1e-7 leaves the saddle in this time, but one of 1e-12.
    undecided = ends(points, 20.0)
    assert undecided["settled_by"].values.tolist() == [SettledBy.UNDECIDED, SettledBy.MEASURED, SettledBy.NOT]
    ds = ends(points, 20.0, tolerance=1e-12)
    assert ds["end_index"].values.tolist() == [1, 0, -1]
    measured = [SettledBy.MEASURED, SettledBy.MEASURED, SettledBy.NOT]
    assert ds["settled_by"].values.tolist() == measured
    np.testing.assert_array_equal(ds["settling_time"], [np.nan, 0.0, np.nan])
    assert [", perhaps passing a saddle" in text for text in texts(ds).values()] == [False, True]


@pytest.mark.long
def test_an_end_that_changes_with_the_step_is_step_sensitive():
    """Steps far too long, and motions that choose between two ends many times: where runs of two steps differ no end is given."""
    starts = random_starts(np.random.default_rng(5), 64) | {"n": np.linspace(2.0, 3.0, 64)}
    body = SKEW | {"damping": 0.02} | starts
    ds = ends(body, 900.0, tolerance=1e-2, check_half_step="all")
    fine = ends(body, 900.0, step=float(ds["step"].min()) / 2, check_half_step="none")
    sensitive = (ds["status"] == Status.STEP_SENSITIVE).values
    changed = (fine["end_equilibrium"] != ds["end_equilibrium"]).values
    assert sensitive.any()
    assert (ds["end_equilibrium"].values[sensitive] == -1).all()
    undecided = [(each["settled_by"] == SettledBy.UNDECIDED).values for each in (ds, fine)]
    assert not (changed & ~sensitive & ~undecided[0] & ~undecided[1]).any()
    assert ((fine["settled_by"] == SettledBy.PROVED).values | undecided[1]).all()


# Weakly damped satellites, which tumble for long, and durations after which they have settled.
TUMBLING = (
    ({"A": 1.0, "B": 1.3, "C": 1.6, "damping": 0.02}, 700.0),
    (SKEW | {"damping": 0.03}, 600.0),
    ({"A": 1.0, "B": 1.0, "C": 1.6, "k1": 0.1, "mu2": 0.3, "h1": 0.4, "damping": 0.03}, 600.0),
)


@pytest.mark.long
def test_runs_of_different_tolerances_agree_on_the_ends_that_they_give():
    """After chaotic transients: without regard to the growth of errors some of them differ with proofs in both."""
    rng = np.random.default_rng(8)
    for body, duration in TUMBLING:
        starts = random_starts(rng, 40)
        runs = [ends(body | starts, duration, tolerance=tolerance) for tolerance in (1e-6, 1e-8, 1e-10)]
        place = np.array([ds["end_equilibrium"].values for ds in runs])
        undecided = np.array([ds["settled_by"].values == SettledBy.UNDECIDED for ds in runs])
        assert all((ds["status"] == Status.OK).all() for ds in runs)
        assert ((place < 0) == undecided).all()
        assert all(
            np.isnan(ds["settling_time"].where(ds["settled_by"] == SettledBy.UNDECIDED)).all() for ds in runs
        )
        assert ((place == place.max(0)) | undecided).all()
        decided = (~undecided).sum(1)
        assert 0 < decided[0] < decided[1] < decided[2] < 40


@pytest.mark.long
def test_ends_after_tumbling_are_those_of_another_integrator():
    body, duration = TUMBLING[0]
    starts = random_starts(np.random.default_rng(9), 40)
    ds = ends(body | starts, duration, tolerance=1e-8)
    given = (ds["settled_by"] == SettledBy.PROVED).values
    assert 2 < given.sum() < 40
    starts = {name: values[given] for name, values in starts.items()}
    states, _ = by_dop853(body | starts, np.array([0.0, duration]))
    every = vectors_of(atlas.equilibria("satellite", body), slice(None))
    end = np.argmin(np.linalg.norm(states[3:, :, -1].T[:, None] - every, axis=-1), 1)
    np.testing.assert_array_equal(ds["end_equilibrium"].values[given], end)


@pytest.mark.long
def test_ends_after_a_transient_are_those_of_the_whole_run():
    """Undecided ones as well: errors grow from the start."""
    body, duration = TUMBLING[0]
    points = body | random_starts(np.random.default_rng(9), 40)
    whole, ds = ends(points, duration), ends(points, 100.0, transient=duration - 100.0)
    for name in ("end_equilibrium", "settled_by"):
        np.testing.assert_array_equal(ds[name], whole[name], err_msg=name)
    assert {SettledBy.PROVED, SettledBy.UNDECIDED} <= set(ds["settled_by"].values)


def test_times_of_settling_count_from_the_start():
    points = SKEW | random_starts(np.random.default_rng(3), 40)
    whole = ends(points, 200.0)["settling_time"].values
    transient = float(np.median(whole))
    time = ends(points, 200.0 - transient, transient=transient)["settling_time"].values
    assert np.abs(np.maximum(whole, transient) - time).max() < 8 * 0.5  # seen at every eighth node
    assert (time[whole < transient - 4.0] == transient).all()
    assert (time > transient + 1.0).any()


def test_the_energy_decides_where_no_error_can_leave_the_well():
    """Errors of 0.05 may decide everything but the end of a body that starts below every saddle."""
    rest = {"theta0": np.array([0.3, 0.3]), "n": np.array([0.0, 2.0])}
    ds = ends({"A": 1.0, "B": 1.3, "C": 1.6, "damping": 0.2} | rest, 200.0, tolerance=0.05)
    assert ds["settled_by"].values.tolist() == [SettledBy.PROVED, SettledBy.UNDECIDED]
    assert (ds["status"] == Status.OK).all()
    assert ds["end_index"].values.tolist() == [0, -1]
    assert np.isnan(
        ds[["end_theta0", "end_psi0", "end_phi0", "settling_time"]].isel(point=1).to_array()
    ).all()


def test_without_a_tolerance_the_expected_error_counts():
    """A given step of which the errors are rounding decides what a smaller tolerance would."""
    body, duration = TUMBLING[0]
    points = body | random_starts(np.random.default_rng(9), 40)
    coarse, fine = (ends(points, duration, step=step) for step in (0.2, 0.05))
    counts = [(ds["settled_by"] == SettledBy.PROVED).sum().item() for ds in (coarse, fine)]
    assert counts[0] < counts[1]
    both = ((coarse["end_equilibrium"] >= 0) & (fine["end_equilibrium"] >= 0)).values
    np.testing.assert_array_equal(*(ds["end_equilibrium"].values[both] for ds in (coarse, fine)))


def test_equal_potentials_are_ordered_by_attitude():
    """Alone and among other bodies, where rounding differs."""
    k3 = np.array([0.0, 0.1, 0.3])
    many = atlas.equilibria("satellite", {"A": 1.0, "B": 1.3, "C": 1.6, "k2": 0.1, "k3": k3})
    for i in range(3):
        one = atlas.equilibria("satellite", {"A": 1.0, "B": 1.3, "C": 1.6, "k2": 0.1, "k3": k3[i]})
        size = one.sizes["equilibrium"]
        np.testing.assert_allclose(
            vectors_of(many, (i, slice(size))), vectors_of(one, slice(None)), atol=1e-9
        )
        for pair in range(0, size, 2):
            first, second = vectors_of(one, [pair, pair + 1]).round(6).tolist()
            assert first < second


def test_bodies_near_the_largest_number_have_no_end():
    huge = np.finfo(float).max
    ds = ends(
        {"A": huge, "B": huge, "C": huge / 2, "n": [1.5, 0.0]}, duration=1e-320, step=5e-324, max_steps=6
    )
    assert (ds.end_equilibrium == -1).all()
