"""Diagrams of branches: what is drawn how, and the command that draws them."""

import numpy as np
import pytest
import xarray as xr
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure
from readers import dashes, entries, lines_of

import atlas
from atlas.analysis.metadata import flag_names
from atlas.cli import main
from atlas.errors import BadInput
from atlas.extensions.branches.diagram import LINES, MARKERS, SUBDIVISION, branch_lines, smooth
from atlas.extensions.branches.singular import BorderKind
from atlas.flags import BifurcationKind, StabilityKind

SCENE = """
schema = 1
title = "rotor"
system = "satellite"
fixed = { A = 1.0, B = 1.3, C = 1.7 }
axes.k3 = { from = 0.05, to = 3.0, count = 12 }
"""


@pytest.fixture(scope="module")
def ds():
    return atlas.branches(
        "satellite", {"A": 1.0, "B": 1.3, "C": 1.7}, along={"k3": np.linspace(0.05, 3.0, 12)}
    )


@pytest.fixture(scope="module")
def arcs():
    top = {"A": 1.0, "B": 1.3, "C": 1.7, "Mg": 1.0, "x0": 0.3, "y0": 0.2, "z0": 0.5}
    return atlas.branches("fixed_point", top, along={"n": np.linspace(-3.0, 3.0, 12)})


def test_lines_end_at_the_bifurcations(arcs):
    """Every fold is the end of lines of two branches, and the lines hold every value of every branch."""
    lines = branch_lines(arcs, "theta0", "n")
    assert set(lines) <= set(StabilityKind)
    vertices = np.concatenate([line for group in lines.values() for line in group])
    for n, theta in zip(arcs.fold_n.values, arcs.fold_theta0.values, strict=True):
        assert (np.abs(vertices - [n, theta]).max(1) == 0).sum() == 2
    stable = np.argwhere((arcs.stability_kind == StabilityKind.ENERGY_STABLE).values)
    drawn = np.concatenate(lines[StabilityKind.ENERGY_STABLE])
    for branch, i in stable:
        point = [arcs.n.values[i], arcs.theta0.values[branch, i]]
        assert (np.abs(drawn - point).max(1) == 0).any()


@pytest.mark.long
def test_angles_are_not_joined_across_a_jump(ds):
    lines = branch_lines(ds, "psi0", "k3")
    assert max(np.abs(np.diff(line[:, 1])).max() for group in lines.values() for line in group) < 0.9 * np.pi


@pytest.mark.parametrize("ends", [(True, False), (False, True), (True, True), (False, False)])
def test_lines_are_smooth_and_vertical_where_branches_turn(ends):
    """Arcs of a circle: a branch turns where the arc has a vertical tangent."""
    low, high = (-1.0 if ends[0] else -0.6), (1.0 if ends[1] else 0.6)
    position = np.linspace(low, high, 9)
    line = smooth(position, np.sqrt(1 - position**2), *ends)
    assert np.abs(np.hypot(*line.T) - 1).max() < 5e-3  # of the polygon 0.07
    np.testing.assert_array_equal(line[::SUBDIVISION, 0], position)
    step = np.diff(line, axis=0)
    angle = np.unwrap(np.arctan2(step[:, 1], step[:, 0]))
    assert np.abs(np.diff(angle)).max() < np.radians(
        8
    )  # 90 degrees at least in 96 steps; 20 and more at corners of the polygon
    for end, is_vertical in zip((0, -1), ends, strict=True):
        assert (abs(np.tan(angle[end])) > 10) == is_vertical


def test_figure_marks_stability_and_bifurcations(ds):
    figure = ds.atlas.diagram("theta0", title="rotor")
    (ax,) = figure.axes
    markers = {line.get_marker(): line.get_xydata() for line in ax.lines if line.get_marker() != "None"}
    pitchforks = markers[MARKERS[BifurcationKind.PITCHFORK]["marker"]]
    np.testing.assert_allclose(np.unique(pitchforks[:, 0].round(9)), [0.4, 0.7, 1.6, 2.8])
    styles = {(line.get_color(), line.get_linewidth()) for line in ax.lines}
    thick = LINES[StabilityKind.ENERGY_STABLE]
    assert (thick["color"], thick["linewidth"]) in styles
    names = {text.get_text() for text in figure.legends[0].get_texts()}
    assert {"energy stable", "unstable", "pitchfork", "exchange"} <= names
    assert ax.get_xlabel() == "$k_3$ (N m s)"


def test_arcs_on_the_sphere_and_axes_of_the_caller(arcs):
    figure = Figure()
    ax = figure.subplots()
    assert arcs.atlas.diagram("gamma", ax=ax, legend=False) is figure
    drawn = np.concatenate([line.get_xydata() for line in ax.lines])
    assert np.nanmax(np.hypot(*drawn.T)) <= 1.1 + 1e-9


def test_command(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "rotor.toml").write_text(SCENE)
    assert main(["branches", "rotor.toml", "-o", "rotor.svg"]) == 0
    assert "<svg" in (tmp_path / "rotor.svg").read_text()
    assert main(["branches", "rotor.toml", "-o", "rotor.nc"]) == 0
    assert "24 branches, 16 points at which they meet" in capsys.readouterr().out
    with xr.open_dataset("rotor.nc") as read:
        assert read.fold_kind.attrs["flag_meanings"].split()[2] == "pitchfork"
    assert main(["branches", "rotor.toml", "-o", "x.svg", "--variable", "theta"]) == 2
    assert "did you mean 'theta0'" in capsys.readouterr().err


def test_other_datasets_have_no_diagram(ds):
    with pytest.raises(BadInput, match="no branches"):
        atlas.equilibria("fixed_point", {}).atlas.diagram()
    with pytest.raises(BadInput, match="allowed"):
        ds.atlas.diagram("axis")


def test_diagrams_in_degrees(ds):
    (rad,), (degrees,) = (ds.atlas.diagram("theta0", degrees=each).axes for each in (False, True))
    assert (rad.get_ylabel(), degrees.get_ylabel()) == (r"$\theta$ (rad)", r"$\theta$ (deg)")
    assert rad.get_xlabel() == degrees.get_xlabel() == "$k_3$ (N m s)"
    for a, b in zip(rad.lines, degrees.lines, strict=True):
        np.testing.assert_allclose(a.get_xydata() * [1, 180 / np.pi], b.get_xydata())
    (plain,), (same,) = (ds.atlas.diagram("potential", degrees=each).axes for each in (False, True))
    assert plain.get_ylabel() == same.get_ylabel()
    np.testing.assert_array_equal(plain.lines[0].get_xydata(), same.lines[0].get_xydata())


@pytest.mark.usual("True")
@pytest.mark.parametrize("degrees", [False, True])
def test_every_branch_looks_like_the_entry_of_its_stability(ds, degrees):
    """And every point at which branches meet like that of its kind; unstable ones alone are dashed."""
    figure = ds.atlas.diagram("theta0", degrees=degrees)
    (ax,), samples, size = figure.axes, entries(figure), 180 / np.pi if degrees else 1.0
    kinds = {i: name.replace("_", " ") for i, name in enumerate(flag_names(ds.stability_kind))}
    for branch, i in np.argwhere(np.isfinite(ds.theta0.values)):
        text = kinds[int(ds.stability_kind[branch, i])]
        point = [float(ds.k3[i]), float(ds.theta0[branch, i]) * size]
        assert np.abs(np.concatenate(lines_of(figure, ax, text)) - point).max(1).min() < 1e-9, (text, point)
        is_dashed = bool(dashes(samples[text]))
        assert is_dashed == (text in ("unstable", "unknown")), text
    kinds = {i: name.replace("_", " ") for i, name in enumerate(flag_names(ds.fold_kind))}
    for k3, theta0, kind in zip(ds.fold_k3.values, ds.fold_theta0.values, ds.fold_kind.values, strict=True):
        (marks,) = lines_of(figure, ax, kinds[kind])
        assert np.abs(marks - [k3, theta0 * size]).max(1).min() < 1e-9
    assert set(samples) == {kinds[i] for i in ds.fold_kind.values} | {
        name.replace("_", " ")
        for i, name in enumerate(flag_names(ds.stability_kind))
        if (ds.stability_kind.where(ds.theta0.notnull()) == i).any()
    }
    assert ax.get_xlim() == (ds.k3.min(), ds.k3.max())


@pytest.mark.parametrize(
    ("variable", "label"),
    [
        ("potential", "potential (J)"), ("frequency_1", "frequency 1 (rad s$^{-1}$)"), ("psi0", r"$\psi$ (rad)"),
        ("growth_rate", "growth rate (rad s$^{-1}$)"),
    ],
)  # fmt: skip
def test_the_vertical_axis_of_a_diagram_names_its_variable(ds, variable, label):
    (ax,) = ds.atlas.diagram(variable).axes
    assert (ax.get_ylabel(), ax.get_xlabel()) == (label, "$k_3$ (N m s)")
    drawn = np.concatenate([line.get_xydata() for line in ax.lines if line.get_marker() == "None"])
    for branch, i in np.argwhere(np.isfinite(ds[variable].values))[::7]:
        point = [float(ds.k3[i]), float(ds[variable][branch, i])]
        assert np.abs(drawn - point).max(1).min() < 1e-9


def borders():
    """Five curves, one of each look, and a special point of each kind, at places of their own."""
    kinds = [
        BorderKind.FOLD,
        BorderKind.FOLD,
        BorderKind.PITCHFORK,
        BorderKind.LIMIT_OF_STABILITY,
        BorderKind.EXTREMAL_MOMENTUM,
    ]
    curve, vertex = np.repeat(np.arange(5), 3), np.tile(np.arange(3.0), 5)
    below = np.repeat([0, 1, 1, 0, 0], 3)  # of the first one the minimum meets a saddle
    above = np.repeat([1, 2, 2, 0, 0], 3)
    columns = {
        "k1": 0.1 * vertex, "k2": curve + 0.01 * vertex, "tangent_k1": np.full(15, 0.1), "tangent_k2": np.full(15, 0.01),
        "arc": vertex, "curve": curve, "kind": np.repeat([int(kind) for kind in kinds], 3), "index_below": below, "index_above": above,
        "count_change": 0 * curve,
    }  # fmt: skip
    special = {"special_k1": [0.05, 0.15, 0.18], "special_k2": [7.0, 8.0, 9.0], "special_kind": [1, 2, 3]}
    ds = xr.Dataset(
        {name: ("vertex", values) for name, values in columns.items()}
        | {name: ("special", values) for name, values in special.items()}
        | {"cells": (("cell_k1", "cell_k2"), np.zeros((2, 2), np.int8))},
        attrs={"atlas_system": "satellite"},
    )
    for name in ("k1", "k2"):
        ds[name].attrs = {
            "units": "N m s",
            "long_name": atlas.systems.get("satellite").parameters[name].meaning,
        }
    return ds


def test_every_border_looks_like_the_entry_of_its_kind():
    figure = borders().atlas.diagram()
    (ax,), samples = figure.axes, entries(figure)
    names = ["a minimum ends", "fold", "pitchfork", "limit of stability", "extremal momentum"]
    for number, patch in enumerate(ax.patches):
        vertices = patch.get_path().vertices
        sample = samples[names[round(vertices[0, 1])]]
        np.testing.assert_allclose(
            vertices[[0, -1]], [[0, round(vertices[0, 1])], [0.2, round(vertices[0, 1]) + 0.02]]
        )
        assert patch.get_linewidth() == sample.get_linewidth(), number
        assert dashes(patch) == dashes(sample)
        np.testing.assert_array_equal(patch.get_edgecolor()[:3], to_rgb(sample.get_color()))
    assert len(ax.patches) == 5
    places = {"cusp": [0.05, 7.0], "meeting of borders": [0.15, 8.0], "exponents meet at 0": [0.18, 9.0]}
    for text, place in places.items():
        (marks,) = lines_of(figure, ax, text)
        np.testing.assert_array_equal(marks, [place])
    assert sorted(samples) == sorted([*names, *places])
    assert (ax.get_xlabel(), ax.get_ylabel()) == ("$k_1$ (N m s)", "$k_2$ (N m s)")
