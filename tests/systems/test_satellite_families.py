"""The satellite's families of steady motions: proved, solved, recognised, and held against the paper."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
import sympy as sp
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import solve_ivp

from atlas.systems.base import on_family
from atlas.systems.satellite import equations
from atlas.systems.satellite.families import FAMILIES, condition_residual, identify_family, steady_motion
from atlas.systems.satellite.initial import PARAMETERS, constants, initial_state
from atlas.systems.satellite.paper.published import PUBLISHED, residual
from atlas.systems.satellite.stability import linear_stability

CASES = json.loads((Path(__file__).parents[1] / "reference" / "satellite_cases.json").read_text())["cases"]
NAMES = ("cylindrical", "equilibrium", "perp_radius", "perp_velocity", "oblique", "transverse_magnet",
         "despun_transverse", "asymmetric_tilt", "spherical", "other_axis")  # fmt: skip

# Proof: the torque that w' = n gamma + m e3 lacks, as a polynomial in sines and cosines.

A, B, C, Omega, k1, k2, k3, mu1, mu2, mu3, h1, h3, n, m = sp.symbols(
    "A B C Omega k1 k2 k3 mu1 mu2 mu3 h1 h3 n m"
)
s, c, sy, cy, sf, cf = sp.symbols("s c sin_psi cos_psi sin_phi cos_phi")


def symbolic(*rotor):
    """The constants of the equations for symbols, with a rotor."""
    names = ("A", "B", "C", "Omega", "mu1", "mu2", "mu3", "h1", "h3", "k1", "k2", "k3")
    return tuple(constants(dict(zip(names, (A, B, C, Omega, mu1, mu2, mu3, h1, h3, *rotor), strict=True))))


def lack(**special):
    """Components of I (w-dot needed) - torque, reduced by s^2 + c^2 = 1 and so on; all zero on a motion."""
    alpha = sp.Matrix([cy * cf - c * sf * sy, -cy * sf - c * cf * sy, s * sy])
    gamma = sp.Matrix([s * sf, s * cf, c])
    state = [*((n + Omega) * gamma + sp.Matrix([0, 0, m])), *alpha, *gamma]
    rates = equations.rhs(state, symbolic(k1, k2, k3))
    needed = [(n + Omega) * m * gamma[1], -(n + Omega) * m * gamma[0], 0]
    numerators = []
    for inertia, rate, target in zip((A, B, C), rates, needed, strict=False):
        expression = sp.expand(inertia * (rate - target))
        for _ in range(3):  # what a formula brings in is replaced in the next round
            for name, value in special.items():
                expression = expression.subs(sp.Symbol(name), value)
        numerator, _ = sp.fraction(sp.together(expression))
        for sine, cosine in ((s, c), (sy, cy), (sf, cf)):
            numerator = sp.rem(sp.expand(numerator), sine**2 + cosine**2 - 1, sine)
        numerators.append(sp.expand(numerator))
    return numerators


def node_rotor(**field):
    """K = (H2 + i H1) U / (Omega s), and k3 of the last equation of the module's (*)."""
    H1, H2 = h1 * cy, h3 * s - h1 * c * sy
    torque = Omega**2 * s * c * (sp.Rational(1, 2) * (A + B) - C) * (1 + 3 * sy**2) + mu3 * H2
    return {
        "k1": (H2 * mu1 - H1 * mu2) / (Omega * s),
        "k2": (H2 * mu2 + H1 * mu1) / (Omega * s),
        "k3": torque / (Omega * s) - C * m,
        **field,
    }


def upright(side):
    return {"s": 0, "c": side, "B": A}


# Substitutions; phi (and psi where n is not 0) stays arbitrary.
PROOFS = {
    "cylindrical, no field along the radius": [
        {**upright(side), "h1": 0, "k1": h3 * mu1 / (Omega + n + side * m), "k2": h3 * mu2 / (Omega + n + side * m)}
        for side in (1, -1)
    ],
    "cylindrical, no magnet": [{**upright(1), "mu1": 0, "mu2": 0, "mu3": 0, "k1": 0, "k2": 0}],
    "cylindrical, no rotation in space": [
        {**upright(side), "h1": 0, "mu1": 0, "mu2": 0, "m": -side * (n + Omega)} for side in (1, -1)
    ],
    "perp_radius": [{"B": A, "n": 0, "mu1": 0, "mu2": 0, **node_rotor(h1=0, sy=0), "sin_psi": 0}],
    "perp_velocity": [
        {"B": A, "n": 0, "mu1": 0, "mu2": 0, **node_rotor(), "sin_psi": side, "cos_psi": 0} for side in (1, -1)
    ],
    "oblique": [{"B": A, "n": 0, "mu1": 0, "mu2": 0, **node_rotor(), "h1": 3 * Omega**2 * s * sy * (A - C) / mu3}],
    "transverse_magnet": [
        {"B": A, "n": 0, **node_rotor(), "sin_psi": side, "cos_psi": 0, "h3": side * h1 * (Omega + m * c) / (m * s)}
        for side in (1, -1)
    ],
    "despun_transverse": [
        {"B": A, "n": 0, **node_rotor(), "m": -Omega * c, "h3": -h1 * s * sy / c,
         "mu3": 3 * Omega**2 * s * sy * (A - C) / h1}
    ],
    "despun_transverse, cos psi0 = 0": [
        {"B": A, "n": 0, **node_rotor(), "m": -Omega * c, "h3": -h1 * s * sy / c, "sin_psi": side, "cos_psi": 0}
        for side in (1, -1)
    ],
    "asymmetric_tilt, axial rotor": [
        {"mu1": 0, "mu2": 0, **node_rotor(), "n": 0, "m": -2 * Omega * c, "sin_psi": e, "cos_psi": 0,
         "c": sp.Rational(side, 2), "s": sp.sqrt(3) / 2}
        for side in (1, -1) for e in (1, -1)
    ],
    "asymmetric_tilt, transverse magnet": [
        {**node_rotor(), "n": 0, "m": -2 * Omega * c, "h1": -e * side * sp.sqrt(3) * h3, "sin_psi": e, "cos_psi": 0,
         "c": sp.Rational(side, 2), "s": sp.sqrt(3) / 2}
        for side in (1, -1) for e in (1, -1)
    ],
    "spherical": [
        {"B": A, "C": A, "k1": 0, "k2": 0, "h1": 0, "mu1": 0, "mu2": 0, "k3": h3 * mu3 / (n + Omega) - A * m},
        {"B": A, "C": A, "k1": 0, "k2": 0, "mu1": 0, "mu2": 0, "mu3": 0, "n": -Omega},
    ],
    "other_axis": [
        {"C": A, "m": 0, "h1": 0, "c": 0, "s": 1, "sin_phi": 0, "cos_phi": side,
         "k1": h3 * mu1 / (n + Omega), "k3": h3 * mu3 / (n + Omega)}
        for side in (1, -1)
    ] + [
        {"C": B, "m": 0, "h1": 0, "c": 0, "s": 1, "cos_phi": 0, "sin_phi": side,
         "k2": h3 * mu2 / (n + Omega), "k3": h3 * mu3 / (n + Omega)}
        for side in (1, -1)
    ],
}  # fmt: skip


@pytest.mark.parametrize("name", PROOFS)
def test_family_solves_the_equations_identically(name):
    for special in PROOFS[name]:
        assert lack(**special) == [0, 0, 0], special


def test_equilibrium_rotor_leaves_the_torque_about_the_normal_alone():
    """k = (R x gamma)/Omega + lambda gamma makes the torque gamma (beta.(3 Omega^2 I alpha + h1 mu))."""
    alpha = sp.Matrix([cy * cf - c * sf * sy, -cy * sf - c * cf * sy, s * sy])
    beta = sp.Matrix([sy * cf + c * sf * cy, -sy * sf + c * cf * cy, -s * cy])
    gamma = sp.Matrix([s * sf, s * cf, c])
    inertia, mu, along = sp.diag(A, B, C), sp.Matrix([mu1, mu2, mu3]), sp.Symbol("along")
    rest = 3 * Omega**2 * alpha.cross(inertia * alpha) + (h1 * alpha + h3 * gamma).cross(mu)
    rest += Omega**2 * (inertia * gamma).cross(gamma)
    k = rest.cross(gamma) / Omega + along * gamma
    needed = gamma * beta.dot(3 * Omega**2 * inertia * alpha + h1 * mu)
    rates = equations.rhs([*(Omega * gamma), *alpha, *gamma], symbolic(*k))
    for i, body in enumerate((A, B, C)):
        difference = sp.expand(body * rates[i] - needed[i])
        for sine, cosine in ((s, c), (sy, cy), (sf, cf)):
            difference = sp.rem(sp.expand(difference), sine**2 + cosine**2 - 1, sine)
        assert sp.expand(difference) == 0


# Random points on every family, by its own formulas.


def draw(rng, **given):
    """A random point of order 1, arrays of shape (1,)."""
    point = {name: rng.uniform(0.3, 1.3, 1) * rng.choice([-1.0, 1.0], 1) for name in PARAMETERS}
    point |= {name: rng.uniform(0.7, 1.3, 1) for name in ("A", "B", "C", "Omega")}
    point |= {"theta0": rng.uniform(-4, 4, 1), "theta_dot0": np.zeros(1)}
    point |= {name: np.full(1, float(value)) for name, value in given.items()}
    return point


def free_point(rng, name):
    """A random point with what the family's formulas do not solve."""
    point = draw(rng)
    if name in (
        "cylindrical",
        "perp_radius",
        "perp_velocity",
        "oblique",
        "transverse_magnet",
        "despun_transverse",
    ):
        point["B"] = point["A"]
        point["n"] = np.zeros(1)
    if name in ("perp_radius", "perp_velocity", "oblique"):
        point |= {key: np.zeros(1) for key in ("k1", "k2", "mu1", "mu2")}
    if name in ("perp_radius", "cylindrical"):
        point["h1"] = np.zeros(1)
    if name == "cylindrical":
        point["n"] = rng.normal(size=1)
    if name == "equilibrium":
        point["n"] = np.zeros(1)
    if name == "asymmetric_tilt":
        point["n"] = np.zeros(1)
    if name == "oblique":
        point["h1"] = point["h1"] * 0.1
    if name == "spherical":
        point |= {"B": point["A"], "C": point["A"]}
        point |= {key: np.zeros(1) for key in ("k1", "k2", "mu1", "mu2", "h1")}
    if name == "other_axis":
        point |= {"m": np.zeros(1), "h1": np.zeros(1)}
        kind = rng.integers(3)
        if kind == 0:
            point |= {
                "C": point["A"],
                "theta0": np.full(1, np.pi / 2),
                "phi0": np.full(1, np.pi * rng.integers(2)),
            }
        elif kind == 1:
            point |= {"C": point["B"], "theta0": np.full(1, np.pi / 2), "phi0": np.full(1, -np.pi / 2)}
        else:
            point |= {"B": point["A"], "C": point["A"]}
    return point


def solved(name, rng):
    """A point on the family, or None where the drawn parameters admit none."""
    point = free_point(rng, name)
    formulas = FAMILIES[name].solve
    # enough of them, in order, to be on the family
    wanted = {
        "cylindrical": ("theta0", "k1", "k2"), "equilibrium": ("m", "h1", "k1", "k2"), "perp_radius": ("psi0", "k3"),
        "perp_velocity": ("psi0", "k3"), "oblique": ("psi0", "k3"),
        "transverse_magnet": ("psi0", "h3", "k1", "k2", "k3"),
        "despun_transverse": ("m", "h3", "mu3", "k1", "k2", "k3"),
        "asymmetric_tilt": ("theta0", "psi0", "m", "h1", "k1", "k2", "k3"),
        "spherical": ("k3",), "other_axis": ("k3", "k1", "k2"),
    }[name]  # fmt: skip
    for parameter in wanted:
        value = formulas[parameter](point)
        if name == "other_axis" and np.isnan(value[0]):  # the component along the axis is free
            continue
        if np.isnan(value[0]) or abs(value[0]) > 50:
            return None
        point[parameter] = value
    return point


@pytest.mark.parametrize("name", NAMES)
@settings(max_examples=25, deadline=None)
@given(seed=st.integers(0, 10**6))
def test_solved_points_are_steady_and_recognised(name, seed):
    point = solved(name, np.random.default_rng(seed))
    if point is None:
        return
    size = float(np.abs(constants(point)).max()) ** 2
    assert on_family(FAMILIES[name], point)[0] < 1e-12
    assert residual(point) < 1e-12 * size
    assert condition_residual(point)[0] < 1e-12
    flag, distance = identify_family(point)
    assert 1 <= flag[0] <= FAMILIES[name].flag
    assert distance[0] < 1e-10


@pytest.mark.parametrize(
    ("name", "parameter"), [(name, key) for name in NAMES for key in FAMILIES[name].solve]
)
def test_every_formula_restores_its_parameter(name, parameter):
    """A point on the family, thrown off in one parameter, comes back by that parameter's formula."""
    tried = 0
    for seed in range(40):
        point = solved(name, np.random.default_rng(seed))
        if point is None:
            continue
        off = point | {parameter: point[parameter] + 0.05}
        formula = FAMILIES[name].solve[parameter]
        if (
            parameter == "theta0"
            and FAMILIES[name].solve["theta0"] is FAMILIES["perp_velocity"].solve["theta0"]
        ):
            off["h1"] = point["h1"] = np.zeros(1)
            off["k3"] = point["k3"] = FAMILIES[name].solve["k3"](point)
        value = formula(off)
        if on_family(FAMILIES[name], off)[0] < 1e-10:  # it is free here
            continue
        if np.isnan(value[0]):
            continue
        assert on_family(FAMILIES[name], off | {parameter: value})[0] < 1e-11
        tried += 1
    assert tried >= 5


def test_nan_where_a_family_does_not_exist():
    rng = np.random.default_rng(0)
    base = draw(rng, B=1, A=1, C=1.2, n=0, k1=0, k2=0, mu1=0, mu2=0, theta0=1)
    oblique = FAMILIES["oblique"].solve
    assert np.isnan(oblique["psi0"](base | {"h1": np.array([9.0]), "mu3": np.array([9.0])}))
    assert np.isnan(FAMILIES["perp_radius"].solve["theta0"](base | {"k3": np.array([9.0])}))
    upright = base | {"theta0": np.array([np.pi]), "psi0": np.array([np.pi / 2])}
    assert np.isnan(FAMILIES["perp_velocity"].solve["k3"](upright))
    without = FAMILIES["perp_velocity"].solve["k3"](upright | {"h1": np.zeros(1)})
    assert on_family(FAMILIES["perp_velocity"], upright | {"h1": np.zeros(1), "k3": without})[0] < 1e-12
    no_orbit = base | {"Omega": np.zeros(1)}
    assert np.isnan(FAMILIES["perp_radius"].solve["k3"](no_orbit))


# Nothing is recognised that is not steady, and nothing that is steady is missed.


@settings(max_examples=400, deadline=None)
@given(data=st.data())
def test_recognised_means_steady_and_the_converse(data):
    """Points from few special values, where families and their accidents are dense."""
    pick = lambda *values: data.draw(st.sampled_from(values))  # noqa: E731
    kind = pick("any", "node", "rest")
    Omega_ = 1.0
    p = {
        "A": 1.0, "B": pick(1.0, 1.0, 1.3), "C": pick(1.0, 1.3, 0.8), "Omega": Omega_,
        "mu1": pick(0.0, 0.0, 0.7), "mu2": pick(0.0, 0.0, 0.4), "mu3": pick(0.0, 0.5),
        "h1": pick(0.0, 0.6, -0.3), "h3": pick(0.0, 0.5), "k1": pick(0.0, 0.0, 0.3), "k2": pick(0.0, 0.2),
        "k3": pick(0.0, 0.3), "theta0": pick(0.0, np.pi, np.pi / 3, 2 * np.pi / 3, np.pi / 2, 1.1, -0.7),
        "psi0": pick(0.0, np.pi / 2, -np.pi / 2, np.pi, 0.4), "phi0": pick(0.0, np.pi / 2, np.pi, 0.9),
        "theta_dot0": 0.0, "n": pick(0.0, 0.0, -1.0, 0.5, 1.0), "m": pick(0.0, 1.0, -1.0, 0.5, -0.5, 0.7),
    }  # fmt: skip
    point = {name: np.full(1, float(value)) for name, value in p.items()}
    if kind == "node":
        names = pick(("m",), ("h1",), ("psi0",), ("h3",), ())
        for name in names:
            formula = FAMILIES[
                pick("oblique", "transverse_magnet", "despun_transverse", "asymmetric_tilt")
            ].solve
            if name in formula:
                point[name] = formula[name](point)
        for name in ("k1", "k2", "k3"):
            point[name] = FAMILIES["transverse_magnet"].solve[name](point)
    if kind == "rest":
        name = pick("spherical", "other_axis", "equilibrium", "cylindrical")
        for parameter, formula in FAMILIES[name].solve.items():
            if parameter.startswith("k"):
                value = formula(point)
                point[parameter] = np.where(np.isnan(value), point[parameter], value)
    if any(np.isnan(value[0]) or abs(value[0]) > 20 for value in point.values()):
        return
    flag, _ = identify_family(point)
    lack_ = residual(point)
    if flag[0]:
        assert lack_ < 1e-9
    else:
        assert lack_ > 1e-6


def test_off_every_family_by_one_percent():
    rng = np.random.default_rng(3)
    for name in NAMES:
        parameter = "C" if name in ("equilibrium", "other_axis", "oblique") else "k3"
        if name == "cylindrical":
            parameter = "B"
        seen = 0
        for _ in range(20):
            point = solved(name, rng)
            if point is None or identify_family(point)[0][0] != FAMILIES[name].flag:
                continue
            off = point | {parameter: point[parameter] * 1.01}
            if name == "other_axis" and np.ptp([point[i][0] for i in "ABC"]) > 0:
                off = point | {"theta0": point["theta0"] * 1.01}
            flag, distance = identify_family(off)
            assert flag[0] == 0
            assert distance[0] > 1e-5
            seen += 1
        assert seen > 3, name


def test_generic_points_are_on_no_family():
    rng = np.random.default_rng(4)
    points = {name: rng.normal(size=500) for name in PARAMETERS}
    points |= {name: rng.uniform(0.8, 1.5, 500) for name in ("A", "B", "C", "Omega")}
    flags, distance = identify_family({name: value.reshape(50, 10) for name, value in points.items()})
    assert flags.shape == distance.shape == (50, 10)
    assert flags.dtype == np.int8
    assert not flags.any()
    assert distance.min() > 1e-3
    assert condition_residual(points).min() > 1e-3


def test_order_of_overlapping_families():
    assert tuple(FAMILIES) == NAMES
    assert [family.flag for family in FAMILIES.values()] == list(range(1, 11))
    body = {"A": 1.0, "B": 1.0, "C": 1.2, "Omega": 1.0}

    def first(**values):
        point = {name: np.full(1, float((body | values).get(name, 0.0))) for name in PARAMETERS}
        holding = [name for name, family in FAMILIES.items() if on_family(family, point)[0] < 1e-12]
        assert holding[0] == NAMES[identify_family(point)[0][0] - 1]
        return holding

    assert first(m=0.4) == ["cylindrical", "perp_radius", "oblique"]
    assert first()[:3] == ["cylindrical", "equilibrium", "perp_radius"]
    k3 = 1.0 * np.cos(1.0) * (1 - 1.2) - 1.2 * 0.4
    assert first(theta0=1.0, m=0.4, k3=k3) == ["perp_radius", "oblique"]
    tilt = {"theta0": np.pi / 3, "psi0": np.pi / 2, "m": -1.0, "k3": 0.8}
    assert first(**tilt) == ["perp_velocity", "transverse_magnet", "asymmetric_tilt"]
    assert first(B=1.1, **tilt | {"k3": 0.9}) == ["asymmetric_tilt"]
    assert first(C=1.0, theta0=1.0, n=0.5) == ["spherical", "other_axis"]
    assert first(C=1.0, theta0=1.0, n=0.5, k2=np.sin(1.0), k3=np.cos(1.0)) == ["other_axis"]
    assert first(C=1.0, theta0=1.0, n=0.5, m=0.3, k3=-0.3) == ["spherical"]


def test_exact_starts_written_with_pi():
    """pi, pi/2 and pi/3 in float64 are on the families; so is a tilt beyond pi."""
    for theta0 in (np.pi, -np.pi, 4 * np.pi):
        point = draw(np.random.default_rng(1), theta0=theta0, B=1, A=1, h1=0)
        for name in ("k1", "k2"):
            point[name] = FAMILIES["cylindrical"].solve[name](point)
        assert identify_family(point)[0][0] == 1


# The closed form against an integrator.


@pytest.mark.parametrize("name", NAMES)
def test_closed_form_agrees_with_the_integrator_over_20_radians(name):
    rng = np.random.default_rng(11)
    done = 0
    while done < 2:
        point = solved(name, rng)
        if point is None:
            continue
        done += 1
        rate = max(abs(point[key][0]) for key in ("Omega", "n", "m"))
        times = np.linspace(0, 20 / rate, 9)
        run = solve_ivp(
            lambda t, y, values: equations.rhs(y, values), (0, times[-1]), initial_state(point)[:, 0],
            "DOP853", times, rtol=1e-12, atol=1e-13, max_step=0.15 / rate,
            args=(constants(point)[:, 0],),
        )  # fmt: skip
        closed = FAMILIES[name].motion(point, times)
        assert closed.shape == (9, 9, 1)
        # an unstable motion leaves the closed form at its growth rate
        _, growth = linear_stability(point, np.array([FAMILIES[name].flag]))
        assert (
            np.abs(closed[..., 0] - run.y).max(0) < 1e-10 * (1 + times) * np.exp(1.1 * growth * times)
        ).all()


def test_closed_form_shapes():
    point = solved("perp_velocity", np.random.default_rng(5))
    wide = {name: np.broadcast_to(value, (4, 3)) for name, value in point.items()}
    assert steady_motion(wide, np.zeros((2, 5))).shape == (9, 2, 5, 4, 3)
    np.testing.assert_array_equal(steady_motion(wide, np.array(0.0)), initial_state(wide))


# The verified cases and the printed equations.


def case_points():
    points = {name: np.array([float(case.get(name, 0.0)) for case in CASES]) for name in PARAMETERS}
    for i in range(3):
        points[f"k{i + 1}"] = np.array([case["k"][i] for case in CASES])
        points[f"mu{i + 1}"] = np.array([case["mu"][i] for case in CASES])
    return points


def test_the_68_cases_are_recognised():
    points = case_points()
    flags, _ = identify_family(points)
    residual = condition_residual(points)
    upright = np.abs(np.sin(points["theta0"])) < 1e-12
    for i, case in enumerate(CASES):
        assert (flags[i] > 0) == case["valid"], case["id"]
        labels = []
        for precession in (points["n"][i], points["n"][i] + points["Omega"][i]):
            regular = not upright[i] and abs(precession) > 1e-5 and abs(points["m"][i]) > 1e-5
            labels.append(
                "drifting" if flags[i] == 0 else "regular_precession" if regular else "permanent_rotation"
            )
        assert labels == [case["label_orbital"], case["label_inertial"]], case["id"]
        if case["valid"]:
            assert residual[i] < 1e-12, case["id"]
            geometry = FAMILIES[NAMES[flags[i] - 1]].geometry
            assert geometry in ("", case["geometry"]), case["id"]
        else:
            assert residual[i] > 1e-4, case["id"]


@pytest.mark.parametrize("row", PUBLISHED, ids=lambda row: row.number)
def test_printed_equations(row):
    printed = [row.residual_printed(np.random.default_rng(seed)) for seed in range(5)]
    true = [row.residual_true(np.random.default_rng(seed)) for seed in range(5)]
    assert max(true) < 1e-12
    assert row.family in ("", *NAMES)
    if row.verdict == "true":
        assert max(printed) < 1e-12
    else:
        assert np.median(printed) > 1e-2
