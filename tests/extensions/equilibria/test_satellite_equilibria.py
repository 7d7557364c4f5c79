"""Relative equilibria of many satellites at once: homotopy continuation against other ways to find them."""

from __future__ import annotations

import json
from itertools import product

import numpy as np
import pytest
from strategies import DRAG
from test_one_satellite import algebraic_count
from truth import REFERENCE

import atlas
from atlas.extensions.equilibria import homotopy
from atlas.flags import Completeness, Stability
from atlas.systems.satellite import SATELLITE
from atlas.systems.satellite.initial import PARAMETERS, constants, initial_state

BODY = {"A": 1.0, "B": 1.3, "C": 1.7, "Omega": 1.0}


def bodies(count, **columns):
    """Points of bodies: numbers or arrays (count,)."""
    given = BODY | columns
    return {name: np.broadcast_to(given.get(name, p.default), count) + 0.0 for name, p in PARAMETERS.items()}


def random_bodies(count, seed=0):
    """Bodies of three different moments, half of them with a magnet, a third with drag, on orbits of different rates."""
    rng = np.random.default_rng(seed)
    parts = rng.uniform(0.05, 1.0, (3, count))
    columns = dict(zip("ABC", parts.sum(0) - parts, strict=True)) | {"Omega": rng.uniform(0.3, 3.0, count)}
    size = 10 ** rng.uniform(-2, 0.5, count)
    columns |= {f"k{i + 1}": size * rng.normal(size=count) for i in range(3)}
    columns |= {f"mu{i + 1}": rng.normal(size=count) * (np.arange(count) % 2) for i in range(3)}
    drag = rng.spawn(1)[0].normal(size=(3, count)) * (np.arange(count) % 3 == 2)
    columns |= dict(zip(DRAG, drag, strict=True))
    return bodies(count, **columns, h1=rng.normal(size=count), h3=rng.normal(size=count))


def complex_solutions(inertia, p, r, q, starts, seed):
    """Critical points of W on the complex rotations, by Newton's method on the nine components with multipliers.

    W = 3/2 a.I a + p.a + r.(g x a) - 1/2 g.I g + q.g with a.a = g.g = 1, a.g = 0; unknowns a, g and three multipliers.
    """
    hat = np.cross(r, np.eye(3)).T
    rng = np.random.default_rng(seed)
    unknown = rng.normal(size=(starts, 9)) + 1j * rng.normal(size=(starts, 9))
    eye, zero = np.eye(3), np.zeros((starts, 3, 3))
    for _ in range(80):
        a, g, (l1, l2, l3) = unknown[:, :3], unknown[:, 3:6], unknown[:, 6:].T[:, :, None]
        value = np.concatenate([
            3 * inertia * a + p + np.cross(r, g) - l1 * a - l3 * g,
            -inertia * g + q - np.cross(r, a) - l2 * g - l3 * a,
            np.stack([(a * a).sum(1) - 1, (g * g).sum(1) - 1, (a * g).sum(1)], 1),
        ], 1)  # fmt: skip
        upper = [np.diag(3 * inertia) - l1[..., None] * eye, hat - l3[..., None] * eye]
        lower = [-hat - l3[..., None] * eye, -np.diag(inertia) - l2[..., None] * eye]
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


@pytest.mark.usual("1.0-1")
@pytest.mark.parametrize("seed", [0, 1])
@pytest.mark.parametrize("drag", [0.0, 1.0])
def test_24_complex_equilibria_of_a_general_body(seed, drag):
    """The number on which the continuation rests, with magnet, rotor and drag, from equations of another form."""
    rng = np.random.default_rng(seed)
    inertia, p, q = rng.normal(size=(3, 3)) + 1j * rng.normal(size=(3, 3))
    r = drag * rng.normal(size=(2, 3)).T @ [1, 1j]
    assert len(complex_solutions(inertia, p, r, q, 2500, seed)) == homotopy.PATHS


# The rotation of a quaternion (w, x, y, z), rows alpha, beta, gamma: quadratic forms with the coefficients of these products.
ROTATION = [
    [{"ww": 1, "xx": 1, "yy": -1, "zz": -1}, {"xy": 2, "wz": -2}, {"xz": 2, "wy": 2}],
    [{"xy": 2, "wz": 2}, {"ww": 1, "xx": -1, "yy": 1, "zz": -1}, {"yz": 2, "wx": -2}],
    [{"xz": 2, "wy": -2}, {"yz": 2, "wx": 2}, {"ww": 1, "xx": -1, "yy": -1, "zz": 1}],
]
FORMS = np.zeros((3, 3, 4, 4))
for (i, j), terms in np.ndenumerate(np.array(ROTATION, object)):
    for factors, coefficient in terms.items():
        u, v = map("wxyz".index, factors)
        FORMS[i, j, u, v] += 0.5 * coefficient
        FORMS[i, j, v, u] += 0.5 * coefficient


def eigenvectors_of_the_quartic(inertia, fields, rng):
    """The different rotations among the 40 eigenvectors grad F(x) = 4 x, up to sign, of W + c as a quartic form F of a quaternion.

    Cartwright and Sturmfels 2013: a general symmetric tensor of order 4 on C^4 has (3^4 - 1)/2 of them. Paths from those of
    x^3 = x; isotropic eigenvectors, of which 40 - 24 remain for every W, are no rotations.
    """
    squares, shift = np.zeros((3, 3), complex), 3 + rng.normal() + 1j * rng.normal()
    squares[0], squares[2] = 1.5 * inertia, -0.5 * inertia
    turn, eye = np.exp(2j * np.pi * rng.random()), np.eye(4)
    every = np.array(list(product(range(-1, 2), repeat=4)), complex)
    first = every[np.arange(81), (every != 0).argmax(1)].real
    x = every[first > 0].copy()
    assert len(x) == 40

    def quartic(x):
        """grad F / 4 and its derivatives; F = squares.R^2 + |x|^2 fields.R + shift |x|^4."""
        half = np.einsum("ijkl,nl->nijk", FORMS, x)
        R, n = np.einsum("nijk,nk->nij", half, x), (x * x).sum(1)
        linear, along = np.einsum("ij,nij->n", fields, R), np.einsum("ij,nijk->nk", fields, half)
        gradient = np.einsum("ij,nij,nijk->nk", squares, R, half) + 0.5 * n[:, None] * along
        gradient += (0.5 * linear + shift * n)[:, None] * x
        hessian = np.einsum("ij,nijk,nijl->nkl", 2 * squares, half, half)
        hessian += np.einsum("ij,nij,ijkl->nkl", squares, R, FORMS)
        hessian += 0.5 * n[:, None, None] * np.einsum("ij,ijkl->kl", fields, FORMS)
        hessian += along[:, :, None] * x[:, None] + x[:, :, None] * along[:, None]
        hessian += (0.5 * linear + shift * n)[:, None, None] * eye + 2 * shift * x[:, :, None] * x[:, None]
        return gradient, hessian, R

    def residual(x, s):
        gradient, hessian, _ = quartic(x)
        start, slope = turn * (x**3 - x), turn * (3 * x[:, :, None] ** 2 * eye - eye)
        s = s[:, None]
        value = (1 - s) * start + s * (gradient - x)
        return value, (1 - s[..., None]) * slope + s[..., None] * (hessian - eye), gradient - x - start

    s, step = np.zeros(40), np.full(40, 0.02)
    for _ in range(4000):
        active = np.flatnonzero((s < 1) & (step > 1e-12) & (np.abs(x).max(1) < 1e6))
        if not active.size:
            break
        now, length = x[active], np.minimum(step[active], 1 - s[active])
        _, matrix, change = residual(now, s[active])
        new = now - length[:, None] * np.linalg.solve(matrix, change[..., None])[..., 0]
        for _ in range(4):
            value, matrix, _ = residual(new, s[active] + length)
            last = np.linalg.solve(matrix, value[..., None])[..., 0]
            new = new - last
        good = (np.abs(last).max(1) < 1e-9) & (
            np.abs(new - now).max(1) < 0.2 * np.maximum(0.5, np.abs(now).max(1))
        )
        x[active[good]], s[active[good]] = new[good], (s[active] + length)[good]
        step[active] = np.where(good, np.minimum(1.5 * length, 0.05), length / 3)
    n = (x * x).sum(1)
    arrived = (s == 1) & (np.abs(x).max(1) < 1e3) & (np.abs(n) > 1e-6 * (np.abs(x) ** 2).sum(1))
    rotations = quartic(x[arrived] / np.sqrt(n[arrived])[:, None])[2].reshape(-1, 9)
    distance = np.abs(rotations[:, None] - rotations).max(2)
    return rotations[~np.triu(distance < 1e-6, 1).any(0)]


@pytest.mark.parametrize(
    ("present", "symmetric", "expected"),
    [("pq", False, 24), ("r", False, 24), ("prq", False, 24), ("prq", True, 16)],
)
def test_the_number_of_complex_equilibria_by_eigenvectors_of_a_quartic_form(present, symmetric, expected):
    """24 for every general body, 16 where two moments are equal, with drag too."""
    rng = np.random.default_rng(3)
    inertia = 0.5 + np.abs(rng.normal(size=3))
    inertia[1] = inertia[0] if symmetric else inertia[1]
    fields = np.array([rng.normal(size=3) * (name in present) for name in "prq"])
    assert len(eigenvectors_of_the_quartic(inertia, fields, rng)) == expected


@pytest.mark.long
@pytest.mark.parametrize("with_p", [0.0, 1.0])
@pytest.mark.parametrize("with_r", [0.0, 1.0])
def test_continuation_finds_the_solutions_of_newtons_method(with_p, with_r):
    rng = np.random.default_rng(3)
    inertia, p, q = rng.normal(size=(3, 3))
    p, r = with_p * p, with_r * rng.normal(size=3)
    real = complex_solutions(inertia + 0j, p, r, q, 2500, 0)
    real = real[np.abs(real.imag).max(1) < 1e-9].real
    columns = (vector[:, None] for vector in (inertia, p, r, q))
    alpha, gamma, is_real, _, complete = homotopy.solve(*columns)
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


@pytest.mark.long
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


@pytest.mark.long
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


def dense_search(body, starts=300):
    """alpha and gamma, (E, 6), of the critical points of W for Omega = 1 by Newton's method on the rotations, starts also beside them."""
    inertia, k, mu, drag = (
        np.array([body.get(f"{x}{i}" if x else "ABC"[i - 1], 0.0) for i in (1, 2, 3)])
        for x in ("", "k", "mu", "drag")
    )
    fields = (3.0, body.get("h1", 0.0) * mu), (0.0, drag), (-1.0, body.get("h3", 0.0) * mu - k)
    rng, seeds = np.random.default_rng(0), np.zeros((0, 3, 3))
    for angle in (3.0, 0.1, 0.01):
        frames = np.linalg.qr(rng.normal(size=(starts, 3, 3)))[0] * rng.choice([-1, 1], (starts, 3, 1))
        frames[:, 1] = np.cross(frames[:, 2], frames[:, 0])
        beside = turned(np.repeat(seeds, 40, 0), angle * rng.normal(size=(40 * len(seeds), 3)))
        frames = np.concatenate([frames, seeds, beside])
        for _ in range(60):
            gradient, hessian = np.zeros((len(frames), 3)), np.zeros((len(frames), 3, 3))
            for (factor, field), v in zip(fields, frames.swapaxes(0, 1), strict=True):
                slope = factor * inertia * v + field
                gradient += np.cross(slope, v)
                for j, change in enumerate(np.cross(v[:, None], np.eye(3)).swapaxes(0, 1)):
                    hessian[:, :, j] += np.cross(factor * inertia * change, v) + np.cross(slope, change)
            step = -np.linalg.solve(hessian + 1e-300 * np.eye(3), gradient[..., None])[..., 0]
            size = np.linalg.norm(step, axis=1)
            frames = turned(frames, step * np.minimum(1, 0.4 / np.maximum(size, 0.4))[:, None])
        kept = []
        for frame in frames[(size < 1e-4) & (np.linalg.norm(gradient, axis=1) < 1e-11)]:
            if all(np.abs(frame - other).max() > 1e-3 for other in kept):
                kept.append(frame)
        seeds = np.array(kept)
    return seeds[:, [0, 2]].reshape(-1, 6)


def turned(frames, xi):
    """Frames of bodies turned by rotation vectors."""
    angle = np.linalg.norm(xi, axis=1)[:, None, None]
    n = (xi / np.maximum(angle[:, 0], 1e-300))[:, None]
    return (
        frames * np.cos(angle)
        + np.cross(frames, n) * np.sin(angle)
        + n * (frames * n).sum(-1, keepdims=True) * (1 - np.cos(angle))
    )


def beside_symmetry(rng, i):
    """A body with two moments nearly equal; the rest as a symmetric body has it, across, or across by the same small difference."""
    first, second = ((0, 1), (0, 2), (1, 2))[i % 3]
    third, difference = 3 - first - second, 10 ** rng.uniform(-9, -3) * rng.choice([-1, 1])
    moments = np.full(3, 1.0)
    moments[second], moments[third] = 1 + difference, rng.choice([0.7, 1.4])
    k, mu = rng.normal(size=(2, 3)) * 0.3
    drag = 0.3 * rng.spawn(1)[0].normal(size=3) * (i % 2)
    if i // 3 != 1:
        across = [first, second]
        for vector in (k, mu, drag):
            vector[across] *= difference * (i // 3 == 2)
    vectors = {f"{name}{j + 1}": v[j] for name, v in (("k", k), ("mu", mu), ("drag", drag)) for j in range(3)}
    return dict(zip("ABC", moments, strict=True)) | vectors | {"h1": 0.4, "h3": -0.7}


@pytest.mark.long
def test_lists_beside_a_symmetry_are_whole():
    """Against a search by itself, for one body and for all at once; the circles of the symmetric body are no equilibria here."""
    rng = np.random.default_rng(17)
    every = [beside_symmetry(rng, i) for i in range(9)]
    together = atlas.equilibria("satellite", {name: [body[name] for body in every] for name in every[0]})
    assert (together.completeness == Completeness.COMPLETE).all()
    for i, body in enumerate(every):
        one, expected = atlas.equilibria("satellite", body), dense_search(body)
        assert not one.circle.any()
        assert ((-1) ** one["index"].astype(int)).sum() == 0
        assert one.sizes["equilibrium"] == together.equilibrium_count[i] == len(expected), i
        vectors = np.concatenate([one.alpha, one.gamma], 1)
        distance = np.abs(vectors[:, None] - expected).max(2)
        assert distance.min(0).max() < 1e-5
        assert distance.min(1).max() < 1e-5
        np.testing.assert_array_equal(together["index"][i, : len(expected)], one["index"])


def test_a_vector_whose_square_underflows_leaves_a_list_incomplete():
    ds = atlas.equilibria("satellite", {"A": 1.0, "B": 1.0, "C": 1.0, "k2": [5e-324, 1e-200, 0.1]})
    assert list(ds.completeness) == 2 * [Completeness.NOT_LISTED] + [Completeness.NOT_ISOLATED]


@pytest.mark.parametrize("difference", [1e-12, -1e-10, 3e-8, 1e-5])
def test_a_circle_leaves_four_equilibria_beside_its_symmetry(difference):
    ds = atlas.equilibria("satellite", {"A": 1.3 + difference, "B": 1.3, "C": 1.7, "k3": 0.1})
    assert np.bincount(ds["index"]).tolist() == [4, 8, 8, 4]
    assert (ds.stable.values[ds["index"].values % 2 == 1] != Stability.STABLE).all()
    assert (ds.stable.values[ds["index"].values == 0] != Stability.UNSTABLE).all()


def listed(body):
    """Number of equilibria by a call for one body and by one for an array, which agree; 0: both refuse."""
    many = atlas.equilibria("satellite", {name: [value] for name, value in body.items()})
    if many.completeness in (Completeness.NEAR_BIFURCATION, Completeness.NOT_LISTED):
        assert np.isnan(many.equilibrium_count)
        with pytest.raises(atlas.BadInput, match="not certain"):
            atlas.equilibria("satellite", body)
        return 0
    count = atlas.equilibria("satellite", body).sizes["equilibrium"]
    assert many.equilibrium_count == count
    return count


@pytest.mark.long
def test_lists_beside_bifurcations_are_whole_or_refused():
    """Beside verified folds and beside pitchforks of a rotor along an axis, where 24 equilibria become 20, and 16 become 12."""
    case = json.loads((REFERENCE / "branches.json").read_text())["satellite"][0]
    folds = [
        (float(fold["k1"]), fold["count_below_above"], {"k2": 0.02, "k3": 0.05}, "k1")
        for fold in case["folds"][::4]
    ]
    folds += [(k3, counts, {}, "k3") for k3, counts in ((0.4, [24, 20]), (1.6, [16, 12]))]
    refused = 0
    for value, counts, rest, name in folds:
        for side, distance in ((0, -1e-6), (1, 1e-9), (0, 0.0)):
            count = listed(BODY | rest | {name: value + distance})
            assert count == counts[side] or (count == distance == 0), (value, distance, count)
            refused += count == 0
    assert refused >= len(folds)


def test_a_rounded_symmetry_is_refused():
    assert 0.1 + 0.2 != 0.3
    assert listed(BODY | {"A": 0.3, "B": 0.1 + 0.2, "C": 0.4, "k3": 0.02}) == 0


def bodies_with_all_torques(count, seed):
    """Bodies of three different moments under all torques, a fifth of them without drag and a fifth with drag alone."""
    rng = np.random.default_rng(seed)
    parts = rng.uniform(0.05, 1.0, (3, count))
    columns = dict(zip("ABC", parts.sum(0) - parts, strict=True))
    kind, size = np.arange(count) % 5, 10 ** rng.uniform(-1.5, 0.7, (5, count))
    for name, own, without in (("k", 0, 1), ("mu", 1, 1), ("drag", 2, 0)):
        columns |= {f"{name}{i}": size[own] * rng.normal(size=count) * (kind != without) for i in (1, 2, 3)}
    return bodies(count, **columns, h1=size[3] * (kind != 1), h3=size[4] * rng.choice([-1, 1], count))


def newton(points, starts, rng):
    """Frames at rest to which Newton's method goes from random ones, (bodies, starts, 3, 3), and where it converges."""
    inertia, k, mu, drag = (
        np.array([points[f"{x}{i}" if x else "ABC"[i - 1]] for i in (1, 2, 3)]).T[:, None]
        for x in ("", "k", "mu", "drag")
    )
    h1, h3 = (points[name][:, None, None] for name in ("h1", "h3"))
    terms = (3.0, h1 * mu), (0.0, drag), (-1.0, h3 * mu - k)
    scale = np.abs(inertia).sum(2) + np.abs(h1 * mu).sum(2) + np.abs(h3 * mu - k).sum(2) + np.abs(drag).sum(2)
    shape = (len(points["A"]), starts)
    frames = np.linalg.qr(rng.normal(size=(*shape, 3, 3)))[0] * rng.choice([-1, 1], (*shape, 3, 1))
    frames[:, :, 1] = np.cross(frames[:, :, 2], frames[:, :, 0])
    for _ in range(50):
        gradient, hessian = np.zeros((*shape, 3)), np.zeros((*shape, 3, 3))
        for row, (factor, field) in enumerate(terms):
            v = frames[:, :, row]
            slope = factor * inertia * v + field
            gradient += np.cross(slope, v)
            for j in range(3):
                change = np.cross(v, np.eye(3)[j])
                hessian[..., j] += np.cross(factor * inertia * change, v) + np.cross(slope, change)
        step = -np.linalg.solve(hessian + 1e-300 * np.eye(3), gradient[..., None])[..., 0]
        size = np.linalg.norm(step, axis=-1)
        step *= np.minimum(1, 0.4 / np.maximum(size, 0.4))[..., None]
        frames = turned(frames.reshape(-1, 3, 3), step.reshape(-1, 3)).reshape(frames.shape)
    return frames, (size < 1e-9) & (np.linalg.norm(gradient, axis=-1) < 1e-11 * scale)


@pytest.mark.parametrize("count", [40, pytest.param(2000, marks=pytest.mark.long)])
def test_newtons_method_finds_no_equilibrium_that_is_not_listed(count):
    """Random bodies under all torques, 500 random orientations each."""
    points, rng = bodies_with_all_torques(count, 5), np.random.default_rng(6)
    listed = SATELLITE.equilibria_of_bodies(points, stability=False)
    complete = listed["completeness"] == Completeness.COMPLETE
    assert complete.mean() > 0.99
    vectors, found = np.concatenate([listed["alpha"], listed["gamma"]], 2), 0
    for first in range(0, count, 20):
        part = np.arange(first, min(first + 20, count))
        frames, converged = newton({name: values[part] for name, values in points.items()}, 500, rng)
        ends = np.concatenate([frames[:, :, 0], frames[:, :, 2]], 2)
        distance = np.nanmin(np.abs(ends[:, :, None] - vectors[part, None]).max(3), 2)
        place = np.nanargmin(np.abs(ends[:, :, None] - vectors[part, None]).max(3), 2)
        missed = converged & (distance > 1e-5) & complete[part, None]
        assert not missed.any(), np.argwhere(missed)
        found += sum(np.unique(place[i][converged[i]]).size for i in np.flatnonzero(complete[part]))
    assert found > 0.98 * (listed["index"][complete] >= 0).sum()
