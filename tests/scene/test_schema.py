"""The JSON Schema of scenes: every scene of configs/ is valid, scenes with mistakes are not."""

import json
import tomllib
from pathlib import Path

import jsonschema
import pytest
from installed import example_scenes

from atlas import BadInput
from atlas.cli import main
from atlas.scene.read import scene_from
from atlas.scene.schema import scene_schema
from atlas.systems import SYSTEMS
from atlas.systems.base import families_of
from atlas.variables import variables

ROOT = Path(__file__).parents[2]
SCENES = [*example_scenes(), ROOT / "tests" / "small.toml"]
SMALL = (ROOT / "tests" / "small.toml").read_text()
SAMPLE = '[points]\nsample = "sobol"\ncount = 8\n[points.ranges.sigma]\nfrom = 0.3\nto = 1.7\n'
SAMPLED = SMALL[: SMALL.index("[axes")] + SAMPLE + SMALL[SMALL.index("[ties]") :]


@pytest.fixture(scope="module")
def validator():
    schema = scene_schema()
    jsonschema.Draft202012Validator.check_schema(schema)
    return jsonschema.Draft202012Validator(schema)


@pytest.mark.parametrize("path", SCENES, ids=lambda path: path.stem)
def test_scenes_of_the_package_are_valid(path, validator):
    validator.validate(tomllib.loads(path.read_text()))


@pytest.mark.parametrize("path", SCENES, ids=lambda path: path.stem)
def test_resolved_scenes_are_valid(path, validator):
    validator.validate(tomllib.loads(scene_from(tomllib.loads(path.read_text())).toml()))


VALID = [
    ("duration = 30.0", 'duration = "1 orbit"'),
    ("duration = 30.0", 'duration = "2.5e1 turns"'),
    ("[labels]", '[about]\nsummary = "a"\nkeywords = ["b"]\nlicence = "MIT"\ncreator.name = "c"\n[labels]'),
    ("from = 0.3\nto = 1.7\ncount = 9", "values = [0.3, 1]"),
    ("[ties]", "[axes.k3]\nfrom = -0.1\nto = 0.1\ncount = 3\noffset_from_family = true\n[ties]"),
    ("[labels]", "[refine]\nlevels = 2\n[labels]"),
    *(("[labels]", f"[labels]\ntransient = {value}") for value in ("0", "20.5", '"5 turns"', '"20 / Omega"')),
]


@pytest.mark.parametrize(("old", "new"), VALID, ids=[new[:20] for _, new in VALID])
def test_valid_scenes(old, new, validator):
    assert old in SMALL
    table = tomllib.loads(SMALL.replace(old, new, 1))
    scene_from(table)
    validator.validate(table)


def test_a_sample_is_valid(validator):
    scene_from(tomllib.loads(SAMPLED))
    validator.validate(tomllib.loads(SAMPLED))


INVALID = [
    (SMALL, "schema = 1", "schema = 2"),
    (SMALL, "[labels]", "[labels]\ntransient = -1.0"),
    (SMALL, "[labels]", "[labels]\ntransient = true"),
    (SMALL, "schema = 1\n", ""),
    (SMALL, '"satellite"', '"sputnik"'),
    (SMALL, 'title = "small"', "colour = 3"),
    (SMALL, "A = 1.0", 'A = "one"'),
    (SMALL, "A = 1.0", "A = 0.0"),
    (SMALL, "Omega = 1.0", "Omega = -1"),
    (SMALL, "Omega = 1.0", "Omega = 1\n'2a' = 1"),
    (SMALL, "Omega = 1.0", "Omega = 1\nsin = 1"),
    (SMALL, "count = 9", "count = 0"),
    (SMALL, "count = 9", "count = 2.5"),
    (SMALL, "count = 9\n", ""),
    (SMALL, "count = 9", "count = 9\nvalues = [1.0]"),
    (SMALL, "count = 9", "count = 9\nstride = 2"),
    (SMALL, "count = 9", "count = 9\nspacing = 'cubic'"),
    (SMALL, "[ties]", "[axes.B]\nfrom = -1\nto = 2\ncount = 3\n[ties]"),
    (SMALL, 'B = "A"', "B = 3"),
    (SMALL, "perp_velocity", "banana"),
    (SMALL, 'name = "perp_velocity"\n', ""),
    (SMALL, '["k3"]', '["Omega"]'),
    (SMALL, '["k3"]', '["k3", "k3"]'),
    (SMALL, "[nudge]\n", "[nudge]\nA = 1\n"),
    (SMALL, "duration = 30.0", 'duration = "20 days"'),
    (SMALL, "duration = 30.0", "duration = 0"),
    (SMALL, "tolerance = 1e-5", "tolerance = 10"),
    (SMALL, "tolerance = 1e-5", "tolerance = 1e-5\nstep = 0.1"),
    (SMALL, "tolerance = 1e-5", "tolernce = 1e-5"),
    (SMALL, "tolerance = 1e-5", 'method = "euler"'),
    (SMALL, "tolerance = 1e-5", "max_steps = 1.5"),
    (SMALL, "[labels]", "[labels]\ndrift_tolerance = -1"),
    (SMALL, "[labels]", "[refine]\nlevels = 9\n[labels]"),
    (SMALL, "[labels]", "[refine]\nprobe = 0.1\n[labels]"),
    (SMALL, "[labels]", '[outputs]\nvariables = ["colour"]\n[labels]'),
    (SMALL, "[labels]", "[outputs]\nvariables = []\n[labels]"),
    (SMALL, "[labels]", "[about]\nauthor = 'a'\n[labels]"),
    (SMALL, "[labels]", "[about]\ncreator.phone = 'a'\n[labels]"),
    (SMALL, "[labels]", "[about]\nkeywords = [1]\n[labels]"),
    (SMALL, "[ties]", SAMPLE + "[ties]"),
    (SAMPLED, "count = 8", ""),
    (SAMPLED, "count = 8", "count = 8\nfile = 'a.csv'"),
    (SAMPLED, "from = 0.3", "from = 0.3\ncount = 3"),
    (SAMPLED, "[ties]", "[refine]\nlevels = 2\n[ties]"),
    (SAMPLED, '"sobol"', '"grid"'),
]  # fmt: skip


@pytest.mark.parametrize(
    ("text", "old", "new"), INVALID, ids=[f"{new[:25]} for {old[:25]}" for _, old, new in INVALID]
)
def test_scenes_with_a_mistake_are_neither_valid_nor_read(text, old, new, validator):
    assert old in text
    table = tomllib.loads(text.replace(old, new, 1))
    assert not validator.is_valid(table)
    with pytest.raises(BadInput):
        scene_from(table)


def test_the_schema_describes_every_parameter_family_and_variable(validator):
    text = json.dumps(scene_schema(), ensure_ascii=False)
    for system in SYSTEMS.values():
        for name, parameter in system.parameters.items():
            assert f'"{name}": ' in text
            assert parameter.meaning in text
        for family in families_of(system).values():
            assert family.title in text
        for variable in variables(system).values():
            assert variable.long_name in text
    # The parameters of one system are none of the other's nudges.
    table = tomllib.loads(SMALL) | {"nudge": {"gamma10": 0.1}}
    assert not validator.is_valid(table)


def test_the_command_prints_and_writes_the_schema(tmp_path, capsys):
    assert main(["schema"]) == 0
    assert json.loads(capsys.readouterr().out) == json.loads(json.dumps(scene_schema()))
    path = tmp_path / "scene.json"
    assert main(["schema", "-o", str(path)]) == 0
    assert json.loads(path.read_text()) == json.loads(json.dumps(scene_schema()))
    assert main(["schema", "-o", str(path)]) == 2
    assert main(["schema", "-o", str(tmp_path / "scene.txt")]) == 2
