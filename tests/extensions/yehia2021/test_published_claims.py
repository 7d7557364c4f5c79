"""Sentences of the satellite's paper, beyond its equations, by vectors, computer algebra and linear algebra."""

import numpy as np
import pytest
import sympy as sp
from strategies import default_points
from truth import paper_vectors, satellite_symbols

from atlas.extensions.yehia2021.published import ENTRIES, PUBLISHED, random_point, residual, with_values
from atlas.systems.base import families_of
from atlas.systems.satellite import SATELLITE
from atlas.systems.satellite.equations import rhs
from atlas.systems.satellite.initial import constants, initial_state

ROWS = {row.number: row for row in PUBLISHED}


def test_every_numbered_equation_has_a_row():
    numbers = " ".join(ROWS)
    for i in range(1, 46):
        assert f"({i})" in numbers, i


@pytest.mark.long
def test_the_kinematics_by_computer_algebra():
    """(1): the columns of a rotation matrix, whose rate is that of omega'."""
    alpha, beta, gamma, rate = paper_vectors()
    angles, rates, _, _ = satellite_symbols()
    frame = sp.Matrix.hstack(alpha, beta, gamma)
    assert (frame.T * frame).applyfunc(sp.simplify) == sp.eye(3)
    assert (alpha.cross(beta) - gamma).applyfunc(sp.simplify) == sp.zeros(3, 1)
    for vector in (alpha, gamma):
        turning = vector.jacobian(angles) * sp.Matrix(rates) - vector.cross(rate)
        assert turning.applyfunc(sp.simplify) == sp.zeros(3, 1)


def test_the_potential_is_that_of_point_masses():
    """(3): a body of point masses far from the Earth, less the monopole, against 3/2 Omega^2 alpha.I alpha."""
    rng = np.random.default_rng(0)
    masses, positions = rng.uniform(0.5, 1, 6), rng.normal(size=(6, 3))
    positions -= masses @ positions / masses.sum()
    inertia = np.einsum("i,ij,ik->jk", masses, positions, positions)
    inertia = np.trace(inertia) * np.eye(3) - inertia

    def potential(alpha, distance):  # Omega^2 = G M / R^3
        distances = np.linalg.norm(distance * alpha + positions, axis=1)
        return -(distance**3) * (masses / distances).sum()

    def direction():
        vector = rng.normal(size=3)
        return vector / np.linalg.norm(vector)

    first, second = direction(), direction()
    expected = 1.5 * (first @ inertia @ first - second @ inertia @ second)
    errors = [abs(potential(first, R) - potential(second, R) - expected) for R in (1e3, 1e4)]
    assert errors[0] < 1e-2 * abs(expected)
    assert errors[1] < 0.2 * errors[0]


def test_no_tilted_motion_without_magnet_has_another_k3_than_that_of_the_formula_of_3():
    """The torque along the nodes is linear in k3 and vanishes at one value alone."""
    entry = ENTRIES["after (23), formula of [3]"]
    for seed in range(3):
        point = with_values(random_point(np.random.default_rng(seed)), entry["start"] | entry["as_true"])
        assert residual(point) < 1e-13
        for change in (-1.0, 0.5):
            moved = with_values(point, {"k3": f"k3 + {change}"})
            expected = abs(change * np.sin(point["theta0"]) * point["Omega"])[0]
            unit = point["A"][0]
            assert residual(moved) == pytest.approx(expected / unit, rel=0.05)


@pytest.mark.parametrize("number", [row for row in ROWS if row.endswith("in space")])
def test_motions_in_inertial_space_by_integration(number):
    """Attitude in space after one time unit, from the equations of motion, against both rotations one after the other."""
    from scipy.integrate import solve_ivp
    from scipy.spatial.transform import Rotation

    entry = ENTRIES[number]
    motion = ENTRIES[entry["motion"]]
    point = with_values(random_point(np.random.default_rng(1)), motion["start"])
    points = default_points("satellite", 1, **{k: v for k, v in point.items() if k != "damping"})
    start = initial_state(points)[:, 0]
    c = constants(points)[:, 0]
    end = solve_ivp(lambda _, y: rhs(y, c), (0, 1.0), start, rtol=1e-11, atol=1e-12).y[:, -1]

    def attitude(state, angle):
        alpha, gamma = state[3:6], state[6:9]
        beta = np.cross(gamma, alpha)
        return np.array(
            [
                np.cos(angle) * alpha - np.sin(angle) * beta,
                np.sin(angle) * alpha + np.cos(angle) * beta,
                gamma,
            ]
        )

    Omega = point["Omega"][0]
    precession, spin = (
        float(np.ravel(with_values(point, {"rate": text})["rate"])[0])
        for text in map(str, entry.get("inertial_true", entry["inertial"]))
    )
    before, after = attitude(start, 0.0), attitude(end, Omega)
    normal = np.array([0.0, 0.0, 1.0])  # in space
    expected = Rotation.from_rotvec(precession * normal).as_matrix() @ before
    expected = expected @ Rotation.from_rotvec(spin * normal).as_matrix()  # about the body's third axis
    np.testing.assert_allclose(after, expected, atol=1e-8)


def test_neither_vanishing_rotor_nor_translation_is_no_motion():
    """After (44): with mu1 = mu2 = 0 one of the two is necessary."""
    point = random_point(np.random.default_rng(2))
    values = {"B": "A", "theta0": 0, "h1": 0, "mu1": 0, "mu2": 0}
    expected = abs((point["Omega"] + point["m"] + point["n"]) * np.hypot(point["k1"], point["k2"]))[0]
    assert residual(with_values(point, values)) * point["A"][0] > 0.5 * expected


def test_a_rational_ratio_leaves_coefficients_undetermined():
    """After (43): ten equations of n/m = 1/2 have a smaller rank than those of an irrational ratio."""
    i = np.arange(1, 11)

    def rank(ratio):
        x = np.pi * i * ratio
        waves = np.array([np.cos(2 * x), np.sin(2 * x), np.cos(x), np.sin(x), np.ones(10)])
        return np.linalg.matrix_rank(np.concatenate([waves * (i % 2), waves * (1 - i % 2)]))

    assert rank(np.sqrt(2)) == 10 > rank(0.5)
    assert ROWS["after (43)"].residual_true(np.random.default_rng(0)) == 0


def test_special_cases_are_those_of_the_general_conditions():
    """After (20) and (24): the conditions without a magnet, by substitution."""
    A, B, C, Omega, m, mu3, h1, h3, theta = sp.symbols("A B C Omega m mu3 h1 h3 theta")
    tilted = (-mu3 * h1 + sp.sqrt(3) * (Omega**2 * (A + B - C) + mu3 * h3)) / (sp.sqrt(3) * Omega)
    assert sp.simplify(tilted.subs(mu3, 0) - Omega * (A + B - C)) == 0
    s, c = sp.sin(theta), sp.cos(theta)
    velocity = (s * (4 * c * (B - C) * Omega**2 - C * Omega * m + mu3 * h3) - mu3 * h1 * c) / (Omega * s)
    assert sp.simplify(velocity.subs({mu3: 0, B: A}) - (4 * c * (A - C) * Omega - C * m)) == 0
    radius = (Omega**2 * (B - C) * c - m * Omega * C + mu3 * h3) / Omega
    formula_of_3 = -m * A - (C - A) * (Omega * c + m)
    assert sp.simplify(radius.subs({mu3: 0, B: A}) - formula_of_3) == 0
    assert sp.simplify(velocity.subs({mu3: 0, B: A}) - formula_of_3) != 0


@pytest.mark.parametrize("row", PUBLISHED, ids=lambda row: row.number)
def test_printed_equations(row):
    printed = [row.residual_printed(np.random.default_rng(seed)) for seed in range(5)]
    true = [row.residual_true(np.random.default_rng(seed)) for seed in range(5)]
    assert max(true) < 1e-12
    assert row.family in ("", *families_of(SATELLITE))
    if row.verdict == "true":
        assert max(printed) < 1e-12
    else:
        assert np.median(printed) > 1e-2
