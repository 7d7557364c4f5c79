"""Steady motions of the fixed-point system: proofs, stability, the solver, and the verified cases."""

import itertools

import numpy as np
import pytest
import sympy as sp
from closed_forms import nutation, stability, upright
from family_starts import exact_starts
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import solve_ivp
from strategies import (
    default_points,
    fixed_points_on_family,
    predictions,
    random_fixed_points,
    select,
    symmetric_fixed_points,
)
from truth import cases, fixed_point_cases, jacobian_matrices, monodromy_matrix

from atlas.flags import Label, Stability
from atlas.measure.instrument import Tolerances
from atlas.measure.rates import geometry
from atlas.systems.base import on_family
from atlas.systems.fixed_point import FIXED_POINT, equations, families, initial
from atlas.systems.gyrostat import secular
from atlas.theory.motions import condition_residual

FAMILIES = families.FAMILIES
FLAG = {name: family.flag for name, family in FAMILIES.items()}


def sleeping_at_threshold(points):
    """2 N (C - A) - s Mg z0, the sign of the term theta^4 of the effective potential where the term theta^2 vanishes."""
    Mg, N = initial.fields(points)
    return 2 * N * (points["C"] - points["A"]) - np.sign(initial.vertical(points)[2]) * Mg * points["z0"]


def linear_stability(points):
    """Stability and growth rate of the family that each point is on."""
    return FIXED_POINT.linear_stability(points, FIXED_POINT.identify_family(points)[0])


def rotations_of(points, n):
    """All permanent rotations of one body at the rate n."""
    return FIXED_POINT.equilibria({name: values[0] for name, values in points.items()} | {"n": n})


# The 55 verified cases.


def test_every_case_is_recognised():
    points = fixed_point_cases()
    initial.check(points)
    flags, family_residual = families.identify_family(points)
    third_axis_residual = condition_residual(FIXED_POINT, points)
    sine, n, m = families.steady_rates(points)
    for i, case in enumerate(cases("fixed_point")):
        assert flags[i] == (FLAG[case["kind"]] if case["kind"] else 0), case["name"]
        residuals = np.array([family_residual[i], third_axis_residual[i]])
        assert (residuals < 1e-13).all() if case["kind"] else (residuals > 1e-6).all(), case["name"]
        if case["n"] is not None:
            np.testing.assert_allclose([n[i], m[i]], [case["n"], case["m"]], rtol=1e-12, atol=1e-12)
        if case["kind"] == "sleeping":
            assert sine[i] < 1e-12
            assert m[i] + n[i] * np.cos(case["theta0"]) == pytest.approx(case["w0"][2], abs=1e-15)


def test_every_case_has_its_stability():
    points = fixed_point_cases()
    stable, growth = linear_stability(points)
    meanings = dict.fromkeys(("stable", "linearly stable", "stable(linear)"), Stability.STABLE)
    meanings["unstable"] = Stability.UNSTABLE
    for i, case in enumerate(cases("fixed_point")):
        if case["kind"] and case["linear_stability"]:
            assert stable[i] == meanings[case["linear_stability"]], case["name"]
        if "max growth rate" in case["note"] and stable[i] == Stability.UNSTABLE:
            assert growth[i] == pytest.approx(float(case["note"].split()[-1]), rel=5e-3)
        if case["nutation_freq2"] is not None:
            squared_frequency, _ = nutation(select(points, i))
            assert squared_frequency[0] == pytest.approx(case["nutation_freq2"], rel=1e-10)


def test_every_case_has_its_label_and_geometry():

    points, durations = fixed_point_cases(), np.array([case["T"] for case in cases("fixed_point")])
    predicted = predictions(FIXED_POINT, points, duration=durations)[0].variables["predicted"]
    labels = [case["label"] for case in cases("fixed_point")]
    assert [Label(value).name.lower() for value in predicted] == labels
    _, n, m = families.steady_rates(points)
    measured = {"psi_dot_mean": n, "phi_dot_mean": m}
    steady = np.array([label != "drifting" for label in labels])
    upright = np.array([case["kind"] == "sleeping" for case in cases("fixed_point")])
    names = ["none", *FIXED_POINT.geometries]
    flags = geometry(FIXED_POINT, measured, steady, upright, Tolerances(1e-5, 1e-5))
    assert flags.dtype == np.int8
    assert [names[flag] for flag in flags] == [case["geometry"] for case in cases("fixed_point")]


# Proofs.


def test_steady_motion_satisfies_exactly_the_equations_of_the_catalogue():
    """The equations of motion of w = n g + m e3, and the coefficient of each harmonic of phi."""
    A, B, C, n, m, N, s, c, phi = sp.symbols("A B C n m N s c phi")
    l1, l2, l3, M1, M2, M3 = sp.symbols("l1 l2 l3 M1 M2 M3")
    g1, g2 = s * sp.sin(phi), s * sp.cos(phi)
    constants = (A, B, C, 1 / A, 1 / B, 1 / C, l1, l2, l3, M1, M2, M3, N * A, N * B, N * C, 0)
    rates = equations.rhs((n * g1, n * g2, n * c + m, g1, g2, c), constants)
    K = n**2 - N
    b1, b2, b3 = n * l1 + M1, n * l2 + M2, n * l3 + M3
    torques = (
        K * (B - C) * g2 * c + n * m * (B - A - C) * g2 + b2 * c - b3 * g2 + m * l2,
        K * (C - A) * g1 * c + n * m * (B - A + C) * g1 + b3 * g1 - b1 * c - m * l1,
        K * (A - B) * g1 * g2 + b1 * g2 - b2 * g1,
    )
    steady_rates = (n * m * g2, -n * m * g1, 0)
    for moment, rate, steady_rate, torque in zip((A, B, C), rates[:3], steady_rates, torques, strict=True):
        assert sp.expand(moment * (rate - steady_rate) - torque) == 0
    # phi' = m alone satisfies g' = g x w.
    assert sp.simplify(rates[3] - m * g2) == 0
    assert sp.simplify(rates[4] + m * g1) == 0
    assert sp.simplify(rates[5]) == 0
    # With A = B, l = (0, 0, l3) and the centre of mass on the axis, one equation remains.
    lagrange = {B: A, l1: 0, l2: 0, M1: 0, M2: 0}
    balance = (C - A) * K * c + (C * m + l3) * n + M3
    assert sp.expand(torques[0].subs(lagrange) + g2 * balance) == 0
    assert sp.expand(torques[1].subs(lagrange) - g1 * balance) == 0
    assert sp.expand(torques[2].subs(lagrange)) == 0
    # With A != B two coefficients must vanish; their sum is (B - A)(K c + 2 n m).
    coefficient1 = K * (B - C) * c + n * m * (B - A - C) - b3
    coefficient2 = K * (C - A) * c + n * m * (B - A + C) + b3
    assert sp.expand(coefficient1 + coefficient2 - (B - A) * (K * c + 2 * n * m)) == 0


def steady_residual(points):
    """Largest difference of w' from that of the steady motion over a turn of phi, over the squared rate."""
    t = np.linspace(0, 2 * np.pi, 12, endpoint=False)[:, None] / np.where(points["m"] == 0, 1.0, points["m"])
    constants = initial.constants(points)[:, None]
    gamma = initial.vertical(points)
    angle = t * points["m"]
    g = np.array(
        [
            gamma[0] * np.cos(angle) + gamma[1] * np.sin(angle),
            gamma[1] * np.cos(angle) - gamma[0] * np.sin(angle),
            np.broadcast_to(gamma[2], angle.shape),
        ]
    )
    w = points["n"] * g + points["m"] * np.array([0, 0, 1.0])[:, None, None]
    rate = np.array(equations.rhs(np.concatenate([w, g]), constants)[:3])
    rate -= points["n"] * points["m"] * np.array([g[1], -g[0], np.zeros_like(angle)])
    scale = families.squared_rate(points)
    return np.sqrt((rate**2).sum(0)).max(0) / np.where(scale > 0, scale, 1.0)


@given(
    moments=st.sampled_from([(1.0, 1.0, 1.5), (1.0, 1.3, 1.7), (1.0, 1.0, 1.0), (1.2, 1.0, 1.2)]),
    numbers=st.tuples(*[st.sampled_from([0.0, 0.0, 1.0, -1.5])] * 10),
    theta=st.sampled_from([0.0, 0.7, np.pi / 2, np.pi]),
    phi=st.sampled_from([0.0, 0.4, np.pi / 2]),
    formula=st.sampled_from([None, *((f, p) for f, family in FAMILIES.items() for p in family.solve)]),
)
@settings(max_examples=300, deadline=None)
def test_a_point_is_recognised_if_and_only_if_it_is_steady(moments, numbers, theta, phi, formula):
    """The catalogue contains all steady motions and nothing else, also where many parameters vanish."""
    names = ("Mg", "x0", "y0", "z0", "N", "l1", "l2", "l3", "n", "m")
    points = default_points(
        "fixed_point",
        **dict(zip("ABC", moments, strict=True)),
        **dict(zip(names, numbers, strict=True)),
        theta0=theta,
        phi0=phi,
    )
    if formula:
        family, name = formula
        value = FAMILIES[family].solve[name](points)
        if not np.isnan(value).any():
            points[name] = value
    steady = bool(steady_residual(points)[0] < 1e-10)
    flags, residual = families.identify_family(points)
    assert (flags[0] > 0) == steady
    assert (residual[0] <= 1e-10) == steady
    if steady:
        assert condition_residual(FIXED_POINT, points)[0] < 1e-10


def test_both_roots_of_the_quadratic_are_reached():
    points = default_points(
        "fixed_point", A=1.0, B=1.0, C=1.5, Mg=3.0, z0=1.0, N=0.5, l3=0.8, theta0=0.8726646259971648, m=6.0
    )
    slow = FAMILIES["conical"].solve["n"](points)[0]
    fast = FAMILIES["conical"].solve["n"](points | {"n": np.full(1, -30.0)})[0]
    assert fast == pytest.approx(-30.19965575936793, rel=1e-13)  # verified case 9
    assert abs(slow) < 1 < abs(fast)
    for n in (slow, fast):
        assert abs(families.precession(points, n=n)[0]) < 1e-12


@pytest.mark.parametrize("name", ["l3", "Mg", "z0", "N", "C", "A", "theta0", "m", "n"])
def test_every_parameter_of_a_conical_motion_can_be_solved(name):
    rng = np.random.default_rng(4)
    family = FAMILIES["conical"]
    points = fixed_points_on_family("conical", symmetric_fixed_points(rng, 300), name)
    points["B"] = family.solve["B"](points)
    assert np.all(on_family(family, points) < 1e-10)
    assert points["A"].size > 30


@pytest.mark.parametrize("name", ["l1", "l2", "l3", "x0", "y0", "z0", "Mg", "N"])
def test_single_parameters_of_a_plane_permanent_rotation_can_be_solved(name):
    """In a principal plane a single condition remains, and one parameter can meet it."""
    rng = np.random.default_rng(5)
    if name in ("l2", "y0"):
        plane = {"phi0": 0.0, "x0": 0.0, "l1": 0.0}
    else:
        plane = {"phi0": np.pi / 2, "y0": 0.0, "l2": 0.0}
    points = fixed_points_on_family(
        "staude", random_fixed_points(rng, 50, theta_dot0=0.0, m=0.0, **plane), name
    )
    assert points["A"].size > 30
    assert np.all(on_family(FAMILIES["staude"], points) < 1e-10)
    if name in ("l3", "Mg"):
        outside_plane = random_fixed_points(rng, 50, theta_dot0=0.0, m=0.0)
        assert np.isnan(FAMILIES["staude"].solve[name](outside_plane)).all()


def test_a_parameter_without_effect_keeps_its_value_or_has_no_solution():
    sphere = default_points("fixed_point", A=1.0, B=1.0, C=1.0, Mg=0.0, l3=2.0, m=-2.0, n=0.7, theta0=0.4)
    assert FAMILIES["conical"].solve["theta0"](sphere)[0] == pytest.approx(0.4)
    assert np.isnan(FAMILIES["conical"].solve["theta0"](sphere | {"m": np.ones(1)})[0])
    heavy = sphere | {"n": np.zeros(1), "Mg": np.ones(1), "z0": np.ones(1)}
    assert np.isnan(FAMILIES["conical"].solve["m"](heavy)[0])


@pytest.mark.parametrize(
    ("name", "C", "exists"), [("A", 1.9, 1), ("A", 2.1, 0), ("C", 1.9, 1), ("C", 2.1, 0), ("C", -0.1, 0)]
)
def test_solved_moments_of_inertia_are_those_of_bodies(name, C, exists):
    """C at most A + B, here 2 A, and positive."""
    top = default_points("fixed_point", A=1.0, B=1.0, C=C, Mg=1.0, theta0=0.6, n=1.3, m=0.8, l3=0.4)
    top["z0"] = -families.precession(top)
    solved = FAMILIES["conical"].solve[name](top | {name: np.full(1, 0.7)})
    np.testing.assert_allclose(solved, top[name] if exists else np.nan, rtol=1e-12)


def test_the_same_motion_given_by_vectors_is_recognised():
    for kind, points in exact_starts().items():
        state = initial.initial_state(points)
        zero = {name: np.zeros_like(points["A"]) for name in ("theta0", "phi0", "n", "m")}
        names = ("p0", "q0", "r0", "gamma10", "gamma20", "gamma30")
        by_vectors = points | zero | dict(zip(names, state, strict=True))
        flags, expected = (families.identify_family(start)[0] for start in (by_vectors, points))
        np.testing.assert_array_equal(flags, expected, err_msg=kind)


def test_a_start_with_a_rate_about_the_node_is_on_no_family():
    points = exact_starts()["conical"] | {"theta_dot0": np.full(12, 1e-6)}
    assert np.all(families.identify_family(points)[0] == 0)
    assert np.all(condition_residual(FIXED_POINT, points) > 1e-8)


def test_weight_and_rotor_do_not_replace_each_other_where_the_resting_body_turns():
    """Each would have to vanish: they act along axes that turn with the body and along one that does not."""
    turning = default_points(
        "fixed_point", A=1.0, B=1.0, C=1.4, Mg=1.0, x0=0.5, l1=1.0, m=0.5, theta0=np.pi / 2, phi0=np.pi / 2
    )
    assert on_family(FAMILIES["rest"], turning)[0] > 0.1


# All permanent rotations.


def count_by_polynomial(d, b):
    """Number of real roots of the secular equation, by Sturm's theorem on its polynomial."""
    L = sp.Symbol("L")
    d, b = [sp.Rational(float(x)) for x in d], [sp.Rational(float(x)) for x in b]
    factors = [(x - L) ** 2 for x in d]
    cofactors = [factors[1] * factors[2], factors[0] * factors[2], factors[0] * factors[1]]
    terms = (x**2 * cofactor for x, cofactor in zip(b, cofactors, strict=True))
    return sp.Poly(sp.prod(factors) - sum(terms), L).count_roots()


@pytest.mark.long
def test_every_permanent_rotation_is_found():
    rng = np.random.default_rng(8)
    points = random_fixed_points(rng, 60, theta_dot0=0.0, m=0.0, n=rng.choice([0.0, 1.0, 3.0, 10.0], 60))
    g, dimension = secular.directions(initial.body(points)._replace(turn=points["n"]))
    counts = (dimension == 0).sum(0)
    assert set(counts) == {2, 4, 6}
    inertia, rotor, weight, N = initial.bodies(points)
    for i in range(60):
        d, b = (points["n"][i] ** 2 - N[i]) * inertia[:, i], points["n"][i] * rotor[:, i] + weight[:, i]
        assert counts[i] == count_by_polynomial(d, b)
    scale = 1 + points["n"] ** 2
    for i in range(12):
        exists = dimension[i] >= 0
        gradient = (points["n"] ** 2 - N) * inertia * g[:, i] + points["n"] * rotor + weight
        torque = np.cross(gradient, g[:, i], axis=0)
        assert np.all(np.abs(torque / scale)[:, exists] < 1e-13)
        np.testing.assert_allclose((g[:, i, exists] ** 2).sum(0), 1, rtol=1e-14)
        assert np.isnan(g[:, i, ~exists]).all()


def test_solver_finds_the_extreme_directions():
    """Also of degenerate bodies, the directions with the largest and the smallest h on the sphere are listed."""
    bodies = [(1.0, 1.3, 1.7), (1.0, 1.0, 1.5), (1.5, 1.0, 1.5), (1.0, 1.0, 1.0)]
    component = [0.0, 1e-12, 1e-3, 0.1, 1.0, -0.3]
    every = itertools.product(bodies, component, component, component, (0.0, 1.0, 2.0))
    columns = np.array([(*inertia, *b_and_n) for inertia, *b_and_n in every]).T
    names = ("A", "B", "C", "x0", "y0", "z0", "n")
    points = default_points("fixed_point", Mg=1.0, N=0.5, **dict(zip(names, columns, strict=True)))
    g, dimension = secular.directions(initial.body(points)._replace(turn=points["n"]))
    d, b = (points["n"] ** 2 - 0.5) * columns[:3], columns[3:6]
    exists = dimension >= 0
    assert np.abs(np.cross(d[:, None] * g + b[:, None], g, axis=0)[:, exists]).max() < 1e-12
    everywhere = (dimension == 2).any(0)
    assert not b[:, everywhere].any()
    isolated = ~(dimension > 0).any(0)
    assert np.isin(exists.sum(0)[isolated], (2, 4, 6)).all()
    directions = np.random.default_rng(0).normal(size=(3, 400))
    directions /= np.linalg.norm(directions, axis=0)
    listed = (0.5 * d[:, None] * g**2 + b[:, None] * g).sum(0)[:, ~everywhere]
    others = (0.5 * directions.T**2 @ d + directions.T @ b)[:, ~everywhere]
    assert (np.nanmax(listed, 0) >= others.max(0) - 1e-12).all()
    assert (np.nanmin(listed, 0) <= others.min(0) + 1e-12).all()


@pytest.mark.extension("equilibria")
def test_degenerate_bodies_have_circles_of_solutions():
    top = default_points("fixed_point", A=1.0, B=1.0, C=1.5, Mg=0.5, z0=1.0)
    rotations = rotations_of(top, 1.5)
    assert list(rotations["dimension"]) == [0, 1, 0]
    assert np.cos(rotations["theta0"][1]) == pytest.approx(-0.5 / (0.5 * 1.5**2))
    np.testing.assert_allclose(rotations["theta0"][[0, 2]], [0, np.pi])
    free_sphere = rotations_of(default_points("fixed_point", A=1.0, B=1.0, C=1.0), 1.0)
    assert list(free_sphere["dimension"]) == [2]
    free_body = rotations_of(default_points("fixed_point", A=1.0, B=1.3, C=1.7), 2.0)
    assert free_body["theta0"].size == 6
    gamma = np.abs(free_body["gamma"].T)
    np.testing.assert_allclose(np.sort(gamma, 0)[:2], 0, atol=1e-15)
    # Rotation about the axis of the largest or the smallest moment is stable, about the middle one unstable.
    axis = gamma.argmax(0)
    assert list(free_body["stable"][axis == 1]) == [Stability.UNSTABLE] * 2
    assert np.all(free_body["stable"][axis != 1] == Stability.STABLE)


def test_solved_directions_are_the_nearest():
    rng = np.random.default_rng(11)
    points = random_fixed_points(rng, 200, theta_dot0=0.0, m=0.0, n=5.0)
    family = FAMILIES["staude"]
    solved = fixed_points_on_family("staude", points, "theta0", "phi0")
    assert solved["A"].size == 200
    g, dimension = secular.directions(initial.body(points)._replace(turn=points["n"]))
    distance = np.where(dimension >= 0, -(g * initial.vertical(points)[:, None]).sum(0), np.inf)
    distance_of_solved = -(initial.vertical(solved) * initial.vertical(points)).sum(0)
    np.testing.assert_allclose(distance_of_solved, distance.min(0), atol=1e-12)
    assert np.isnan(family.solve["phi0"](points)).all()


# Stability.


def floquet_multipliers(points, duration):
    """Eigenvalues of the linearised flow of one point over a time."""
    state, constants = initial.initial_state(points)[:, 0], initial.constants(points)[:, 0]
    return np.linalg.eigvals(monodromy_matrix(equations.rhs, state, constants, duration))


@pytest.mark.parametrize("seed", range(6))
def test_nutation_frequency_of_conical_motions(seed):
    """Floquet multipliers over one turn of phi are exp(+-i nutation 2 pi / m) and 1."""
    rng = np.random.default_rng(seed)
    sign = 1.0 if seed % 2 else -1.0
    points = symmetric_fixed_points(
        rng, 1, C=0.5, N=4.0 if seed % 2 else 0.5, l3=0.1, n=0.6 * sign, Mg=1.5, theta0=1.2
    )
    points = fixed_points_on_family("conical", points, "m")
    period = 2 * np.pi / abs(points["m"][0])
    squared_frequency, _ = nutation(points)
    expected = np.exp(np.array([1, -1]) * np.sqrt(-squared_frequency.astype(complex)) * period)
    multipliers = floquet_multipliers(points, period)
    for value in expected:
        assert np.abs(multipliers - value).min() < 1e-5 * abs(value)
    stable, growth = linear_stability(points)
    if squared_frequency[0] < 0:
        assert stable[0] == Stability.UNSTABLE
        assert growth[0] == pytest.approx(np.log(np.abs(multipliers).max()) / period, rel=1e-5)
    else:
        assert (stable[0], growth[0]) == (Stability.STABLE, 0.0)


def test_an_unstable_precession_grows_at_its_rate():
    wanted = [
        case["linear_stability"] == "unstable" and case["kind"] == "conical" for case in cases("fixed_point")
    ]
    points = select(fixed_point_cases(), wanted.index(True))
    growth = linear_stability(points)[1][0]
    assert growth == pytest.approx(np.sqrt(0.7125), rel=1e-12)
    _, _, m = families.steady_rates(points)
    period = 2 * np.pi / abs(m[0])
    assert np.log(np.abs(floquet_multipliers(points, period)).max()) / period == pytest.approx(
        growth, rel=1e-5
    )


@pytest.mark.parametrize("kind", ["staude", "staude, rotor", "rest", "sleeping"])
def test_stability_of_permanent_rotations_against_eigenvalues(kind):
    points = exact_starts(7, 60)[kind]
    stable, growth = linear_stability(points)
    constants, state = initial.constants(points), initial.initial_state(points)
    matrices = jacobian_matrices(equations.rhs, state, constants)
    largest = np.linalg.eigvals(matrices).real.max(1)
    # The eigenvalue 0 is double and defective: it is computed with an error of the square root of rounding.
    unstable = largest > 1e-3
    assert np.all(stable[unstable] == Stability.UNSTABLE)
    np.testing.assert_allclose(growth[unstable], largest[unstable], rtol=1e-4)
    assert np.all(stable[~unstable] == Stability.STABLE)
    assert {Stability.STABLE, Stability.UNSTABLE} == set(stable)


@pytest.mark.long
@pytest.mark.extension("equilibria")
def test_index_of_the_amended_potential_decides_the_stability():
    """Index 0 is stable and index 1 unstable, for every permanent rotation of many bodies."""
    rng = np.random.default_rng(3)
    kinds = set()
    for _ in range(40):
        points = random_fixed_points(rng, 1, theta_dot0=0.0)
        rotations = rotations_of(points, float(rng.normal()))
        index, stable = rotations["index"], rotations["stable"]
        assert np.all(stable[index == 0] == Stability.STABLE)
        assert np.all(stable[index == 1] == Stability.UNSTABLE)
        kinds |= set(zip(index.tolist(), stable.tolist(), strict=True))
    assert kinds >= {(0, Stability.STABLE), (1, Stability.UNSTABLE), (2, Stability.UNSTABLE)}


def sleeping_points(side, **given):
    """A heavy body with its third axis towards the attracting centre (side 1) or away from it (-1)."""
    theta0 = 0.0 if side > 0 else np.pi
    body = {"A": 1.0, "B": 1.0, "C": 1.4, "Mg": 1.1, "z0": 1.0, "N": 0.3, "theta0": theta0}
    return default_points("fixed_point", **(body | given))


@pytest.mark.parametrize("side", [1, -1])
@pytest.mark.parametrize("l3", [0.0, 0.7, -0.7])
def test_sleeping_threshold(side, l3):
    """Rate at which the discriminant vanishes, both sides of it, and the growth of the tilt."""
    points = sleeping_points(side, A=0.5, B=0.5, C=0.7, l3=l3, Mg=-side * 1.1)
    threshold = np.sqrt(4 * 0.5 * (0.3 * 0.2 + 1.1))
    expected = {0.99: Stability.UNSTABLE, 1.01: Stability.STABLE, 1.0: Stability.UNKNOWN}
    for factor, stability_flag in expected.items():
        m = (threshold * factor - l3) / 0.7
        sleeping = points | {"m": np.full(1, m)}
        (stable,), (growth,) = linear_stability(sleeping)
        assert stable == stability_flag
        _, (expected_growth,) = stability(*upright(sleeping))
        assert growth == pytest.approx(expected_growth, abs=1e-7 if factor == 1 else 1e-12)


@pytest.mark.usual("True")
@pytest.mark.parametrize(("N", "C", "stays"), [(0.2, 1.4, True), (4.0, 0.4, False)])
def test_sleeping_at_the_threshold_is_decided_by_the_fourth_order(N, C, stays):
    """Upright body exactly at the threshold: where the theta^4 term holds it, it swings by the root of its tilt."""
    points = sleeping_points(-1, N=N, C=C, Mg=3.0)
    points["m"] = np.full(1, np.sqrt(4 * (N * (C - 1) + 3.0)) / C)
    assert (sleeping_at_threshold(points)[0] > 0) == stays
    assert linear_stability(points)[0][0] == Stability.UNKNOWN
    amplitudes = []
    for tilt in (1e-2, 1e-4):
        tilted = points | {"theta0": np.full(1, np.pi - tilt)}
        constants = initial.constants(tilted)[:, 0]
        solution = solve_ivp(
            lambda _, y, constants=constants: equations.rhs(y, constants), (0, 400.0),
            initial.initial_state(tilted)[:, 0], method="DOP853", rtol=1e-10, atol=1e-13,
        )  # fmt: skip
        amplitudes.append(np.hypot(solution.y[3], solution.y[4]).max())
    if stays:
        assert amplitudes[0] / amplitudes[1] == pytest.approx(10, rel=0.02)
    else:
        assert min(amplitudes) > 0.9


def test_free_body_turning_about_its_third_axis():
    """The middle axis is unstable at Euler's rate; a fast rotor makes it stable."""
    points = default_points("fixed_point", A=1.0, B=1.7, C=1.3, m=2.0, theta0=0.6)
    assert families.identify_family(points)[0][0] == FLAG["rest"]
    stable, growth = linear_stability(points)
    assert stable[0] == Stability.UNSTABLE
    assert growth[0] == pytest.approx(2.0 * np.sqrt(0.3 * 0.4 / 1.7))
    assert np.log(np.abs(floquet_multipliers(points, 10.0)).max()) / 10 == pytest.approx(growth[0], rel=0.02)
    with_rotor = points | {"l3": np.full(1, 3.0)}
    assert linear_stability(with_rotor)[0][0] == Stability.STABLE


@pytest.mark.extension("equilibria")
def test_neutral_bodies_have_no_growth_unless_unstable():
    free_sphere = default_points("fixed_point", A=1.0, B=1.0, C=1.0)
    assert families.identify_family(free_sphere)[0][0] == FLAG["sleeping"]
    stable, growth = linear_stability(free_sphere)
    assert (stable[0], growth[0]) == (Stability.UNKNOWN, 0.0)
    # A body symmetric about its first axis has a circle of permanent rotations, along which two exponents are 0.
    points = default_points("fixed_point", A=1.5, B=1.0, C=1.0, Mg=1.0, x0=0.4, n=1.5)
    inclined = rotations_of(points, 1.5)
    circle = inclined["dimension"] == 1
    assert circle.sum() == 1
    (stable,), (growth,) = inclined["stable"][circle], inclined["growth_rate"][circle]
    assert (stable, growth) == (Stability.STABLE, 0.0)


def test_catalogue_is_in_order():
    assert [family.flag for family in FAMILIES.values()] == [1, 2, 3, 4]
    assert list(FAMILIES) == ["conical", "sleeping", "staude", "rest"]
    for family in FAMILIES.values():
        assert set(family.solve) <= set(initial.PARAMETERS)
        assert family.geometry in ("", *FIXED_POINT.geometries)
