"""The satellite's families of steady motions: proofs, formulas, identification, and the paper's equations."""

from __future__ import annotations

import numpy as np
import pytest
import sympy as sp
from hypothesis import given, settings
from hypothesis import strategies as st
from strategies import DRAG, nonzero_satellite, random_satellites, satellite_on_family
from truth import acceleration_error, cases, satellite_cases

from atlas.systems.base import on_family, unsteady
from atlas.systems.satellite import SATELLITE, equations
from atlas.systems.satellite.families import FAMILIES, steady_motion
from atlas.systems.satellite.initial import PARAMETERS, constants, initial_state
from atlas.theory.motions import condition_residual

NAMES = ("cylindrical", "equilibrium", "perp_radius", "perp_velocity", "oblique", "transverse_magnet",
         "despun_transverse", "asymmetric_tilt", "spherical", "other_axis")  # fmt: skip

# Proof: the torque missing for w' = n gamma + m e3 is 0, as a polynomial in sines and cosines.

A, B, C, Omega, k1, k2, k3, mu1, mu2, mu3, h1, h3, n, m = sp.symbols(
    "A B C Omega k1 k2 k3 mu1 mu2 mu3 h1 h3 n m"
)
drag = drag1, drag2, drag3 = sp.symbols(DRAG)
s, c, sy, cy, sf, cf = sp.symbols("s c sin_psi cos_psi sin_phi cos_phi")


def symbolic_constants(*rotor):
    """The constants of the equations as symbols, with a rotor."""
    names = ("A", "B", "C", "Omega", "mu1", "mu2", "mu3", "h1", "h3", *DRAG, "k1", "k2", "k3")
    values = (A, B, C, Omega, mu1, mu2, mu3, h1, h3, *drag, *rotor)
    return tuple(constants(dict(zip(names, values, strict=True)) | {"damping": 0}))


def reduced(expression):
    """A polynomial in sines and cosines without the squares of sines."""
    for sine, cosine in ((s, c), (sy, cy), (sf, cf)):
        expression = sp.rem(sp.expand(expression), sine**2 + cosine**2 - 1, sine)
    return sp.expand(expression)


def missing_torque(**substitutions):
    """Torque of the equations of motion less that of the steady motion; all components are 0 on a family, drag is 0 unless given."""
    substitutions = dict.fromkeys(DRAG, 0) | substitutions
    alpha = sp.Matrix([cy * cf - c * sf * sy, -cy * sf - c * cf * sy, s * sy])
    gamma = sp.Matrix([s * sf, s * cf, c])
    state = [*((n + Omega) * gamma + sp.Matrix([0, 0, m])), *alpha, *gamma]
    rates = equations.rhs(state, symbolic_constants(k1, k2, k3))
    steady_rates = [(n + Omega) * m * gamma[1], -(n + Omega) * m * gamma[0], 0]
    numerators = []
    for inertia, rate, steady_rate in zip((A, B, C), rates[:3], steady_rates, strict=True):
        expression = sp.expand(inertia * (rate - steady_rate))
        for _ in range(3):  # a formula may introduce a name that another one replaces
            for name, value in substitutions.items():
                expression = expression.subs(sp.Symbol(name), value)
        numerator, _ = sp.fraction(sp.together(expression))
        numerators.append(reduced(numerator))
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


def with_drag(**more):
    """As node_rotor, with drag along the third axis."""
    rotor = node_rotor()
    return {**rotor, "k3": rotor["k3"] + drag3 * c * cy / (Omega * s), "drag3": drag3, **more}


def upright(side):
    return {"s": 0, "c": side, "B": A}


# The conditions of each family as substitutions; phi (and psi where n is not 0) is arbitrary.
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
    "perp_radius with drag": [
        {"B": A, "n": 0, "mu1": 0, "mu2": 0, **with_drag(h1=0, sin_psi=0, cos_psi=side)} for side in (1, -1)
    ],
    "oblique with drag": [
        {"B": A, "n": 0, "mu1": 0, "mu2": 0, **with_drag(h1=(3 * Omega**2 * s * (A - C) - drag3 / cy) * sy / mu3)}
    ],
    # The closed form without a magnet: s cos psi0 = drag3 / (3 Omega^2 (A - C)), k3 + C m = 4 Omega (A - C) c.
    "oblique with drag alone": [
        {"B": A, "n": 0, "mu1": 0, "mu2": 0, "mu3": 0, "k1": 0, "k2": 0, "k3": 4 * Omega * (A - C) * c - C * m,
         "drag3": 3 * Omega**2 * (A - C) * s * cy}
    ],
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


@pytest.mark.usual(
    "cylindrical, no magnet",
    "cylindrical, no rotation in space",
    "perp_radius",
    "oblique with drag alone",
    "spherical",
    "other_axis",
    "despun_transverse",
)
@pytest.mark.parametrize("name", PROOFS)
def test_family_solves_the_equations_identically(name):
    for substitutions in PROOFS[name]:
        assert missing_torque(**substitutions) == [0, 0, 0], substitutions


@pytest.mark.long
def test_equilibrium_rotor_leaves_only_the_torque_about_the_normal():
    """k = (R x gamma)/Omega + lambda gamma makes the torque gamma (beta.(3 Omega^2 I alpha + h1 mu) - alpha.drag)."""
    alpha = sp.Matrix([cy * cf - c * sf * sy, -cy * sf - c * cf * sy, s * sy])
    beta = sp.Matrix([sy * cf + c * sf * cy, -sy * sf + c * cf * cy, -s * cy])
    gamma = sp.Matrix([s * sf, s * cf, c])
    inertia, mu, lambda_ = sp.diag(A, B, C), sp.Matrix([mu1, mu2, mu3]), sp.Symbol("lambda")
    R = 3 * Omega**2 * alpha.cross(inertia * alpha) + (h1 * alpha + h3 * gamma).cross(mu)
    R += Omega**2 * (inertia * gamma).cross(gamma) + beta.cross(sp.Matrix(drag))
    k = R.cross(gamma) / Omega + lambda_ * gamma
    torque = gamma * (beta.dot(3 * Omega**2 * inertia * alpha + h1 * mu) - alpha.dot(sp.Matrix(drag)))
    rates = equations.rhs([*(Omega * gamma), *alpha, *gamma], symbolic_constants(*k))
    for i, moment in enumerate((A, B, C)):
        assert reduced(moment * rates[i] - torque[i]) == 0


# Random points on every family, by its own formulas.


@pytest.mark.usual(
    "theta0",
    "equilibrium-k1",
    "oblique-drag3",
    "transverse_magnet-h1",
    "despun_transverse-mu3",
    "spherical-n",
    "other_axis-k2",
)
@pytest.mark.parametrize(
    ("name", "parameter"), [(name, key) for name in NAMES for key in FAMILIES[name].solve]
)
def test_every_formula_restores_its_parameter(name, parameter):
    """A point on the family, changed in one parameter, returns to the family by that parameter's formula."""
    formula, count = FAMILIES[name].solve[parameter], 0
    for seed in range(40):
        point = satellite_on_family(name, np.random.default_rng(seed))
        if point is None:
            continue
        off = point | {parameter: point[parameter] + 0.05}
        if parameter == "theta0" and formula is FAMILIES["perp_velocity"].solve["theta0"]:
            off["h1"] = point["h1"] = off["drag3"] = point["drag3"] = np.zeros(1)
            off["k3"] = point["k3"] = FAMILIES[name].solve["k3"](point)
        value = formula(off)
        is_free = on_family(FAMILIES[name], off)[0] < 1e-10
        if is_free or np.isnan(value[0]):
            continue
        assert on_family(FAMILIES[name], off | {parameter: value})[0] < 1e-11
        count += 1
    assert count >= 5


def test_both_tilts_of_an_asymmetric_body():
    formula = FAMILIES["asymmetric_tilt"].solve["theta0"]
    tilts = formula({"theta0": np.array([-0.4, 1.5, 1.7, 4.0])})
    np.testing.assert_allclose(tilts, np.pi / 3 * np.array([1, 1, 2, 2]), rtol=1e-15)


def test_formulas_give_nan_where_a_family_does_not_exist():
    rng = np.random.default_rng(0)
    base = nonzero_satellite(rng, B=1, A=1, C=1.2, n=0, k1=0, k2=0, mu1=0, mu2=0, theta0=1)
    oblique = FAMILIES["oblique"].solve
    assert np.isnan(oblique["psi0"](base | {"h1": np.array([9.0]), "mu3": np.array([9.0])}))
    assert np.isnan(FAMILIES["perp_radius"].solve["theta0"](base | {"k3": np.array([9.0])}))
    upright = base | {"theta0": np.array([np.pi]), "psi0": np.array([np.pi / 2])}
    assert np.isnan(FAMILIES["perp_velocity"].solve["k3"](upright))
    upright["h1"] = np.zeros(1)
    upright["k3"] = FAMILIES["perp_velocity"].solve["k3"](upright)
    assert on_family(FAMILIES["perp_velocity"], upright)[0] < 1e-12
    no_orbit = base | {"Omega": np.zeros(1)}
    assert np.isnan(FAMILIES["perp_radius"].solve["k3"](no_orbit))


# A point is on a family if and only if its motion is steady.


@pytest.mark.long
@settings(max_examples=400, deadline=None)
@given(data=st.data())
def test_a_point_is_recognised_if_and_only_if_it_is_steady(data):
    """Points of few values, among which families and coincidences are frequent."""

    def pick(*values):
        return data.draw(st.sampled_from(values))

    rotor = pick("any", "node", "family")
    parameters = {
        "A": 1.0, "B": pick(1.0, 1.0, 1.3), "C": pick(1.0, 1.3, 0.8), "Omega": 1.0,
        "mu1": pick(0.0, 0.0, 0.7), "mu2": pick(0.0, 0.0, 0.4), "mu3": pick(0.0, 0.5),
        "h1": pick(0.0, 0.6, -0.3), "h3": pick(0.0, 0.5), "k1": pick(0.0, 0.0, 0.3), "k2": pick(0.0, 0.2),
        "k3": pick(0.0, 0.3), "theta0": pick(0.0, np.pi, np.pi / 3, 2 * np.pi / 3, np.pi / 2, 1.1, -0.7),
        "psi0": pick(0.0, np.pi / 2, -np.pi / 2, np.pi, 0.4), "phi0": pick(0.0, np.pi / 2, np.pi, 0.9),
        "theta_dot0": 0.0, "n": pick(0.0, 0.0, -1.0, 0.5, 1.0), "m": pick(0.0, 1.0, -1.0, 0.5, -0.5, 0.7),
        "damping": pick(0.0, 0.0, 0.3), "drag1": pick(0.0, 0.0, 0.0, 0.3), "drag2": pick(0.0, 0.0, 0.0, 0.2),
        "drag3": pick(0.0, 0.0, 0.4),
    }  # fmt: skip
    point = {name: np.full(1, float(value)) for name, value in parameters.items()}
    if rotor == "node":
        for name in pick(("m",), ("h1",), ("psi0",), ("h3",), ()):
            family = pick("oblique", "transverse_magnet", "despun_transverse", "asymmetric_tilt")
            if name in FAMILIES[family].solve:
                point[name] = FAMILIES[family].solve[name](point)
        for name in ("k1", "k2", "k3"):
            point[name] = FAMILIES["transverse_magnet"].solve[name](point)
    if rotor == "family":
        family = pick("spherical", "other_axis", "equilibrium", "cylindrical")
        for parameter, formula in FAMILIES[family].solve.items():
            if parameter.startswith("k"):
                value = formula(point)
                point[parameter] = np.where(np.isnan(value), point[parameter], value)
    if any(np.isnan(value[0]) or abs(value[0]) > 20 for value in point.values()):
        return
    flag, _ = SATELLITE.identify_family(point)
    if 0 < flag[0] <= len(FAMILIES):  # those that follow are about other axes
        assert acceleration_error(point) < 1e-9
    elif not any(point[name][0] for name in DRAG):  # families are complete without drag
        assert acceleration_error(point) > 1e-6


@pytest.mark.long
def test_points_one_percent_off_a_family_are_on_none():
    rng = np.random.default_rng(3)
    for name in NAMES:
        parameter = "C" if name in ("equilibrium", "other_axis", "oblique") else "k3"
        if name == "cylindrical":
            parameter = "B"
        count = 0
        for _ in range(20):
            point = satellite_on_family(name, rng)
            if point is None or SATELLITE.identify_family(point)[0][0] != FAMILIES[name].flag:
                continue
            off = point | {parameter: point[parameter] * 1.01}
            if name == "other_axis" and np.ptp([point[i][0] for i in "ABC"]) > 0:
                off = point | {"theta0": point["theta0"] * 1.01}
            flag, distance = SATELLITE.identify_family(off)
            assert flag[0] == 0
            assert distance[0] > 1e-5
            count += 1
        assert count > 3, name


@pytest.mark.long
def test_generic_points_are_on_no_family():
    points = random_satellites(np.random.default_rng(4), 500)
    flags, distance = SATELLITE.identify_family(
        {name: value.reshape(50, 10) for name, value in points.items()}
    )
    assert flags.shape == distance.shape == (50, 10)
    assert flags.dtype == np.int8
    assert not flags.any()
    assert distance.min() > 1e-3
    assert condition_residual(SATELLITE, points).min() > 1e-3


def test_order_of_overlapping_families():
    assert tuple(FAMILIES) == NAMES
    assert [family.flag for family in FAMILIES.values()] == list(range(1, 11))
    body = {"A": 1.0, "B": 1.0, "C": 1.2, "Omega": 1.0}

    def families_of(**values):
        point = {name: np.full(1, float((body | values).get(name, 0.0))) for name in PARAMETERS}
        names = [name for name, family in FAMILIES.items() if on_family(family, point)[0] < 1e-12]
        assert names[0] == NAMES[SATELLITE.identify_family(point)[0][0] - 1]
        return names

    assert families_of(m=0.4) == ["cylindrical", "perp_radius", "oblique"]
    assert families_of()[:3] == ["cylindrical", "equilibrium", "perp_radius"]
    k3 = 1.0 * np.cos(1.0) * (1 - 1.2) - 1.2 * 0.4
    assert families_of(theta0=1.0, m=0.4, k3=k3) == ["perp_radius", "oblique"]
    tilt = {"theta0": np.pi / 3, "psi0": np.pi / 2, "m": -1.0, "k3": 0.8}
    assert families_of(**tilt) == ["perp_velocity", "transverse_magnet", "asymmetric_tilt"]
    assert families_of(B=1.1, **tilt | {"k3": 0.9}) == ["asymmetric_tilt"]
    assert families_of(C=1.0, theta0=1.0, n=0.5) == ["spherical", "other_axis"]
    assert families_of(C=1.0, theta0=1.0, n=0.5, k2=np.sin(1.0), k3=np.cos(1.0)) == ["other_axis"]
    assert families_of(C=1.0, theta0=1.0, n=0.5, m=0.3, k3=-0.3) == ["spherical"]


def test_exact_starts_written_with_pi():
    """Tilts of multiples of pi in float64 are on the family."""
    for theta0 in (np.pi, -np.pi, 4 * np.pi):
        point = nonzero_satellite(np.random.default_rng(1), theta0=theta0, B=1, A=1, h1=0)
        for name in ("k1", "k2"):
            point[name] = FAMILIES["cylindrical"].solve[name](point)
        assert SATELLITE.identify_family(point)[0][0] == FAMILIES["cylindrical"].flag


# The closed form against an integrator.


def test_closed_form_shapes():
    point = satellite_on_family("perp_velocity", np.random.default_rng(5))
    points = {name: np.broadcast_to(value, (4, 3)) for name, value in point.items()}
    assert steady_motion(points, np.zeros((2, 5))).shape == (9, 2, 5, 4, 3)
    np.testing.assert_allclose(
        steady_motion(points, np.array(0.0)), initial_state(points), rtol=0, atol=1e-15
    )


# The verified cases and the paper's equations.


def test_the_68_cases_are_recognised():
    points = satellite_cases()
    flags, _ = SATELLITE.identify_family(points)
    flags[unsteady(SATELLITE, flags)] = 0
    residuals = condition_residual(SATELLITE, points)
    upright = np.abs(np.sin(points["theta0"])) < 1e-12

    def label(i, precession):
        if flags[i] == 0:
            return "drifting"
        regular = not upright[i] and abs(precession) > 1e-5 and abs(points["m"][i]) > 1e-5
        return "regular_precession" if regular else "permanent_rotation"

    for i, case in enumerate(cases("satellite")):
        assert (flags[i] > 0) == case["valid"], case["id"]
        assert label(i, points["n"][i]) == case["label_orbital"], case["id"]
        assert label(i, points["n"][i] + points["Omega"][i]) == case["label_inertial"], case["id"]
        if case["valid"]:
            assert residuals[i] < 1e-12, case["id"]
            geometry = FAMILIES[NAMES[flags[i] - 1]].geometry
            assert geometry in ("", case["geometry"]), case["id"]
        else:
            assert residuals[i] > 1e-4, case["id"]
