"""`error_estimate` against the true errors of all statistics, expected and measured by a second run."""

from functools import partial

import numpy as np
import pytest
from strategies import DRAG, RANDOM, default_points
from truth import worst_point

import atlas
from atlas.analysis.summary import summary
from atlas.flags import Label, Status
from atlas.kernel.statistics import RATES
from atlas.systems import SYSTEMS

pytestmark = pytest.mark.usefixtures("whole_kernels")

COUNT = 64


def point_set(kind: str, system: str) -> tuple[dict[str, np.ndarray], np.ndarray]:
    """Points of a system and durations: random, slender or symmetric bodies, or starts beside the vertical."""
    rng = np.random.default_rng(3)
    points = {k: v for k, v in RANDOM[system](rng, COUNT).items() if not np.isnan(v).any()}
    duration = rng.uniform(0.5, 8.0, COUNT)
    if kind == "slender":
        points["C"] = points["A"] * 10 ** rng.uniform(-2, -1, COUNT)
        points["B"] = points["A"] - 0.9 * points["C"]
        duration = duration / 4
    elif kind == "symmetric":
        points["B"] = points["A"]
        points |= {
            name: np.zeros(COUNT)
            for name in ("k1", "k2", "mu1", "mu2", "drag1", "drag2", "l1", "l2", "x0", "y0")
            if name in points
        }
        points["C"] = np.minimum(points["C"], 1.9 * points["A"])
    elif kind == "beside the vertical":
        points["theta0"] = 10 ** rng.uniform(-3, -1, COUNT)
        points["theta0"][::2] = np.pi - points["theta0"][::2]
        points["theta_dot0"] = rng.normal(size=COUNT)
    elif (
        kind == "kicked off the vertical"
    ):  # from the pole itself, or from the cylinder around it; drag makes most of them unstable
        points |= {name: np.zeros(COUNT) for name in DRAG if name in points}
        points["theta0"] = 10 ** rng.uniform(-9, -5.1, COUNT) * rng.integers(0, 2, COUNT)
        points["theta0"][::2] = np.pi - points["theta0"][::2]
        points["theta_dot0"] = 10 ** rng.uniform(-2, 0.3, COUNT) * rng.choice([-1, 1], COUNT)
    return points, duration


@pytest.mark.usual("random-satellite", "kicked off the vertical-fixed_point")
@pytest.mark.parametrize("system", SYSTEMS)
@pytest.mark.parametrize(
    "kind", ["random", "slender", "symmetric", "beside the vertical", "kicked off the vertical"]
)
def test_estimates_cover_the_errors_of_all_statistics(kind, system):
    """Against rk8 at a tolerance of 1e-13; of 64 points at most two may be beyond ten times their estimate."""
    points, duration = point_set(kind, system)
    true = atlas.label_points(system, points, duration=duration, method="rk8", tolerance=1e-13, rate_tolerance=1e-9,
                              cylinder_tolerance=1e-5)  # fmt: skip
    bound = SYSTEMS[system].frequency_bound(default_points(system, **points))
    for method in ("rk4", "rk8"):
        for check in ("none", "all"):
            ds = atlas.label_points(system, points, duration=duration, method=method, check_half_step=check)
            error = [np.abs(ds[name] - true[name]) / bound for name in RATES]
            error += [np.abs(ds[name] - true[name]) for name in ("theta_min", "theta_max")]
            ok = (ds.status.values == Status.OK) & (true.status.values == Status.OK)
            ratio = np.where(ok, np.fmax.reduce(error) / ds.error_estimate.values, 0.0)
            assert ok.sum() > 0.9 * COUNT
            assert (ratio > 10).sum() <= 2, worst_point(points, 3, ratio, ratio=ratio, duration=duration)
            limit = {"beside the vertical": 1e-4, "kicked off the vertical": 0.1}.get(kind, 1e-5)
            assert np.median(ds.error_estimate.values[ok]) < limit


@pytest.mark.usual("rk8-all")
@pytest.mark.parametrize("check", ["none", "all"])
@pytest.mark.parametrize("method", ["rk4", "rk8"])
def test_a_kick_from_the_vertical_has_a_small_estimate_and_blames_no_instability(method, check):
    """The commonest tip-off of a satellite: nothing is unstable. A top that leaves an unstable rotation is."""
    body = {"A": 1.0, "B": 1.3, "C": 1.7, "theta_dot0": 0.3, "m": 0.1, "theta0": [0.0, np.pi]}
    settings = {"method": method, "check_half_step": check}
    ds = atlas.label_points("satellite", body, duration=50.0, **settings)
    assert (ds.error_estimate < 1e-3).all()
    assert (ds.label == Label.DRIFTING).all()
    weak = atlas.label_points("satellite", body | {"theta_dot0": [1e-4, 0.3]}, duration=50.0, **settings)
    assert (weak.error_estimate > 0.01).any()
    top = {"A": 1.0, "B": 1.0, "C": 0.5, "Mg": 1.0, "z0": -0.5, "n": 0.0, "theta0": 1e-12, "m": [0.1, 0.2]}
    falls = atlas.label_points(
        "fixed_point", top, duration=60.0, tolerance=1e-3, method=method, variables=None
    )
    assert "instability" not in summary(ds) + summary(weak)
    for each, words in ((weak, "psi' of an axis"), (falls, "an instability has amplified")):
        each["error_estimate"] = each.error_estimate * 1e9
        assert words in summary(each)


@pytest.mark.parametrize("system", SYSTEMS)
def test_extremes_of_starts_at_rest_beside_the_vertical(system):
    """theta turns at the start, and may turn back before the next node."""
    rng = np.random.default_rng(5)
    points = {k: v for k, v in RANDOM[system](rng, 400).items() if not np.isnan(v).any()}
    points |= {"theta0": 10.0 ** rng.uniform(-4, -0.5, 400), "theta_dot0": np.zeros(400)}
    points["theta0"][::2] = np.pi - points["theta0"][::2]
    run = partial(atlas.label_points, system, points, duration=3.0, method="rk8")
    true, ds = run(step=2e-3), run(tolerance=1e-9)
    error = np.maximum(np.abs(ds.theta_min - true.theta_min), np.abs(ds.theta_max - true.theta_max))
    assert (ds.status == Status.OK).all()
    ratio = error / ds.error_estimate
    assert (ratio > 10).sum() <= 4, worst_point(points, 5, ratio, error=error, estimate=ds.error_estimate)


@pytest.mark.long
def test_extremes_of_a_constant_theta():
    """Rounding errors alone turn theta: turning points must not be sought outside the interval of two nodes."""
    rng = np.random.default_rng(0)
    points = default_points(
        "fixed_point", C=rng.uniform(0.2, 1.9, COUNT), Mg=rng.uniform(0.2, 2.0, COUNT), z0=1.0,
        theta0=rng.uniform(0.1, 3.0, COUNT), n=rng.uniform(-2.0, 2.0, COUNT), m=rng.uniform(-3.0, 3.0, COUNT),
    )  # fmt: skip
    points["l3"] = SYSTEMS["fixed_point"].families["conical"].solve["l3"](points)
    ds = atlas.label_points("fixed_point", points, duration=5.0, method="rk8")
    assert (ds.status == Status.OK).all()
    assert (ds.label == Label.REGULAR_PRECESSION).all()
    for extreme in (ds.theta_min, ds.theta_max):
        assert (np.abs(extreme - points["theta0"]) < ds.error_estimate).all()


@pytest.mark.parametrize("method", ["rk4", "rk8"])
def test_the_deviation_of_a_constant_nutation_rate_does_not_cancel(method):
    """A free sphere turns about the line of nodes at a constant rate; a weak weight lets it vary."""
    body = {"A": 1.0, "B": 1.0, "C": 1.0, "theta_dot0": 1.3, "theta0": np.array([1e-3, 0.02, 0.3, 0.9, 1.7])}
    free = atlas.label_points("fixed_point", body, duration=1.0, method=method)
    assert (free["theta_dot_std"] < 1e-15).all()
    weak = atlas.label_points("fixed_point", body | {"Mg": 1e-9, "z0": 1.0}, duration=1.0, method=method)
    # theta' = rate + acceleration of the weight along the straight motion
    t, weight = np.linspace(0.0, 1.0, 2001)[:, None], np.full((2001, 1), 1 / 2000)
    weight[[0, -1]] *= 0.5
    change = np.cos(body["theta0"] + 1.3 * t) - np.cos(body["theta0"])
    change = 1e-9 * change / 1.3
    deviation = np.sqrt((weight * (change - (weight * change).sum(0)) ** 2).sum(0))
    np.testing.assert_allclose(weak["theta_dot_std"], deviation, rtol=1e-5)
