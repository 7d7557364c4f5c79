"""Relative equilibria of one satellite: their number, order, index and circles."""

from __future__ import annotations

import numpy as np
import pytest
from strategies import default_points

from atlas.errors import BadInput
from atlas.flags import Stability
from atlas.systems.satellite import SATELLITE
from atlas.systems.satellite.families import FAMILIES
from atlas.systems.satellite.initial import PARAMETERS, initial_state


def algebraic_count(inertia, kappa):
    """Number of equilibria without h1, from two curves that contain beta, the direction of motion.

    alpha.(4 I gamma + kappa) = 0, beta.(I gamma + kappa) = 0, beta.I alpha = 0 with kappa = k/Omega give
    gamma = (I beta - (beta.I beta) beta)/rho, alpha = beta x I beta/rho, rho = -kappa.beta, and so a
    cubic and a quartic in beta; each common real point is two equilibria, +-alpha.
    """
    rng = np.random.default_rng(0)
    basis, _ = np.linalg.qr(rng.normal(size=(3, 3)))

    def curves(x, y):
        beta = basis @ np.array([x, y, np.ones_like(x)])
        momentum = inertia[:, None] * beta
        normal = np.cross(beta, momentum, axis=0)
        determinant = (normal * inertia[:, None] * momentum).sum(0)
        component = kappa @ beta
        square = (beta**2).sum(0)
        cubic = 4 * determinant - component * (kappa @ normal)
        quartic = (momentum**2).sum(0) * square - (beta * momentum).sum(0) ** 2 - component**2 * square
        return cubic, quartic

    circle = np.exp(2j * np.pi * np.arange(8) / 8)

    def coefficients_in_y(x):
        """Coefficients of both curves in powers of y, highest first, for one x."""
        values = curves(np.full(8, x, complex), circle)
        cubic, quartic = (np.fft.fft(value) / 8 for value in values)
        return cubic[3::-1], quartic[4::-1]

    def resultant(x):
        cubic, quartic = coefficients_in_y(x)
        matrix = np.zeros((7, 7), complex)
        for i in range(4):
            matrix[i, i : i + 4] = cubic
        for i in range(3):
            matrix[4 + i, i : i + 5] = quartic
        return np.linalg.det(matrix)

    samples = np.exp(2j * np.pi * np.arange(16) / 16)
    coefficients = np.fft.fft([resultant(x) for x in samples]) / 16
    roots = np.roots(coefficients[12::-1])
    return 2 * int((np.abs(roots.imag) < 1e-7 * (1 + np.abs(roots))).sum())


@pytest.mark.parametrize("seed", range(8))
def test_all_equilibria_of_a_gyrostat_are_found(seed):
    rng = np.random.default_rng(seed)
    # no component near 0, where the two curves touch at points that are not equilibria
    inertia, k = np.array([1.0, 1.3, 1.7]), rng.uniform(0.04, 0.2, 3) * (3 if seed % 2 else 1)
    body = dict(zip("ABC", inertia, strict=True)) | {f"k{i + 1}": k[i] for i in range(3)}
    index = SATELLITE.equilibria(body | {"Omega": 1.0})["index"]
    assert len(index) == algebraic_count(inertia, k)
    assert 8 <= len(index) <= 24
    assert ((-1.0) ** index).sum() == 0  # Euler characteristic of the rotation group


def test_equilibria_are_on_their_family_and_sorted_by_potential():
    body = {"A": 1.0, "B": 1.3, "C": 1.7, "Omega": 0.4, "k1": 0.04, "k2": -0.03, "k3": 0.05, "mu1": 0.1, "mu2": 0.2,
            "mu3": -0.1, "h1": 0.3, "h3": 0.2}  # fmt: skip
    solutions = SATELLITE.equilibria(body)
    count = len(solutions["index"])
    points = {name: np.full(count, body.get(name, 0.0)) for name in PARAMETERS}
    points |= {name: solutions[name] for name in ("theta0", "psi0", "phi0")}
    flags, _ = SATELLITE.identify_family(points)
    assert (flags == FAMILIES["equilibrium"].flag).all()
    state = initial_state(points)
    np.testing.assert_allclose(state[3:6].T, solutions["alpha"], atol=1e-12)
    np.testing.assert_allclose(state[6:].T, solutions["gamma"], atol=1e-12)
    assert (np.diff(solutions["potential"]) >= 0).all()
    # a minimum of the potential is stable, an odd index unstable (Kelvin, Chetaev)
    assert (solutions["stable"][solutions["index"] == 0] == Stability.STABLE).all()
    assert (solutions["stable"][solutions["index"] % 2 == 1] == Stability.UNSTABLE).all()
    assert ((-1.0) ** solutions["index"]).sum() == 0


def test_index_is_that_of_the_difference_quotients_of_the_potential():
    body = {"A": 1.0, "B": 1.3, "C": 1.7, "Omega": 0.7, "mu1": 0.2, "h1": 0.3}
    body |= {"k1": 0.1, "k2": -0.03, "k3": 0.05}
    solutions = SATELLITE.equilibria(body)
    inertia, k = np.array([1.0, 1.3, 1.7]), np.array([0.1, -0.03, 0.05])
    names = ("theta0", "psi0", "phi0")

    def potential(angles):
        state = initial_state(default_points("satellite", **body, **dict(zip(names, angles, strict=True))))
        alpha, gamma = state[3:6, 0], state[6:, 0]
        gravity = 1.5 * 0.49 * inertia @ alpha**2 + 0.3 * 0.2 * alpha[0]
        return gravity - 0.7 * k @ gamma - 0.5 * 0.49 * inertia @ gamma**2

    step = 1e-3
    for i in range(len(solutions["index"])):
        if abs(np.sin(solutions["theta0"][i])) < 0.05:
            continue
        x = np.array([solutions[name][i] for name in names])
        assert potential(x) == pytest.approx(solutions["potential"][i], abs=1e-12)
        hessian = np.zeros((3, 3))
        for p in range(3):
            for q in range(3):
                e, f = np.eye(3)[p] * step, np.eye(3)[q] * step
                difference = potential(x + e + f) - potential(x + e - f)
                difference -= potential(x - e + f) - potential(x - e - f)
                hessian[p, q] = difference / (4 * step**2)
        assert (np.linalg.eigvalsh(hessian) < 0).sum() == solutions["index"][i]


def test_a_rigid_body_has_24_equilibria():
    solutions = SATELLITE.equilibria({"A": 1.0, "B": 1.2, "C": 1.5})
    assert np.bincount(solutions["index"]).tolist() == [4, 8, 8, 4]
    assert np.allclose(np.sort(np.abs(solutions["gamma"]), axis=1), [0, 0, 1], atol=1e-9)
    assert not solutions["circle"].any()
    assert solutions["stable"].dtype == np.int8


@pytest.mark.long
def test_circles_of_a_symmetric_body():
    """A = B: the axis along normal, velocity or radius, and any angle about it."""
    solutions = SATELLITE.equilibria({"A": 1.0, "B": 1.0, "C": 1.5})
    assert len(solutions["circle"]) == 6
    assert solutions["circle"].all()
    np.testing.assert_allclose(np.abs(solutions["axis"]), np.tile([0, 0, 1.0], (6, 1)), atol=1e-9)
    # C > A: stable along the normal and along the velocity, as in the classical diagram
    assert (solutions["stable"] == Stability.STABLE).sum() == 4
    ball = SATELLITE.equilibria({"A": 1.0, "B": 1.0, "C": 1.0, "k1": 0.3, "k3": 0.4})
    assert ball["circle"].all()
    np.testing.assert_allclose(np.abs(ball["gamma"]), [[0.6, 0, 0.8]] * 2, atol=1e-9)
    np.testing.assert_allclose(np.abs(ball["axis"]), [[0.6, 0, 0.8]] * 2, atol=1e-6)


@pytest.mark.parametrize("axis", [0, 1, 2])
@pytest.mark.parametrize("k", [0.0, 0.1, 0.7, 1.3, 3.0])
def test_circles_of_a_symmetric_gyrostat(axis, k):
    """Two each: axis on the normal; across the radius if |k| < |A - C|; across the velocity if |k| < 4 |A - C|."""
    inertia = np.full(3, 1.5)
    inertia[axis] = 1.0
    solutions = SATELLITE.equilibria({**dict(zip("ABC", inertia, strict=True)), f"k{axis + 1}": k})
    assert solutions["circle"].all()
    assert len(solutions["circle"]) == 2 + 2 * (k < 0.5) + 2 * (k < 2.0)


def test_bodies_at_rest_in_every_orientation_are_refused():
    with pytest.raises(BadInput, match="surface of equilibria"):
        SATELLITE.equilibria({"A": 1.0, "B": 1.0, "C": 1.0})
    with pytest.raises(BadInput, match="any orientation"):
        SATELLITE.equilibria({"Omega": 0.0})
