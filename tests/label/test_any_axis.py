"""Labels about any axis: thresholds, verified cases, exact precessions, and what scenes do with them."""

import runpy
from pathlib import Path
from unittest.mock import Mock

import numpy as np
import pytest
import tomli_w
from hypothesis import assume, given
from hypothesis import strategies as st
from strategies import (
    SATELLITE_SOLVED,
    default_points,
    fixed_points_on_family,
    random_fixed_points,
    satellite_on_family,
    symmetric_fixed_points,
    tile_of,
)
from truth import assert_at_points, assert_shards_and_threads_agree, cases, columns_of

import atlas
from atlas import cli
from atlas.flags import Label, Status
from atlas.kernel import specialization
from atlas.label import pipeline, theory
from atlas.label.any_axis import predict_any_axis
from atlas.label.plan import Plan
from atlas.measure import circle as any_axis
from atlas.runs import refine
from atlas.scene.model import Settings
from atlas.systems import SYSTEMS
from atlas.variables import default_variables, variables

pytestmark = pytest.mark.usefixtures("whole_kernels")

CASES = cases("any_axis")  # all about a fixed point
VARIABLES = [
    "label",
    "label_any_axis",
    "status",
    "end_time",
    "error_estimate",
    *any_axis.AXIS_RATES,
    *any_axis.ANGLES,
]
NAMES = list(Label.meanings())


def labelled(system: str, points, duration=60.0, variables=VARIABLES, **options):
    """The points with these variables."""
    return atlas.label_points(system, points, duration=duration, variables=variables, **options)


def names(ds, variable: str = "label_any_axis") -> list[str]:
    return [NAMES[flag] for flag in ds[variable].values]


@pytest.mark.usual("rk4")
@pytest.mark.parametrize("method", ["rk4", "rk8"])
def test_verified_cases(method):
    ds = labelled("fixed_point", columns_of("fixed_point", CASES), method=method)
    assert names(ds) == [case["label"] for case in CASES]
    assert (ds.status == 1).all()
    rows = ds.to_dataframe().to_dict("records")
    for row, case in zip(rows, CASES, strict=True):
        near = {"rel": 0, "abs": 1e-6}
        for name in ("precession_rate", "nutation"):
            if name in case:
                assert row[name] == pytest.approx(case[name], **near), case["id"]
        if "spin_rate" in case:
            sign = -1 if case["id"] == "sphere_rotor" else 1  # given without a sign: about the opposite axis
            assert row["spin_rate"] == pytest.approx(sign * case["spin_rate"], **near)
        if "rate" in case:
            assert row["spin_rate"] == pytest.approx(case["rate"], **near)
            assert row["precession_rate"] == row["nutation"] == 0
        if "cos_inclination_to_vertical" in case:
            cosine = np.cos(row["precession_inclination"])
            assert cosine == pytest.approx(case["cos_inclination_to_vertical"], **near)
        if case["label"] == "drifting":
            assert all(np.isnan(row[name]) for name in (*any_axis.AXIS_RATES, *any_axis.ANGLES))


def test_grioli_s_motion_lasts():
    """Its label about the third axis is drifting; the run is whole all the same."""
    ds = labelled("fixed_point", columns_of("fixed_point", CASES[:2]), 200.0)
    assert names(ds) == 2 * ["regular_precession"]
    assert names(ds, "label") == 2 * ["drifting"]
    assert (ds.end_time == 200.0).all()
    np.testing.assert_allclose(ds.precession_rate, [case["precession_rate"] for case in CASES[:2]], rtol=1e-9)


def free_bodies(axis: int, count: int, seed: int = 0):
    """Random free bodies symmetric about a principal axis, with a rotor along it, in random rotation."""
    rng = np.random.default_rng(seed)
    inertia = np.ones((3, count))
    inertia[axis] = rng.uniform(0.3, 1.9, count)
    rotor = np.zeros((3, count))
    rotor[axis] = rng.normal(size=count)
    w, vertical = rng.normal(size=(2, 3, count))
    vertical /= np.linalg.norm(vertical, axis=0)
    start = {f"{name}0": w[i] for i, name in enumerate("pqr")}
    start |= {f"gamma{i + 1}0": vertical[i] for i in range(3)}
    body = dict(zip("ABC", inertia, strict=True)) | {f"l{i + 1}": rotor[i] for i in range(3)}
    momentum = inertia * w + rotor
    return {**body, **start, "Mg": np.zeros(count)}, inertia, rotor, w, vertical, momentum


@pytest.mark.parametrize("axis", range(3))
def test_free_symmetric_gyrostats(axis):
    """n = |G| / A about G, m = ((A - C) r - l) / A about the axis of symmetry, with A = 1."""
    points, inertia, rotor, w, vertical, momentum = free_bodies(axis, 20)
    ds = labelled("fixed_point", points, 30.0, rate_tolerance=1e-4)
    size = np.linalg.norm(momentum, axis=0)
    assert names(ds) == 20 * ["regular_precession"]
    assert "regular_precession" not in names(ds, "label")
    assert_at_points(ds.precession_rate, size, points, 0, rtol=1e-6)
    spin = (1 - inertia[axis]) * w[axis] - rotor[axis]
    assert_at_points(ds.spin_rate, spin, points, 0, rtol=1e-7, atol=1e-6)
    assert_at_points(ds.nutation, np.arccos(momentum[axis] / size), points, 0, rtol=1e-7, atol=1e-6)
    inclination = np.arccos((momentum * vertical).sum(0) / size)
    assert_at_points(ds.precession_inclination, inclination, points, 0, rtol=1e-7, atol=1e-6)
    for i in range(3):
        assert_at_points(ds[f"spin_axis_{i + 1}"], float(i == axis), points, 0, rtol=1e-7, atol=1e-6)


def test_short_and_tiny_arcs():
    """Nutations down to 1e-4 rad about the first axis, and parts of a circle of 0.05 rad that are no constant yet."""
    count = 24
    tilt = np.geomspace(1e-4, 1.0, count)
    points = {"A": 1.7, "B": 1.0, "C": 1.0, "Mg": 0.0, "p0": np.cos(tilt), "q0": 1.7 * np.sin(tilt), "r0": 0.0,
              "gamma10": 0.6, "gamma20": 0.0, "gamma30": 0.8}  # fmt: skip
    momentum = 1.7 * np.array([np.cos(tilt), np.sin(tilt)])
    for duration in (0.05 / 0.7, 1.0, 50.0):
        ds = labelled("fixed_point", points, duration)
        arc = 1.7 * np.sin(tilt) * min(0.7 * np.cos(tilt[0]) * duration, 1.0)
        long = arc / np.sqrt(12) > 2e-5
        assert long.sum() > 12
        assert (ds.label_any_axis[long] == Label.REGULAR_PRECESSION).all()
        assert (ds.label_any_axis != Label.DRIFTING).all()
        np.testing.assert_allclose(ds.spin_rate[long], (-0.7 * np.cos(tilt))[long], rtol=1e-6)
        np.testing.assert_allclose(
            ds.precession_rate[long], np.linalg.norm(momentum, axis=0)[long], rtol=1e-6
        )
        np.testing.assert_allclose(ds.nutation[long], tilt[long], rtol=1e-5)


def test_rotations_slower_than_the_tolerance_count_as_none():
    """Of a free body symmetric about its first axis: precession or spin of at most the rate tolerance."""
    spins = np.array([0.0, 0.9e-5, 1.1e-5, -0.9e-5, -1.1e-5])
    points = {"A": 2.0, "B": 1.0, "C": 1.0, "Mg": 0.0, "p0": 0.5, "q0": 0.5, "l1": -0.5 - spins, "gamma10": 0.6,
              "gamma20": 0.0, "gamma30": 0.8, "r0": 0.0}  # fmt: skip
    ds = labelled("fixed_point", points, 300.0)
    slow = ["permanent_rotation", "permanent_rotation", "regular_precession"]
    assert names(ds) == [*slow, *slow[1:]]
    np.testing.assert_allclose(ds.spin_rate[:1], np.hypot(0.5, 0.5))
    rest = labelled("fixed_point", {"Mg": 0.0, "theta0": 0.5})
    assert names(rest) == ["permanent_rotation"]
    assert rest.spin_rate == rest.precession_rate == 0
    assert np.isnan([rest[name][0] for name in any_axis.ANGLES]).all()


@pytest.mark.long
def test_a_spherical_satellite_precesses_in_inertial_space():
    """Nothing turns it, so that it precesses about its momentum; seen from the orbit the axis of that turns as well."""
    rng = np.random.default_rng(0)
    rotor = rng.normal(size=(3, 10))
    start = {"theta0": rng.uniform(0.4, 2.7, 10), "n": rng.normal(size=10), "m": rng.normal(size=10)}
    points = {
        "A": 1.0,
        "B": 1.0,
        "C": 1.0,
        "Omega": 0.7,
        **start,
        **{f"k{i + 1}": rotor[i] for i in range(3)},
    }
    ds = labelled("satellite", points, 40.0, [*VARIABLES, "label_inertial", "label_any_axis_inertial"])
    assert names(ds, "label_any_axis_inertial") == 10 * ["regular_precession"]
    assert names(ds, "label_inertial") == names(ds) == names(ds, "label") == 10 * ["drifting"]
    assert np.isnan(ds.precession_rate).all()
    # At rest in the orbital frame, it turns with the orbit.
    resting = labelled(
        "satellite", {"Omega": 0.7, "theta0": 0.0}, 40.0, ["label_any_axis", "label_any_axis_inertial"]
    )
    assert names(resting) == names(resting, "label_any_axis_inertial") == ["permanent_rotation"]


@pytest.mark.long
@given(st.sampled_from(sorted(SATELLITE_SOLVED)), st.integers(0, 10**6))
def test_steady_motions_of_the_satellite_are_steady_by_their_circle(name, seed):
    """The circle alone, without the rule that a steady label stays."""
    point = satellite_on_family(name, np.random.default_rng(seed))
    assume(point is not None)
    with pytest.MonkeyPatch.context() as patched:
        patched.setattr(any_axis, "is_steady", lambda label: np.zeros(label.shape, bool))
        ds = labelled(
            "satellite", point, 3.0, ["label", "label_any_axis", "label_any_axis_inertial"], tolerance=1e-6
        )
    assume(ds.label in (Label.REGULAR_PRECESSION, Label.PERMANENT_ROTATION))
    assert names(ds) == names(ds, "label")


def test_precessions_about_the_vertical_have_the_same_rates_by_their_circle():
    points = symmetric_fixed_points(np.random.default_rng(0), 40)
    points = fixed_points_on_family("conical", points, "l3")
    own = labelled("fixed_point", points, 5.0, [*VARIABLES, "phi_dot_mean"])
    ok = ((own.status == Status.OK) & (own.label == Label.REGULAR_PRECESSION)).values
    assert ok.sum() > 10
    assert_at_points(own.label, own.label_any_axis, points, 0)
    assert_at_points(own.spin_rate, own.phi_dot_mean, points, 0, where=ok)
    assert np.isin(own.precession_inclination[ok], (0.0, np.pi)).all()
    with pytest.MonkeyPatch.context() as patched:
        patched.setattr(
            any_axis,
            "label_of_third_axis",
            lambda measured, *_: np.full(measured["theta_min"].shape, Label.DRIFTING, np.int8),
        )
        by_circle = labelled("fixed_point", points, 5.0)
    for name in (*any_axis.AXIS_RATES, *any_axis.ANGLES):
        assert_at_points(by_circle[name], own[name], points, 0, where=ok, rtol=1e-7, atol=1e-9)


def test_estimates_cover_the_errors():
    """Of rates, axes and angles; of 60 precessions at most one may be beyond ten times its estimate."""
    count = 60
    points, inertia, rotor, w, vertical, momentum = free_bodies(0, count, seed=5)
    duration = np.random.default_rng(1).uniform(0.5, 30.0, count)
    size = np.linalg.norm(momentum, axis=0)
    exact = {"precession_rate": size, "spin_rate": (1 - inertia[0]) * w[0] - rotor[0],
             "nutation": np.arccos(momentum[0] / size), "spin_axis_1": 1.0, "spin_axis_2": 0.0, "spin_axis_3": 0.0,
             "precession_inclination": np.arccos((momentum * vertical).sum(0) / size)}  # fmt: skip
    bound = SYSTEMS["fixed_point"].frequency_bound(default_points("fixed_point", count, **points))
    for method in ("rk4", "rk8"):
        for check in ("none", "all"):
            ds = labelled(
                "fixed_point", points, duration, method=method, check_half_step=check, tolerance=1e-5
            )
            ok = (ds.label_any_axis == Label.REGULAR_PRECESSION).values
            assert ok.sum() > 0.9 * count
            unit = {name: bound if name in any_axis.AXIS_RATES else 1.0 for name in exact}
            error = np.fmax.reduce([np.abs(ds[name] - exact[name]) / unit[name] for name in exact])
            ratio = (error / ds.error_estimate.values)[ok]
            assert (ratio > 10).sum() <= 1


def free_scene(variables, **sections):
    """Text of a scene of 9 x 9 free bodies, symmetric about the first axis where C is 1, and as many in a field.

    Those in the field have every term of the equations, so that the kernel is the one of the other tests.
    """
    body = {"A": 1.6, "B": 1.0, "q0": 0.3, "r0": 0.0, "gamma10": 0.6, "gamma20": 0.0, "gamma30": 0.8}
    axes = {
        "C": {"from": 0.8, "to": 1.2, "count": 9},
        "p0": {"from": -0.4, "to": 0.4, "count": 9},
        "N": {"values": [0.0, 0.1]},
    }
    return tomli_w.dumps(
        {
            "schema": 1, "system": "fixed_point", "fixed": body, "axes": axes,
            "ties": dict.fromkeys(("Mg", "x0", "y0", "z0", "l1", "l2", "l3"), "N"),
            "integration": {"duration": 20.0, "tolerance": 1e-6}, "outputs": {"variables": list(variables)}, **sections,
        }
    )  # fmt: skip


def test_other_variables_are_the_same_to_the_bit_without_it():
    plain_names = ("label", "status", "theta_dot_rms", "theta_max", "psi_dot_mean")
    plain = atlas.run(atlas.load_scene(free_scene(plain_names)), progress=False)
    both = atlas.run(
        atlas.load_scene(free_scene((*plain_names, "label_any_axis", "nutation"))), progress=False
    )
    for name in plain_names:
        np.testing.assert_array_equal(plain[name], both[name])
    assert plain.attrs["atlas_kernel_hash"] != both.attrs["atlas_kernel_hash"]
    free = both.sel(N=0.0)
    assert (free.label_any_axis.sel(C=1.0, method="nearest") != Label.DRIFTING).all()
    assert (free.label_any_axis.sel(C=0.8) == Label.DRIFTING).any()
    np.testing.assert_array_equal(np.isnan(both.nutation), both.label_any_axis == Label.DRIFTING)


def test_only_scenes_that_ask_for_it_have_it():
    for system in SYSTEMS.values():
        assert not set(any_axis.ANY_AXIS) & set(default_variables(system))
        assert not Plan(system, Settings(), default_variables(system)).plugs
        assert Plan(system, Settings(), ["nutation"]).plugs == any_axis.CIRCLES[:1]
    assert Plan(SYSTEMS["satellite"], Settings(), ["label_any_axis_inertial"]).plugs == any_axis.CIRCLES
    outside = {name for name in any_axis.ANY_AXIS if name in variables(SYSTEMS["fixed_point"])}
    assert outside == set(any_axis.ANY_AXIS) - {"label_any_axis_inertial"}


def test_run_folders_shards_and_threads_give_the_same(tmp_path):
    scene = atlas.load_scene(free_scene(["label_any_axis", *any_axis.AXIS_RATES, "error_estimate"]))
    assert_shards_and_threads_agree(scene, tmp_path)


@pytest.mark.long
def test_refinement_follows_it(tmp_path, capsys):
    """Its borders are traced though `label` has none, and the cost is estimated without knowing where they are."""
    text = free_scene(["label", "label_any_axis", "nutation"], refine={"levels": 2, "probe": 0.0})
    refined = atlas.run(atlas.load_scene(text), progress=False)
    whole = atlas.run(
        atlas.load_scene(free_scene(["label_any_axis"], refine={"levels": 2, "probe": 1.0})), progress=False
    )
    np.testing.assert_array_equal(refined.label_any_axis, whole.label_any_axis)
    assert 0 < refined.attrs["atlas_computed_share"] < 1
    assert (refined.label == Label.DRIFTING).all()
    (tmp_path / "scene.toml").write_text(text)
    assert cli.main(["run", str(tmp_path / "scene.toml"), "--dry-run"]) == 0
    assert "points" in capsys.readouterr().out


def test_every_flag_together_fits_into_the_codes_of_refinement():
    names = [
        "label",
        "label_inertial",
        "label_any_axis",
        "label_any_axis_inertial",
        "geometry",
        "status",
        "regularity",
    ]
    counts = [len(variables(SYSTEMS["satellite"])[name].flags) for name in names]
    flags = {name: np.array([0, count - 1], np.int8) for name, count in zip(names, counts, strict=True)}
    decoded = refine._decode(refine._encode(list(flags.values()), counts), counts)
    for name, values in zip(names, decoded, strict=True):
        np.testing.assert_array_equal(values, flags[name])


def test_the_error_of_an_unstable_exact_start_is_bounded():
    """A sleeping top whose instability multiplies errors by e^50 in the run."""
    points = {"A": 1.0, "B": 1.0, "C": 0.5, "Mg": 1.0, "z0": -1.0, "theta0": 0.0, "m": 0.1}
    ds = labelled("fixed_point", points, 60.0, [*VARIABLES, "growth_rate"])
    assert names(ds) == ["permanent_rotation"]
    assert ds.growth_rate * 60 > 50
    assert ds.error_estimate < 1.001


@pytest.mark.long
def test_a_system_in_euler_angles(monkeypatch, own_systems):
    """A free symmetric top whose angular velocity is no linear function of its state."""
    path = Path(__file__).parents[2] / "docs/examples/heavy_top_euler/heavy_top_euler.py"
    kernels = Mock(wraps=specialization.kernel)
    monkeypatch.setattr(specialization, "kernel", kernels)
    atlas.register(runpy.run_path(str(path))["HeavyTopEuler"])
    C, theta, n, m = np.array([0.5, 1.6]), 0.8, 0.7, np.array([1.1, -0.9])
    points = {"A": 1.0, "C": C, "theta0": theta, "n": n, "m": m}
    ds = labelled("heavy_top_euler", points, 30.0)
    # its frequency bound needs no kernel of its own
    assert {call.args[3] for call in kernels.call_args_list} == {any_axis.CIRCLES[:1]}
    spin = m + n * np.cos(theta)
    momentum = np.hypot(n * np.sin(theta), C * spin)
    assert names(ds, "label") == 2 * ["drifting"]
    assert names(ds) == 2 * ["regular_precession"]
    np.testing.assert_allclose(ds.precession_rate, momentum, rtol=1e-7)
    np.testing.assert_allclose(ds.spin_rate, (1 - C) * spin, rtol=1e-7)
    np.testing.assert_allclose(ds.nutation, np.arccos(C * spin / momentum), rtol=1e-7)


def test_a_nudge_along_free_rotations_leads_to_another_and_one_across_does_not():
    """About the middle axis of inertia, which is unstable: a turn of the vertical, and a turn of the body."""
    given = {"A": 1.0, "B": 1.3, "C": 1.7, "p0": 0.0, "q0": 0.9, "r0": 0.0, "gamma20": 0.0}
    base = default_points("fixed_point", gamma10=[0.6, 0.6], gamma30=0.8, **given)
    nudged = base | {
        "gamma10": np.array([0.8, 0.6]),
        "gamma30": np.array([0.6, 0.8]),
        "p0": np.array([0.0, 1e-4]),
    }
    system = SYSTEMS["fixed_point"]
    settings = Settings(rate_tolerance=1e-3, tolerance=1e-6)
    plan, tile = (
        Plan(system, settings, ["label_any_axis"], nudged=True),
        tile_of(system, base, nudged, np.full(2, 300.0), settings),
    )
    prediction = theory.predict_runs(plan, tile)
    assert prediction.about_other_axes.all()
    assert prediction.pushed.tolist() == [False, True]
    # m^2 = q0^2 (C - B)(B - A) / (A C)
    np.testing.assert_allclose(prediction.log_growth, 300.0 * 0.9 * np.sqrt(0.4 * 0.3 / 1.7), rtol=1e-6)
    about_any = predict_any_axis(plan, tile, prediction)
    assert list(about_any["predicted_any_axis"]) == [Label.PERMANENT_ROTATION, Label.DRIFTING]
    columns = pipeline.evaluate(plan, tile)
    # The first is left to rounding, the growth of the second is that of its nudge.
    assert list(columns["status"]) == [Status.ROUNDOFF_DECIDED, Status.OK]
    assert list(columns["label_any_axis"]) == [Label.UNRESOLVED, Label.DRIFTING]


def test_no_prediction_about_any_axes_contradicts_a_label():
    """Slow bodies, which are near motions about axes of which no family knows, and spheres in short runs."""
    rng, count = np.random.default_rng(41), 150
    sphere, slow = np.arange(count) < 30, 10 ** rng.uniform(-6, -1, count)
    points = random_fixed_points(rng, count)
    points |= {name: points[name] * slow for name in ("n", "m", "theta_dot0", "l1", "l2", "l3")}
    points |= {name: points[name] * np.where(sphere, 0.0, slow**2) for name in ("Mg", "N")}
    points |= {name: np.where(sphere, 0.7, points[name]) for name in "ABC"}
    names = ["label_any_axis", "predicted_any_axis", "status"]
    duration = np.minimum(
        10 ** rng.uniform(-0.5, 2.3, count), 1e3 / SYSTEMS["fixed_point"].frequency_bound(points)
    )
    ds = labelled("fixed_point", points, duration, names, method="rk8", rate_tolerance=1e-5)
    decided = (ds.status.values == Status.OK) & (ds.predicted_any_axis.values != Label.NOT_COMPUTED)
    assert_at_points(ds.predicted_any_axis, ds.label_any_axis, points, 41, where=decided, duration=duration)
    predicted = ds.predicted_any_axis.values[decided]
    assert (np.bincount(predicted)[1:] > 9).all()


@pytest.mark.parametrize("duration", [60.0, 0.2])
def test_starts_far_from_every_circle(duration):
    """A free body: predicted to drift where Euler's equations take it ten tolerances from rest and from a circle, in a radian at most."""
    inertia, tolerance = np.array([1.0, 1.3, 1.7]), 1e-5
    size = np.geomspace(1e-3, 0.3, 120)
    w = np.stack([size, 2 * size, np.ones(120)], -1)
    names = ("p0", "q0", "r0", "gamma10", "gamma20", "gamma30")
    values = (*w.T, *np.full((3, 120), [[0.6], [0.0], [0.8]]))
    points = {"A": 1.0, "B": 1.3, "C": 1.7, "Mg": 0.0} | dict(zip(names, values, strict=True))
    ds = labelled("fixed_point", points, duration, ["predicted_any_axis"], rate_tolerance=tolerance)
    # Derivatives of I w' = I w x w.
    first = np.cross(inertia * w, w) / inertia
    second = (np.cross(inertia * first, w) + np.cross(inertia * w, first)) / inertia
    third = (
        np.cross(inertia * second, w) + 2 * np.cross(inertia * first, first) + np.cross(inertia * w, second)
    )
    bound = SYSTEMS["fixed_point"].frequency_bound(default_points("fixed_point", **points))
    time, speed, turn = np.minimum(1 / bound, duration), *(np.linalg.norm(v, axis=1) for v in (first, second))
    centripetal = third / inertia + (turn / speed)[:, None] ** 2 * first
    leaves_rest = speed * time + turn * time**2 / 2
    off_circle = np.maximum(
        np.abs((first * second).sum(1)) / speed * time**2 / 2,
        np.linalg.norm(centripetal, axis=1) * time**3 / 6,
    )
    distance = np.minimum(leaves_rest, off_circle) / tolerance
    expected = np.where(distance > 10, Label.DRIFTING, Label.NOT_COMPUTED)
    assert ((distance > 9) & (distance < 11)).sum() > 3
    assert_at_points(ds.predicted_any_axis, expected, {"w": w.T}, None, distance=distance)


@pytest.mark.long
def test_spin_rates_that_rounding_hides_have_no_prediction():
    """A spin of 2e6 and a weight: across the axis of a rate of 8 the torque changes the spin rate by 0.03."""
    point = {
        "A": 1.0, "B": 1.0, "C": 1.375, "Mg": 0.438, "z0": -0.578, "N": -0.801, "l3": 0.232, "theta0": 0.765,
        "phi0": 0.421, "theta_dot0": -4e-4, "n": 11.923, "m": -2474527.943,
    }  # fmt: skip
    for tolerance in (1e-6, 1e-5, 1e-3):
        ds = atlas.label_points(
            "fixed_point", point, duration=1e-3, rate_tolerance=tolerance, cylinder_tolerance=tolerance,
            method="rk8", variables=["label_any_axis", "predicted_any_axis", "status"],
        )  # fmt: skip
        assert (ds.status == Status.OK).all()
        assert (ds.label_any_axis == Label.DRIFTING).all()
        assert (ds.predicted_any_axis == Label.NOT_COMPUTED).all()
