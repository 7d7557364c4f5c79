"""The torque of drag: equations in inertial space, scenes without it, and steady motions with it."""

from __future__ import annotations

import ast
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from strategies import DRAG, default_points, random_satellites

import atlas
from atlas.flags import Label, Stability
from atlas.kernel.blocks import Threads
from atlas.kernel.differentiate import simplify
from atlas.kernel.ensemble import Ensemble
from atlas.kernel.specialization import GENERIC, kernel
from atlas.label import pipeline
from atlas.systems import arithmetic
from atlas.systems.satellite import SATELLITE, equations
from atlas.systems.satellite.initial import PARAMETERS

COUNT, DURATION, TOLERANCE = 500, 8.0, 1e-2


def starts():
    """Random satellites under all torques, every second one near a minimum of its potential."""
    rng = np.random.default_rng(83)
    points = random_satellites(
        rng, COUNT, n=0.0, m=0.0, theta_dot0=0.0, damping=0.3 * (np.arange(COUNT) % 3 == 0)
    )
    found = SATELLITE.equilibria_of_bodies(points, stability=False)
    near = np.arange(COUNT) % 2 == 0
    assert (found["index"][near, 0] == 0).all()
    size = np.where(near, 10 ** rng.uniform(-5, -1, COUNT), 0.5)
    for name in ("theta0", "psi0", "phi0"):
        change = size * rng.normal(size=COUNT)
        points[name] = np.where(near, found[name][:, 0], points[name]) + change
    return points | {name: size * rng.normal(size=COUNT) for name in ("n", "m", "theta_dot0")}


def in_inertial_space(points, times):
    """Attitudes, columns the body axes in space, and angular velocities in space, (3, 3, instants, points) and (3, ...).

    The orbit is in the plane of x and y. Each torque is that of its force: two masses on every axis have the moments of the body
    and are attracted to first order in their size, drag is a force against the velocity at an arm.
    """
    p, Omega = points, points["Omega"]
    inertia = np.array([p[name] for name in "ABC"])
    masses = 0.5 * (0.5 * inertia.sum(0) - inertia)  # at both ends of axes of length 1, not always positive
    rotor, dipole = (np.array([p[f"{x}{i}"] for i in (1, 2, 3)]) for x in ("k", "mu"))
    force = np.full(COUNT, 0.7)
    arm = np.array([p[name] for name in DRAG]) / force

    def torques(R, w, t):
        """In body axes."""
        radius = np.array([np.cos(Omega * t), np.sin(Omega * t), 0 * Omega])
        velocity = np.array([-radius[1], radius[0], 0 * Omega])
        normal = np.array([0 * Omega, 0 * Omega, 1 + 0 * Omega])
        up, along, vertical = (np.einsum("ijn,in->jn", R, v) for v in (radius, velocity, normal))
        total = np.zeros_like(up)
        for axis, mass in zip(np.eye(3)[:, :, None], masses, strict=True):
            # The attraction -Omega^2 (x - 3 up up.x) of a mass at x; both ends give the same torque.
            pull = -(Omega**2) * (axis - 3 * up * (up * axis).sum(0))
            total += 2 * mass * np.cross(axis + 0 * up, pull, axis=0)
        total += np.cross(arm, -force * along, axis=0)
        total += np.cross(-dipole, p["h1"] * up + p["h3"] * vertical, axis=0)
        return total - p["damping"] * (w - Omega * vertical)

    def slope(t, y):
        R, w = y[: 9 * COUNT].reshape(3, 3, COUNT), y[9 * COUNT :].reshape(3, COUNT)
        hat = np.array([[0 * w[0], -w[2], w[1]], [w[2], 0 * w[0], -w[0]], [-w[1], w[0], 0 * w[0]]])
        change = (np.cross(inertia * w + rotor, w, axis=0) + torques(R, w, t)) / inertia
        return np.concatenate([np.einsum("ijn,jkn->ikn", R, hat).ravel(), change.ravel()])

    state = SATELLITE.initial_state(points)
    w, alpha, gamma = np.split(state, 3)
    start = np.array([alpha, np.cross(gamma, alpha, axis=0), gamma])  # at t = 0 the radius is along x
    run = solve_ivp(
        slope,
        (0, times[-1]),
        np.concatenate([start.ravel(), w.ravel()]),
        "DOP853",
        times,
        rtol=1e-12,
        atol=1e-13,
    )
    R = run.y[: 9 * COUNT].reshape(3, 3, COUNT, -1).swapaxes(2, 3)
    return R, run.y[9 * COUNT :].reshape(3, COUNT, -1).swapaxes(1, 2)


def own_labels(w, alpha, gamma, Omega):
    """Labels of motions far from the vertical by their rates, and how near the decisive one is to the tolerance, as a factor."""
    u = w - Omega * gamma
    sine = np.hypot(gamma[0], gamma[1])
    psi = (u[0] * gamma[0] + u[1] * gamma[1]) / sine**2
    theta, phi = (u[0] * gamma[1] - u[1] * gamma[0]) / sine, u[2] - psi * gamma[2]
    deviation = np.max([np.sqrt((theta**2).mean(0)), psi.std(0), phi.std(0)], axis=0)
    n, m = np.abs(psi.mean(0)), np.abs(phi.mean(0))
    steady = np.where((n > TOLERANCE) & (m > TOLERANCE), Label.REGULAR_PRECESSION, Label.PERMANENT_ROTATION)
    distance = np.abs(np.log(np.array([deviation, n, m]) / TOLERANCE))
    distance[1:, deviation > TOLERANCE] = np.inf
    return np.where(deviation > TOLERANCE, Label.DRIFTING, steady), distance.min(0), sine.min(0)


@pytest.mark.long
def test_motions_and_labels_are_those_of_equations_in_inertial_space():
    points, times = starts(), np.linspace(0, DURATION, 1601)
    R, w = in_inertial_space(points, times)
    Omega = points["Omega"]
    radius = np.array(
        [np.cos(Omega * times[:, None]), np.sin(Omega * times[:, None]), 0 * Omega * times[:, None]]
    )
    alpha, gamma = np.einsum("ijtn,itn->jtn", R, radius), R[2]
    ensemble = Ensemble.of(SATELLITE, points)
    steps = np.full(COUNT, 4000)
    final = ensemble.final_states(kernel(SATELLITE, "rk8", GENERIC), steps, DURATION / steps, Threads(1))
    expected = np.concatenate([w[:, -1], alpha[:, -1], gamma[:, -1]])
    assert (np.abs(final - expected) / np.maximum(1, np.abs(expected).max(0))).max() < 1e-9

    labels, distance, sine = own_labels(w, alpha, gamma, Omega)
    ds = atlas.label_points(
        "satellite",
        points,
        duration=DURATION,
        rate_tolerance=TOLERANCE,
        tolerance=1e-10,
        variables=["label", "status"],
    )
    clear = (distance > 0.02) & (sine > 0.05) & (ds.status.values == 1)
    assert clear.sum() > 0.9 * COUNT
    assert set(labels[clear]) == {Label.DRIFTING, Label.PERMANENT_ROTATION}
    np.testing.assert_array_equal(ds.label.values[clear], labels[clear])


def test_a_right_hand_side_without_drag_is_left_as_it_was():
    """A scene that has no drag pays nothing: of the drag in its kernel there is the name of each constant and nothing else."""
    zero, equal = SATELLITE.specialization({*DRAG}, set())
    assert not equal
    assert zero == {*DRAG} | {f"drag{i}_{m}" for i, m in ("3A", "2A", "1B", "3B", "2C", "1C")}
    for name in ("rhs", "jacobi"):
        text = simplify(arithmetic.functions(equations)[name], zero, {}, equations.ONES)
        names = [node for node in ast.walk(ast.parse(text)) if isinstance(node, ast.Name)]
        assert {type(node.ctx) for node in names if node.id.startswith("drag")} == {ast.Store}
        assert not any(isinstance(node.ctx, ast.Load) and node.id in ("b1", "b2", "b3") for node in names)


def sampled(points):
    """Which points are rerun at half the step."""
    ensemble = Ensemble.of(SATELLITE, points)
    settings = SimpleNamespace(check_half_step="sample")
    return pipeline._sample(SimpleNamespace(settings=settings, ensemble=ensemble, system=SATELLITE))


def test_the_sample_that_is_rerun_does_not_move_without_drag():
    """By the hash of the state and the constants that were there before drag, in their order."""
    names = [name for name in equations.CONSTANTS if not name.startswith("drag")]
    points = random_satellites(np.random.default_rng(2), 4000) | dict.fromkeys(DRAG, np.zeros(4000))
    rows = dict(zip(equations.CONSTANTS, SATELLITE.constants(points), strict=True))
    mixed = np.zeros(4000, np.uint64)
    for bits in [*SATELLITE.initial_state(points), *(rows[name] for name in names)]:
        mixed = (mixed ^ np.ascontiguousarray(bits).view(np.uint64)) * np.uint64(0x9E3779B97F4A7C15)
        mixed ^= mixed >> np.uint64(29)
    expected = mixed % np.uint64(pipeline.POINTS_PER_HALF_STEP) == 0
    assert expected.any()
    np.testing.assert_array_equal(sampled(points), expected)
    dragged = points | {"drag2": np.where(np.arange(4000) % 2, 0.1, 0.0)}
    changed = sampled(dragged) != expected
    assert not changed[::2].any()
    assert changed[1::2].any()


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_an_arrow_flies_with_its_centre_of_pressure_behind(sign):
    """Drag D at the arm r e1 behind the centre of mass, r < 0: of a sphere only e1 along the velocity is stable."""
    body = {"A": 1.0, "B": 1.0, "C": 1.0, "drag1": -0.5 * sign}
    found = atlas.equilibria("satellite", body | {"k3": 1e-9, "C": 1.001})
    beta = np.cross(found.gamma, found.alpha)[:, 0]
    stable = found.stable.values == Stability.STABLE
    assert stable.any()
    assert (beta[stable] * sign > 0.99).all()


def test_drag_is_a_parameter_as_others():
    assert {PARAMETERS[name].unit for name in DRAG} == {"N m"}
    with pytest.raises(atlas.BadInput, match="drag4"):
        atlas.label_points("satellite", {"drag4": 1.0})
    with pytest.raises(atlas.BadInput, match="drag1"):
        atlas.label_points("satellite", {"drag1": "much"})


@pytest.mark.long
@pytest.mark.parametrize("family", ["perp_radius", "oblique"])
def test_a_family_with_drag_is_steady_and_found(family):
    """Axial drag keeps the tilt of the closed forms; the label is predicted, and measured."""
    C, drag, c = {"perp_radius": 1.3, "oblique": 0.7}[family], 0.3, np.cos(1.1)
    cosine = 1.0 if family == "perp_radius" else drag / (3 * (1 - C) * np.sin(1.1))
    k3 = (1 - C) * c + drag * c / np.sin(1.1) if family == "perp_radius" else 4 * (1 - C) * c
    point = {
        "A": 1.0,
        "B": 1.0,
        "C": C,
        "drag3": drag,
        "theta0": 1.1,
        "psi0": np.arccos(cosine),
        "m": 0.4,
        "k3": k3 - 0.4 * C,
    }
    ds = atlas.label_points(
        "satellite", point, variables=["label", "predicted", "family", "stable", "geometry"]
    )
    assert SATELLITE.families[family].flag == ds.family
    assert ds.label == ds.predicted == Label.PERMANENT_ROTATION
    assert ds.stable == Stability.STABLE
    assert np.ptp(atlas.trajectory("satellite", point, duration=30.0).theta.values) < 1e-7


def test_the_jacobi_integral_is_kept_in_the_units_of_the_kernels():
    points = random_satellites(np.random.default_rng(4), 50)
    ds = atlas.label_points(
        "satellite", points, duration=20.0, method="rk8", tolerance=1e-11, variables=["integral_drift"]
    )
    assert ds.integral_drift.max() < 1e-11
    no_orbit = default_points("satellite", 1, Omega=0.0, drag1=0.3, theta0=1.0, psi0=0.4, n=0.5)
    ds = atlas.label_points(
        "satellite", no_orbit, duration=20.0, method="rk8", tolerance=1e-11, variables=["integral_drift"]
    )
    assert ds.integral_drift.max() < 1e-11
