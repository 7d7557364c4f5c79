"""What docs/stability.md promises: names, options, keys, numbers of flags, and the warning before anything goes."""

import json
import logging
from importlib import import_module
from pathlib import Path

import pytest

from atlas.errors import deprecated, messages_for_shell

ROOT = Path(__file__).parents[1]
PROMISED = json.loads((ROOT / "tests" / "reference" / "public.json").read_text())


@pytest.fixture
def tool(monkeypatch):
    """The script that writes the snapshot."""
    monkeypatch.syspath_prepend(ROOT / "scripts" / "tools")
    return import_module("make_public")


@pytest.fixture
def every_extension():
    """Skip a test where an extension of this package is not installed."""
    missing = PROMISED["extensions"].keys() - import_module("atlas.extension").extensions().keys()
    if missing:
        pytest.skip(f"needs {', '.join(sorted(missing))}")


@pytest.mark.usefixtures("every_extension")
def test_nothing_public_is_missing_or_has_another_value(tool):
    """What a minor release has warned of is removed by `python scripts/tools/make_public.py --remove`."""
    assert tool.lost(PROMISED, tool.public()) == []


@pytest.mark.usefixtures("every_extension")
def test_what_is_new_is_recorded(tool):
    """By `python scripts/tools/make_public.py`."""
    assert tool.lost(tool.public(), PROMISED) == []


def test_what_is_lost_is_named(tool):
    before = {
        "variables": {"label": {"flags": {"ok": 1, "differ": 2}}, "gone": {}},
        "atlas": {"run": ["scene", "out"]},
    }
    now = {"variables": {"label": {"flags": {"ok": 1, "differ": 3}}}, "atlas": {"run": ["scene", "new"]}}
    assert tool.lost(before, now) == [
        "/variables/label/flags/differ: 2 or 3",
        "/variables/gone",
        "/atlas/run/out",
    ]


@pytest.mark.parametrize("remove", [False, True])
def test_the_script_removes_nothing_by_itself(tool, remove, tmp_path, monkeypatch, capsys):
    file = tmp_path / "public.json"
    file.write_text(json.dumps({"atlas": {"run": ["scene"], "old": []}}))
    monkeypatch.setattr(tool, "SNAPSHOT", file)
    monkeypatch.setattr(tool, "public", lambda: {"atlas": {"run": ["scene", "out"]}})
    monkeypatch.setattr("sys.argv", ["make_public.py", *(["--remove"] if remove else [])])
    before = file.read_text()
    assert tool.main() == int(not remove)
    assert capsys.readouterr().out == "gone: /atlas/old\nnew: /atlas/run/out\n"
    assert (file.read_text() == before) is not remove


def test_a_deprecation_is_shown_at_the_line_of_the_user():
    namespace = {"__name__": "atlas.example", "deprecated": deprecated}
    exec(
        "def old():\n    return inner()\ndef inner():\n    deprecated('`old`', '`new`', '1.2')\n    return 1",
        namespace,
    )
    with pytest.warns(
        FutureWarning, match=r"^`old` is deprecated, and version 1\.2 removes it: use `new`$"
    ) as warned:
        assert namespace["old"]() == 1
    assert warned[0].filename == __file__


def test_a_command_logs_a_deprecation(caplog):
    with messages_for_shell(), caplog.at_level(logging.WARNING):
        deprecated("--old", "--new", "1.2")
    assert caplog.messages == ["--old is deprecated, and version 1.2 removes it: use --new"]
