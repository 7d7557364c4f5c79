"""Random numbers in ties: the same whatever the order of the points, and as evenly distributed as they should be."""

import numpy as np
import pytest
from scipy import stats

import atlas
from atlas import load_scene
from atlas.scene import draws, grid
from atlas.scene.expressions import Expression

DRAW = {"from": 1, "to": 400, "count": 400}


def splitmix64(state):
    """The next number of the generator, in whole numbers of Python."""
    state = (state + 0x9E3779B97F4A7C15) % 2**64
    state = (state ^ (state >> 30)) * 0xBF58476D1CE4E5B9 % 2**64
    state = (state ^ (state >> 27)) * 0x94D049BB133111EB % 2**64
    return state ^ (state >> 31)


def test_bits_are_those_of_splitmix64():
    """The first numbers of the published generator with the seed 0, and others by another program."""
    golden = 0x9E3779B97F4A7C15
    assert splitmix64(0) == 0xE220A8397B1DCDAF
    assert splitmix64(golden) == 0x6E789E6AA1B965F4
    counters = np.array([0, 1, 2, 12345, 2**63], np.uint64)
    expected = [splitmix64(int(c) * golden % 2**64) for c in counters]
    assert [int(bits) for bits in draws.mixed(counters)] == expected


def value(text, seed=0, key="ties.C", **values):
    return Expression(key, text, seed).value({name: np.asarray(v, float) for name, v in values.items()})


@pytest.mark.parametrize("spacing", [1.0, 1e-3, 1e6])
def test_draws_are_distributed_and_independent(spacing):
    """Of one tie along an axis, of two ties, of two places in a tie and of two seeds; 4 deviations are rare by chance."""
    draw = spacing * np.arange(1, 20_001)
    z = value("normal(draw)", draw=draw)
    assert stats.kstest(z, "norm").pvalue > 1e-3
    assert stats.kstest(value("uniform(draw)", draw=draw), "uniform").pvalue > 1e-3
    others = [
        value("normal(draw)", seed=1, draw=draw),
        value("normal(draw)", key="ties.B", draw=draw),
        value("normal(draw) - normal(draw)", draw=draw),
        value("normal(draw, 1)", draw=draw),
        np.roll(z, 1),
    ]
    deviations = [np.std(other) for other in others]
    np.testing.assert_allclose(deviations, [1, 1, 2**0.5, 1, 1], rtol=0.03)
    for i, correlation in enumerate(np.corrcoef([z, *others])[0, 1:]):
        expected = 0.5**0.5 if i == 2 else 0.0
        assert abs(correlation - expected) < 4 / draw.size**0.5


@pytest.mark.parametrize("exponent", [2.0, 0.5, -1.0, 3.0])
def test_a_tie_has_the_bits_of_arrays_where_a_parameter_is_its_exponent(exponent, scene_text):
    """NumPy rounds powers otherwise where a single number in memory is the exponent of all points."""
    scene = load_scene(scene_text({"fixed.m": exponent, "ties.C": "sigma ** m"}))
    values = grid.parameter_values(scene, np.arange(scene.size))
    expected = np.power(values["sigma"], np.full(scene.size, exponent))
    assert values["C"].tobytes() == expected.tobytes()


def test_numbers_depend_on_the_seed_the_tie_and_the_values_alone(scene_text):
    changes = {
        "ties.C": "sigma + 0.01 * normal(draw)",
        "ties.B": "1 + 0 * normal(draw) - 0.01 * normal(draw)",
    }
    scene = load_scene(scene_text({"axes.draw": DRAW, **changes}))
    every = np.arange(scene.size)
    whole = grid.parameter_values(scene, every)
    mixed = np.random.default_rng(0).permutation(every)[:1000]
    some = grid.parameter_values(scene, mixed)
    for name in ("B", "C"):
        assert (some[name] == whole[name][mixed]).all()
    c = whole["C"].reshape(scene.shape) - scene.axes["sigma"].values[:, None, None]
    # Every cell has the same draws.
    np.testing.assert_allclose(c, np.broadcast_to(c[:1, :1], c.shape), atol=1e-15)
    assert abs(np.corrcoef(c[0, 0], whole["B"].reshape(scene.shape)[0, 0])[0, 1]) < 0.2
    own = load_scene(scene_text({"axes.draw": DRAW, "ties.C": "sigma + 0.01 * normal(draw, sigma)"}))
    c = (
        grid.parameter_values(own, every)["C"].reshape(scene.shape)
        - scene.axes["sigma"].values[:, None, None]
    )
    assert abs(np.corrcoef(c[0, 0], c[1, 0])[0, 1]) < 0.2
    seeded = load_scene(scene_text({"axes.draw": DRAW, **changes, "seed": 7}))
    assert load_scene(seeded.toml()).seed == 7
    assert (grid.parameter_values(seeded, every)["C"] != whole["C"]).all()
    assert "seed" not in scene.toml()


def test_draws_of_no_number_are_none():
    u = value("uniform(draw)", draw=[0.0, -0.0, np.nan, np.inf])
    assert u[0] == u[1]
    assert np.isnan(u[2:]).all()


@pytest.mark.long
@pytest.mark.usefixtures("whole_kernels")
def test_probability_at_a_straight_border_is_that_of_the_normal_distribution(scene_text):
    """The axis along the velocity is stable iff C > A (17), and no body has C > A + B = 2: P = Phi(distance / sigma)."""
    spread, sigma = 0.05, [0.9, 0.95, 0.98, 1.0, 1.02, 1.05, 1.1, 1.95, 2.0, 2.03]
    scene = scene_text({
        "axes.sigma": {"values": sigma},
        "axes.theta0": {"values": [0.7]},
        "axes.draw": DRAW,
        "ties.C": f"sigma + {spread} * normal(draw)",
        "ties.psi0": "0 * A",
        "family.name": "perp_radius",
        "integration.duration": 0.5,
        "outputs": {"variables": ["stable", "status"]},
    })  # fmt: skip
    ds = atlas.run(load_scene(scene), progress=False)
    sigma = np.array(sigma)
    z = value("normal(draw)", draw=np.arange(1, 401))
    C = sigma[:, None] + spread * z
    stable = ds.atlas.probability("stable", over="draw").squeeze()
    np.testing.assert_array_equal(stable.probability.sel(stable="stable"), ((C > 1) & (C <= 2)).mean(1))
    status = ds.atlas.probability("status", over="draw").squeeze()
    for of_flag, distance in (
        (stable.sel(stable="stable"), np.where(sigma < 1.5, sigma - 1, 2 - sigma)),
        (status.sel(status="impossible_body"), sigma - 2),
    ):
        expected = stats.norm.cdf(distance / spread)
        deviation = np.sqrt(expected * (1 - expected) / 400) + 1e-12
        assert (np.abs(of_flag.probability - expected) < 3 * deviation + 1e-3).all()
        assert (of_flag.lower <= of_flag.probability).all()
        assert (of_flag.probability <= of_flag.upper).all()
    assert (stable.probability.sum("stable") == 1).all()
    assert status.attrs["atlas_draws"] == 400
