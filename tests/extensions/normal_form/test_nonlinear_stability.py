"""Birkhoff's normal form and the verdicts from it: closed forms, published numbers, and cases by other methods."""

from __future__ import annotations

import json
from itertools import combinations, combinations_with_replacement, permutations
from pathlib import Path

import numpy as np
import pytest
import xarray as xr
from scipy.optimize import brentq
from truth import default_points

import atlas
from atlas.extensions.normal_form import nonlinear
from atlas.extensions.normal_form.nonlinear import NormalForm
from atlas.extensions.normal_form.variables import NONLINEAR, NORMAL_FORM
from atlas.flags import NonlinearStability, StabilityKind
from atlas.systems.base import derived_values, derived_variables
from atlas.systems.fixed_point import FIXED_POINT
from atlas.systems.gyrostat.oscillations import Equilibria
from atlas.systems.gyrostat.system import FREQUENCIES
from atlas.systems.satellite import SATELLITE

FOLDER = Path(__file__).parents[2] / "reference"
CASES = json.loads((FOLDER / "arnold_moser.json").read_text("utf-8"))
STAUDE = json.loads((FOLDER / "birkhoff_staude.json").read_text("utf-8"))["cases"]
ENERGY, ARNOLD_MOSER = NonlinearStability.ENERGY, NonlinearStability.ARNOLD_MOSER
NAMES = (NONLINEAR, *NORMAL_FORM, "stability_kind", *FREQUENCIES)
VERDICTS = {"stable_by_energy": ENERGY, "stable_by_Arnold_Moser": ARNOLD_MOSER}


def theory(system, points):
    """Columns of the derived variables."""
    return derived_values(system, NAMES, points, np.ones(len(points["A"])), lambda: None)


def derivatives(*homogeneous):
    """Derivatives of homogeneous polynomials of degree 2, 3, ..., functions of (4, ...), by polarisation."""
    tensors = []
    for order, polynomial in enumerate(homogeneous, 2):
        tensor = np.zeros(order * [4])
        for index in combinations_with_replacement(range(4), order):
            vectors = np.eye(4)[list(index)]
            value = 0.0
            for count in range(1, order + 1):
                sums = [sum(chosen) for chosen in combinations(vectors, count)]
                value += (-1) ** (order - count) * sum(polynomial(x) for x in sums)
            for place in permutations(index):
                tensor[place] = value
        tensors.append(tensor[None])
    return tensors


def form_of(*homogeneous):
    return NormalForm._make(value[0] for value in NormalForm.of(*derivatives(*homogeneous)))


# The normal form.


def test_the_constants_of_coupled_oscillators():
    """The anharmonic constants of I. M. Mills (1972), with phi_ijk and phi_ijkl in units of sqrt(w): H = sum (n + 1/2) w ..."""
    rng = np.random.default_rng(0)
    for _ in range(5):
        w = rng.uniform(0.5, 2.5, 2)
        w = np.sort(w)[::-1]
        cubic, quartic = rng.normal(size=(2, 2, 2)), rng.normal(size=(2, 2, 2, 2))
        form = form_of(
            lambda z, w=w: 0.5 * w @ (z[:2] ** 2 + z[2:] ** 2),
            lambda z, k=cubic: np.einsum("ijk,i,j,k", k, *3 * [z[:2]]) / 6,
            lambda z, k=quartic: np.einsum("ijkl,i,j,k,l", k, *4 * [z[:2]]) / 24,
        )
        p3 = (
            sum(
                cubic.transpose(o) for o in ((0, 1, 2), (0, 2, 1), (1, 0, 2), (1, 2, 0), (2, 0, 1), (2, 1, 0))
            )
            / 6
        )
        quartets = [
            np.einsum("ijkl->" + o, quartic) for o in ("ijkl", "ikjl", "iljk", "jkil", "jlik", "klij")
        ]
        iiii = [quartic[i, i, i, i] for i in (0, 1)]
        iijj = sum(q[0, 0, 1, 1] for q in quartets) / 6

        def own(i, p=p3, w=w, iiii=iiii):
            terms = [
                p[i, i, k] ** 2 * (8 * w[i] ** 2 - 3 * w[k] ** 2) / (w[k] * (4 * w[i] ** 2 - w[k] ** 2))
                for k in (0, 1)
            ]
            return (iiii[i] - sum(terms)) / 16

        def mixed(p=p3, w=w, iijj=iijj):
            first = sum(p[0, 0, k] * p[1, 1, k] / w[k] for k in (0, 1))
            second = 0.0
            for k in (0, 1):
                poles = [w[k] + s * w[0] + t * w[1] for s in (1, -1) for t in (1, -1)]
                second += p[0, 1, k] ** 2 * w[k] * (w[k] ** 2 - w[0] ** 2 - w[1] ** 2) / np.prod(poles)
            return (iijj - first - 2 * second) / 4

        np.testing.assert_allclose([form.l1, form.l2], w, rtol=1e-13)
        np.testing.assert_allclose([form.c20, form.c02, form.c11], [own(0), own(1), mixed()], rtol=1e-9)


def test_henon_and_heiles():
    """H = I - 5/12 I^2 + 7/12 L^2 (Gustavson 1966), L^2 = 2 J1 J2 (1 - cos 2(phi1 - phi2)), at equal frequencies."""
    split = 1e-4  # equal frequencies have no modes
    form = form_of(
        lambda z: 0.5 * (z @ z + split * (z[0] ** 2 + z[2] ** 2)),
        lambda z: z[0] ** 2 * z[1] - z[1] ** 3 / 3,
        lambda z: 0.0,
    )
    np.testing.assert_allclose([form.c20, form.c11, form.c02], [-5 / 12, 1 / 3, -5 / 12], atol=3 * split)
    equal = form_of(lambda z: 0.5 * z @ z, lambda z: z[0] ** 2 * z[1] - z[1] ** 3 / 3, lambda z: 0.0)
    assert np.isnan(equal.c11)
    assert equal.verdict() == NonlinearStability.DEGENERATE


def lagrange_point(mu):
    """The normal form at L4, coordinates from there, by Legendre's series of 1/distance."""
    radii = np.array([[0.5, np.sqrt(0.75)], [-0.5, np.sqrt(0.75)]])  # from the masses 1 - mu and mu

    def attraction(legendre, z):
        return -sum(m * legendre(r @ z[:2], z[:2] @ z[:2]) for m, r in zip((1 - mu, mu), radii, strict=True))

    return form_of(
        lambda z: (
            z[2:] @ z[2:] / 2 + z[1] * z[2] - z[0] * z[3] + attraction(lambda s, q: (3 * s**2 - q) / 2, z)
        ),
        lambda z: attraction(lambda s, q: -(5 * s**3 - 3 * s * q) / 2, z),
        lambda z: attraction(lambda s, q: (35 * s**4 - 30 * s**2 * q + 3 * q**2) / 8, z),
    )


def test_the_triangular_point_has_the_determinant_of_deprit():
    """A. Deprit and A. Deprit-Bartholome, Astron. J. 72 (1967) 173, with half their D as the scale of the actions."""
    for mu in (0.002, 0.006, 0.012, 0.02, 0.03):
        form = lagrange_point(mu)
        square = 27 / 4 * mu * (1 - mu)
        assert (form.l1 * form.l2) ** 2 == pytest.approx(square, rel=1e-12)
        D = (36 - 541 * square + 644 * square**2) / (8 * (1 - 4 * square) * (4 - 25 * square))
        assert form.l1 * form.l2 < 0
        assert abs(form.determinant) == pytest.approx(abs(D) / 2, rel=1e-9)
    assert abs(lagrange_point(0.0109136676772).determinant) < 1e-9
    critical = lagrange_point(0.0109136676772)
    assert critical.verdict() == NonlinearStability.DEGENERATE
    # A. P. Markeev (1969): unstable at both resonances of low order.
    for ratio, resonant in ((2, "cubic"), (3, "quartic")):
        square = (ratio / (1 + ratio**2)) ** 2
        form = lagrange_point(0.5 * (1 - np.sqrt(1 - 16 / 27 * square)))
        assert form.l1 / form.l2 == pytest.approx(-ratio, rel=1e-10)
        assert getattr(form, resonant) > 0.1
        assert form.verdict() == NonlinearStability.RESONANCE_UNSTABLE
    assert lagrange_point(0.01).verdict() == ARNOLD_MOSER


def test_verdicts_by_their_order():
    def verdict(l1, l2, c20=1.0, c11=0.0, c02=1.0, cubic=0.0, quartic=0.0):
        columns = (np.array([float(x)]) for x in (l1, l2, c20, c11, c02, cubic, quartic))
        return NormalForm(*columns).verdict()[0].item()

    V = NonlinearStability
    assert verdict(2.0, 0.7) == V.ENERGY
    assert verdict(2.0, -0.7) == V.ARNOLD_MOSER
    assert verdict(2.0, -0.7, c11=-(1.0 * 0.49 + 4.0) / 1.4) == V.DEGENERATE
    assert verdict(1.0005, -1.0) == V.DEGENERATE
    assert verdict(2.0, -1.0, cubic=1e-3) == V.RESONANCE_UNSTABLE
    assert verdict(2.0, -1.0) == V.RESONANCE_STABLE
    assert verdict(2.0, -1.0, c20=0.0, c02=0.0) == V.DEGENERATE
    assert verdict(2.0012, -1.0, cubic=1e-3) == V.ARNOLD_MOSER
    assert verdict(-3.0, 1.0, quartic=1.92) == V.RESONANCE_STABLE
    assert verdict(-3.0, 1.0, quartic=1.93) == V.RESONANCE_UNSTABLE
    assert verdict(3.0, -1.0, quartic=10 / np.sqrt(27)) == V.DEGENERATE
    assert verdict(np.nan, np.nan) == V.DEGENERATE


# The satellite.


def satellite_points(case):
    """Points of a case, a third of its momentum in the rotor."""
    parameters = {name: float(value) for name, value in case["parameters"].items()}
    axis = {name: float(value) for name, value in case["axis_in_orbital_frame"].items()}
    S, C = parameters["momentum_C_w3_plus_k3"], parameters["C"]
    return default_points(
        "satellite", C=C, k3=S / 3, m=2 * S / (3 * C) - axis["normal"], mu3=1.0, h1=parameters["h1mu3"],
        h3=parameters["h3mu3"], theta0=np.arctan2(np.hypot(axis["radius"], axis["velocity"]), axis["normal"]),
        psi0=np.arctan2(axis["radius"], -axis["velocity"]) if axis["normal"] < 1 else 0.0,
    )  # fmt: skip


@pytest.mark.parametrize("case", CASES["cases"])
def test_coefficients_and_verdicts_of_satellites(case):
    values = theory(SATELLITE, satellite_points(case))
    assert values[NONLINEAR][0] == VERDICTS[case["verdict"]]
    expected = [float(case[name]) for name in ("c20", "c11", "c02", "D")]
    np.testing.assert_allclose([values[name][0] for name in NORMAL_FORM], expected, rtol=1e-9)
    frequencies = [abs(float(case[name])) for name in ("l1", "l2")]
    np.testing.assert_allclose([values[name][0] for name in FREQUENCIES[:2]], frequencies, rtol=1e-9)


def cylindrical(sigma, momentum, **more):
    return default_points("satellite", C=sigma, m=momentum / sigma - 1, **more)


def test_resonances_and_zeros_of_the_determinant():
    V = NonlinearStability
    for curve in CASES["curves"]:
        sigma = float(curve["C_over_A"])
        for momentum in map(float, curve["D_zero"]):
            values = theory(SATELLITE, cylindrical(sigma, momentum))
            assert abs(values["birkhoff_determinant"][0]) < 1e-12
            assert values[NONLINEAR][0] == V.DEGENERATE
            beside = theory(SATELLITE, cylindrical(sigma, momentum + np.array([-1e-6, 1e-6])))
            assert np.prod(np.sign(beside["birkhoff_determinant"])) == -1
            assert (beside[NONLINEAR] == V.ARNOLD_MOSER).all()
        for name, verdict in (
            ("1:1", V.DEGENERATE),
            ("2:1", V.RESONANCE_STABLE),
            ("3:1", V.RESONANCE_STABLE),
        ):
            for momentum in map(float, curve["resonance"][name]):
                values = theory(SATELLITE, cylindrical(sigma, momentum))
                assert values[NONLINEAR][0] == verdict
                if name != "1:1":
                    ratio = values["frequency_1"][0] / values["frequency_2"][0]
                    assert ratio == pytest.approx(float(name[0]), abs=1e-9)
    for case in CASES["resonance_3_1"]:
        values = theory(SATELLITE, cylindrical(float(case["C_over_A"]), float(case["momentum"])))
        assert values[NONLINEAR][0] == V.RESONANCE_STABLE
        expected = [float(case[name]) for name in ("c20", "c11", "c02")]
        np.testing.assert_allclose([values[name][0] for name in NORMAL_FORM[:3]], expected, rtol=1e-9)
        # the resonance ends at |l1/l2 + 3| = 1e-3
        beside = theory(SATELLITE, cylindrical(float(case["C_over_A"]), float(case["momentum"]) + 0.01))
        assert beside[NONLINEAR][0] == ARNOLD_MOSER


@pytest.mark.usual("momenta0")
@pytest.mark.parametrize(
    ("momenta", "ends"), [((-2.0, -1.5), (1.05182, 1.08671)), ((0.3, 0.6), (1.05606, 1.07165))]
)
def test_the_resonance_3_to_1_is_unstable_near_the_zeros_of_the_determinant(momenta, ends):
    """Runs leave such motions, see scripts/tools/nonlinear_runs.py."""

    def verdict(sigma):
        def off_resonance(momentum):
            values = theory(SATELLITE, cylindrical(sigma, momentum))
            return values["frequency_1"][0] / values["frequency_2"][0] - 3

        resonance = brentq(off_resonance, *momenta, xtol=1e-13)
        return theory(SATELLITE, cylindrical(sigma, resonance))[NONLINEAR][0]

    for end, outward in zip(ends, (-1, 1), strict=True):
        assert verdict(end + 2e-5 * outward) == NonlinearStability.RESONANCE_STABLE
        assert verdict(end - 2e-5 * outward) == NonlinearStability.RESONANCE_UNSTABLE


def test_the_markeev_amplitude_at_the_resonance_3_to_1():
    for case in CASES["resonance_3_1"]:
        points = cylindrical(float(case["C_over_A"]), float(case["momentum"]))
        body = SATELLITE.body(points)
        rest = Equilibria.of(body, *SATELLITE.start(points))
        form = NormalForm.of(*nonlinear.derivatives(rest, np.array([0])))
        moment = body.inertia.max()
        assert form.quartic[0] / moment == pytest.approx(float(case["resonant_amplitude"]), rel=1e-10)
        rates = [form.l1[0] * rest.rate[0], form.l2[0] * rest.rate[0]]
        np.testing.assert_allclose(rates, [float(case["l1"]), float(case["l2"])], rtol=1e-10)


def test_units_and_the_axis_of_symmetry_do_not_matter():
    values = theory(SATELLITE, cylindrical(0.8, -3.0))
    expected = [0.555696576719847, 0.145668076809346, 0.0183181185584357, 1.57626422123705]
    np.testing.assert_allclose([values[name][0] for name in NORMAL_FORM], expected, rtol=1e-13)
    other = {"A": 2.0, "B": 2.0, "C": 1.6, "Omega": 3.0, "m": 3 * (-3 / 0.8 - 1)}
    other = theory(SATELLITE, default_points("satellite", **other))
    scaled = np.array(expected) / [2, 2, 2, 2 / 9]
    np.testing.assert_allclose([other[name][0] for name in NORMAL_FORM], scaled, rtol=1e-12)
    # the axis of symmetry is the first one, along the normal
    turned = default_points(
        "satellite", A=0.8, B=1.0, C=1.0, theta0=np.pi / 2, phi0=np.pi / 2, n=-3 / 0.8 - 1
    )
    assert SATELLITE.identify_family(turned)[0] == SATELLITE.families["other_axis"].flag
    turned = theory(SATELLITE, turned)
    np.testing.assert_allclose([turned[name][0] for name in NORMAL_FORM], expected, rtol=1e-12)
    assert turned[NONLINEAR][0] == values[NONLINEAR][0] == ARNOLD_MOSER


def test_a_tilted_satellite_has_a_cubic_resonance():
    """perp_velocity at l1 = -2 l2, where the Hamiltonian has cubic terms."""

    def at(theta):
        points = default_points("satellite", C=1.9, theta0=theta, psi0=np.pi / 2)
        return theory(SATELLITE, points | {"k3": SATELLITE.families["perp_velocity"].solve["k3"](points)})

    def off_resonance(theta):
        values = at(theta)
        return values["frequency_1"][0] / values["frequency_2"][0] - 2

    resonance = brentq(off_resonance, 0.6, 0.79, xtol=1e-14)
    slope = (off_resonance(resonance + 1e-5) - off_resonance(resonance - 1e-5)) / 2e-5
    for shift, verdict in (
        (0.0, NonlinearStability.RESONANCE_UNSTABLE),
        (0.9e-3, NonlinearStability.RESONANCE_UNSTABLE),
        (1.1e-3, ARNOLD_MOSER),
        (-1.1e-3, ARNOLD_MOSER),
    ):
        values = at(resonance + shift / slope)
        assert values["stability_kind"][0] == StabilityKind.GYROSCOPIC
        assert values[NONLINEAR][0] == verdict


def test_three_degrees_of_freedom_are_undecided():
    V = NonlinearStability
    B, C = np.array([1.5, 1.0, 1.4]), np.array([1.2, 1.2, 1.7])
    asymmetric = default_points("satellite", A=1.3, B=B, C=C)
    values = theory(SATELLITE, asymmetric)
    assert values["stability_kind"].tolist() == [
        StabilityKind.GYROSCOPIC,
        StabilityKind.UNSTABLE,
        StabilityKind.ENERGY_STABLE,
    ]
    assert values[NONLINEAR].tolist() == [V.UNDECIDED, V.LINEARLY_UNSTABLE, V.ENERGY]
    assert np.isnan([values[name] for name in NORMAL_FORM]).all()
    off = default_points("satellite", B=1.3, C=1.7, theta0=0.3)
    assert theory(SATELLITE, off)[NONLINEAR][0] == V.UNKNOWN
    # Damping leaves no normal form.
    damped = theory(SATELLITE, default_points("satellite", C=1.25, damping=0.1))
    assert damped[NONLINEAR][0] == V.ENERGY
    assert np.isnan(damped["birkhoff_c20"][0])


def test_a_libration_is_no_equilibrium_where_it_starts_at_rest():
    values = theory(SATELLITE, default_points("satellite", B=1.3, C=1.7, psi0=0.5))
    assert np.isnan([values[name][0] for name in FREQUENCIES]).all()
    assert values[NONLINEAR][0] == NonlinearStability.UNDECIDED


# A fixed point.


@pytest.mark.parametrize("case", STAUDE)
def test_permanent_rotations_by_periodic_orbits(case):
    values = theory(FIXED_POINT, default_points("fixed_point", **case["body"]))
    assert values[NONLINEAR][0] == (ENERGY if case["l1"] * case["l2"] > 0 else ARNOLD_MOSER)
    expected = [case["c20"], np.mean(case["c11"]), case["c02"]]
    np.testing.assert_allclose([values[name][0] for name in NORMAL_FORM[:3]], expected, rtol=1e-6, atol=1e-8)


def test_tops_with_one_degree_of_freedom_are_decided_by_the_energy():
    spin = np.array([1.0, 5.0])
    sleeping = theory(FIXED_POINT, default_points("fixed_point", C=0.6, Mg=2.0, z0=-0.7, m=spin))
    assert sleeping[NONLINEAR].tolist() == [NonlinearStability.LINEARLY_UNSTABLE, ENERGY]
    conical = default_points("fixed_point", C=0.6, Mg=1.0, z0=0.4, m=3.0, theta0=1.0)
    conical |= {"n": FIXED_POINT.families["conical"].solve["n"](conical)}
    assert FIXED_POINT.identify_family(conical)[0] == FIXED_POINT.families["conical"].flag
    conical = theory(FIXED_POINT, conical)
    assert conical[NONLINEAR][0] == ENERGY
    assert np.isnan([values for name, values in {**sleeping, **conical}.items() if name in NORMAL_FORM]).all()


# As variables of scenes.


@pytest.mark.usefixtures("whole_kernels")
def test_scenes_and_points_write_verdicts_and_coefficients():
    names = ["nonlinear_stability", "birkhoff_determinant"]
    ds = atlas.label_points("satellite", {"A": 1.0, "B": 1.3, "C": 1.7}, duration=1.0, variables=names)
    assert ds.nonlinear_stability.dtype == np.int8
    assert ds.nonlinear_stability.attrs["flag_meanings"].split()[1:3] == ["energy", "arnold_moser"]
    assert ds.nonlinear_stability.item() == ENERGY
    assert ds.birkhoff_determinant.attrs["units"] == "kg-1 m-2 s-2"
    assert np.isnan(ds.birkhoff_determinant.item())


@pytest.mark.parametrize("system", [SATELLITE, FIXED_POINT])
def test_variables_computed_together_are_those_computed_alone(system):
    """To the bit, at equilibria with and without oscillations and off every family."""
    moments = np.random.default_rng(0).uniform(1, 2, (3, 30))
    points = default_points(system.name, **dict(zip("ABC", moments, strict=True)))
    points["theta0"][:10] = 0.3
    together = derived_values(system, NAMES, points, np.ones(30), lambda: None)
    for name in NAMES:
        alone = derived_variables(system)[name].values(points, np.ones(30), lambda: None)
        assert alone.tobytes() == together[name].tobytes()


def test_verdicts_share_linear_theory_with_the_variables_of_the_core(steps_of_theory):
    points = default_points("satellite", C=1.7, B=1.3)
    for names, expected in (
        ([NONLINEAR, "birkhoff_c11"], ["energy_stability", "linear_stability"]),
        (NAMES, ["frequencies", "energy_stability", "linear_stability"]),
    ):
        steps_of_theory.clear()
        derived_values(SATELLITE, names, points, np.ones(1), lambda: None)
        assert sorted(steps_of_theory) == sorted(["identify_family", *expected])


def test_without_the_extension_its_names_are_refused_and_other_numbers_are_equal(
    without_extension, scene_text
):
    text = scene_text(
        {"outputs.variables": ["label", "predicted", "stable", "growth_rate", "stability_kind"]}
    )
    whole = atlas.run(atlas.load_scene(text), progress=False)
    without_extension("normal_form")
    for name in (NONLINEAR, *NORMAL_FORM):
        with pytest.raises(atlas.BadInput, match=f"^outputs.variables: '{name}' is unknown; [^\n]*$"):
            atlas.load_scene(scene_text({"outputs.variables": ["label", name]}))
    with pytest.raises(atlas.BadInput, match=f"^variables: '{NONLINEAR}' is unknown; [^\n]*$"):
        atlas.label_points("satellite", {"theta0": 0.4}, duration=1.0, variables=[NONLINEAR])
    alone = atlas.run(atlas.load_scene(text), progress=False)
    xr.testing.assert_equal(alone[[*whole.data_vars]], whole[[*whole.data_vars]])
