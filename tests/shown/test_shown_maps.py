"""A place of a map has the colour, the hatching and the side of a line that the legend gives to what was measured there."""

import numpy as np
import pytest
from matplotlib.colors import LogNorm, to_hex
from readers import cell, colour_at, colours, entries, hatched, heading, lines_of, mesh_of, number_at

import atlas
from atlas import load_scene
from atlas.analysis.boundary import STABILITY
from atlas.analysis.metadata import flag_names
from atlas.plotting import content, style

pytestmark = pytest.mark.usefixtures("whole_kernels")

UNSTABLE = 2


@pytest.fixture(scope="module")
def small(small_scene):
    return atlas.run(load_scene(small_scene), progress=False).load()


@pytest.fixture(scope="module")
def varied(small):
    """The small atlas with every label, in no order."""
    ds = small.copy(deep=True)
    ds["label"][:] = np.random.default_rng(81).integers(1, 5, ds.label.shape)
    return ds


@pytest.fixture(scope="module")
def solid(scene_text):
    """Three axes, the shortest with two values in no order, of which one is an angle."""
    changes = {
        "family": None, "nudge": None, "labels": None, "integration": {"duration": 2.0},
        "axes.phi0": {"values": [0.3, -0.02], "display_units": "deg"}, "axes.sigma.count": 4, "axes.theta0.count": 3,
    }  # fmt: skip
    return atlas.run(load_scene(scene_text(changes)), progress=False).load()


def places(ds, **scale):
    """Index, and place on the map, of every point over sigma and theta0."""
    for i, j in np.ndindex(ds.sizes["sigma"], ds.sizes["theta0"]):
        yield (i, j), float(ds.sigma[i]), float(ds.theta0[j]) * scale.get("y", 1.0)


# Variable -> what the legend or the colour bar is called; the unit is that of the attribute, by hand.
FLAGS = {
    "label": "label", "label_inertial": "label inertial", "predicted": "predicted (theory)", "agreement": "agreement",
    "stable": "stable (theory)", "family": "family (theory)", "status": "status", "geometry": "geometry",
}  # fmt: skip
NUMBERS = {
    "growth_rate": "growth rate (theory, rad s$^{-1}$)",
    "theta_max": r"largest $\theta$ (rad)",
    "theta_min": r"least $\theta$ (rad)",
    "theta_dot_rms": r"rms $\dot\theta$ (rad s$^{-1}$)",
    "psi_dot_mean": r"mean $\dot\psi$ (rad s$^{-1}$)",
    "phi_dot_std": r"standard deviation of $\dot\varphi$ (rad s$^{-1}$)",
    "normal_rate_mean": r"mean $\omega'\cdot\gamma$ (rad s$^{-1}$)",
    "end_time": "end time (s)",
    "step": "step (s)",
    "error_estimate": "error estimate",
    "condition_residual": "condition residual (theory)",
}


@pytest.mark.parametrize("variable", FLAGS)
def test_the_legend_names_the_flag_of_every_place(varied, variable):
    figure = varied.atlas.map(variable, boundary=False)
    (ax,) = figure.axes
    assert (heading(figure), ax.get_xlabel(), ax.get_ylabel()) == (
        FLAGS[variable],
        "$C/A$",
        r"$\theta_0$ (rad)",
    )
    names, texts = flag_names(varied[variable]), colours(figure)
    for index, x, y in places(varied):
        assert texts[colour_at(ax, x, y)] == names[varied[variable].values[index]].replace("_", " "), index
    shown = {names[v] for v in np.unique(varied[variable])}
    assert len(texts) == len(shown)


@pytest.mark.parametrize("variable", NUMBERS)
def test_the_bar_has_the_numbers_of_every_place(small, variable):
    figure = small.atlas.map(variable, boundary=False)
    ax, bar = figure.axes
    assert (bar.get_ylabel(), ax.get_xlabel(), ax.get_ylabel()) == (
        NUMBERS[variable],
        "$C/A$",
        r"$\theta_0$ (rad)",
    )
    mesh, values = mesh_of(ax), small[variable].values
    assert mesh.colorbar.ax is bar
    assert bar.get_ylim() == pytest.approx((mesh.norm.vmin, mesh.norm.vmax))
    is_log = isinstance(mesh.norm, LogNorm)
    for index, x, y in places(small):
        drawn, value = number_at(ax, x, y), values[index]
        assert drawn == value or (is_log and value == 0 < drawn < mesh.norm.vmin)
    shades = [float(np.mean(mesh.cmap(mesh.norm(v))[:3])) for v in np.linspace(*bar.get_ylim(), 5)]
    assert shades == sorted(shades)  # larger numbers are lighter


def test_degrees_are_on_axes_bars_and_panels(solid):
    figure = solid.atlas.map("theta_max", degrees=True, boundary=False)
    *panels, bar = figure.axes
    assert bar.get_ylabel() == r"largest $\theta$ (deg)"
    assert figure.get_supylabel() == r"$\theta_0$ (deg)"
    assert figure.get_supxlabel() == "$C/A$"
    assert len(panels) == 2
    for ax in panels:
        text = ax.get_title().removeprefix(r"$\varphi_0$ = ").removesuffix(" deg")
        angle = np.radians(float(text.replace("\N{MINUS SIGN}", "-")))
        panel = solid.sel(phi0=angle, method="nearest")
        assert float(panel.phi0) == pytest.approx(angle, abs=1e-3)
        for index, x, y in places(panel, y=180 / np.pi):
            expected = np.degrees(panel.theta_max.transpose("sigma", "theta0").values[index])
            assert number_at(ax, x, y) == pytest.approx(expected)
    titles = [
        ax.get_title() for ax in solid.atlas.map("theta_max", boundary=False).axes[:2]
    ]  # as the scene asks
    assert sorted(titles) == [r"$\varphi_0$ = 17.19 deg", "$\\varphi_0$ = \N{MINUS SIGN}1.146 deg"]


def test_panels_of_rows_and_columns_are_where_their_texts_are(solid):
    figure = solid.atlas.map("theta_max", x="sigma", row="theta0", col="phi0", degrees=False, boundary=False)
    panels = figure.axes
    column = [ax.get_title() for ax in panels[:2]]
    for number, ax in enumerate(panels):
        (beside,) = panels[2 * (number // 2) + 1].texts
        point = {}
        for name, text in (("phi0", column[number % 2]), ("theta0", beside.get_text())):
            value = text.partition(" = ")[2].removesuffix(" rad")
            point[name] = float(value.replace("\N{MINUS SIGN}", "-"))
        part = solid.sel(point, method="nearest")
        assert all(abs(float(part[name]) - value) < 1e-3 for name, value in point.items())
        np.testing.assert_array_equal(ax.lines[0].get_xydata(), np.stack([part.sigma, part.theta_max], -1))


def test_the_limit_of_stability_parts_stable_from_unstable_motions(small):
    """It looks like its entry, and passes between two neighbours as often as it must: once, or of one kind never or twice."""
    for variable in ("stable", "growth_rate", "label"):
        figure = small.atlas.map(variable)
        (line,) = lines_of(figure, figure.axes[0], STABILITY)
        (x, y), is_unstable = line.T, (small.stable == UNSTABLE).values
        for (i, j), _, theta0 in places(small.isel(sigma=slice(-1))):
            k = np.flatnonzero((y[:-1] - theta0) * (y[1:] - theta0) < 0)  # pieces end in nan
            at = x[k] + (theta0 - y[k]) / (y[k + 1] - y[k]) * (x[k + 1] - x[k])
            crossings = ((at > float(small.sigma[i]) - 1e-9) & (at < float(small.sigma[i + 1]) - 1e-9)).sum()
            assert crossings % 2 == (is_unstable[i, j] != is_unstable[i + 1, j])


def test_slow_instabilities_are_hatched_and_no_others(small):
    figure = small.atlas.map("label")
    sample = entries(figure)[content.SLOW]
    steady = np.isin(small.label, [1, 2]) & (small.stable == UNSTABLE)
    slow = steady & (small.growth_rate * small.end_time < 12)
    assert 0 < slow.sum() < slow.size
    for index, x, y in places(small):
        assert (hatched(figure.axes[0], x, y) == sample.get_hatch()) == bool(slow.values[index])


def test_a_point_of_no_body_no_motion_and_no_number_is_white_for_its_reason(varied):
    ds = varied.copy(deep=True)
    ds["label"][:], ds["status"][:] = 3, 1
    ds["theta_max"][1, 2] = np.nan
    ds["theta_max"][4, 5] = ds["theta_max"][6, 1] = np.nan
    ds["label"][4, 5] = ds["status"][4, 5] = ds["label"][6, 1] = 0
    ds["status"][6, 1] = flag_names(ds.status).index("impossible_body")
    texts = entries(ds.atlas.map("theta_max", boundary=False))
    assert list(texts) == [content.NO_BODY, content.NO_MOTION, content.NO_VALUE]
    ax = ds.atlas.map("theta_max", boundary=False).axes[0]
    for index, x, y in places(ds):
        assert np.isnan(number_at(ax, x, y)) == bool(np.isnan(ds.theta_max.values[index]))


def test_a_curve_has_the_values_over_its_axis(small):
    for axis, label, factor in (("sigma", "$C/A$", 1.0), ("theta0", r"$\theta_0$ (deg)", 180 / np.pi)):
        other = "theta0" if axis == "sigma" else "sigma"
        part = small.isel({other: 2})
        (ax,) = part.atlas.map("theta_max", degrees=True).axes
        assert (ax.get_xlabel(), ax.get_ylabel()) == (label, r"largest $\theta$ (deg)")
        curve = ax.lines[0].get_xydata()
        np.testing.assert_allclose(curve, np.stack([part[axis] * factor, np.degrees(part.theta_max)], -1))


def test_levels_of_a_curve_of_flags_are_named(varied):
    part = varied.isel(theta0=4)
    (ax,) = part.atlas.map("label", boundary=False).axes
    texts = {
        round(tick): text.get_text() for tick, text in zip(ax.get_yticks(), ax.get_yticklabels(), strict=True)
    }
    names = flag_names(varied.label)
    dots = ax.collections[-1]
    assert len(texts) == np.unique(part.label).size > 2
    for (x, height), colour, sigma, value in zip(
        dots.get_offsets(), dots.get_facecolors(), part.sigma.values, part.label.values, strict=True
    ):
        assert x == sigma
        assert texts[round(height)] == names[value].replace("_", " ")
        assert to_hex(colour) == style.COLOURS[names[value]]


@pytest.fixture(scope="module")
def dots():
    """Single points in an order that no mirror image has."""
    rng = np.random.default_rng(81)
    points = {"C": rng.uniform(0.3, 1.7, 40), "theta0": rng.uniform(0.1, 1.5, 40), "k3": 0.2, "m": 0.4}
    ds = atlas.label_points("satellite", points, duration=2.0).load()
    ds["label"][:] = rng.choice([1, 2, 3, 4], 40, p=[0.5, 0.3, 0.15, 0.05])
    return ds


def test_dots_are_at_their_points_in_the_colours_of_the_legend(dots):
    figure = dots.atlas.map("label", x="C", y="theta0", degrees=True)
    (ax,) = figure.axes
    assert (heading(figure), ax.get_xlabel(), ax.get_ylabel()) == (
        "label",
        "$C$ (kg m$^{2}$)",
        r"$\theta_0$ (deg)",
    )
    drawn, texts, names = ax.collections[0], colours(figure), flag_names(dots.label)
    place = {
        (float(c), float(t)): k for k, (c, t) in enumerate(zip(dots.C, np.degrees(dots.theta0), strict=True))
    }
    order = [place[tuple(map(float, offset))] for offset in drawn.get_offsets()]
    assert sorted(order) == list(range(40))
    shades = [to_hex(drawn.cmap(drawn.norm(value))) for value in drawn.get_array()]
    assert [texts[s] for s in shades] == [names[dots.label.values[k]].replace("_", " ") for k in order]
    counts = np.bincount(dots.label.values)[dots.label.values[order]]
    assert (np.diff(counts) <= 0).all()  # rare ones are on top


def test_dots_of_numbers_have_them(dots):
    figure = dots.atlas.map("theta_max", x="theta0", y="C")
    ax, bar = figure.axes
    assert (ax.get_xlabel(), ax.get_ylabel(), bar.get_ylabel()) == (
        r"$\theta_0$ (rad)", "$C$ (kg m$^{2}$)", r"largest $\theta$ (rad)",
    )  # fmt: skip
    drawn = ax.collections[0]
    np.testing.assert_array_equal(drawn.get_offsets(), np.stack([dots.theta0, dots.C], -1))
    np.testing.assert_array_equal(drawn.get_array(), dots.theta_max)


@pytest.mark.usual("perp radius")
@pytest.mark.parametrize(
    ("psi0", "family", "factor"), [(0.0, "perp radius", 1), (np.pi / 2, "perp velocity", 4)]
)
def test_exact_motions_are_where_the_entry_of_their_family_runs(psi0, family, factor):
    """Conical motions of a symmetric body: (A - C) cos(theta) = C m + k3, of the axis normal to the velocity four times this."""
    axes = {"theta0": {"from": 0.1, "to": 1.5, "count": 3}, "k3": {"from": -3.0, "to": 3.0, "count": 3}}
    scene = {"schema": 1, "system": "satellite", "fixed": {"C": 1.4, "m": 0.3, "psi0": psi0}, "axes": axes}
    ds = atlas.run(scene | {"integration": {"duration": 1.0}}, progress=False)
    figure = ds.atlas.map("label", legend=True)
    # The frame reaches below theta = 0.1, and upright bodies are cylindrical.
    assert {text for text in entries(figure) if text.endswith("(exact)")} == {
        f"{family} (exact)",
        "cylindrical (exact)",
    }
    (line,) = lines_of(figure, figure.axes[0], "cylindrical (exact)")
    np.testing.assert_allclose(line[np.isfinite(line).all(1), 0], 0, atol=1e-8)
    (line,) = lines_of(figure, figure.axes[0], f"{family} (exact)")
    theta, k3 = line[np.isfinite(line).all(1)].T
    np.testing.assert_allclose(factor * (1 - 1.4) * np.cos(theta), 1.4 * 0.3 + k3, atol=1e-8)


def test_exponents_and_lengths_of_a_map_of_regularity(small):
    """Shades of chaotic points alone are exponents; regular and chaotic are said of the length of the runs."""
    from atlas.flags import Regularity

    meanings = " ".join(Regularity.meanings())
    attrs = {"flag_meanings": meanings, "flag_values": np.arange(len(Regularity), dtype=np.int8)}
    i, j = np.indices(small.label.shape)
    flags = ((i + 2 * j) % len(Regularity)).astype(np.int8)
    exponents = 10.0 ** (-2 + (i + j) / 8)
    ds = small[["label"]].assign(
        regularity=(("sigma", "theta0"), flags, attrs),
        lyapunov=(("sigma", "theta0"), exponents, {"units": "s-1", "long_name": "exponent"}),
    )
    figure = ds.atlas.map("regularity", boundary=False)
    ax, bar = figure.axes
    texts = colours(figure)
    assert bar.get_ylabel() == r"Lyapunov exponent $\lambda$ (s$^{-1}$)"
    layer = ax.collections[-1]
    named = {"regular": "regular up to 30", "chaotic": "chaotic up to 30"}
    for index, x, y in places(ds):
        name = list(Regularity.meanings())[flags[index]]
        text = texts[colour_at(ax, x, y)]
        assert text == named.get(name, text)
        shade = np.ma.filled(layer.get_array(), np.nan)[cell(ax, x, y)]
        if flags[index] == Regularity.CHAOTIC:
            assert shade == pytest.approx(exponents[index])
        else:
            assert np.isnan(shade)
