"""The catalogue of the paper's equations, its tables, and Lagrange's form."""

import csv
import importlib.util
import io
import json
from pathlib import Path

import numpy as np
import pytest

from atlas import systems
from atlas.cli import main
from atlas.extensions.catalogue import tables as catalogue
from atlas.extensions.yehia2021 import published
from atlas.systems.base import families_of
from atlas.systems.satellite.families import FAMILIES as SATELLITE_FAMILIES

ROOT = Path(__file__).parents[3]
SATELLITE, FIXED_POINT = systems.get("satellite"), systems.get("fixed_point")
# The paper's equations that are wrong or incomplete by the catalogue, and those that are right.
WRONG = {
    *(f"({i})" for i in range(4, 14)), "(14)1", "(14)2", "(14)3", "(19)1", "(21)", "(26)", "(29)1", "(31b)",
    "after (31)", "(32)", "(33)", "(34)", "(36)", "(37)", "(38)", "(40)", "(41)", "(42)", "(44)1", "(44)3", "names",
    "before (11)", "after (20), mu3 = 0", "after (23), formula of [3]", "after (26), m* < 0", "after (27)",
    "after (31b), in space", "after (31), n = Omega", "after (45), new solutions", "abstract, accuracy",
}  # fmt: skip
RIGHT = {
    "(15)", "(16)", "(17)1", "(17)2", "(18)", "(19)2", "(20)", "(22)", "(23)", "after (23)", "(24)", "(25)",
    "(27)", "(28)", "(29)2", "(30)", "(31)1", "(31)2", "(35)", "(39)", "(43)", "(44)2", "(45)",
    "(1)", "(2), (3)", "after (18), special case", "after (20), B = C", "after (20), h1 = h3 = 0", "after (23), [3]",
    "after (24)", "after (31), m = 2n", "after (43)", "after (44)", *(f"section 1, [{i}]" for i in (4, 6, 7, 16, 17, 19, 20, 25)),
    *(f"after ({i}), in space" for i in (15, 16, 18, 20, 23, 25, 28, 30, 45)),
}  # fmt: skip


def script(path):
    """A file of scripts/ as a module."""
    spec = importlib.util.spec_from_file_location(Path(path).stem, ROOT / "scripts" / path)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.mark.long
def test_every_printed_equation_has_its_verdict_and_residuals():
    rows = catalogue.published(SATELLITE)
    catalogue.residual.cache_clear()
    assert rows == catalogue.published(SATELLITE)  # the same random parameters in every process
    beyond = {row["equation"] for row in rows if row["equation"].startswith("beyond")}
    assert {row["equation"] for row in rows} == WRONG | RIGHT | beyond
    for row in rows:
        assert row["residual_true"] < 1e-12
        wrong = row["equation"] in WRONG | beyond
        assert (row["verdict"] != "true") == wrong
        assert (row["residual_printed"] > 1e-2) == wrong
    errata = catalogue.published(SATELLITE, errata=True)
    assert {row["equation"] for row in errata} == WRONG | beyond


def test_at_pi_the_body_at_rest_in_space_turns_the_other_way():
    """(14)2: there m = -Omega leaves the torque 2 Omega (-k2, k1, 0), and m = Omega none."""
    point = published.random_point(np.random.default_rng(0)) | {
        name: np.zeros(1) for name in ("h1", "mu1", "mu2", "n", "psi0")
    }
    point |= {"B": point["A"], "theta0": np.full(1, np.pi)}
    torque = 2 * max(abs(point["k1"][0]), abs(point["k2"][0]))
    left = published.residual(point | {"m": -point["Omega"]})
    assert left * point["A"][0] == pytest.approx(torque, rel=1e-9)
    assert published.residual(point | {"m": point["Omega"]}) < 1e-12


@pytest.mark.long
def test_command_line_tables(capsys, monkeypatch):
    monkeypatch.setattr(catalogue, "N_SAMPLES", 1)

    def output(*arguments):
        assert main(["conditions", *arguments]) == 0
        return capsys.readouterr().out

    assert output("satellite") == output()
    assert "(31b)" in output("satellite")
    assert "conical" in output("fixed_point")
    detail = output("--family", "perp_velocity")
    for expected in (
        "lambda^4 + P lambda^2 + Q = 0",
        "hyperboloidal",
        "(24), (25)",
        "4 Omega |A - C|",
        "phi0",
    ):
        assert expected in detail
    assert "conical permanent rotation (orbital)" in output()
    one = output("--errata", "19")
    assert one.startswith("(19)1  asymmetric_tilt: misprint")
    assert not {"(18)", "(20)"} & {line.split()[0] for line in one.splitlines()}
    assert output("--errata", "17").startswith("(17)1  perp_radius: true")  # right or wrong
    assert output("fixed_point", "--errata", "9").startswith("(9): misprint")
    assert output("--errata", "fixed_point") == output("fixed_point", "--errata")
    for arguments, message in (
        (["--errata", "99"], "--errata 99: no equation of this number; allowed: 1, 2, 3"),
        (["--errata", "("], "--errata (: no equation of this number"),
        (
            ["--family", "conical"],
            "family conical: unknown; perp_radius, by the paper's words 'conical permanent",
        ),
    ):
        assert main(["conditions", *arguments]) == 2
        assert message in capsys.readouterr().err
    errata = output("--errata")
    assert all(f"{number}" in errata for number in WRONG)
    assert "(15)  " not in errata
    for system in ("satellite", "fixed_point"):
        read = list(csv.DictReader(io.StringIO(output(system, "--csv"))))
        assert [row["family"] for row in read] == list(families_of(systems.get(system)))
        read = list(csv.DictReader(io.StringIO(output(system, "--errata", "--csv"))))
        expected = catalogue.published(systems.get(system), errata=True)
        assert [row["printed"] for row in read] == [row["printed"] for row in expected]
        whole = json.loads(output(system, "--json"))
        assert whole["printed"] == catalogue.published(systems.get(system))
        assert len(whole["families"]) == len(families_of(systems.get(system)))
    assert list(csv.DictReader(io.StringIO(output("--family", "oblique", "--errata", "--csv"))))


def test_lagrange_form_is_exact_on_precessions_and_singular_upright():
    form = script("tools/lagrange_form.py")
    points = form.tilted(np.array([1.0, 1e-3, 0.0]), np.pi / 2, "perp_velocity", C=1.3, m=0.5)
    closed = SATELLITE.families["perp_velocity"].motion(points, np.array(5.0))
    (angles, resolved), (cosines, sure) = (form.integrate(points, 5.0, 100, name) for name in form.FORMS)
    assert list(resolved) == [True, True, False]
    assert sure.all()
    assert form.error(points, angles, closed)[:2].max() < 1e-11
    errors = form.error(points, cosines, closed)
    assert 1e-11 < errors.min() < errors.max() < 1e-6


@pytest.mark.long
def test_lagrange_form_reports_where_it_is_not_resolved():
    form = script("tools/lagrange_form.py")
    tilts = np.concatenate([np.geomspace(1e-8, 1, 20), np.linspace(0.5, 2.6, 20)])
    points = form.random_points(40, 3, theta0=tilts)
    exact = form.reference(points, 6.0)
    coarser = None
    for steps in (150, 300, 600):
        (angles, resolved), (cosines, sure) = (
            form.integrate(points, 6.0, steps, name) for name in form.FORMS
        )
        assert sure.all()
        assert form.error(points, angles, exact)[resolved].max() < form.HALVED
        assert not resolved[:10].any()  # they start at a pole
        errors = np.median(form.error(points, cosines, exact))
        if coarser is not None:
            assert np.log2(coarser / errors) == pytest.approx(4, abs=0.4)
        coarser = errors


def test_families_satisfy_the_true_readings():
    for row in catalogue.families(SATELLITE):
        if row["family"] in SATELLITE_FAMILIES:
            assert row["residual_true"] < 1e-12
