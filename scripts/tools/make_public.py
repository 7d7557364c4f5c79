"""Write tests/reference/public.json: what docs/stability.md promises, from the registries.

python scripts/tools/make_public.py [--check] [--remove]

Something new is added; what the file has and the package has no longer, or with another value, is an error without --remove.
"""

from __future__ import annotations

import argparse
import inspect
import json
import math
import sys
from collections.abc import Callable, Iterator, Mapping
from dataclasses import fields
from pathlib import Path
from typing import Any

import atlas
from atlas import extension, flags, systems
from atlas.accessor import questions
from atlas.cli import parser
from atlas.scene.model import Settings
from atlas.scene.schema import scene_schema
from atlas.store.dataset import provenance
from atlas.systems import plugins
from atlas.systems.base import System, families_of
from atlas.variables import data_variables

SNAPSHOT = Path(__file__).parents[2] / "tests" / "reference" / "public.json"

Public = dict[str, dict[str, Any]]


def parameters(value: object) -> list[str]:
    """Parameters of a function or method, in their order; none of a class or a value."""
    if isinstance(value, type) or not callable(value):
        return []
    return [name for name in inspect.signature(value).parameters if name not in ("self", "ds")]


def commands() -> dict[str, list[str]]:
    """Options of every command, and its arguments in capitals."""
    top = parser()
    (named,) = (action for action in top._actions if isinstance(action, argparse._SubParsersAction))
    return {
        name: sorted(word for action in each._actions for word in action.option_strings or [action.metavar])
        for name, each in {"": top, **named.choices}.items()
    }


def scene_keys(schema: Mapping[str, Any], path: str = "") -> Iterator[tuple[str, object]]:
    """Keys of a scene, NAME for a name of the user's choice, with their defaults, or the values that are allowed."""
    inner = dict(schema.get("properties", {}))
    if isinstance(schema.get("additionalProperties"), dict):
        inner["NAME"] = schema["additionalProperties"]
    for name, each in inner.items():
        if name != "NAME":
            yield f"{path}{name}", each.get("default", each.get("const"))
            for value in () if name == "system" else each.get("enum", ()):  # others may be installed
                yield f"{path}{name} = {value}", None
        yield from scene_keys(each, f"{path}{name}.")


def of_systems(entries: Callable[[System], Mapping[str, Any]]) -> dict[str, Any]:
    """Entries of each system of this package, by their names behind that of the system."""
    return {
        f"{name}.{key}": value
        for name in systems.BUILT_IN
        for key, value in entries(systems.get(name)).items()
    }


def variable(each: Any) -> dict[str, object]:
    """What a file says of a variable: type, and unit or the numbers of its flags."""
    if each.flags is None:
        return {"dtype": each.dtype, "units": each.units}
    return {"dtype": each.dtype, "flags": {name: number for number, name in enumerate(each.flags)}}


def public() -> Public:
    """Everything that is promised."""
    return {
        "atlas": {name: parameters(getattr(atlas, name)) for name in atlas.__all__},
        "ds.atlas": {name: parameters(question) for name, question in questions().items()},
        "atlas.systems": {name: parameters(getattr(systems, name)) for name in systems.__all__},
        "commands": commands(),
        "scene": dict(scene_keys(scene_schema())),
        "parameters": of_systems(
            lambda system: {
                name: {"unit": each.unit, "default": None if math.isnan(each.default) else each.default}
                for name, each in system.parameters.items()
            }
        ),
        "families": of_systems(
            lambda system: {
                name: {"flag": each.flag, "solve": list(each.solve)}
                for name, each in families_of(system).items()
            }
        ),
        "variables": of_systems(
            lambda system: {name: variable(each) for name, each in data_variables(system).items()}
        ),
        "flags": {
            name: {flag.name.lower(): flag.value for flag in each}
            for name, each in vars(flags).items()
            if isinstance(each, type) and issubclass(each, flags.Flag) and each is not flags.Flag
        },
        "attributes": dict.fromkeys(provenance(systems.get("satellite"), Settings(), "", warnings=[])),
        "extensions": dict.fromkeys(
            name for name, each in extension.extensions().items() if each.package.startswith("atlas.")
        ),
        "entry points": {
            extension.GROUP: [each.name for each in fields(extension.Extension)],
            plugins.GROUP: [name for name in dir(System) if not name.startswith("_")],
        },
    }


def lost(before: Any, now: Any, path: str = "") -> list[str]:
    """What one of two such values has and the other has not, or has otherwise; a line for each."""
    if isinstance(before, dict) and isinstance(now, dict):
        return [
            line
            for key, value in before.items()
            for line in (lost(value, now[key], f"{path}/{key}") if key in now else [f"{path}/{key}"])
        ]
    if isinstance(before, list) and isinstance(now, list):
        return [f"{path}/{each}" for each in before if each not in now]
    return [] if before == now else [f"{path}: {before} or {now}"]


def text(everything: Public) -> str:
    """The file: a line for each entry, in alphabetical order."""
    rooms = (
        f"{json.dumps(room)}: {{\n"
        + ",\n".join(f"{json.dumps(key)}: {json.dumps(entries[key])}" for key in sorted(entries))
        + "\n}"
        for room, entries in everything.items()
    )
    return "{\n" + ",\n".join(rooms) + "\n}\n"


def main() -> int:
    options = argparse.ArgumentParser(description=__doc__)
    options.add_argument("--check", action="store_true", help="write nothing")
    options.add_argument("--remove", action="store_true", help="also what a minor release has warned of")
    chosen = options.parse_args()
    before, now = json.loads(SNAPSHOT.read_text(encoding="utf-8")), public()
    gone, new = lost(before, now), lost(now, before)
    for word, lines in (("gone", gone), ("new", new)):
        for line in lines:
            print(f"{word}: {line}")
    if chosen.check or (gone and not chosen.remove):
        return int(bool(gone or new))
    SNAPSHOT.write_text(text(now), encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
