"""Predictions of systems without families: polynomial equations decide, and others have none."""

import heavy_top_equations
import numpy as np
import pytest
from family_starts import free_precessions, spheres
from strategies import random_satellites
from test_outside_system import HeavyTop, random_points, steady_spin

import atlas
from atlas import cli, systems
from atlas.flags import Agreement, Label, Status
from atlas.systems.base import Parameter
from atlas.systems.check import REPLACED
from atlas.systems.steady import growth_about_vertical, polynomial_degree
from atlas.variables import variables

pytestmark = pytest.mark.usefixtures("whole_kernels", "short_timings")

VECTORS = (("g1", "g2", "g3"),)


class TopEquations:
    STATE, CONSTANTS, FRAME_VECTORS = heavy_top_equations.STATE, heavy_top_equations.CONSTANTS, VECTORS
    rhs, frame_motion = heavy_top_equations.rhs, heavy_top_equations.frame_motion


class Top(HeavyTop):
    """The heavy top, with what its states are."""

    name = "declared_top"
    rate_states = ("w1", "w2", "w3")
    equations = TopEquations


class DraggedEquations:
    STATE, CONSTANTS, FRAME_VECTORS = heavy_top_equations.STATE, heavy_top_equations.CONSTANTS, VECTORS
    frame_motion = heavy_top_equations.frame_motion

    def rhs(state, constants):
        w1, w2, w3, g1, g2, g3 = state
        transverse, axial, weight = constants
        return (
            ((transverse - axial) * w2 * w3 + weight * g2) / transverse,
            ((axial - transverse) * w3 * w1 - weight * g1) / transverse,
            0.1 * tanh(w3 - 1.0),  # noqa: F821
            g2 * w3 - g3 * w2,
            g3 * w1 - g1 * w3,
            g1 * w2 - g2 * w1,
        )


class DraggedTop(Top):
    """A top with a motor that is no polynomial."""

    name, equations = "dragged_top", DraggedEquations


class DrivenEquations:
    STATE, CONSTANTS, FRAME_VECTORS = (
        (*heavy_top_equations.STATE, "t"),
        heavy_top_equations.CONSTANTS,
        VECTORS,
    )

    def rhs(state, constants):
        w1, w2, w3, g1, g2, g3, t = state
        transverse, axial, weight = constants
        return (
            ((transverse - axial) * w2 * w3 + weight * g2) / transverse,
            ((axial - transverse) * w3 * w1 - weight * g1) / transverse,
            0.01 * t,
            g2 * w3 - g3 * w2,
            g3 * w1 - g1 * w3,
            g1 * w2 - g2 * w1,
            1.0 + 0.0 * t,
        )

    def frame_motion(state, constants):
        w1, w2, w3, g1, g2, g3, t = state
        return w1, w2, w3, g1, g2, g3


class DrivenTop(Top):
    """A top with a torque that grows with the time."""

    name, equations = "driven_top", DrivenEquations
    frequency_bound = systems.System.frequency_bound

    def initial_state(self, points):
        return np.concatenate([super().initial_state(points), np.zeros((1, *points["tilt"].shape))])


class RunningDownEquations:
    STATE, CONSTANTS = (*heavy_top_equations.STATE, "charge"), heavy_top_equations.CONSTANTS
    FRAME_VECTORS, frame_motion = VECTORS, DrivenEquations.frame_motion

    def rhs(state, constants):
        w1, w2, w3, g1, g2, g3, charge = state
        transverse, axial, weight = constants
        return (
            ((transverse - axial) * w2 * w3 + weight * g2) / transverse,
            ((axial - transverse) * w3 * w1 - weight * g1) / transverse,
            0.1 * charge,
            g2 * w3 - g3 * w2,
            g3 * w1 - g1 * w3,
            g1 * w2 - g2 * w1,
            -0.2 * charge,
        )


class RunningDownTop(DrivenTop):
    """A top with a motor whose charge is one more state."""

    name, equations = "running_down_top", RunningDownEquations
    parameters = Top.parameters | {
        "charge0": Parameter("charge0", "1", "charge at the start", 1.0, start=True)
    }

    def initial_state(self, points):
        return np.concatenate([HeavyTop.initial_state(self, points), points["charge0"][None]])


REASONS = {"dragged_top": "tanh", "driven_top": "state t ", "running_down_top": "state charge "}


@pytest.fixture(autouse=True)
def registered(own_systems):
    for system in (Top(), DraggedTop(), DrivenTop(), RunningDownTop()):
        systems.register(system)


@pytest.mark.long
def test_polynomial_equations_predict_without_a_family():
    points = random_points(60)
    transverse = {"transverse": np.ones(60), **points}
    points["spin"][:20] = steady_spin(transverse)[:20]
    points["tilt"][20:30] = 0.0  # upright: permanent rotations, stable or not
    points["spin"][30:34], points["precession"][30:34], points["tilt"][30:34] = 0.0, 0.0, np.pi  # at rest
    ds = atlas.label_points("declared_top", points, duration=8.0, tolerance=1e-10, method="rk8")
    assert "family" not in ds
    assert "stable" not in ds
    assert (ds.predicted[:20] == Label.REGULAR_PRECESSION).all()
    assert (ds.predicted[20:34] == Label.PERMANENT_ROTATION).all()
    assert (ds.predicted[34:] == Label.DRIFTING).all()
    resolved = ds.where(ds.status == Status.OK, drop=True)
    assert resolved.sizes["point"] > 50
    assert (resolved.agreement == Agreement.AGREE).all()
    assert (ds.condition_residual[:34] < 1e-13).all()


@pytest.mark.long
def test_motions_about_any_axes_are_predicted_without_a_family():
    """A free top precesses about its angular momentum, wherever the vertical is."""
    points = random_points(20) | {"weight": 0.0}
    names = ["label", "predicted", "label_any_axis", "predicted_any_axis", "agreement_any_axis"]
    ds = atlas.label_points(
        "declared_top", points, duration=20.0, variables=names, method="rk8", tolerance=1e-10
    )
    assert (ds.predicted == Label.DRIFTING).all()
    assert (ds.predicted_any_axis == Label.REGULAR_PRECESSION).all()
    assert (ds.agreement_any_axis == Agreement.AGREE).all()


@pytest.mark.parametrize("name", REASONS)
def test_other_equations_have_no_prediction_and_check_says_why(name, tmp_path, capsys):
    system = systems.get(name)
    assert REASONS[name] in polynomial_degree(system)
    assert not {"predicted", "agreement", "predicted_any_axis", "condition_residual"} & set(variables(system))
    scene = tmp_path / "scene.toml"
    scene.write_text(f'schema = 1\nsystem = "{name}"\n[axes.tilt]\nvalues = [0.5, 0.9]\n')
    assert cli.main(["check", str(scene)]) == 0
    (line,) = [line for line in capsys.readouterr().out.splitlines() if line.startswith("predicted: ")]
    assert REASONS[name] in line


def test_check_says_nothing_where_the_equations_decide(tmp_path, capsys):
    scene = tmp_path / "scene.toml"
    scene.write_text('schema = 1\nsystem = "declared_top"\n[axes.tilt]\nvalues = [0.5, 0.9]\n')
    assert cli.main(["check", str(scene)]) == 0
    assert "predicted: " not in capsys.readouterr().out


def test_rotations_about_the_vertical_grow_as_the_equations_say():
    """0 about an axis of symmetry of the fields; nan of tilted bodies, and where the equations do not decide."""
    points = random_points(3) | {"tilt": np.array([0.0, 0.0, 0.5])}
    points = {name: np.broadcast_to(p.default, 3) for name, p in Top.parameters.items()} | points
    np.testing.assert_array_equal(growth_about_vertical(systems.get("declared_top"), points), [0, 0, np.nan])
    assert np.isnan(growth_about_vertical(systems.get("dragged_top"), points)).all()


@pytest.mark.parametrize("name", REPLACED)
def test_a_member_that_no_system_has_is_refused_in_one_line(name):
    kind = type("OldTop", (Top,), {"name": "old_top", name: lambda self, points: points["tilt"] > 0})
    with pytest.raises(
        atlas.BadInput, match=f"OldTop.{name} is no member of a system: {REPLACED[name][:20]}"
    ) as raised:
        systems.register(kind())
    assert "\n" not in str(raised.value)


@pytest.mark.usual("free tops")
@pytest.mark.parametrize("kind", ["spheres", "free tops", "random satellites"])
def test_predictions_about_any_axes_of_moved_starts_contradict_no_label(kind):
    """Changes of one parameter by 1e-16 to 0.1; in both frames of satellites."""
    rng, count = np.random.default_rng(55), 40
    starts = {"spheres": spheres, "free tops": free_precessions, "random satellites": random_satellites}
    points = {name: np.array(values) for name, values in starts[kind](rng, count).items()}
    points = {name: values for name, values in points.items() if np.isfinite(values).all()}
    moved = rng.choice([name for name in points if name not in ("A", "B", "C", "damping")], count)
    for i in range(1, count, 2):
        points[moved[i]][i] += 10.0 ** rng.uniform(-16, -1)
    name = "fixed_point" if kind == "free tops" else "satellite"
    suffixes = [""] if kind == "free tops" else ["", "_inertial"]
    variables = [f"{each}_any_axis{suffix}" for each in ("label", "predicted") for suffix in suffixes]
    ds = atlas.label_points(name, points, duration=20.0, variables=[*variables, "status"], method="rk8")
    for suffix in suffixes:
        label, predicted = (ds[f"{each}_any_axis{suffix}"] for each in ("label", "predicted"))
        decided = (ds.status == Status.OK) & (predicted != Label.NOT_COMPUTED)
        assert (label == predicted).where(decided, True).all()
        assert decided.sum() > 15
