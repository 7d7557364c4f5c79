"""Borders of equilibria as curves, against verified folds, pitchforks and cusps, closed forms and numbers of equilibria."""

import json
from itertools import pairwise

import numpy as np
import pandas as pd
import pytest
from refusals import assert_refused
from truth import REFERENCE, jacobian_matrices

import atlas
from atlas import systems
from atlas.cli import main
from atlas.extensions.branches.borders import BorderKind, SpecialKind
from atlas.extensions.branches.starts import Cell

CASES = json.loads((REFERENCE / "fold_curves.json").read_text())["cases"]


def crossings(ds, name, value, other, change_of="count_change"):
    """Values of the other parameter where curves cross name = value, their kinds, and solutions to their left, seen towards larger `name`."""
    cuts = []
    for curve in np.unique(ds.curve):
        line = ds.isel(vertex=np.flatnonzero(ds.curve.values == curve))
        p, q, s = line[name].values - value, line[other].values, line.arc.values
        slopes = [line[f"tangent_{each}"].values for each in (name, other)]
        for k in np.flatnonzero(p[:-1] * p[1:] < 0):
            h = s[k + 1] - s[k]

            def cubic(w, values, slope, k=k, h=h):
                ends = (1 + 2 * w) * (1 - w) ** 2 * values[k] + w**2 * (3 - 2 * w) * values[k + 1]
                return ends + h * (w * (1 - w) ** 2 * slope[k] - w**2 * (1 - w) * slope[k + 1])

            low, high = 0.0, 1.0
            for _ in range(60):
                middle = 0.5 * (low + high)
                same = cubic(middle, p, slopes[0]) * p[k] > 0
                low, high = (middle, high) if same else (low, middle)
            change = np.sign(p[k + 1] - p[k]) * float(line[change_of][k])
            cuts.append((cubic(low, q, slopes[1]), int(line.kind[0]), change))
    return sorted(cuts)


@pytest.mark.usual("fixed_point, general, rotor1", "fixed_point, A = B, rotor (closed form: astroid)")
@pytest.mark.parametrize("case", CASES, ids=lambda case: f"{case['system']}, {case['kind']}")
def test_verified_borders(case):
    """Every fold, pitchfork and cusp of the list and no other, at the accuracy of the cubics between vertices."""
    first, second = case["parameters"]
    body = {name: value for name, value in case["body"].items() if name not in case["parameters"]}
    box = case["cusp_range"]
    ds = atlas.borders(case["system"], body, box)
    assert (ds.cells == Cell.COUNTED).all()
    assert float(ds.residual.max()) < 1e-10
    spans = {name: high - low for name, (low, high) in box.items()}
    for line in case["lines"]:
        ((name, value),) = line["fixed"].items()
        other = line["vary"]
        low, high = line["range"]
        cuts = [each for each in crossings(ds, name, value, other) if low < each[0] < high]
        values = np.array([each[0] for each in cuts])
        expected = np.array([float(fold[0]) for fold in line["folds"]])
        kinds = [BorderKind[fold[1].upper()] for fold in line["folds"]]
        nearest = np.abs(values[:, None] - expected).argmin(1) if len(values) else np.zeros(0, int)
        np.testing.assert_allclose(values, expected[nearest], rtol=0, atol=1e-6 * spans[other])
        assert [each[1] for each in cuts] == [kinds[i] for i in nearest]
        assert set(nearest) == set(range(len(expected)))
        # Towards larger values of `first` the left side has the larger values of `second`.
        way = 1 if name == first else -1
        for i, fold in enumerate(line["folds"]):
            change = sum(way * each[2] for each, own in zip(cuts, nearest, strict=True) if own == i)
            assert change == fold[2][1] - fold[2][0]
    cusps = ds.isel(special=np.flatnonzero(ds.special_kind.values == SpecialKind.CUSP))
    points = np.stack([cusps[f"special_{name}"] for name in (first, second)], -1)
    expected = np.array(case["cusps"], float)
    distance = np.abs(points[:, None] - expected).max(-1)
    assert max(distance.min(0).max(), distance.min(1).max()) < 1e-12


DRAGGED = {
    "general": (
        {"A": 1.0, "B": 1.3, "C": 1.7, "drag3": 0.2, "k1": 0.1},
        {"drag1": (-1.0, 1.2), "drag2": (-1.0, 1.1)},
    ),
    "with a magnet": (
        {"A": 1.0, "B": 1.3, "C": 1.7, "drag3": 0.2, "mu1": 0.3, "mu2": 0.2, "h1": 0.5, "h3": 0.4},
        {"drag1": (-1.0, 1.2), "k3": (-1.0, 1.1)},
    ),
    "symmetric": (
        {"A": 1.0, "B": 1.0, "C": 0.6, "mu3": 0.3, "h1": 0.4},
        {"drag3": (-0.9, 2.0), "k3": (-1.0, 1.1)},
    ),
}


@pytest.mark.usual("symmetric")
@pytest.mark.parametrize("case", DRAGGED)
def test_borders_with_drag_explain_the_numbers_of_equilibria(case):
    """In every cell, and at the ends of random lines across the curves."""
    body, box = DRAGGED[case]
    ds = atlas.borders("satellite", body, box)
    assert (ds.cells == Cell.COUNTED).all()
    assert float(ds.residual.max()) < 1e-10
    (first, (low, high)), (second, (bottom, top)) = box.items()
    for value in np.random.default_rng(1).uniform(low, high, 2):
        cuts = crossings(ds, first, value, second)
        ends = np.array([bottom, *(cut[0] for cut in cuts), top])
        middles = 0.5 * (ends[1:] + ends[:-1])[np.diff(ends) > 1e-4]
        rest = atlas.equilibria("satellite", body | {first: np.full(middles.size, value), second: middles})
        counted = (rest["index"].values >= 0).sum(1)
        changes = np.cumsum([0.0, *(cut[2] for cut in cuts)])[np.diff(ends) > 1e-4]
        np.testing.assert_array_equal(counted - counted[0], changes - changes[0])


@pytest.mark.long
@pytest.mark.parametrize("case", ["symmetric"])
def test_limits_of_stability_with_drag_explain_the_numbers_of_stable_equilibria(case):
    ds = atlas.borders("satellite", *DRAGGED[case], stability=True)
    assert (ds.cells == Cell.COUNTED).all()
    assert (ds.kind >= BorderKind.LIMIT_OF_STABILITY).any()


@pytest.mark.long
def test_sides_change_where_pitchforks_cross():
    """A rotor in a principal plane: beside each segment near k2 = 0 the numbers of equilibria differ by its count_change."""
    body = {"A": 1.443, "B": 1.108, "C": 0.502, "k1": 0.0}
    ds = atlas.borders("satellite", body, {"k2": (-4.2, 4.2), "k3": (-4.2, 4.2)})
    at = np.stack([ds.k2, ds.k3], -1)
    same = np.diff(ds.curve) == 0
    begin = np.flatnonzero(same & (abs(at[1:, 0]) < 0.08) & (abs(at[1:, 1] - 1.5) < 0.12))
    slope = np.stack([ds.tangent_k2, ds.tangent_k3], -1)
    chord, arc = at[begin + 1] - at[begin], np.diff(ds.arc)[begin, None]
    middle = 0.5 * (at[begin + 1] + at[begin]) + 0.125 * arc * (slope[begin] - slope[begin + 1])
    normal = np.stack([-chord[:, 1], chord[:, 0]], -1) / np.linalg.norm(chord, axis=1)[:, None]
    bodies = np.concatenate([middle + 1e-4 * normal, middle - 1e-4 * normal])
    rest = atlas.equilibria("satellite", body | dict(zip(("k2", "k3"), bodies.T, strict=True)))
    change = ds.count_change.values[begin]
    assert set(change) == {-4, 4}
    for index in range(4):
        left, right = (rest.index.values == index).sum(1).reshape(2, -1)
        own = (index == ds.index_below.values[begin]) | (index == ds.index_above.values[begin])
        np.testing.assert_array_equal(left - right, np.where(own, change // 2, 0))


@pytest.mark.parametrize(
    ("body", "ranges", "sentence"),
    [
        ({}, {"k1": [0, 1]}, "borders: needs two parameters with a range each, found k1"),
        ({}, {"k1": [0, 1], "k2": [1, 1]}, "ranges.k2 = [1, 1]: must be a lowest and a higher value"),
        ({}, {"k1": [0, 1], "k2": [1]}, "ranges.k2 = [1]: must be a lowest and a higher value"),
        ({}, {"k1": [0, 1], "mass": [0, 1]}, "axes.mass: ..."),
        ({"mass": 1}, {"k1": [0, 1], "k2": [0, 1]}, "fixed.mass: not a parameter of the satellite, ..."),
        ({}, {"k1": [0, 1], "theta0": [0, 1]}, "borders: theta0 changes no equilibria; take a parameter of body or field"),
        ({"damping": 0.1}, {"k1": [0, 1], "k2": [0, 1]}, "borders: damping = 0.1; the body has to be without damping"),
        ({"A": 5.0}, {"k1": [0, 1], "k2": [0, 1]}, "B + C = 2.2 is less than A = 5: no rigid body has these moments of inertia..."),
        ({"Omega": 0.0}, {"k1": [0, 1], "k2": [0, 1]}, "borders: without orbit and field these bodies rest in any orientation"),
    ],
)  # fmt: skip
def test_input_without_borders(body, ranges, sentence):
    assert_refused(lambda: atlas.borders("satellite", body, ranges), sentence)


SCENE = """
schema = 1
title = "rotor"
system = "satellite"
fixed = { A = 1.0, B = 1.3, C = 1.7, k3 = 0.05 }
axes.k1 = { values = [0.9, 1.3] }
axes.k2 = { values = [-0.1, 0.1] }
integration = { duration = 0.1 }
"""


def test_figures_and_tables(tmp_path):
    """Figures are cubics, and tables have every vertex."""
    body = {"A": 1.0, "B": 1.3, "C": 1.7, "k3": 0.05}
    ds = atlas.borders("satellite", body, {"k1": (0.9, 1.3), "k2": (-0.1, 0.1)})
    figure = ds.atlas.diagram()
    figure.savefig(tmp_path / "borders.svg")
    curves = [line for line in (tmp_path / "borders.svg").read_text().splitlines() if line.startswith("C ")]
    assert len(curves) > 0.9 * ds.sizes["vertex"]
    assert [text.get_text() for text in figure.legends[0].get_texts()] == ["a minimum ends", "cusp"]
    (tmp_path / "rotor.toml").write_text(SCENE)
    assert (
        main(["branches", str(tmp_path / "rotor.toml"), "--borders", "-o", str(tmp_path / "rotor.csv")]) == 0
    )
    table = pd.read_csv(tmp_path / "rotor.csv")
    np.testing.assert_allclose(table.k2, ds.k2, rtol=0, atol=1e-12)
    np.testing.assert_allclose(table.gamma_2, ds.gamma[:, 1], rtol=0, atol=1e-12)


@pytest.mark.long
def test_curves_end_on_the_sides_of_the_ranges():
    """Also where a step along the tangent stays inside and the curve does not."""
    body = {"A": 1.352, "B": 1.445, "C": 0.956, "k2": -0.22180597552426218, "h1": 0.559637412812156, "h3": 0.7869113652768456,
            "mu1": -0.42619257491935897, "mu2": 0.4219967358948798, "mu3": -0.06699111954668029}  # fmt: skip
    side = 2.20316247973306
    ds = atlas.borders("satellite", body, {"k1": (-side, side), "k3": (-side, side)})
    assert (ds.cells == Cell.COUNTED).all()
    at = np.stack([ds.k1, ds.k3], -1)
    change = np.diff(ds.curve.values) != 0
    first, last = at[np.r_[True, change]], at[np.r_[change, True]]
    on_side = [np.abs(np.abs(end).max(1) - side) < 1e-12 for end in (first, last)]
    closed = np.abs(first - last).max(1) < 1e-12
    np.testing.assert_array_equal(on_side, [~closed, ~closed])
    assert 0 < closed.sum() < closed.size


@pytest.mark.long
def test_a_body_without_symmetry_has_folds_alone():
    """Also over wide ranges, in which the magnet is so weak that folds look like pitchforks from afar."""
    body = {"A": 1.05, "B": 1.638, "C": 1.197, "k3": -0.09892719176930284, "h1": -1.5399972735490655, "h3": -0.2222643644,
            "mu1": 0.010414919842403335, "mu2": 0.027175547610085154, "mu3": -0.3087054833900708}  # fmt: skip
    side = 10.579040020948021
    ds = atlas.borders("satellite", body, {"k1": (-side, side), "k2": (-side, side)})
    assert (ds.cells == Cell.COUNTED).all()
    assert (ds.kind == BorderKind.FOLD).all()


@pytest.mark.long
@pytest.mark.parametrize(
    ("body", "ranges", "name", "value", "other", "total"),
    [  # complex solutions alone lead to one curve of the former, and points beyond the ranges to one of the latter
        ({"A": 1.922, "B": 0.829, "C": 1.971, "k1": 0.5537536068166906, "k2": -0.3977839282871051},
         {"Omega": (0.3, 2.0), "k3": (-20.56655983171697, 20.56655983171697)}, "Omega", 1.9, "k3", 4),
        ({"A": 0.619, "B": 1.385, "k1": -0.4254231697308194, "k3": 0.10201631971735522},
         {"C": (0.6, 1.9), "k2": (-5.902814263865798, 5.902814263865798)}, "C", 1.874, "k2", 8),
    ],
)  # fmt: skip
def test_curves_between_the_corners_of_the_coarse_grid(body, ranges, name, value, other, total):
    """On a line across them the numbers of equilibria between the curves differ as these say."""
    cuts = crossings(atlas.borders("satellite", body, ranges), name, value, other)
    assert len(cuts) == total
    ends = [0.99 * end for end in ranges[other]]
    middles = np.array([ends[0], *(0.5 * (a[0] + b[0]) for a, b in pairwise(cuts)), ends[1]])
    rest = atlas.equilibria("satellite", body | {name: np.full(middles.size, value), other: middles})
    numbers = (rest.index >= 0).sum("equilibrium").values
    np.testing.assert_array_equal(np.diff(numbers), [change for *_, change in cuts])


@pytest.mark.long
def test_bodies_that_cannot_exist_cut_borders():
    ds = atlas.borders("satellite", {"A": 1.0, "k1": 0.3, "k3": 0.5}, {"B": (0.5, 1.0), "C": (1.2, 1.8)})
    excess = (1 + ds.B - ds.C).values
    assert excess.min() > -1e-9
    change = np.diff(ds.curve.values) != 0
    ends = excess[np.r_[True, change] | np.r_[change, True]]
    assert (np.abs(ends) < 1e-9).any()


@pytest.mark.usual("satellite")
@pytest.mark.parametrize(
    ("system", "body", "ranges"),
    [
        ("satellite", {"A": 1.0, "B": 1.3, "C": 1.7, "k3": 0.05}, {"k1": (-4.5, -3.0), "k2": (-2.0, -1.0)}),
        ("fixed_point", {"A": 2.0, "B": 1.2, "C": 1.5, "Mg": 1.0, "x0": 0.4, "y0": -0.2, "z0": 0.3, "l1": 0.3, "l2": 0.5, "l3": -0.2},
         {"n": (-3.0, -1.5), "N": (-9.0, 0.0)}),
    ],
)  # fmt: skip
def test_limits_of_stability(system, body, ranges):
    """Solutions beside the curves are linearly stable on one side, and unstable on the other with the same Morse index."""
    ds = atlas.borders(system, body, ranges, stability=True)
    limits = ds.isel(vertex=np.flatnonzero(ds.kind.values == BorderKind.LIMIT_OF_STABILITY))
    assert limits.sizes["vertex"] > 30
    names, spans = list(ranges), np.array([high - low for low, high in ranges.values()])
    limits = limits.isel(vertex=slice(10, -10, 7))
    tangent = np.stack([limits[f"tangent_{name}"] for name in names], -1) / spans
    normal = np.stack([-tangent[:, 1], tangent[:, 0]], -1) / np.linalg.norm(tangent, axis=1)[:, None]
    growth = []
    for side in (-1e-4, 1e-4):
        at = np.stack([limits[name] for name in names], -1) + side * normal * spans
        rest = atlas.equilibria(system, body | dict(zip(names, at.T, strict=True)))
        near = np.abs(rest.gamma - limits.gamma.rename(vertex="point")).max("body_axis").argmin("equilibrium")
        growth.append(rest.growth_rate.isel(equilibrium=near).values)
    growth = np.sort(growth, axis=0)
    assert (growth[0] < 1e-8).mean() > 0.95  # and on the other side it is about the root of the distance
    assert (growth[1] > 1e-4).mean() > 0.9  # but where another exponent is near


@pytest.mark.long
@pytest.mark.parametrize("k3", [0.0, 0.05])
def test_limits_pass_other_exponents(k3):
    """Curves end at the border of the ranges alone, through cusps, at which all three pairs of exponents meet.

    There growth is the cube root of the distance. With k3 = 0 a pair that takes no part passes the others elsewhere.
    """
    body, ranges = {"A": 1.0, "B": 1.3, "C": 1.7, "k3": k3}, {"k1": (-3.1, 3.3), "k2": (0.5, 3.0)}
    ds = atlas.borders("satellite", body, ranges, stability=True)
    assert (ds.cells == Cell.COUNTED).all()
    limits = np.flatnonzero(ds.kind.values == BorderKind.LIMIT_OF_STABILITY)
    first = np.flatnonzero(np.diff(ds.curve.values[limits], prepend=-1))
    for vertex in limits[np.r_[first, first[1:] - 1, -1]]:
        end = {name: float(ds[name][vertex]) for name in ranges}
        assert any(value == pytest.approx(side) for name, value in end.items() for side in ranges[name])
    cusps = ds.isel(special=np.isin(ds.special_curve, ds.curve.values[limits]))
    assert (cusps.special_kind == SpecialKind.CUSP).all()
    assert sorted(np.sign(cusps.special_k1.values)) == [-1, 1]
    gamma, growth = cusps.special_gamma.rename(special="point"), []
    for distance in (1e-9, 1e-6):
        at = {"k1": cusps.special_k1.values * (1 + distance), "k2": cusps.special_k2.values}
        rest = atlas.equilibria("satellite", body | at)
        near = np.abs(rest.gamma - gamma).max("body_axis").argmin("equilibrium")
        growth.append(rest.growth_rate.isel(equilibrium=near).values)
    np.testing.assert_allclose(growth[1] / growth[0], 10, rtol=0.05)


@pytest.mark.long
@pytest.mark.parametrize(
    ("system", "body", "ranges"),
    [
        ("satellite", {"A": 1.0, "B": 1.3, "C": 1.7, "k3": 0.05}, {"k1": (-4.5, 4.5), "k2": (-4.5, 4.5)}),
        ("satellite", {"A": 1.0, "B": 1.3, "C": 1.7}, {"k1": (0.1, 3.3), "k3": (0.1, 3.0)}),
        ("satellite", {"A": 1.0, "k1": 0.3, "k2": 0.2, "k3": 0.5}, {"B": (0.9, 1.4), "C": (1.2, 1.8)}),
        ("fixed_point", {"A": 1.0, "B": 1.3, "C": 1.7, "Mg": 1.0, "x0": 0.3, "y0": 0.2, "z0": 0.5, "l2": 0.1},
         {"n": (0.2, 4.0), "l3": (-2.0, 2.0)}),
        ("fixed_point", {"A": 1.0, "B": 1.3, "C": 1.7, "Mg": 1.0, "z0": 0.5}, {"n": (0.21, 4.0), "l3": (-2.0, 2.0)}),
        ("fixed_point", {"A": 1.2458, "B": 1.0119, "C": 1.0429, "Mg": 1.0, "z0": 0.1593, "l3": 0.3598}, {"n": (0.3, 3.0), "N": (-3.0, 3.0)}),
    ],
)  # fmt: skip
def test_numbers_of_stable_solutions(system, body, ranges):
    """They change across curves, along several lines, as `stable_change` says, and nowhere else."""
    ds, (first, second), seen = atlas.borders(system, body, ranges, stability=True), ranges, 0
    assert (ds.cells == Cell.COUNTED).all()
    low, high = ranges[second]
    for value in ranges[first][0] + np.diff(ranges[first]) * [0.13, 0.28, 0.41, 0.57, 0.71, 0.94]:
        cuts = crossings(ds, first, value, second, "stable_change")
        places = np.array([place for place, _, _ in cuts])
        edges = np.sort(np.r_[low, places, high])
        between = 0.5 * (edges[1:] + edges[:-1])[np.diff(edges) > 1e-4]  # nearer ones count as one
        rest = atlas.equilibria(system, body | {first: value, second: between})
        changes = np.diff((rest.stable == 1).sum("equilibrium"))
        for i, change in enumerate(changes):
            own = (places > between[i]) & (places < between[i + 1])
            assert change == sum(cuts[k][2] for k in np.flatnonzero(own))
        seen += np.count_nonzero(changes)
    assert seen > 5


EQUAL_MOMENTS = [
    ("fixed_point", {"A": 1.0, "C": 1.0, "Mg": 1.0, "z0": -0.55, "N": -0.63, "l3": -0.7}, {"B": (0.9, 1.005), "n": (-2.0, -0.5)}),
    ("fixed_point", {"A": 1.52, "B": 1.0, "C": 1.000000001, "Mg": 1.0, "y0": -0.77, "l2": 0.16}, {"n": (0.3, 3.0), "N": (-3.0, 3.0)}),
    ("fixed_point", {"A": 1.07, "B": 1.0, "C": 1.000001, "Mg": 1.0, "x0": 0.62}, {"l1": (-2.0, 2.0), "n": (0.3, 3.0)}),
    ("satellite", {"A": 1.0, "C": 1.0, "k2": 0.5}, {"k3": (-0.1, 0.7), "B": (1.05, 1.55)}),
    ("satellite", {"A": 1.0, "B": 1.0, "k3": -0.6, "h3": 1.0, "mu2": 0.87}, {"k1": (0.8, 2.0), "C": (0.6, 1.6)}),
    ("satellite", {"A": 1.0, "C": 1.000000000001, "k2": -1.29, "h3": 1.0, "mu3": 1.2}, {"k1": (1.37, 2.0), "B": (0.6, 1.2)}),
]  # fmt: skip


@pytest.mark.long
@pytest.mark.parametrize(("system", "body", "ranges"), EQUAL_MOMENTS)
def test_equal_and_nearly_equal_moments(system, body, ranges):
    """Every vertex and special point is on its curve; along several lines the exponents of the equations of motion say the same, but in marked cells."""
    ds, (first, second) = atlas.borders(system, body, ranges, stability=True), ranges
    assert float(ds.residual.max()) < 1e-9
    for name, (low, high) in ranges.items():
        for values in (ds[name], ds[f"special_{name}"]):
            assert (values >= low).all()
            assert (values <= high).all()
    low, high = ranges[second]
    seen = 0
    for value in ranges[first][0] + np.diff(ranges[first]) * [0.07, 0.19, 0.31, 0.46, 0.61, 0.83]:
        places = [crossings(ds, first, value, second, f"{kind}_change") for kind in ("count", "stable")]
        edges = np.sort(np.r_[low, [place for place, _, _ in places[0]], high])
        between = 0.5 * (edges[1:] + edges[:-1])[np.diff(edges) > 1e-4]  # nearer ones count as one
        numbers = own_numbers(system, body | {first: np.full(between.size, value), second: between})
        for i, changes in enumerate(np.diff(numbers, axis=1).T):
            way = {f"cell_{first}": value, f"cell_{second}": np.linspace(*between[i : i + 2], 20)}
            if (ds.cells.sel(way, method="nearest") == Cell.COUNTED).all():
                for change, cuts in zip(changes, places, strict=True):
                    assert change == sum(cut[2] for cut in cuts if between[i] < cut[0] < between[i + 1])
                seen += changes.any()
    assert seen > 3


@pytest.mark.long
def test_limits_on_both_sides_of_a_plane_of_symmetry():
    """Between corners of the coarse grid that lie beyond both they cancel."""
    top = {"A": 1.001, "B": 1.0, "Mg": 1.0, "y0": -0.74, "l2": 0.65, "N": 0.76, "n": 1.3}
    ds = atlas.borders("fixed_point", top, {"C": (0.92, 1.05), "l1": (-2.0, 2.0)}, stability=True)
    assert (ds.cells == Cell.COUNTED).all()
    ends = np.array([-1.0, -0.15, 0.01, 0.15, 1.0])
    for C in (0.94, 1.03):
        _, stable = assert_explained(ds, "fixed_point", top | {"C": C}, "C", "l1", ends, ["stable"])
        np.testing.assert_array_equal(stable, [2, 1, 2, 1, 2])


def assert_explained(ds, system, body, name, other, ends, kinds=("count", "stable")):
    """On a line name = value the numbers, which are returned, change between values of the other parameter as the curves say."""
    numbers = own_numbers(system, body | {name: np.full(ends.size, body[name]), other: ends})
    for kind, own in zip(("count", "stable"), numbers, strict=True):
        cuts = crossings(ds, name, body[name], other, f"{kind}_change")
        sums = [sum(cut[2] for cut in cuts if low < cut[0] < high) for low, high in pairwise(ends)]
        if kind in kinds:
            np.testing.assert_array_equal(np.diff(own), sums)
    return numbers


@pytest.mark.long
def test_folds_through_a_sphere():
    """At a body with equal moments and no rotor, whose equilibria form a circle, folds change their side and do not turn back."""
    field = {"A": 1.0, "C": 1.0, "h1": 0.5, "h3": 1.0, "mu1": 0.25, "mu2": -0.47, "mu3": -0.47}
    ds = atlas.borders("satellite", field, {"B": (0.9, 1.1), "k1": (-0.02, 0.02)})
    assert (ds.cells == Cell.COUNTED).all()
    ends = np.array([-0.019, -0.013, -0.0087, 0.0, 0.008, 0.0105, 0.0185])
    for B in (0.95, 0.98, 1.02):
        assert_explained(ds, "satellite", field | {"B": B}, "B", "k1", ends, ["count"])
    assert not ds.sizes["special"]


@pytest.mark.long
def test_a_limit_of_stability_ends_twice_on_a_fold():
    """In between one of the two solutions that merge is stable, for 1e-9 of C, though neither is at the vertices beside."""
    body = {"A": 1.000001, "B": 1.0, "h1": 0.5, "h3": 1.0, "mu1": 0.26, "mu2": 0.12, "mu3": 0.44, "k1": 0.05}
    ds = atlas.borders("satellite", body, {"k3": (0.0, 0.5), "C": (0.9, 1.0)}, stability=True)
    assert (ds.cells == Cell.COUNTED).all()
    for k3 in (0.22, 0.2244, 0.2251, 0.2256, 0.23):
        assert_explained(ds, "satellite", body | {"k3": k3}, "k3", "C", np.array([0.952, 0.963]))
    fold = ds.isel(vertex=ds.kind.values == BorderKind.FOLD)
    assert (fold.stable_change != 0).any()


@pytest.mark.long
@pytest.mark.parametrize(
    ("body", "ranges", "values"),
    [
        ({"A": 1.0, "B": 1.0, "C": 0.87}, {"k2": (1.0, 1.4), "k3": (-0.1, 0.1)}, (1.2232, 1.22366, 1.22382, 1.2245)),
        ({"A": 1.53, "B": 1.0, "C": 1.0, "k2": 0.74}, {"k3": (-1.2, -0.2), "k1": (-0.3, 0.3)}, (-0.674, -0.6723, -0.671)),
    ],
)  # fmt: skip
def test_limits_of_stability_cross(body, ranges, values):
    """Beyond the crossing the other side of both has more stable solutions."""
    ds, (first, second) = atlas.borders("satellite", body, ranges, stability=True), ranges
    ends = np.array([-0.009, 0.0, 0.009])
    for value in values:
        _, stable = assert_explained(ds, "satellite", body | {first: value}, first, second, ends)
        np.testing.assert_array_equal(stable, [2, 4, 2])


@pytest.mark.long
def test_directions_of_limits_of_stability_that_cross():
    """Where the equations have two tangents each limit keeps its own: own exponents change within 1e-5 of both lines beside the crossing."""
    body = {"A": 1.0, "B": 1.0, "C": 0.87}
    ds = atlas.borders("satellite", body, {"k2": (1.1, 1.5), "k3": (-0.15, 0.1)}, stability=True)
    for k2 in (1.2235, 1.2241, 1.2243, 1.2246):
        cuts = [cut for cut in crossings(ds, "k2", k2, "k3", "stable_change") if abs(cut[0]) < 2e-3]
        assert len(cuts) == 2
        for k3, _, change in cuts:
            beside = {"k2": np.full(2, k2), "k3": k3 + np.array([-1e-5, 1e-5])}
            _, stable = own_numbers("satellite", body | beside)
            assert np.diff(stable) == change


@pytest.mark.long
def test_limits_of_stability_end_at_pitchforks_once():
    """Also where moments are nearly equal, so that limits there solve their equations to rounding on a piece of 1e-6."""
    body = {"A": 1.001, "B": 1.56, "C": 1.0}
    ds = atlas.borders("satellite", body, {"k2": (0.5, 0.7), "k1": (-0.03, 0.03)}, stability=True)
    for k2 in (0.6, 0.6028458, 0.6028461, 0.60285, 0.604):
        assert_explained(
            ds, "satellite", body | {"k2": k2}, "k2", "k1", np.array([-0.0135, -0.0125, 0.0125, 0.0135])
        )


@pytest.mark.long
def test_lines_of_equilibria_are_no_borders():
    """Where equilibria of one body form a line, to rounding, nothing bifurcates, and curves that lead there are cut."""
    body = {"A": 1.0, "C": 1.000001, "k2": 1.21}
    ds = atlas.borders("satellite", body, {"k3": (-1.0, 0.01), "B": (0.7, 1.001)})
    for k3 in (-0.9, -0.6, -0.35):
        assert_explained(ds, "satellite", body | {"k3": k3}, "k3", "B", np.array([0.9, 1.0005]), ["count"])
    assert not ds.sizes["special"]


@pytest.mark.long
def test_limits_turn_back():
    """At a pitchfork the limits of mirror images are the same line, passed to and fro, with the same side up to its end."""
    top = {"B": 1.001, "C": 1.0, "Mg": 1.0, "z0": -0.5, "l3": -0.47}
    ds = atlas.borders("fixed_point", top, {"A": (0.7, 1.6), "n": (-3.0, -0.3)}, stability=True)
    line = ds.isel(vertex=ds.kind.values == BorderKind.EXTREMAL_MOMENTUM)
    beside = crossings(line, "A", 0.938, "n")[0][0] + np.array([-1e-5, 1e-5])
    _, stable = own_numbers("fixed_point", top | {"A": np.full(2, 0.938), "n": beside})
    for A in (0.9, 0.938, 0.939, 0.939049):  # the end is beyond by 4e-7
        changes = [change for _, _, change in crossings(line, "A", A, "n", "stable_change")]
        assert changes == 2 * [0.5 * float(np.diff(stable)[0])]


def own_numbers(system, bodies):
    """Numbers of relative equilibria, and of those whose exponents, of the equations of motion, have no real part, (2, bodies)."""
    rest, system = atlas.equilibria(system, bodies), systems.get(system)
    row, place = np.nonzero(rest.index.values >= 0)
    at = {name: np.broadcast_to(value, rest.sizes["point"])[row] for name, value in bodies.items()}
    angles = {name: rest[name].values[row, place] for name in ("theta0", "psi0", "phi0") if name in rest}
    points = {name: np.full(row.size, p.default) for name, p in system.parameters.items()} | at | angles
    state, constants = system.initial_state(points), system.constants(points)
    growth = np.linalg.eigvals(jacobian_matrices(system.equations.rhs, state, constants)).real.max(-1)
    count = len(rest.index)
    return np.array([np.bincount(row, minlength=count), np.bincount(row, growth < 1e-5, count)])


@pytest.mark.long
def test_momentum_has_an_extremum():
    """A pair of exponents vanishes where a change of the rate, and of the attitude with it, keeps the momentum about the vertical."""
    top = {"A": 1.0, "B": 1.3, "C": 1.7, "Mg": 1.0, "x0": 0.3, "y0": 0.2, "z0": 0.5, "l2": 0.1}
    ds = atlas.borders("fixed_point", top, {"n": (0.2, 4.0), "l3": (-2.0, 2.0)}, stability=True)
    assert (ds.cells == Cell.COUNTED).all()
    ds = ds.isel(vertex=np.flatnonzero(ds.kind.values == BorderKind.EXTREMAL_MOMENTUM)[5:-5:40])
    inertia, momenta, follows = np.array([1.0, 1.3, 1.7]), [], np.ones(ds.sizes["vertex"], bool)
    for change in (-1e-4, 0.0, 1e-4):
        n = ds.n.values + change
        rest = atlas.equilibria("fixed_point", top | {"n": n, "l3": ds.l3.values})
        distance = np.abs(rest.gamma - ds.gamma.rename(vertex="point")).max("body_axis")
        follows &= (
            distance.min("equilibrium").values < 9e-4
        )  # within a change of 1e-4 of a fold the solution may end
        near = distance.argmin("equilibrium")
        gamma = rest.gamma.isel(equilibrium=near).values
        rotor = np.stack([0 * n, 0 * n + 0.1, ds.l3.values], -1)
        momenta.append(((n[:, None] * inertia * gamma + rotor) * gamma).sum(-1))
    assert follows.sum() > 10
    assert follows.mean() > 0.9  # which of the vertices are here depends on the processor's rounding
    low, middle, high = np.array(momenta)[:, follows]
    slope, bend = (high - low) / 2e-4, (high - 2 * middle + low) / 1e-8
    assert (np.abs(slope) < 1e-5 * np.abs(bend)).all()
