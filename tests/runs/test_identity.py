"""The identity of a run: a folder is continued, and its tiles are read, only where the same bits are computed."""

import ast
import importlib.util
import os
import shutil
import sys
from dataclasses import replace

import llvmlite
import netCDF4
import numba
import numpy as np
import pytest
import scipy

import atlas
from atlas import BadInput, sources
from atlas.kernel import machine_code
from atlas.label.plan import Plan
from atlas.runs import folder as folders
from atlas.runs import plan
from atlas.runs.plan import ScenePlan
from atlas.runs.run import RunFolder


@pytest.fixture(scope="module")
def scene(small_scene):
    return atlas.load_scene(small_scene)


@pytest.fixture
def run(scene, tmp_path):
    """An empty run folder."""
    return RunFolder.prepare(ScenePlan.of(scene), tmp_path / "run")


@pytest.fixture
def package(tmp_path, monkeypatch):
    """A copy of the package, which this process takes for the one that it has imported."""
    copy = tmp_path / "atlas"
    shutil.copytree(sources.PACKAGE, copy, ignore=shutil.ignore_patterns("__pycache__"))
    monkeypatch.setattr(sources, "PACKAGE", copy)
    monkeypatch.setattr(sources, "AT_IMPORT", sources.read())
    return copy


def test_the_copy_of_the_package_is_the_same_code(run, scene, package):
    run.check_same(ScenePlan.of(scene))


@pytest.mark.parametrize(
    "name",
    [
        "flags.py", "kernel/machine_code.py", "variables.py", "kernel/stepsize.py", "systems/satellite/families.py", "scene/grid.py",
        "label/theory.py", "measure/rates.py", "store/dataset.py", "store/tile.py", "runs/memory.py",
    ],
)  # fmt: skip
def test_a_run_is_not_continued_by_other_code(name, run, scene, package, monkeypatch):
    with open(package / name, "a") as file:
        file.write("\n")
    monkeypatch.setattr(sources, "AT_IMPORT", sources.read())  # a process that starts after the edit
    with pytest.raises(BadInput, match=r"differs in code \([0-9a-f]{16} in the folder, [0-9a-f]{16} now\)$"):
        run.check_same(ScenePlan.of(scene))


def test_code_that_no_number_of_a_tile_depends_on_may_be_edited(run, scene, package, monkeypatch):
    (package / "plotting" / "style.py").write_text("")
    monkeypatch.setattr(sources, "AT_IMPORT", sources.read())
    run.check_same(ScenePlan.of(scene))


def edit(file):
    file.write_text(file.read_text().replace("REGULAR_PRECESSION", "PERMANENT_ROTATION"))


def edit_and_hide(file):
    """The same size and time of change."""
    status = file.stat()
    file.write_bytes(file.read_bytes()[:-2] + b"#\n")
    os.utime(file, ns=(status.st_atime_ns, status.st_mtime_ns))
    assert file.stat().st_size == status.st_size


def edit_and_undo(file):
    """What was imported in the meantime is the edited code."""
    original = file.read_bytes()
    file.write_bytes(b"")
    file.write_bytes(original)


@pytest.mark.parametrize("change", [edit, edit_and_hide, edit_and_undo, os.remove], ids=lambda f: f.__name__)
def test_a_process_whose_files_changed_after_the_import_is_refused(change, run, scene, package):
    change(package / "label" / "theory.py")
    with pytest.raises(
        BadInput, match=r"theory\.py was written after this process .* had imported it"
    ) as refused:
        run.check_same(ScenePlan.of(scene))
    assert len(str(refused.value).splitlines()) == 1


def test_a_file_that_appears_after_the_import_is_noticed(scene, package):
    (package / "kernel" / "new.py").write_text("")
    with pytest.raises(BadInput, match=r"new\.py was written after"):
        plan.identity(Plan.of(scene))


@pytest.mark.parametrize(
    ("name", "owner", "attribute", "value"),
    [
        ("atlas", plan, "__version__", "9.9"),
        ("architecture", machine_code, "architecture", lambda: "another"),
        ("kernel", Plan, "kernel_hash", "0" * 16),
        ("NUMBA_SLP_VECTORIZE", numba.config, "SLP_VECTORIZE", 1),
        ("numpy", np, "__version__", "9.9"),
        ("numba", numba, "__version__", "9.9"),
        ("llvmlite", llvmlite, "__version__", "9.9"),
        ("scipy", scipy, "__version__", "9.9"),
        ("netCDF4", netCDF4, "__version__", "9.9"),
        ("HDF5", netCDF4, "__hdf5libversion__", "9.9"),
        ("libc", plan.platform, "libc_ver", lambda: ("glibc", "0.1")),
        ("library_bits", plan, "library_bits", lambda: "0" * 16),
    ],
)
def test_a_run_is_not_continued_where_one_program_or_the_processor_differs(
    name, owner, attribute, value, run, scene, monkeypatch
):
    run.check_same(ScenePlan.of(scene))
    monkeypatch.setattr(numba.config, "reload_config", lambda: None)
    monkeypatch.setattr(owner, attribute, value)
    with pytest.raises(BadInput, match=rf"It differs in {name} \([^()]+ in the folder, [^()]+ now\)$"):
        run.check_same(ScenePlan.of(scene))


def test_a_worker_that_computes_other_bits_writes_nothing(run, scene, monkeypatch):
    other = plan.identity(Plan.of(scene)) | {"code": "0" * 16}
    monkeypatch.setattr(folders, "identity", lambda plan: other)
    folders._open_cached.cache_clear()
    refused = rf"would compute other bits; .* It differs in code \({run.manifest['identity']['code']} in the run, 0+ in"
    for refusing in (
        lambda: folders.compute_tile(str(run.path), None, run.key, 0),
        lambda: folders.check_worker(str(run.path), None, run.key),
    ):
        with pytest.raises(BadInput, match=refused) as error:
            refusing()
        assert len(str(error.value).splitlines()) == 1
    assert list(run.tiles.place.path.iterdir()) == []


def test_a_worker_refuses_another_run_of_the_same_name(run):
    folders._open_cached.cache_clear()
    with pytest.raises(BadInput, match="holds another run on the machine of this worker"):
        folders.compute_tile(str(run.path), None, "0" * 64, 0)


def test_the_code_of_a_system_of_ones_own_is_part_of_the_identity(scene, tmp_path, monkeypatch):
    file = tmp_path / "my_system.py"

    def identity_with(text: str):
        file.write_text(text)
        spec = importlib.util.spec_from_file_location("my_system", file)
        module = importlib.util.module_from_spec(spec)
        monkeypatch.setitem(sys.modules, "my_system", module)
        spec.loader.exec_module(module)
        return plan.identity(Plan.of(replace(scene, system=module.Mine())))

    text = "from atlas.systems.satellite import SATELLITE\nclass Mine(type(SATELLITE)):\n    pass\n"
    first = identity_with(text)
    changed = identity_with(
        text + "    def frequency_bound(self, points):\n        return 7.0 + 0.0 * points['A']\n"
    )
    assert {name for name in changed if changed[name] != first.get(name)} == {"system_code"}
    assert "system_code" not in plan.identity(Plan.of(scene))


def test_differences_name_what_is_missing_on_one_side():
    text = plan.differences({"a": "1", "b": "2"}, {"b": "2", "c": "3"}, "there", "here")
    assert text == "a (1 there, nothing here), c (nothing there, 3 here)"
    assert plan.differences({"a": "1"}, {"a": "1"}, "there", "here") == ""


def test_sources_are_hashed_before_any_of_them_is_imported():
    """What `atlas/__init__.py` imports before could be older than its hash."""
    tree = ast.parse((sources.PACKAGE / "__init__.py").read_text())
    names = [
        f"{node.module or node.names[0].name}.py"
        for node in tree.body
        if isinstance(node, ast.ImportFrom) and node.level
    ]
    assert not sources.AT_IMPORT.keys() & set(names[: names.index("sources.py")])
