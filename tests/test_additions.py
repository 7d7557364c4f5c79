"""What ARCHITECTURE.md says of adding something: the smallest example of each row of its table runs."""

import inspect
import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
from plain_kernel import plain_module
from scipy.integrate import solve_ivp

import atlas
from atlas import BadInput, systems, variables
from atlas.extension import Extension, extensions
from atlas.flags import Label, Status
from atlas.kernel import tableaux
from atlas.kernel.tableaux import Method
from atlas.label.plan import Plan
from atlas.measure.instrument import Instrument, MainInstrument, Rule, Variable
from atlas.systems import SYSTEMS
from atlas.systems.base import families_of

pytestmark = pytest.mark.usefixtures("whole_kernels")
ROOT = Path(__file__).parents[1]
# Row of the table -> file and test that runs its example.
TESTS = {
    "a statistic of the motion": "label/test_new_statistic.py::test_the_largest_nutation_rate",
    "a variable from theory": "extensions/test_example.py::test_variable_question_and_line",
    "a label": "test_additions.py::test_a_label_with_flags_of_its_own",
    "a family": "test_additions.py::test_a_family_of_an_extension",
    "a system": "systems/test_examples.py::test_the_command_finds_the_systems_of_installed_packages",
    "a method": "test_additions.py::test_a_method_is_a_name_an_order_and_a_tableau",
    "a format of atlases": "extensions/test_example.py::test_a_run_in_a_format_is_one_file_with_all_of_the_atlas",
    "a science, a figure of a paper, a command": "extensions/test_example.py::test_variable_question_and_line",
}
# A symmetric top: C (m + n cos theta) n - A n^2 cos theta = weight has a solution m for both signs of n.
M = 4.4387912809451864
TOP = {
    "A": 1.0,
    "B": 1.0,
    "C": 0.5,
    "Mg": -1.0,
    "z0": 1.0,
    "theta0": 0.5,
    "n": [0.5, -0.5, 0.5],
    "m": [M, -M, 1.0],
}


def test_every_row_of_the_table_has_a_test():
    table = (ROOT / "ARCHITECTURE.md").read_text().partition("| to add | where |\n|---|---|\n")[2]
    rows = re.findall(r"^\| ([^|]+) \| (.+) \|$", table.partition("\n\n")[0], re.MULTILINE)
    assert [row[0] for row in rows] == list(TESTS)
    for test in TESTS.values():
        file, name = test.split("::")
        assert f"def {name}(" in (ROOT / "tests" / file).read_text()
    for row in rows:
        assert all((ROOT / path).exists() for path in re.findall(r"docs/[\w/.]+\w", row[1]))


def test_a_label_with_flags_of_its_own(install_example):
    """Of precessions, of a drifting top, and where nothing is resolved."""
    install_example("precession_sense")
    options = {"duration": 30.0, "variables": ["label", "precession_sense", "status"], "progress": False}
    ds = atlas.label_points("fixed_point", TOP, rate_tolerance=1e-4, **options)
    flags = ds.precession_sense.flag_meanings.split()
    assert flags == ["none", "retrograde", "prograde"]
    assert ds.label.values.tolist() == [Label.REGULAR_PRECESSION, Label.REGULAR_PRECESSION, Label.DRIFTING]
    assert [flags[value] for value in ds.precession_sense.values] == ["prograde", "retrograde", "prograde"]
    stiff = atlas.label_points("fixed_point", TOP | {"Mg": -1e4}, step=0.5, **options)
    assert (stiff.status != Status.OK).all()
    assert (stiff.label == Label.UNRESOLVED).all()
    assert (stiff.precession_sense == 0).all()


@dataclass(frozen=True, eq=False)
class Wrong(Instrument):
    """A label whose rule does not fit its variable."""

    rule: Rule
    flags: tuple[str, ...] = ("none", "one", "two")

    def variables(self, system):
        flags = dict.fromkeys(self.flags, "a flag")
        return (Variable("wrong", "int8", "1", "a label", flags or None, optional=True),)

    def rules(self, run, rules):
        return {"wrong": self.rule}


def constant(value):
    return lambda measured: np.full_like(measured["theta_min"], value, int)


@pytest.mark.parametrize(
    ("instrument", "message"),
    [
        (Wrong(Rule(constant(1), ())), "'drifting' is no flag of this variable; allowed: none, one, two"),
        (
            Wrong(Rule(constant(1), (), drifting="two")),
            "'unresolved' is no flag of this variable; allowed: none, one, two",
        ),
        (Wrong(Rule(constant(3), (), drifting="two", unresolved="none")), "flags 2 to 3; allowed: 0 to 2"),
        (Wrong(Rule(constant(1), ()), ()), "'drifting' is no flag of this variable; allowed: none"),
    ],
)
def test_a_rule_whose_flags_its_variable_has_not_is_refused(instrument, message, monkeypatch):
    monkeypatch.setattr(variables, "INSTRUMENTS", [*variables.INSTRUMENTS, instrument])
    with pytest.raises(BadInput) as error:
        atlas.label_points("fixed_point", TOP, duration=1.0, variables=["wrong"], progress=False)
    assert str(error.value) == f"the rule of wrong: {message}"


@pytest.mark.parametrize("kind", [Instrument, MainInstrument])
def test_the_docstring_of_an_instrument_names_its_members(kind):
    """All of an instrument; of a main one those without a default, and what needs one of them."""
    documented, own = (
        set(re.findall(r"`(\w+)`", kind.__doc__)),
        {name for name in vars(kind) if name[0] != "_"},
    )
    if kind is MainInstrument:
        own = {
            name
            for name in own
            if "NotImplementedError"
            in inspect.getsource(kind).partition(f"def {name}(")[2].partition("def ")[0]
        }
    assert documented - {"may_stop_early"} == own


FAMILY = """
import numpy as np
from atlas.systems.base import Condition, Family

def weights(p):
    cosine = np.cos(p["theta0"])
    return p["A"] * p["n"] ** 2 * cosine, p["C"] * (p["m"] + p["n"] * cosine) * p["n"], p["Mg"] * p["z0"]

def residual(p):
    centrifugal, gyroscopic, weight = weights(p)
    return (centrifugal - gyroscopic - weight) / np.sum(np.abs(weights(p)), axis=0)

def m(p):
    centrifugal, _, weight = weights(p)
    return (centrifugal - weight) / (p["C"] * p["n"]) - p["n"] * np.cos(p["theta0"])

PRECESSION = Family(
    "precession", title="regular precession", conditions=(Condition("balance of torques", residual),), solve={"m": m}
)

def families(system):
    return {"precession": PRECESSION} if system.name == "heavy_top_euler" else {}
"""


@pytest.mark.long
def test_a_family_of_an_extension(tmp_path, monkeypatch, install_example, installed_extensions):
    """Its motions have its flag and its label; the system of the package has the same motions under another name."""
    (tmp_path / "tops").mkdir()
    (tmp_path / "tops" / "__init__.py").write_text("")
    (tmp_path / "tops" / "motions.py").write_text(FAMILY)
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.setattr(systems, "SYSTEMS", dict(systems.SYSTEMS))
    install_example("heavy_top_euler")
    record = Extension("tops", "tops", "precessions", families={"precession": "motions:families"})
    installed_extensions({**extensions(), "tops": record})
    top = {"A": 1.0, "C": 0.5, "Mg": -1.0, "z0": 1.0, "theta0": 0.5, "n": [0.5, -0.5, 0.5]}
    system = systems.get("heavy_top_euler")
    assert list(families_of(system)) == ["precession"]
    assert "precession" not in families_of(systems.SYSTEMS["fixed_point"])
    points = {
        name: np.broadcast_to(np.asarray(top.get(name, p.default), float), 3)
        for name, p in system.parameters.items()
    }
    m = families_of(system)["precession"].solve["m"](points)
    assert m == pytest.approx([M, -M, M], rel=1e-12)
    options = {
        "duration": 30.0,
        "variables": ["label", "family", "predicted", "agreement"],
        "progress": False,
    }
    ds = atlas.label_points("heavy_top_euler", top | {"m": [*m[:2], 1.0]}, rate_tolerance=1e-4, **options)
    assert ds.family.flag_meanings.split() == ["none", "precession"]
    assert ds.family.values.tolist() == [1, 1, 0]
    assert ds.predicted.values.tolist()[:2] == [Label.REGULAR_PRECESSION] * 2
    assert ds.label.values.tolist() == [Label.REGULAR_PRECESSION, Label.REGULAR_PRECESSION, Label.DRIFTING]
    ours = atlas.label_points("fixed_point", top | {"B": 1.0, "m": m}, rate_tolerance=1e-4, **options)
    assert (ours.label == Label.REGULAR_PRECESSION).all()
    scene = atlas.load_scene(
        'schema = 1\nsystem = "heavy_top_euler"\nfixed = { C = 0.5, Mg = -1.0, z0 = 1.0 }\n'
        'axes.n = { from = 0.5, to = 1.0, count = 3 }\nfamily = { name = "precession" }\nintegration = { duration = 1.0 }\n'
    )
    assert scene.family == "precession"


# The solution of order 6 of Verner's pair of orders 6 and 5: SIAM J. Numer. Anal. 15, 772 (1978).
VERNER = (
    (
        (),
        (1 / 6,),
        (4 / 75, 16 / 75),
        (5 / 6, -8 / 3, 5 / 2),
        (-165 / 64, 55 / 6, -425 / 64, 85 / 96),
        (-8263 / 15000, 124 / 75, -643 / 680, -81 / 250, 2484 / 10625),
        (3501 / 1720, -300 / 43, 297275 / 52632, -319 / 2322, 24068 / 84065, 3850 / 26703),
    ),
    (3 / 40, 0.0, 875 / 2244, 23 / 72, 264 / 1955, 125 / 11592, 43 / 616),
)


@pytest.mark.long
def test_a_method_is_a_name_an_order_and_a_tableau(monkeypatch):
    """Labels and states by it are those of DOP853 to its tolerance, in about the steps that its order promises."""
    monkeypatch.setitem(tableaux.METHODS, "rk6", Method("rk6", 6, *VERNER))
    system = SYSTEMS["fixed_point"]
    monkeypatch.setattr(Plan, "kernel", plain_module(system.equations, "rk6"))
    spinning = TOP | {"m": [M, -M, 3.0], "B": [1.0, 1.0, 1.3]}
    points = {
        n: np.broadcast_to(np.asarray(spinning.get(n, p.default), float), 3)
        for n, p in system.parameters.items()
    }
    constants, start = system.constants(points)[:, 2], system.initial_state(points)[:, 2]
    y = solve_ivp(
        lambda t, y: system.equations.rhs(y, constants), (0, 4), start, "DOP853", np.linspace(0, 4, 4001), rtol=1e-11, atol=1e-12,
    ).y  # fmt: skip
    theta = np.arccos(system.equations.frame_motion(y, constants)[5])
    for tolerance in (1e-4, 1e-6):
        ds = atlas.label_points(
            "fixed_point", spinning, duration=4.0, method="rk6", tolerance=tolerance, rate_tolerance=1e-3, progress=False,
        )  # fmt: skip
        assert ds.label.values.tolist() == [
            Label.REGULAR_PRECESSION,
            Label.REGULAR_PRECESSION,
            Label.DRIFTING,
        ]
        assert (ds.error_estimate < 10 * tolerance).all()
        assert ds.theta_max[2] == pytest.approx(theta.max(), abs=10 * tolerance)
