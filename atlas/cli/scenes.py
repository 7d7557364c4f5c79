"""Commands that help to write scenes: schema."""

from __future__ import annotations

import argparse
import json
from pathlib import Path

from ..errors import say
from ..files import writable
from .options import DONE, Commands, add_command, force_option, out_option


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
