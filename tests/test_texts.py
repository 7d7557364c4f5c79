"""Texts of files, folders and command lines: one printable line wherever they are printed or drawn."""

import ast
import io
import itertools
import json
import logging
from pathlib import Path

import numpy as np
import pytest
from matplotlib.text import Text

import atlas
from atlas import BadInput, load_scene
from atlas.cli import main
from atlas.errors import MAX_MESSAGE, MAX_TEXT
from atlas.files import process_name
from atlas.runs.status import status as status_of

pytestmark = pytest.mark.usefixtures("whole_kernels")

PACKAGE = Path(atlas.__file__).parent
# A screen is cleared, a line is forged, writing turns round, half a character; longer than a text may be.
HOSTILE = "\x1b[2J\ndone\u202e\udcff" + "<b>A</b>" * 100
# In turn also what is no formula, what would take long to set, letters without a glyph, and what is no text.
VALUES = (
    HOSTILE, r"$\nonsense{$" + HOSTILE, f"${'A' * 3_000_000}$", f"${'{' * 3000}{'}' * 3000}$", "$\u4e2d_0$ \u4e2d", 3,
    np.arange(5.0),
)  # fmt: skip


@pytest.fixture(scope="module")
def ds(small_scene):
    return atlas.run(load_scene(small_scene), progress=False)


def changed(ds, values):
    """The atlas with these values in turn in its text attributes, but for those that name its system and its flags."""
    ds, values = ds.copy(), itertools.cycle(values)
    keep = ("atlas_system", "atlas_scene", "flag_meanings")
    for owner in (ds, *ds.variables.values()):
        owner.attrs = {
            name: next(values) if isinstance(old, str) and name not in keep else old
            for name, old in owner.attrs.items()
        }
    return ds


def is_clean(text):
    return all(line.isprintable() and len(line) <= MAX_MESSAGE + len("atlas: ") for line in text.split("\n"))


@pytest.mark.long
@pytest.mark.parametrize("first", range(3))
def test_attributes_of_any_kind_are_drawn_and_printed_in_clean_lines(ds, first, caplog):
    hostile = changed(ds, VALUES[first:] + VALUES[:first])
    figure = hostile.atlas.map("psi_dot_mean", caption=True, boundary=False)
    figure.savefig(svg := io.BytesIO(), format="svg")  # a warning of Matplotlib is an error here
    assert "\x1b" not in svg.getvalue().decode()
    texts = [text.get_text() for text in figure.findobj(Text)]
    assert all(map(is_clean, texts))
    assert max(map(len, texts)) > MAX_TEXT
    assert is_clean(hostile.atlas.compare())
    lines = hostile.atlas.cite().split("\n")
    assert len(lines) == 3
    assert all(map(str.isprintable, lines))
    assert not caplog.records


@pytest.mark.long
def test_attributes_are_read_by_the_functions_that_clean_them():
    """A text that is read in another way could reach a terminal or a figure."""
    rooms = ("analysis", "cli", "extensions", "plotting")
    files = [PACKAGE / "accessor.py", *(path for room in rooms for path in (PACKAGE / room).rglob("*.py"))]
    for path in files:
        if path.name == "metadata.py":
            continue
        for node in ast.walk(ast.parse(path.read_text())):
            read = None
            match node:
                case ast.Subscript(value=ast.Attribute(attr="attrs"), slice=ast.Constant(value=name)):
                    read = name
                case ast.Call(func=ast.Attribute(value=ast.Attribute(attr="attrs"), attr="get")):
                    read = "get"
            # texts of the program itself, printed at the end of its own run
            own = path.parent.name == "studies" and path.name != "convergence.py"
            assert read is None or own, path


@pytest.mark.parametrize(
    ("attributes", "words"),
    [
        ({"atlas_step": "a"}, "the attribute atlas_step is no number"),
        ({"atlas_rate_tolerance": [1, 2]}, "the attribute atlas_rate_tolerance is no number"),
        ({"atlas_scene": 3}, "atlas_scene is no text"),
    ],
)
def test_attributes_of_a_wrong_type_are_refused(ds, attributes, words):
    damaged = ds.assign_attrs(attributes)
    with pytest.raises(BadInput, match=words.replace("\\\\", "\\\\\\\\")):
        damaged.atlas.map(caption=True)


def test_variables_of_a_wrong_type_or_shape_are_refused(ds):
    texts = ds.assign(label=ds.label.astype(str))
    for question in (texts.atlas.map, texts.atlas.compare):
        with pytest.raises(BadInput, match="label: values of type <U"):
            question()
    for question in (ds.assign_coords(Omega="one").atlas.compare, ds.assign_coords(m=1j).atlas.trajectory):
        with pytest.raises(
            BadInput, match=r"(Omega|m): values of type (<U3|complex128); an atlas has numbers"
        ):
            question()
    with pytest.raises(BadInput, match="label and growth_rate lie along different dimensions"):
        ds.assign(growth_rate=ds.growth_rate.mean("sigma")).atlas.compare()
    row = ds.assign(theta_dot_rms=ds.theta_dot_rms.mean("sigma"))
    assert row.atlas.map("theta_dot_rms").axes[0].get_xlabel() == r"$\theta_0$ (rad)"
    equal = ds.assign_coords(sigma=np.ones(ds.sigma.size))
    with pytest.raises(BadInput, match="sigma: its values are equal or not finite"):
        equal.atlas.map()


# The command line.


@pytest.mark.parametrize(
    "arguments",
    [
        ["compare", "a.nc", HOSTILE],
        ["compare", HOSTILE[:40] + ".nc"],
        ["map", "a.nc", "--colors", HOSTILE],
        ["trajectory", "a.nc", "--at", HOSTILE],
        ["run", "none.toml", "-o", "r/", "--shard", f"1/{'9' * 4400}"],
        ["run", "none.toml", "--threads", "9" * 5000],
        [HOSTILE],
    ],
)
def test_a_wrong_argument_is_answered_in_one_clean_line(arguments, capsys, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    try:
        code = main(arguments)
    except SystemExit as stop:
        code = stop.code
    printed = capsys.readouterr()
    assert (code, printed.out) == (2, "")
    assert printed.err.endswith("\n")
    assert is_clean(printed.err[:-1])
    assert "\n" not in printed.err[:-1]


def test_names_of_files_are_printed_clean(capsys, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert main(["new", "conditions_k3", "-o", "a\x1b[2J\nb.toml"]) == 0
    (line,) = capsys.readouterr().out.splitlines()
    assert line.startswith(r"wrote a\x1b[2J\nb.toml; next: ")
    assert line.endswith(r" map 'a\x1b[2J\nb.nc' --no-boundary")


def test_messages_of_the_log_are_clean(caplog):
    logging.getLogger("atlas").warning("%s", HOSTILE)
    (record,) = caplog.records
    assert is_clean(record.getMessage())


@pytest.mark.long
def test_a_hostile_progress_file_is_printed_in_its_line_or_not_read(longer):
    _, run, _ = longer
    numbers = {"done": 1, "points": 2, "points_per_second": 3.0, "running": False}

    def status(words):
        texts = dict.fromkeys(("shard", "host", "written", "process"), words)
        (run.path / f"progress-{process_name()}.json").write_text(json.dumps(numbers | texts))
        text = status_of(run.path)
        assert is_clean(text)
        return text

    # No process writes a lone surrogate, which is no UTF-8: such a file is not one of this package.
    assert len(status(HOSTILE).splitlines()) == 3
    text = status(HOSTILE.replace("\udcff", ""))
    assert len(text.splitlines()) == 4
    assert r"shard \x1b[2J\ndone\u202e<b>A" in text
