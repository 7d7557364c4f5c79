"""Figures of trajectories: they show the motion, enlarged where it is small, and explain every mark."""

import re
from pathlib import Path

import numpy as np
import pytest
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.text import Text
from PIL import Image, ImageSequence

import atlas
from atlas import BadInput, load_scene
from atlas.label.trajectory import trajectory_of_scene
from atlas.plotting import options, style, trajectory

pytestmark = pytest.mark.usefixtures("whole_kernels")


def test_a_trajectory_figure_shows_the_motion():
    tr = atlas.trajectory("satellite", {"theta0": 1.0, "n": 0.3, "m": 0.4}, duration=20.0, samples=201)
    figure = trajectory.trajectory_figure(tr)
    assert figure.get_figwidth() * 25.4 == pytest.approx(options.WIDTHS["page"])
    theta_ax, angle_ax, rate_ax, sphere_ax = figure.axes
    np.testing.assert_array_equal(theta_ax.lines[0].get_ydata(), tr.theta)
    psi = angle_ax.lines[0].get_ydata()
    finite = np.isfinite(psi)
    np.testing.assert_allclose(np.exp(1j * psi[finite]), np.exp(1j * tr.psi.values[finite]), atol=1e-12)
    assert [t.get_text() for t in rate_ax.get_legend().get_texts()] == [
        style.SYMBOLS[n] for n in trajectory.PLOTTED_RATES
    ]
    # the near and the far part of the path are the whole path, inside the disc
    near, far = sphere_ax.lines[-2].get_xydata(), sphere_ax.lines[-3].get_xydata()
    assert (np.isfinite(near[:, 0]) ^ np.isfinite(far[:, 0])).all()
    assert np.nanmax(np.hypot(*np.where(np.isfinite(near), near, far).T)) <= 1 + 1e-9
    assert [t.get_text() for t in sphere_ax.texts] == ["radius", "velocity", "normal"]


@pytest.fixture(scope="module")
def nutation():
    """The motion of an upright top."""
    start = {"C": 0.4, "Mg": 1.0, "z0": 1.0, "theta0": 2.6, "n": 0.0, "m": 8.0}
    return atlas.trajectory("fixed_point", start, duration=10.0, samples=301)


def path_of(ax):
    """The path on the sphere, near and far parts together."""
    near, far = ax.lines[-2].get_xydata(), ax.lines[-3].get_xydata()
    return np.where(np.isfinite(near), near, far), np.isfinite(near[:, 0])


def test_up_is_at_the_top_of_the_sphere_also_where_the_third_axis_of_the_frame_points_down(nutation):
    """Drawn by own projections of the axis in a frame of x, -y and up, which is right-handed."""
    axis = np.stack([nutation.axis_x, -nutation.axis_y, -nutation.axis_z], -1)
    assert (axis[:, 2] > 0.7).all()
    for view in ((40.0, 25.0), (-100.0, 0.0), (10.0, 90.0)):
        figure = trajectory.trajectory_figure(nutation, view=view)
        azimuth, elevation = np.radians(view)
        right = np.array([-np.sin(azimuth), np.cos(azimuth), 0.0])
        viewer = np.array(
            [*(np.cos(elevation) * np.array([np.cos(azimuth), np.sin(azimuth)])), np.sin(elevation)]
        )
        drawn, near = path_of(figure.axes[3])
        np.testing.assert_allclose(
            drawn, np.stack([axis @ right, axis @ np.cross(viewer, right)], -1), atol=1e-12
        )
        np.testing.assert_array_equal(near, axis @ viewer >= 0)
        start = figure.axes[3].lines[-1].get_xydata()[0]
        np.testing.assert_allclose(start, drawn[0], atol=1e-12)
    texts = {text.get_text(): text.get_position() for text in figure.axes[3].texts}
    assert texts.keys() == {"$x$", "$y$", "down (\N{GREEK SMALL LETTER GAMMA})"}
    satellite = atlas.trajectory("satellite", {"theta0": 1.0, "n": 0.3, "m": 0.4}, duration=2.0, samples=21)
    drawn, _ = path_of(trajectory.trajectory_figure(satellite, view=(0.0, 0.0)).axes[3])
    np.testing.assert_allclose(drawn, np.stack([satellite.axis_y, satellite.axis_z], -1), atol=1e-12)


def test_a_motion_in_degrees_and_of_another_width(nutation):
    theta_ax, angle_ax, rate_ax, _ = trajectory.trajectory_figure(nutation, degrees=True, width=120.0).axes
    np.testing.assert_allclose(theta_ax.lines[0].get_ydata(), np.degrees(nutation.theta))
    assert "deg" in theta_ax.get_ylabel()
    assert angle_ax.get_ylim() == (-180, 180)
    np.testing.assert_array_equal(rate_ax.lines[1].get_ydata(), nutation.psi_dot)
    figure = nutation.atlas.plot(width="column")
    assert figure.get_figwidth() * 25.4 == pytest.approx(options.WIDTHS["column"])
    figure.draw_without_rendering()
    sphere, rates = figure.axes[3].get_window_extent(), figure.axes[2].get_window_extent()
    assert sphere.y1 < rates.y0


@pytest.mark.parametrize(
    ("bad", "message"),
    [
        ({"view": (1.0,)}, "view = (1.0,): must be azimuth and elevation in degrees, from -90 to 90"),
        (
            {"view": (0.0, 91.0)},
            "view = (0.0, 91.0): must be azimuth and elevation in degrees, from -90 to 90",
        ),
        ({"degrees": 2}, "degrees = 2: must be true or false"),
        ({"width": 3.0}, "width = 3.0: allowed: column, page, or 20 to 2000 mm"),
    ],
)
def test_wrong_options_of_motions_are_named(nutation, bad, message):
    with pytest.raises(atlas.BadInput) as error:
        nutation.atlas.plot(**bad)
    assert str(error.value) == message


@pytest.mark.long
def test_the_panel_of_rates_says_where_it_is_clipped(tmp_path):
    tr = atlas.trajectory("satellite", {"theta0": 1.0, "n": 0.3, "m": 0.4}, duration=20.0, samples=201)
    rates = trajectory.trajectory_figure(tr).axes[2]
    assert rates.get_title(loc="right") == ""
    tr["psi_dot"][5] = -4321.0
    figure = trajectory.trajectory_figure(tr)
    rates = figure.axes[2]
    high = rates.get_ylim()[1]
    assert rates.get_title(loc="right") == f"clipped at $\\pm${high:.2g}; largest magnitude 4.3e+03"
    figure.savefig(tmp_path / "motion.png", dpi=100)
    figure.draw_without_rendering()
    (title,) = [text for text in rates.findobj(Text) if text.get_text().startswith("clipped")]
    box = title.get_window_extent()
    assert box.x0 > figure.bbox.x0
    assert not box.overlaps(figure.axes[1].get_window_extent())
    assert not box.padded(-0.5).overlaps(
        rates.get_window_extent()
    )  # Matplotlib 3.10 rounds the box to pixels


def small_motion(theta0):
    """Librations of 1e-4 rad about a stable steady motion."""
    scene = "stability_perp_radius" if theta0 else "stability_cylindrical"
    scene = load_scene(Path(__file__).parents[2] / "configs" / f"{scene}.toml")
    return trajectory_of_scene(
        scene, {"sigma": 1.5} | ({"theta0": theta0} if theta0 else {"m": 0.4}), samples=301
    )


@pytest.mark.usual("0.8")
@pytest.mark.parametrize("theta0", [0.0, 0.8])
def test_a_small_path_is_enlarged(theta0):
    """Sideways sin(theta) dpsi, upward -dtheta; about the vertical the components in the frame."""
    tr = small_motion(theta0)
    figure = trajectory.trajectory_figure(tr)
    ax = figure.axes[-1]
    assert "10^{-4}" in ax.get_xlabel()
    drawn = 1e-4 * ax.lines[0].get_xydata()
    if theta0:
        expected = [np.sin(tr.theta) * tr.psi, -tr.theta]
        assert ax.get_ylabel().startswith("upward")
    else:
        expected = [tr.axis_x, tr.axis_y]
        assert ax.get_ylabel().startswith("along velocity")
    for offset, exact in zip(drawn.T, expected, strict=True):
        np.testing.assert_allclose(offset - offset.mean(), exact - exact.mean(), atol=1e-7)
    np.testing.assert_allclose(ax.lines[1].get_xydata()[0], ax.lines[0].get_xydata()[0])
    FigureCanvasAgg(figure).draw()
    offset = figure.axes[0].yaxis.get_offset_text().get_text()
    assert ("10^{\N{MINUS SIGN}4}" in offset) == (theta0 == 0)


def test_an_axis_at_rest_is_named():
    tr = small_motion(0.8)
    for name in "xyz":
        tr[f"axis_{name}"][:] = tr[f"axis_{name}"][0]
    figure = trajectory.trajectory_figure(tr)
    assert re.fullmatch(r"third axis at rest within \de-1[56] rad", figure.axes[3].get_title())
    assert len(figure.axes) == 4


def test_names_of_the_axes_are_beside_the_disc():
    figure = trajectory.trajectory_figure(small_motion(0.8))
    for text in figure.axes[3].texts:
        assert np.hypot(*text.get_position()) > 1.1


def test_every_mark_of_a_trajectory_is_explained():
    figure = trajectory.trajectory_figure(small_motion(0.8))
    left, right = figure.subfigs
    assert [text.get_text() for text in right.legends[0].get_texts()] == [
        "third axis, near side", "far side", "start",
    ]  # fmt: skip
    assert right.legends[0].get_lines()[2].get_marker() == figure.axes[3].lines[-1].get_marker() == "o"
    assert left.get_supxlabel().startswith(style.SYMBOLS["normal_rate"])


def test_rates_that_diverge_near_the_vertical_do_not_hide_the_others():
    tr = atlas.trajectory("satellite", {"theta0": 1.0, "n": 0.3}, duration=20.0, samples=201)
    tr["psi_dot"][100] = 1e6
    assert trajectory.trajectory_figure(tr).axes[2].get_ylim()[1] < 100


def test_down_is_named_where_gamma_points_down():
    tr = atlas.trajectory("fixed_point", {"theta0": 2.9, "m": 6.0, "psi0": 0.1}, duration=1.0, samples=50)
    figure = trajectory.trajectory_figure(tr)
    texts = [text.get_text() for ax in figure.axes for text in ax.texts]
    assert "down (\N{GREEK SMALL LETTER GAMMA})" in texts
    assert any(ax.get_ylabel().startswith("downward") for ax in figure.axes)
    assert tr.axis_z.long_name == "third axis along down (\N{GREEK SMALL LETTER GAMMA})"


def test_a_motion_is_drawn_from_its_dataset():
    tr = atlas.trajectory("satellite", {"theta0": 1.0, "n": 0.3, "m": 0.4}, duration=20.0, samples=201)
    assert len(tr.atlas.plot().axes) == 4
    figure = Figure()
    left, right = figure.subplots(1, 2)
    assert tr.atlas.plot(ax=left) is figure
    assert [text.get_text() for text in left.texts] == ["radius", "velocity", "normal"]
    assert not right.lines
    for call in (lambda: tr.atlas.plot(ax=3), tr[["theta"]].atlas.plot, tr[["theta"]].atlas.animate):
        with pytest.raises(BadInput, match=r"Axes of Matplotlib|not a trajectory: psi is missing"):
            call()


def test_an_animation_shows_the_axis_at_each_instant(tmp_path, monkeypatch):
    tr = atlas.trajectory("satellite", {"theta0": 1.0, "n": 0.3, "m": 0.4}, duration=20.0, samples=41)
    tr.atlas.animate(tmp_path / "a.gif", seconds=0.2)
    with Image.open(tmp_path / "a.gif") as film:
        assert film.n_frames == 5
        assert film.info["duration"] == 40  # ms
        pictures = [np.asarray(frame.convert("RGB")) for frame in ImageSequence.Iterator(film)]
    assert (pictures[0] != pictures[-1]).any()
    film = tr.atlas.animate(seconds=100.0)
    assert len([*film.new_frame_seq()]) == 41  # as many as samples
    film._func(40)
    (ax,) = film._fig.axes
    assert ax.get_title() == "20 s"
    pointers = [line.get_xydata() for line in ax.lines if line.get_color() == "black"]
    (pointer,) = [each for each in pointers if np.isfinite(each).all()]
    trace = [
        line.get_xydata() for line in ax.lines if line.get_color() == style.COLOURS["regular_precession"]
    ]
    ends = [each[-1] for each in trace if np.isfinite(each[-1]).all()]
    np.testing.assert_allclose(pointer[0], 0.0, atol=1e-8)
    np.testing.assert_allclose(pointer[1], ends[0])
    assert "<script" in tr.atlas.animate(seconds=0.1)._repr_html_()
    film._draw_was_started = True  # else Matplotlib warns that nothing was drawn
    monkeypatch.setitem(trajectory.ANIMATIONS, ".mp4", type("Missing", (), {"isAvailable": lambda: False}))
    for name, named in (("a.mp4", "needs the program ffmpeg"), ("a.png", "must end in .gif or .mp4")):
        with pytest.raises(BadInput, match=named):
            tr.atlas.animate(tmp_path / name)
    with pytest.raises(BadInput, match="seconds = 0"):
        tr.atlas.animate(seconds=0.0)
    assert [path.name for path in tmp_path.iterdir()] == ["a.gif"]
