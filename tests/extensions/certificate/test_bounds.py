"""Bounds of motions for all time, against motions of a Runge-Kutta method of the test's own."""

from __future__ import annotations

import numpy as np
import pytest

from atlas.extensions.certificate import energy
from atlas.extensions.certificate.top import top
from atlas.systems.fixed_point import FIXED_POINT
from atlas.systems.gyrostat.equilibria import described, rotated
from atlas.systems.satellite import SATELLITE

COUNT = 60


@pytest.fixture(autouse=True)
def _quiet():
    """Where there is no bound, numbers overflow or are no numbers."""
    with np.errstate(all="ignore"):
        yield


def filled(system, **points):
    """Every parameter of COUNT points."""
    return {k: np.broadcast_to(points.get(k, p.default), COUNT).astype(float) for k, p in system.parameters.items()}  # fmt: skip


def bodies(rng, symmetric=False):
    x = rng.dirichlet((1, 1, 1), COUNT).T + 0.1
    inertia = x.sum(0) - x
    if symmetric:
        inertia = np.array([inertia[0], inertia[0], np.minimum(inertia[2], 1.9 * inertia[0])])
    return dict(zip("ABC", inertia, strict=True))


def bottom(Q, c, z):
    """Minima of z.Q z / 2 + c.z on the sphere by steepest descent."""
    size = np.abs(Q).max(0) + np.linalg.norm(c, axis=0)
    for _ in range(2000):
        slope = Q * z + c
        z = z - (slope - z * (z * slope).sum(0)) / size
        z = z / np.linalg.norm(z, axis=0)
    return z


def extremes(system, points, duration, step):
    """Least and largest sin(theta), theta', psi', phi' and rate about the vertical along each motion."""
    state, constants = system.initial_state(points), system.constants(points)

    def rhs(state):
        return np.array(np.broadcast_arrays(*system.equations.rhs(state, constants)))

    def rates():
        u, g = np.split(np.array(system.equations.frame_motion(state, constants)), 2)
        sine = np.hypot(g[0], g[1])
        psi = (u[0] * g[0] + u[1] * g[1]) / sine**2
        theta = (u[0] * g[1] - u[1] * g[0]) / sine
        return np.array([sine, theta, psi, u[2] - psi * g[2], (u * g).sum(0)])

    low = high = rates()
    for _ in range(round(duration / step)):
        k1 = rhs(state)
        k2 = rhs(state + 0.5 * step * k1)
        k3 = rhs(state + 0.5 * step * k2)
        state = state + step / 6 * (k1 + 2 * k2 + 2 * k3 + rhs(state + step * k3))
        now = rates()
        low, high = np.minimum(low, now), np.maximum(high, now)
    return low, high


def shares(system, points, bounds, duration=20.0, step=0.025):
    """How much of each bound the motions use, 1 at most, where it is known: range of theta, theta', psi', phi', normal rate."""
    low, high = extremes(system, points, duration, step)
    (least, largest), (n, n_width), (m, m_width) = bounds.sine, bounds.psi_dot, bounds.phi_dot
    known, away = np.isfinite(largest), least > 0.02
    used = [
        (np.maximum(least / low[0], high[0] / largest), known),
        (np.maximum(-low[1], high[1]) / bounds.theta_dot, away),
        (np.maximum(n - low[2], high[2] - n) / n_width, away),
        (np.maximum(m - low[3], high[3] - m) / m_width, away),
        (0.5 * (high[4] - low[4]) / bounds.normal_rate, known),
    ]
    return known, [share[where] for share, where in used]


def assert_sharp(used, *largest):
    """No bound is broken, beyond errors of the integration, and each is reached as far as this."""
    for share, least in zip(used, largest, strict=True):
        assert np.all(share <= 1 + 1e-5)
        assert share.max(initial=0.0) >= least


def near_equilibria(rng):
    """Satellites near minima of their potential, found by descent, half of them with a magnet."""
    k, mu, (h1, h3) = 0.3 * rng.normal(size=(3, COUNT)), 0.7 * rng.normal(size=(3, COUNT)), 0.3 * rng.normal(size=(2, COUNT))  # fmt: skip
    magnet = rng.random(COUNT) < 0.5
    points = filled(SATELLITE, **bodies(rng), k1=k[0], k2=k[1], k3=k[2], h1=h1 * magnet, h3=h3 * magnet,
                    mu1=mu[0], mu2=mu[1], mu3=mu[2], damping=0.1 * (rng.random(COUNT) < 0.3))  # fmt: skip
    body, frames = SATELLITE.body(points), np.linalg.qr(rng.normal(size=(COUNT, 3, 3)))[0]
    frames[:, 1] = np.cross(frames[:, 2], frames[:, 0])
    for _ in range(800):
        frames = rotated(frames, -body.gradient(frames[:, 0], frames[:, 2])[0] / body.steepness()[:, None])
    size = 10 ** rng.uniform(-5, -1.7, COUNT)
    attitude = described(frames)
    for name in ("theta0", "psi0", "phi0"):
        points[name] = attitude[name] + size * rng.normal(size=COUNT)
    return points | {name: size * rng.normal(size=COUNT) for name in ("theta_dot0", "n", "m")}


def test_bounds_near_any_minimum_of_a_satellite():
    points = near_equilibria(np.random.default_rng(1))
    bounds = energy.attitude(SATELLITE.body(points), *SATELLITE.start(points))
    known, used = shares(SATELLITE, points, bounds)
    assert known.sum() > 0.8 * COUNT
    assert_sharp(used, 0.99, 0.85, 0.85, 0.85, 0.8)


def test_bounds_of_an_upright_satellite():
    """On both sides of the orbit, also far from the normal, where no bound of the third derivative holds it."""
    rng = np.random.default_rng(2)
    points = filled(SATELLITE, **bodies(rng), k3=rng.normal(size=COUNT), theta0=10 ** rng.uniform(-4, -0.3, COUNT),
                    damping=0.1 * (rng.random(COUNT) < 0.3))  # fmt: skip
    across = np.where(points["A"] < points["B"], 0.0, np.pi / 2)
    points["phi0"] = across + 10 ** rng.uniform(-4, -0.3, COUNT)
    points["theta0"] = np.where(rng.random(COUNT) < 0.5, points["theta0"], np.pi - points["theta0"])
    for name in ("theta_dot0", "n", "m"):
        points[name] = 10 ** rng.uniform(-4, -0.5, COUNT) * rng.normal(size=COUNT)
    body, start = SATELLITE.body(points), SATELLITE.start(points)
    bounds, others = energy.upright(body, *start), energy.attitude(body, *start)
    known, used = shares(SATELLITE, points, bounds)
    assert known.sum() > np.isfinite(others.sine[1]).sum() > 3
    assert_sharp(used, 0.95, 0.0, 0.0, 0.0, 0.9)


def test_bounds_of_a_symmetric_satellite():
    rng = np.random.default_rng(3)
    points = filled(SATELLITE, **bodies(rng, symmetric=True), k3=rng.normal(size=COUNT), h1=0.5 * rng.normal(size=COUNT),
                    h3=0.5 * rng.normal(size=COUNT), mu3=0.5 * (rng.random(COUNT) < 0.5))  # fmt: skip
    A, C, spin = points["A"], points["C"], rng.normal(size=COUNT)
    Q = np.array([3 * (C - A), 0 * A, A])
    c = np.array(
        [points["h1"] * points["mu3"], 0 * A, points["h3"] * points["mu3"] - C * spin - points["k3"]]
    )
    z = bottom(Q, c, rng.normal(size=(3, COUNT)))
    size = 10 ** rng.uniform(-5, -0.7, COUNT)
    for name, value in (
        ("theta0", np.arccos(z[2])),
        ("psi0", np.arctan2(z[0], -z[1])),
        ("n", 0),
        ("theta_dot0", 0),
    ):
        points[name] = value + size * rng.normal(size=COUNT)
    points["m"] = spin - (1 + points["n"]) * np.cos(points["theta0"])
    bounds = energy.symmetric(SATELLITE.body(points), *SATELLITE.start(points))
    known, used = shares(SATELLITE, points, bounds)
    assert known.sum() > 0.9 * COUNT
    assert_sharp(used, 0.99, 0.99, 0.95, 0.9, 0.2)


def test_bounds_near_permanent_rotations_about_a_fixed_point():
    rng = np.random.default_rng(4)
    n, rotor, centre = rng.normal(size=COUNT), 0.6 * rng.normal(size=(3, COUNT)), 0.6 * rng.normal(size=(3, COUNT))  # fmt: skip
    points = filled(FIXED_POINT, **bodies(rng), N=0.3 * rng.normal(size=COUNT), Mg=1.0, l1=rotor[0], l2=rotor[1],
                    l3=rotor[2], x0=centre[0], y0=centre[1], z0=centre[2])  # fmt: skip
    Q = (points["N"] - n**2) * np.array([points[name] for name in "ABC"])
    z = bottom(Q, -centre - n * rotor, rng.normal(size=(3, COUNT)))
    size = 10 ** rng.uniform(-5, -0.7, COUNT)
    for name, value in (
        ("theta0", np.arccos(z[2])),
        ("phi0", np.arctan2(z[0], z[1])),
        ("n", n),
        ("m", 0),
        ("theta_dot0", 0),
    ):
        points[name] = value + size * rng.normal(size=COUNT)
    w, _, gamma = FIXED_POINT.start(points)
    known, used = shares(FIXED_POINT, points, energy.in_space(FIXED_POINT.body(points), w, gamma))
    assert known.sum() > 0.9 * COUNT
    assert_sharp(used, 0.99, 0.95, 0.9, 0.9, 0.7)


def test_the_range_of_a_top_is_exact():
    """Fast and slow, hanging and inverted: the motion goes from one end of the range to the other."""
    rng = np.random.default_rng(5)
    points = filled(FIXED_POINT, **bodies(rng, symmetric=True), N=0.3 * rng.normal(size=COUNT), Mg=1.0, m=2 * rng.normal(size=COUNT),
                    l3=rng.normal(size=COUNT), z0=0.5 * rng.normal(size=COUNT), n=rng.normal(size=COUNT),
                    theta0=np.arccos(rng.uniform(-0.95, 0.95, COUNT)), theta_dot0=10 ** rng.uniform(-5, 0, COUNT))  # fmt: skip
    w, _, gamma = FIXED_POINT.start(points)
    bounds = top(FIXED_POINT.body(points), w, gamma)
    known, used = shares(FIXED_POINT, points, bounds, duration=10.0, step=0.005)
    assert known.all()
    assert_sharp(used, 0.9999, 0.99, 0.9999, 0.9999, 0.9999)
    assert np.median(used[0]) > 0.999
