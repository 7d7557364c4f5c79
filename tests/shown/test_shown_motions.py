"""Pictures, numbers and lists of one motion are those of its dataset, of own projections, and of a closed form."""

import importlib

import numpy as np
import pytest
from matplotlib.figure import Figure
from plugins import PENDULUM
from readers import look

import atlas
from atlas.plotting import style, trajectory

pytestmark = pytest.mark.usefixtures("whole_kernels")

START = {"theta0": 1.0, "n": 0.3, "m": 0.4, "psi0": 0.2, "phi0": -0.4}


@pytest.fixture(scope="module")
def motion():
    return atlas.trajectory("satellite", START, duration=20.0, samples=201)


def curves(ax) -> dict[str, np.ndarray]:
    """Curves of a panel by the entries of its legend that look like them."""
    samples = zip(ax.get_legend().get_texts(), ax.get_legend().get_lines(), strict=True)
    return {
        text.get_text(): line.get_xydata()
        for text, sample in samples
        for line in ax.lines
        if look(line) == look(sample)
    }


@pytest.mark.parametrize(("degrees", "unit"), [(False, "rad"), (True, "deg")])
def test_every_curve_over_time_is_the_one_of_its_entry(motion, degrees, unit):
    theta, angles, rates, _ = motion.atlas.plot(degrees=degrees).axes
    size = 180 / np.pi if degrees else 1.0
    assert [ax.get_ylabel() for ax in (theta, angles, rates)] == [
        rf"$\theta$ ({unit})", rf"$\psi$, $\varphi$ ({unit})", "rates (rad s$^{-1}$)",
    ]  # fmt: skip
    assert rates.get_xlabel() == "time (s)"
    np.testing.assert_allclose(theta.lines[0].get_xydata(), np.stack([motion.time, size * motion.theta], -1))
    names = {text: name for name, text in style.SYMBOLS.items()}
    assert {names[text] for text in curves(angles)} == {"psi", "phi"}
    for text, drawn in curves(angles).items():
        value = motion[names[text]].values
        turns = (drawn[:, 1] / size - value) / (2 * np.pi)
        seen = np.isfinite(turns)
        assert seen.mean() > 0.95
        np.testing.assert_allclose(turns[seen], np.round(turns[seen]), atol=1e-9)
    assert {names[text] for text in curves(rates)} == {"theta_dot", "psi_dot", "phi_dot", "normal_rate"}
    for text, drawn in curves(rates).items():
        np.testing.assert_array_equal(drawn, np.stack([motion.time, motion[names[text]]], -1))
    marked = dict(zip(angles.get_yticks(), [t.get_text() for t in angles.get_yticklabels()], strict=True))
    half = 180.0 if degrees else np.pi
    assert marked == dict(
        zip(
            (-half, 0.0, half), ("$-180$", "0", "180") if degrees else (r"$-\pi$", "0", r"$\pi$"), strict=True
        )
    )


def test_symbols_are_those_of_the_angles_and_of_their_rates():
    """Curves and bars are named by this table."""
    assert style.SYMBOLS == {
        "theta": r"$\theta$", "psi": r"$\psi$", "phi": r"$\varphi$", "theta_dot": r"$\dot\theta$",
        "psi_dot": r"$\dot\psi$", "phi_dot": r"$\dot\varphi$", "normal_rate": r"$\omega'\cdot\gamma$",
    }  # fmt: skip


def test_the_axes_of_the_sphere_are_a_right_handed_frame_seen_from_outside(motion):
    """Each name is where the axis points; a path is strong on the side of the viewer, and begins at its mark."""
    sphere = motion.atlas.plot(view=(40.0, 25.0)).axes[3]
    azimuth, elevation = np.radians([40.0, 25.0])
    right, up = np.array([[-np.sin(azimuth), np.cos(azimuth), 0.0], [0.0, 0.0, 1.0]])
    viewer = np.array(
        [np.cos(azimuth) * np.cos(elevation), np.sin(azimuth) * np.cos(elevation), np.sin(elevation)]
    )
    up = up - viewer * (viewer @ up)
    up = up / np.linalg.norm(up)
    for text, axis in zip(sphere.texts, np.eye(3), strict=True):
        place, tip = np.array(text.get_position()), np.array([axis @ right, axis @ up])
        np.testing.assert_allclose(place / np.hypot(*place), tip / np.hypot(*tip), atol=1e-9)
    assert [text.get_text() for text in sphere.texts] == ["radius", "velocity", "normal"]
    far, near, start = sphere.lines[-3:]
    assert near.get_alpha() == 1 > far.get_alpha()
    assert near.get_zorder() > far.get_zorder()
    path = np.stack([motion.axis_x, motion.axis_y, motion.axis_z], -1)
    is_near = path @ viewer >= 0
    assert 0.1 < is_near.mean() < 0.9
    for line, mask in ((near, is_near), (far, ~is_near)):
        expected = np.where(mask[:, None], np.stack([path @ right, path @ up], -1), np.nan)
        np.testing.assert_allclose(line.get_xydata(), expected, atol=1e-12)
    np.testing.assert_allclose(start.get_xydata()[0], [path[0] @ right, path[0] @ up], atol=1e-12)


def test_the_legend_of_the_sphere_looks_like_the_path(motion):
    figure = motion.atlas.plot()
    legend = figure.subfigs[1].legends[0]
    texts = dict(zip([text.get_text() for text in legend.get_texts()], legend.get_lines(), strict=True))
    far, near, start = figure.axes[3].lines[-3:]
    assert texts["far side"].get_alpha() == far.get_alpha() < 1
    assert texts["third axis, near side"].get_alpha() in (None, near.get_alpha())
    colours = [texts[text].get_color() for text in ("third axis, near side", "far side")]
    assert colours == [near.get_color(), far.get_color()]
    assert look(texts["start"]) == look(start)


def test_the_meridian_of_the_start_is_that_of_psi0():
    """The third axis leans to the radius sin(psi) sin(theta), to the velocity -cos(psi) sin(theta), to the normal cos(theta)."""
    start = {"theta0": 0.7, "psi0": 0.9}
    tr = atlas.trajectory("satellite", start, duration=0.1, samples=3)
    expected = [np.sin(0.9) * np.sin(0.7), -np.cos(0.9) * np.sin(0.7), np.cos(0.7)]
    np.testing.assert_allclose([tr.axis_x[0], tr.axis_y[0], tr.axis_z[0]], expected, atol=1e-12)


def test_directions_of_an_enlarged_path():
    """A tilt towards the vertical is up, a turn about it sideways, to the left seen from outside and above."""
    tr = atlas.trajectory("satellite", {"theta0": 1.0}, duration=1.0, samples=101)
    small = 1e-3 * np.linspace(0, 1, 101)
    for theta, psi, moved in ((1.0 - small, 0 * small, 1), (1.0 + 0 * small, small, 0)):
        path = tr.assign(
            axis_x=("time", np.sin(psi) * np.sin(theta)), axis_y=("time", -np.cos(psi) * np.sin(theta)),
            axis_z=("time", np.cos(theta)),
        )  # fmt: skip
        ax = path.atlas.plot().axes[4]
        assert ax.get_xlabel().startswith("sideways")
        assert ax.get_ylabel().startswith("upward")
        exponent = int(ax.get_xlabel().partition("10^{")[2].partition("}")[0])
        drawn = ax.lines[0].get_xydata() * 10.0**exponent
        change = drawn[-1] - drawn[0]
        length = 1e-3 if moved == 1 else 1e-3 * np.sin(1.0)
        assert change[moved] == pytest.approx(length, rel=1e-3)
        assert abs(change[1 - moved]) < 1e-5


@pytest.mark.long
def test_observables_of_another_system_have_their_names_and_units(tmp_path, monkeypatch, own_systems):
    (tmp_path / "pendulum_of_shown.py").write_text(PENDULUM)
    monkeypatch.syspath_prepend(tmp_path)
    atlas.register(importlib.import_module("pendulum_of_shown").Pendulum)
    tr = atlas.trajectory("pendulum", {"omega": 1.2, "x0": 0.8, "cubic": 0.1}, duration=5.0, samples=51)
    for degrees, unit, size in ((False, "rad", 1.0), (True, "deg", 180 / np.pi)):
        x, height = tr.atlas.plot(degrees=degrees).axes
        assert (x.get_ylabel(), height.get_ylabel(), height.get_xlabel()) == (
            f"$x$ ({unit})",
            "height",
            "time (s)",
        )
        np.testing.assert_allclose(x.lines[0].get_ydata(), size * tr.x)
        np.testing.assert_allclose(height.lines[0].get_ydata(), 1 - np.cos(tr.x), atol=1e-12)


def test_a_film_shows_time_and_axis(motion):
    film = motion.atlas.animate(seconds=100.0)
    film._func(150)
    film._draw_was_started = True  # else Matplotlib warns that nothing was drawn
    (ax,) = film._fig.axes
    assert ax.get_title() == "15 s"
    sphere = trajectory.Sphere(Figure().subplots(), ["x", "y", "z"])
    end = sphere.project(np.array([motion.axis_x[150], motion.axis_y[150], motion.axis_z[150]]))
    pointers = [line.get_xydata()[-1] for line in ax.lines if line.get_color() == "black"]
    np.testing.assert_allclose([each for each in pointers if np.isfinite(each).all()], [end], atol=1e-9)
