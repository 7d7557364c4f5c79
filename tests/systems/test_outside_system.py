"""A system written outside the package, of required members only: no line inside the package is about it."""

from types import SimpleNamespace

import heavy_top_equations as equations
import numpy as np
import pytest
import xarray as xr
from plugins import registry
from scipy.integrate import solve_ivp

import atlas
from atlas import cli, systems
from atlas.flags import Agreement, Label, Status
from atlas.kernel import numeric_bound
from atlas.kernel.tableaux import METHODS
from atlas.systems.base import Condition, Family, Parameter, System
from atlas.variables import variables

pytestmark = pytest.mark.usefixtures("whole_kernels", "short_timings")


class HeavyTop(System):
    """Symmetric top about a fixed point in uniform gravity."""

    name = "heavy_top"
    title = "symmetric heavy top"
    equations = equations
    parameters = {  # noqa: RUF012
        parameter.name: parameter
        for parameter in (
            Parameter("transverse", "kg m2", "moment of inertia across the axis", 1.0, 0.0, open_low=True),
            Parameter("axial", "kg m2", "moment of inertia about the axis", 0.5, 0.0, open_low=True),
            Parameter("weight", "N m", "weight times distance of the centre of mass", 1.0, 0.0),
            Parameter("tilt", "rad", "angle from the vertical to the axis at the start", start=True),
            Parameter("precession", "rad s-1", "rate about the vertical at the start", start=True),
            Parameter("spin", "rad s-1", "rate about the axis at the start", start=True),
        )
    }

    def initial_state(self, points):
        sine, cosine = np.sin(points["tilt"]), np.cos(points["tilt"])
        vertical = np.array([np.zeros_like(sine), sine, cosine])
        w = points["precession"] * vertical
        w[2] += points["spin"]
        return np.concatenate([w, vertical])

    def frequency_bound(self, points):
        """Bound of the rates by the energy, and of the blocks of the linearised equations by their norms."""
        w1, w2, w3, _, _, g3 = self.initial_state(points)
        weight = points["weight"] / points["transverse"]
        turn = np.sqrt(w1**2 + w2**2 + w3**2 + 2 * weight * (g3 + 1))
        gyration = np.abs(1 - points["axial"] / points["transverse"]) * np.abs(w3)
        return 0.5 * (gyration + turn) + np.sqrt((0.5 * (gyration - turn)) ** 2 + weight)


def steady_spin(points):
    """Spin of the regular precession with the tilt and the precession of the points."""
    n, cosine = points["precession"], np.cos(points["tilt"])
    axial = (points["weight"] + points["transverse"] * n**2 * cosine) / n
    return axial / points["axial"] - n * cosine


class HeavyTopWithTheory(HeavyTop):
    """The same with a family of steady motions."""

    name = "heavy_top_with_theory"
    families = {  # noqa: RUF012
        "precession": Family(
            "precession", 1, "regular precession", "Lagrange",
            (Condition("steady", lambda points: (points["spin"] - steady_spin(points)) / np.abs(steady_spin(points))),),
            {"spin": steady_spin},
        )
    }  # fmt: skip


class BareEquations:
    """Those of the heavy top, without anything that may be left out."""

    STATE, CONSTANTS = equations.STATE, equations.CONSTANTS
    rhs, frame_motion = equations.rhs, equations.frame_motion


class BareTop(HeavyTop):
    """A top whose author has given neither first integrals, nor units of the kernels, nor a frequency bound."""

    name = "bare_top"
    equations = BareEquations
    frequency_bound = System.frequency_bound


SCENE = """
schema = 1
title = "A top"
system = "heavy_top"

[fixed]
precession = 0.5

[axes.tilt]
from = 0.3
to = 1.2
count = 5

[axes.spin]
from = 1.0
to = 6.0
count = 7

[ties]
axial = "0.5 * transverse"

[integration]
duration = 20.0
tolerance = 1e-6
"""


@pytest.fixture(autouse=True)
def registered(own_systems):
    for system in (HeavyTop(), HeavyTopWithTheory(), BareTop()):
        systems.register(system)


@pytest.fixture(scope="module")
def ds():
    with registry():
        systems.register(HeavyTop())
        return atlas.run(atlas.load_scene(SCENE), progress=False)


def random_points(count):
    rng = np.random.default_rng(5)
    return {
        "axial": rng.uniform(0.3, 1.8, count),
        "weight": rng.uniform(0.5, 2.0, count),
        "tilt": rng.uniform(0.3, 2.5, count),
        "precession": rng.uniform(0.2, 1.0, count),
        "spin": rng.uniform(-3.0, 3.0, count),
    }


@pytest.mark.long
def test_trajectories_agree_with_dop853_and_conserve_energy():
    point = {name: values[0] for name, values in random_points(1).items()}
    tr = atlas.trajectory("heavy_top", point, duration=10.0, samples=101, tolerance=1e-10, method="rk8")
    state = np.array([tr[name].values for name in equations.STATE])
    constants = (1.0, point["axial"], point["weight"])
    exact = solve_ivp(
        lambda _, y: equations.rhs(y, constants), (0, 10), state[:, 0], "DOP853", tr.time.values,
        rtol=1e-12, atol=1e-12,
    ).y  # fmt: skip
    np.testing.assert_allclose(state, exact, atol=1e-9)
    energy = sum(equations.energy(state, constants))
    np.testing.assert_allclose(energy, energy[0], rtol=1e-10)
    assert tr["integral_drift"].max() < 1e-10
    turn = solve_ivp(  # psi' = w.g / sin^2 theta less the part along the axis
        lambda t, y: [*equations.rhs(y[:6], constants), (y[0] * y[3] + y[1] * y[4]) / (y[3] ** 2 + y[4] ** 2)],
        (0, 10), [*state[:, 0], 0.0], "DOP853", rtol=1e-11, atol=1e-11,
    ).y[6, -1]  # fmt: skip
    assert float(tr.psi[0]) == 0.0
    assert float(tr.psi[-1]) == pytest.approx(turn, abs=1e-8)


@pytest.mark.long
def test_labels_of_steady_and_other_motions():
    points = random_points(40)
    steady = points | {"spin": steady_spin({"transverse": np.ones(40), **points})}
    labels = atlas.label_points("heavy_top", steady, duration=3.0, tolerance=1e-10, method="rk8")
    assert (labels["status"] == Status.OK).all()
    assert (labels["label"] == Label.REGULAR_PRECESSION).all()
    np.testing.assert_allclose(labels["psi_dot_mean"], points["precession"], rtol=1e-8)
    assert (atlas.label_points("heavy_top", points, duration=20.0)["label"] == Label.DRIFTING).all()


@pytest.mark.long
def test_units_and_a_bound_that_are_filled_in_give_the_same_labels():
    points = random_points(40)
    points["spin"][:20] = steady_spin({"transverse": np.ones(40), **points})[:20]
    options = {"duration": 5.0, "tolerance": 1e-10, "method": "rk8"}
    bare, proved_bound = (
        atlas.label_points("bare_top", points, **options),
        atlas.label_points("heavy_top", points, **options),
    )
    assert systems.get("bare_top").has_numeric_bound
    assert not systems.get("heavy_top").has_numeric_bound
    assert "integral_drift" not in bare
    checked = atlas.label_points("bare_top", points, check_half_step="all", **options)
    np.testing.assert_array_equal(checked["error_estimate"], bare["error_estimate"])
    for name in ("label", "status"):
        np.testing.assert_array_equal(bare[name], proved_bound[name])
    for name in ("psi_dot_mean", "phi_dot_std", "normal_rate_mean"):
        np.testing.assert_allclose(bare[name], proved_bound[name], rtol=1e-7, atol=1e-7)
    assert bare.attrs["atlas_frequency_bound"] == "numeric"
    assert "numeric bound" in bare["step_ratio"].attrs["long_name"]
    bound, proved = (ds["step_ratio"] / ds["step"] * METHODS["rk8"].stability for ds in (bare, proved_bound))
    least = 2 * np.pi * numeric_bound.LEAST_TURNS / 5.0
    assert (bound <= np.fmax(1.15 * proved, least * (1 + 1e-12))).all()
    assert (bound >= np.fmax(0.3 * proved, least * (1 - 1e-12))).all()


def test_variables_that_the_system_does_not_have_are_absent():
    names = set(variables(systems.get("heavy_top")))
    assert {"label", "status", "theta_dot_rms", "integral_drift", "error_estimate"} <= names
    assert not names & {
        "label_inertial", "geometry", "family", "stable", "growth_rate", "condition_residual", "predicted",
        "predicted_inertial", "agreement",
    }  # fmt: skip
    theory = set(variables(systems.get("heavy_top_with_theory"))) - names
    without_integrals = HeavyTop()
    without_integrals.equations = SimpleNamespace(INTEGRALS={})
    assert names - set(variables(without_integrals)) == {"integral_drift"}
    assert theory == {
        "family", "stable", "growth_rate", "condition_residual", "predicted", "agreement",
        "predicted_any_axis", "agreement_any_axis",
    }  # fmt: skip


@pytest.mark.long
def test_a_family_makes_predictions():
    points = random_points(20)
    points["spin"] = steady_spin({"transverse": np.ones(20), **points})
    labels = atlas.label_points("heavy_top_with_theory", points, duration=3.0)
    assert (labels["family"] == 1).all()
    assert (labels["predicted"] == Label.REGULAR_PRECESSION).all()
    assert (labels["agreement"] == Agreement.AGREE).all()
    scene = SCENE.replace("heavy_top", "heavy_top_with_theory").replace("[axes.spin]", "[axes.weight]")
    scene = atlas.load_scene(scene + '[family]\nname = "precession"\nsolve = ["spin"]\n')
    assert (atlas.run(scene, progress=False)["label"] == Label.REGULAR_PRECESSION).all()


@pytest.mark.long
def test_scene_file_and_queries(ds, tmp_path):
    assert dict(ds.sizes) == {"tilt": 5, "spin": 7}
    assert set(np.unique(ds["label"])) <= {Label.REGULAR_PRECESSION, Label.DRIFTING}
    out = tmp_path / "top.nc"
    atlas.run(atlas.load_scene(SCENE), out, progress=False)
    opened = atlas.open_atlas(out).load()
    xr.testing.assert_equal(opened.drop_attrs(), ds.drop_attrs())
    assert opened.atlas.select(label="drifting").sizes["point"] == (ds["label"] == Label.DRIFTING).sum()
    assert float(opened.atlas.fractions().sum()) > 0
    assert float(opened.atlas.nearest(tilt=0.35, spin=1.1)["tilt"]) == pytest.approx(0.3)
    assert opened.atlas.trajectory(tilt=0.5, spin=2.0).sizes["time"] > 100
    assert opened.atlas.families() is not None
    assert opened.atlas.trust() is not None
    assert opened.atlas.cite()
    with pytest.raises(atlas.BadInput, match="predicts nothing"):
        opened.atlas.compare()


@pytest.mark.long
def test_figures(ds, tmp_path):
    from atlas.plotting.trajectory import trajectory_figure

    ds.atlas.map().savefig(tmp_path / "map.png")
    ds.atlas.map("theta_max").savefig(tmp_path / "theta_max.png")
    trajectory_figure(ds.atlas.trajectory(tilt=0.5, spin=2.0)).savefig(tmp_path / "trajectory.png")
    assert (tmp_path / "map.png").stat().st_size > 5000


@pytest.mark.long
def test_a_frame_of_another_name(monkeypatch):
    from atlas.plotting.trajectory import trajectory_figure

    monkeypatch.setattr(HeavyTop, "frame", "turntable")
    monkeypatch.setattr(HeavyTop, "frame_axes", ("east", "north", "up"))
    tr = atlas.trajectory("heavy_top", {"tilt": 0.4, "spin": 3.0}, duration=2.0, samples=21)
    assert tr["axis_y"].attrs["long_name"] == "third axis along north"
    assert [text.get_text() for text in trajectory_figure(tr).axes[3].texts] == ["east", "north", "up"]


@pytest.mark.long
@pytest.mark.extension("studies")
def test_refined_scene_and_accuracy(tmp_path):
    from atlas.extensions.studies import work_precision

    ds = atlas.run(atlas.load_scene(SCENE + "[refine]\nlevels = 1\n"), progress=False)
    assert "computed" in ds
    (tmp_path / "top.toml").write_text(SCENE)
    report = work_precision.work_precision(atlas.load_scene(SCENE), 4)
    assert float(report["error_state"].min()) < 1e-8


@pytest.mark.long
@pytest.mark.extension("studies")
def test_stress_study_makes_its_own_cases(monkeypatch):
    from atlas.extensions.studies import stress

    system = systems.get("heavy_top")
    assert system.stress_cases() == ()
    cases = stress.generic_cases(system)
    assert [case.name for case in cases] == ["defaults", "beside the defaults", *system.parameters]
    for case in cases:
        for name, values in case.columns.items():
            assert (np.asarray(values) >= system.parameters[name].low).all()
    monkeypatch.setattr(stress, "generic_cases", lambda system: [cases[1], cases[4]])
    ds = stress.stress(system)
    # The reference determines no label of the largest weight.
    np.testing.assert_array_equal(ds["weight"], [1.0, *cases[4].columns["weight"][:-1]])
    assert set(ds["known_from"].values) == {"reference"}
    assert not stress.mislabelled(ds).any()


@pytest.mark.long
@pytest.mark.extension("equilibria")
def test_commands(tmp_path, capsys):
    (tmp_path / "top.toml").write_text(SCENE)
    assert cli.main(["check", str(tmp_path / "top.toml")]) == cli.DONE
    assert (
        cli.main(["run", str(tmp_path / "top.toml"), "-o", str(tmp_path / "top.nc"), "--quiet"]) == cli.DONE
    )
    assert cli.main(["conditions", "heavy_top"]) == cli.DONE
    assert cli.main(["compare", str(tmp_path / "top.nc")]) == cli.BAD_INPUT
    assert cli.main(["map", str(tmp_path / "top.nc"), "-o", str(tmp_path / "map.png")]) == cli.DONE
    with pytest.raises(atlas.BadInput, match="equilibria"):
        atlas.equilibria("heavy_top", {})


@pytest.mark.long
def test_variational_equations_follow_from_its_own():
    """A symmetric heavy top is integrable: its neighbours separate linearly, never exponentially."""
    points = {"tilt": np.array([0.5, 1.0, 2.5]), "precession": np.array([0.3, 0.7, 0.1]), "spin": 0.4}
    names = ["label", "status", "megno", "regularity"]
    ds = atlas.label_points("heavy_top", points, duration=300.0, variables=names, progress=False)
    assert (ds.status == 1).all()
    assert (ds.regularity == 2).all()
    np.testing.assert_allclose(ds.megno, 2.0, atol=0.3)
