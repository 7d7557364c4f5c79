"""Step sizes from the point and the settings alone."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from scipy.interpolate import KroghInterpolator

from atlas.kernel.sampling import MIN_INTERVALS
from atlas.kernel.stepsize import INTERPOLATION_ERROR, StepSizes, count_ladder
from atlas.kernel.tableaux import METHODS
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
        assert halved.step_ratio == pytest.approx(given_half.step_ratio)
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
    assert shorter.steps_per_sample.tolist() == [sizes.steps_per_sample[0], 1, 1, 1]
    np.testing.assert_array_equal(shorter.step_size, sizes.step_size)
    at_limits = replace(sizes, step_ratio=np.full(4, 0.5), dissipation_error=np.full(4, 0.1))
    assert at_limits.resolved.all()
    assert not StepSizes.of(settings, np.array([np.nan, np.inf]), np.full(2, 4.0)).resolved.any()


def test_steps_are_counts_whatever_the_numbers():
    """At rest with a tolerance that underflows, and where bound times duration overflows."""
    settings = Settings(rate_tolerance=5e-324, max_steps=64)
    with np.errstate(all="ignore"):
        sizes = StepSizes.of(settings, np.array([0.0, 1.0, 1e200]), np.array([1e8, 1e8, 1e200]))
    assert ((sizes.steps > 0) & (sizes.steps <= 128) & (sizes.steps_per_sample > 0)).all()
    assert sizes.step_ratio[0] == 0
    assert np.isinf(sizes.step_ratio[2])
    unbounded = StepSizes.of(Settings(tolerance=1e-12).at(1e-5), np.array([np.nan, np.inf]), np.ones(2))
    assert unbounded.steps.tolist() == [16, 16]


def amplification(method, y):
    """Factor by which a step of y radians multiplies x of x' = i w x: the stages worked out one by one."""
    slopes = []
    for row in method.a:
        slopes.append(1j * y * (1 + sum(a * k for a, k in zip(row, slopes, strict=True))))
    return 1 + sum(b * k for b, k in zip(method.b, slopes, strict=True))


@pytest.mark.parametrize("method", METHODS.values(), ids=lambda method: method.name)
def test_expected_errors_are_those_of_an_oscillation(method):
    """Phase and loss of amplitude of x' = 2 i x after 40 time units, to leading order in the step."""
    sizes = StepSizes.of(Settings(method=method.name, step=0.1), np.array([2.0]), np.array([40.0]))
    steps, y = int(sizes.steps[0]), 2.0 * float(sizes.step_size[0])
    factor = amplification(method, y)
    phase_error, loss = abs(np.angle(factor) - y), 1 - abs(factor)
    assert sizes.dispersion_error[0] == pytest.approx(steps * phase_error, rel=0.05, abs=0)
    assert sizes.dissipation_error[0] == pytest.approx(steps * loss, rel=0.05, abs=0)
    assert sizes.step_ratio[0] == pytest.approx(y / method.stability)
    # a rate of 2 varies by the local error of a time unit, by its loss of amplitude and by rounding
    assert sizes.rate_error[0] == pytest.approx(2 * (phase_error / y + steps * loss), rel=0.05, abs=0)


def test_rounding_errors_of_many_steps_add_up_as_a_random_walk():
    sizes = StepSizes.of(Settings(method="rk8", step=1e-5), np.array([3.0]), np.array([10.0]))
    assert sizes.rate_error[0] == pytest.approx(3.0 * 1e-16 * 1e3, rel=1e-3, abs=0)


@example(METHODS["rk4"], 0.05, 1e3, 1e-3, 1e-9)
@example(METHODS["rk4"], 0.1, 1.0, 1e-16, 1.0)
@given(
    st.sampled_from(list(METHODS.values())),
    st.floats(1e-2, 1e3),
    st.floats(1e-2, 1e3),
    st.sampled_from([1e-3, 1e-6, 1e-9]),
    st.sampled_from([1.0, 1e-3, 1e-6, 1e-9]),
)
def test_automatic_steps_keep_all_errors_within_the_tolerances_and_are_not_far_too_many(
    method, bound, duration, tolerance, rate_tolerance
):
    settings = Settings(
        method=method.name, tolerance=tolerance, rate_tolerance=rate_tolerance, max_steps=10**12
    )
    sizes = StepSizes.of(settings, np.array([bound]), np.array([duration]))
    steps, budget = int(sizes.steps[0]), 0.1 * rate_tolerance
    y = bound * duration / steps
    phase, loss = steps * method.dispersion * y ** (method.order + 1), method.dissipation_order - 1
    lost = steps * method.dissipation * y**method.dissipation_order
    # each error over what is allowed of it, and the power of the step that it grows with
    shares = [
        (phase / tolerance, method.order),
        (bound * method.dispersion * y**method.order / budget, method.order),
        (bound * lost / budget, loss),
    ]
    assert all(share <= 1 + 1e-9 for share, _ in shares)
    if steps >= 64:  # the next shorter count is then longer than two thirds
        assert any(share * 1.5**power > 1 for share, power in shares)


def test_counts_of_steps_are_multiples_of_16_a_quarter_of_an_octave_apart():
    assert count_ladder(np.array([0.0, 1.0, 16.0, 16.1, 32.0, 32.1, 48.1])).tolist() == [
        16, 16, 16, 32, 32, 48, 64,
    ]  # fmt: skip
    powers = 16.0 * 2.0 ** np.arange(30)
    np.testing.assert_array_equal(count_ladder(powers), powers)
    count = np.geomspace(1, 1e9, 20_001)
    rounded = count_ladder(count)
    assert (rounded % 16 == 0).all()
    assert ((rounded >= count) & (rounded <= 2**0.25 * np.maximum(count, 16) + 16)).all()
    octave = (rounded > 2**20) & (rounded <= 2**21)
    assert np.unique(rounded[octave]).size == 4


def test_interpolation_error_is_that_of_four_nodes_with_slopes():
    """Of cos(t), half-way between the two inner nodes, to leading order in their distance."""
    x = 0.3
    nodes = x * (np.arange(4) - 1.5)
    values = np.column_stack([np.cos(nodes), -np.sin(nodes)]).ravel()
    error = abs(KroghInterpolator(np.repeat(nodes, 2), values)(0.0) - 1.0)
    assert error == pytest.approx(INTERPOLATION_ERROR * x**8, rel=0.01)


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("limit", [{"tolerance": 1e-2}, {"tolerance": 1e-9}, {"step": 0.1}, {"step": 1e-4}])
def test_nodes_are_as_far_apart_as_their_interpolation_allows(method, limit):
    """The interpolation adds a tenth of the phase error at most; a short run keeps enough nodes."""
    bound, duration = (
        each.ravel() for each in np.meshgrid(np.geomspace(1e-2, 1e2, 60), np.geomspace(0.1, 1e3, 60))
    )
    sizes = StepSizes.of(Settings(method=method, **limit).at(1e-5), bound, duration)
    spacing, y = sizes.steps_per_sample, bound * sizes.step_size

    def allowed(spacing, slack):
        interpolation = INTERPOLATION_ERROR * (spacing * y) ** 8
        enough = sizes.steps * slack >= 4 * MIN_INTERVALS * spacing
        return (interpolation <= 0.1 * sizes.dispersion_error * slack) & enough

    assert np.isin(spacing, (1, 2, 4, 8, 16)).all()
    assert (sizes.steps % spacing == 0).all()
    # given steps are rounded up to whole intervals afterwards
    slack = 2.0 if "step" in limit else 1 + 1e-6
    assert ((spacing == 1) | allowed(spacing, slack)).all()
    assert ((spacing == 16) | ~allowed(2 * spacing, 1 / slack)).all()


@pytest.mark.parametrize("method", METHODS.values(), ids=lambda method: method.name)
def test_incommensurate_step_sizes_share_no_node(method):
    duration = np.geomspace(0.1, 1e4, 200)
    sizes = StepSizes.of(Settings(method=method.name, tolerance=1e-4).at(1e-5), np.full(200, 20.0), duration)
    other = sizes.incommensurate(method)
    np.testing.assert_allclose(other.step_size * other.steps, duration)
    assert (other.steps % other.steps_per_sample == 0).all()
    assert (np.gcd(sizes.intervals, other.intervals) <= 3).all()
    assert (np.abs(other.steps / sizes.steps - 0.618) < 0.06).all()
    few = StepSizes.of(Settings(method=method.name, step=1.0), np.ones(1), np.array([3.0]))
    assert few.incommensurate(method).intervals.tolist() == [5]


@pytest.mark.parametrize("method", METHODS.values(), ids=lambda method: method.name)
def test_coarsened_step_sizes(method):
    """Half the steps, rounded up, with the errors of steps of that length."""
    duration = np.array([0.003, 0.004, 0.005, 0.009, 0.1])
    bound = np.full(duration.size, 20.0)
    settings = Settings(method=method.name, step=0.001)
    fine = StepSizes.of(settings, bound, duration)
    coarse = fine.coarsened(method)
    assert coarse.steps.tolist() == [3, 3, 3, 5, fine.steps[4] // 2]
    assert (coarse.steps % coarse.steps_per_sample == 0).all()
    np.testing.assert_allclose(coarse.step_size * coarse.steps, duration)
    y = bound * duration / coarse.steps
    lost = coarse.steps * method.dissipation * y**method.dissipation_order
    np.testing.assert_allclose(coarse.step_ratio, y / method.stability)
    np.testing.assert_allclose(
        coarse.dispersion_error, coarse.steps * method.dispersion * y ** (method.order + 1)
    )
    np.testing.assert_allclose(coarse.dissipation_error, lost)
    # rate errors change with the order of the method
    ratio = fine.steps / coarse.steps
    np.testing.assert_allclose(coarse.rate_error, fine.rate_error * ratio**method.order)
    np.testing.assert_allclose(fine.halved(method).rate_error, fine.rate_error / 2**method.order)


@pytest.mark.parametrize("method", METHODS)
def test_a_transient_and_a_run_take_the_steps_of_a_whole_run(method):
    """No longer ones, hardly more of them, with the same errors; halved ones are twice as many."""
    rng = np.random.default_rng(6)
    bound, duration = 10 ** rng.uniform(-2, 2, 300), 10 ** rng.uniform(-1, 3, 300)
    transient = 10 ** rng.uniform(-1, 3, 300) * (rng.uniform(size=300) > 0.2)
    settings = Settings(method=method).at(1e-5)
    whole = StepSizes.of(settings, bound, transient + duration)
    sizes, none = whole.after(transient, duration), transient == 0
    assert (sizes.transient_steps[none] == 0).all()
    np.testing.assert_array_equal(sizes.step_size[none], whole.step_size[none])
    np.testing.assert_array_equal(sizes.steps[none], whole.steps[none])
    np.testing.assert_allclose(sizes.steps * sizes.step_size, duration, rtol=1e-12)
    assert (sizes.step_size <= whole.step_size * (1 + 1e-9)).all()
    assert (transient <= sizes.transient_steps * whole.step_size * (1 + 1e-9)).all()
    assert (sizes.whole_steps <= whole.steps + 8 * whole.steps_per_sample).all()
    assert (sizes.steps % sizes.steps_per_sample == 0).all()
    np.testing.assert_array_equal(sizes.dispersion_error, whole.dispersion_error)
    halved = sizes.halved(METHODS[method])
    np.testing.assert_array_equal(halved.whole_steps, 2 * sizes.whole_steps)
