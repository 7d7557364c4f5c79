"""Systems of installed packages: found by their names, checked in one line, and part of what an atlas depends on."""

import os
import subprocess
import sys

import numpy as np
import pytest
import xarray as xr
from plugins import PENDULUM, PENDULUM_SCENE, install

import atlas
from atlas import cli, systems
from atlas.label.plan import Plan
from atlas.runs.plan import identity
from atlas.systems import arithmetic, check


@pytest.fixture
def folder(tmp_path, monkeypatch, own_systems):
    """A folder of installed packages."""
    packages = tmp_path / "packages"
    packages.mkdir()
    monkeypatch.syspath_prepend(packages)
    before = set(sys.modules)
    yield packages
    for name in set(sys.modules) - before:
        if str(packages) in str(getattr(sys.modules[name], "__file__", "")):
            del sys.modules[name]


@pytest.fixture
def pendulum(folder):
    install(folder, "pendulum_plugin", PENDULUM, {"pendulum": "pendulum_plugin:Pendulum"})
    return folder


@pytest.fixture
def scene_file(tmp_path):
    file = tmp_path / "pendulum.toml"
    file.write_text(PENDULUM_SCENE)
    return file


def error_of(name):
    with pytest.raises(atlas.BadInput) as caught:
        systems.get(name)
    text = str(caught.value)
    assert "\n" not in text
    return text


def test_a_name_is_found_and_only_then_imported(pendulum):
    assert "pendulum" in systems.names()
    assert "pendulum_plugin" not in sys.modules
    system = systems.get("pendulum")
    assert system.title == "pendulum with a spring"
    assert systems.get("pendulum") is system
    assert systems.origin(system).package == "some-systems 1.2"
    assert systems.origin(systems.get("satellite")) is None
    assert "pendulum" in systems.available()


@pytest.mark.long
def test_check_and_schema_find_it_without_a_compiler(pendulum, scene_file):
    program = (
        "import sys; from atlas.cli import main\n"
        f"assert main(['check', {str(scene_file)!r}]) == 0\n"
        "assert main(['schema']) == 0\n"
        "assert 'numba' not in sys.modules"
    )
    path = os.pathsep.join([str(pendulum), os.getcwd(), os.environ.get("PYTHONPATH", "")])
    done = subprocess.run(
        [sys.executable, "-c", program], env=os.environ | {"PYTHONPATH": path}, capture_output=True, text=True
    )
    assert done.returncode == 0, done.stderr
    assert "system pendulum: omega 12 x x0 9 = 108 points" in done.stdout
    assert "height_drift" in done.stdout


@pytest.mark.parametrize(
    ("text", "value", "message"),
    [
        ("import nothing_of_this_name", "broken:X", "cannot be imported: ModuleNotFoundError: No module named"),
        ("raise SystemExit('enough\\nof it')", "broken:X", "cannot be imported: SystemExit: enough of it"),
        ("x = 1", "broken:X", "cannot be imported: AttributeError"),
        ("class X: pass", "broken:X", "not an object of a subclass of atlas.systems.System"),
        ("from atlas.systems import System\nclass X(System):\n    name = title = 'broken'\n    equations = parameters = {}", "broken:X", "X.initial_state is missing"),
        (PENDULUM, "broken:Pendulum", "its name is 'pendulum'; the name of the entry point must be the same"),
        (
            PENDULUM + "    def __init__(self):\n        raise RuntimeError('not today')\n", "broken:Pendulum",
            "RuntimeError: not today",
        ),
    ],
)  # fmt: skip
def test_a_broken_package_is_one_line_and_disturbs_nothing_else(folder, text, value, message, caplog, capsys):
    install(folder, "broken", text, {"broken": value})
    error = error_of("broken")
    assert error.startswith("system = 'broken' of some-systems 1.2")
    assert message in error
    assert tuple(systems.available()) == systems.BUILT_IN
    assert message in caplog.text
    assert cli.main(["conditions", "broken"]) == cli.BAD_INPUT
    assert len(capsys.readouterr().err.splitlines()) == 1


def test_two_packages_with_one_name(pendulum):
    install(pendulum, "other", PENDULUM, {"pendulum": "other:Pendulum"}, "other-systems", "0.1")
    error = error_of("pendulum")
    assert "several packages have this system: other-systems 0.1, some-systems 1.2" in error


def test_names_of_this_package_cannot_be_taken(folder):
    text = PENDULUM.replace('name = "pendulum"', 'name = "satellite"')
    install(folder, "thief", text, {"satellite": "thief:Pendulum"})
    assert systems.get("satellite").title.startswith("magnetised")
    import thief

    with pytest.raises(atlas.BadInput, match="a system of this package has this name"):
        atlas.register(thief.Pendulum)


def test_an_unknown_name_lists_the_installed_ones(pendulum):
    names = ", ".join([*systems.BUILT_IN, "pendulum"])
    assert f"did you mean 'pendulum'? allowed: {names}" in error_of("pendulom")


@pytest.mark.long
def test_every_command_finds_it(pendulum, scene_file, tmp_path, capsys):
    out, night = tmp_path / "pendulum.nc", f"{tmp_path}/night/"
    scene = str(scene_file)
    assert cli.main(["run", scene, "-o", str(out), "--quiet"]) == cli.DONE
    assert cli.main(["run", scene, "-o", night, "--workers", "1", "--quiet"]) == cli.DONE
    assert cli.main(["join", night, "-o", str(tmp_path / "joined.nc")]) == cli.DONE
    assert cli.main(["map", str(out), "-o", str(tmp_path / "map.png")]) == cli.DONE
    motion = ["trajectory", scene, "--at", "omega=1", "x0=1", "-o"]
    assert cli.main([*motion, str(tmp_path / "motion.nc")]) == cli.DONE
    (tmp_path / "points.csv").write_text("omega,cubic,x0\n1.0,0.1,0.5\n2.0,0.1,0.1\n")
    points = ["points", "pendulum", str(tmp_path / "points.csv"), "--method", "rk8", "--quiet"]
    assert cli.main([*points, "-o", str(tmp_path / "labels.csv")]) == cli.DONE
    capsys.readouterr()
    assert cli.main(["compare", str(out)]) == cli.BAD_INPUT
    assert "theory predicts nothing of the system pendulum" in capsys.readouterr().err
    assert cli.main(["conditions", "pendulum"]) == cli.DONE
    assert capsys.readouterr().out.startswith("the system pendulum has no families of steady motions")
    with atlas.open_atlas(out) as ds, atlas.open_atlas(tmp_path / "joined.nc") as joined:
        assert ds.attrs["atlas_system_package"] == "some-systems 1.2"
        assert ds.attrs["atlas_frequency_bound"] == "numeric"
        assert ds.attrs["atlas_std_tolerance"] == "x 0.5, height 0.01"
        for name in ds.data_vars:
            np.testing.assert_array_equal(ds[name], joined[name])


def test_an_atlas_of_a_package_that_is_not_installed(folder):
    ds = xr.Dataset(attrs={"atlas_system": "pendulum", "atlas_system_package": "some-systems 1.2"})
    with pytest.raises(atlas.BadInput, match=r"not installed here; its package was .some-systems 1\.2."):
        ds.atlas.families()


def test_an_edit_makes_another_run_and_a_stale_process_is_refused(pendulum):
    scene = atlas.load_scene(PENDULUM_SCENE)
    before = identity(Plan.of(scene))
    assert before["system_package"] == "some-systems 1.2"
    file = pendulum / "pendulum_plugin.py"
    file.write_text(PENDULUM.replace("omega**2", "omega**4"))
    with pytest.raises(atlas.BadInput, match=r"pendulum_plugin.py was written after this process"):
        identity(Plan.of(scene))
    systems.SYSTEMS.pop("pendulum")
    del sys.modules["pendulum_plugin"]
    import importlib

    importlib.invalidate_caches()
    after = identity(Plan.of(atlas.load_scene(PENDULUM_SCENE)))
    assert {name for name in before if before[name] != after[name]} == {"system_code", "kernel"}


def test_a_registered_system_runs_in_threads_only(pendulum, tmp_path):
    import pendulum_plugin

    class Mine(pendulum_plugin.Pendulum):
        name = "mine"

    system = atlas.register(Mine)
    assert atlas.register(system) is system
    assert systems.origin(system).package == ""
    text = PENDULUM_SCENE.replace('"pendulum"', '"mine"')
    with pytest.raises(atlas.BadInput, match="registered in this process alone"):
        atlas.run(atlas.load_scene(text), f"{tmp_path}/night/", workers=1)
    ds = atlas.run(atlas.load_scene(text), progress=False)
    assert ds.attrs["atlas_system_package"].startswith("registered in the process")


@pytest.mark.parametrize("name", systems.BUILT_IN)
def test_systems_of_the_package_pass_the_checks_of_others(name):
    """They are not registered, and so not completed: their equations leave nothing out."""
    system = systems.SYSTEMS[name]
    # A coefficient of the paper, older than the check, which no expression can name.
    parameters = {key: parameter for key, parameter in system.parameters.items() if key != "lambda"}

    class Checked(type(system)):
        pass

    checked = Checked()
    checked.parameters = parameters
    check.check(checked)
    check.check_start(system)
    added = vars(arithmetic.completed(system.equations, ())).keys() - vars(system.equations).keys()
    assert added == {"OBSERVABLES", "SOURCES"}
