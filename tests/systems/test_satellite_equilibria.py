"""Relative equilibria of many satellites at once: homotopy continuation against other ways to find them."""

from __future__ import annotations

import numpy as np
import pytest
from test_satellite_stability import algebraic_count
from truth import default_points

from atlas.flags import Completeness, Stability
from atlas.systems.gyrostat import homotopy
from atlas.systems.satellite import SATELLITE
from atlas.systems.satellite.initial import PARAMETERS, constants, initial_state

BODY = {"A": 1.0, "B": 1.3, "C": 1.7, "Omega": 1.0}


def bodies(count, **columns):
    """Points of bodies: numbers or arrays (count,)."""
    given = BODY | columns
    return {name: np.broadcast_to(given.get(name, p.default), count) + 0.0 for name, p in PARAMETERS.items()}


def random_bodies(count, seed=0):
    """Bodies of three different moments, half of them with a magnet, on orbits of different rates."""
    rng = np.random.default_rng(seed)
    parts = rng.uniform(0.05, 1.0, (3, count))
    columns = dict(zip("ABC", parts.sum(0) - parts, strict=True)) | {"Omega": rng.uniform(0.3, 3.0, count)}
    size = 10 ** rng.uniform(-2, 0.5, count)
    columns |= {f"k{i + 1}": size * rng.normal(size=count) for i in range(3)}
    columns |= {f"mu{i + 1}": rng.normal(size=count) * (np.arange(count) % 2) for i in range(3)}
    return bodies(count, **columns, h1=rng.normal(size=count), h3=rng.normal(size=count))


def complex_solutions(inertia, p, q, starts, seed):
    """Critical points of W on the complex rotations, by Newton's method on the nine components with multipliers.

    W = 3/2 a.I a + p.a - 1/2 g.I g + q.g with a.a = g.g = 1, a.g = 0; unknowns a, g and three multipliers.
    """
    rng = np.random.default_rng(seed)
    unknown = rng.normal(size=(starts, 9)) + 1j * rng.normal(size=(starts, 9))
    eye, zero = np.eye(3), np.zeros((starts, 3, 3))
    for _ in range(80):
        a, g, (l1, l2, l3) = unknown[:, :3], unknown[:, 3:6], unknown[:, 6:].T[:, :, None]
        value = np.concatenate([
            3 * inertia * a + p - l1 * a - l3 * g, -inertia * g + q - l2 * g - l3 * a,
            np.stack([(a * a).sum(1) - 1, (g * g).sum(1) - 1, (a * g).sum(1)], 1),
        ], 1)  # fmt: skip
        upper = [np.diag(3 * inertia) - l1[..., None] * eye, -l3[..., None] * eye]
        lower = [-l3[..., None] * eye, -np.diag(inertia) - l2[..., None] * eye]
        by_multiplier = [-np.stack([a, 0 * a, g], 2), -np.stack([0 * a, g, a], 2)]
        constraints = [np.stack([2 * a, 0 * a, g], 1), np.stack([0 * a, 2 * g, a], 1), zero]
        jacobian = np.concatenate([
            np.concatenate([*upper, by_multiplier[0]], 2), np.concatenate([*lower, by_multiplier[1]], 2),
            np.concatenate(constraints, 2),
        ], 1)  # fmt: skip
        step = np.linalg.solve(jacobian, value[:, :, None])[:, :, 0]
        length = np.linalg.norm(step, axis=1)
        unknown = unknown - step * np.minimum(1, 1 / np.maximum(length, 1))[:, None]
    solutions = unknown[(length < 1e-9) & (np.abs(unknown).max(1) < 1e3)]
    distinct = []
    for solution in solutions:
        if all(np.abs(solution[:6] - other).max() > 1e-6 for other in distinct):
            distinct.append(solution[:6])
    return np.array(distinct)


@pytest.mark.parametrize("seed", [0, 1])
def test_24_complex_equilibria_of_a_general_body(seed):
    """The number on which the continuation rests, with magnet and rotor, from equations of another form."""
    rng = np.random.default_rng(seed)
    inertia, p, q = rng.normal(size=(3, 3)) + 1j * rng.normal(size=(3, 3))
    assert len(complex_solutions(inertia, p, q, 2500, seed)) == homotopy.PATHS


def test_continuation_finds_the_solutions_of_newtons_method():
    inertia, p, q = np.random.default_rng(3).normal(size=(3, 3))
    real = complex_solutions(inertia + 0j, p, q, 2500, 0)
    real = real[np.abs(real.imag).max(1) < 1e-9].real
    alpha, gamma, is_real, _, complete = homotopy.solve(inertia[:, None], p[:, None], q[:, None])
    assert complete.all()
    continued = np.concatenate([alpha, gamma])[:, is_real[:, 0], 0].T
    assert len(continued) == len(real)
    distance = np.abs(continued[:, None] - real).max(2)
    assert distance.min(1).max() < 1e-9


def test_counts_of_gyrostats_are_those_of_their_curves():
    rng = np.random.default_rng(1)
    k = rng.uniform(0.04, 0.6, (3, 60))
    solutions = SATELLITE.equilibria_of_bodies(bodies(60, k1=k[0], k2=k[1], k3=k[2]), stability=False)
    counts = (solutions["index"] >= 0).sum(1)
    assert (solutions["completeness"] == Completeness.COMPLETE).all()
    assert counts.tolist() == [algebraic_count(np.array([1.0, 1.3, 1.7]), k[:, i]) for i in range(60)]
    assert set(counts) >= {12, 16, 24}


@pytest.mark.parametrize("k", [0.05, 0.35, 0.5, 0.9, 1.5, 2.0, 3.0])
def test_rotor_along_an_axis(k):
    """Rotor along the third axis: all equilibria with one body axis along one of the frame, in closed form.

    gamma = +-e3, or alpha = +-e1, +-e2 if |k| < |C - B|, |C - A|, or beta = +-e1, +-e2 if |k| < 4 |C - B|, 4 |C - A|.
    """
    solutions = SATELLITE.equilibria_of_bodies(bodies(1, k3=k))
    alpha, gamma = solutions["alpha"][0], solutions["gamma"][0]
    used = solutions["index"][0] >= 0
    beta = np.cross(gamma, alpha)

    def along(vector, axis):
        return int((np.abs(np.abs(vector[used, axis]) - 1) < 1e-12).sum())

    assert along(gamma, 2) == 8
    upright = np.abs(gamma[:, 2]) > 1 - 1e-9
    tilted = {name: vector[~upright & used] for name, vector in (("alpha", alpha), ("beta", beta))}
    for name, factor in (("alpha", 1.0), ("beta", 4.0)):
        for axis, difference in ((0, 0.4), (1, 0.7)):
            count = (np.abs(np.abs(tilted[name][:, axis]) - 1) < 1e-12).sum()
            assert count == (4 if k < factor * difference else 0)


def test_every_equilibrium_of_random_bodies_rests_and_the_indices_sum_to_zero():
    points = random_bodies(400)
    solutions = SATELLITE.equilibria_of_bodies(points)
    used = solutions["index"] >= 0
    assert (solutions["completeness"] == Completeness.COMPLETE).mean() > 0.98
    sums = np.where(used, (-1.0) ** solutions["index"], 0.0).sum(1)
    isolated = solutions["completeness"] <= Completeness.NEAR_BIFURCATION
    assert (sums[isolated] == 0).all()
    assert isolated.all()
    # A function on the rotation group has at least four critical points, among them a minimum and a maximum.
    assert used.sum(1).min() >= 4
    body, place = np.nonzero(used)
    at_rest = {name: values[body] for name, values in points.items()}
    at_rest |= {name: solutions[name][body, place] for name in ("theta0", "psi0", "phi0")}
    state = initial_state(at_rest)
    scale = (np.abs(state[:3]).max(0) + 1) * (1 + np.abs(constants(at_rest)).max(0))
    assert np.abs(np.array(SATELLITE.equations.rhs(state, constants(at_rest))) / scale).max() < 1e-9
    minima = solutions["index"][body, place] == 0
    assert (solutions["stable"][body, place][minima] == Stability.STABLE).all()
    odd = solutions["index"][body, place] % 2 == 1
    assert (solutions["stable"][body, place][odd] == Stability.UNSTABLE).all()


def test_bodies_at_once_and_one_by_one():
    points = random_bodies(12, seed=5)
    solutions = SATELLITE.equilibria_of_bodies(points)
    for i in range(12):
        one = SATELLITE.equilibria({name: values[i] for name, values in points.items()})
        count = len(one["index"])
        assert (solutions["index"][i, count:] == -1).all()
        assert np.isnan(solutions["theta0"][i, count:]).all()
        np.testing.assert_allclose(solutions["potential"][i, :count], one["potential"], rtol=0, atol=1e-12)
        np.testing.assert_allclose(solutions["growth_rate"][i, :count], one["growth_rate"], rtol=0, atol=1e-7)
        np.testing.assert_array_equal(solutions["stable"][i, :count], one["stable"])
        np.testing.assert_array_equal(solutions["index"][i, :count], one["index"])


def test_no_result_depends_on_the_other_bodies():
    points = random_bodies(40, seed=2)
    together = SATELLITE.equilibria_of_bodies(points)
    for part in (slice(0, 1), slice(7, 24)):
        alone = SATELLITE.equilibria_of_bodies({name: values[part] for name, values in points.items()})
        for name, values in alone.items():
            np.testing.assert_array_equal(values, together[name][part], name)


def test_bodies_without_isolated_equilibria_and_on_bifurcations():
    points = bodies(
        6,
        A=np.array([1.0, 1.0, 1.0, 1.0, 1.0, 1.0]),
        B=np.array([1.0, 1.0, 1.3, 1.3, 1.3, 1.3]),
        C=np.array([1.5, 1.0, 1.7, 1.7, 1.7, 1.7]),
        Omega=np.array([1.0, 1.0, 0.0, 1.0, 1.0, 1e-80]),
        k3=np.array([0.0, 0.0, 0.1, 0.4, 0.4 * (1 + 1e-4), 0.0]),
    )
    solutions = SATELLITE.equilibria_of_bodies(points)
    assert [Completeness(flag).name for flag in solutions["completeness"]] == [
        "NOT_ISOLATED", "NOT_LISTED", "NOT_LISTED", "NEAR_BIFURCATION", "COMPLETE", "NOT_LISTED",
    ]  # fmt: skip
    assert solutions["circle"][0].sum() == 6
    assert (solutions["index"][[1, 2, 5]] == -1).all()
    count = SATELLITE.derived["equilibrium_count"].values(points, np.ones(6), lambda: None)
    np.testing.assert_array_equal(np.isnan(count), [True, True, True, False, False, True])
    assert count[4] == (solutions["index"][4] >= 0).sum()


def test_counts_pause_and_stop():
    def stop():
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        SATELLITE.derived["equilibrium_count"].values(random_bodies(3), np.ones(3), stop)


def test_energy_stable_equilibria_are_the_minima():
    """Without a rotor the four orientations with the least axis along the radius and the greatest along the normal."""
    points = default_points("satellite", A=1.0, B=1.3, C=1.7)
    counts = {
        name: derived.values(points, np.ones(1), lambda: None).item()
        for name, derived in SATELLITE.derived.items()
        if derived.is_count
    }
    assert counts == {
        "equilibrium_count": 24, "equilibrium_stable_count": 4, "equilibrium_energy_stable_count": 4,
    }  # fmt: skip
