"""Notebooks to download: they are what their script makes of the pages, and their cells run."""

import importlib
import json
import sys
from pathlib import Path
from types import ModuleType

import matplotlib
import pytest
from matplotlib import pyplot

from atlas import systems
from atlas.extension import extensions

ROOT = Path(__file__).parent.parent
NOTEBOOKS = sorted((ROOT / "docs" / "notebooks").glob("*.ipynb"))
# Notebooks of many points; the usual tests run the same blocks, of their pages.
LONG = {"first_atlas", "my_satellite"}
EXTENSIONS = {"my_equations": {"studies"}, "my_satellite": {"branches", "equilibria"}}


@pytest.fixture
def script(monkeypatch):
    """The script that writes the notebooks."""
    monkeypatch.syspath_prepend(str(ROOT / "scripts" / "tools"))
    return importlib.import_module("notebooks")


@pytest.fixture
def shell(tmp_path, monkeypatch):
    """The shell in which a kernel runs the cells of a notebook, in an empty folder; its systems and figures go afterwards."""
    interactiveshell = pytest.importorskip("IPython.core.interactiveshell")
    config = importlib.import_module("traitlets.config").Config()
    config.HistoryManager.enabled = False
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("IPYTHONDIR", str(tmp_path / "ipython"))
    monkeypatch.setitem(sys.modules, "cells", module := ModuleType("cells"))
    known_systems = dict(systems.SYSTEMS)
    with matplotlib.rc_context({"backend": "agg"}):
        yield interactiveshell.InteractiveShell(user_module=module, config=config)
        pyplot.close("all")
    systems.SYSTEMS.clear()
    systems.SYSTEMS.update(known_systems)


def test_notebooks_are_made_from_their_pages(script):
    assert [notebook.stem for notebook in NOTEBOOKS] == sorted(script.NOTEBOOKS)
    for notebook in NOTEBOOKS:
        page, sections = script.NOTEBOOKS[notebook.stem]
        text = (ROOT / "docs" / f"{page}.md").read_text()
        assert f"](notebooks/{notebook.name})" in text
        assert all(f"\n## {section}\n" in text for section in sections)
        assert notebook.read_text() == script.notebook(page, sections)


@pytest.mark.usefixtures("whole_kernels", "short_timings", "coarse_lines")
@pytest.mark.parametrize(
    "notebook", [pytest.param(each, id=each.stem, marks=[pytest.mark.long] * (each.stem in LONG)) for each in NOTEBOOKS]
)  # fmt: skip
def test_the_cells_of_a_notebook_run(notebook, shell, capsys):
    if missing := EXTENSIONS.get(notebook.stem, set()) - extensions().keys():
        pytest.skip(f"needs {', '.join(sorted(missing))}")
    cells = json.loads(notebook.read_text())["cells"]
    for cell in cells:
        if cell["cell_type"] == "code":
            assert cell["outputs"] == []
            source = "".join(cell["source"])
            shell.run_cell(source).raise_error()
            printed = capsys.readouterr().out
            for line in source.splitlines():
                if line.startswith("# prints "):
                    assert line.removeprefix("# prints ") in printed
