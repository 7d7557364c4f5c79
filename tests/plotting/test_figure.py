"""Several panels in one figure, and the public style: everything is inside the canvas, and no text covers another."""

from itertools import combinations

import matplotlib
import matplotlib.pyplot as plt
import numpy as np
import pytest
from matplotlib.backends.backend_agg import RendererAgg
from matplotlib.collections import QuadMesh
from matplotlib.font_manager import FontProperties

import atlas
from atlas.plotting import style

pytestmark = pytest.mark.usefixtures("whole_kernels")

WIDTHS = (85, 180)  # mm


@pytest.fixture(scope="module")
def small(small_scene):
    return atlas.run(small_scene, progress=False)


@pytest.fixture(scope="module")
def radius(scene_text):
    """The same plane for the motion perpendicular to the radius."""
    changes = {"family.name": "perp_radius", "ties.psi0": "0"}
    return atlas.run(scene_text(changes), progress=False)


@pytest.fixture(scope="module")
def points():
    values = np.linspace(0.3, 1.2, 12)
    given = {"theta0": values, "m": values[::-1], "C": 0.8}
    return atlas.label_points("satellite", given, duration=5.0, step=0.1)


def legend(figure):
    return [entry.get_text().replace("\n", " ") for each in figure.legends for entry in each.get_texts()]


def assert_legible(figure, mm):
    """No text or panel leaves the canvas, and none overlaps the legend or another."""
    figure.draw_without_rendering()
    assert figure.get_figwidth() * 25.4 == pytest.approx(mm)
    canvas = figure.bbox
    texts = [text for text in figure.texts if text.get_text()]
    boxes = {each: each.get_tightbbox() for each in [*figure.axes, *figure.legends]}
    boxes |= {each: each.get_window_extent() for each in texts}
    for what, box in boxes.items():
        assert canvas.x0 - 1 <= box.x0 < box.x1 <= canvas.x1 + 1, what
        assert canvas.y0 - 1 <= box.y0 < box.y1 <= canvas.y1 + 1, what
    for (what, box), (other, beside) in combinations(boxes.items(), 2):
        shared = matplotlib.transforms.Bbox.intersection(box, beside)
        assert shared is None or min(shared.width, shared.height) < 1, (what, other)


LONG = "The first of two motions whose names are too long for a panel of a column"


@pytest.mark.long
@pytest.mark.parametrize("mm", WIDTHS)
@pytest.mark.parametrize("columns", [None, 1])
def test_texts_of_panels_are_inside_and_apart(small, radius, points, mm, columns):
    figures = [
        atlas.figure([small], width=mm, title=LONG, columns=columns),
        atlas.figure({LONG: small, "radius": radius}, width=mm, degrees=True, columns=columns),
        atlas.figure([small, (small, "growth_rate")], width=mm, title=LONG, columns=columns),
        atlas.figure([small, points, (points, "theta_max")], width=mm, columns=columns, caption=True),
        atlas.figure([small.isel(theta0=3), (radius.isel(theta0=3), "theta_max")], width=mm, columns=columns),
        atlas.figure([small, radius], width=mm, columns=columns, labels={"drifting": f"{LONG}, {LONG}"}),
    ]
    for figure in figures:
        assert_legible(figure, mm)


@pytest.mark.long
def test_lines_of_captions_fit_whatever_the_hash(points):
    """The hash differs between processors, and letters are wider or narrower on a screen than in print."""
    renderers = {dpi: RendererAgg(1, 1, dpi) for dpi in (100, 300, style.PRINT_DPI)}
    generator, font = np.random.default_rng(7), FontProperties(family=style.FONT, size=6.5)
    for mm in generator.uniform(80, 180, 200):
        ds = points.assign_attrs(atlas_kernel_hash=generator.bytes(8).hex())
        words, screen = style.caption(ds).split(), int(generator.choice([100, 300]))
        before = words.index("(kernel") - generator.integers(5, 20)
        for line in style.wrapped(" ".join(words[before:]), mm, 6.5, screen).split("\n")[:3]:
            for dpi in (screen, style.PRINT_DPI):
                drawn = renderers[dpi].get_text_width_height_descent(line, font, False)[0]
                assert drawn / dpi * 25.4 <= mm, (dpi, line)


@pytest.mark.long
@pytest.mark.parametrize("mm", WIDTHS)
def test_figures_fit_whatever_the_hash(small, points, mm):
    ds = points.assign_attrs(atlas_kernel_hash=np.random.default_rng(mm).bytes(8).hex())
    figure = atlas.figure([small, ds], width=mm, caption=True)
    assert_legible(figure, mm)
    figure.set_dpi(style.PRINT_DPI)
    assert_legible(figure, mm)


@pytest.mark.usual("85")
@pytest.mark.parametrize("mm", WIDTHS)
def test_names_become_panels(small, radius, mm):
    joined = atlas.concat({"v": small, "r": radius}, "kind")
    figure = joined.atlas.map(col="kind", width=mm)
    assert_legible(figure, mm)
    assert [ax.get_title() for ax in figure.axes] == ["v", "r"]
    alone = {text for ds in (small, radius) for text in legend(ds.atlas.map())}
    assert set(legend(figure)) == alone
    for ax, ds in zip(figure.axes, (small, radius), strict=True):
        (mesh,) = [c for c in ax.collections if isinstance(c, QuadMesh)]
        np.testing.assert_array_equal(
            np.ravel(mesh.get_array()), ds.label.transpose("theta0", "sigma").values.ravel()
        )
        own, drawn = (
            [line.get_xydata() for line in each.lines if len(line.get_xdata())]
            for each in (ds.atlas.map().axes[0], ax)
        )  # without the samples of the legend
        assert len(own) == len(drawn) > 0
        for line, other in zip(drawn, own, strict=True):
            np.testing.assert_array_equal(line, other)
    figure = joined.atlas.map("theta_max", row="kind", width=mm)
    assert_legible(figure, mm)
    left, right, bar = figure.axes
    assert left.collections[0].norm.vmax == right.collections[0].norm.vmax == float(joined.theta_max.max())
    assert (figure.get_supxlabel(), bar.get_ylabel()) == ("$C/A$", r"largest $\theta$ (rad)")


@pytest.mark.long
def test_names_and_numbers_span_rows_and_columns(small, radius):
    cut = [ds.isel(theta0=[1, 3, 5]) for ds in (small, radius)]
    joined = atlas.concat({"v": cut[0], "r": cut[1]}, "kind")
    for place, shape in (
        ({"row": "theta0", "col": "kind"}, (3, 2)),
        ({"row": "kind", "col": "theta0"}, (2, 3)),
    ):
        figure = joined.atlas.map("theta_dot_rms", width="page", x="sigma", **place)
        assert_legible(figure, 180)
        assert len(figure.axes) == 6
        titles = [ax.get_title() for ax in figure.axes]
        assert all(titles[: shape[1]])
        assert not any(titles[shape[1] :])
        ends = [ax.texts[0].get_text() for ax in figure.axes[shape[1] - 1 :: shape[1]]]
        assert (titles[:2] if place["col"] == "kind" else ends) == ["v", "r"]
        for ax, (i, j) in zip(figure.axes, np.ndindex(shape), strict=True):
            kind, theta = (j, i) if place["col"] == "kind" else (i, j)
            values = joined.theta_dot_rms.isel(kind=kind, theta0=theta)
            np.testing.assert_array_equal(ax.lines[0].get_ydata(), values.where(values > 0))


def test_flags_of_one_name_and_two_colours_have_an_entry_each(small):
    values = np.full(small.label.shape, 2, np.int8)
    for name, meanings in (("few", "none one two"), ("many", "none one two three four")):
        attributes = {"long_name": f"{name} flags", "flag_meanings": meanings}
        small = small.assign({name: (small.label.dims, values, attributes)})
    figure = atlas.figure([(small, "few"), (small, "many"), (small, "label")], boundary=False)
    assert legend(figure)[:2] == ["two", "two (many)"]
    assert legend(figure)[2:] == legend(small.atlas.map("label", boundary=False))
    colours = [each.get_facecolor() for each in figure.legends[0].legend_handles]
    assert len(set(colours)) == len(colours)


def test_flags_of_a_result_become_panels(small):
    fractions = small.expand_dims(draw=[0, 1]).atlas.probability(over="draw")
    figure = fractions.atlas.map("probability", col="label", columns=3, boundary=False)
    assert [ax.get_title() for ax in figure.axes[:5]] == list(fractions.label.values)
    assert len(figure.axes) == 6


@pytest.mark.long
def test_panels_share_what_they_have_in_common(small, radius):
    one = atlas.figure([small, (small, "predicted")])
    assert [bool(ax.get_ylabel()) for ax in one.axes] == [False, False]
    assert one.axes[0].get_shared_y_axes().joined(*one.axes)
    two = atlas.figure([small, radius.isel(sigma=slice(4))])
    assert not two.axes[0].get_shared_x_axes().joined(*two.axes)
    assert two.axes[0].get_shared_y_axes().joined(*two.axes)
    assert len(atlas.figure(small).axes) == 1
    three = atlas.figure([small] * 3, columns=1, boundary=False)
    assert [ax.get_subplotspec().rowspan.start for ax in three.axes] == [0, 1, 2]


@pytest.mark.usual("85-85", "column-88")
@pytest.mark.parametrize(("width", "mm"), [("column", 88), ("page", 180), (85, 85)])
def test_figures_of_the_caller_have_the_style(small, width, mm):
    before = dict(matplotlib.rcParams)
    with atlas.style(width):
        figure, (left, right) = plt.subplots(1, 2, sharey=True)
        small.atlas.map(ax=left, legend=False)
        right.plot([1, 2], label="a curve")
        figure.legend(loc="outside upper center")
        assert left.xaxis.label.get_fontsize() == 8
        assert_legible(figure, mm)
    plt.close(figure)
    assert dict(matplotlib.rcParams) == before
