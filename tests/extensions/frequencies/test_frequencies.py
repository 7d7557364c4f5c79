"""Lines of a motion: sums of exponentials, a torque-free symmetric top, and what is too fast for the samples."""

import numpy as np
import pytest
import xarray as xr
from refusals import assert_refused

import atlas
from atlas.analysis.degrees import in_degrees
from atlas.extensions.frequencies.spectrum import frequencies_of_motion, frequencies_of_point, spectral_lines

pytestmark = pytest.mark.usefixtures("whole_kernels")


def test_lines_of_a_sum_of_exponentials():
    time = np.linspace(0, 200, 2001)
    exact = {1.2345678: 1.0, -0.7654321: 0.5j, 2.1: -0.01}
    signal = sum(c * np.exp(1j * w * time) for w, c in exact.items())
    frequency, coefficient = spectral_lines(time, signal, 5)
    np.testing.assert_allclose(frequency[:3], list(exact), atol=1e-7)
    np.testing.assert_allclose(coefficient[:3], list(exact.values()), atol=1e-6)
    assert np.abs(coefficient[3:]).max(initial=0) < 1e-5


def test_lines_of_a_real_signal_are_cosines():
    time = np.linspace(0, 150, 1501)
    signal = (0.7 * np.cos(0.9 * time + 0.3) + 0.2 * np.cos(2.3 * time)).astype(complex)
    frequency, coefficient = spectral_lines(time, signal, 2, real=True)
    np.testing.assert_allclose(frequency, [0.9, 2.3], atol=1e-8)
    np.testing.assert_allclose(np.abs(coefficient), [0.7, 0.2], atol=1e-7)
    assert np.angle(coefficient[0]) == pytest.approx(0.3, abs=1e-6)


def regular_precession(n, m, theta):
    """Motion of a torque-free symmetric top: psi and phi turn at n and m."""
    A = 1.0
    C = A * n * np.cos(theta) / (n * np.cos(theta) + m)  # C (n cos theta + m) = A n cos theta
    return atlas.trajectory(
        "fixed_point", {"A": A, "B": A, "C": C, "theta0": theta, "n": n, "m": m, "Mg": 0.0},
        duration=120.0, samples=2001,
    )  # fmt: skip


def test_rates_of_a_regular_precession():
    n, m, theta = 0.8, 0.3, 0.9
    ds = frequencies_of_motion(regular_precession(n, m, theta), 1)
    assert ds.frequency.sel(signal="psi").item() == pytest.approx(n, abs=1e-7)
    assert ds.frequency.sel(signal="phi").item() == pytest.approx(m, abs=1e-7)
    assert ds.amplitude.sel(signal="psi").item() == pytest.approx(np.sin(theta), abs=1e-6)
    assert ds.share.sel(signal="phi").item() == pytest.approx(1.0, abs=1e-5)


def test_a_motion_answers_by_itself_in_rad_or_degrees():
    motion = regular_precession(0.8, 0.3, 0.9)
    lines = motion.atlas.frequencies(4)
    assert dict(lines.sizes) == {"signal": 3, "line": 4}
    assert lines.frequency.sel(signal="psi", line=0).item() == pytest.approx(0.8, abs=1e-7)
    xr.testing.assert_identical(lines, motion.atlas.frequencies(4, trajectory=motion))
    np.testing.assert_allclose(
        in_degrees(motion, True).atlas.frequencies(1).frequency, lines.frequency[:, :1], rtol=1e-9
    )


@pytest.mark.long
def test_small_librations_have_the_frequency_of_the_linear_equations():
    """Third axis along the radius, second along the normal: B psi'' = -3 (A - C) psi."""
    A, B, C = 1.3, 1.6, 1.0
    start = {"psi0": np.pi / 2 + 1e-3, "theta0": np.pi / 2, "phi0": 0.0}
    motion = atlas.trajectory("satellite", {"A": A, "B": B, "C": C} | start, duration=300.0, samples=3001)
    psi = frequencies_of_motion(motion, 2).sel(signal="psi")
    expected = np.sqrt(3 * (A - C) / B)
    np.testing.assert_allclose(np.sort(psi.frequency), [-expected, expected], atol=1e-5)


def test_too_few_samples_are_refused():
    motion = atlas.trajectory(
        "fixed_point", {"Mg": 0.0, "theta0": 1.0, "n": 5.0, "m": 3.0}, duration=100.0, samples=180
    )
    with pytest.raises(atlas.BadInput, match="samples = 180: too few"):
        frequencies_of_motion(motion, 1)
    with pytest.raises(atlas.BadInput, match="samples = 180: too few"):
        motion.atlas.frequencies(1)


@pytest.mark.usual("50.6")
@pytest.mark.parametrize("rate", [50.6, 2 * np.pi * 100 / 12.6])
def test_lines_that_are_too_fast_for_the_samples(rate):
    """The vertical turns in a spherical body at its rate; the second has one phase at every sample, as a constant has."""
    m = np.sqrt(rate**2 - (1.3 * np.sin(0.5)) ** 2) - 1.3 * np.cos(0.5)

    def sampled(samples):
        point = {"A": 1.0, "B": 1.0, "C": 1.0, "theta0": 0.5, "m": m, "n": 0.3}
        return atlas.trajectory("satellite", point, duration=12.6, samples=samples, method="rk8")

    with pytest.raises(atlas.BadInput, match="samples = 101: too few for a line of") as error:
        frequencies_of_motion(sampled(101), 1)
    for lines in (
        frequencies_of_motion(sampled(int(str(error.value).split()[-1])), 1),
        frequencies_of_point(sampled, 1, 101),
    ):
        assert float(lines.frequency.sel(signal="phi")[0]) == pytest.approx(rate, abs=1e-3)


def test_accessor(small_scene):
    ds = atlas.run(atlas.load_scene(small_scene), progress=False)
    place = {dim: float(ds[dim][1]) for dim in ds.label.dims}
    table = ds.atlas.frequencies(2, samples=1025, **place)
    assert table.sizes == {"signal": 3, "line": 2}
    assert table.frequency.attrs["units"] == "rad s-1"


def test_lines_of_a_motion_have_the_amplitudes_and_shares_of_its_angles():
    """sin(theta) exp(i psi) of a small libration about a tilted axis; the shares of all lines are the whole variance."""
    tr = atlas.trajectory("satellite", {"theta0": 0.3, "m": 1.0, "C": 1.4}, duration=60.0, samples=2001)
    table = tr.atlas.frequencies(4, trajectory=tr)
    assert table.share.sum("line").values == pytest.approx(1.0, abs=2e-3)
    assert (table.frequency.attrs["units"], table.share.attrs["units"]) == ("rad s-1", "1")
    signals = {"theta": np.cos(tr.theta.values) + 0j}
    signals |= {name: np.sin(tr.theta.values) * np.exp(1j * tr[name].values) for name in ("psi", "phi")}
    window = np.hanning(2001)
    window /= window.sum()
    for name, signal in signals.items():
        # The transform of the signal is what the line has alone, where it is far from the others.
        line = table.sel(signal=name).isel(line=0)
        wave = np.exp(-1j * float(line.frequency) * tr.time.values)
        mean = (window @ signal) if name == "theta" else 0.0
        part = abs(window @ ((signal - mean) * wave)) * (2 if name == "theta" else 1)
        assert float(line.amplitude) == pytest.approx(part, rel=0.02)
        variance = window @ np.abs(signal - window @ signal) ** 2
        assert float(line.share) == pytest.approx(
            part**2 / variance / (2 if name == "theta" else 1), rel=0.05
        )


@pytest.mark.parametrize(
    ("options", "sentence"),
    [
        ({"lines": "a"}, "lines = 'a': must be a whole number..."),
        ({"trajectory": 3}, "trajectory = 3: must be a dataset..."),
        ({"degrees": "yes"}, "degrees = 'yes': must be true or false"),
    ],
)
def test_wrong_values_are_one_line(options, sentence):
    points = atlas.label_points("satellite", {"theta0": [0.1, 0.2]}, duration=1.0)
    assert_refused(lambda: points.atlas.frequencies(**options), sentence)
