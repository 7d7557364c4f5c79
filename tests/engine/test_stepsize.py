"""Step sizes from the point and the settings alone."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from atlas.engine.stepsize import StepSizes
from atlas.engine.tableaux import METHODS
from atlas.scene.model import Settings


@given(
    st.floats(1e-3, 1e4),
    st.floats(1e-3, 1e5),
    st.sampled_from([1e-4, 1e-6, 1e-8, 1e-10]),
    st.sampled_from(list(METHODS)),
)
def test_steps_follow_from_the_point_alone(bound, duration, tolerance, method):
    settings = Settings(method=method, tolerance=tolerance, rate_tolerance=1e30, max_steps=10**9)
    both = StepSizes.of(settings, np.array([bound, 1.0]), np.array([duration, 3.0]))
    alone = StepSizes.of(settings, np.array([bound]), np.array([duration]))
    assert both.steps[0] == alone.steps[0]
    assert both.steps[0] % both.steps_per_sample[0] == 0
    assert both.step_size[0] * both.steps[0] == pytest.approx(duration, rel=1e-14)
    if both.steps[0] < 10**9 // 2:
        assert both.dispersion_error[0] <= tolerance * (1 + 1e-9)


def test_a_given_step_is_kept():
    step_sizes = StepSizes.of(Settings(step=0.01), np.array([2.0]), np.array([10.0]))
    assert step_sizes.step_size[0] <= 0.01
    assert step_sizes.step_size[0] > 0.0098
    assert step_sizes.step_ratio[0] == pytest.approx(step_sizes.step_size[0] * 2.0 / np.sqrt(8))


def test_half_the_step_is_that_of_twice_the_count():
    for method in METHODS.values():
        settings = Settings(method=method.name, step=0.01)
        bound, duration = np.array([2.0]), np.array([16.0])
        halved = StepSizes.of(settings, bound, duration).halved(method)
        given_half = StepSizes.of(replace(settings, step=0.005), bound, duration)
        assert halved.steps == given_half.steps
        assert halved.step_size == given_half.step_size
        assert halved.dispersion_error == pytest.approx(given_half.dispersion_error)
        assert halved.dissipation_error == pytest.approx(given_half.dissipation_error)


def test_a_run_is_resolved_where_neither_the_step_nor_the_dissipation_is_too_large():
    settings = Settings(step=0.01, max_steps=10**9)
    sizes = replace(
        StepSizes.of(settings, np.ones(4), np.full(4, 4.0)),
        step_ratio=np.array([0.4, 0.6, 0.4, np.nan]),
        dissipation_error=np.array([0.05, 0.05, 0.2, 0.05]),
    )
    assert sizes.resolved.tolist() == [True, False, False, False]
    shorter = sizes.without_unresolved()
    assert shorter.steps.tolist() == [sizes.steps[0], 64, 64, 64]
    np.testing.assert_array_equal(shorter.step_size, sizes.step_size)
    assert not StepSizes.of(settings, np.array([np.nan, np.inf]), np.full(2, 4.0)).resolved.any()


def test_steps_are_counts_whatever_the_numbers():
    """At rest with a tolerance that underflows, and where bound times duration overflows."""
    settings = Settings(rate_tolerance=5e-324, max_steps=64)
    with np.errstate(all="ignore"):
        sizes = StepSizes.of(settings, np.array([0.0, 1.0, 1e200]), np.array([1e8, 1e8, 1e200]))
    assert ((sizes.steps > 0) & (sizes.steps <= 128) & (sizes.steps_per_sample > 0)).all()
    assert sizes.step_ratio[0] == 0
    assert np.isinf(sizes.step_ratio[2])
