"""Every map names its variable, calls theory theory, and says why a cell is white."""

import numpy as np
import pytest
from matplotlib.figure import Figure

import atlas
from atlas.plotting import content

pytestmark = pytest.mark.usefixtures("whole_kernels")

BODY = {"A": 0.005, "B": 0.03, "C": 0.03, "Omega": 1.131e-3, "h3": 2.6e-5, "mu3": 0.05}
SCENE = {
    "schema": 1,
    "system": "satellite",
    "fixed": BODY,
    "axes": {
        "k3": {"from": -1e-3, "to": 1e-3, "count": 3},
        "theta0": {"from": "1 * deg", "to": "89 * deg", "count": 4},
    },
    "integration": {"duration": "2 orbits", "tolerance": 1e-4, "method": "rk8"},
}


@pytest.fixture(scope="module")
def cubesat():
    """Every motion is measured as drifting; of none theory knows a steady motion."""
    return atlas.run(SCENE, progress=False).load()


def legend(figure: Figure) -> list[str]:
    return [entry.get_text() for legend in figure.legends for entry in legend.get_texts()]


def heading(figure: Figure) -> str:
    (drawn,) = figure.legends
    return drawn.get_title().get_text()


def test_a_map_shows_labels_and_says_so(cubesat):
    assert np.unique(cubesat.label).tolist() == [3]
    figure = cubesat.atlas.map()
    np.testing.assert_array_equal(figure.axes[0].collections[0].get_array().ravel(), 3)
    assert (heading(figure), legend(figure)) == ("label", ["drifting", "equilibrium (exact)"])


@pytest.mark.long
def test_theory_is_called_theory(cubesat):
    assert heading(cubesat.atlas.map("predicted")) == "predicted (theory)"
    assert heading(cubesat.atlas.map("stable")) == "stable (theory)"
    assert cubesat.atlas.map("growth_rate").axes[1].get_ylabel() == "growth rate (theory, rad s$^{-1}$)"
    assert cubesat.atlas.map("theta_max").axes[1].get_ylabel() == r"largest $\theta$ (rad)"
    for variable, label in (("predicted", "predicted (theory)"), ("label", "label")):
        assert cubesat.atlas.map(variable, select={"k3": 0.0}).axes[0].get_ylabel() == label
    points = cubesat.atlas.select(label="drifting")
    assert heading(points.atlas.map("predicted", x="k3", y="theta0")) == "predicted (theory)"


@pytest.mark.long
def test_with_a_title_or_several_variables_each_panel_is_named(cubesat):
    figure = cubesat.atlas.map("predicted", title="A satellite")
    assert (heading(figure), figure.axes[0].get_title()) == ("A satellite", "predicted (theory)")
    figure = atlas.figure({"(a)": cubesat, "(b)": (cubesat, "predicted"), "(c)": (cubesat, "growth_rate")})
    assert [ax.get_title() for ax in figure.axes[:3]] == ["(a): label", "(b): predicted (theory)", "(c)"]
    assert heading(figure) == ""
    figure = atlas.figure({"(a)": cubesat, "(b)": cubesat})
    assert ([ax.get_title() for ax in figure.axes], heading(figure)) == (["(a)", "(b)"], "label")


def test_maps_in_the_axes_of_the_caller_are_named(cubesat):
    left, middle, right = Figure().subplots(1, 3)
    right.set_title("mine")
    cubesat.atlas.map(ax=left, title="A")
    cubesat.atlas.map("predicted", ax=middle, legend=False)
    cubesat.atlas.map("theta_max", ax=right, legend=False)
    assert (left.get_title(), left.get_legend().get_title().get_text()) == ("A", "label")
    assert middle.get_title() == "predicted (theory)"
    assert right.get_title() == "mine"


def test_labels_of_the_caller_replace_the_name(cubesat):
    assert heading(cubesat.atlas.map(labels={"label": "motion in five orbits"})) == "motion in five orbits"


def test_a_measured_point_is_not_white_for_the_reason_of_one_that_was_not(cubesat):
    """At one point theory says nothing, another one was not computed."""
    ds = cubesat.copy(deep=True)
    ds["predicted"][0, 0] = ds["predicted"][1, 1] = ds["label"][1, 1] = ds["status"][1, 1] = 0
    ds["growth_rate"][:] = 1.0
    ds["growth_rate"][0, 0] = ds["growth_rate"][1, 1] = np.nan
    ds["theta_max"][0, 0] = ds["theta_max"][1, 1] = np.nan
    for variable in ("predicted", "growth_rate"):
        assert legend(ds.atlas.map(variable, boundary=False))[-2:] == [content.NO_MOTION, content.NO_THEORY]
    assert legend(ds.atlas.map("theta_max", boundary=False)) == [content.NO_MOTION, content.NO_VALUE]
    without_label = ds.drop_vars("label")
    assert legend(without_label.atlas.map("theta_max", boundary=False)) == [
        content.NO_MOTION,
        content.NO_VALUE,
    ]
    panel = content.panel_of(without_label, "predicted", ["k3", "theta0"], None, False)
    assert np.argwhere(panel.white[content.NO_MOTION]).tolist() == [[1, 1]]
    assert np.argwhere(panel.white[content.NO_THEORY]).tolist() == [[0, 0]]


@pytest.mark.long
def test_a_probability_says_of_what():
    changes = {"axes": {"K1": {"count": 3}, "K3": {"count": 3}, "draw": {"to": 4, "count": 4}}}
    changes |= {"integration": {"duration": "1 orbits"}}
    ds = atlas.run(atlas.example("gravity_gradient_uncertain", **changes), progress=False)
    shares = ds.atlas.probability(over="draw")
    chosen = shares.sel(label="drifting").atlas
    assert chosen.map().axes[1].get_ylabel() == "probability, label = drifting"
    assert chosen.map("lower").axes[1].get_ylabel() == "lower 95 % limit of probability, label = drifting"
    panels = shares.sel(label=["drifting", "permanent_rotation"]).atlas.map("probability", col="label")
    assert [ax.get_title() for ax in panels.axes[:2]] == ["drifting", "permanent_rotation"]
    assert panels.axes[2].get_ylabel() == "probability"
