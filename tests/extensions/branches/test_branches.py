"""Branches of equilibria against a parameter: folds and pitchforks against verified ones and closed forms."""

import json

import numpy as np
import pytest
import xarray as xr
from refusals import assert_refused
from strategies import default_points
from truth import REFERENCE

import atlas
from atlas.flags import BifurcationKind, Completeness
from atlas.systems.fixed_point.system import FIXED_POINT
from atlas.systems.satellite import SATELLITE

ORACLE = json.loads((REFERENCE / "branches.json").read_text())
BODY = {"A": 1.0, "B": 1.3, "C": 1.7}
FOLD, PITCHFORK, EXCHANGE = BifurcationKind.FOLD, BifurcationKind.PITCHFORK, BifurcationKind.EXCHANGE


def counts_beside(ds, along, values):
    """Numbers of equilibria of bodies just below and just above values, and of minima of the amended potential, (values, 2)."""
    body = {name: float(ds[name]) for name in ds.coords if name != along and ds[name].ndim == 0}
    sides = xr.DataArray(np.array(values)[:, None] + [-1e-4, 1e-4], dims=("value", "side"))
    both = atlas.equilibria(ds.attrs["atlas_system"], body | {along: sides})
    return both.equilibrium_count.values.tolist(), both.equilibrium_energy_stable_count.values.tolist()


def check_consistent(ds, along, characteristic):
    """Indices sum up, a branch keeps its index between its bifurcations, and all solutions are on a branch."""
    np.testing.assert_array_equal(ds.index_sum, characteristic)
    assert (ds.fold_error < 1e-12).all()
    assert (ds.fold_kind != BifurcationKind.UNRESOLVED).all()
    values = ds[along].values
    for branch, index in enumerate(ds["index"].values):
        where = np.flatnonzero(index >= 0)
        if not where.size:  # the branch exists between two values alone
            continue
        assert (np.diff(where) == 1).all()
        own = (ds.fold_branch == branch).any("meeting").values
        changes = values[where[:-1]][np.diff(index[where]) != 0]
        inside = ds[f"fold_{along}"].values[own & (ds.fold_kind != FOLD).values]
        following = values[np.minimum(np.searchsorted(values, changes) + 1, values.size - 1)]
        assert all(
            ((inside >= low) & (inside <= high)).any() for low, high in zip(changes, following, strict=True)
        )
        assert own.sum() >= (where[0] > 0) + (where[-1] < values.size - 1)


@pytest.mark.long
@pytest.mark.parametrize("case", ORACLE["satellite"], ids=lambda case: f"A={case['A']}")
def test_verified_folds_of_satellites(case):
    body = {name: float(case[name]) for name in ("A", "B", "C", "k2", "k3", "Omega")}
    ds = atlas.branches("satellite", body, along={"k1": np.linspace(*case["range_of_k1"], 12)})
    check_consistent(ds, "k1", 0)
    assert ds.equilibrium_count.values[[0, -1]].tolist() == case["count_at_ends"]
    expected = [(float(fold["k1"]), sign) for fold in case["folds"] for sign in (1, -1)]  # alpha -> -alpha
    assert (ds.fold_kind == FOLD).all()
    np.testing.assert_allclose(ds.fold_k1, [value for value, _ in expected], rtol=0, atol=1e-12)
    for fold in case["folds"]:
        near = ds.isel(fold=np.flatnonzero(np.abs(ds.fold_k1 - float(fold["k1"])) < 1e-9))
        alpha = np.array(fold["alpha"], float)
        distance = np.abs(near.fold_alpha - alpha).max("body_axis")
        assert float(distance.min()) < 1e-7
        assert float(np.abs(near.fold_gamma - np.array(fold["gamma"], float)).max("body_axis").min()) < 1e-7
    counts, minima = counts_beside(ds, "k1", [float(fold["k1"]) for fold in case["folds"]])
    assert counts == [fold["count_below_above"] for fold in case["folds"]]
    assert minima == [fold["minima_below_above"] for fold in case["folds"]]


@pytest.mark.usual("A=1, l1=0")
@pytest.mark.parametrize("case", ORACLE["fixed_point"], ids=lambda case: f"A={case['A']}, l1={case['l'][0]}")
def test_verified_folds_of_permanent_rotations(case):
    body = {name: float(case[name]) for name in ("A", "B", "C", "N")} | {"Mg": 1.0}
    body |= dict(zip(("l1", "l2", "l3", "x0", "y0", "z0"), map(float, case["l"] + case["Mg_r"]), strict=True))
    ds = atlas.branches("fixed_point", body, along={"n": np.linspace(*map(float, case["range_of_n"]), 12)})
    check_consistent(ds, "n", 2)
    np.testing.assert_allclose(ds.fold_n, [float(fold["n"]) for fold in case["folds"]], rtol=0, atol=1e-12)
    assert (ds.fold_kind == FOLD).all()
    vertical = np.array([fold["vertical"] for fold in case["folds"]], float)
    np.testing.assert_allclose(ds.fold_gamma, vertical, rtol=0, atol=1e-7)
    counts = counts_beside(ds, "n", [float(fold["n"]) for fold in case["folds"]])[0]
    assert counts == [[fold["count_below"], fold["count_above"]] for fold in case["folds"]]


@pytest.mark.long
def test_folds_between_two_values():
    """A window of two more minima, of which the numbers of equilibria at the values given tell nothing."""
    ds = atlas.branches("satellite", BODY | {"k2": 0.02, "k3": 0.05}, along={"k1": [0.9, 1.2, 1.5]})
    assert ds.equilibrium_count.values.tolist() == [12, 12, 12]
    folds = [float(fold["k1"]) for fold in ORACLE["satellite"][0]["folds"][3:5]]
    np.testing.assert_allclose(ds.fold_k1, np.repeat(folds, 2), rtol=1e-12)


ROTOR, TOP = BODY | {"k2": 0.02, "k3": 0.05}, BODY | {"Mg": 1.0, "x0": 0.3, "y0": 0.2, "z0": 0.5}
LAST = [
    float(ORACLE[system][0]["folds"][-1][name])
    for system, name in (("satellite", "k1"), ("fixed_point", "n"))
]


@pytest.mark.usual("satellite-body3", "fixed_point")
@pytest.mark.parametrize(
    ("system", "body", "tie", "edge", "kind"),
    [  # solutions exist on one side of a bifurcation, which a parabola passes between two of eight values of e
        ("satellite", ROTOR, "k1 = 2.5 + 1.5 * e**2", np.sqrt((LAST[0] - 2.5) / 1.5), FOLD),
        ("satellite", ROTOR, "k1 = 2.5177 + 1.5 * e**2", np.sqrt((LAST[0] - 2.5177) / 1.5), FOLD),
        ("fixed_point", TOP, "n = 1.593 - 0.6 * e**2", np.sqrt((1.593 - LAST[1]) / 0.6), FOLD),
        ("satellite", BODY | {"B": 1.0}, "k3 = 0.69 + 0.8 * e**2", np.sqrt(0.01 / 0.8), PITCHFORK),
    ],
)  # fmt: skip
def test_closed_lines_between_two_values(system, body, tie, edge, kind):
    """Isolas, and a pair of pitchforks of one branch: the equilibria at the values given are those without them."""
    name, formula = tie.split(" = ")
    ds = atlas.branches(system, body, along={"e": np.linspace(-1, 1, 8)}, ties={name: formula})
    inside = np.abs(ds.fold_e.values) < 0.14  # the values on both sides are +-1/7
    np.testing.assert_allclose(np.abs(ds.fold_e.values[inside]), edge, rtol=1e-9)
    assert inside.sum() >= 2
    assert (ds.fold_kind.values[inside] == kind).all()
    assert ds.equilibrium_count.values[3] == ds.equilibrium_count.values[4]
    lines = np.unique(ds.fold_branch.values[inside])
    between = np.isin(lines, np.flatnonzero((ds["index"] < 0).all("e").values))
    assert between.sum() == (inside.sum() if kind == FOLD else 2)


@pytest.mark.parametrize("N", [-1.0, 4.0])
def test_folds_move_with_the_newtonian_field_by_a_law(N):
    """Without a rotor n_fold^2 = N +- n_fold(0)^2, as far as that is positive."""
    heavy = BODY | {"Mg": 1.0, "x0": 0.3, "y0": 0.2, "z0": 0.5}
    squares = np.array([float(fold["n"]) for fold in ORACLE["fixed_point"][0]["folds"]]) ** 2
    expected = np.concatenate([N + squares[:2], N - squares[:2]])
    ds = atlas.branches("fixed_point", heavy | {"N": N}, along={"n": np.linspace(0.013, 3.1, 12)})
    np.testing.assert_allclose(ds.fold_n, np.sqrt(np.sort(expected[expected > 0])), rtol=1e-12)


def test_staudes_cone():
    """Without rotor gamma, I gamma and the centre of mass are coplanar, whatever the rate and the Newtonian field."""
    centre = np.array([0.3, 0.2, 0.5])
    body = BODY | dict(zip(("x0", "y0", "z0"), centre, strict=True)) | {"Mg": 1.0, "N": 0.7}
    ds = atlas.branches("fixed_point", body, along={"n": np.tan(np.linspace(-1.5, 1.5, 31))})
    gamma = ds.gamma.values[ds["index"].values >= 0]
    inertia = np.array([1.0, 1.3, 1.7])
    cone = np.linalg.det(np.stack([gamma, inertia * gamma, np.broadcast_to(centre, gamma.shape)], 1))
    assert len(gamma) > 100
    assert np.abs(cone).max() < 1e-12
    # Far from rest the axes are the principal ones.
    ends = ds.gamma.isel(n=[0, -1]).values
    assert np.nanmax(np.sort(np.abs(ends), -1)[..., 1]) < 0.05


@pytest.mark.long
def test_pitchforks_of_a_rotor_along_an_axis():
    """Gutnik & Sarychev's counts 24, 20, 16, 12, 8: alpha = +-e1, +-e2 lean off the normal where |k3| < C - B, C - A, and
    beta where |k3| < 4 (C - B), 4 (C - A). At k3^2 = 4 (C - A) (C - B) lines of equilibria join two of these families."""
    ds = atlas.branches("satellite", BODY, along={"k3": np.linspace(0.05, 3.01, 25)})
    check_consistent(ds, "k3", 0)
    pitchforks = ds.fold_k3.values[ds.fold_kind == PITCHFORK]
    np.testing.assert_allclose(pitchforks, np.repeat([0.4, 0.7, 1.6, 2.8], 2), rtol=1e-12)
    np.testing.assert_allclose(ds.fold_k3.values[ds.fold_kind == EXCHANGE], np.sqrt(1.12), rtol=1e-12)
    assert (np.isin(ds.fold_kind, (PITCHFORK, EXCHANGE))).all()
    counts = ds.equilibrium_count.sel(k3=[0.1, 0.5, 1.2, 2.0, 3.0], method="nearest")
    assert counts.values.tolist() == [24, 20, 16, 12, 8]
    assert ((ds.fold_branch >= 0).sum("meeting") == np.where(ds.fold_kind == PITCHFORK, 3, 1)).all()


@pytest.mark.long
def test_pitchforks_of_a_rotor_across_an_axis_over_a_wide_range():
    """Branches leave these pitchforks so steeply that Newton's method from beside them has to be told from one that ends."""
    values = np.geomspace(0.01, 30.0, 20)
    ds = atlas.branches("satellite", BODY | {"k1": 0.05, "k3": 0.3}, along={"Omega": values})
    check_consistent(ds, "Omega", 0)
    assert ((ds.fold_branch >= 0).sum("meeting") == np.where(ds.fold_kind == PITCHFORK, 3, 2)).all()
    assert (ds.fold_kind == PITCHFORK).sum() == 8


def test_circles_of_equilibria_of_a_symmetric_satellite():
    """The third axis leaves the normal at k3 = C - A towards the radius and at 4 (C - A) towards the velocity."""
    ds = atlas.branches("satellite", {"A": 1.0, "B": 1.0, "C": 1.4}, along={"k3": np.linspace(-3, 3, 40)})
    check_consistent(ds, "k3", 2)
    assert (ds.completeness == Completeness.NOT_ISOLATED).all()
    np.testing.assert_allclose(ds.fold_k3, [-1.6, -0.4, 0.4, 1.6], rtol=1e-12)
    assert (ds.fold_kind == PITCHFORK).all()


def test_sleeping_top_leaves_the_vertical():
    """Circles of conical rotations end at the vertical where (C - A) n^2 = l3 n + Mg z0, for gamma = -e3."""
    top = {"A": 1.0, "B": 1.0, "C": 1.4, "Mg": 1.0, "z0": 0.5, "l3": 0.3}
    ds = atlas.branches("fixed_point", top, along={"n": np.linspace(-3, 3, 41)})
    np.testing.assert_allclose(ds.fold_n, np.sort(np.roots([0.4, -0.3, -0.5])), rtol=1e-12)
    assert (ds.fold_kind == PITCHFORK).all()
    np.testing.assert_allclose(ds.fold_theta0, np.pi, atol=1e-7)


def random_families(count):
    """Bodies of three different moments with rotor, magnet or weight, a parameter and its range."""
    rng = np.random.default_rng(7)
    for i in range(count):
        parts, size = rng.uniform(0.05, 1.0, 3), 10 ** rng.uniform(-2, 0.5)
        body = dict(zip("ABC", parts.sum() - parts, strict=True))
        if i % 3 < 2:
            names = ("k1", "k2", "k3") + ("mu1", "mu2", "mu3", "h1", "h3") * (i % 3)
            body |= dict(zip(names, size * rng.normal(size=len(names)), strict=True))
            yield "satellite", body, ("k1", "h3")[i % 3], (-2.013, 2.0)
        else:
            names = ("l1", "l2", "l3", "x0", "y0", "z0", "N")
            body |= dict(zip(names, size * rng.normal(size=7), strict=True)) | {"Mg": 1.0, "n": 1.0}
            yield "fixed_point", body, "l2", (-5.03, 5.0)


@pytest.mark.usual("fixed_point")
@pytest.mark.parametrize("family", list(random_families(3)), ids=lambda family: family[0])
def test_no_branch_of_a_random_body_is_lost(family):
    system, body, along, limits = family
    values = np.linspace(*limits, 8)
    body.pop(along, None)
    ds = atlas.branches(system, body, along={along: values})
    check_consistent(ds, along, 0 if system == "satellite" else 2)
    expected = atlas.equilibria(system, body | {along: xr.DataArray(values, dims=along)})
    np.testing.assert_array_equal(ds.equilibrium_count, expected.equilibrium_count)


def test_ties_and_files(tmp_path):
    ds = atlas.branches(
        "satellite", {"k3": 0.01}, along={"e": [0.2, 0.3]}, ties={"B": "1 + e", "C": "1 + 2 * e"}
    )
    assert ds.e.attrs["long_name"] == "e"
    np.testing.assert_allclose(ds.B, 1 + ds.e)
    ds.to_netcdf(tmp_path / "branches.nc")
    with xr.open_dataset(tmp_path / "branches.nc") as read:
        xr.testing.assert_identical(read.load(), ds)


def test_values_without_a_possible_body_cut_branches():
    ds = atlas.branches("satellite", {"A": 1.0, "B": 1.3, "k3": 0.1}, along={"C": [1.7, 2.2, 2.4, 2.6]})
    assert ds.completeness.values.tolist() == [
        0,
        0,
        Completeness.IMPOSSIBLE_BODY,
        Completeness.IMPOSSIBLE_BODY,
    ]
    assert ds.equilibrium_count.values.tolist() == [24, 24, 0, 0]


@pytest.mark.parametrize(
    ("body", "along", "sentence"),
    [
        (
            {"mass": 1.0},
            {"k1": [0.0, 1.0]},
            "fixed.mass: not a parameter of the satellite, and no tie uses it; allowed: ...",
        ),
        (
            {},
            {"k1": [0.0]},
            "branches: needs an axis on which two values or more have a body that is possible",
        ),
        (
            {},
            {"k1": np.ma.array([0.0, 1.0], mask=[0, 1])},
            "point 1 (counted from 0): axes.k1.values is masked or was never written; must be a finite number",
        ),
        ({}, {"k1": [0.0, 1.0], "k2": [0.0, 1.0]}, "branches: needs one axis, found k1, k2"),
        (
            {},
            {"theta0": [0.0, 1.0]},
            "branches: theta0 changes no equilibria; take a parameter of body or field",
        ),
        (
            {"A": 5.0},
            {"k1": [0.0, 1.0]},
            "B + C = 2.2 is less than A = 5: no rigid body has these moments of inertia, and none of 2 points is possible",
        ),
        (
            {"A": 1.0, "B": 1.3, "C": 1.7},
            {"k3": [0.7, 1.6, 2.8]},
            "branches: each of these values of k3 is a bifurcation, or its equilibria are not isolated; add values between them",
        ),
    ],
)
def test_input_without_branches(body, along, sentence):
    assert_refused(lambda: atlas.branches("satellite", body, along=along), sentence)


def test_symmetric_satellites_have_the_equilibria_of_a_search():
    """The circles from the secular equation, against Newton's method from many orientations, about every axis."""
    rng = np.random.default_rng(3)
    for i in range(3):
        across = [name for j, name in enumerate("ABC") if j != i]
        body = {across[0]: 1.0, across[1]: 1.0, "ABC"[i]: 1.5, "h1": 0.4, "h3": 0.6}
        body |= {f"k{i + 1}": rng.normal(), f"mu{i + 1}": rng.normal()}
        one = SATELLITE.equilibria(body)
        many = SATELLITE.equilibria_of_bodies(default_points("satellite", 1, **body))
        count = one["index"].size
        assert (many["index"][0] >= 0).sum() == count
        np.testing.assert_allclose(many["potential"][0, :count], one["potential"], rtol=0, atol=1e-12)
        for name in ("index", "circle", "stable"):
            np.testing.assert_array_equal(many[name][0, :count], one[name])
        np.testing.assert_allclose(np.abs(many["axis"][0, :count]), np.abs(one["axis"]), rtol=0, atol=1e-7)


def test_permanent_rotations_with_evenly_spaced_moments():
    """The middle pole has no residue here and lies halfway between the others: no root beside it is missed."""
    body = {"A": 1.0, "B": 1.2, "C": 1.4, "Mg": 1.0, "x0": 0.1, "z0": 0.5, "l1": 0.2, "n": 1.5}
    N = np.linspace(-1.2, -1.0, 9)
    counts = atlas.equilibria("fixed_point", body | {"N": N}).equilibrium_count
    assert (counts == 6).all()
    assert FIXED_POINT.equilibria(body | {"N": -1.05})["index"].size == 6


def test_numbers_at_a_bifurcation_are_nan():
    ds = atlas.branches("satellite", BODY, along={"k3": [0.39, 0.4, 0.41]})
    assert ds.completeness.values.tolist() == [0, Completeness.NEAR_BIFURCATION, 0]
    np.testing.assert_array_equal(ds.equilibrium_count, [24, np.nan, 20])
    np.testing.assert_array_equal(ds.index_sum, [0, np.nan, 0])
    assert ((ds["index"] >= 0).sum("branch") >= 20).all()


@pytest.mark.parametrize("difference", [1e-12, -3e-11, 2e-9, 1e-5])
def test_permanent_rotations_beside_a_symmetry(difference):
    """Index and stability of the tilted axes into which each circle of the symmetric top splits."""
    top = {"A": 1.0, "B": 1.0 + difference, "C": 1.4, "Mg": 1.0, "z0": 0.2, "n": 1.3}
    one, many = atlas.equilibria("fixed_point", top), atlas.equilibria("fixed_point", top | {"n": [1.3]})
    assert many.equilibrium_count == one.sizes["equilibrium"] == 6
    assert not one.circle.any()
    assert ((-1) ** one["index"].astype(int)).sum() == 2
    tilted = np.abs(np.sin(one.theta0.values)) > 0.1
    first, second = (np.abs(one.gamma.values[tilted, i]) > 0.1 for i in (0, 1))
    index = one["index"].values[tilted]
    larger = first if difference < 0 else second
    assert (index[larger] == index[~larger] - 1).all()
    assert (first != second).all()


@pytest.mark.usual("2-B")
@pytest.mark.parametrize(("axis", "moment"), [(1, "A"), (2, "B"), (3, "C")])
def test_drag_along_an_axis_loses_its_equilibria_in_closed_form(axis, moment):
    """8 rest with this axis along the velocity; 4 more each while |drag| < |difference to another moment|, Omega = 1, and 3 times it.

    They turn about another axis, which is along the normal or the radius. About the axis of the middle moment two of these families
    exchange their index at drag^2 = 3 (B - A) (C - B), where a line of equilibria joins them.
    """
    moments = {"A": 1.0, "B": 1.3, "C": 1.7}
    differences = [abs(moments[moment] - other) for name, other in moments.items() if name != moment]
    folds = np.sort([factor * difference for factor in (1, 3) for difference in differences])
    name = f"drag{axis}"
    ds = atlas.branches("satellite", moments, along={name: np.linspace(0.031, 3.017, 14)})
    exchange = [np.sqrt(3 * 0.3 * 0.4)] if moment == "B" else []
    values = np.unique(np.round([*folds, *exchange], 9))
    np.testing.assert_allclose(np.unique(np.round(ds[f"fold_{name}"], 9)), values, rtol=1e-9)
    expected = 8 + 4 * (ds[name].values[:, None] < folds).sum(1)
    np.testing.assert_array_equal(ds.equilibrium_count, expected)


@pytest.mark.long
def test_no_branch_of_a_body_with_all_torques_is_lost():
    body = {"A": 1.0, "B": 1.3, "C": 1.7, "k1": 0.1, "mu2": 0.3, "h1": 0.2, "drag1": 0.2, "drag3": 0.3}
    values = np.linspace(-1.01, 1.1, 8)
    ds = atlas.branches("satellite", body, along={"drag2": values})
    check_consistent(ds, "drag2", 0)
    expected = atlas.equilibria("satellite", body | {"drag2": xr.DataArray(values, dims="drag2")})
    np.testing.assert_array_equal(ds.equilibrium_count, expected.equilibrium_count)
