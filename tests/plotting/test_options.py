"""The options of maps are one list: the method, its documentation and the command have each of them."""

import inspect
import re
import subprocess
import sys
from dataclasses import fields

from atlas.accessor import Atlas
from atlas.cli import atlases
from atlas.cli.options import Parser
from atlas.plotting.options import MapOptions


def test_the_method_has_every_option_with_its_default_and_its_documentation():
    parameters = inspect.signature(Atlas.map).parameters
    assert list(parameters) == ["self", "variable", *(each.name for each in fields(MapOptions))]
    for each in fields(MapOptions):
        assert parameters[each.name].default == each.default
        assert parameters[each.name].kind is inspect.Parameter.KEYWORD_ONLY
    documented = re.findall(r"^([a-z, ]+) : ", inspect.getdoc(Atlas.map), re.MULTILINE)
    assert [name for names in documented for name in names.split(", ")] == list(parameters)[1:]


def test_the_command_has_every_option_but_axes_of_matplotlib():
    commands = Parser().add_subparsers()
    atlases.draw_map.add(commands)
    parser = commands.choices["map"]
    options = vars(parser.parse_args(["a.nc"]))
    assert {each.name for each in fields(MapOptions)} - options.keys() == {"ax"}
    assert {name: options[name] for name in ("boundary", "legend", "caption", "width", "dpi", "size")} == {
        "boundary": True, "legend": True, "caption": False, "width": "column", "dpi": None, "size": None,
    }  # fmt: skip
    words = "a.nc --no-boundary --no-legend --caption --width page --x m --select n=1 --select k3=2 --dpi 90"
    options = vars(parser.parse_args(words.split()))
    assert (options["boundary"], options["legend"], options["caption"]) == (False, False, True)
    assert (options["width"], options["x"], options["dpi"]) == ("page", "m", 90.0)
    assert options["select"] == ["n=1", "k3=2"]


def test_the_list_of_options_imports_no_matplotlib():
    code = "import sys, atlas.plotting.options; sys.exit('matplotlib' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0
