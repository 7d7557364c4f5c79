"""Viscous damping of the satellite: equations, balance of the energy, steady motions and their stability."""

from __future__ import annotations

import ast

import numpy as np
import pytest
import sympy as sp
from scipy.integrate import simpson
from strategies import DRAG, default_points, random_satellites, satellite_on_family, steady_motions
from truth import (
    exponents_along_runs,
    jacobian_matrices,
    lagrangian_arguments,
    lagrangian_functions,
    paper_vectors,
    satellite_symbols,
)

import atlas
from atlas.errors import BadInput
from atlas.flags import EnergyStability, Label, Stability
from atlas.kernel.differentiate import simplify
from atlas.systems.arithmetic import functions
from atlas.systems.satellite import SATELLITE, equations
from atlas.systems.satellite.equations import rhs
from atlas.systems.satellite.families import FAMILIES
from atlas.systems.satellite.initial import constants, frequency_bound, initial_state
from atlas.systems.steady import growth_about_vertical
from atlas.theory.motions import condition_residual
from atlas.theory.steady import Existence

pytestmark = pytest.mark.usefixtures("whole_kernels")


def damped_satellites(rng, count, **given):
    return random_satellites(rng, count, **{"damping": rng.uniform(0.1, 2.0, count)} | given)


def test_the_torque_is_minus_damping_times_the_relative_rate():
    """The equations in vectors, at random states."""
    points = damped_satellites(np.random.default_rng(1), 30)
    state = initial_state(points)
    w, alpha, gamma = np.split(state.T, 3, axis=1)
    inertia, k, mu, drag = (
        np.stack([points[name] for name in names], 1)
        for names in (("A", "B", "C"), ("k1", "k2", "k3"), ("mu1", "mu2", "mu3"), DRAG)
    )
    Omega, h1, h3, damping = (points[name][:, None] for name in ("Omega", "h1", "h3", "damping"))
    relative = w - Omega * gamma
    torque = np.cross(inertia * w + k, w) + 3 * Omega**2 * np.cross(alpha, inertia * alpha)
    torque += np.cross(h1 * alpha + h3 * gamma, mu) + np.cross(np.cross(gamma, alpha), drag)
    torque -= damping * relative
    expected = np.concatenate([torque / inertia, np.cross(alpha, relative), np.cross(gamma, relative)], 1)
    np.testing.assert_allclose(np.array(rhs(state, constants(points))).T, expected, atol=1e-13)


def test_it_is_the_force_of_the_dissipation_function_in_lagrangian_coordinates():
    """Lagrange's equations with the forces -dR/dq', R = damping |w'|^2 / 2."""
    angles, rates, _, _ = satellite_symbols()
    relative_rate = paper_vectors()[3]
    half_square = sum(component**2 for component in relative_rate) / 2
    by_rates = sp.lambdify((*angles, *rates), [sp.diff(half_square, rate) for rate in rates], modules="numpy")
    points = damped_satellites(np.random.default_rng(2), 20)
    w_dot = np.array(rhs(initial_state(points), constants(points)))[:3]
    for i in range(20):
        point = {name: float(values[i]) for name, values in points.items()}
        arguments = lagrangian_arguments(point)
        mass = np.array(lagrangian_functions()["mass"](*arguments), float)
        left_sides = np.array(lagrangian_functions()["left_sides"](*arguments), float)[:, 0]
        accelerations = np.linalg.solve(
            mass, -left_sides - point["damping"] * np.array(by_rates(*arguments[:6]))
        )
        expected = lagrangian_functions()["w_dot"](*lagrangian_arguments(point, accelerations))
        np.testing.assert_allclose(w_dot[:, i], np.array(expected, float)[:, 0], atol=1e-11)


def test_what_damping_takes_of_the_integrals():
    """Identically; the lengths are conserved as without damping."""
    names = ("A", "B", "C", "Omega", "k1", "k2", "k3", "mu1", "mu2", "mu3", "h1", "h3", *DRAG, "damping")
    body = dict(zip(names, sp.symbols(names), strict=True))
    state, values = sp.symbols(equations.STATE), tuple(constants(body))
    slopes = rhs(state, values)

    def rate(name):
        total = sum(getattr(equations, name)(state, values))
        return sum(sp.diff(total, x) * slope for x, slope in zip(state, slopes, strict=True))

    relative = equations.frame_motion(state, values)[:3]
    power, torque = body["damping"] * sum(u**2 for u in relative), body["damping"] * relative[2]
    assert sp.expand(rate("jacobi") + power) == 0
    assert sp.expand(equations.jacobi_loss(state, values) - power) == 0
    symmetric = {"B": body["A"]} | dict.fromkeys(("k1", "k2", "mu1", "mu2", "drag1", "drag2"), 0)
    assert sp.expand(rate("axial_momentum").subs(symmetric) + torque) == 0
    assert sp.expand(equations.axial_momentum_loss(state, values) - torque) == 0
    for name in ("length_alpha", "length_gamma", "length_sum"):
        assert sp.expand(rate(name)) == 0


def test_the_energy_lost_along_a_run_is_the_work_of_the_damping():
    point = {"A": 0.9, "B": 1.2, "C": 1.4, "damping": 0.2, "k1": 0.3, "k3": -0.2, "mu2": 0.4, "h1": 0.5, "h3": 0.3,
             "theta0": 1.0, "psi0": 0.4, "n": 1.1, "m": -1.4, "theta_dot0": 0.7}  # fmt: skip
    motion = atlas.trajectory("satellite", point, duration=20.0, samples=4001, tolerance=1e-10)
    values = constants(default_points("satellite", **point))
    state = np.array([motion[name].values for name in equations.STATE])
    energy = sum(equations.jacobi(state, values))
    relative = state[:3] - state[6:]
    power = 0.2 * (relative**2).sum(0)
    lost = np.array([simpson(power[: i + 1], x=motion.time.values[: i + 1]) for i in (1000, 2000, 4000)])
    assert lost[-1] > 1.0
    np.testing.assert_allclose(energy[0] - energy[[1000, 2000, 4000]], lost, rtol=1e-7)
    # which the run measures, too
    assert motion.integral_drift.values[-1] < 1e-9


def test_integrals_have_a_balance_with_damping_and_without():
    points = default_points("satellite", damping=[0.0, 0.1, 0.1], k1=[0.0, 0.0, 0.2], m=0.5)
    scales = SATELLITE.integral_scales(points)
    np.testing.assert_array_equal(np.isnan(scales["axial_momentum"]), [False, False, True])
    for name in ("jacobi", "length_alpha", "length_gamma", "length_sum"):
        assert not np.isnan(scales[name]).any()


def test_damped_spin_cannot_be_replaced_by_a_rotor():
    """The torque acts on the spin alone; without damping the rotor is moved into it where that is slower."""
    points = default_points("satellite", C=1.3, theta0=0.6, m=-20.0, k3=26.0, damping=[0.0, 0.1])
    despun, excess = SATELLITE.despun(points)
    np.testing.assert_array_equal(excess, [20.0, 0.0])
    np.testing.assert_array_equal(despun["k3"], [0.0, 26.0])


@pytest.mark.parametrize(("strength", "symmetric"), [(0.3, False), (30.0, False), (30.0, True)])
def test_frequency_bound_holds_along_damped_motions(strength, symmetric):
    """Weak damping, and damping that decides the bound alone; a symmetric body loses the momentum of its spin."""
    points = damped_satellites(np.random.default_rng(3), 8, damping=strength)
    if symmetric:
        points["B"] = points["A"]
        points |= {name: np.zeros(8) for name in ("k1", "k2", "mu1", "mu2", "drag1", "drag2")}
    bound, state, values = frequency_bound(points), initial_state(points), constants(points)
    for i, (path, exponents) in enumerate(exponents_along_runs(rhs, state, values, 6)):
        relative = path[:3] - points["Omega"][i] * path[6:]
        assert np.linalg.norm(relative, axis=0).max() <= bound[i]
        assert np.abs(exponents).max() <= bound[i]
        assert np.abs(exponents).max() >= 0.7 * strength / min(points[name][i] for name in "ABC")


def test_kernels_without_damping_have_no_term_of_it():
    whole = functions(equations)["rhs"]
    zero, _ = SATELLITE.specialization({"damping"}, set())
    assert zero == {"damping_A", "damping_B", "damping_C"}

    def names(text):
        nodes = ast.walk(ast.parse(text))
        return {node.id for node in nodes if isinstance(node, ast.Name) and isinstance(node.ctx, ast.Load)}

    assert zero <= names(whole)
    assert not zero & names(simplify(whole, zero, {}))
    assert SATELLITE.specialization(set(), set()) == (set(), set())


@pytest.mark.usual("cylindrical", "oblique")
@pytest.mark.parametrize("name", [name for name in FAMILIES if name != "equilibrium"])
def test_damping_leaves_no_motion_that_turns_in_the_orbital_frame(name):
    rng, count = np.random.default_rng(5), 0
    for _ in range(40):
        point = satellite_on_family(name, rng)
        if point is None:
            continue
        damped = point | {"damping": np.array([0.1])}
        relative = initial_state(point)[:3] - point["Omega"] * initial_state(point)[6:]
        if np.linalg.norm(relative) < 0.1:
            continue
        assert SATELLITE.identify_family(point)[0] > 0
        assert SATELLITE.identify_family(damped)[0] == 0
        assert SATELLITE.identify_family(damped)[1] > 1e-4
        assert condition_residual(SATELLITE, damped) > 1e-4
        motion = steady_motions(SATELLITE, damped, 1e3, 1e-5, 1e-5)
        assert motion.answer == Existence.FAR
        count += 1
    assert count >= 5


def test_spherical_bodies_that_turn_about_any_axis_are_slowed_down():
    point = default_points(
        "satellite", C=1.0, theta0=0.7, n=-1.0, m=0.4, phi0=0.3, theta_dot0=0.2, damping=[0.0, 0.1]
    )
    flags, residual = SATELLITE.identify_family(point)
    np.testing.assert_array_equal(flags, [SATELLITE.families["spherical_any_axis"].flag, 0])
    assert residual[1] > 1e-3


def test_labels_of_damped_precessions_and_rests():
    """A precession slows down, as theory predicts; a stable rest stays, and exact starts stay exact."""
    given = {
        "C": [1.3, 1.3, 1.3],
        "theta0": [0.6, 0.6, 0.0],
        "m": [0.5, 0.5, 0.0],
        "damping": [0.0, 0.2, 0.2],
    }
    k3 = np.cos(0.6) * (1 - 1.3) - 1.3 * 0.5
    ds = atlas.label_points("satellite", given | {"k3": [k3, k3, 0.4]}, duration=60.0, progress=False)
    expected = [Label.PERMANENT_ROTATION, Label.DRIFTING, Label.PERMANENT_ROTATION]
    np.testing.assert_array_equal(ds.label, expected)
    np.testing.assert_array_equal(ds.predicted, expected)
    assert ds.theta_dot_rms[2] == 0


def equilibria_of(body, damping):
    """Points of the equilibria of a body, and the dataset."""
    ds = atlas.equilibria("satellite", body | {"damping": damping})
    angles = {name: ds[name].values for name in ("theta0", "psi0", "phi0")}
    return ds, default_points("satellite", **body, **angles, damping=damping)


@pytest.mark.extension("equilibria")
def test_damped_equilibria_are_stable_where_the_energy_has_a_minimum_and_nowhere_else():
    """The theorem of Kelvin, Tait and Chetaev, at all equilibria of random bodies; exponents from the equations."""
    rng = np.random.default_rng(0)
    gyroscopic = 0
    for _ in range(6):
        body = dict(zip("ABC", 1 + 0.7 * rng.uniform(size=3), strict=True)) | {"h1": 0.4, "h3": -0.2}
        body |= {f"{name}{i}": 0.4 * rng.normal() for name in ("k", "mu") for i in (1, 2, 3)}
        undamped, _ = equilibria_of(body, 0.0)
        for damping in (0.05, 3.0):
            ds, points = equilibria_of(body, damping)
            for name in ("theta0", "psi0", "phi0", "index", "frequency_1"):
                np.testing.assert_array_equal(ds[name], undamped[name])
            minimum = ds.index.values == 0
            np.testing.assert_array_equal(ds.stable == Stability.STABLE, minimum)
            flags, _ = SATELLITE.identify_family(points)
            assert (flags == FAMILIES["equilibrium"].flag).all()
            np.testing.assert_array_equal(SATELLITE.linear_stability(points, flags)[0], ds.stable)
            exponents = np.linalg.eigvals(jacobian_matrices(rhs, initial_state(points), constants(points)))
            growth = exponents.real.max(1)  # three are 0, of the lengths and the angle of alpha and gamma
            np.testing.assert_allclose(ds.growth_rate, np.where(minimum, 0.0, growth), atol=1e-6)
            decay = np.sort(exponents.real, axis=1)[minimum, :6]
            assert decay.max() < -1e-4
        gyroscopic += int(((undamped.stable == Stability.STABLE) & (undamped["index"] > 0)).sum())
    assert gyroscopic > 0


@pytest.mark.parametrize("psi0", [0.0, np.pi / 2])
def test_damping_takes_away_the_momentum_that_stabilises_symmetric_bodies(psi0):
    """At rest with a rotor along the axis: on the level of the momentum more of them are stable than with damping."""
    rng, count = np.random.default_rng(7), 200
    sigma, theta = rng.uniform(0.2, 1.9, count), rng.uniform(0.2, 2.8, count)
    k3 = (1.0 if psi0 == 0.0 else 4.0) * np.cos(theta) * (1 - sigma)
    points = default_points("satellite", C=sigma, theta0=theta, psi0=psi0, k3=k3)
    damped = points | {"damping": np.full(count, 0.5)}
    energy = {}
    for name, each in (("undamped", points), ("damped", damped)):
        flags = SATELLITE.identify_family(each)[0]
        assert (flags > 0).all()
        energy[name] = SATELLITE.derived["energy_stable"].values(each, np.ones(count), lambda: None)
        stable = SATELLITE.linear_stability(each, flags)[0]
        assert (stable[energy[name] == EnergyStability.YES] == Stability.STABLE).all()
    yes = energy["damped"] == EnergyStability.YES
    np.testing.assert_array_equal(stable == Stability.STABLE, yes)
    exponents = np.linalg.eigvals(jacobian_matrices(rhs, initial_state(damped), constants(damped)))
    np.testing.assert_array_equal(exponents.real.max(1) < 1e-6, yes)
    assert (energy["undamped"][yes] == EnergyStability.YES).all()


def test_pitch_of_a_body_on_the_normal():
    """C psi'' = 3 Omega^2 (A - B) psi - damping psi' with the first axis along the radius."""
    points = default_points("satellite", A=[1.2, 1.2, 1.0], B=[1.0, 1.0, 1.2], C=1.5, damping=[0.0, 0.4, 0.4])
    expected = [np.roots([1.5, damping, -0.6]).real.max() for damping in (0.0, 0.4)]
    np.testing.assert_allclose(growth_about_vertical(SATELLITE, points), [*expected, 0.0], rtol=1e-12)


@pytest.mark.long
def test_the_damped_diagram():
    """Nudged: motions in Lagrange's triangle return to rest, those of DeBra and Delp drift, as predicted."""
    k1 = np.array([0.5, 0.8, 0.3, -0.05, -0.03, -0.02, 0.3])
    k3 = np.array([0.2, 0.5, 0.1, -0.5, -0.8, -0.3, 0.6])
    a = (1 - k1) / (1 - k3)
    body = {"A": a, "B": np.ones(7), "C": a + k1, "theta0": 1e-4, "psi0": 1e-4}
    settings = {"duration": 314.0, "progress": False, "tolerance": 1e-5, "rate_tolerance": 1e-3,
                "cylinder_tolerance": 1e-2}  # fmt: skip
    undamped = atlas.label_points("satellite", body, **settings)
    damped = atlas.label_points("satellite", body | {"damping": 0.3}, **settings)
    rest, drift = Label.PERMANENT_ROTATION, Label.DRIFTING
    np.testing.assert_array_equal(undamped.label, [rest] * 6 + [drift])
    np.testing.assert_array_equal(damped.label, [rest] * 3 + [drift] * 4)
    motion = atlas.trajectory("satellite", {n: float(v[0]) if np.ndim(v) else v for n, v in body.items()}
                              | {"damping": 0.3}, duration=314.0)  # fmt: skip
    assert motion.theta[-1] < 1e-6


@pytest.mark.extension("equilibria")
def test_negative_damping_is_refused():
    with pytest.raises(BadInput, match="damping") as error:
        atlas.label_points("satellite", {"damping": -0.1}, duration=1.0, progress=False)
    assert "\n" not in str(error.value)
    with pytest.raises(BadInput, match="damping"):
        atlas.equilibria("satellite", {"damping": [0.1, -0.1]})


@pytest.mark.extension("studies")
def test_damped_points_have_no_exact_motion():
    from atlas.extensions.studies import exact

    points = default_points(
        "satellite", C=1.0, k3=0.4, theta0=0.3, theta_dot0=0.1, damping=np.array([0.0, 0.1])
    )
    assert exact.motion_of(SATELLITE, "symmetric top", points, 0)
    with pytest.raises(ValueError, match="damping"):
        exact.motion_of(SATELLITE, "symmetric top", points, 1)


@pytest.mark.extension("equilibria")
def test_starts_along_the_orbit_of_random_bodies_are_not_moved_by_damping():
    """w = Omega gamma at an equilibrium: it solves the equations with damping as those without."""
    body = {"A": 1.0, "B": 1.3, "C": 1.7, "k1": 0.1, "k2": 0.2}
    _, points = equilibria_of(body, 0.7)
    slopes = np.array(rhs(initial_state(points), constants(points)))
    assert np.abs(slopes).max() < 1e-9
    assert condition_residual(SATELLITE, points).max() < 1e-9
