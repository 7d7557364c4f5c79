"""Maps: figures show the values of the atlas and of theory, and can be printed."""

import io
import re

import matplotlib
import numpy as np
import pytest
import xarray as xr
from hypothesis import given, settings
from hypothesis import strategies as st
from matplotlib.collections import QuadMesh
from matplotlib.colors import LogNorm, to_rgb
from matplotlib.figure import Figure

import atlas
from atlas import BadInput, load_scene
from atlas.analysis import boundary, metadata, select
from atlas.errors import MAX_TEXT, printable
from atlas.files import FIGURES
from atlas.flags import Label
from atlas.plotting import cells, content, maps, style, trajectory
from atlas.systems import SYSTEMS
from atlas.variables import variables

pytestmark = pytest.mark.usefixtures("whole_kernels")


@pytest.fixture(scope="module")
def small(small_scene):
    return atlas.run(load_scene(small_scene), progress=False)


@pytest.fixture(scope="module")
def solid(scene_text, without_family):
    """Three axes, the shortest with three values; only n = 0 is on a family."""
    scene = scene_text(without_family | {"axes.n.values": [0.1, -0.02, 0.0]})
    return atlas.run(load_scene(scene), progress=False)


def meshes(figure: Figure) -> list[QuadMesh]:
    return [
        c for ax in figure.axes for c in ax.collections if isinstance(c, QuadMesh) and ax.get_xlabel() != ""
    ]


def legend(figure: Figure) -> list[str]:
    return [entry.get_text() for legend in figure.legends for entry in legend.get_texts()]


# Colours.

# Machado, Oliveira & Fernandes 2009, severity 1, on linear RGB: protanopia, deuteranopia, tritanopia.
COLOUR_VISION = (
    np.eye(3),
    [[0.152286, 1.052583, -0.204868], [0.114503, 0.786281, 0.099216], [-0.003882, -0.048116, 1.051998]],
    [[0.367322, 0.860646, -0.227968], [0.280085, 0.672501, 0.047413], [-0.011820, 0.042940, 0.968881]],
    [[1.255528, -0.076749, -0.178779], [-0.078411, 0.930809, 0.147602], [0.004733, 0.691367, 0.303900]],
)
XYZ = np.array([[0.4124, 0.3576, 0.1805], [0.2126, 0.7152, 0.0722], [0.0193, 0.1192, 0.9505]])


def lab(colours: list[str], vision) -> np.ndarray:
    """CIE L*a*b* (D65) of colours as perceived, shape (colours, 3)."""
    rgb = np.array([to_rgb(c) for c in colours])
    linear = np.where(rgb <= 0.04045, rgb / 12.92, ((rgb + 0.055) / 1.055) ** 2.4)
    xyz = np.clip(linear @ np.asarray(vision).T, 0, 1) @ XYZ.T / XYZ.sum(1)
    f = np.where(xyz > 216 / 24389, np.cbrt(xyz), (24389 / 27 * xyz + 16) / 116)
    return np.stack([116 * f[:, 1] - 16, 500 * (f[:, 0] - f[:, 1]), 200 * (f[:, 1] - f[:, 2])], -1)


@pytest.mark.parametrize("vision", COLOUR_VISION, ids=("full", "protan", "deutan", "tritan"))
def test_flags_differ_in_grey_and_for_the_colour_blind(vision):
    for system in SYSTEMS.values():
        for variable in variables(system).values():
            if variable.flags:
                colours = lab(list(style.flag_colours(variable.flags).values()), vision)
                i, j = np.triu_indices(len(colours), 1)
                lightness_difference = np.abs(colours[i, 0] - colours[j, 0]).min()
                assert lightness_difference > (5 if len(colours) > 7 else 12), variable.name
                assert np.linalg.norm(colours[i] - colours[j], axis=1).min() > 7, variable.name


@pytest.mark.parametrize("vision", COLOUR_VISION, ids=("full", "protan", "deutan", "tritan"))
def test_positions_differ_for_the_colour_blind(vision):
    names = ["none", *(f"place_{i}" for i in range(len(style.QUALITATIVE)))]
    for count in range(2, len(names) + 1):
        assert len(set(style.flag_colours(names[:count]).values())) == count
    colours = lab(list(style.QUALITATIVE), vision)
    i, j = np.triu_indices(len(colours), 1)
    assert np.linalg.norm(colours[i] - colours[j], axis=1).min() > 7


@pytest.mark.parametrize("vision", COLOUR_VISION, ids=("full", "protan", "deutan", "tritan"))
def test_labels_differ_clearly_for_the_colour_blind(vision):
    colours = lab(list(style.flag_colours(Label.meanings()).values()), vision)
    i, j = np.triu_indices(len(colours), 1)
    assert np.linalg.norm(colours[i] - colours[j], axis=1).min() > 20


@pytest.mark.long
def test_the_colour_of_a_flag_does_not_depend_on_the_others(small):
    part = small.isel(sigma=slice(0, 2))
    assert len(np.unique(part.label)) < len(np.unique(small.label))
    for ds in (small, part):
        (mesh,) = meshes(maps.atlas_map(ds))
        for value in np.unique(ds.label):
            colour = to_rgb(style.COLOURS[Label(value).name.lower()])
            assert mesh.cmap(mesh.norm(value))[:3] == pytest.approx(colour, abs=1e-6)


# Cells.


@settings(max_examples=50)
@given(st.lists(st.floats(1e-3, 10), min_size=2, max_size=30), st.booleans())
def test_cells_enclose_their_points_and_meet_midway(steps, log):
    values = np.cumsum(steps)
    if log:
        values = np.exp(values / values[-1] * 20)
    edges = select.cell_edges(values, log)
    assert edges.shape == (values.size + 1,)
    assert (edges[:-1] < values).all()
    assert (values < edges[1:]).all()
    middle = np.sqrt(values[1:] * values[:-1]) if log else (values[1:] + values[:-1]) / 2
    np.testing.assert_allclose(edges[1:-1], middle, rtol=1e-12)
    outer = np.log(edges) if log else edges
    inner = np.log(values) if log else values
    assert inner[0] - outer[0] == pytest.approx(outer[1] - inner[0])
    assert outer[-1] - inner[-1] == pytest.approx(inner[-1] - outer[-2])


def test_a_map_shows_every_value_at_its_coordinates(small):
    for x, y in (("sigma", "theta0"), ("theta0", "sigma")):
        (mesh,) = meshes(maps.atlas_map(small, "theta_dot_rms", x=x, y=y))
        shown = np.asarray(mesh.get_array()).reshape(small.sizes[y], small.sizes[x])
        values = small.theta_dot_rms.transpose(y, x).values
        positive = values > 0  # exact zeros are below any logarithmic scale
        np.testing.assert_array_equal(shown[positive], values[positive])
        assert (shown[~positive] < mesh.norm.vmin).all()
        corners = mesh.get_coordinates()
        np.testing.assert_array_equal(corners[0, :, 0], select.cell_edges(small[x].values))
        np.testing.assert_array_equal(corners[:, 0, 1], select.cell_edges(small[y].values))
        assert mesh.get_rasterized()


def test_axes_are_drawn_in_increasing_order(small):
    mixed = small.isel(sigma=[3, 0, 8, 1, 7, 2, 5, 4, 6], theta0=slice(None, None, -1))
    (a,), (b,) = meshes(maps.atlas_map(small)), meshes(maps.atlas_map(mixed))
    np.testing.assert_array_equal(np.asarray(a.get_array()), np.asarray(b.get_array()))


@pytest.mark.long
def test_long_axes_are_thinned(small, monkeypatch):
    monkeypatch.setattr(select, "MAX_CELLS", 4)
    (mesh,) = meshes(maps.atlas_map(small))
    shown = np.asarray(mesh.get_array()).reshape(4, 3)
    np.testing.assert_array_equal(shown, small.label.transpose("theta0", "sigma")[::2, ::3])


# Scales, labels, size.


@pytest.mark.long
def test_scales_fit_the_numbers(small):
    def norm_and_figure(values):
        ds = small.assign(theta_dot_rms=small.theta_dot_rms.copy(data=values))
        figure = maps.atlas_map(ds, "theta_dot_rms", boundary=False)
        return meshes(figure)[0].norm, figure

    shape = small.theta_dot_rms.shape
    decades = np.logspace(-6, 0, 63).reshape(shape)
    norm, _ = norm_and_figure(decades)
    assert isinstance(norm, LogNorm)
    assert (norm.vmin, norm.vmax) == pytest.approx((1e-6, 1))
    decades[0, 0] = 0.0
    norm, figure = norm_and_figure(decades)
    assert isinstance(norm, LogNorm)
    mesh = meshes(figure)[0]
    zero = mesh.cmap(mesh.norm(np.asarray(mesh.get_array()).ravel()[0]))
    assert zero == mesh.cmap(0)  # the lowest colour, not a hole
    norm, _ = norm_and_figure(np.linspace(1, 2, 63).reshape(shape))
    assert not isinstance(norm, LogNorm)
    norm, _ = norm_and_figure(np.linspace(-1, 3, 63).reshape(shape))
    assert (norm.vmin, norm.vmax) == (-3, 3)
    norm, _ = norm_and_figure(np.full(shape, 2.0))
    assert norm.vmin < 2 < norm.vmax
    hole = np.linspace(1, 2, 63).reshape(shape)
    hole[2, 2] = np.nan
    assert "no value" in legend(norm_and_figure(hole)[1])
    assert legend(norm_and_figure(np.full(shape, np.nan))[1])[0] == "no value"


def test_signed_colours_show_the_sign_in_grey():
    lightness = lab(
        [matplotlib.colors.to_hex(c) for c in matplotlib.colormaps["cividis"](np.linspace(0, 1, 11))],
        np.eye(3),
    )
    assert (np.diff(lightness[:, 0]) > 0).all()


@pytest.mark.long
@pytest.mark.parametrize(("width", "mm"), [("column", 88), ("page", 180)])
def test_the_figure_has_the_width_of_the_journal(small, solid, width, mm):
    for ds in (small, solid, small.isel(sigma=0)):
        figure = maps.atlas_map(ds, width=width, caption=ds is small)
        assert figure.get_figwidth() * 25.4 == pytest.approx(mm)
        figure.draw_without_rendering()
        box = figure.get_tightbbox()
        assert box.x0 > -0.01
        assert box.y0 > -0.01
        assert box.x1 < figure.get_figwidth() + 0.01
        assert box.y1 < figure.get_figheight() + 0.01


def test_axes_carry_symbols_and_units(small):
    figure = maps.atlas_map(small, "psi_dot_mean")
    ax, bar = figure.axes
    assert (ax.get_xlabel(), ax.get_ylabel()) == ("$C/A$", r"$\theta_0$ (rad)")
    assert bar.get_ylabel() == r"mean $\dot\psi$ (rad s$^{-1}$)"
    assert style.unit_text("kg m2") == "kg m$^{2}$"
    assert style.variable_label(small.growth_rate) == "growth rate (rad s$^{-1}$)"


@pytest.mark.long
def test_every_variable_of_an_atlas_can_be_drawn(small):
    for name in small.data_vars:
        maps.atlas_map(small, name, boundary=False).draw_without_rendering()


def test_the_legend_shows_only_what_occurs(small):
    names = list(variables(SYSTEMS["satellite"])["label"].flags)
    occurring = [names[v].replace("_", " ") for v in np.unique(small.label)]
    assert legend(maps.atlas_map(small, boundary=False)) == occurring
    every = [*occurring, content.SLOW, "stability limit (theory)"]
    assert sorted(legend(maps.atlas_map(small))) == sorted(every)  # ordered by length, where this saves a row
    assert legend(maps.atlas_map(small, legend=False)) == []


@pytest.mark.long
@pytest.mark.parametrize("bad", [r"$\nonsense{$", f"${'{' * 3000}$"], ids=["unknown", "nested"])
def test_texts_that_are_no_formulas_are_drawn_as_they_are(small, bad):
    """A file of a stranger may contain any."""
    ds = small.copy().assign_attrs(title=bad)
    ds["sigma"] = ds["sigma"].assign_attrs(long_name=bad)
    ds["label"] = ds["label"].assign_attrs(flag_meanings=ds.label.flag_meanings.replace("drifting", bad))
    ds["psi_dot_mean"] = ds["psi_dot_mean"].assign_attrs(units=bad)
    drawn = printable(bad, MAX_TEXT).replace("$", r"\$")
    for variable in ("label", "psi_dot_mean"):
        figure = ds.atlas.map(variable, title=bad, caption=True)
        figure.savefig(io.BytesIO())
        labels = [label for ax in figure.axes for label in (ax.get_xlabel(), ax.get_ylabel())]
        assert drawn in {label.replace("\n", " ") for label in labels}
    assert figure.axes[-1].get_ylabel() == rf"mean $\dot\psi$ ({drawn})"
    assert style.drawable("$k_3$") == "$k_3$"
    assert style.drawable("$k_3$\n$\\bad$") == "$k_3$\n\\$\\bad\\$"


def test_a_third_axis_becomes_panels(solid):
    figure = maps.atlas_map(solid, "theta_dot_rms")
    panels = figure.axes[:3]
    assert [ax.get_title() for ax in panels] == [
        f"$n$ = {v} rad s$^{{-1}}$" for v in ("\N{MINUS SIGN}0.02", "0", "0.1")
    ]
    limits = {(m.norm.vmin, m.norm.vmax) for ax in panels for m in ax.collections}
    assert len(limits) == 1
    assert (figure.get_supxlabel(), figure.get_supylabel()) == ("$C/A$", r"$\theta_0$ (rad)")
    numbers = [any(tick.label1.get_visible() for tick in ax.xaxis.get_major_ticks()) for ax in panels]
    assert numbers == [False, True, True]  # two above, one below


def test_rows_and_columns_of_panels(solid):
    solid = solid.expand_dims(k2=[0.0, 0.5])
    figure = maps.atlas_map(solid, "theta_dot_rms", row="k2", col="n", width="page", boundary=False)
    panels = figure.axes[:6]
    places = [ax.get_subplotspec() for ax in panels]
    assert [(p.rowspan.start, p.colspan.start) for p in places] == list(np.ndindex(2, 3))
    assert [bool(ax.get_title()) for ax in panels] == [True] * 3 + [False] * 3
    assert [[t.get_text() for t in ax.texts] for ax in panels[2::3]] == [["$k_2$ = 0"], ["$k_2$ = 0.5"]]
    for ax, (row, column) in zip(panels, np.ndindex(2, 3), strict=True):
        (mesh,) = [c for c in ax.collections if isinstance(c, QuadMesh)]
        part = solid.theta_dot_rms.isel(k2=row).sortby("n").isel(n=column).transpose("theta0", "sigma")
        np.testing.assert_array_equal(
            np.ravel(mesh.get_array()), np.where(part > 0, part, mesh.get_array().min()).ravel()
        )
    column = maps.atlas_map(solid.isel(k2=0), "theta_dot_rms", row="n", boundary=False)
    assert [ax.get_subplotspec().rowspan.start for ax in column.axes[:3]] == [0, 1, 2]


def test_one_axis_gives_a_curve(small):
    levels = maps.atlas_map(small, select={"theta0": 0.8})
    (ax,) = levels.axes
    label = small.label.sel(theta0=0.8, method="nearest")
    values = np.unique(label)
    assert [t.get_text() for t in ax.get_yticklabels()] == [
        Label(v).name.lower().replace("_", " ") for v in values
    ]
    np.testing.assert_array_equal(values[ax.lines[0].get_ydata()], label)
    assert legend(levels) == ["stability limit (theory)"]
    line = maps.atlas_map(small, "theta_dot_rms", select={"theta0": 0.8})
    curve = line.axes[0].lines[0]
    nearest = small.theta_dot_rms.sel(theta0=0.8, method="nearest")
    np.testing.assert_array_equal(curve.get_ydata(), nearest.where(nearest > 0))
    assert line.axes[0].get_yscale() == "log"


def test_logarithmic_axes_are_drawn_on_a_logarithmic_scale(small):
    scene = small.attrs["atlas_scene"].replace("from = 0.3", 'spacing = "log"\nfrom = 0.3')
    ds = small.assign_coords(sigma=np.geomspace(0.3, 1.7, 9)).assign_attrs(atlas_scene=scene)
    ds["sigma"].attrs = small["sigma"].attrs
    ax = maps.atlas_map(ds).axes[0]
    assert ax.get_xscale() == "log"
    np.testing.assert_allclose(ax.get_xlim(), select.cell_edges(ds.sigma.values, log=True)[[0, -1]])


def test_settings_of_the_user_are_left_alone(small):
    before = dict(matplotlib.rcParams)
    maps.atlas_map(small)
    assert dict(matplotlib.rcParams) == before


# Theory.


def test_a_map_without_theory_where_bodies_between_its_points_cannot_exist(small, caplog):
    scene = small.attrs["atlas_scene"].replace('B = "A"', 'B = "A * sqrt(sigma - 0.3)"')
    figure = maps.atlas_map(
        small.assign_attrs(atlas_scene=scene).assign_coords(sigma=np.linspace(-0.3, 1, 9))
    )
    assert "no theory on this map" in caplog.text
    assert meshes(figure) or figure.axes


# Choices of the caller.


def test_a_map_in_the_axes_of_the_caller(small):
    figure = Figure(figsize=(4, 3))
    left, right = figure.subplots(1, 2)
    with matplotlib.rc_context({"font.size": 20}):
        assert maps.atlas_map(small, ax=left, title="mine") is figure
        maps.atlas_map(small, "theta_dot_rms", ax=right, cmap="magma", legend=False)
    assert left.get_title() == "mine"
    assert left.xaxis.label.get_fontsize() == 10  # as the caller made the Axes
    assert [t.get_text() for t in left.get_legend().get_texts()][-1] == "stability limit (theory)"
    assert right.get_legend() is None
    (mesh,) = [c for c in right.collections if isinstance(c, QuadMesh)]
    assert mesh.cmap.name == "magma"
    assert figure.get_size_inches().tolist() == [4, 3]


def test_latex_is_not_asked_for_where_the_settings_of_the_user_name_it(small, tmp_path):
    for path, usetex in ((tmp_path / "a.png", False), (tmp_path / "b.png", True)):
        with matplotlib.rc_context({"text.usetex": usetex}):
            style.save(maps.atlas_map(small), path, dpi=50)
    assert (tmp_path / "a.png").read_bytes() == (tmp_path / "b.png").read_bytes()


def test_maps_of_the_caller_carry_the_entries_of_one_legend(small):
    figure = Figure()
    left, right = figure.subplots(1, 2)
    maps.atlas_map(small, ax=left, legend=False)
    maps.atlas_map(small, "predicted", ax=right, legend=False)
    handles, texts = left.get_legend_handles_labels()
    assert sorted(texts) == sorted(legend(maps.atlas_map(small)))
    figure.legend(handles, texts)
    figure.draw_without_rendering()
    drawn = dict(zip(texts, figure.legends[0].legend_handles, strict=True))
    assert drawn["drifting"].get_facecolor() == matplotlib.colors.to_rgba(style.COLOURS["drifting"])
    assert content.SLOW not in right.get_legend_handles_labels()[1]  # nothing was run there


@pytest.mark.long
@pytest.mark.parametrize("dpi", [72, 110, 300])
def test_the_legend_is_inside_the_figure_at_any_resolution(small, dpi):
    figure = maps.atlas_map(small)
    file = io.BytesIO()
    figure.savefig(file, dpi=dpi)
    file.seek(0)
    ink = (matplotlib.image.imread(file)[: dpi // 4, :, :3] < 0.9).any(axis=(0, 2))  # of the legend
    assert ink.any()
    assert not ink[[0, -1]].any()


def test_colours_texts_and_size_can_be_chosen(small):
    figure = maps.atlas_map(
        small,
        title="Where it drifts",
        colors={"drifting": "red"},
        labels={"drifting": "falls", "theta0": "tilt"},
        size=(120, 90),
    )
    (mesh,) = meshes(figure)
    assert mesh.cmap(mesh.norm(Label.DRIFTING)) == (1, 0, 0, 1)
    assert mesh.cmap(mesh.norm(Label.PERMANENT_ROTATION))[:3] == to_rgb(style.COLOURS["permanent_rotation"])
    assert "falls" in legend(figure)
    assert "drifting" not in legend(figure)
    assert figure.legends[0].get_title().get_text() == "Where it drifts"
    assert figure.axes[0].get_ylabel() == "tilt"
    assert (figure.get_size_inches() * 25.4).tolist() == pytest.approx([120, 90])
    bar = maps.atlas_map(
        small, "theta_dot_rms", boundary=False, title="A", labels={"theta_dot_rms": "unrest"}
    )
    assert bar.get_suptitle() == "A"
    assert bar.axes[1].get_ylabel() == "unrest"


@pytest.mark.long
def test_plain_savefig_writes_for_print(small, tmp_path):
    for dpi, expected in ((None, 300), (120, 120)):
        figure = maps.atlas_map(small, **({} if dpi is None else {"dpi": dpi}))
        figure.savefig(tmp_path / "map.png")
        width = matplotlib.image.imread(tmp_path / "map.png").shape[1]
        assert width == pytest.approx(88 / 25.4 * expected, abs=2)
    figure.savefig(tmp_path / "map.pdf")
    assert b"/FontFile2" in (tmp_path / "map.pdf").read_bytes()  # TrueType, not drawn glyphs


# What cannot be seen or was not computed.


def regions(shape, **marked):
    """A dataset like an atlas without a scene, permanent rotation but for some marked indices."""
    values = np.full(shape, Label.PERMANENT_ROTATION, np.int8)
    for name, index in marked.items():
        values[index] = Label[name.upper()]
    flags = {"flag_meanings": " ".join(Label.meanings()), "flag_values": np.arange(5, dtype=np.int8)}
    return xr.Dataset(
        {"label": (("x", "y"), values, flags)},
        {"x": np.arange(shape[0], dtype=float), "y": np.arange(shape[1], dtype=float)},
        {"atlas_system": "satellite"},
    )


def test_what_is_too_small_to_be_seen_is_in_the_caption(caplog):
    ds = regions((60, 50), drifting=(slice(0, 5), 0), regular_precession=(9, 9))
    ds.attrs |= {
        "atlas_step": 0.1,
        "atlas_rate_tolerance": 1e-3,
        "atlas_cylinder_tolerance": 1e-3,
    }  # for captions
    rare = "regular precession, 1 of 3000 points"
    with caplog.at_level("INFO", "atlas"):
        figure = maps.atlas_map(ds)
    assert legend(figure) == ["permanent rotation", "drifting"]
    assert not figure.texts
    assert caplog.messages == [f"too few to be seen, and not in the legend: {rare}"]
    for panels in (1, 2):  # of each panel by itself
        figure = atlas.figure([ds] * panels, caption=True)
        text = " ".join(" ".join(t.get_text() for t in figure.texts).split())
        assert text.startswith(f"Too few to be seen: {'; '.join([rare] * panels)}. Atlas: ")


def test_white_cells_are_explained():
    ds = regions((20, 20), not_computed=slice(0, 8))
    assert legend(maps.atlas_map(ds)) == ["permanent rotation", content.NO_MOTION]
    status = np.ones((20, 20), np.int8)
    status[:4], status[4:8] = 2, 0
    names = {"flag_meanings": "not_computed ok impossible_body", "flag_values": np.arange(3, dtype=np.int8)}
    ds = ds.assign(status=(("x", "y"), status, names))
    assert legend(maps.atlas_map(ds)) == ["permanent rotation", content.NO_BODY, content.NO_MOTION]


def test_missing_tiles_of_an_unfinished_run_are_hatched(small):
    part = small.copy(deep=True).assign_attrs(atlas_run="1 of 3 tiles; 1 by one process")
    part["label"][3:] = Label.NOT_COMPUTED
    part["status"][3:] = 0
    figure = maps.atlas_map(part)
    assert content.NOT_YET in legend(figure)
    assert content.NO_MOTION not in legend(figure)
    assert [t.get_text() for t in figure.texts] == ["Unfinished: 1 of 3 tiles are computed."]
    hatched = [c for c in figure.axes[0].collections if c.get_hatch()]
    boxes = np.concatenate([p.vertices for c in hatched for p in c.get_paths()])
    edges = select.cell_edges(small.sigma.values)
    assert (boxes[:, 0].min(), boxes[:, 0].max()) == pytest.approx((edges[3], edges[-1]))


def test_slow_instabilities_are_hatched_where_growth_had_no_time(small):
    panel = content.panel_of(small, "label", ["sigma", "theta0"], None, False)
    assert not panel.slow.any()  # without theory
    scene = metadata.scene_of(small)
    slow = content.panel_of(small, "label", ["sigma", "theta0"], scene, True).slow
    steady = (small.label != Label.DRIFTING).transpose("theta0", "sigma").values
    unstable = (small.stable == 2).transpose("theta0", "sigma").values
    growth = (small.growth_rate * 30.0).transpose("theta0", "sigma").values
    np.testing.assert_array_equal(slow, steady & unstable & (growth < 12))
    assert slow.any()


def test_what_cannot_be_seen_has_no_entry():
    """Lines that only touch the frame, and hatching narrower than a hundredth of it."""
    array = regions((300, 300)).label
    slow = np.zeros((300, 300), bool)
    slow[:, 7:9] = True
    corner = np.array([[299.4, 299.5], [299.5, 299.4]])
    inside = np.array([[100.0, 100.0], [110.0, 100.0]])
    panel = content.Panel(array, {}, slow, {"a": [corner], "b": [corner, inside], "c": [inside + 300]}, {})
    edges = [np.linspace(-0.5, 299.5, 301)] * 2
    seen = content.visible(panel, edges)
    assert list(seen.borders) == ["b"]
    assert not seen.slow.any()
    slow[:, 7:10] = True
    assert content.visible(panel, edges).slow.sum() == 900
    one = [np.geomspace(1, 100, 9)]
    lines = {"in": [np.array([[10.0]])], "out": [np.array([[0.9]])]}
    assert list(content.visible(content.Panel(array[0], {}, slow[:, 0], lines), one).borders) == ["in"]


def test_a_border_of_many_lines_is_without_halo():
    x = np.linspace(0, 1, 500)
    array = xr.DataArray(np.zeros((2, 2)), dims=("y", "x"))
    edges = [np.linspace(0, 1, 3)] * 2
    for count, widths in ((cells.MAX_HALOED, [1.7, 1.0]), (cells.MAX_HALOED + 1, [1.0])):
        ax = Figure(figsize=(3, 3)).subplots()
        lines = [np.stack([x, y + 0.01 * x], -1) for y in np.linspace(0, 0.9, count)]
        cells.draw_overlay(
            ax,
            content.Panel(array, {}, array.values > 0, {boundary.STABILITY: lines}),
            edges,
            [],
            cells.NARROW,
        )
        assert [line.get_linewidth() for line in ax.lines] == pytest.approx(widths)
        assert all(np.isnan(line.get_xdata()).sum() == count for line in ax.lines)


@pytest.mark.parametrize(("count", "is_crowded"), [(20, True), (200, False)])
def test_tongues_narrower_than_a_cell_are_without_halo(count, is_crowded):
    """A tongue of the width 0.02 on a grid of 20 or 200 cells, and a wedge that ends in a point."""
    x = np.linspace(0, 1, 100)
    tongue = [np.stack([x, 0.3 + 0.2 * x**2 + offset], -1) for offset in (0.0, 0.02)]
    wedge = [np.stack([x, 0.7 + sign * 0.1 * x], -1) for sign in (-1, 1)]
    edges = [np.linspace(0, 1, count + 1)] * 2
    array = xr.DataArray(np.zeros((count, count)), dims=("y", "x"))
    lines = {boundary.STABILITY: tongue, boundary.LABEL: wedge}
    panel = content.visible(content.Panel(array, {}, array.values > 0, lines), edges)
    assert panel.crowded == [boundary.STABILITY] * is_crowded
    ax = Figure(figsize=(3, 3)).subplots()
    cells.draw_overlay(ax, panel, edges, [], cells.NARROW)
    haloes = [line for line in ax.lines if line.get_color() == "white"]
    assert len(haloes) == 2 - is_crowded
    assert content.crowding(tongue[:1], edges) == 0


@pytest.mark.long
def test_a_map_warns_once_that_its_grid_is_coarser_than_the_lines(small, caplog):
    maps.atlas_map(small)
    assert not caplog.records
    maps.atlas_map(small.isel(sigma=[0, 4, 8]))  # the lines C/A = 1 and 4/3 are in one column of cells
    (record,) = caplog.records
    assert record.getMessage().startswith("label: the grid is coarser than the lines of theory: ")


def line_styles(lines) -> set:
    """Colour, width and dashes of lines that are no haloes."""
    drawn = [line for line in lines if line.get_color() != "white"]
    return {(line.get_color(), line.get_linewidth(), line.get_linestyle()) for line in drawn}


def test_every_line_and_hatching_is_in_the_legend(small, solid):
    unfinished = small.copy(deep=True).assign_attrs(atlas_run="1 of 3 tiles; 1 by one process")
    unfinished["label"][3:] = Label.NOT_COMPUTED
    cases = [(small, {}), (small, {"theta0": 0.8}), (solid, {"n": 0.0}), (unfinished, {})]
    maps_drawn = [
        ds.atlas.map(variable, select=select)
        for ds, select in cases
        for variable in ("label", "predicted", "growth_rate", "status")
    ]
    assert sum(len(figure.axes[0].lines) for figure in maps_drawn) > 20
    for figure in maps_drawn:
        samples = figure.legends[0].legend_handles if figure.legends else []
        in_legend = line_styles(
            each for each in samples if hasattr(each, "get_linestyle") and hasattr(each, "get_xdata")
        )
        panels = [ax for ax in figure.axes if ax.get_label() != "<colorbar>"]
        curve = {
            (style.COLOURS["regular_precession"], 1.0, "-"),
            ("0.35", 0.6, "-"),
        }  # the variable of a map over one axis
        drawn = line_styles(line for ax in panels for line in ax.lines if len(line.get_xdata()))
        assert drawn - curve == in_legend - curve
        hatches = {c.get_hatch() for ax in panels for c in ax.collections if c.get_hatch()}
        assert hatches <= {each.get_hatch() for each in samples if hasattr(each, "get_hatch")}


def test_integers_have_a_colour_each(small):
    counts = small.label.astype(float) * 3 + 2
    ds = small.assign(theta_dot_rms=small.theta_dot_rms.copy(data=counts.values))
    figure = maps.atlas_map(ds, "theta_dot_rms")
    mesh, bar = meshes(figure)[0], figure.axes[1]
    np.testing.assert_array_equal(mesh.norm.boundaries, np.arange(8, 13) - 0.5)
    assert len(mesh.norm.boundaries) - 1 == mesh.cmap.N
    assert bar.get_yticks().tolist() == [8, 9, 10, 11]


def test_refined_maps_have_no_gaps(scene_text):
    scene = scene_text({"refine.levels": 2, "axes.sigma.count": 5, "axes.theta0.count": 5})
    ds = atlas.run(load_scene(scene), progress=False)
    interpolated = (ds.computed == 0).transpose("theta0", "sigma").values
    assert np.isnan(ds.theta_dot_rms.transpose("theta0", "sigma").values[interpolated]).any()
    figure = maps.atlas_map(ds, "theta_dot_rms", boundary=False)
    shown = np.asarray(meshes(figure)[0].get_array()).reshape(interpolated.shape)
    assert np.isfinite(shown).all()
    assert set(shown[interpolated]) <= set(shown[~interpolated])
    assert "nearest" in figure.texts[0].get_text()


def test_neighbouring_panels_keep_their_numbers_apart(solid):
    figure = maps.atlas_map(solid, width="page")
    figure.draw_without_rendering()
    boxes = [t.get_window_extent() for ax in figure.axes for t in ax.get_xticklabels() if t.get_text()]
    boxes = [box for box in boxes if box.width > 1]
    assert len(boxes) >= 6
    for i, box in enumerate(boxes):
        assert not any(box.overlaps(other) for other in boxes[:i])


# Scatter maps.


@pytest.fixture(scope="module")
def sample(scene_text):
    """64 single points, a Sobol sample of two ranges."""
    changes = {
        "axes": None,
        "points": {
            "sample": "sobol",
            "count": 64,
            "ranges": {"sigma": {"from": 0.3, "to": 1.7}, "theta0": {"from": 0.2, "to": 1.4}},
        },
    }
    return atlas.run(load_scene(scene_text(changes)), progress=False)


def test_single_points_become_dots(sample):
    figure = maps.atlas_map(sample, x="theta0", y="k3")
    (dots,) = figure.axes[0].collections
    shown = {tuple(place) for place in dots.get_offsets()}
    assert shown == set(zip(sample.theta0.values, sample.k3.values, strict=True))
    assert figure.axes[0].get_xlabel() == r"$\theta_0$ (rad)"
    by_place = dict(zip(map(tuple, dots.get_offsets()), dots.get_array(), strict=True))
    for i in range(sample.sizes["point"]):
        assert by_place[float(sample.theta0[i]), float(sample.k3[i])] == sample.label[i]
    assert "drifting" in legend(figure)
    assert figure.axes[0].get_legend_handles_labels()[1] == legend(figure)


def test_scatter_axes_are_given_parameters_that_vary(sample, small):
    ax = maps.atlas_map(sample, "theta_dot_rms").axes[0]
    assert r"$\theta_0$ (rad)" in (ax.get_xlabel(), ax.get_ylabel())
    chosen = small.atlas.select(label=["permanent_rotation", "drifting"])
    figure = maps.atlas_map(chosen, x="theta0", y="sigma")
    assert len(figure.axes[0].collections[0].get_offsets()) == chosen.sizes["point"]
    with pytest.raises(BadInput, match="x = 'A': not a number given at each of these points; allowed: "):
        maps.atlas_map(sample, x="A")


# Axis names.


@pytest.mark.parametrize(
    ("words", "printed"),
    [
        ("C/A", "$C/A$"),
        ("K1 = (C - A)/B", "$K_{1} = (C - A)/B$"),
        ("sigma", r"$\sigma$"),
        ("l / (A r0), l1 = l2", r"$l / (A\,r_{0}),\ l_{1} = l_{2}$"),
        ("small parameter eps", r"small parameter $\epsilon$"),
        ("rate of precession n", "rate of precession $n$"),
        ("tilt of a body", "tilt of a body"),
        ("A * sigma**2", r"$A\,\sigma^{2}$"),
        ("$x_7$", "$x_7$"),
    ],
)
def test_names_of_axes_are_mathematics(words, printed):
    symbols = {name: p.symbol for name, p in SYSTEMS["satellite"].parameters.items()}
    assert style.math_text(words, symbols) == printed
    assert style.unit_text("Omega") == r"$\Omega$"


@pytest.mark.parametrize(
    ("name", "label"),
    [("theta_drift", r"drift of $\theta$"), ("theta_other", "theta other"), ("x_drift", "x drift")],
)
def test_statistics_of_observables_have_labels(name, label):
    """Also of observables with the name of an angle."""
    assert style.variable_label(xr.DataArray(0.0, name=name)) == label


def test_borders_reach_the_frame_of_coarse_maps_and_as_data_the_ends_of_the_axes(small):
    edges = select.cell_edges(small.theta0.values)
    drawn = maps.atlas_map(small).axes[0].lines[0].get_xydata()
    lines = small.atlas.boundary()
    assert set(lines.kind.values) == {boundary.STABILITY}
    vertices = np.stack([lines.sigma, lines.theta0], -1)
    ends = small.theta0.values[[0, -1]]
    for places, (low, high) in ((drawn, edges[[0, -1]]), (vertices, ends)):
        vertical = places[np.abs(places[:, 0] - 1) < 1e-3]
        assert vertical[:, 1].min() == pytest.approx(low, abs=1e-6)
        assert vertical[:, 1].max() == pytest.approx(high, abs=1e-6)
    assert (vertices >= [small.sigma.min(), ends[0]]).all()
    assert (vertices <= [small.sigma.max(), ends[1]]).all()
    table = {tuple(vertex) for vertex in np.round(drawn, 9)}
    inside = ((vertices > [small.sigma.min(), ends[0]]) & (vertices < [small.sigma.max(), ends[1]])).all(1)
    assert {tuple(vertex) for vertex in np.round(vertices[inside], 9)} <= table


# Bad input.


def test_datasets_without_a_map_are_errors(small, solid):
    with pytest.raises(BadInput, match="not an atlas"):
        maps.atlas_map(xr.Dataset())
    with pytest.raises(BadInput, match="fewer than two parameters"):
        maps.atlas_map(atlas.label_points("satellite", {"theta0": [0.1, 0.2]}, duration=1.0, step=0.1))
    with pytest.raises(BadInput, match="single points without axes"):
        maps.atlas_map(small.atlas.select(label="drifting"), select={"sigma": 1.0})
    with pytest.raises(BadInput, match="not a trajectory"):
        trajectory.trajectory_figure(small)
    with pytest.raises(BadInput, match=r"sigma has 9 values here: choose one by select=\{'sigma': VALUE\}"):
        maps.atlas_map(solid.expand_dims(extra=[0.0, 1.0]), x="theta0", y="n")


def test_too_many_panels_are_refused(solid):
    wide = solid.isel(n=0, drop=True).expand_dims(n=np.linspace(0, 1, select.MAX_PANELS + 1))
    with pytest.raises(BadInput, match="choose one by select"):
        maps.atlas_map(wide, x="sigma", y="theta0")


# Files.


@pytest.mark.long
def test_files_are_whole_repeatable_and_carry_their_fonts(small, tmp_path, few_dots, monkeypatch):
    monkeypatch.setitem(style.STYLE, "savefig.dpi", few_dots)
    for suffix in FIGURES:
        path = tmp_path / f"map{suffix}"
        written = []
        for _ in range(2):
            style.save(maps.atlas_map(small), path)
            written.append(path.read_bytes())
        assert written[0] == written[1]
    assert sorted(p.name for p in tmp_path.iterdir()) == ["map.pdf", "map.png", "map.svg"]
    pdf = (tmp_path / "map.pdf").read_bytes()
    assert b"/FontFile2" in pdf
    assert b"/Type3" not in pdf
    assert b"DejaVuSans" in pdf
    image = matplotlib.image.imread(io.BytesIO((tmp_path / "map.png").read_bytes()), format="png")
    assert image.shape[1] == pytest.approx(88 / 25.4 * 600, abs=2)


def test_paths_that_cannot_be_written_are_errors(small, tmp_path):
    figure = maps.atlas_map(small)
    for path, words in (
        (tmp_path / "map.jpeg", "the name must end in .png, .pdf or .svg"),
        (tmp_path / "map", "the name must end in"),
        (tmp_path / "no" / "map.png", "there is no folder"),
    ):
        with pytest.raises(BadInput, match=re.escape(words)):
            style.save(figure, path)
    (tmp_path / "folder.png").mkdir()
    with pytest.raises(BadInput, match="this is a folder"):
        style.save(figure, tmp_path / "folder.png")
    assert [p.name for p in tmp_path.iterdir()] == ["folder.png"]


def test_a_figure_that_fails_leaves_the_older_file(small, tmp_path, monkeypatch):
    figure = maps.atlas_map(small)
    path = tmp_path / "map.png"
    path.write_bytes(b"older")

    def fail(file, **_):
        file.write(b"half")
        raise OSError("no space")

    monkeypatch.setattr(figure, "savefig", fail)
    with pytest.raises(OSError, match="no space"):
        style.save(figure, path)
    assert [p.name for p in tmp_path.iterdir()] == ["map.png"]
    assert path.read_bytes() == b"older"


def test_the_caption_contains_what_was_computed(small):
    caption = style.caption(small)
    for words in (
        "small: magnetised satellite-gyrostat",
        "m = 0.5",
        "C = sigma * A",
        "perp_velocity [(24), (25)], solved for k3",
        "theta0 by 0.0001",
        "Duration 30 time units",
        "phase tolerance 1e-05 rad",
        "within 0.001 rad per time unit",
        f"Precession Atlas {atlas.__version__} (kernel {small.attrs['atlas_kernel_hash']})",
        "10.22055/JACM.2021.37913.3113",
    ):
        assert words in caption
    assert "theta0 = 0.8" in style.caption(select.nearest(small, {"theta0": 0.8}))
    printed = maps.atlas_map(small, caption=True).texts[0].get_text()
    assert " ".join(printed.split()) == caption
    points = atlas.label_points("satellite", {"theta0": [0.1, 0.2]}, duration=1.0, step=0.1)
    assert "step 0.1" in style.caption(points)
