"""The package: directions of its imports, cost of the command line, form of the registries."""

import ast
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import atlas
from atlas import sources
from atlas.systems import SYSTEMS
from atlas.systems.base import families_of
from atlas.variables import variables

PACKAGE = Path(atlas.__file__).parent
EQUATIONS = sorted(PACKAGE.rglob("equations.py"))


@pytest.mark.parametrize("path", EQUATIONS, ids=str)
def test_equations_import_nothing(path):
    assert not [
        node
        for node in ast.walk(ast.parse(path.read_text()))
        if isinstance(node, ast.Import | ast.ImportFrom)
    ]


def test_data_flows_one_way():
    """The order of the rooms is declared in pyproject.toml.

    In a process of its own: import-linter disables every logger that exists.
    """
    code = "from importlinter.cli import lint_imports; raise SystemExit(lint_imports(no_cache=True))"
    done = subprocess.run(
        [sys.executable, "-c", code], cwd=PACKAGE.parent, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stdout


def test_the_sources_on_which_numbers_depend_are_all_that_the_computation_imports():
    """What a tile is computed and written by, and what that imports, but for modules that no number passes through."""
    without_numbers = {
        "_version.py", "errors.py", "extension.py", "files.py", "hdf5.py", "interruption.py", "process.py", "sources.py",
        "store/__init__.py", "store/place.py", "store/progress.py", "store/tally.py",
    }  # fmt: skip
    for pattern in sources.NUMERIC_SOURCES:
        assert list(PACKAGE.glob(pattern)), f"{pattern}: there is no such file"
    imported, waiting = set(), ["label/pipeline.py", "label/points.py", "store/tile.py"]
    while waiting:
        path = PACKAGE / waiting.pop()
        if path in imported:
            continue
        imported.add(path)
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, ast.ImportFrom) and node.level:
                base = path.parents[node.level - 1].joinpath(*(node.module or "").split("."))
                for file in (
                    base.with_suffix(".py"),
                    base / "__init__.py",
                    *(base / f"{a.name}.py" for a in node.names),
                ):
                    if file.exists() and file != PACKAGE / "__init__.py":
                        waiting.append(file.relative_to(PACKAGE).as_posix())
    names = {path.relative_to(PACKAGE).as_posix() for path in imported}
    assert names - sources.read().keys() <= without_numbers
    assert len(names) > 80


@pytest.mark.parametrize("command", [["--help"], ["check", "configs/quickstart.toml"], ["--version"]])
def test_help_and_check_load_neither_compiler_nor_xarray(command):
    code = (
        "import sys; sys.argv[0] = 'atlas'; from atlas.cli import main\n"
        "try: main(sys.argv[1:])\n"
        "except SystemExit: pass\n"
        "unused = 'numba', 'llvmlite', 'matplotlib', 'scipy', 'xarray'\n"
        "sys.exit(any(name in sys.modules for name in unused))"
    )
    result = subprocess.run(
        [sys.executable, "-c", code, *command],
        cwd=PACKAGE.parent,
        capture_output=True,
        text=True,
        check=False,
    )
    assert result.returncode == 0, result.stderr


def test_extensions_and_the_compiler_are_loaded_by_what_uses_them():
    code = (
        "import sys, atlas, atlas.systems, atlas.label.pipeline, atlas.runs.execution\n"
        "sys.exit(any(name.startswith(('atlas.extensions', 'numba')) for name in sys.modules))"
    )
    assert subprocess.run([sys.executable, "-c", code], cwd=PACKAGE.parent, check=False).returncode == 0


@pytest.mark.long
def test_the_library_of_a_format_is_loaded_by_its_atlases_alone():
    code = (
        "import sys; sys.argv[0] = 'atlas'; from atlas.cli import parser; parser()\n"
        "if not sys.modules.keys().isdisjoint({'netCDF4', 'zarr'}): sys.exit(1)\n"
        "from pathlib import Path; import atlas.runs.folder; from atlas.store.finished import format_of; format_of(Path('a.nc'))\n"
        "sys.exit('zarr' in sys.modules)"
    )
    assert subprocess.run([sys.executable, "-c", code], cwd=PACKAGE.parent, check=False).returncode == 0


@pytest.mark.parametrize("system", SYSTEMS.values(), ids=lambda s: s.name)
def test_every_variable_is_described(system):
    for name, variable in variables(system).items():
        assert name == variable.name
        assert variable.long_name
        assert np.dtype(variable.dtype)
        if variable.flags is None:
            assert variable.units
        else:
            assert len(variable.flags) >= 2  # cf_xarray fails for a single flag
            assert all(" " not in flag for flag in variable.flags)


@pytest.mark.parametrize("system", SYSTEMS.values(), ids=lambda s: s.name)
def test_every_parameter_is_described(system):
    for name, parameter in system.parameters.items():
        assert name == parameter.name
        assert parameter.unit
        assert parameter.meaning


@pytest.mark.parametrize("system", SYSTEMS.values(), ids=lambda s: s.name)
def test_families_are_numbered_in_order_and_solve_parameters_of_the_system(system):
    assert [f.flag for f in families_of(system).values()] == list(range(1, len(families_of(system)) + 1))
    for name, family in families_of(system).items():
        assert name == family.name
        assert set(family.solve) <= set(system.parameters)
        assert family.geometry in {"", *system.geometries}


def test_what_is_released_is_the_same_everywhere():
    root = Path(__file__).parents[1]
    citation, changelog = (root / "CITATION.cff").read_text(), (root / "CHANGELOG.md").read_text()
    assert re.search(r"^version: (.+)$", citation, re.MULTILINE)[1] == atlas.__version__
    released = re.search(rf"^## \[{re.escape(atlas.__version__)}\] - (\S+)$", changelog, re.MULTILINE)
    date = re.search(r"^date-released: (.+)$", citation, re.MULTILINE)
    assert (released and released[1]) == (date and date[1])


def test_no_hint_names_the_package_on_an_index():
    root = Path(__file__).parents[1]
    files = [*root.glob("*.md"), *(root / "docs").rglob("*.md"), *(root / "atlas").rglob("*.py")]
    assert [
        f.name
        for f in files
        if re.search(r"install\W+precession-atlas", f.read_text()) and f.name != "CONTRIBUTING.md"
    ] == []
