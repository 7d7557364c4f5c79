"""Which of several solutions a scene takes: branch and near under [family]."""

import numpy as np
import pytest

import atlas
from atlas import BadInput, load_scene
from atlas.flags import Label
from atlas.scene import grid
from atlas.scene.family import solution
from atlas.systems import SYSTEMS
from atlas.systems.base import families_of

pytestmark = pytest.mark.usefixtures("whole_kernels")

VECTORS = ["p0", "q0", "r0", "gamma10", "gamma20", "gamma30"]
TOP = {"A": 1.0, "B": 1.0, "C": 0.5, "Mg": 1.0, "z0": 1.0, "theta0": np.radians(150)}
TILTED = {
    "A": 1.0,
    "B": 1.0,
    "C": 1.7,
    "Omega": 1.0,
    "h1": -0.6,
    "mu3": 0.4,
    "h3": 0.1,
    "k3": -0.5,
    "m": 0.3,
    "psi0": np.pi / 2,
}
UPRIGHT = {"A": 1.0, "B": 1.0, "C": 1.3, "m": 0.2}


def scene_of(system, fixed, name, solve, axis="phi0", values=(0.1, 0.2), **choice):
    """A scene on a family along an axis."""
    return load_scene(
        {
            "schema": 1, "system": system, "fixed": fixed, "axes": {axis: {"values": list(values)}},
            "family": {"name": name, "solve": solve} | choice, "integration": {"duration": 20.0, "method": "rk8"},
            "labels": {"rate_tolerance": 1e-5},
        }
    )  # fmt: skip


def solved(*arguments, **choice):
    """The starts of such a scene, all of which are on the family."""
    scene = scene_of(*arguments, **choice)
    points = grid.points_at_indices(scene, np.arange(scene.size))
    assert points.exists.all()
    return points.base


def test_slow_and_fast_precession_of_a_top():
    fast, slow, default, near = (
        solved("fixed_point", TOP, "conical", ["n"], "m", (8.0, 9.0), **choice)["n"]
        for choice in ({"branch": "fast"}, {"branch": "slow"}, {}, {"near": -8.5})
    )
    for i, m in enumerate((8.0, 9.0)):
        # the balance of torques of a body of which A n sin(theta) is the transverse momentum
        roots = np.roots([(0.5 - 1.0) * np.cos(TOP["theta0"]), 0.5 * m, 1.0])
        np.testing.assert_allclose(sorted((slow[i], fast[i]), key=abs), sorted(roots, key=abs), rtol=1e-12)
    np.testing.assert_array_equal(default, slow)
    np.testing.assert_array_equal(near, fast)
    assert np.abs(fast).min() > 8 > 1 > np.abs(slow).max()


def test_near_takes_arithmetic_as_fixed_values_do():
    top = {key: value for key, value in TOP.items() if key not in ("theta0", "Mg")}
    for near, theta0 in (
        ("20 * deg", 0.0),
        ("150 * deg", np.pi),
        (2.9, np.pi),
        ({"theta0": "pi - 0.2"}, np.pi),
    ):
        found = solved("fixed_point", top, "rest", ["theta0"], "Mg", (1.0, 2.0), near=near)["theta0"]
        np.testing.assert_allclose(found, theta0, atol=1e-12)


def test_a_fast_precession_is_measured():
    ds = atlas.run(
        scene_of("fixed_point", TOP, "conical", ["n"], "m", (8.0, 9.0), branch="fast"), progress=False
    )
    assert (ds.label == Label.REGULAR_PRECESSION).all()
    np.testing.assert_allclose(ds.psi_dot_mean, ds.n, rtol=1e-9)


def test_there_is_no_fast_precession_where_the_equation_is_linear():
    thetas = (1.2, np.pi / 2, 2.0)
    top = {key: value for key, value in TOP.items() if key != "theta0"} | {"C": 1.0, "m": 9.0}
    fast, slow = (
        scene_of("fixed_point", top, "conical", ["n"], "theta0", thetas, branch=branch)
        for branch in ("fast", "slow")
    )
    with pytest.raises(BadInput, match="no n puts any point"):
        grid.check(fast)  # of a sphere
    np.testing.assert_allclose(grid.points_at_indices(slow, np.arange(3)).base["n"], -1 / 9)


@pytest.mark.parametrize("rotor", [0.0, 0.3, -1.5])
def test_precessions_of_grioli_at_each_rate(rotor):
    s = np.sqrt([0.4, 0.0, 0.6])  # normal to a circular section of 1, 1.4, 2
    body = {
        "A": 1.0,
        "B": 1.4,
        "C": 2.0,
        "x0": s[0],
        "z0": s[2],
        "l1": rotor * s[0],
        "l3": rotor * s[2],
        "N": 0.0,
    }
    b = 0.4 * 1.0 + 0.6 * 2.0
    d2 = (1.4 - 1.0) * (2.0 - 1.4)
    roots = np.roots([b**2 + d2, 2 * b * rotor, rotor**2, 0.0, -1.0])
    roots = np.sort(roots[np.abs(roots.imag) < 1e-9].real)
    arguments = ("fixed_point", body, "grioli", VECTORS, "Mg", (1.0,))

    def rate(**choice):
        base = solved(*arguments, **choice)
        return s @ [base[name][0] for name in VECTORS[:3]]

    for root in roots:
        assert rate(near=float(root)) == pytest.approx(root, rel=1e-12)
    assert rate() == pytest.approx(roots.max(), rel=1e-12)
    if rotor:
        assert rate(branch="fast") == pytest.approx(max(roots, key=abs), rel=1e-12)
        assert rate(branch="slow") == pytest.approx(min(roots, key=abs), rel=1e-12)


def test_all_tilts_of_an_axial_magnet():
    tilt = np.linspace(0.001, np.pi - 0.001, 20_001)
    p = TILTED
    torque = p["Omega"] * np.sin(tilt) * (p["k3"] + p["C"] * p["m"]) - (
        4 * np.sin(tilt) * np.cos(tilt) * (p["A"] - p["C"])
        + p["mu3"] * (p["h3"] * np.sin(tilt) - p["h1"] * np.cos(tilt))
    )
    roots = tilt[:-1][np.diff(np.sign(torque)) != 0]
    assert len(roots) > 1
    for root in roots:
        found = solved("satellite", TILTED, "perp_velocity", ["theta0"], near=float(root))["theta0"]
        np.testing.assert_allclose(found, root, atol=2e-4)
    scene = scene_of(
        "satellite", TILTED, "perp_velocity", ["theta0"]
    )  # by default none, as there are several
    with pytest.raises(BadInput, match="no theta0 puts any point"):
        grid.check(scene)


ANGLES = [
    ("perp_radius", "psi0", {"k3": 0.1}, (0.0, np.pi, -np.pi)),
    ("perp_velocity", "psi0", {"k3": 0.1}, (np.pi / 2, -np.pi / 2)),
    ("cylindrical", "theta0", {}, (0.0, np.pi)),
    ("asymmetric_tilt", "theta0", {"psi0": np.pi / 2}, (np.pi / 3, 2 * np.pi / 3)),
]  # fmt: skip


@pytest.mark.parametrize(("family", "name", "fixed", "values"), ANGLES)
def test_angles_near_a_value(family, name, fixed, values):
    description = families_of(SYSTEMS["satellite"])[family]
    base = {key: np.array([parameter.default]) for key, parameter in SYSTEMS["satellite"].parameters.items()}
    base |= {key: np.array([value]) for key, value in (UPRIGHT | fixed).items()}
    for value in values:  # the first is that of today, without a choice
        assert solution(description, [name], base, {name: value + 0.1})[name] == pytest.approx(value)
    assert solution(description, [name], base, {})[name] == pytest.approx(values[0])


@pytest.mark.parametrize("theta", [0.0, np.pi, 2.2])
def test_a_symmetric_body_rests_upright_too(theta):
    body = {"A": 1.0, "B": 1.0, "C": 0.5, "N": 1.0, "Mg": 1.0, "z0": -0.5 * np.cos(2.2)}
    found = solved("fixed_point", body, "rest", ["theta0"], near=theta + 0.05)["theta0"]
    assert (np.abs(found - theta) < 1e-9).all()


def test_several_parameters_take_a_table():
    choice = {"near": {"psi0": -1.0, "theta0": 2.0}}
    base = solved(
        "satellite",
        {"A": 1.0, "B": 1.2, "C": 1.3},
        "asymmetric_tilt",
        ["theta0", "psi0", "m", "k3"],
        **choice,
    )
    assert base["psi0"] == pytest.approx(-np.pi / 2)
    assert base["theta0"] == pytest.approx(2 * np.pi / 3)
    body = {"A": 1.0, "B": 1.4, "C": 2.0, "z0": np.sqrt(0.6), "y0": 0.0, "N": 0.0}
    base = solved("fixed_point", body, "grioli", ["x0", *VECTORS], "Mg", (1.0,), near={"x0": -1.0})
    assert base["x0"] == pytest.approx(-np.sqrt(0.4))
    assert base["x0"] * base["p0"] + base["z0"] * base["r0"] > 0  # n, of which nothing is asked


@pytest.mark.parametrize(
    "choice", [{"branch": "slow"}, {"branch": "fast"}, {"near": -3.0}, {"near": {"n": -3.0}}]
)
def test_the_resolved_scene_names_the_choice(choice):
    scene = scene_of("fixed_point", TOP, "conical", ["n"], "m", (8.0, 9.0), **choice)
    assert load_scene(scene.toml()).toml() == scene.toml()
    assert load_scene(scene.toml()).choice == choice
    assert f"solved for n, {next(iter(choice))} = " in repr(scene)
    assert "choice" not in scene_of("fixed_point", TOP, "conical", ["n"], "m", (8.0,)).toml()


WRONG = [
    ("conical", ["n"], {"branch": "quick"}, "family.branch = 'quick': allowed: slow, fast"),
    ("conical", ["n"], {"branch": 3}, "family.branch = 3: allowed: slow, fast"),
    ("conical", ["n"], {"branch": "fast", "near": 1.0}, "family: branch and near are both given; a scene has one of them"),
    ("conical", ["m"], {"branch": "fast"}, "family.branch = 'fast': no rate with several solutions is solved; atlas conditions lists them by family"),
    ("staude", ["theta0"], {"branch": "fast"}, "family.branch = 'fast': no rate with several solutions is solved; use near for theta0"),
    ("conical", ["m"], {"near": 1.0}, "family.near = 1.0: no solved parameter has several solutions"),
    ("conical", [], {"near": 1.0}, "family.near = 1.0: no solved parameter has several solutions"),
    ("conical", ["n"], {"near": "fast"}, "family.near = 'fast': must be a number"),
    ("conical", ["n"], {"near": float("inf")}, "family.near = inf: must be a finite number"),
    ("conical", ["n"], {"near": [1.0]}, "family.near = [1.0]: must be a number"),
    ("conical", ["n"], {"near": {"m": 1.0}}, "family.near.m: no solved parameter with several solutions; allowed: n"),
    ("conical", ["n"], {"near": {"n": True}}, "family.near.n = True: must be a number"),
    ("staude", ["theta0", "phi0"], {"near": 1.0}, "family.near = 1.0: must be a table with one of theta0, phi0"),
    ("conical", ["n"], {"near": "8.5 *"}, "family.near = '8.5 *': not an expression"),
    ("rest", ["theta0"], {"near": 30}, "family.near = 30: in rad, at most a turn; of degrees give '30 * deg'"),
    ("rest", ["theta0"], {"near": {"theta0": 180}}, "family.near.theta0 = 180: in rad, at most a turn; of degrees give '180 * deg'"),
    ("conical", ["n"], {"root": 1}, "family.root: unknown key; allowed: name, solve, branch, near"),
]  # fmt: skip


@pytest.mark.parametrize(("name", "solve", "choice", "sentence"), WRONG)
def test_wrong_choices_are_refused(name, solve, choice, sentence):
    with pytest.raises(BadInput) as error:
        scene_of("fixed_point", {}, name, solve, "Mg", (1.0,), **choice)
    assert sentence in str(error.value)
