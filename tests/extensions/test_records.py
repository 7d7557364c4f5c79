"""Records of extensions: the names in them are those of what they load."""

import re
import subprocess
import sys
from pathlib import Path

import pytest

from atlas import extension
from atlas.systems import SYSTEMS

ROOT = Path(__file__).parents[2]


@pytest.mark.parametrize("kind", ["instruments", "variables"])
@pytest.mark.parametrize("each", extension.extensions().values(), ids=lambda each: each.name)
def test_names_are_those_of_the_objects(each, kind):
    for reference in {*getattr(each, kind).values()}:
        names = [name for name, own in getattr(each, kind).items() if own == reference]
        part = each.load(reference)
        if kind == "instruments":
            made = [[variable.name for variable in part.every_variable(s)] for s in SYSTEMS.values()]
        else:
            made = [[*part(system)] for system in SYSTEMS.values()]
        assert names in made


def test_the_stub_of_the_faces_is_current():
    script = ROOT / "scripts" / "tools" / "make_faces.py"
    assert subprocess.run([sys.executable, script, "--check"], cwd=ROOT, check=False).returncode == 0


def test_the_core_names_no_extension():
    """Neither as a module nor in a string; "page" is also a width of figures, "published" what a row of a paper is."""
    own = [name for name, each in extension.extensions().items() if each.package.startswith("atlas.")]
    names, quoted = "|".join(own), "|".join(name for name in own if name not in ("page", "published"))
    pattern = re.compile(rf"\bextensions[./]({names})\b|[\"']({quoted})[\"']")
    package = ROOT / "atlas"
    core = [path for path in package.rglob("*.py") if path.relative_to(package).parts[0] != "extensions"]
    assert len(core) > 100
    assert [path.name for path in core if pattern.search(path.read_text())] == []


def test_extensions_need_what_they_import():
    """Records name the other extensions that their modules import; equations of yehia2021 say so where one is missing."""
    package = ROOT / "atlas" / "extensions"
    for name, each in extension.extensions().items():
        if each.package.startswith("atlas.") and name != "yehia2021":
            texts = [path.read_text() for path in (package / name).rglob("*.py")]
            others = {other for text in texts for other in re.findall(r"^\s*from \.\.([a-z]\w*)", text, re.M)}
            assert others <= set(each.needs), name


def test_an_extension_without_one_that_it_needs_is_missing_by_name(installed_extensions):
    """So is one that needs it in turn; the others stay."""
    records = {
        name: extension.Extension(name, name, name, needs=needs, functions={name: "module:function"})
        for name, needs in (
            ("first", ["absent"]),
            ("second", ["first"]),
            ("third", []),
            ("fourth", ["third"]),
        )
    }
    installed_extensions(records)
    assert [*extension.extensions()] == ["third", "fourth"]
    assert [*extension.parts("functions")] == ["third", "fourth"]
    assert extension.not_loaded() == (
        "; the extension first cannot be loaded (it needs the extension absent, which is missing)"
        "; the extension second cannot be loaded (it needs the extension first, which is missing)"
    )
