"""Regular or chaotic: verified cases, integrable motions, steady motions, and what a scene does with it."""

import json
from collections.abc import Sequence

import numpy as np
import pytest
import tomli_w
from strategies import default_points
from truth import REFERENCE, assert_shards_and_threads_agree, columns_of

import atlas
from atlas import cli
from atlas.flags import Regularity
from atlas.measure.chaos import Chaos
from atlas.systems import SYSTEMS
from atlas.variables import default_variables

pytestmark = pytest.mark.usefixtures("whole_kernels")

VARIABLES = ["label", "status", "megno", "lyapunov", "regularity"]
CASES = json.loads((REFERENCE / "chaos_cases.json").read_text())


def labelled(system: str, points, duration, variables: Sequence[str] = VARIABLES, **options):
    """The points with these variables."""
    return atlas.label_points(system, points, duration=duration, variables=variables, **options)


def cases_of(system: str, *classes: str):
    """Verified cases of a system, and their points as columns."""
    cases = [case for case in CASES["cases"] if case["system"] == system and case["class"] in classes]
    if not cases:
        pytest.skip(f"there are no cases of the system {system}")
    return cases, columns_of(system, [case["points"] for case in cases])


def column(cases, key, i=None):
    return np.array([case[key] if i is None else case[key][i] for case in cases])


@pytest.mark.long
@pytest.mark.parametrize("system", SYSTEMS)
def test_verified_regular_and_chaotic_motions(system):
    cases, points = cases_of(system, "regular", "chaotic", "unstable_periodic")
    # Of the states; tangent vectors have a method of their own.
    method = "rk4" if system == "fixed_point" else "rk8"
    for i, duration in enumerate((500.0, 2000.0)):
        ds = labelled(system, points, duration, method=method)
        assert (ds.status == 1).all()
        assert (column(cases, "T", i) == duration).all()
        kind, known = column(cases, "class"), column(cases, "class_at", i)
        regular = (kind == "regular") & (known == "regular")
        steady = np.isin(ds.label, (1, 2))
        expected = np.where(steady, Regularity.STEADY, Regularity.REGULAR)
        np.testing.assert_array_equal(ds.regularity[regular], expected[regular])
        np.testing.assert_allclose(ds.megno[regular], column(cases, "megno", i)[regular], rtol=0, atol=0.05)
        np.testing.assert_allclose(
            ds.lyapunov[regular] * duration,
            (column(cases, "lyapunov", i) * duration)[regular],
            rtol=0,
            atol=0.1,
        )
        chaotic = (kind == "chaotic") & (known == "chaotic")
        assert chaotic.sum() > 10
        assert (ds.regularity[chaotic] == Regularity.CHAOTIC).all()
        low, high = np.array([case["lyapunov_range"][i] for case in cases]).T
        assert (ds.lyapunov[chaotic] > 0.5 * low[chaotic]).all()
        assert (ds.lyapunov[chaotic] < 2 * high[chaotic]).all()
        periodic = kind == "unstable_periodic"
        if system == "fixed_point":  # where theory has no motions in a plane
            assert (ds.regularity[periodic] == Regularity.CHAOTIC).all()
        if duration == 2000:
            exponents = [case["floquet_exponent"] for case in cases if case["class"] == "unstable_periodic"]
            np.testing.assert_allclose(ds.lyapunov[periodic], exponents, rtol=0, atol=2e-3)


@pytest.mark.parametrize("system", SYSTEMS)
def test_unstable_steady_motions_separate_at_their_growth_rate(system):
    cases, points = cases_of(system, "unstable_steady")
    growth = []
    for i in range(2):
        ds = labelled(system, points, column(cases, "T", i))
        growth.append(ds.lyapunov.values * column(cases, "T", i))
    assert (ds.regularity == Regularity.HYPERBOLIC).all()
    measured = (growth[1] - growth[0]) / (column(cases, "T", 1) - column(cases, "T", 0))
    np.testing.assert_allclose(measured, column(cases, "growth_measured"), rtol=1e-6)


@pytest.mark.long
def test_planar_oscillations_are_unstable_in_tongues():
    a, amplitude, exponent = np.array(CASES["planar_map"]).T
    points = {"A": a, "B": 1.0, "C": 1.0, "psi0": amplitude, "theta0": 0.0}
    settings = {"method": "rk8", "tolerance": 1e-4, "rate_tolerance": 1e-2}
    growth = [
        labelled("satellite", points, t, ["lyapunov"], **settings).lyapunov * t for t in (1000.0, 2000.0)
    ]
    clear = (exponent > 0.005) | (exponent < 0.002)
    measured = (growth[1] - growth[0]) / 1000
    np.testing.assert_array_equal(measured[clear] > 0.0035, exponent[clear] > 0.005)


def integrable(name: str, count: int, seed: int = 0):
    """Random bodies about a fixed point whose motion is integrable."""
    rng = np.random.default_rng(seed)
    points = {"theta0": rng.uniform(0.2, 2.9, count), "phi0": rng.uniform(0, 2 * np.pi, count)}
    points |= {rate: rng.normal(size=count) for rate in ("n", "m", "theta_dot0")}
    parts = rng.uniform(0.3, 1.0, (3, count))
    points |= dict(zip("ABC", parts.sum(0) - parts, strict=True))
    if name == "Joukovsky":
        points |= {rotor: rng.normal(size=count) for rotor in ("l1", "l2", "l3")}
    elif name == "Clebsch":
        points |= {"N": rng.normal(size=count)}
    elif name == "Lagrange":
        points |= {"B": points["A"], "C": points["A"] * rng.uniform(0.3, 1.9, count), "Mg": 1.0}
        points |= {"z0": rng.normal(size=count), "l3": rng.normal(size=count)}
    elif name == "Kovalevskaya":
        points |= {"A": 2.0, "B": 2.0, "C": 1.0, "Mg": 1.0}
        points |= {"x0": rng.normal(size=count), "l3": rng.normal(size=count)}
    return default_points("fixed_point", count, **points)


def test_no_integrable_motion_is_chaotic():
    names = ("Euler", "Joukovsky", "Clebsch", "Lagrange", "Kovalevskaya")
    bodies = [integrable(name, 40) for name in names]
    points = {name: np.concatenate([body[name] for body in bodies]) for name in bodies[0]}
    ds = labelled("fixed_point", points, 300.0)
    assert (ds.status == 1).all()
    assert not (ds.regularity == Regularity.CHAOTIC).any()


def beside_separatrices(count: int):
    """Free bodies about nearly their middle axis, slow and fast, and tops that spin or swing to nearly upright."""
    rng = np.random.default_rng(1)
    offset = 10 ** rng.uniform(-12, -6, (3, count))
    one, kind = np.ones(count), np.arange(count) % 4
    vertical = np.array([0.6, 0.0, 0.8])[:, None] * one
    upright = np.array([offset[0], offset[1], -np.sqrt(1 - offset[0] ** 2 - offset[1] ** 2)])
    gamma = np.where(kind < 2, vertical, upright)
    points = {"B": np.choose(kind, [1.5, 1.001, 1.0, 1.0]), "C": np.choose(kind, [2.0, 1.9, 0.7, 1.0])}
    points |= {"A": 1.0, "p0": offset[0], "q0": np.where(kind < 2, 1.0, offset[1])}
    points |= {
        "r0": np.choose(kind, [offset[2], offset[2], 0.9, 0.0]),
        "Mg": np.where(kind < 2, 0.0, 1.0),
        "z0": 1.0,
    }
    points |= dict(zip(("gamma10", "gamma20", "gamma30"), gamma, strict=True))
    return default_points("fixed_point", count, **points)


def test_what_passes_an_unstable_motion_is_not_called_chaotic():
    """In 80-bit arithmetic the first body has the MEGNO 1.68; rounding errors make it 8.65."""
    points = beside_separatrices(64)
    for name, value in {"p0": 1e-8, "q0": 1.0, "r0": 5e-9}.items():
        points[name][0] = value
    ds = labelled("fixed_point", points, np.tile([2000.0, 500.0, 60.0, 60.0], 16))
    ok = ds.status.values == 1
    assert ok.mean() > 0.9
    assert not (ds.regularity == Regularity.CHAOTIC).any()
    assert not (ds.megno > 5).any()
    examined = np.isnan(ds.megno.values) & ok
    np.testing.assert_array_equal(np.isnan(ds.lyapunov) & ok, examined)
    assert np.isin(ds.regularity[examined], (Regularity.REGULAR, Regularity.UNDECIDED)).all()
    assert examined[0]
    assert ds.regularity[0] == Regularity.UNDECIDED
    assert (examined.reshape(-1, 4).sum(0) > 3).all()


def test_starts_on_unstable_rotations_are_hyperbolic():
    """About an axis that `label` does not describe, whatever variables are asked for."""
    free = {"A": 1.0, "B": 1.5, "C": 2.0, "Mg": 0.0, "gamma10": 0.6, "gamma20": 0.0, "gamma30": 0.8}
    free |= {"p0": [0.0, 1e-9, 1.0], "q0": [1.0, 1.0, 0.0], "r0": 0.0}
    for variables in (["regularity"], [*VARIABLES, "family", "stable"]):
        ds = labelled("fixed_point", free, 200.0, variables)
        expected = [Regularity[name] for name in ("HYPERBOLIC", "UNDECIDED", "REGULAR")]
        np.testing.assert_array_equal(ds.regularity, expected)


def scene_of(duration="100 orbits", variables=("label", "megno", "regularity"), **integration):
    """Text of a scene of 6 x 5 satellites that librate and tumble."""
    return tomli_w.dumps(
        {
            "schema": 1,
            "system": "satellite",
            "fixed": {"A": 1.0, "B": 1.3, "C": 1.6, "theta0": 0.1},
            "axes": {"psi0": {"from": 0.1, "to": 1.4, "count": 6}, "m": {"from": 0.0, "to": 0.5, "count": 5}},
            "integration": {"duration": duration} | (integration or {"tolerance": 1e-6}),
            "outputs": {"variables": list(variables)},
        }
    )


@pytest.mark.long
def test_other_variables_are_the_same_to_the_bit_without_it():
    names = ("label", "status", "theta_dot_rms", "theta_max", "error_estimate")
    plain = atlas.run(atlas.load_scene(scene_of(variables=names)), progress=False)
    chaos = [variable.name for variable in Chaos().variables(SYSTEMS["satellite"])]
    both = atlas.run(atlas.load_scene(scene_of(variables=(*names, *chaos))), progress=False)
    for name in names:
        np.testing.assert_array_equal(plain[name], both[name])
    assert both.attrs["atlas_kernel_hash"].startswith(plain.attrs["atlas_kernel_hash"] + "-")
    assert len(np.unique(both.regularity)) > 1


def test_only_scenes_that_ask_for_it_have_it():
    for system in SYSTEMS.values():
        assert not Chaos().wanted(system, default_variables(system))


def test_run_folders_shards_and_threads_give_the_same(tmp_path):
    scene = atlas.load_scene(scene_of())
    assert_shards_and_threads_agree(scene, tmp_path)


def test_coarse_steps_fake_no_chaos():
    """A step that resolves the labels may be too long for the indicators: no label then."""
    points = {"A": 1.0, "B": 1.3, "C": 1.6, "psi0": np.linspace(0.5, 1.4, 4), "theta0": 0.1}
    settings = {"step": 0.15, "method": "rk8"}
    ds = labelled("satellite", points, 100.0, **settings)
    assert (ds.regularity == 0).all()
    assert np.isnan(ds.megno).all()
    assert (ds.label == 4).all()
    assert (ds.status == 4).all()
    assert (labelled("satellite", points, 100.0, ["label"], **settings).label == 3).all()


def test_check_warns_of_runs_that_are_too_short(tmp_path, capsys):
    for duration, words in (("20 orbits", "4 times as long"), ("80 orbits", None)):
        (tmp_path / "scene.toml").write_text(scene_of(duration))
        assert cli.main(["check", str(tmp_path / "scene.toml")]) == 0
        output = capsys.readouterr().out
        assert ("too short" in output) == (words is not None)
        assert words is None or words in output


@pytest.mark.long
def test_refinement_follows_regularity():
    text = scene_of() + "\n[refine]\nlevels = 1\nprobe = 1.0\n"
    refined = atlas.run(atlas.load_scene(text), progress=False)
    assert "regularity" in refined
    computed = refined.computed == 1
    assert (refined.regularity.where(computed, 1) > 0).all()
