"""The sample of points that a run integrates again at half the step, and the error estimate."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.stats import binom
from strategies import default_points, evaluate

from atlas.flags import Label
from atlas.kernel.blocks import Threads
from atlas.kernel.statistics import RATES
from atlas.kernel.stepsize import StepSizes
from atlas.kernel.tableaux import METHODS
from atlas.label import half_step
from atlas.scene.model import Settings
from atlas.scene.read import load_scene
from atlas.systems import SYSTEMS

pytestmark = pytest.mark.usefixtures("whole_kernels")


@given(st.integers(1, 10**12), st.integers(1, 300))
def test_stratified_indices_take_one_of_each_part(size, count):
    indices = half_step.stratified_indices(size, count)
    assert indices.size == min(size, count)
    np.testing.assert_array_equal(indices, half_step.stratified_indices(size, count))
    for i, index in enumerate(indices):
        assert i * size // indices.size <= index < (i + 1) * size // indices.size


@given(st.integers(0, 50), st.integers(1, 2000))
def test_upper_bound_is_the_exact_binomial_one(events, draws):
    bound = half_step.upper_bound(events, draws)
    if events >= draws:
        assert bound == 1.0
    else:
        assert binom.cdf(events, draws, bound) == pytest.approx(0.05, rel=1e-6)


def test_half_step_sample_counts_what_changes(scene_text, monkeypatch):
    """With a kernel whose labels and rates depend on the step in a known way."""

    def labels_by_step(plan, tile, *, halved, threads):
        number = np.where(halved, halved.cumsum(), (~halved).cumsum()) - 1  # among the points of this step
        label = np.full(tile.duration.size, Label.PERMANENT_ROTATION, np.int8)
        label[number == 0], label[number == 1] = Label.NOT_COMPUTED, Label.UNRESOLVED
        label[halved & (number < 5)] = Label.DRIFTING
        rates = {name: np.where(halved, 0.05, 0.1) for name in RATES}
        estimate = np.where(number < 7, 0.0, 1.0)
        return {"label": label, "label_inertial": label.copy(), "error_estimate": estimate, **rates}

    monkeypatch.setattr(half_step, "evaluate", labels_by_step)
    fixed_step = {"integration.tolerance": None, "integration.step": 0.1}
    attributes = half_step.half_step_sample(load_scene(scene_text(fixed_step)))
    # All points were tried, so the bound is the count. The two points without a label cannot change it.
    assert attributes["atlas_half_step_points"] == attributes["atlas_points"] == 63
    assert attributes["atlas_labels_may_change"] == attributes["atlas_half_step_changed"] == 3
    assert attributes["atlas_half_step_difference"] == pytest.approx(0.05)
    text = half_step.half_step_text(attributes)
    first = "3 of 63 points checked at half the step changed their label; with 95 % confidence at most 3 of all 63 would"
    assert text.startswith(first + "; largest change")
    assert half_step.half_step_text(attributes, verbose=False) == first
    assert text.endswith("; 7 points changed by more than their error_estimate")
    large = load_scene(scene_text(fixed_step | {"axes.sigma.count": 900}))
    attributes = half_step.half_step_sample(large)
    assert attributes["atlas_half_step_points"] == 64
    assert attributes["atlas_labels_may_change"] == math.ceil(half_step.upper_bound(3, 64) * 6300)


def test_half_the_step_changes_nothing_in_a_well_resolved_scene(small_scene):
    scene = load_scene(small_scene)
    attributes = half_step.half_step_sample(scene)
    assert attributes["atlas_half_step_changed"] == attributes["atlas_labels_may_change"] == 0
    assert 0 < attributes["atlas_half_step_difference"] < 1e-6
    assert attributes == half_step.half_step_sample(scene, threads=Threads(1))


@pytest.mark.parametrize("method", METHODS.values(), ids=lambda method: method.name)
@pytest.mark.parametrize("limit", [{}, {"max_steps": 200}, {"step": 0.01}, {"rate_tolerance": 1e-9}])
def test_halved_step_sizes(method, limit):
    """Twice the steps, whatever limits the step; the expected errors fall with the order of the method."""
    points = default_points("satellite", theta0=[0.3, 0.9, 1.2], m=[0.5, 2.0, 9.0])
    bound, duration = SYSTEMS["satellite"].frequency_bound(points), np.array([30.0, 40.0, 50.0])
    settings = Settings(method=method.name, **limit).at(1e-5)
    full = StepSizes.of(settings, bound, duration)
    half = full.halved(method)
    np.testing.assert_array_equal(half.steps, 2 * full.steps)
    np.testing.assert_allclose(half.step_size * half.steps, full.step_size * full.steps, rtol=1e-15)
    np.testing.assert_array_equal(half.intervals, 2 * full.intervals)
    given_step = Settings(method=method.name, step=half.step_size.max(), max_steps=10**9)
    exact = StepSizes.of(given_step, bound, duration)
    i = int(half.step_size.argmax())
    assert exact.dispersion_error[i] == pytest.approx(half.dispersion_error[i], rel=0.5)
    assert exact.dissipation_error[i] == pytest.approx(half.dissipation_error[i], rel=0.5)


def test_errors_expected_and_measured_by_a_second_run():
    system, rng = SYSTEMS["satellite"], np.random.default_rng(8)
    points = default_points("satellite", 24, A=1.0, B=1.2, C=0.8, k3=0.5, mu1=0.2, h3=0.4)
    points |= {"m": rng.uniform(-1, 1, 24), "psi0": rng.uniform(0, 6, 24)}
    # the axis of half of them falls across the vertical, where psi' has peaks
    points["theta0"] = np.r_[rng.uniform(0.8, 2.2, 12), np.full(12, 0.5)]
    points["theta_dot0"] = np.r_[np.zeros(12), np.full(12, -1.0)]

    def run(tolerance, check_half_step):
        settings = Settings(tolerance=tolerance, cylinder_tolerance=1e-5, check_half_step=check_half_step)
        return evaluate(system, points, points, np.full(24, 8.0), settings)

    expected, measured, fine = run(1e-5, "none"), run(1e-5, "all"), run(1e-10, "none")
    bound = system.frequency_bound(points)
    error = np.max([np.abs(expected[name] - fine[name]) / bound for name in RATES], axis=0)
    for run_of in (expected, measured):
        assert (run_of["error_estimate"] >= run_of["integral_drift"]).all()
        assert (error <= 3 * run_of["error_estimate"]).all()
    assert np.median(measured["error_estimate"]) < 0.1 * np.median(expected["error_estimate"])
