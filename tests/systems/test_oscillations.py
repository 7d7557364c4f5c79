"""Frequencies of small oscillations: classical formulas, and the Jacobian of the equations of motion."""

from __future__ import annotations

import numpy as np
import pytest
from truth import default_points

import atlas
from atlas.systems.base import derived_values
from atlas.systems.fixed_point import FIXED_POINT
from atlas.systems.gyrostat.system import FREQUENCIES
from atlas.systems.satellite import SATELLITE


def frequencies(system, **point):
    """Frequencies of one motion, without the places that are not used."""
    points = default_points(system.name, **point)
    values = [system.derived[name].values(points, np.ones(1), lambda: None).item() for name in FREQUENCIES]
    count = int(np.isfinite(values).sum())
    assert np.isnan(values[count:]).all()
    assert (np.diff(values[:count]) <= 0).all()
    return np.array(values[:count])


def of_quartic(P, Q):
    """Frequencies from lambda^4 + P lambda^2 + Q = 0, largest first."""
    x = np.roots([1.0, P, Q])
    assert np.isreal(x).all()
    return np.sort(np.sqrt(-x[x < 0].real))[::-1]


def of_jacobian(system, points, zeros):
    """Positive imaginary parts of the eigenvalues of the equations of motion at a rest point, but for the zeros."""
    state, constants = system.initial_state(points)[:, 0], system.constants(points)[:, 0]
    step = 1e-5
    columns = []
    for unit in np.eye(state.size):
        ahead, behind = (
            np.array(system.equations.rhs(state + sign * step * unit, constants), float) for sign in (1, -1)
        )
        columns.append((ahead - behind) / (2 * step))
    eigenvalues = np.linalg.eigvals(np.array(columns).T)
    assert np.abs(system.equations.rhs(state, constants)).max() < 1e-9
    assert np.abs(eigenvalues.real).max() < 1e-4
    return np.sort(eigenvalues.imag)[::-1][: (state.size - zeros) // 2]


@pytest.mark.parametrize("Omega", [1.0, 0.3])
@pytest.mark.parametrize(("A", "B", "C"), [(1.0, 1.3, 1.7), (1.0, 1.9, 2.0), (0.8, 1.0, 0.75)])
def test_gravity_gradient(A, B, C, Omega):
    """Pitch sqrt(3 (B - A)/C) Omega; roll and yaw from Hughes (1986), 10.2, with k1 = (C - A)/B, k3 = (C - B)/A."""
    k1, k3 = (C - A) / B, (C - B) / A
    pitch = np.sqrt(3 * (B - A) / C)
    expected = np.append(of_quartic(1 + 3 * k1 + k1 * k3, 4 * k1 * k3), pitch) * Omega
    computed = frequencies(SATELLITE, A=A, B=B, C=C, Omega=Omega)
    np.testing.assert_allclose(computed, np.sort(expected)[::-1], rtol=1e-10)


@pytest.mark.parametrize("m", [0.0, 0.5, -2.5, 3.0])
@pytest.mark.parametrize("sigma", [0.4, 1.2, 1.8])
def test_cylindrical_motion_of_likins_and_thomson(sigma, m):
    """lambda^4 + (b^2 - 2b + 3 sigma - 1) lambda^2 + (b - 1)(b + 3 sigma - 4) with b = C (m + Omega) / (A Omega)."""
    b = sigma * (1 + m)
    P, Q = b**2 - 2 * b + 3 * sigma - 1, (b - 1) * (b + 3 * sigma - 4)
    computed = frequencies(SATELLITE, A=2.0, B=2.0, C=2.0 * sigma, m=m)
    if P > 0 and Q > 0 and P**2 > 4 * Q:
        np.testing.assert_allclose(computed, of_quartic(P, Q), rtol=1e-8)
    else:
        assert len(computed) < 2


def test_conical_and_hyperboloidal_motions():
    """Axis across the radius: P = 3 sigma - 2, Q = 3 (sigma - 1) sin^2; across the velocity see below; spin and rotor alike."""
    sigma, theta = 1.5, 0.7
    s2, c = np.sin(theta) ** 2, np.cos(theta)
    for m in (0.0, 2.0):
        k3 = -c * (sigma - 1) - sigma * m
        computed = frequencies(SATELLITE, A=1.0, B=1.0, C=sigma, theta0=theta, m=m, k3=k3)
        np.testing.assert_allclose(computed, of_quartic(3 * sigma - 2, 3 * (sigma - 1) * s2), rtol=1e-8)
    sigma = 0.6
    P = 7 - 6 * sigma + 9 * sigma * (sigma - 1) * c**2
    k3 = -4 * c * (sigma - 1) - 1.3 * sigma
    computed = frequencies(SATELLITE, A=1.0, B=1.0, C=sigma, theta0=theta, psi0=np.pi / 2, m=1.3, k3=k3)
    np.testing.assert_allclose(computed, of_quartic(P, 3 * (sigma - 1) * (3 * sigma - 4) * s2), rtol=1e-8)


@pytest.mark.extension("equilibria")
def test_equilibria_with_rotor_and_magnet_as_the_equations_of_motion():
    body = {
        "A": 1.0,
        "B": 1.3,
        "C": 1.7,
        "Omega": 0.8,
        "k1": 0.1,
        "k2": -0.05,
        "k3": 0.2,
        "mu1": 0.1,
        "mu3": 0.2,
    }
    body |= {"h1": 0.5, "h3": -0.3}
    ds = atlas.equilibria("satellite", body)
    stable = ds.isel(equilibrium=ds.stable.values == 1)
    assert stable.sizes["equilibrium"] >= 2
    for i in range(stable.sizes["equilibrium"]):
        one = stable.isel(equilibrium=i)
        start = {name: one[name].item() for name in ("theta0", "psi0", "phi0")}
        expected = of_jacobian(SATELLITE, default_points("satellite", **body, **start), zeros=3)
        np.testing.assert_allclose([one[name].item() for name in FREQUENCIES], expected, rtol=1e-6)
        np.testing.assert_allclose(frequencies(SATELLITE, **body, **start), expected, rtol=1e-6)
    unstable = ds.isel(equilibrium=ds.stable.values == 2)
    assert np.isnan(unstable.frequency_3).all()


def test_a_body_that_turns_about_another_axis_of_symmetry():
    about_third = frequencies(SATELLITE, A=1.0, B=1.0, C=1.5, k3=0.2, n=0.7)
    about_first = frequencies(SATELLITE, A=1.5, B=1.0, C=1.0, k1=0.2, n=0.7, theta0=np.pi / 2, phi0=np.pi / 2)
    assert about_third.size == 2
    np.testing.assert_allclose(about_first, about_third, rtol=1e-8)


def test_no_frequencies_off_families_and_of_periodic_equations():
    assert frequencies(SATELLITE, A=1.0, B=1.3, C=1.7, theta0=0.3).size == 0
    tilted = {"theta0": np.pi / 3, "psi0": np.pi / 2, "m": -1.0, "k3": 0.6}
    assert SATELLITE.identify_family(default_points("satellite", A=1.0, B=1.3, C=1.7, **tilted))[0] > 0
    assert frequencies(SATELLITE, A=1.0, B=1.3, C=1.7, **tilted).size == 0
    assert frequencies(FIXED_POINT, A=1.0, B=1.3, C=1.7, m=1.0, theta0=0.3, Mg=1.0, x0=1.0).size == 0


@pytest.mark.parametrize("l3", [0.0, 1.5])
def test_the_two_frequencies_of_a_sleeping_gyrostat(l3):
    """In space (S +- sqrt(S^2 - 4 A Mg |z0|)) / (2 A), S = C r + l3; relative to the body less its spin r."""
    A, C, r = 1.0, 0.6, 5.0
    point = {"A": A, "B": A, "C": C, "Mg": 2.0, "z0": -0.7, "m": r, "l3": l3}
    S = C * r + l3
    root = np.sqrt(S**2 - 4 * A * 1.4)
    computed = frequencies(FIXED_POINT, **point)
    np.testing.assert_allclose(computed, [(S + root) / (2 * A), (S - root) / (2 * A)], rtol=1e-10)
    relative = of_jacobian(FIXED_POINT, default_points("fixed_point", **point), zeros=2)
    np.testing.assert_allclose(np.sort(np.abs(computed - r)), np.sort(relative), rtol=1e-6)


@pytest.mark.extension("equilibria")
def test_permanent_rotations_as_the_equations_of_motion():
    body = {
        "A": 1.0,
        "B": 1.5,
        "C": 2.0,
        "Mg": 2.0,
        "x0": 0.3,
        "y0": 0.2,
        "z0": 0.5,
        "l1": 0.4,
        "N": 0.3,
        "n": 2.5,
    }
    ds = atlas.equilibria("fixed_point", body)
    stable = ds.isel(equilibrium=ds.stable.values == 1)
    assert stable.sizes["equilibrium"] >= 2
    for i in range(stable.sizes["equilibrium"]):
        one = stable.isel(equilibrium=i)
        points = default_points("fixed_point", **body, theta0=one.theta0.item(), phi0=one.phi0.item())
        expected = of_jacobian(FIXED_POINT, points, zeros=2)
        np.testing.assert_allclose([one[name].item() for name in FREQUENCIES[:2]], expected, rtol=1e-6)
        assert np.isnan(one.frequency_3)


def test_nutation_and_polhode():
    """A regular precession nutates, in the limit of a fast top at C r / A; Euler's free body has its polhode."""
    theta, n, A, C, Mg, z0 = 0.5, 0.4, 1.0, 0.6, 1.0, -0.7
    m = (-(C - A) * n**2 * np.cos(theta) - Mg * z0) / (C * n)
    computed = frequencies(FIXED_POINT, A=A, B=A, C=C, Mg=Mg, z0=z0, theta0=theta, n=n, m=m)
    spin = C * (m + n * np.cos(theta)) / A
    square = (n * np.sin(theta)) ** 2 + (spin - 2 * n * np.cos(theta)) ** 2
    np.testing.assert_allclose(computed, [np.sqrt(square)], rtol=1e-12)
    computed = frequencies(FIXED_POINT, A=1.0, B=1.3, C=1.7, m=2.0, theta0=0.6)
    np.testing.assert_allclose(computed, [2.0 * np.sqrt(0.7 * 0.4 / 1.3)], rtol=1e-12)


@pytest.mark.parametrize("system", [SATELLITE, FIXED_POINT])
def test_variables_computed_together_are_those_computed_alone(system):
    """To the bit, at equilibria with and without oscillations and off every family."""
    rng = np.random.default_rng(0)
    points = default_points(
        system.name, A=rng.uniform(1, 2, 30), B=rng.uniform(1, 2, 30), C=rng.uniform(1, 2, 30)
    )
    points["theta0"][:10] = 0.3
    names = [*FREQUENCIES, "energy_stable", "stability_kind"]
    together = derived_values(system, names, points, np.ones(30), lambda: None)
    assert list(together) == names
    for name in names:
        alone = system.derived[name].values(points, np.ones(30), lambda: None)
        assert alone.tobytes() == together[name].tobytes()


@pytest.mark.parametrize(
    ("names", "expected"),
    [
        (FREQUENCIES, ["frequencies"]),
        (["energy_stable"], ["energy_stability"]),
        (["stability_kind"], ["linear_stability", "energy_stability"]),
        (["stability_kind", "frequency_2", "energy_stable"], ["frequencies", "energy_stability", "linear_stability"]),
    ],
)  # fmt: skip
def test_variables_share_what_they_have_in_common(names, expected, steps_of_theory):
    derived_values(SATELLITE, names, default_points("satellite", C=1.7, B=1.3), np.ones(1), lambda: None)
    assert steps_of_theory == ["identify_family", *expected]
