"""Borders of theory: those of closed forms, traced as finely as they need, kept, and given as data."""

from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import xarray as xr
from scenes import plane

import atlas
from atlas import BadInput, load_scene
from atlas.analysis import boundary, tracer
from atlas.analysis import plane as planes
from atlas.flags import Label
from atlas.kernel.compiling import announced

pytestmark = pytest.mark.usefixtures("whole_kernels")

QUICKSTART = Path(__file__).parents[2] / "configs" / "quickstart.toml"


@pytest.fixture(scope="module")
def small(small_scene):
    return atlas.run(load_scene(small_scene), progress=False)


def growth_rate(sigma, theta, m):
    """Largest growth of perp-velocity precession (mu = 0) by a numerical Jacobian of the equations of motion."""
    from atlas.systems.satellite import equations, families, initial

    p = {n: np.array(q.default) for n, q in initial.PARAMETERS.items()}
    p |= {"C": np.array(sigma), "theta0": np.array(theta), "m": np.array(m), "psi0": np.array(np.pi / 2)}
    p["k3"] = families.FAMILIES["perp_velocity"].solve["k3"](p)
    points = {n: np.atleast_1d(v) for n, v in p.items()}
    state, constants = initial.initial_state(points)[:, 0], initial.constants(points)[:, 0]
    # in the axes of the node, in which a symmetric body rotates about e3 at m and its motion is steady
    rotation = np.zeros((9, 9))
    generator = np.array([[0, 1, 0], [-1, 0, 0], [0, 0, 0]]) * m
    for i in (0, 3, 6):
        rotation[i : i + 3, i : i + 3] = generator
    steps = np.eye(9) * 1e-6
    jacobian = np.array(
        [
            (np.array(equations.rhs(state + s, constants)) - np.array(equations.rhs(state - s, constants)))
            / 2e-6
            for s in steps
        ]
    ).T
    return np.linalg.eigvals(jacobian - rotation).real.max()


def test_the_stability_limit_separates_growth_from_none(small_scene):
    view = plane(small_scene)
    lines = boundary.theory_borders(view)[boundary.STABILITY]
    vertices = np.concatenate(lines)
    assert len(vertices) > 100
    steps = np.array([[0.02, 0.0], [-0.02, 0.0], [0.0, 0.02], [0.0, -0.02]])
    for vertex in vertices[:: len(vertices) // 12]:
        growth = [growth_rate(*(vertex + s), 0.5) for s in steps]
        assert max(growth) > 1e-2, vertex
        assert min(growth) < 1e-3, vertex


@pytest.mark.long
def test_the_stability_limit_is_sharp(small_scene):
    vertices = np.concatenate(boundary.theory_borders(plane(small_scene))[boundary.STABILITY])
    sigma, u = vertices[:, 0], np.cos(vertices[:, 1]) ** 2
    # closed form for mu = 0: lambda^4 + P lambda^2 + Q = 0 in units of Omega
    P, Q = 7 - 6 * sigma + 9 * sigma * (sigma - 1) * u, 3 * (sigma - 1) * (3 * sigma - 4) * (1 - u)
    root = np.sqrt(np.maximum(Q, 1e-300))
    resonance = np.where(Q > 0, P - 2 * root, np.inf)
    # the distance in the plane, because the square root is steep near Q = 0
    along_sigma = 9 * (2 * sigma - 1) * u - 6 - 3 * (6 * sigma - 7) * (1 - u) / root
    along_u = 9 * sigma * (sigma - 1) + 3 * (sigma - 1) * (3 * sigma - 4) / root
    slope = np.hypot(along_sigma, along_u * np.sin(2 * vertices[:, 1]))
    off = np.min([abs(sigma - 1), abs(sigma - 4 / 3), abs(resonance / np.maximum(1, slope))], 0)
    assert off.max() < 1e-4


def test_the_stability_limit_on_one_axis(small_scene):
    (first, second) = boundary.theory_borders(plane(small_scene, theta0=0.5))[boundary.STABILITY]
    assert (float(first[0, 0]), float(second[0, 0])) == pytest.approx((1.0, 4 / 3), abs=1e-4)


@pytest.mark.long
def test_borders_of_the_quickstart_are_those_of_the_formulas():
    scene = load_scene(QUICKSTART)
    view = planes.Plane(scene, {"l3": (-2.5, 2.5), "n": (-2.0, 2.0)}, {})
    borders = boundary.theory_borders(view)
    assert set(borders) == {boundary.STABILITY, boundary.LABEL}
    l3, n = np.concatenate(borders[boundary.LABEL]).T
    # there (C - A)(n^2 - N) cos theta + (C m + l3) n + Mg z0 = 0 with cos theta = 1 or -1
    edge = np.abs(-0.6 * (n**2 - 2.0)) - np.abs((0.2 + l3) * n + 0.3)
    assert np.abs(edge).max() < 1e-3
    l3, n = np.concatenate(borders[boundary.STABILITY]).T
    cosine = ((0.2 + l3) * n + 0.3) / (0.6 * (n**2 - 2.0))
    # frequency squared of small nutations at constant momenta, from the reduced potential of Lagrange's case
    spin = 0.4 * (0.5 + n * cosine) + l3
    stiffness = (n**2 - 0.6 * 2.0) * (1 - cosine**2) + (2 * n * cosine - spin) ** 2
    np.testing.assert_allclose(stiffness, 0, atol=1e-3)


@pytest.mark.long
def test_lines_are_kept_for_later_processes(small, tmp_path, monkeypatch, capsys):
    monkeypatch.setenv("ATLAS_CACHE", str(tmp_path))
    for name in ("ANNOUNCED", "WORTH_KEEPING"):
        monkeypatch.setattr(tracer, name, 0.0)
    with announced(True):
        lines = small.atlas.boundary()
    assert "tracing the lines of theory" in capsys.readouterr().err
    (kept,) = (tmp_path / "lines").iterdir()

    def trace(plane):
        traced.append(plane)
        return {boundary.STABILITY: []}

    traced: list[planes.Plane] = []
    monkeypatch.setattr(boundary, "theory_borders", trace)
    xr.testing.assert_identical(small.atlas.boundary(), lines)
    assert not traced
    small.isel(sigma=slice(1, None)).atlas.boundary()  # another plane
    assert len(traced) == 1
    kept.write_text(kept.read_text().replace("1", "2"))
    assert small.atlas.boundary().sizes["vertex"] == 0
    assert len(traced) == 2


def test_straight_lines_have_few_vertices_and_bent_ones_as_many_as_they_need():
    """Stable inside a circle, and beyond a straight line."""

    def theory(places):
        x, y = places["x"], places["y"]
        stable = (np.hypot(x - 0.3, y - 0.6) < 0.2) | (x + 0.3 * y > 0.9)
        ones = np.ones(x.shape)
        frames = {"": (2 * ones, {"n": ones, "m": ones})}
        return planes.Predictions(ones.astype(bool), np.where(stable, 1, 2), frames)

    line, circle = sorted(boundary.theory_borders(drawn_plane(theory, "xy"))[boundary.STABILITY], key=len)
    np.testing.assert_allclose(line @ [1, 0.3], 0.9, atol=2e-5)
    assert len(line) < 150
    middles = 0.5 * (circle[1:] + circle[:-1])
    for places in (circle, middles):
        np.testing.assert_allclose(np.hypot(*(places - [0.3, 0.6]).T), 0.2, atol=6e-5)
    assert len(circle) < 300


def test_borders_have_units_and_the_parameters_of_all_points(small, scene_text, without_family):
    text = scene_text(without_family | {"axes.n.values": [0.1, -0.02, 0.0]})
    solid = atlas.run(load_scene(text), progress=False)
    borders = small.atlas.boundary()
    assert (borders.theta0.units, borders.sigma.units) == ("rad", "1")
    given = {name: borders.attrs[name] for name in ("A", "m", "B", "C", "psi0")}
    assert given == {"A": 1.0, "m": 0.5, "B": "A", "C": "sigma * A", "psi0": "pi / 2"}
    assert solid.atlas.boundary(select={"n": 0.1}).n == 0.1
    assert small.atlas.boundary("drifting").A == 1.0
    assert small.atlas.boundary(degrees=True).theta0.max() == pytest.approx(np.degrees(small.theta0.max()))


def test_lines_are_cut_at_the_sides_of_a_box():
    angle = np.linspace(0, 2 * np.pi, 400)
    ring = np.stack([np.cos(angle), np.sin(angle)], -1)
    ring[-1] = ring[0]
    low, high = np.array([-0.5, -2.0]), np.array([2.0, 2.0])
    (part,) = tracer.within(ring, low, high)
    assert part[[0, -1], 0].tolist() == [-0.5, -0.5]
    assert sorted(part[[0, -1], 1]) == pytest.approx([-np.sqrt(0.75), np.sqrt(0.75)], abs=1e-4)
    assert len(tracer.within(ring, np.array([-0.5, -2.0]), np.array([0.5, 2.0]))) == 2
    assert tracer.within(ring, low + 4, high + 4) == []
    np.testing.assert_array_equal(tracer.within(ring, -high, high)[0], ring)
    point = np.array([[0.3]])
    assert [tracer.within(point, np.array([low]), np.array([1.0])) for low in (0.0, 0.4)] == [[point], []]


def drawn_plane(theory, dims):
    """A plane of a nudged scene, with axes from 0 to 1, of which theory is a function of the coordinates."""
    return SimpleNamespace(
        extent=dict.fromkeys(dims, (0.0, 1.0)),
        scene=SimpleNamespace(nudge={"m": 1e-4}),
        coordinates=lambda positions: dict(zip(dims, positions.T, strict=True)),
        theory=theory,
    )


def test_a_strip_narrower_than_the_samples_is_followed_to_its_end():
    """Unstable between y = x / 2 and a little above, ending in a point at x = 1."""

    def theory(places):
        x, y = places["x"], places["y"]
        inside = (y > 0.5 * x) & (y < 0.5 * x + 0.02 * (1 - x))
        ones = np.ones(x.shape)
        frames = {"": (np.full(x.shape, 2), {"n": ones, "m": ones})}
        return planes.Predictions(ones.astype(bool), np.where(inside, 2, 1), frames)

    strip = drawn_plane(theory, "xy")
    line = max(boundary.theory_borders(strip)[boundary.STABILITY], key=len)
    assert line[:, 0].max() > 0.93  # where it is a fifth of the distance between coarse samples wide
    x, y = line[1:-1].T
    assert np.minimum(abs(y - 0.5 * x), abs(y - 0.5 * x - 0.02 * (1 - x))).max() < 1e-4


def test_only_precessions_and_rotations_have_a_limit_between_them():
    """Fifths of an axis: precessions, unstable ones, starts that drift, rotations, precessions; m is 0 in the second."""

    def theory(places):
        x = places["x"]
        fifth = np.minimum((5 * x).astype(int), 4)
        labels = [Label.REGULAR_PRECESSION] * 2 + [
            Label.DRIFTING, Label.PERMANENT_ROTATION, Label.REGULAR_PRECESSION
        ]  # fmt: skip
        rates = {"n": x - 0.11, "m": x - 0.31}
        frames = {"": (np.array(labels)[fifth], rates)}
        return planes.Predictions(x >= 0, np.where(fifth == 1, 2, 1), frames)

    lines = boundary.theory_borders(drawn_plane(theory, "x"))
    positions = {kind: [float(line[0, 0]) for line in kinds] for kind, kinds in lines.items()}
    assert positions == {
        boundary.STABILITY: pytest.approx([0.2, 0.4], abs=1e-4),
        boundary.LABEL: pytest.approx([0.8], abs=1e-4),
        boundary.ZERO_RATES["n"]: pytest.approx([0.11], abs=1e-4),
    }


@pytest.mark.long
def test_a_rate_that_is_zero_on_a_line_is_traced_and_a_pole_is_not():
    scene = load_scene(QUICKSTART.with_name("conical_precession_spin.toml"))
    view = planes.Plane(scene, {"theta0": (0.05, 3.09), "n": (-2.0, 2.0)}, {})
    lines = boundary.theory_borders(view)[boundary.ZERO_RATES["m"]]
    theta, n = np.concatenate(lines).T
    assert theta.size > 100
    # m = 0: (C - A)(n^2 - N) cos theta + l3 n + Mg z0 = 0; m has a pole at n = 0
    np.testing.assert_allclose(-0.6 * (n**2 - 2.0) * np.cos(theta) + 0.2 * n + 0.3, 0, atol=1e-3)
    assert np.abs(n).min() > 0.3


def test_an_axis_of_random_draws_has_no_lines_of_theory():
    scene = load_scene(QUICKSTART.with_name("gravity_gradient_uncertain.toml"))
    coords = {axis.dim: axis.values for axis in scene.axes.values()}
    view = xr.Dataset(coords=coords | {"K3": -0.5})
    with pytest.raises(BadInput, match="draw: its values number random draws"):
        boundary.theory_lines(scene, view, ["K1", "draw"], "label")
