"""Extensions: what is left without one, names given twice, records and parts that cannot be loaded, what a run records."""

import re
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import atlas
from atlas import BadInput, cli, extension, systems
from atlas.extension import PARTS, Extension, extensions
from atlas.label.plan import Plan
from atlas.runs import plan
from atlas.systems.base import families_of, stress_cases_of
from atlas.systems.satellite import SATELLITE
from atlas.variables import variables

ALL = extensions()
OWN = [name for name, each in ALL.items() if each.package.startswith("atlas.extensions.")]
TOP = """
schema = 1
system = "fixed_point"
[fixed]
Mg = 1.0
z0 = 0.5
N = 0.1
C = 0.7
[axes.n]
values = [0.3, 0.6]
[axes.theta0]
values = [0.0, 0.8]
[integration]
duration = 5.0
"""


def run(text):
    return atlas.run(atlas.load_scene(text), progress=False)


@pytest.fixture(scope="module")
def whole(small_scene_text, whole_kernels):
    """Plain scenes of both systems, and their atlases with all extensions."""
    return {text: run(text) for text in (small_scene_text, TOP)}


@pytest.fixture(scope="module")
def small_scene_text():
    return (Path(__file__).parent / "small.toml").read_text()


@pytest.mark.usual("branches", "equilibria")
@pytest.mark.parametrize("name", OWN)
def test_a_plain_atlas_is_the_same_without_an_extension(name, whole, without_extension):
    without_extension(name)
    for text, expected in whole.items():
        ds = run(text)
        assert list(ds.variables) == list(expected.variables)
        for variable in ds.variables:
            assert ds[variable].values.tobytes() == expected[variable].values.tobytes()
            assert str(ds[variable].attrs) == str(expected[variable].attrs)


@pytest.mark.parametrize(
    ("name", "part"), [(e, p) for e in OWN for p in PARTS if getattr(extensions()[e], p)]
)
def test_what_an_extension_gives_is_refused_without_it(name, part, scene_text, without_extension, capsys):
    given = list(getattr(extensions()[name], part))
    without_extension(name)
    if part == "questions":
        with pytest.raises(AttributeError, match=given[0]):
            getattr(atlas.label_points("satellite", {}, duration=1.0, progress=False).atlas, given[0])
    elif part == "functions":
        owner = atlas.systems if given[0].startswith("systems.") else atlas
        with pytest.raises(AttributeError, match=given[0].removeprefix("systems.")):
            getattr(owner, given[0].removeprefix("systems."))
    elif part == "commands":
        with pytest.raises(SystemExit) as ended:
            cli.main([given[0]])
        assert ended.value.code == 2
        message = capsys.readouterr().err
        assert f"argument COMMAND: '{given[0]}': " in message
        assert "allowed: run, " in message
    elif part == "variables":
        outputs = f'[outputs]\nvariables = ["{given[0]}"]\n'
        text = TOP if name == "amer2013" else scene_text({})
        with pytest.raises(BadInput, match=rf"outputs\.variables: '{given[0]}' is unknown"):
            atlas.load_scene(text.partition("[outputs]")[0] + outputs)
        needing = "".join(
            f"; the extension {each} cannot be loaded (it needs the extension {name}, which is missing)"
            for each in OWN
            if name in ALL[each].needs
        )
        installed = f"^extensions: '{name}' is not installed; installed: [a-z0-9_, ]+{re.escape(needing)}$"
        with pytest.raises(BadInput, match=installed):
            atlas.load_scene(f'extensions = ["{name}"]\n{text.partition("[outputs]")[0]}{outputs}')
    elif part == "methods":
        with pytest.raises(BadInput, match=f"^{given[0]}: the system satellite has no function"):
            getattr(SATELLITE, given[0])({})
    elif part == "families":
        with pytest.raises(BadInput, match=rf"family\.name = '{given[0]}': of a missing extension"):
            run(scene_text({"family": {"name": given[0]}}))
        assert given[0] in variables(SATELLITE)["family"].flags  # which files list all the same


def module(folder, name, record, **files):
    """A package with a record and modules in a folder."""
    package = folder / name
    package.mkdir()
    (package / "__init__.py").write_text(record)
    for key, text in files.items():
        (package / f"{key}.py").write_text(text)
    return package


def test_families_of_others_have_flags_after_the_reserved_ones(
    installed_extensions, tmp_path, monkeypatch, scene_text
):
    """And after the reserved ones, which stay as they are; the name of a family of the system is refused."""
    module(tmp_path, "tumbling", "", theory="""
from atlas.systems.base import Condition, Family
NEVER = Condition("1 = 0", lambda points: 1.0 + 0.0 * points["n"])
def families(system):
    return {"tumbling": Family("tumbling", title="tumbles", conditions=(NEVER,))} if system.frame == "orbital" else {}
def repeated(system):
    return {"cylindrical": Family("cylindrical", conditions=(NEVER,))}
""")  # fmt: skip
    monkeypatch.syspath_prepend(tmp_path)
    before = variables(SATELLITE)["family"].flags
    new = Extension("tumbling", "tumbling", "more families", families={"tumbling": "theory:families"})
    installed_extensions({**extensions(), "tumbling": new})
    assert list(variables(SATELLITE)["family"].flags.items()) == [*before.items(), ("tumbling", "tumbles")]
    assert families_of(SATELLITE)["tumbling"].flag == len(before)
    assert atlas.load_scene(scene_text({"family": {"name": "tumbling"}})).family == "tumbling"
    for families, why in (
        ({"cylindrical": "theory:repeated"}, "cylindrical: the system has one too"),
        ({"rolling": "theory:families"}, "tumbling: its record does not name it"),
    ):
        new = Extension("tumbling", "tumbling", "more families", families=families)
        installed_extensions({**extensions(), "tumbling": new})
        message = f"^the system satellite: an extension has a family {why}; rename one$"
        with pytest.raises(BadInput, match=message):
            atlas.load_scene(scene_text({}))


def test_a_subclass_of_the_satellite_is_its_authors_own_system(monkeypatch):
    """Its families are those that it inherits, without families of extensions that are about the equations of the satellite."""

    class Mine(type(SATELLITE)):
        name, title = "mine", "a satellite of my own"

    monkeypatch.setattr(systems, "SYSTEMS", dict(systems.SYSTEMS))
    mine = systems.register(Mine)
    ds = atlas.label_points("mine", {"theta0": 0.3}, duration=1.0, progress=False)
    assert list(families_of(mine)) == list(SATELLITE.families)
    assert ds.family.flag_meanings.split() == ["none", *SATELLITE.families]
    assert "plane_period" not in variables(mine)


@pytest.mark.long
def test_a_broken_record_leaves_everything_else_working(tmp_path):
    """In processes that find it by its entry point."""
    module(tmp_path, "broken_record", "raise RuntimeError('no\\nsuch library')")
    info = tmp_path / "broken_record-1.0.dist-info"
    info.mkdir()
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: broken-record\nVersion: 1.0\n")
    (info / "entry_points.txt").write_text("[atlas.extensions]\nbroken = broken_record:EXTENSION\n")
    code = (
        f"import sys; sys.path.insert(0, {str(tmp_path)!r})\n"
        "from atlas import extension\nfrom atlas.systems import SYSTEMS\nfrom atlas.systems.base import families_of\n"
        "print([*extension.extensions(), *families_of(SYSTEMS['satellite'])])\n"
        "import atlas\n"
        'try: atlas.load_scene(\'schema = 1\\nsystem = "satellite"\\n[axes.m]\\nvalues = [1.0]\\n[outputs]\\nvariables = ["x"]\')\n'
        "except atlas.BadInput as error: print(error)\n"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    found, message = done.stdout.splitlines()
    assert found == str([*OWN, *families_of(SATELLITE)])
    why = "; the extension broken cannot be loaded (RuntimeError: no such library)"
    assert message.endswith(why)
    code = (
        f"import sys; sys.path.insert(0, {str(tmp_path)!r})\n"
        "from atlas import cli\n"
        "try: cli.main(['mapp'])\n"
        "except SystemExit as end: print(end.code, flush=True)\n"
        "cli.main(['--help'])\n"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    printed, _, help_text = done.stdout.partition("\n")
    assert printed == "2"
    assert done.stderr.startswith("atlas: argument COMMAND: 'mapp': did you mean 'map'? allowed: run, ")
    assert done.stderr.count("\n") == 1
    assert f"{why} (see atlas --help)" in done.stderr
    assert f"143 terminated (SIGTERM){why}." in " ".join(help_text.split())


def test_a_part_that_cannot_be_imported_is_as_if_missing(
    installed_extensions, tmp_path, monkeypatch, scene_text
):
    module(tmp_path, "half_broken", "", theory="import no_such_library")
    monkeypatch.syspath_prepend(tmp_path)
    broken = Extension(
        "half",
        "half_broken",
        "nothing",
        variables={"new": "theory:variables"},
        functions={"new": "theory:new"},
    )
    kept = {"half": broken, **extensions()}
    installed_extensions(kept)
    assert atlas.load_scene(scene_text({})).extensions == []
    why = r"the extension half cannot be loaded \(ModuleNotFoundError: No module named 'no_such_library'\)$"
    with pytest.raises(BadInput, match=rf"^outputs\.variables: 'new' is unknown; .*; {why}"):
        atlas.load_scene(scene_text({"outputs.variables": ["new"]}))
    with pytest.raises(BadInput, match=f"^{why}"):
        atlas.new  # noqa: B018


def test_records_import_nothing_but_the_lowest_rooms():
    code = (
        "import sys; sys.argv[0] = 'atlas'\n"
        "from atlas import extension\n"
        "assert all(extension.parts(kind) is not None for kind in extension.PARTS)\n"
        "print(*sorted(name for name in sys.modules if name.startswith('atlas')))\n"
        "sys.exit(any(name in sys.modules for name in ('numpy', 'numba', 'scipy', 'matplotlib', 'xarray')))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    low = {
        "atlas",
        *(f"atlas.{name}" for name in ("_version", "errors", "extension", "interruption", "sources")),
    }
    assert set(done.stdout.split()) == low | {
        *(["atlas.extensions"] if OWN else []),
        *(f"atlas.extensions.{name}" for name in OWN),
    }


def test_a_process_whose_extension_changed_after_the_import_is_refused(
    installed_extensions, tmp_path, monkeypatch
):
    package = module(tmp_path, "changing", "", theory="""
import numpy as np
from atlas.systems.base import DerivedVariable
def variables(system):
    return {"twice_m": DerivedVariable("twice_m", "s-1", "twice m", lambda points, *_: 2 * points["m"])}
""")  # fmt: skip
    monkeypatch.syspath_prepend(tmp_path)
    new = Extension("changing", "changing", "twice m", variables={"twice_m": "theory:variables"})
    installed_extensions({**extensions(), "changing": new})
    scene = atlas.load_scene(TOP + '[outputs]\nvariables = ["label", "twice_m"]\n')
    ds = atlas.run(scene, progress=False)
    assert scene.extensions == ["changing"]
    assert ds.attrs["atlas_extensions"] == f"changing {new.code}"
    np.testing.assert_array_equal(ds.twice_m, 0.0)
    (package / "theory.py").write_text("")
    with pytest.raises(BadInput, match=r"changing/theory\.py was written after this process"):
        plan.identity(Plan.of(scene))
    plan.identity(Plan.of(replace(scene, outputs=("label",))))


@pytest.mark.extension("catalogue")
def test_several_extensions_add_cases_and_equations_of_a_system(installed_extensions, tmp_path, monkeypatch):
    from atlas.extensions.catalogue.papers import published_equations

    module(tmp_path, "rows", "", theory="""
from atlas.extensions.catalogue.papers import rows
from atlas.systems.base import StressCase
def cases(system):
    return (StressCase(f"at rest, {system.name}", "a case of an extension", 1.0, {}),)
ROWS = rows({"equation": [{"number": "(1)", "printed": "0 = 0", "true": "the same", "verdict": "true"}]}, {})
""")  # fmt: skip
    monkeypatch.syspath_prepend(tmp_path)
    parts = {
        "stress_cases": {"satellite": "theory:cases"}, "published": {"satellite": "theory:ROWS"}
    }  # fmt: skip
    installed_extensions({name: Extension(name, "rows", "rows", **parts) for name in ("first", "second")})
    for rows, own in ((stress_cases_of, SATELLITE.stress_cases), (published_equations, tuple)):
        assert len(rows(SATELLITE)) == len(own()) + 2
    assert extension.parts("stress_cases")["satellite"][1] == "theory:cases"  # two extensions give some
    installed_extensions({})
    assert len(stress_cases_of(SATELLITE)) == len(SATELLITE.stress_cases())
