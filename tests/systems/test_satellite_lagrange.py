"""Lagrange's form of the satellite's equations against the Lagrangian and against Euler-Poisson."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from test_satellite_equations import arguments, derived, random_points

from atlas.systems.satellite import equations
from atlas.systems.satellite.initial import constants, initial_state
from atlas.systems.satellite.paper import lagrange


def states(points):
    return np.array([points[name] for name in ("psi0", "theta0", "phi0", "n", "theta_dot0", "m")])


def test_corrected_equations_are_those_of_the_lagrangian():
    points = random_points(1, 200)
    accelerations = np.random.default_rng(2).normal(size=(3, 200))
    expected = np.array(derived()["left"](*arguments(points, accelerations)))[:, 0]
    values = np.array(lagrange.equations(states(points), accelerations, constants(points)))
    np.testing.assert_allclose(values, expected, atol=2e-13)


def test_same_accelerations_as_euler_poisson():
    points = random_points(3, 500)
    rates = np.array(lagrange.rhs(states(points), constants(points)))
    np.testing.assert_array_equal(rates[:3], states(points)[3:])
    zero = lagrange.equations(states(points), rates[3:], constants(points))
    assert np.abs(zero).max() < 1e-12
    w_dot = np.array(derived()["w_dot"](*arguments(points, rates[3:])))[:, 0]
    expected = np.array(equations.rhs(initial_state(points), constants(points)))[:3]
    assert (np.abs(w_dot - expected).max(0) / (1 + np.abs(expected).max(0))).max() < 1e-13


def test_same_motion_as_euler_poisson():
    points = random_points(4, 2)
    for i in range(2):
        values = constants(points)[:, i]
        options = {"method": "DOP853", "rtol": 1e-12, "atol": 1e-12}
        angles = solve_ivp(lambda t, y, c=values: lagrange.rhs(y, c), (0, 3), states(points)[:, i], **options)
        cosines = solve_ivp(
            lambda t, y, c=values: equations.rhs(y, c), (0, 3), initial_state(points)[:, i], **options
        )
        names = ("psi0", "theta0", "phi0", "n", "theta_dot0", "m")
        one = {name: value[i : i + 1] for name, value in points.items()}
        end = initial_state(one | {name: angles.y[j, -1:] for j, name in enumerate(names)})
        np.testing.assert_allclose(end[:, 0], cosines.y[:, -1], atol=1e-8)


@pytest.mark.parametrize("index", [0, 1, 2])
def test_printed_equations_are_not_satisfied(index):
    points = random_points(5, 200)
    accelerations = lagrange.rhs(states(points), constants(points))[3:]
    printed = lagrange.equations_printed(states(points), accelerations, constants(points))[index]
    assert np.median(np.abs(printed)) > 0.1


def test_singular_where_the_tilt_is_zero():
    """The mass matrix has determinant A B C sin^2 theta: the result is not finite, never a wrong number."""
    points = random_points(6, 3, theta0=0.0)
    with np.errstate(divide="ignore", invalid="ignore"):
        rates = np.array(lagrange.rhs(states(points), constants(points)))
    assert not np.isfinite(rates[3]).any()
    near = random_points(7, 1)
    determinant = np.linalg.det(np.array(derived()["mass"](*(float(x[0]) for x in arguments(near))), float))
    body = np.prod([near[name][0] for name in "ABC"])
    assert determinant == pytest.approx(body * np.sin(near["theta0"][0]) ** 2, rel=1e-12)
