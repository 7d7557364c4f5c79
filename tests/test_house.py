"""The house: who may import whom, what the command line costs, and one registry for all."""

import ast
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import atlas
from atlas.systems import SYSTEMS
from atlas.variables import variables

PACKAGE = Path(atlas.__file__).parent
ABOVE = {"xarray", "dask", "distributed", "matplotlib", "netCDF4", "cf_xarray", "pandas"}
# Rooms in the order of the flow of data; a room imports only from itself and the rooms before it.
FLOW = [
    {"systems", "engine"},
    {"variables", "ties", "points"},
    {"scene"},
    {"grid", "labels", "progress", "cluster"},
    {"compare"},
    {"evaluate", "store", "folder"},
    {"accuracy", "refine"},
    {"runner"},
    {"follow", "catalogue", "stress"},
    {"maps", "accessor"},
    {"figures"},
    {"cli"},
]


def imports(path: Path) -> set[str]:
    """Top-level names that a file imports: other packages by name, rooms of atlas as .room."""
    found = set()
    inside = path.relative_to(PACKAGE).parts
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Import):
            found |= {alias.name.split(".")[0] for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.level == 0:
            found.add((node.module or "").split(".")[0])
        elif isinstance(node, ast.ImportFrom):
            base = inside[: len(inside) - node.level]
            if base:
                found.add("." + base[0])
            elif node.module:
                found.add("." + node.module.split(".")[0])
            else:
                found |= {"." + atlas._FACE.get(alias.name, alias.name) for alias in node.names}
    return found - {".__version__"}


def files(*parts: str) -> list[Path]:
    return sorted(PACKAGE.joinpath(*parts).rglob("*.py"))


@pytest.mark.parametrize("path", files("engine") + files("systems"), ids=str)
def test_engine_and_physics_know_nothing_above_them(path):
    found = imports(path)
    assert not found & ABOVE
    own = "." + path.relative_to(PACKAGE).parts[0]
    assert {name for name in found if name.startswith(".")} <= {own}


@pytest.mark.parametrize("path", [p for p in files("systems") if p.name == "equations.py"], ids=str)
def test_equations_import_nothing(path):
    assert imports(path) == set()


def test_data_flows_one_way():
    rank = {room: i for i, rooms in enumerate(FLOW) for room in rooms}
    for path in files():
        room = path.relative_to(PACKAGE).parts[0].removesuffix(".py")
        if room in ("__init__", "__main__"):
            continue
        for name in imports(path):
            if name.startswith(".") and name != ".":
                assert rank[name[1:]] <= rank[room], f"{path} imports {name}"


@pytest.mark.parametrize("command", [["--help"], ["check", "configs/quickstart.toml"], ["--version"]])
def test_help_and_check_load_no_compiler(command):
    code = (
        "import sys; from atlas.cli import main\n"
        "try: main(sys.argv[1:])\n"
        "except SystemExit: pass\n"
        "sys.exit(any(name in sys.modules for name in ('numba', 'llvmlite', 'matplotlib')))"
    )
    done = subprocess.run(
        [sys.executable, "-c", code, *command],
        cwd=PACKAGE.parent,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr


@pytest.mark.parametrize("system", SYSTEMS.values(), ids=lambda s: s.name)
def test_registries_are_whole(system):
    for name, variable in variables(system).items():
        assert name == variable.name
        assert variable.long_name
        assert np.dtype(variable.dtype)
        if variable.flags is not None:
            assert len(variable.flags) >= 2  # cf_xarray breaks on one
            assert all(" " not in flag for flag in variable.flags)
    for name, parameter in system.parameters.items():
        assert name == parameter.name
        assert parameter.unit
        assert parameter.meaning
    assert [f.flag for f in system.families.values()] == list(range(1, len(system.families) + 1))
    for family in system.families.values():
        assert set(family.solve) <= set(system.parameters)
        assert family.geometry in {"", *system.geometries}
