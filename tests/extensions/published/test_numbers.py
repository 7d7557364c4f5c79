"""Numbers that others have printed, beside ours."""

import csv
import io
import json

import pytest

import atlas
from atlas.cli import main
from atlas.extensions.published.numbers import compared, result_of

# The kernels of other tests, so that none is compiled for a few points.
pytestmark = pytest.mark.usefixtures("whole_kernels")

# Quantity -> difference, of the numbers that do not agree.
DIFFERENT = {
    "l < 0, first end": (-1.743, 0.0006),
    "l > 0, last end": (0.949, 0.5),
    "greatest r of both sections": (1.08, 0.007),
    "momenta of a rotor along the axis of the middle moment": (1.0, 1.0),
    "rotation over wobble of a thin plate": (2.0, 1.5),
}


@pytest.mark.long
def test_what_needs_a_missing_extension_says_so(without_extension):
    result_of.cache_clear()  # the first test, so that this costs nothing
    without_extension("normal_form")
    verdicts = {row["printed"]: row["verdict"] for row in compared("satellite")}
    assert verdicts["-1.567"].startswith("not computed: outputs.variables: 'nonlinear_stability' is unknown")
    assert verdicts["24"] == "agrees"


def test_which_numbers_agree():
    rows = compared("satellite") + compared("fixed_point")
    different = [row for row in rows if row["verdict"] != "agrees"]
    assert len(rows) > 20
    assert {row["quantity"]: float(row["printed"]) for row in different} == {
        name: printed for name, (printed, _) in DIFFERENT.items()
    }
    for row in different:
        difference = float(row["verdict"].removeprefix("differs by "))
        assert difference == pytest.approx(DIFFERENT[row["quantity"]][1], rel=0.1)
        assert difference == pytest.approx(abs(float(row["ours"]) - float(row["printed"])), rel=0.1)
    suspected = next(row for row in rows if row["printed"] == "0.949")
    assert "0.449 would agree" in suspected["remark"]
    assert round(float(suspected["ours"]), 3) == 0.449


def test_a_number_is_computed_as_its_row_says():
    row = next(row for row in compared("satellite") if row["printed"] == "-1.567")
    assert row["computation"] == "greatest m of atlas.run where nonlinear_stability is resonance_unstable"
    ds = atlas.run(**json.loads(row["arguments"]))
    unstable = ds.m.values[ds.nonlinear_stability == 4]
    assert f"{unstable.max():.4f}" == row["ours"]
    assert ds.sizes["b"] > len(unstable) > 1000


def test_the_command_prints_them(capsys):
    assert main(["conditions", "fixed_point", "--published"]) == 0
    text = capsys.readouterr().out
    assert "\n  y1: -0.9396570798729192, ours -0.939657079873: agrees\n" in text
    assert "wobble of a thin plate: 2, ours 0.5: differs by 1.5 (the ratio is that of wobble and " in text
    assert text.endswith("5 of 6 numbers of others on the system fixed_point agree with ours\n")
    rows = compared("fixed_point")
    assert main(["conditions", "fixed_point", "--published", "--csv"]) == 0
    assert [*csv.DictReader(io.StringIO(capsys.readouterr().out))] == rows
    assert main(["conditions", "fixed_point", "--published", "--json"]) == 0
    content = json.loads(capsys.readouterr().out)
    assert content["numbers"] == rows
    assert content.keys() == {"system", "reference", "doi", "numbers"}


def test_without_the_extension_there_are_none(without_extension, capsys):
    without_extension("published")
    assert main(["conditions", "--published"]) == 0
    assert capsys.readouterr().out == "0 of 0 numbers of others on the system satellite agree with ours\n"
