"""The catalogue: tables, limits of families as errors, Lagrange's form."""

import csv
import io
import json
import re
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from matplotlib.mathtext import MathTextParser
from refusals import assert_refused, assert_refused_in_shell
from strategies import (
    fixed_points_on_family,
    random_fixed_points,
    satellite_on_family,
    symmetric_fixed_points,
)

from atlas import BadInput, conditions, load_scene, systems
from atlas.cli import main
from atlas.extensions.catalogue import tables as catalogue
from atlas.extensions.catalogue.latex import latex_table
from atlas.flags import Stability
from atlas.scene import grid
from atlas.systems.base import families_of, on_family
from atlas.systems.satellite.families import FAMILIES as SATELLITE_FAMILIES

ROOT = Path(__file__).parents[3]
SATELLITE, FIXED_POINT = systems.get("satellite"), systems.get("fixed_point")
# Tables.


def test_rows_of_families_are_complete():
    rows = catalogue.families(SATELLITE)
    assert [row["family"] for row in rows] == list(families_of(SATELLITE))
    for row in rows + catalogue.families(FIXED_POINT):
        assert all(
            row[key] for key in ("equations", "motion", "conditions", "solves_for", "geometry", "labels")
        )
        assert row["stability"]
    for row in rows:
        assert row["exists"]
    with pytest.raises(BadInput, match="banana"):
        catalogue.families(SATELLITE, "banana")


# Tables of pandas, and for papers.


@pytest.mark.long
def test_the_table_of_conditions_has_the_keys_of_its_errata(capsys):
    """Of the papers on both systems; the shell prints the same rows."""
    for system in ("satellite", "fixed_point"):
        table, errata = conditions(system), conditions(system, errata=True)
        assert list(table.index) == list(families_of(systems.get(system)))
        assert errata.index.is_unique
        for family, numbers in table.errata.items():
            assert (errata.family[numbers] == family).all()
        assert sum(map(len, table.errata)) == (errata.family != "").sum()
        assert not (errata.verdict == "true").any()
        assert main(["conditions", system, "--csv"]) == 0
        rows = list(csv.DictReader(io.StringIO(capsys.readouterr().out)))
        assert [row.pop("family") for row in rows] == list(table.index)
        assert [list(row) for row in rows] == len(rows) * [list(table.columns)]
        assert [row["conditions"].split("; ") for row in rows] == list(table.conditions)
        assert [row["errata"] for row in rows] == ["; ".join(numbers) for numbers in table.errata]
    one = conditions("satellite", "asymmetric_tilt", errata=True)
    assert list(one.index) == ["(19)1", "after (20), mu3 = 0", "beyond (19)"]
    with pytest.raises(BadInput, match="family banana: unknown"):
        conditions("satellite", "banana")
    with pytest.raises(BadInput, match="system = 'moon': there is no such system"):
        conditions("moon")


def check_latex(text, columns):
    """Syntax of a longtable, without a TeX: columns, environments, signs outside of formulas; formulas by another parser."""
    assert text.startswith("% needs \\usepackage{amsmath, longtable}\n\\begin{longtable}{")
    assert text.endswith("\\hline\n\\end{longtable}\n")
    assert text.isascii()
    assert text.count("\\linewidth") == columns
    body = text.split("\\endhead\n")[1].split("\\hline")[0].splitlines()
    for line in body:
        assert line.endswith(r" \\")
        assert line[0] not in "[*"  # an argument of the end of the line before
        words, formulas = re.split(r"\$[^$]*\$", line[:-3]), re.findall(r"\$[^$]*\$", line)
        assert len(re.findall(r"(?<!\\)&", "".join(words))) == columns - 1
        assert not any("&" in formula for formula in formulas)
        left = re.sub(r"\\(newline |[_&%#$]|text[a-z]+\{\})", "", "".join(words))
        assert not re.search(r"[\\{}_^#%~$<>|]", left), left
        for formula in formulas:
            known = re.sub(r"\\(ge|le|ne)\b", r"\\\1q", re.sub(r"\\[lr]vert", "|", formula))  # to Matplotlib
            assert MathTextParser("path").parse(known)
    return body


@pytest.mark.long
def test_tables_for_papers_are_latex(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    for system in ("satellite", "fixed_point"):
        for option in ([], ["--errata"]):
            assert main(["conditions", system, *option, "-o", f"{system}{len(option)}.tex"]) == 0
            table = conditions(system, errata=bool(option))
            lines = check_latex(Path(f"{system}{len(option)}.tex").read_text(), 4)
            names = [line.split(" & ")[0].replace("\\_", "_") for line in lines]
            if not option:
                assert names == list(table.index)
            assert len(lines) == len(table)
    assert r"$h_{1} \mu_{3} = 0$ \newline" in Path("satellite0.tex").read_text()
    assert main(["conditions", "--family", "oblique", "-o", "one.csv"]) == 0
    (row,) = csv.DictReader(io.StringIO(Path("one.csv").read_text()))
    assert (row["family"], row["errata"]) == ("oblique", "beyond (17), (24)")
    capsys.readouterr()
    assert main(["conditions", "-o", "one.csv"]) == 2
    assert main(["conditions", "-o", "one.txt"]) == 2
    assert "one.txt: the name must end in .csv or .tex" in capsys.readouterr().err


def test_signs_of_latex_in_words_are_printed():
    texts = ["100 % of a_b & #1 {c} ~ \\ ^", "m < 0 | 1"]
    lines = check_latex(latex_table([{"family": text} for text in texts], {"family": "family"}), 1)
    signs = r"\textasciitilde{} \textbackslash{} \textasciicircum{}"
    assert lines[0] == rf"100 \% of a\_b \& \#1 \textbraceleft{{}}c\textbraceright{{}} {signs} \\"
    assert lines[1] == r"m \textless{} 0 \textbar{} 1 \\"


# Free parameters and limits of existence of the families.


def holds_after_change(family, point, name):
    """Is the point still on the family when one parameter is changed?"""
    return (on_family(family, {**point, name: point[name] + 0.37}) < 1e-9).all()


@pytest.mark.parametrize("name", SATELLITE_FAMILIES)
def test_free_parameters_of_the_satellite(name):
    family, rng = families_of(SATELLITE)[name], np.random.default_rng(1)
    points = [p for _ in range(20) if (p := satellite_on_family(name, rng)) is not None]
    assert points
    free = {p for p in SATELLITE.parameters if all(holds_after_change(family, point, p) for point in points)}
    # a magnet is free only as long as there is no field along the radius
    assert free - {"mu3"} == set(family.free)
    assert not set(family.free) & set(family.solve)


@pytest.mark.parametrize("name", ["conical", "sleeping", "staude", "rest"])
def test_free_parameters_of_the_fixed_point(name):
    family, rng = families_of(FIXED_POINT)[name], np.random.default_rng(2)
    points = {
        "conical": lambda: fixed_points_on_family(name, symmetric_fixed_points(rng, 9), "l3"),
        "sleeping": lambda: fixed_points_on_family(
            name, random_fixed_points(rng, 9, theta_dot0=0.0), "theta0", "l1", "l2"
        ),
        "staude": lambda: fixed_points_on_family(
            name, random_fixed_points(rng, 9, theta_dot0=0.0, m=0.0), "l1", "l2"
        ),
        "rest": lambda: fixed_points_on_family(
            name, random_fixed_points(rng, 9, theta_dot0=0.0, n=0.0, m=0.0), "theta0", "phi0"
        ),
    }[name]()
    assert (on_family(family, points) < 1e-9).all()
    for parameter in family.free:
        assert holds_after_change(family, points, parameter), parameter
    assert not set(family.free) & set(family.solve)


@pytest.mark.usual("perp_velocity-4")
@settings(max_examples=60, deadline=None)
@given(k3=st.floats(-6, 6), m=st.floats(-2, 2), C=st.floats(0.2, 1.9), h3=st.floats(-1, 1))
@pytest.mark.parametrize(("name", "factor"), [("perp_radius", 1), ("perp_velocity", 4)])
def test_existence_limits_of_the_tilted_axis(name, factor, k3, m, C, h3):
    given_values = {"k3": k3, "m": m, "C": C, "h3": h3, "mu3": 0.5, "psi0": np.pi / 2 * (factor == 4)}
    point = {p.name: np.full(1, p.default) for p in SATELLITE.parameters.values()}
    point |= {key: np.full(1, value) for key, value in given_values.items()}
    momentum, limit = abs(k3 + C * m - 0.5 * h3), factor * abs(1 - C)
    if abs(momentum - limit) < 1e-9:
        return
    point["theta0"] = families_of(SATELLITE)[name].solve["theta0"](point)
    assert np.isfinite(point["theta0"][0]) == (momentum < limit)
    if momentum < limit:
        assert on_family(families_of(SATELLITE)[name], point)[0] < 1e-9


@settings(max_examples=60, deadline=None)
@given(h1=st.floats(-3, 3), theta0=st.floats(0.05, 3.1), C=st.floats(0.2, 1.9))
def test_existence_limit_of_the_oblique_axis(h1, theta0, C):
    point = {p.name: np.full(1, p.default) for p in SATELLITE.parameters.values()}
    point |= {
        key: np.full(1, value) for key, value in {"h1": h1, "theta0": theta0, "C": C, "mu3": 0.7}.items()
    }
    product, limit = abs(0.7 * h1), 3 * np.sin(theta0) * abs(1 - C)
    if abs(product - limit) < 1e-9 or limit < 1e-6:
        return
    point["psi0"] = SATELLITE.families["oblique"].solve["psi0"](point)
    assert np.isfinite(point["psi0"][0]) == (product < limit)


@settings(max_examples=60, deadline=None)
@given(seed=st.integers(0, 10**6))
def test_existence_limit_of_the_conical_motion(seed):
    point = symmetric_fixed_points(np.random.default_rng(seed), 1)
    weight, gradient = point["Mg"] * point["z0"], (point["C"] - point["A"]) * np.cos(point["theta0"])
    discriminant = (point["C"] * point["m"] + point["l3"]) ** 2
    limit = 4 * gradient * (weight - point["N"] * gradient)
    n = FIXED_POINT.families["conical"].solve["n"](point)
    assert np.isfinite(n[0]) == (discriminant > limit)[0]


# Errors.


def scene(system, family, solve, axis="phi0", **fixed):
    lines = [f"{name} = {float(value)!r}" for name, value in fixed.items()]
    return load_scene(
        f'schema = 1\nsystem = "{system}"\n[fixed]\n' + "\n".join(lines)
        + f'\n[axes.{axis}]\nvalues = [0.0, 0.5, 1.0]\n[family]\nname = "{family}"\nsolve = {json.dumps(solve)}\n'
    )  # fmt: skip


OUTSIDE = [
    # system, family, solved, parameters, the condition that fails
    ("satellite", "cylindrical", ["k1", "k2"], {"h1": 1, "mu3": 1}, "h1 mu = 0"),
    ("satellite", "cylindrical", ["k1"], {"m": -1, "mu1": 1, "h3": 1}, "no k1 puts any point"),
    ("satellite", "equilibrium", ["k1", "k2", "k3"], {"m": 0.5, "theta0": 1}, "n sin theta0 = 0"),
    ("satellite", "equilibrium", ["k1", "k2"], {"B": 1.2, "psi0": 0.3}, "beta.(3 Omega^2 I alpha"),
    ("satellite", "perp_radius", ["theta0"], {"k3": 5}, "Omega s (k3 + C m)"),
    ("satellite", "perp_radius", ["k3"], {"theta0": 1, "h1": 1, "mu3": 1}, "h1 mu3 = 0"),
    ("satellite", "perp_velocity", ["theta0"], {"k3": 9, "psi0": np.pi / 2}, "Omega s (k3 + C m)"),
    ("satellite", "perp_velocity", ["k3"], {"theta0": 1, "k1": 0.2, "psi0": np.pi / 2}, "k1 = k2 = 0"),
    ("satellite", "oblique", ["psi0", "k3"], {"theta0": 0.5, "h1": 5, "mu3": 1}, "3 Omega^2 s sin psi0"),
    ("satellite", "transverse_magnet", ["k1", "k2", "k3"],
     {"theta0": 1, "psi0": np.pi / 2, "mu1": 1, "h1": 1, "h3": 1, "m": 2}, "w3 k1,2 = H3 mu1,2"),
    ("satellite", "despun_transverse", ["k1", "k2", "k3"], {"theta0": 1, "m": 1}, "m = -Omega cos theta0"),
    ("satellite", "asymmetric_tilt", ["k3"], {"theta0": 1, "psi0": np.pi / 2, "m": -1}, "cos theta0 = +-1/2"),
    ("satellite", "spherical", ["k3"], {"theta0": 1, "n": 1}, "B = C"),
    ("satellite", "spherical", ["k3"], {"C": 1, "n": -1, "h3": 1, "mu3": 1}, "no k3 puts any point"),
    ("satellite", "other_axis", ["k3"], {"theta0": 0.3, "n": 1}, "an axis of equal moments"),
    ("fixed_point", "conical", ["l3"], {"B": 1.2, "theta0": 1, "n": 1}, "A = B"),
    ("fixed_point", "conical", ["n"], {"C": 0.5, "theta0": 1, "z0": 1, "Mg": -3}, "(C - A)(n^2 - N)"),
    ("fixed_point", "sleeping", [], {"theta0": 0.3, "m": 1}, "sin theta0 = 0"),
    ("fixed_point", "staude", [], {"m": 1, "n": 1, "theta0": 1}, "m = 0"),
    ("fixed_point", "rest", [], {"n": 1, "theta0": 1}, "n = 0"),
]  # fmt: skip


@pytest.mark.parametrize(("system", "family", "solve", "fixed", "named"), OUTSIDE)
def test_the_error_outside_a_family_has_the_condition_and_its_residual(system, family, solve, fixed, named):
    with pytest.raises(BadInput) as error:
        grid.check(scene(system, family, solve, **fixed))
    text = str(error.value)
    assert "\n" not in text
    assert family in text
    assert named in text
    assert "fails by" in text
    amount = float(text.split("fails by ")[1].split()[0])
    assert amount > 1e-3


FREE = [
    ("satellite", "cylindrical", ["k3"], {}),
    ("satellite", "perp_velocity", ["phi0"], {}),
    ("fixed_point", "sleeping", ["l3"], {}),
    # free only here: without a magnet, or without the tilt on which k3 and the rotor act
    ("satellite", "perp_velocity", ["h3", "k3"], {"theta0": 1, "psi0": np.pi / 2}),
    ("satellite", "perp_velocity", ["k3"], {"psi0": np.pi / 2}),
    ("satellite", "equilibrium", ["k3"], {}),
    ("satellite", "asymmetric_tilt", ["h1", "k3"], {"theta0": np.pi / 3, "psi0": np.pi / 2, "m": -1}),
    ("satellite", "spherical", ["k3"], {"C": 1, "n": -1, "theta0": 1}),
]


@pytest.mark.parametrize(("system", "family", "solve", "fixed"), FREE)
def test_solving_for_a_free_parameter_is_an_error(system, family, solve, fixed):
    with pytest.raises(BadInput, match=f"family.solve = '{solve[0]}'.*free"):
        grid.check(scene(system, family, solve, axis="n" if solve == ["phi0"] else "phi0", **fixed))


def test_gravity_gradient_diagram_is_the_classical_one():
    """Lagrange's triangle and the region of DeBra and Delp, by their inequalities."""
    scene = load_scene(ROOT / "configs" / "gravity_gradient.toml")
    base = grid.points_at_indices(scene, np.arange(0, scene.size, 37)).base
    flags, _ = SATELLITE.identify_family(base)
    stable, _ = SATELLITE.linear_stability(base, flags)
    A, B, C = (base[name] for name in "ABC")
    K1, K3 = (C - A) / B, (C - B) / A
    above = 1 + 3 * K1 + K1 * K3 - 4 * np.sqrt(np.maximum(K1 * K3, 0))
    expected = (K1 * K3 > 0) & (K1 > K3) & (above > 0)
    clear = (np.abs(K1 - K3) > 0.01) & (np.abs(above) > 0.01)
    assert clear.sum() > 1000
    np.testing.assert_array_equal(stable[clear] == Stability.STABLE, expected[clear])


# Lagrange's form, and the scripts.


def test_conditions_name_the_solution_that_is_taken(capsys):
    assert main(["conditions", "fixed_point", "--family", "conical"]) == 0
    assert "of several solutions\n    n: the slow one\n" in capsys.readouterr().out
    (row,) = catalogue.families(FIXED_POINT, "grioli")
    assert row["of_several_solutions"][-1] == "n: that of the largest n"


def test_conditions_are_printed(capsys):
    assert main(["conditions", "satellite"]) == 0
    assert "perp_velocity" in capsys.readouterr().out
    assert main(["conditions", "satellite", "--family", "cylindrical"]) == 0
    assert "A = B" in capsys.readouterr().out


REFUSALS = [
    ("conditions sputnik", "system = 'sputnik': there is no such system; allowed: satellite, fixed_point"),
    ("conditions satellite --family banana", "family banana: unknown; allowed: ..."),
    ("conditions --published --family conical", "--published: numbers of others belong to no family; leave out --family"),
    ("conditions --published --errata", "atlas conditions: argument --errata: not allowed with argument --published (see atlas conditions --help)"),
    ("conditions --csv --json", "atlas conditions: argument --json: not allowed with argument --csv (see atlas conditions --help)"),
]  # fmt: skip


@pytest.mark.parametrize(("command", "sentence"), REFUSALS, ids=[row[0] for row in REFUSALS])
def test_a_mistake_in_the_command(command, sentence, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert_refused_in_shell(command, sentence, capsys)


def test_a_system_that_is_not_known():
    sentence = "system = 'moon': there is no such system; allowed: satellite, fixed_point"
    assert_refused(lambda: conditions("moon"), sentence)
