"""Lagrange's form of the satellite's equations against the Lagrangian and against Euler-Poisson."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from strategies import DRAG, random_satellites
from truth import lagrangian_arguments, lagrangian_functions

from atlas.extensions.yehia2021 import lagrange, published
from atlas.systems.satellite import equations
from atlas.systems.satellite.initial import constants, initial_state

OF_THE_PAPER = dict.fromkeys(DRAG, 0.0)


def states(points):
    return np.array([points[name] for name in ("psi0", "theta0", "phi0", "n", "theta_dot0", "m")])


def test_corrected_equations_are_those_of_the_lagrangian():
    points = random_satellites(np.random.default_rng(1), 200, **OF_THE_PAPER)
    accelerations = np.random.default_rng(2).normal(size=(3, 200))
    expected = np.array(lagrangian_functions()["left_sides"](*lagrangian_arguments(points, accelerations)))[
        :, 0
    ]
    left_sides = np.array(lagrange.equations(states(points), accelerations, constants(points)))
    np.testing.assert_allclose(left_sides, expected, atol=2e-13)


def test_same_accelerations_as_euler_poisson():
    points = random_satellites(np.random.default_rng(3), 500, **OF_THE_PAPER)
    rates = np.array(lagrange.rhs(states(points), constants(points)))
    np.testing.assert_array_equal(rates[:3], states(points)[3:])
    residuals = lagrange.equations(states(points), rates[3:], constants(points))
    assert np.abs(residuals).max() < 1e-12
    w_dot = np.array(lagrangian_functions()["w_dot"](*lagrangian_arguments(points, rates[3:])))[:, 0]
    expected = np.array(equations.rhs(initial_state(points), constants(points)))[:3]
    assert (np.abs(w_dot - expected).max(0) / (1 + np.abs(expected).max(0))).max() < 1e-13


def test_same_motion_as_euler_poisson():
    points = random_satellites(np.random.default_rng(4), 2, **OF_THE_PAPER)
    for i in range(2):
        point_constants = constants(points)[:, i]
        options = {"method": "DOP853", "rtol": 1e-12, "atol": 1e-12}
        angles = solve_ivp(
            lambda t, y, c=point_constants: lagrange.rhs(y, c), (0, 3), states(points)[:, i], **options
        )
        cosines = solve_ivp(
            lambda t, y, c=point_constants: equations.rhs(y, c),
            (0, 3),
            initial_state(points)[:, i],
            **options,
        )
        names = ("psi0", "theta0", "phi0", "n", "theta_dot0", "m")
        point = {name: value[i : i + 1] for name, value in points.items()}
        final = initial_state(point | {name: angles.y[j, -1:] for j, name in enumerate(names)})
        np.testing.assert_allclose(final[:, 0], cosines.y[:, -1], atol=1e-8)


@pytest.mark.parametrize("number", ["(5)", "(6)", "(7)"])
def test_printed_equations_are_not_those_of_the_motion(number):
    row = next(row for row in published.PUBLISHED if row.number == number)
    residuals = [row.residual_printed(np.random.default_rng(seed)) for seed in range(50)]
    assert np.median(residuals) > 0.1


def test_accelerations_are_not_finite_where_the_tilt_is_zero():
    """The mass matrix has determinant A B C sin^2 theta."""
    points = random_satellites(np.random.default_rng(6), 3, **OF_THE_PAPER, theta0=0.0)
    with np.errstate(divide="ignore", invalid="ignore"):
        rates = np.array(lagrange.rhs(states(points), constants(points)))
    assert not np.isfinite(rates[3]).any()
    point = random_satellites(np.random.default_rng(7), 1, **OF_THE_PAPER)
    arguments = (float(value[0]) for value in lagrangian_arguments(point))
    determinant = np.linalg.det(np.array(lagrangian_functions()["mass"](*arguments), float))
    inertia_product = np.prod([point[name][0] for name in "ABC"])
    assert determinant == pytest.approx(inertia_product * np.sin(point["theta0"][0]) ** 2, rel=1e-12)
