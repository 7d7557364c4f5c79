"""Commands that help to write scenes: schema."""

from __future__ import annotations

import argparse
import json
import re
import shlex
import tomllib
from importlib.resources import files
from importlib.resources.abc import Traversable
from pathlib import Path

from ..errors import BadInput, allowed_text, say, text_table
from ..files import atomic_write, writable
from ..interruption import called_as
from .options import DONE, Commands, add_command, default_name, force_option, out_option


def add_schema(commands: Commands) -> None:
    """Add the command `schema`."""
    command = add_command(
        commands,
        "schema",
        _schema,
        "print the JSON Schema of scenes, with which editors complete and check them",
    )
    out_option(command, "FILE", "write it to this file (.json)")
    force_option(command, "an existing file")


def _schema(options: argparse.Namespace) -> int:
    """Run the command `schema`; returns its exit code."""
    from ..scene.schema import scene_schema

    text = json.dumps(scene_schema(), indent=2)
    if options.out is None:
        say(*text.split("\n"))
        return DONE
    path: Path = writable(options.out, (".json",), force=options.force)
    path.write_text(text + "\n", encoding="utf-8")
    say(f"wrote {path}")
    return DONE


def add_new(commands: Commands) -> None:
    """Add the command `new`."""
    command = add_command(commands, "new", _new, "copy an example scene, to run it or to change it")
    command.add_argument("name", metavar="NAME", nargs="?", help="which example (default: list them)")
    out_option(command, "SCENE", "name of the copy (default: NAME.toml)")


def _new(options: argparse.Namespace) -> int:
    """Run the command `new`; returns its exit code."""
    scenes = examples()
    if options.name is None:
        rows = [(name, tomllib.loads(scene.read_text("utf-8"))["title"]) for name, scene in scenes.items()]
        say(*text_table([("example", "what it shows"), *rows]).split("\n"))
        say(f"{called_as()} new NAME copies one of them")
        return DONE
    name = options.name.removesuffix(".toml")
    if name not in scenes:
        raise BadInput(f"{options.name}: no such example; {allowed_text(name, scenes)}")
    out = writable(options.out or f"{name}.toml", (".toml",), force=True)
    if out.exists():
        raise BadInput(f"{out}: this file exists; -o gives the copy another name")
    with atomic_write(out) as temporary:
        temporary.write_bytes(scenes[name].read_bytes())
    figure = figure_options(scenes[name].read_text("utf-8"))
    atlas, command = shlex.quote(f"{default_name(str(out))}.nc"), called_as()
    say(f"wrote {out}; next: {command} run {shlex.quote(str(out))}, then {command} map {atlas}{figure}")
    return DONE


def figure_options(scene: str) -> str:
    """Options of `atlas map` in the comment "Figure: --option" of an example, after a blank."""
    match = re.search(r"^# Figure:((?: --[\w-]+)+)", scene, re.MULTILINE)
    return match[1] if match else ""


def examples() -> dict[str, Traversable]:
    """Example scenes by name: of the installed package, or of the folder configs/ next to it."""
    folder: Traversable = files("atlas") / "examples"
    if not folder.is_dir():
        folder = Path(__file__).parents[2] / "configs"
    scenes = {
        path.name.removesuffix(".toml"): path for path in folder.iterdir() if path.name.endswith(".toml")
    }
    return dict(sorted(scenes.items()))
