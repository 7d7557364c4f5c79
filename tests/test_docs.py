"""README and docs: code blocks run, tables are those of the registries, links lead to files."""

import ast
import contextlib
import importlib
import io
import json
import re
import sys
import textwrap
from pathlib import Path

import matplotlib
import pytest
from matplotlib import pyplot
from PIL import Image

import atlas
from atlas import cli, systems
from atlas.accessor import Atlas
from atlas.extension import extensions
from atlas.extensions.catalogue.papers import published_numbers
from atlas.flags import Status

ROOT = Path(__file__).parent.parent
PAGES = [
    "README.md",
    "ARCHITECTURE.md",
    "CONTRIBUTING.md",
    *sorted(f"docs/{path.name}" for path in (ROOT / "docs").glob("*.md")),
]
BLOCK = re.compile(r"^```([^\n`]+)\n(.*?)^```", re.M | re.S)
SET_UP = ("sh", ".", "pip", "pipx")  # commands that make the environment in which the tests run
CELL = "{code-cell} ipython3"
# Extensions that the code of a page uses.
EXTENSIONS = {
    "README.md": {"page"},
    "docs/accuracy.md": {"studies"},
    "docs/api.rst": {
        "attitude",
        "basins",
        "branches",
        "catalogue",
        "equilibria",
        "frequencies",
        "margins",
        "page",
        "periodic",
        "sections",
    },
    "docs/basins.md": {"basins", "equilibria"},
    "docs/branches.md": {"branches"},
    "docs/chaos.md": {"frequencies"},
    "docs/fixed_point.md": {"equilibria"},
    "docs/fixed_point_checks.md": {"amer2013"},
    "docs/gallery.md": {"amer2013", "basins", "page"},
    "docs/how_to.md": {"basins", "branches", "catalogue", "equilibria", "margins", "studies", "yehia2021"},
    "docs/labels.md": {"certificate"},
    "docs/my_satellite.md": {"attitude", "branches"},
    "docs/my_top.md": {"attitude"},
    "docs/new_system.md": {"lagrangian", "studies"},
    "docs/page.md": {"page"},
    "docs/periodic.md": {"attitude", "periodic"},
    "docs/published.md": {"branches", "normal_form", "published"},
    "docs/satellite.md": {"equilibria"},
    "docs/scenes.md": {"equilibria"},
    "docs/sections.md": {"sections"},
    "docs/stress.md": {"studies"},
}


def skip_without_extensions(page):
    """Skip the code of a page that uses an extension that is not installed."""
    if missing := EXTENSIONS.get(page, set()) - extensions().keys():
        pytest.skip(f"needs {', '.join(sorted(missing))}")


def run_commands(text, install_example):
    """Run the commands of a block for the shell, as far as they are those of this package and its examples."""
    for line in text.splitlines():
        command = line.split("#")[0].split()
        if command[:1] == ["atlas"]:
            assert cli.main(command[1:]) == cli.DONE, line
        elif command[:1] == ["python"]:
            assert (ROOT / command[1]).is_file()
        elif command[:2] == ["pip", "install"] and command[2].startswith("./docs/examples/"):
            install_example(Path(command[2]).name)
        elif command:
            assert command[0] in SET_UP, line
            if command[0] == "sh":
                assert (ROOT / command[1]).is_file()


@pytest.fixture
def folder_of_reader(tmp_path, monkeypatch):
    """Empty working folder from which modules are imported; they, their systems and their figures go afterwards."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(tmp_path)
    known_systems = dict(systems.SYSTEMS)
    with matplotlib.rc_context({"backend": "agg"}):
        yield
        pyplot.close("all")
    systems.SYSTEMS.clear()
    systems.SYSTEMS.update(known_systems)
    for path in tmp_path.glob("*.py"):
        sys.modules.pop(path.stem, None)


@pytest.mark.usual("README.md", "docs/index.md", "docs/satellite.md")
@pytest.mark.usefixtures("whole_kernels", "short_timings", "coarse_lines", "folder_of_reader")
@pytest.mark.parametrize("page", PAGES)
def test_code_blocks_run(page, install_example):
    """A TOML block is saved as the scene of the blocks after it; commands of atlas and Python run in order.

    A block that begins with the name of a module is saved and imported. The cells of a notebook share their names.
    """
    skip_without_extensions(page)
    cells = {"__name__": "__main__"}
    for language, text in BLOCK.findall((ROOT / page).read_text()):
        if language == "toml":
            Path("first.toml").write_text(text)
        elif language == "python":
            if module := re.match(r"# (\w+)\.py\n", text):
                Path(f"{module[1]}.py").write_text(text)
                importlib.import_module(module[1])
                continue
            with contextlib.redirect_stdout(io.StringIO()) as printed:
                exec(compile(text, page, "exec"), {"__name__": "__main__"})
            for line in re.findall(r"^# prints (.+)", text, re.M):
                assert line in printed.getvalue()
        elif language == "sh":
            run_commands(text, install_example)
        elif language == CELL:
            exec(compile(text, page, "exec"), cells)


@pytest.mark.long
@pytest.mark.usefixtures("whole_kernels", "coarse_lines", "folder_of_reader")
def test_the_reference_has_an_example_of_each_function():
    skip_without_extensions("docs/api.rst")
    text = (ROOT / "docs" / "api.rst").read_text()
    blocks = re.findall(r"^\.\. code-block:: (\w+)\n\n((?:(?:   .*)?\n)+)", text, re.M)
    code = "".join(textwrap.dedent(block) for language, block in blocks if language == "python")
    (scene,) = [textwrap.dedent(block) for language, block in blocks if language == "toml"]
    Path("first.toml").write_text(scene)
    with contextlib.redirect_stdout(io.StringIO()):
        exec(compile(code, "api.rst", "exec"), {"__name__": "__main__"})
    functions = {name for name in atlas.__all__ if name not in ("__version__", "register")}
    assert {name for name in functions if f"atlas.{name}" not in code} == set()
    methods = [name for name in vars(Atlas) if not name.startswith("_")]
    assert [name for name in methods if f".atlas.{name}(" not in code] == []


@pytest.mark.parametrize("page", PAGES)
def test_links_lead_to_files_and_headings(page):
    for link in re.findall(r"\]\(([^)\s]+)\)", (ROOT / page).read_text()):
        if link.startswith("http"):
            continue
        name, _, anchor = link.partition("#")
        target = (ROOT / page).parent / name if name else ROOT / page
        assert target.exists(), link
        if anchor:
            assert anchor in anchors(target), link


def anchors(page):
    """Anchors of the headings of a page, made as GitHub and MyST make them."""
    headings = re.findall(r"^#+ (.*)", re.sub(BLOCK, "", page.read_text()), re.M)
    return {re.sub(r"[^\w\- ]", "", heading.lower()).replace(" ", "-") for heading in headings}


def test_architecture_names_functions_that_exist():
    text = (ROOT / "ARCHITECTURE.md").read_text()
    links = re.findall(r"\[`([^`]+)`\]\(((?:atlas|tests)/[\w/]+\.py)\)", text)
    assert len(links) > 25
    for name, path in links:
        tree = ast.parse((ROOT / path).read_text())
        if name == path:
            continue
        for part in name.split("."):
            tree = next(node for node in tree.body if getattr(node, "name", "") == part)


def test_pages_of_the_systems_are_short():
    pages = [page for name in ("satellite", "fixed_point") for page in (ROOT / "docs").glob(f"{name}*.md")]
    assert len(pages) == 8
    for page in pages:
        assert len(page.read_text().split()) < 3000, page


@pytest.mark.parametrize("page", PAGES)
def test_scripts_that_pages_name_exist(page):
    for script in re.findall(r"scripts/[\w/]+\.(?:py|sh)", (ROOT / page).read_text()):
        assert (ROOT / script).is_file(), script


def test_every_status_has_advice():
    advice = (ROOT / "docs/messages.md").read_text().split("| status | what to do |")[1]
    for status in Status.meanings():
        assert f"| `{status}` |" in advice


def test_the_paper_cites_what_its_bibliography_contains():
    paper = (ROOT / "docs/paper/paper.md").read_text()
    entries = re.findall(r"^@\w+\{(\w+),", (ROOT / "docs/paper/paper.bib").read_text(), re.M)
    assert set(re.findall(r"(?<!\w)@(\w+)", paper)) == set(entries)


def test_the_paper_and_the_readme_have_the_measured_times_of_the_docs():
    """`bench_peers.py --docs` writes all of them."""
    measured = (ROOT / "docs/accuracy.md").read_text()
    paper = (ROOT / "docs/paper/paper.md").read_text()
    (table,) = re.findall(r"<!-- peers_table -->\n(.*?)<!-- end -->", paper, re.S)
    assert len(re.findall(r"^\|.*(?: \| [\d.]+){3} \|$", table, re.M)) == 12
    assert table in measured
    times = re.findall(r"([\d.]+)\s+µs", (ROOT / "README.md").read_text())
    assert len(times) == 3
    for time in times:
        assert f"| {time} |" in table


def test_warnings_that_the_page_explains_exist():
    page = (ROOT / "docs/messages.md").read_text().split("## Warnings")[1]
    source = "".join(path.read_text() for path in (ROOT / "atlas").rglob("*.py"))
    warnings = re.findall(r"^\| (?!warning, or|---)(.*?) \|", page, re.M)
    assert len(warnings) > 5
    for warning in warnings:
        assert max(re.split(r" ?\.\.\.:? ?|\bN\b|\d+", warning), key=len).strip() in source, warning


def test_the_gallery_shows_its_pictures_with_all_their_colours():
    page = (ROOT / "docs" / "gallery.md").read_text()
    pictures = sorted((ROOT / "docs" / "gallery").glob("*.png"))
    assert re.findall(r"\(gallery/(\w+\.png)\)", page)
    assert sorted(re.findall(r"\(gallery/(\w+\.png)\)", page)) == [picture.name for picture in pictures]
    for picture in pictures:
        with Image.open(picture) as image:
            assert image.mode in ("RGB", "RGBA")  # no palette
        folders = ("configs", f"docs/examples/{picture.stem}")
        assert any((ROOT / folder / f"{picture.stem}.toml").is_file() for folder in folders)


@pytest.fixture
def gallery(monkeypatch):
    """The script that writes the gallery."""
    skip_without_extensions("docs/gallery.md")
    monkeypatch.syspath_prepend(str(ROOT / "scripts" / "tools"))
    return importlib.import_module("gallery")


def test_the_gallery_has_the_captions_and_commands_of_its_scenes(gallery):
    page = (ROOT / "docs" / "gallery.md").read_text()
    for picture in gallery.PICTURES:
        assert gallery.with_formulas(picture.caption) in page, picture.scene
        assert "\n".join(gallery.commands(picture)) in page, picture.scene


@pytest.mark.usual("conditions_k3")
@pytest.mark.usefixtures("whole_kernels", "coarse_lines", "folder_of_reader")
@pytest.mark.parametrize("scene", ["conditions_k3", "capture_damping"])
def test_the_python_of_the_gallery_draws_its_picture(scene, gallery, monkeypatch):
    """On a coarse grid; with an option of the map, and for a probability."""

    def coarse(name):
        axes = example(name)["axes"]
        return example(name, axes={axis: {"count": 4} for axis in axes})

    example = atlas.example
    monkeypatch.setitem(vars(atlas), "example", coarse)
    (picture,) = (each for each in gallery.PICTURES if each.scene == scene)
    ((_, code),) = (
        block for block in BLOCK.findall("\n".join(gallery.commands(picture))) if block[0] == "py"
    )
    exec(compile(code, scene, "exec"), {})
    assert Path(f"{scene}.png").stat().st_size > 10_000


def test_the_how_to_page_lists_its_questions_and_draws_its_pictures():
    first, *sections = re.split(r"^## ", (ROOT / "docs" / "how_to.md").read_text(), flags=re.M)
    listed = re.findall(r"\[([^\]]+)\]\(#", first)
    assert sorted(listed) == sorted(text[0].lower() + text[1 : text.index("\n")] for text in sections)
    drawn = [
        picture
        for text in sections
        for picture in re.findall(r"\(how_to/(\w+\.png)\)", text)
        if f'savefig("{picture}"' in text
    ]
    pictures = sorted((ROOT / "docs" / "how_to").iterdir())
    assert sorted(drawn) == [picture.name for picture in pictures]
    assert max(picture.stat().st_size for picture in pictures) < 40_000


@pytest.mark.parametrize("page", ["my_satellite", "my_top", "teaching"])
def test_pages_draw_their_pictures(page):
    text = (ROOT / "docs" / f"{page}.md").read_text()
    drawn = re.findall(r'savefig\("(\w+\.png)"', text)
    assert re.findall(rf"\({page}/(\w+\.png)\)", text) == drawn
    assert sorted(drawn) == [picture.name for picture in sorted((ROOT / "docs" / page).iterdir())]


@pytest.mark.parametrize(
    ("text", "latex"),
    [
        ("k1 = 0, or C m = k3 cos(theta0)", r"$k_{1} = 0$, or $C m = k_{3} \cos (\theta_{0})$"),
        (
            "theta_dot0 = 0 (or h1 != -sqrt(3) h3)",
            r"$\dot{\theta}_{0} = 0$ (or $h_{1} \ne - \sqrt{3} h_{3})$",
        ),
        ("w3 k1,2 = |Mg r_c|^2 A^-1", r"$\omega_{3} k_{1,2} = \lvert Mg r_{c} \rvert^{2} A^{-1}$"),
        ("l along the axis s of a one-sheet cone", "$l$ along the axis $s$ of a one-sheet cone"),
    ],
)
def test_conditions_are_set_as_formulas(text, latex, monkeypatch):
    monkeypatch.syspath_prepend(str(ROOT / "scripts" / "tools"))
    assert importlib.import_module("make_docs").in_latex(text) == latex


@pytest.mark.parametrize(
    ("text", "latex"),
    [
        (
            "A body with A != B, stable where (C r0 + l3)^2 > 4 A. At theta0 = 0 a top needs m.",
            r"A body with $A \ne B$, stable where $(C r_{0} + l_{3})^{2} > 4 A$. At $\theta_{0} = 0$ a top needs $m$.",
        ),
        (
            "- A list, 2 s, of T. S. Amer, (31b), `m = 0`, $n$ and a *word*.",
            "- A list, 2 s, of T. S. Amer, (31b), `m = 0`, $n$ and a *word*.",
        ),
        ("| a C/A | A < C | psi', (A > C) |", r"| a $C/A$ | $A < C$ | $\psi'$, $(A > C)$ |"),
    ],
)
def test_formulas_in_prose_are_set(text, latex, monkeypatch):
    monkeypatch.syspath_prepend(str(ROOT / "scripts" / "tools"))
    assert importlib.import_module("make_docs").with_formulas(text) == latex


@pytest.mark.long
def test_the_evidence_is_what_the_commands_of_its_script_count(monkeypatch):
    """The numbers of others are counted again; the other commands take minutes."""
    monkeypatch.syspath_prepend(str(ROOT / "scripts" / "tools"))
    checks, kept = (
        importlib.import_module("evidence").CHECKS,
        json.loads((ROOT / "docs" / "evidence.json").read_text()),
    )
    assert list(kept) == [name for name in checks if name in kept]
    for name, row in kept.items():
        assert row["command"] == checks[name].command
        assert row["version"] == atlas.__version__
        for path in re.findall(r"(?:tests|scripts|configs)/[\w/.]+", row["command"]):
            assert (ROOT / path).exists()
    if "published" not in extensions():
        pytest.skip("needs published")
    for system in ("satellite", "fixed_point"):
        rows = published_numbers(systems.get(system))
        differ = sum(row["verdict"] != "agrees" for row in rows)
        assert (kept[system]["compared"], kept[system]["differ"]) == (len(rows), differ)
