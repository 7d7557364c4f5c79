"""The circle of the angular velocity in the body: against exact precessions and NumPy."""

from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.integrate import solve_ivp
from scipy.spatial.transform import Rotation

from atlas.kernel.ensemble import Ensemble
from atlas.measure import circle
from atlas.measure.circle import CIRCLES, Sum
from atlas.systems import SYSTEMS


def precession(s, z, n, m, duration, vertical, nodes=41, frame_rate=0.0):
    """Statistics of nodes of the exact regular precession with these axes and rates, as arrays of one element.

    frame_rate: what is missing about the vertical in the angular velocity of the nodes, and is added to it.
    """
    spin_vector = m * s
    # u' = u x m s, and the vertical is at rest: equations of which the angular velocity is the state.
    equations = SimpleNamespace(
        rhs=lambda state, constants: np.concatenate(
            [np.cross(state[:3], spin_vector, axis=0), np.cross(state[3:], state[:3], axis=0)]
        ),
        frame_motion=lambda state, constants: np.concatenate([state[:3] - frame_rate * state[3:], state[3:]]),
    )
    u0 = n * z + spin_vector
    bound = np.array([abs(n) + abs(m)])
    one = np.s_[:, None]
    spin_vector = spin_vector[one]
    start = np.r_[u0, vertical][one]
    axes = circle.circle_axes(equations, start, np.empty((0, 1)), np.array([frame_rate]), bound)
    t = np.linspace(0, duration, nodes)
    turn = Rotation.from_rotvec(-m * np.outer(t, s))
    u, g = turn.apply(u0), (turn * Rotation.from_rotvec(-n * np.outer(t, z))).apply(vertical)
    du, dg = np.cross(u, m * s), np.cross(g, u)
    sums = np.zeros((len(Sum), 1))
    for i in range(nodes):
        # The unit of time of the kernel is half of that of the motion.
        node = np.r_[u[i] - frame_rate * g[i], g[i], (du[i] - frame_rate * dg[i]) / 2, dg[i] / 2][:, None]
        circle.add_to_circle(sums, 0, axes, 0, 0, np.array(4 * [node]), i, nodes - 1, 1.0, 2.0)
    return circle.circle_statistics(sums, axes, np.array([nodes - 1]))


def directions(tilt, seed):
    """Two unit vectors at this angle, and a third."""
    turn = Rotation.random(random_state=seed)
    other = Rotation.random(random_state=seed + 1).apply([0.0, 0.0, 1.0])
    return turn.apply([0.0, 0.0, 1.0]), turn.apply([np.sin(tilt), 0.0, np.cos(tilt)]), other


@pytest.mark.parametrize("frame_rate", [0.0, -1.3])
def test_one_precession(frame_rate):
    """Axes apart by 0.8, rates 2 and -3, seen for 1.5 of the 2.1 that a turn takes, in a frame at rest and in one that turns."""
    s, z, vertical = directions(0.8, 4)
    found = precession(s, z, 2.0, -3.0, 1.5, vertical, frame_rate=frame_rate)
    found = {name: float(value[0]) for name, value in found.items()}
    axis = np.array([found[f"spin_axis_{i}"] for i in (1, 2, 3)])
    sign = np.sign(axis @ s)
    np.testing.assert_allclose(sign * axis, s, atol=1e-12)
    u = Rotation.from_rotvec(3.0 * np.outer(np.linspace(0, 1.5, 41), s)).apply(2 * z - 3 * s)
    weight = np.full(41, 1 / 40)
    weight[[0, -1]] /= 2
    np.testing.assert_allclose([found[f"rate_{i}"] for i in (1, 2, 3)], weight @ u, rtol=1e-12)
    spread = np.linalg.eigvalsh((weight[:, None] * u).T @ u - np.outer(weight @ u, weight @ u))
    angle = [np.arccos(a @ vertical / np.linalg.norm(a)) for a in (z, u[0], [0, 0, 1])]
    expected = {
        "spread": np.sqrt(spread.sum()), "extent": np.sqrt(spread[1]), "radius": 2 * np.sin(0.8), "height": sign * (2 * np.cos(0.8) - 3),
        "spin": -3.0 * sign, "height_std": 0.0, "radius_std": 0.0, "spin_std": 0.0, "precession_inclination": angle[0],
        "rotation_inclination": angle[1], "tilt": angle[2],
    }  # fmt: skip
    for name, value in expected.items():
        assert found[name] == pytest.approx(value, rel=1e-9, abs=1e-7), name


@given(
    tilt=st.one_of(st.floats(1e-4, np.pi - 1e-4), st.just(np.pi / 2)),
    n=st.floats(0.01, 10.0),
    m=st.floats(0.01, 10.0).flatmap(lambda size: st.sampled_from([size, -size])),
    angle=st.floats(0.05, 50.0),
    seed=st.integers(0, 1000),
)
def test_exact_precessions(tilt, n, m, angle, seed):
    """Tiny circles, parts of them of 0.05 rad, great circles: axis, rates and nutation as well as rounding allows."""
    s, z, vertical = directions(tilt, seed)
    statistics = {k: v[0] for k, v in precession(s, z, n, m, angle / abs(m), vertical).items()}
    sign = np.sign(s @ [statistics[f"spin_axis_{i}"] for i in (1, 2, 3)])
    u = np.linalg.norm(n * z + m * s)
    radius, height = n * np.sin(tilt), m + n * np.cos(tilt)
    # An error of the angular velocity tilts the plane of a part of the circle.
    rounding = 1e-14 * (u + abs(m))
    error = rounding * (1 + abs(height) / radius) * (u + abs(m)) / statistics["extent"]
    axis = sign * np.array([statistics[f"spin_axis_{i}"] for i in (1, 2, 3)])
    np.testing.assert_allclose(axis, s, atol=error / (u + abs(m)) + 1e-14)
    assert statistics["radius"] == pytest.approx(radius, abs=error)
    assert sign * statistics["height"] == pytest.approx(height, abs=error)
    assert sign * statistics["spin"] == pytest.approx(m, abs=error * (1 + abs(m) / radius))
    assert max(statistics["height_std"], statistics["radius_std"]) < 10 * error
    assert statistics["spin_std"] < 10 * error * (1 + abs(m) / radius)
    inclination = np.arctan2(np.linalg.norm(np.cross(z, vertical)), z @ vertical)
    assert statistics["precession_inclination"] == pytest.approx(
        inclination, abs=10 * error * (1 + abs(m) / radius) / n
    )


def test_what_is_no_circle():
    """The angular velocity of a free body near its axis runs along an ellipse, if A = B along a circle: against NumPy."""
    equations, rows = SYSTEMS["fixed_point"].equations, {}
    turns = {
        "A": 1.0,
        "B": 1.2,
        "C": 1.9,
        "p0": 0.02,
        "r0": 1.0,
        "gamma10": 0.6,
        "gamma20": 0.0,
        "gamma30": 0.8,
    }
    for name, body in {"asymmetric": turns, "symmetric": turns | {"B": 1.0}}.items():
        points = {k: np.array([p.default]) for k, p in SYSTEMS["fixed_point"].parameters.items()}
        points |= {k: np.array([float(v)]) for k, v in (body | {"q0": 0.0, "Mg": 0.0}).items()}
        ensemble = Ensemble.of(SYSTEMS["fixed_point"], points, CIRCLES[:1])
        t = np.linspace(0, 40, 1001)
        constants = ensemble.constants[:, 0]
        y = solve_ivp(
            lambda t, y, c=constants: equations.rhs(y, c), (0, 40), ensemble.state[:, 0], "DOP853", t, rtol=1e-12, atol=1e-13
        ).y  # fmt: skip
        sums = np.zeros((len(Sum), 1))
        for i in range(t.size):
            node = np.r_[y[:, i], equations.rhs(y[:, i], constants)][:, None]
            circle.add_to_circle(sums, 0, ensemble.given, 0, 0, np.array(4 * [node]), i, t.size - 1, 1.0, 1.0)
        rows[name] = circle.circle_statistics(sums, ensemble.given, np.array([1000]))
        u = y[:3]
        _, _, plane = np.linalg.svd(u.T - u.T.mean(0), full_matrices=False)
        distance = np.linalg.norm(u - np.outer(plane[2], plane[2] @ u), axis=0)
        assert rows[name]["radius_std"][0] == pytest.approx(distance.std(), rel=0.02, abs=1e-10)
        assert rows[name]["spread"][0] == pytest.approx(np.sqrt(u.var(1).sum()), rel=1e-3)
        speed = np.linalg.norm(equations.rhs(y, constants[:, None])[:3], axis=0)
        expected = speed.std() / np.sqrt((distance**2).mean())
        assert rows[name]["spin_std"][0] == pytest.approx(expected, rel=0.02, abs=1e-9)
    assert rows["asymmetric"]["spin_std"][0] > 1e-3
    assert rows["asymmetric"]["radius_std"][0] > 1e-4


def test_principal_axes():
    """Against LAPACK, and where the least eigenvalue is far below rounding errors of the largest."""
    rng = np.random.default_rng(0)
    half = rng.normal(size=(3, 3, 50))
    matrix = np.einsum("ikp,jkp->ijp", half, half)
    values, vectors = circle.principal_axes(matrix)
    expected = np.linalg.eigvalsh(np.moveaxis(matrix, 2, 0)).T
    np.testing.assert_allclose(values, expected, rtol=1e-9, atol=1e-13)
    np.testing.assert_allclose(
        np.einsum("ijp,ajp->aip", matrix, vectors), values[:, None] * vectors, atol=1e-12
    )
    scale = np.array([1.0, 1e-5, 1e-12])
    graded = matrix * scale[:, None, None] * scale[None, :, None]
    # The least eigenvalue is the last pivot of a graded matrix, to leading order.
    pivot = (
        np.linalg.det(np.moveaxis(matrix, 2, 0)) / np.linalg.det(np.moveaxis(matrix[:2, :2], 2, 0)) * 1e-24
    )
    np.testing.assert_allclose(circle.principal_axes(graded)[0][0], pivot, rtol=1e-6)
