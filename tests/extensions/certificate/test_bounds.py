"""Bounds of motions for all time, against motions of a Runge-Kutta method of the test's own."""

from __future__ import annotations

import numpy as np
import pytest
from strategies import DRAG

from atlas.extensions.certificate import bounds, energy
from atlas.extensions.certificate.bounds import Tolerances
from atlas.extensions.certificate.rules import Bodies, body_at, load
from atlas.extensions.certificate.top import top
from atlas.extensions.equilibria.algebra import attitudes, frames_of, rotated
from atlas.systems.fixed_point import FIXED_POINT
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


def limits_of(rule, system, points, *settings):
    """Bounds by a rule, as arrays (points,)."""
    columns = Bodies.of(system, points)
    starts = (
        (columns.w, columns.gamma) if system is FIXED_POINT else (columns.w, columns.alpha, columns.gamma)
    )
    each = [
        rule(body_at(columns, i), *(load(vector, i) for vector in starts), *settings) for i in range(COUNT)
    ]
    return bounds.Bounds(*np.array(each).T)


def shares(system, points, limits, duration=20.0, step=0.025):
    """How much of each bound the motions use, 1 at most, where it is known: range of theta, theta', psi', phi', normal rate."""
    low, high = extremes(system, points, duration, step)
    least, largest, _, n, n_width, m, m_width, _ = limits
    known, away = np.isfinite(largest), least > 0.02
    used = [
        (np.maximum(least / low[0], high[0] / largest), known),
        (np.maximum(-low[1], high[1]) / limits.theta_dot, away),
        (np.maximum(n - low[2], high[2] - n) / n_width, away),
        (np.maximum(m - low[3], high[3] - m) / m_width, away),
        (0.5 * (high[4] - low[4]) / limits.normal_rate, known),
    ]
    return known, [share[where] for share, where in used]


def assert_sharp(used, *largest):
    """No bound is broken, beyond errors of the integration, and each is reached as far as this."""
    for share, least in zip(used, largest, strict=True):
        assert np.all(share <= 1 + 1e-5)
        assert share.max(initial=0.0) >= least


def near_equilibria(rng):
    """Satellites near minima of their potential, found by descent, half of them with a magnet, half with drag."""
    k, mu, (h1, h3) = 0.3 * rng.normal(size=(3, COUNT)), 0.7 * rng.normal(size=(3, COUNT)), 0.3 * rng.normal(size=(2, COUNT))  # fmt: skip
    magnet = rng.random(COUNT) < 0.5
    points = filled(SATELLITE, **bodies(rng), k1=k[0], k2=k[1], k3=k[2], h1=h1 * magnet, h3=h3 * magnet,
                    mu1=mu[0], mu2=mu[1], mu3=mu[2], damping=0.1 * (rng.random(COUNT) < 0.3))  # fmt: skip
    drag = 0.3 * rng.spawn(1)[0].normal(size=(3, COUNT)) * (np.arange(COUNT) % 2)
    points |= dict(zip(DRAG, drag, strict=True))
    body, frames = SATELLITE.body(points), np.linalg.qr(rng.normal(size=(COUNT, 3, 3)))[0]
    frames[:, 1] = np.cross(frames[:, 2], frames[:, 0])
    for _ in range(800):
        frames = rotated(frames, -body.gradient(frames[:, 0], frames[:, 2])[0] / body.steepness()[:, None])
    size = 10 ** rng.uniform(-5, -1.7, COUNT)
    attitude = attitudes(frames)
    for name in ("theta0", "psi0", "phi0"):
        points[name] = attitude[name] + size * rng.normal(size=COUNT)
    return points | {name: size * rng.normal(size=COUNT) for name in ("theta_dot0", "n", "m")}


@pytest.mark.long
def test_bounds_near_any_minimum_of_a_satellite():
    points = near_equilibria(np.random.default_rng(1))
    limits = limits_of(energy.attitude, SATELLITE, points)
    known, used = shares(SATELLITE, points, limits)
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
    limits, others = (limits_of(rule, SATELLITE, points) for rule in (energy.upright, energy.attitude))
    known, used = shares(SATELLITE, points, limits)
    assert known.sum() > np.isfinite(others.largest_sine).sum() > 3
    assert_sharp(used, 0.95, 0.0, 0.0, 0.0, 0.9)


def test_bounds_of_a_symmetric_satellite():
    rng = np.random.default_rng(3)
    points = filled(SATELLITE, **bodies(rng, symmetric=True), k3=rng.normal(size=COUNT), h1=0.5 * rng.normal(size=COUNT),
                    h3=0.5 * rng.normal(size=COUNT), mu3=0.5 * (rng.random(COUNT) < 0.5))  # fmt: skip
    points["drag3"] = 0.3 * rng.spawn(1)[0].normal(size=COUNT) * (np.arange(COUNT) % 2)
    A, C, spin = points["A"], points["C"], rng.normal(size=COUNT) * rng.choice([1.0, 3.0], COUNT)
    Q = np.array([3 * (C - A), 0 * A, A])
    c = np.array(
        [
            points["h1"] * points["mu3"],
            points["drag3"],
            points["h3"] * points["mu3"] - C * spin - points["k3"],
        ]
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
    limits = limits_of(energy.symmetric, SATELLITE, points)
    known, used = shares(SATELLITE, points, limits)
    assert known.sum() > 0.9 * COUNT
    assert_sharp(used, 0.99, 0.99, 0.95, 0.85, 0.2)


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
    known, used = shares(FIXED_POINT, points, limits_of(energy.in_space, FIXED_POINT, points))
    assert known.sum() > 0.9 * COUNT
    assert_sharp(used, 0.99, 0.95, 0.9, 0.9, 0.7)


@pytest.mark.long
def test_the_range_of_a_top_is_exact():
    """Fast and slow, hanging and inverted: the motion goes from one end of the range to the other."""
    rng = np.random.default_rng(5)
    points = filled(FIXED_POINT, **bodies(rng, symmetric=True), N=0.3 * rng.normal(size=COUNT), Mg=1.0, m=2 * rng.normal(size=COUNT),
                    l3=rng.normal(size=COUNT), z0=0.5 * rng.normal(size=COUNT), n=rng.normal(size=COUNT),
                    theta0=np.arccos(rng.uniform(-0.95, 0.95, COUNT)), theta_dot0=10 ** rng.uniform(-5, 0, COUNT))  # fmt: skip
    limits = limits_of(top, FIXED_POINT, points, Tolerances(1.0, 0.02))
    known, used = shares(FIXED_POINT, points, limits, duration=10.0, step=0.005)
    assert known.all()
    assert_sharp(used, 0.9999, 0.99, 0.9999, 0.9999, 0.9999)
    assert np.median(used[0]) > 0.999


def test_the_range_of_a_top_has_room_for_the_rounding_of_its_rates():
    """A thin rod turns about an axis that is normal to it: its tilt is that of the axis, which a change of the last bit moves."""
    rates = 1e-8 * np.linspace(1, 2, COUNT)
    rod = filled(FIXED_POINT, A=1.0, B=1.0, C=1e-4, n=1.0, theta0=np.pi / 2, phi0=np.pi / 4, theta_dot0=rates)
    share = rates / limits_of(top, FIXED_POINT, rod, Tolerances(1.0, 0.02)).theta_dot
    assert np.all((share < 1) & (share > 1 - 1e-5))


def test_the_rate_of_a_swinging_satellite_about_the_vertical():
    """A pendulum in a magnetic field whose spin m and rotor cancel: the rate is m at the bottom, m cos(theta0) at rest."""
    m, theta0 = np.full(COUNT, 100.0), 0.1
    points = filled(
        SATELLITE, A=1.0, B=1.0, C=0.6, Omega=0.0, mu3=-1.0, h3=1.0, theta0=theta0, m=m, k3=-0.6 * m
    )
    limits = limits_of(energy.symmetric, SATELLITE, points)
    np.testing.assert_allclose(limits.theta_dot, 2 * np.sin(theta0 / 2), rtol=1e-6)
    share = 0.5 * m * (1 - np.cos(theta0)) / limits.normal_rate
    assert np.all((share <= 1) & (share > 0.49))


def recorded(monkeypatch):
    """The calls of `energy.reach`, one a point: the energy above the minimum, the distance of the start, and the one found."""
    calls = []

    def reach(*arguments):
        (excess, *_), _, inside = arguments
        calls.append((excess, inside, bounds.reach(*arguments)))
        return calls[-1][-1]

    monkeypatch.setattr(energy, "reach", reach)
    return calls


@pytest.mark.long
def test_the_potential_at_the_rim_of_an_attitude_is_above_the_energy(monkeypatch):
    """At rest, far from the minimum: the start is inside, and turned by that angle about any axis W is larger."""
    rng, calls = np.random.default_rng(8), recorded(monkeypatch)
    points = near_equilibria(rng)
    body, (_, alpha, gamma) = SATELLITE.body(points), SATELLITE.start(points)
    lowest = frames_of(alpha, gamma)
    for _ in range(800):
        slope = body.gradient(lowest[:, 0], lowest[:, 2])[0]
        lowest = rotated(lowest, -slope / body.steepness()[:, None])
    axes = rng.normal(size=(50, COUNT, 3))
    axes = axes / np.linalg.norm(axes, axis=-1)[..., None]
    angle = 10 ** rng.uniform(-3, -0.3, COUNT)
    start = rotated(lowest, angle[:, None] * axes[0])
    columns = Bodies.of(SATELLITE, points)
    for i in range(COUNT):
        energy.attitude(body_at(columns, i), body.turn[i] * start[i, 2], start[i, 0], start[i, 2])
    excess, inside, rim = np.array(calls).T
    known = np.isfinite(rim)
    assert 10 < known.sum() < COUNT
    np.testing.assert_allclose(inside[known], angle[known], rtol=1e-6, atol=1e-9)
    assert (inside < rim)[known].all()
    for axis in axes:
        frames = rotated(lowest, rim[:, None] * axis)
        rise = body.potential(frames[:, 0], frames[:, 2]) - body.potential(lowest[:, 0], lowest[:, 2])
        assert (rise >= excess * (1 - 1e-6))[known].all()


def test_the_potential_at_the_rim_on_a_sphere_is_above_the_energy(monkeypatch):
    """Of symmetric satellites, whose two minima are mirror images of each other."""
    rng, calls = np.random.default_rng(9), recorded(monkeypatch)
    points = filled(
        SATELLITE,
        **bodies(rng, symmetric=True),
        k3=rng.normal(size=COUNT),
        mu3=1.0,
        h1=0.3 * rng.normal(size=COUNT),
    )
    A, C = points["A"], points["C"]
    Q = np.array([3 * (C - A), 0 * A, A])
    c = np.array([points["h1"], 0 * A, -C - points["k3"]])  # w3 = 1
    z = bottom(Q, c, rng.normal(size=(3, COUNT)))
    points["theta0"] = np.arccos(z[2]) + 10 ** rng.uniform(-3, -0.3, COUNT)
    points["psi0"] = np.arctan2(z[0], -z[1])
    points["m"] = 1 - np.cos(points["theta0"])
    limits_of(energy.symmetric, SATELLITE, points)
    excess, inside, rim = np.array(calls).T
    known = np.isfinite(rim)
    assert 10 < known.sum() < COUNT
    assert (inside < rim)[known].all()
    for _ in range(50):
        across = np.cross(z.T, rng.normal(size=(COUNT, 3))).T
        across = across / np.linalg.norm(across, axis=0)
        y = z * (1 - rim**2 / 2) + across * rim * np.sqrt(1 - rim**2 / 4)
        rise = (0.5 * Q * (y**2 - z**2) + c * (y - z)).sum(0)
        assert (rise >= excess * (1 - 1e-6))[known].all()
