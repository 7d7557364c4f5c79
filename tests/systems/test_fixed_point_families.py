"""Steady motions of the fixed-point system: proofs, stability, the solver, and the verified cases."""

import json
from pathlib import Path

import numpy as np
import pytest
import sympy as sp
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import solve_ivp

from atlas.flags import Label
from atlas.systems.base import on_family
from atlas.systems.fixed_point import FIXED_POINT, equations, equilibria, families, initial, stability

CASES = json.loads((Path(__file__).parents[1] / "reference" / "fixed_point_cases.json").read_text())["cases"]
FAMILIES = families.FAMILIES
FLAG = {name: family.flag for name, family in FAMILIES.items()}


def points(**given):
    size = max((np.size(value) for value in given.values()), default=1)
    known = {name: parameter.default for name, parameter in initial.PARAMETERS.items()} | given
    assert set(known) == set(initial.PARAMETERS)
    return {name: np.broadcast_to(np.asarray(value, float), (size,)).copy() for name, value in known.items()}


def random_points(size, rng, **given):
    part = rng.uniform(0.3, 1.0, (3, size))
    body = dict(zip("ABC", part.sum(0) - part, strict=True))
    names = ("Mg", "x0", "y0", "z0", "N", "l1", "l2", "l3", "n", "m")
    rest = {name: rng.normal(size=size) for name in names}
    angles = {"theta0": rng.uniform(0.2, 2.9, size), "phi0": rng.uniform(-3, 3, size)}
    return points(**(body | rest | angles | given))


def symmetric_points(size, rng, **given):
    C = rng.uniform(0.3, 1.9, size)
    axial = {"A": 1.0, "B": 1.0, "C": C, "x0": 0.0, "y0": 0.0, "l1": 0.0, "l2": 0.0}
    return random_points(size, rng, **(axial | given))


def solved(family, at, *names):
    """The points with the named parameters from the family's formulas, those where they exist."""
    at = dict(at)
    for name in names:
        at[name] = FAMILIES[family].solve[name](at)
    there = np.all([~np.isnan(at[name]) for name in names], axis=0)
    assert there.any()
    return {name: values[there] for name, values in at.items()}


def of_cases():
    def column(get):
        return np.array([get(case) for case in CASES], float)

    given = {name: column(lambda case, name=name: case[name]) for name in ("A", "B", "C", "Mg", "N")}
    vectors = {
        "rc": ("x0", "y0", "z0"),
        "l": ("l1", "l2", "l3"),
        "w0": ("p0", "q0", "r0"),
        "gamma0": ("gamma10", "gamma20", "gamma30"),
    }
    for key, names in vectors.items():
        given |= {name: column(lambda case, key=key, i=i: case[key][i]) for i, name in enumerate(names)}
    return points(**given)


def linear_stability(at):
    flags, _ = families.identify_family(at)
    stable, growth = np.zeros(flags.shape, int), np.full(flags.shape, np.nan)
    for family in FAMILIES.values():
        on = flags == family.flag
        if on.any():
            stable[on], growth[on] = family.stability({name: values[on] for name, values in at.items()})
    return stable, growth


# The 55 verified cases.


def test_every_case_is_recognised():
    at = of_cases()
    initial.check(at)
    flags, residual = families.identify_family(at)
    for case, flag, rest, whole in zip(CASES, flags, residual, families.condition_residual(at), strict=True):
        expected = FLAG[case["kind"]] if case["kind"] else 0
        assert flag == expected, case["name"]
        assert (rest < 1e-13 and whole < 1e-13) if flag else (rest > 1e-6 and whole > 1e-6), case["name"]
    sine, n, m = families.steady_rates(at)
    for i, case in enumerate(CASES):
        if case["n"] is not None:
            np.testing.assert_allclose([n[i], m[i]], [case["n"], case["m"]], rtol=1e-12, atol=1e-12)
        if case["kind"] == "sleeping":
            assert sine[i] < 1e-12
            assert m[i] + n[i] * np.cos(case["theta0"]) == pytest.approx(case["w0"][2], abs=1e-15)


def test_every_case_has_its_stability():
    at = of_cases()
    stable, growth = linear_stability(at)
    words = {"stable": 1, "linearly stable": 1, "stable(linear)": 1, "unstable": 2}
    for i, case in enumerate(CASES):
        if case["kind"] and case["linear_stability"]:
            assert stable[i] == words[case["linear_stability"]], case["name"]
        if "max growth rate" in case["note"] and stable[i] == 2:
            assert growth[i] == pytest.approx(float(case["note"].split()[-1]), rel=5e-3)
        if case["nutation_freq2"] is not None:
            value, _ = stability.nutation({name: values[i : i + 1] for name, values in at.items()})
            assert value[0] == pytest.approx(case["nutation_freq2"], rel=1e-10)


def test_every_case_has_its_label_and_geometry():
    from atlas.label import theory

    at = of_cases()
    theory = theory.predict(FIXED_POINT, at, 1e-5, nudged=False)
    assert [list(Label.meanings())[value] for value in theory["predicted"]] == [
        case["label"] for case in CASES
    ]
    _, n, m = families.steady_rates(at)
    measured = {"psi_dot_mean": n, "phi_dot_mean": m}
    steady = np.array([case["label"] != "drifting" for case in CASES])
    upright = np.array([case["kind"] == "sleeping" for case in CASES])
    names = list(FIXED_POINT.geometries)
    flags = FIXED_POINT.geometry(measured, steady, upright, 1e-5, 1e-5)
    assert flags.dtype == np.int8
    assert [names[flag] for flag in flags] == [case["geometry"] for case in CASES]


# Proofs.


def test_steady_motion_needs_exactly_the_equations_of_the_catalogue():
    """The equations of motion of w = n g + m e3, and the coefficient of each harmonic of phi."""
    A, B, C, n, m, N, s, c, phi = sp.symbols("A B C n m N s c phi")
    l1, l2, l3, M1, M2, M3 = sp.symbols("l1 l2 l3 M1 M2 M3")
    g1, g2 = s * sp.sin(phi), s * sp.cos(phi)
    constants = (A, B, C, 1 / A, 1 / B, 1 / C, l1, l2, l3, M1, M2, M3, N * A, N * B, N * C)
    rates = equations.rhs((n * g1, n * g2, n * c + m, g1, g2, c), constants)
    K = n**2 - N
    b1, b2, b3 = n * l1 + M1, n * l2 + M2, n * l3 + M3
    stated = (
        K * (B - C) * g2 * c + n * m * (B - A - C) * g2 + b2 * c - b3 * g2 + m * l2,
        K * (C - A) * g1 * c + n * m * (B - A + C) * g1 + b3 * g1 - b1 * c - m * l1,
        K * (A - B) * g1 * g2 + b1 * g2 - b2 * g1,
    )
    needed = (n * m * g2, -n * m * g1, 0)
    for moment, rate, need, torque in zip((A, B, C), rates[:3], needed, stated, strict=True):
        assert sp.expand(moment * (rate - need) - torque) == 0
    # g' = g x w is satisfied by phi' = m alone.
    assert sp.simplify(rates[3] - m * g2) == 0
    assert sp.simplify(rates[4] + m * g1) == 0
    assert sp.simplify(rates[5]) == 0
    # With A = B, l = (0, 0, l3) and the centre of mass on the axis one equation is left.
    lagrange = {B: A, l1: 0, l2: 0, M1: 0, M2: 0}
    balance = (C - A) * K * c + (C * m + l3) * n + M3
    assert sp.expand(stated[0].subs(lagrange) + g2 * balance) == 0
    assert sp.expand(stated[1].subs(lagrange) - g1 * balance) == 0
    assert sp.expand(stated[2].subs(lagrange)) == 0
    # With A != B the sum of the two coefficients that must vanish leaves only (A - B)(K c + 2 n m).
    one = K * (B - C) * c + n * m * (B - A - C) - b3
    two = K * (C - A) * c + n * m * (B - A + C) + b3
    assert sp.expand(one + two - (B - A) * (K * c + 2 * n * m)) == 0


def steadiness(at):
    """Largest |w' - what the steady motion needs| as phi goes round, over the squared rate."""
    t = np.linspace(0, 2 * np.pi, 12, endpoint=False)[:, None] / np.where(at["m"] == 0, 1.0, at["m"])
    constants = initial.constants(at)[:, None]
    gamma = initial.vertical(at)
    angle = t * at["m"]
    g = np.array(
        [
            gamma[0] * np.cos(angle) + gamma[1] * np.sin(angle),
            gamma[1] * np.cos(angle) - gamma[0] * np.sin(angle),
            np.broadcast_to(gamma[2], angle.shape),
        ]
    )
    w = at["n"] * g + at["m"] * np.array([0, 0, 1.0])[:, None, None]
    rate = np.array(equations.rhs(np.concatenate([w, g]), constants)[:3])
    rate -= at["n"] * at["m"] * np.array([g[1], -g[0], np.zeros_like(angle)])
    size = families.squared_rate(at)
    return np.sqrt((rate**2).sum(0)).max(0) / np.where(size > 0, size, 1.0)


values = st.sampled_from([0.0, 0.0, 1.0, -1.5])


@given(
    moments=st.sampled_from([(1.0, 1.0, 1.5), (1.0, 1.3, 1.7), (1.0, 1.0, 1.0), (1.2, 1.0, 1.2)]),
    numbers=st.tuples(*[values] * 10),
    theta=st.sampled_from([0.0, 0.7, np.pi / 2, np.pi]),
    phi=st.sampled_from([0.0, 0.4, np.pi / 2]),
    formula=st.sampled_from([None, *((f, p) for f, family in FAMILIES.items() for p in family.solve)]),
)
@settings(max_examples=300, deadline=None)
def test_a_point_is_recognised_if_and_only_if_it_is_steady(moments, numbers, theta, phi, formula):
    """The catalogue is complete and holds nothing else: bodies with every kind of vanishing parameter."""
    names = ("Mg", "x0", "y0", "z0", "N", "l1", "l2", "l3", "n", "m")
    at = points(
        **dict(zip("ABC", moments, strict=True)),
        **dict(zip(names, numbers, strict=True)),
        theta0=theta,
        phi0=phi,
    )
    if formula:
        family, name = formula
        value = FAMILIES[family].solve[name](at)
        if not np.isnan(value).any():
            at[name] = value
    steady = bool(steadiness(at)[0] < 1e-10)
    flags, residual = families.identify_family(at)
    assert (flags[0] > 0) == steady
    assert (residual[0] <= 1e-10) == steady
    if steady:
        assert families.condition_residual(at)[0] < 1e-10


def exact_starts(seed=0, size=12):
    """One set of points on each family, by name."""
    rng = np.random.default_rng(seed)
    general = random_points(size, rng, m=0.0)
    resting = random_points(size, rng, m=0.0, n=0.0)
    free = random_points(size, rng, n=0.0, N=0.0, Mg=0.0, l1=0.0, l2=0.0)
    upright = random_points(size, rng, n=0.0, theta0=rng.choice([0.0, np.pi], size))
    return {
        "conical": solved("conical", symmetric_points(size, rng), "m"),
        "conical, slow": solved("conical", symmetric_points(4 * size, rng, n=0.0), "n"),
        "conical, fast": solved("conical", symmetric_points(4 * size, rng, n=50.0), "n"),
        "conical, n = 0": solved("rest", symmetric_points(size, rng, n=0.0, N=3.0, Mg=0.3), "theta0"),
        "sleeping": solved("sleeping", upright, "l1", "y0"),
        "staude": solved("staude", general, "theta0", "phi0"),
        "staude, rotor": solved("staude", general, "l1", "l2"),
        "rest": solved("rest", resting, "theta0", "phi0"),
        "rest, free": free,
    }


@pytest.mark.parametrize("kind", exact_starts())
def test_families_are_exact_motions(kind):
    """By substitution into the equations at many times, and by integration."""
    at = exact_starts()[kind]
    family = FAMILIES[kind.split(",")[0]]
    assert np.all(families.identify_family(at)[0] == family.flag)
    assert np.all(on_family(family, at) < 1e-12)
    assert np.all(families.condition_residual(at) < 1e-12)
    t = np.linspace(0, 2.0, 9)
    closed = family.motion(at, t)
    assert closed.shape == (6, 9, at["A"].size)
    np.testing.assert_allclose(closed[:, 0], initial.initial_state(at), atol=1e-14)
    h = 1e-4
    slope = (family.motion(at, t + h) - family.motion(at, t - h)) / (2 * h)
    constants = initial.constants(at)[:, None]
    size = 1 + np.abs(slope).max()
    np.testing.assert_allclose(slope / size, np.array(equations.rhs(closed, constants)) / size, atol=3e-5)

    found = solve_ivp(
        lambda _, y: np.ravel(equations.rhs(y.reshape(6, -1), constants[:, 0])), (0, 1), initial.initial_state(at).ravel(),
        method="DOP853", rtol=1e-12, atol=1e-13,
    )  # fmt: skip
    last = found.y[:, -1].reshape(6, -1)
    np.testing.assert_allclose(last, family.motion(at, np.array(1.0)), atol=1e-8 * size)


def test_both_roots_of_the_quadratic_are_reached():
    at = points(A=1.0, B=1.0, C=1.5, Mg=3.0, z0=1.0, N=0.5, l3=0.8, theta0=0.8726646259971648, m=6.0)
    slow = FAMILIES["conical"].solve["n"](at)[0]
    fast = FAMILIES["conical"].solve["n"](at | {"n": np.full(1, -30.0)})[0]
    assert fast == pytest.approx(-30.19965575936793, rel=1e-13)  # verified case 9
    assert abs(slow) < 1 < abs(fast)
    for n in (slow, fast):
        assert abs(families.precession(at, n=n)[0]) < 1e-12


@pytest.mark.parametrize("name", ["l3", "Mg", "z0", "N", "C", "A", "theta0", "m", "n"])
def test_every_parameter_of_a_conical_motion_can_be_solved(name):
    rng = np.random.default_rng(4)
    family = FAMILIES["conical"]
    at = solved("conical", symmetric_points(300, rng), name)
    at["B"] = family.solve["B"](at)
    assert np.all(on_family(family, at) < 1e-10)
    assert at["A"].size > 30


@pytest.mark.parametrize("name", ["l1", "l2", "l3", "x0", "y0", "z0", "Mg", "N"])
def test_single_parameters_of_a_plane_permanent_rotation_can_be_solved(name):
    """With everything in one principal plane a single condition is left, and one parameter meets it."""
    rng = np.random.default_rng(5)
    plane = {"phi0": np.pi / 2, "y0": 0.0, "l2": 0.0} if name[0] + name[-1] not in ("l2", "y0") else {
        "phi0": 0.0, "x0": 0.0, "l1": 0.0}  # fmt: skip
    at = solved("staude", random_points(50, rng, m=0.0, **plane), name)
    assert at["A"].size > 30
    assert np.all(on_family(FAMILIES["staude"], at) < 1e-10)
    if name in ("l3", "Mg"):
        bare = FAMILIES["staude"].solve[name](random_points(50, rng, m=0.0))
        assert np.isnan(bare).all()


def test_a_condition_without_its_parameter_keeps_it_or_has_no_solution():
    sphere = points(A=1.0, B=1.0, C=1.0, Mg=0.0, l3=2.0, m=-2.0, n=0.7, theta0=0.4)
    assert FAMILIES["conical"].solve["theta0"](sphere)[0] == pytest.approx(0.4)
    assert np.isnan(FAMILIES["conical"].solve["theta0"](sphere | {"m": np.ones(1)})[0])
    assert np.isnan(
        FAMILIES["conical"].solve["m"](sphere | {"n": np.zeros(1), "Mg": np.ones(1), "z0": np.ones(1)})[0]
    )


def test_the_same_motion_given_by_vectors_is_recognised():
    for kind, at in exact_starts().items():
        state = initial.initial_state(at)
        zero = {name: np.zeros_like(at["A"]) for name in ("theta0", "phi0", "n", "m")}
        names = ("p0", "q0", "r0", "gamma10", "gamma20", "gamma30")
        other = at | zero | dict(zip(names, state, strict=True))
        np.testing.assert_array_equal(
            families.identify_family(other)[0], families.identify_family(at)[0], err_msg=kind
        )


def test_a_rate_about_the_node_is_no_steady_motion():
    at = exact_starts()["conical"] | {"theta_dot0": np.full(12, 1e-6)}
    assert np.all(families.identify_family(at)[0] == 0)
    assert np.all(families.condition_residual(at) > 1e-8)


# All permanent rotations.


def count_by_polynomial(d, b):
    """Number of real roots of the secular equation, by Sturm's theorem on its polynomial."""
    L = sp.Symbol("L")
    d, b = [sp.Rational(float(x)) for x in d], [sp.Rational(float(x)) for x in b]
    factors = [(x - L) ** 2 for x in d]
    whole = sp.prod(factors)
    others = [factors[1] * factors[2], factors[0] * factors[2], factors[0] * factors[1]]
    return sp.Poly(whole - sum(x**2 * y for x, y in zip(b, others, strict=True)), L).count_roots()


def test_every_permanent_rotation_is_found():
    rng = np.random.default_rng(8)
    at = random_points(60, rng, m=0.0, n=rng.choice([0.0, 1.0, 3.0, 10.0], 60))
    g, dimension = equilibria.permanent_rotations(at, at["n"])
    counts = (dimension == 0).sum(0)
    assert set(counts) == {2, 4, 6}
    inertia, rotor, weight, N = initial.bodies(at)
    for i in range(60):
        d, b = (at["n"][i] ** 2 - N[i]) * inertia[:, i], at["n"][i] * rotor[:, i] + weight[:, i]
        assert counts[i] == count_by_polynomial(d, b)
    for place in range(12):
        on = dimension[place] >= 0
        torque = np.cross(
            ((at["n"] ** 2 - N) * inertia * g[:, place]) + at["n"] * rotor + weight, g[:, place], axis=0
        )
        scale = 1 + np.abs(at["n"]) ** 2
        assert np.all(np.abs(torque / scale)[:, on] < 1e-13)
        np.testing.assert_allclose((g[:, place, on] ** 2).sum(0), 1, rtol=1e-14)
        assert np.isnan(g[:, place, ~on]).all()


@given(
    inertia=st.sampled_from([(1.0, 1.3, 1.7), (1.0, 1.0, 1.5), (1.5, 1.0, 1.5), (1.0, 1.0, 1.0)]),
    b=st.tuples(*[st.sampled_from([0.0, 1e-12, 1e-3, 0.1, 1.0, -0.3])] * 3),
    n=st.sampled_from([0.0, 1.0, 2.0]),
)
@settings(max_examples=200, deadline=None)
def test_the_solver_leaves_out_no_direction(inertia, b, n):
    """Degenerate bodies: the highest and the lowest point of h on the sphere are listed."""
    at = points(
        **dict(zip("ABC", inertia, strict=True)),
        Mg=1.0,
        **dict(zip(("x0", "y0", "z0"), b, strict=True)),
        n=n,
        N=0.5,
    )
    g, dimension = equilibria.permanent_rotations(at, at["n"])
    d = (n**2 - 0.5) * np.array(inertia)
    there = dimension[:, 0] >= 0
    g, dimension = g[:, there, 0], dimension[there, 0]
    assert np.all(np.abs(np.cross(d[:, None] * g + np.array(b)[:, None], g, axis=0)) < 1e-12)
    if (dimension == 2).any():
        assert not np.any(b)
        return
    found = equilibria.equilibria(at, n)
    if not (found["dimension"] > 0).any():
        assert dimension.size in (2, 4, 6)
    heights = 0.5 * (d[:, None] * g**2).sum(0) + np.array(b) @ g
    directions = np.random.default_rng(0).normal(size=(3, 400))
    directions /= np.linalg.norm(directions, axis=0)
    sampled = 0.5 * (d[:, None] * directions**2).sum(0) + np.array(b) @ directions
    assert heights.max() >= sampled.max() - 1e-12
    assert heights.min() <= sampled.min() + 1e-12


def test_degenerate_bodies_have_circles_of_solutions():
    top = points(A=1.0, B=1.0, C=1.5, Mg=0.5, z0=1.0)
    found = equilibria.equilibria(top, 1.5)
    assert list(found["dimension"]) == [0, 1, 0]
    assert np.cos(found["theta"][1]) == pytest.approx(-0.5 / (0.5 * 1.5**2))
    np.testing.assert_allclose(found["theta"][[0, 2]], [0, np.pi])
    free = equilibria.equilibria(points(A=1.0, B=1.0, C=1.0), 1.0)
    assert list(free["dimension"]) == [2]
    classical = equilibria.equilibria(points(A=1.0, B=1.3, C=1.7), 2.0)
    assert classical["theta"].size == 6
    np.testing.assert_allclose(
        np.sort(np.abs([classical["g1"], classical["g2"], classical["g3"]]), 0)[:2], 0, atol=1e-15
    )
    # Turning about the largest and the smallest axis is stable, about the middle one not.
    axis = np.abs([classical["g1"], classical["g2"], classical["g3"]]).argmax(0)
    assert list(classical["stable"][axis == 1]) == [2, 2]
    assert np.all(classical["stable"][axis != 1] == 1)


def test_solved_directions_are_the_nearest():
    rng = np.random.default_rng(11)
    at = random_points(200, rng, m=0.0, n=5.0)
    family = FAMILIES["staude"]
    both = solved("staude", at, "theta0", "phi0")
    assert both["A"].size == 200
    g, dimension = equilibria.permanent_rotations(at, at["n"])
    distance = np.where(dimension >= 0, -(g * initial.vertical(at)[:, None]).sum(0), np.inf)
    reached = -(initial.vertical(both) * initial.vertical(at)).sum(0)
    np.testing.assert_allclose(reached, distance.min(0), atol=1e-12)
    assert np.isnan(family.solve["phi0"](at)).all()


# Stability.


def monodromy(at, duration):
    """Exponents of the motion of one point over a time, from its linearised equations."""
    constants = initial.constants(at)[:, 0]

    def rate(_, z):
        y, rest = z[:6], z[6:].reshape(6, 6)
        step = 1e-6
        columns = [
            (
                np.array(equations.rhs(y + step * e, constants))
                - np.array(equations.rhs(y - step * e, constants))
            )
            / (2 * step)
            for e in np.eye(6)
        ]
        return np.concatenate([np.array(equations.rhs(y, constants)), (np.array(columns).T @ rest).ravel()])

    first = np.concatenate([initial.initial_state(at)[:, 0], np.eye(6).ravel()])
    found = solve_ivp(rate, (0, duration), first, method="DOP853", rtol=1e-10, atol=1e-11)
    return np.linalg.eigvals(found.y[6:, -1].reshape(6, 6))


@pytest.mark.parametrize("seed", range(6))
def test_nutation_frequency_of_conical_motions(seed):
    """Floquet multipliers over one turn of phi are exp(+-i nutation 2 pi / m) and ones."""
    rng = np.random.default_rng(seed)
    sign = 1.0 if seed % 2 else -1.0
    at = symmetric_points(1, rng, C=0.5, N=4.0 if seed % 2 else 0.5, l3=0.1, n=0.6 * sign, Mg=1.5, theta0=1.2)
    at = solved("conical", at, "m")
    period = 2 * np.pi / abs(at["m"][0])
    square, _ = stability.nutation(at)
    expected = np.exp(np.array([1, -1]) * np.sqrt(-square.astype(complex)) * period)
    multipliers = monodromy(at, period)
    for value in expected:
        assert np.abs(multipliers - value).min() < 1e-5 * abs(value)
    stable, growth = FAMILIES["conical"].stability(at)
    if square[0] < 0:
        assert stable[0] == 2
        assert growth[0] == pytest.approx(np.log(np.abs(multipliers).max()) / period, rel=1e-5)
    else:
        assert (stable[0], growth[0]) == (1, 0.0)


def test_an_unstable_precession_grows_at_its_rate():
    number = next(
        i
        for i, case in enumerate(CASES)
        if case["linear_stability"] == "unstable" and case["kind"] == "conical"
    )
    at = {name: values[number : number + 1] for name, values in of_cases().items()}
    growth = FAMILIES["conical"].stability(at)[1][0]
    assert growth == pytest.approx(np.sqrt(0.7125), rel=1e-12)
    _, _, m = families.steady_rates(at)
    period = 2 * np.pi / abs(m[0])
    assert np.log(np.abs(monodromy(at, period)).max()) / period == pytest.approx(growth, rel=1e-5)


@pytest.mark.parametrize("kind", ["staude", "staude, rotor", "rest", "sleeping"])
def test_stability_of_permanent_rotations_against_eigenvalues(kind):
    at = exact_starts(7, 60)[kind]
    stable, growth = FAMILIES[kind.split(",")[0]].stability(at)
    constants, state = initial.constants(at), initial.initial_state(at)
    step = 1e-6
    columns = []
    for i in range(6):
        ahead, behind = state.copy(), state.copy()
        ahead[i] += step
        behind[i] -= step
        columns.append(
            (np.array(equations.rhs(ahead, constants)) - np.array(equations.rhs(behind, constants)))
            / (2 * step)
        )
    largest = np.linalg.eigvals(np.moveaxis(np.array(columns), 2, 0)).real.max(1)
    # The two zero exponents are defective and come out at the root of the rounding.
    clear = largest > 1e-3
    assert np.all(stable[clear] == 2)
    np.testing.assert_allclose(growth[clear], largest[clear], rtol=1e-4)
    assert np.all(stable[~clear] == 1)
    assert {1, 2} == set(stable)


def test_amended_potential_decides_as_its_index_says():
    """Index 0 is stable and an odd index unstable, for every permanent rotation of many bodies."""
    rng = np.random.default_rng(3)
    seen = set()
    for _ in range(40):
        at = random_points(1, rng)
        found = equilibria.equilibria(at, float(rng.normal()))
        assert np.all(found["stable"][found["index"] == 0] == 1)
        assert np.all(found["stable"][found["index"] == 1] == 2)
        seen |= set(zip(found["index"].tolist(), found["stable"].tolist(), strict=True))
    assert seen >= {(0, 1), (1, 2), (2, 2)}


def sleeping_points(side, **given):
    body = {
        "A": 1.0,
        "B": 1.0,
        "C": 1.4,
        "Mg": 1.1,
        "z0": 1.0,
        "N": 0.3,
        "theta0": 0.0 if side > 0 else np.pi,
    }
    return points(**(body | given))


@pytest.mark.parametrize("side", [1, -1])
@pytest.mark.parametrize("l3", [0.0, 0.7, -0.7])
def test_sleeping_threshold(side, l3):
    """r at which the discriminant vanishes; the two sides of it, and the closed form against eigenvalues."""
    at = sleeping_points(side, l3=l3, Mg=-side * 1.1)
    needed = 4 * (0.3 * 0.4 + 1.1)
    r = np.sqrt(needed) / 1.4 - l3 / 1.4
    for factor, expected in ((0.99, 2), (1.01, 1), (1.0, 0)):
        m = (np.sqrt(needed) * factor - l3) / 1.4
        stable, growth = FAMILIES["sleeping"].stability(at | {"m": np.full(1, m)})
        assert stable[0] == expected
        other = stability._equilibrium_stability(
            at, np.full(1, m * side), np.array([[0.0], [0.0], [float(side)]])
        )
        assert (other[0][0], other[1][0]) == (stable[0], pytest.approx(growth[0], abs=1e-6))
    value, _ = stability.sleeping_discriminant(at | {"m": np.full(1, r)})
    assert abs(value[0]) < 1e-13


@pytest.mark.parametrize(("N", "C", "stays"), [(0.2, 1.4, True), (4.0, 0.4, False)])
def test_sleeping_at_the_threshold_is_decided_by_the_fourth_order(N, C, stays):
    """Upright body exactly at the threshold: where the theta^4 term holds it, it swings by the root of the nudge."""
    at = sleeping_points(-1, N=N, C=C, Mg=3.0)
    at["m"] = np.full(1, np.sqrt(4 * (N * (C - 1) + 3.0)) / C)
    assert (stability.sleeping_at_threshold(at)[0] > 0) == stays
    assert FAMILIES["sleeping"].stability(at)[0][0] == 0
    reached = []
    for nudge in (1e-2, 1e-4):
        tilted = at | {"theta0": np.full(1, np.pi - nudge)}
        constants = initial.constants(tilted)[:, 0]
        found = solve_ivp(
            lambda _, y, constants=constants: equations.rhs(y, constants), (0, 400.0),
            initial.initial_state(tilted)[:, 0], method="DOP853", rtol=1e-10, atol=1e-13,
        )  # fmt: skip
        reached.append(np.hypot(found.y[3], found.y[4]).max())
    if stays:
        assert reached[0] / reached[1] == pytest.approx(10, rel=0.02)
    else:
        assert min(reached) > 0.9


def test_free_body_turning_about_its_third_axis():
    """Middle axis unstable at Euler's rate, with a rotor where the rotor says."""
    at = points(A=1.0, B=1.7, C=1.3, m=2.0, theta0=0.6)
    assert families.identify_family(at)[0][0] == FLAG["rest"]
    stable, growth = FAMILIES["rest"].stability(at)
    assert stable[0] == 2
    assert growth[0] == pytest.approx(2.0 * np.sqrt(0.3 * 0.4 / 1.7))
    assert np.log(np.abs(monodromy(at, 10.0)).max()) / 10 == pytest.approx(growth[0], rel=0.02)
    held = at | {"l3": np.full(1, 3.0)}
    assert FAMILIES["rest"].stability(held)[0][0] == 1


def test_neutral_bodies_are_not_called_unstable():
    free_sphere = points(A=1.0, B=1.0, C=1.0)
    assert families.identify_family(free_sphere)[0][0] == FLAG["sleeping"]
    stable, growth = linear_stability(free_sphere)
    assert (stable[0], growth[0]) == (0, 0.0)
    # Symmetric about the first axis: a circle of permanent rotations, one pair of exponents zero.
    at = points(A=1.5, B=1.0, C=1.0, Mg=1.0, x0=0.4, n=1.5)
    inclined = equilibria.equilibria(at, 1.5)
    circle = inclined["dimension"] == 1
    assert circle.sum() == 1
    assert inclined["stable"][circle][0] in (0, 2)
    assert inclined["growth_rate"][circle][0] == 0 or inclined["stable"][circle][0] == 2


def test_the_catalogue_is_said_to_be_complete():
    assert FIXED_POINT.complete(points()).all()
    assert [family.flag for family in FAMILIES.values()] == [1, 2, 3, 4]
    assert list(FAMILIES) == ["conical", "sleeping", "staude", "rest"]
    for family in FAMILIES.values():
        assert set(family.solve) <= set(initial.PARAMETERS)
        assert family.geometry in ("", *FIXED_POINT.geometries)
