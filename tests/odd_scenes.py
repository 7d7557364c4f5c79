"""Odd and hostile scenes and points, drawn from a seed: each must lead to a result or to BadInput.

`tests/scene/test_fuzz.py` tries some of them, `scripts/tools/fuzz_scenes.py` as many as wanted.
"""

from __future__ import annotations

import ast
import copy
import io
import tomllib
import warnings
from pathlib import Path
from random import Random
from typing import Any

import numpy as np
import tomli_w
from plain_kernel import plain_module

from atlas import BadInput, label_points, load_scene
from atlas.errors import MAX_MESSAGE
from atlas.kernel.blocks import Threads
from atlas.label import pipeline
from atlas.label.plan import Plan
from atlas.runs.plan import ScenePlan
from atlas.scene import expressions, grid, tables
from atlas.store.dataset import dataset
from atlas.systems import SYSTEMS
from atlas.systems.base import families_of
from atlas.variables import variables

ROOT = Path(__file__).parent.parent
TINY, HUGE = 5e-324, 1.7976931348623157e308
NUMBERS = [
    *(
        0.0,
        -0.0,
        1.0,
        -1.0,
        0.5,
        2.0,
        1 + 2**-52,
        1e-16,
        1e-8,
        1e16,
        1e8,
        np.pi,
        np.pi / 2,
        1e60,
        1e77,
        1e-60,
    ),
    *(TINY, -TINY, 1e-310, 1e-300, 1e-160, 1e154, -1e154, 1e160, 1e300, -1e300, HUGE, -HUGE),
    *(float("inf"), float("-inf"), float("nan"), 0, 1, -1, 2, 3, 7, 2**31, 2**63, -(2**63), 10**19, 10**400),
]
STRINGS = [
    *(
        "",
        " ",
        "A",
        "k3",
        "label",
        "point",
        "pi",
        "sigma",
        "\n",
        "\x1b[2J\x1b]0;owned\x07",
        "\x7f\x9b31m",
        "\u202egnp.exe",
    ),
    *(
        "\u2028",
        "\ud7ff",
        "\ufeff",
        "\0",
        "a" * 3000,
        "20 orbits",
        "5 turns",
        "1e308 orbits",
        "1e-320 turns",
        "-1 turns",
    ),
    *(
        "1e999 turns",
        "../../etc/x.csv",
        "/dev/zero",
        "/dev/null.csv",
        "x" * 5000 + ".nc",
        "x.csv",
        "C:\\x.nc",
        "é",
        "0x1",
    ),
    *(
        "rk8",
        "log",
        "linear",
        "sobol",
        "all",
        "sample",
        "none",
        "__import__('os')",
        "1 if A else 2",
        "lambda: 0",
        "A" * 400,
    ),
]
NAMES = [
    *(
        "label",
        "status",
        "step",
        "family",
        "stable",
        "computed",
        "point",
        "k3_offset",
        "k3",
        "A_offset",
        "sigma",
        "u",
        "v",
    ),
    *(
        "time",
        "from",
        "x" * 70,
        "a b",
        "\x1b[1m",
        "",
        "é",
        "pi",
        "sin",
        "lambda",
        "1a",
        "_",
        "count",
        "values",
        "\u202e",
    ),
]
OPERATORS = ["+", "-", "*", "/", "**", "//", "%", "@", "<", "and", ","]
FUNCTIONS = ["sqrt", "sin", "acos", "exp", "log", "abs", "tan", "eval", "open", ""]
# Values that pass most checks, for scenes that get further.
USUAL = [0.0, 0.1, 0.5, 1.0, 1.5, -0.7, 3.0, 1e-4]
BASES = [
    (ROOT / "tests" / "small.toml").read_text(),
    """schema = 1
    system = "fixed_point"
    [fixed]
    C = 1.2
    z0 = 1.0
    Mg = 0.5
    l1 = 0.01
    theta0 = 0.7
    [axes.m]
    from = 3.0
    to = 5.0
    count = 3
    [integration]
    duration = 2.0
    [outputs]
    variables = ["label", "first_order_error", "first_order_rate_error_printed"]
    """,
    """schema = 1
    system = "satellite"
    [points]
    sample = "sobol"
    count = 5
    seed = 3
    [points.ranges.theta0]
    from = 0.1
    to = 1.0
    [points.ranges.q]
    from = 0.1
    to = 1.0
    spacing = "log"
    [ties]
    C = "0.8 + q / 2"
    [integration]
    duration = "1 orbits"
    method = "rk8"
    """,
    """schema = 1
    system = "satellite"
    [points.values]
    m = [0.1, 0.5]
    mu3 = [1.0, 0.0]
    [fixed]
    h1 = 0.3
    """,
    """schema = 1
    system = "satellite"
    [fixed]
    Omega = 1.0
    m = 0.3
    psi0 = 1.5707963267948966
    [axes.theta0]
    from = 0.3
    to = 1.2
    count = 3
    [axes.k3]
    from = -0.1
    to = 0.1
    count = 3
    offset_from_family = true
    [family]
    name = "perp_velocity"
    solve = ["k3"]
    [refine]
    levels = 1
    probe = 0.2
    [integration]
    duration = "0.5 turns"
    [outputs]
    variables = ["label", "predicted", "stable", "growth_rate"]
    """,
    """schema = 1
    system = "fixed_point"
    [fixed]
    p0 = 0.1
    q0 = 0.2
    r0 = 1.0
    gamma10 = 0.6
    gamma20 = 0.0
    gamma30 = 0.8
    M = 2.0
    lambda = 3.0
    R = 4.0
    [axes.x0]
    values = [0.0, 0.1]
    [nudge]
    theta0 = 1e-3
    [outputs]
    variables = ["label", "family", "error_estimate", "geometry"]
    """,
]
MAX_STEPS = 6  # of a run: kernels are interpreted


def scene_text(rng: Random) -> str:
    """A scene of BASES after some random changes, sometimes also of its characters."""
    table = tomllib.loads(rng.choice(BASES))
    for _ in range(rng.choice([0, 1, 1, 2, 2, 3, 5])):
        _change(rng, table)
    text = tomli_w.dumps(table)
    if rng.random() < 0.15:
        for _ in range(rng.randint(1, 4)):
            i = rng.randrange(len(text))
            text = (
                text[:i]
                + rng.choice(["", "\n", "=", "[", "]", '"', "\\", ".", "\x1b", "9", "e", "{"])
                + text[i + 1 :]
            )
    return text + "\n"


def _change(rng: Random, table: dict[str, Any]) -> None:
    """Change, remove or add one entry somewhere in a scene."""
    system = SYSTEMS.get(
        table.get("system") if isinstance(table.get("system"), str) else "", SYSTEMS["satellite"]
    )
    where = rng.choice(_tables_in(table))
    keys = list(where)
    match rng.choice(
        ["value", "value", "usual", "usual", "remove", "add", "tie", "section", "outputs", "family"]
    ):
        case "value" if keys:
            where[rng.choice(keys)] = _value(rng)
        case "usual" if keys:
            where[rng.choice(keys)] = rng.choice(USUAL)
        case "remove" if keys:
            del where[rng.choice(keys)]
        case "add":
            where[_name(rng, system)] = _value(rng) if rng.random() < 0.5 else rng.choice(USUAL)
        case "tie":
            _section(table, "ties")[_name(rng, system)] = _expression(rng, system, 4)
        case "section":
            _add_section(rng, table, system)
        case "outputs":
            names = [*variables(system), *system.derived]
            _section(table, "outputs")["variables"] = rng.sample(names, rng.randint(1, 6))
        case "family":
            family = rng.choice(list(families_of(system).values()))
            solve = rng.sample(list(family.solve), rng.randint(0, len(family.solve)))
            table["family"] = {"name": family.name, "solve": solve}


def _add_section(rng: Random, table: dict[str, Any], system: Any) -> None:
    """Add an axis, a nudge, settings or a refinement."""
    kind = rng.choice(["axes", "axes", "nudge", "integration", "labels", "refine"])
    if kind == "axes":
        axis: dict[str, Any] = {
            "from": _number(rng),
            "to": _number(rng),
            "count": rng.choice([1, 2, 3, 10**8, 10**5]),
        }
        if rng.random() < 0.3:
            axis = {"values": [_number(rng) for _ in range(rng.randint(0, 4))]}
        for key, value in {
            "spacing": "log",
            "offset_from_family": True,
            "units": rng.choice(STRINGS),
        }.items():
            if rng.random() < 0.2:
                axis[key] = value
        _section(table, "axes")[_name(rng, system)] = axis
    elif kind == "nudge":
        _section(table, kind)[rng.choice(["theta0", "psi0", "n", "m", "p0", "r0"])] = _number(rng)
    elif kind == "refine":
        table["refine"] = {"levels": rng.choice([1, 2, 8, 9]), "probe": _number(rng)}
    else:
        keys = ["tolerance", "step", "duration", "max_steps"] if kind == "integration" else ["rate_tolerance"]
        _section(table, kind)[rng.choice(keys)] = _number(rng)
        if kind == "labels":
            _section(table, kind)["cylinder_tolerance"] = _number(rng)


def _section(table: dict[str, Any], key: str) -> dict[str, Any]:
    """A table in the scene, created if it is missing."""
    if not isinstance(table.get(key), dict):
        table[key] = {}
    return table[key]


def _tables_in(table: dict[str, Any]) -> list[dict[str, Any]]:
    """The table and every table in it."""
    inner = [t for value in table.values() if isinstance(value, dict) for t in _tables_in(value)]
    return [table, *inner]


def _name(rng: Random, system: Any) -> str:
    return rng.choice(NAMES) if rng.random() < 0.5 else rng.choice(list(system.parameters))


def _number(rng: Random) -> Any:
    return rng.choice(NUMBERS) if rng.random() < 0.6 else rng.choice(USUAL)


def _value(rng: Random, depth: int = 0) -> Any:
    """A random value of any type of TOML."""
    kind = rng.random()
    if kind < 0.5:
        return _number(rng)
    if kind < 0.8 or depth > 3:
        return rng.choice(STRINGS)
    if kind < 0.9:
        return [_value(rng, depth + 1) for _ in range(rng.choice([0, 1, 2, 30]))]
    if kind < 0.95:
        return {rng.choice(NAMES): _value(rng, depth + 1) for _ in range(2)}
    return rng.choice([True, False, tomllib.loads("d = 1979-05-27T07:32:00Z")["d"]])


def _expression(rng: Random, system: Any, depth: int) -> str:
    """Random arithmetic, most of it allowed."""
    kind = rng.random()
    if depth == 0 or kind < 0.3:
        return rng.choice(
            [str(rng.choice(NUMBERS)), str(rng.choice(USUAL)), _name(rng, system), "pi", "sigma"]
        )
    if kind < 0.7:
        left, right = _expression(rng, system, depth - 1), _expression(rng, system, depth - 1)
        return f"({left} {rng.choice(OPERATORS[: rng.choice([5, 11])])} {right})"
    if kind < 0.95:
        return f"{rng.choice(FUNCTIONS)}({_expression(rng, system, depth - 1)})"
    return rng.choice(["-", "+", "~", "not "]) * rng.choice([1, 2, 80]) + _expression(rng, system, depth - 1)


def points(rng: Random, system: str, count: int) -> dict[str, Any]:
    """Columns of points with odd numbers, of a body that is possible in three of four draws."""
    parameters = SYSTEMS[system].parameters
    finite = [x for x in NUMBERS if isinstance(x, float) and abs(x) < np.inf]
    columns: dict[str, Any] = {}
    for name in rng.sample(list(parameters), rng.randint(1, 9)):
        allowed = [
            x for x in finite if parameters[name].low <= x and not (parameters[name].open_low and x <= 0)
        ]
        numbers = USUAL if rng.random() < 0.4 else (NUMBERS if rng.random() < 0.05 else allowed)
        column = [rng.choice(numbers) for _ in range(count)]
        columns[name] = column if rng.random() < 0.7 else column[0]
    if rng.random() < 0.75:
        moment = rng.choice([1.0, 1.0, 1e-150, 1e150, 1e-300, 1e300, TINY, HUGE])
        columns |= {"A": moment, "B": moment, "C": moment * rng.choice([1.0, 0.5])}
    return columns


def try_scene(text: str) -> str:
    """Read and check a scene as `atlas check` does; "ok" or the message of BadInput."""

    def check() -> None:
        scene = load_scene(text)
        assert load_scene(scene.toml()).toml() == scene.toml()
        sample = grid.check(scene)
        assert repr(scene).replace("\n", "").isprintable()
        ScenePlan(scene, sample).method_lines()
        scene.system.warnings(sample.base)

    return _outcome(check)


def try_run(text: str) -> str:
    """Evaluate the first points of a scene with interpreted kernels and make their dataset."""

    def run() -> None:
        load_scene(text)
        table = tomllib.loads(text)
        if isinstance(table.get("integration", {}), dict):
            table.setdefault("integration", {})["max_steps"] = MAX_STEPS
        scene = load_scene(tomli_w.dumps(table))
        grid.check(scene)
        tile = grid.points_at_indices(scene, np.arange(min(scene.size, 3)))
        values = pipeline.evaluate(Plan.of(scene), tile, threads=Threads(1))
        _check_columns(values, tile.exists.size)
        if scene.size <= 30:
            columns = {name: np.zeros(scene.size) for name in (*scene.outputs, *scene.solve)}
            dataset(scene, columns)

    return _outcome(run)


def try_points(rng: Random) -> str:
    """`label_points` of odd numbers with interpreted kernels."""
    system = rng.choice(list(SYSTEMS))
    columns = points(rng, system, rng.choice([1, 2, 3]))
    options: dict[str, Any] = {"max_steps": MAX_STEPS, "threads": 1, "method": rng.choice(["rk4", "rk8"])}
    for key in ("duration", "step", "tolerance", "rate_tolerance", "cylinder_tolerance"):
        if rng.random() < 0.25:
            options[key] = rng.choice([x for x in NUMBERS if isinstance(x, float) and 0 < x < np.inf])
    options["check_half_step"] = rng.choice(["none", "sample", "all"])
    if rng.random() < 0.3:
        options["variables"] = rng.sample([*variables(SYSTEMS[system]), *SYSTEMS[system].derived], 3)

    def run() -> None:
        ds = label_points(system, copy.deepcopy(columns), **options)
        _check_columns({str(name): ds[name].values for name in ds.data_vars}, ds.sizes["point"])

    try:
        return _outcome(run)
    except BaseException as error:
        error.add_note(f"label_points({system!r}, {columns!r}, **{options!r})")
        raise


def try_csv(rng: Random) -> str:
    """Read a table of odd fields, some of it changed; without a change its numbers are those of the fields."""
    names = rng.sample([*SYSTEMS["satellite"].parameters, "index"], rng.randint(1, 5))
    names[0] = rng.choice(NAMES) if rng.random() < 0.2 else names[0]
    names = ["index", "m"] if names == ["index"] else names  # a table without a parameter is refused
    separator, count = rng.choice(",;\t"), rng.choice([0, 1, 1, 2, 2, 3, 4])
    rows = [[_field(rng) for _ in names] for _ in range(count)]
    rows = [row for row in rows if separator.join(row).strip()]  # other rows would be empty lines
    lines = [separator.join(fields) for fields in (names, *rows)]
    for _ in range(rng.choice([0, 0, 1, 3])):
        lines.insert(rng.randint(0, len(lines)), rng.choice(["", "# a comment", "  ", "\t#"]))
    text = whole = rng.choice(["\n", "\r\n", "\r"]).join(lines) + rng.choice(["", "\n"])
    for _ in range(rng.choice([0, 0, 1, 3])):
        i = rng.randrange(len(text) + 1)
        text = (
            text[:i]
            + rng.choice(["", '"', ",", ";", "\0", "\n", "x", "\ufeff", "\ud7ff", '""'])
            + text[i + 1 :]
        )

    def read() -> None:
        system = SYSTEMS["satellite"]
        columns = tables.read_csv(io.StringIO(text, None), "odd.csv", system.parameters)
        if text == whole and not any("#" in name for name in names):
            for i, name in enumerate(names):
                if name in system.parameters:
                    np.testing.assert_array_equal(
                        columns[name], [float(row[i].strip() or "nan") for row in rows]
                    )
        tables.point_columns(system, columns)

    return _outcome(read)


def _field(rng: Random) -> str:
    """A field of a table, a number in most cases."""
    if rng.random() < 0.85:
        return (
            rng.choice([" ", "", "+"]) + str(rng.choice(USUAL)) if rng.random() < 0.9 else str(_number(rng))
        )
    return rng.choice(["", " ", "1,5", "1_0", "0x1", "nan", "-inf", "1e", "\u0661", "a b", "'1'", "1" * 5000])


def try_tie(rng: Random) -> str:
    """Evaluate random arithmetic; its value is that of Python's own evaluator with NumPy's numbers."""
    system = SYSTEMS["satellite"]
    text = _expression(rng, system, 4)

    def evaluate() -> None:
        tie = expressions.Expression("ties.u", text)
        values = {name: np.array([rng.choice(USUAL), 0.3, -2.0]) for name in sorted(tie.names)}
        if tie.names & expressions.FUNCTIONS.keys():  # such names are unknown to scenes
            return
        tree = ast.parse(tie.text, mode="eval")
        for i, node in enumerate([each for each in ast.walk(tree) if isinstance(each, ast.Constant)]):
            name, number = f"number_{i}", node.value  # of NumPy, whose numbers can be divided by 0
            values[name] = np.asarray(float(number) if number <= HUGE else np.inf)
            node.__class__, node.id, node.ctx = ast.Name, name, ast.Load()
        with np.errstate(all="ignore"):
            expected = eval(
                compile(tree, "tie", "eval"), expressions.FUNCTIONS | expressions.CONSTANTS | values
            )
        np.testing.assert_array_equal(np.broadcast_to(tie.value(values), 3), np.broadcast_to(expected, 3))

    return _outcome(evaluate)


def _check_columns(values: dict[str, np.ndarray], size: int) -> None:
    """Assert that every column has a value for each point, and that points not computed or not finite have no label."""
    assert all(column.shape == (size,) for column in values.values())
    if "label" in values and "error_estimate" in values and "status" in values:
        label, status = values["label"], values["status"]
        not_computed = np.isin(status, (0, 7))
        assert (label[(status > 1) & ~not_computed] == 4).all()
        assert ((label == 0) == not_computed).all()


def _outcome(run: Any) -> str:
    """ "ok", or the message of BadInput, checked; warnings are errors."""
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        try:
            run()
        except BadInput as error:
            message = str(error)
            assert message.isprintable(), message
            assert 0 < len(message) <= MAX_MESSAGE, message
            return message
    return "ok"


def use_interpreted_kernels(monkeypatch: Any) -> None:
    """Let the pipeline integrate with kernels that are neither compiled nor hashed, so that a new one takes only a moment."""
    modules: dict[Any, Any] = {}

    def kernel(plan: Plan) -> Any:
        terms = plan.specialization
        key = (plan.system.name, plan.settings.method, terms, plan.plugs)
        if key not in modules:
            modules[key] = plain_module(
                plan.system.equations, plan.settings.method, terms.zero, dict(terms.equal), plugs=plan.plugs
            )
        return modules[key]

    monkeypatch.setattr(Plan, "kernel", property(kernel))
    monkeypatch.setattr(Plan, "kernel_hash", "0" * 16)
