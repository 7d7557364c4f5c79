"""JSON Schema of scenes, from the registries of parameters, families, methods and variables: editors complete from it."""

from __future__ import annotations

from typing import Any

import numpy as np

from .. import systems as all_systems
from ..systems.base import Parameter, System
from ..variables import variables
from . import checks, points, read
from .expressions import RESERVED
from .model import SCHEMA, About, Refine, Settings

DIALECT = "https://json-schema.org/draft/2020-12/schema"
NAME = f"^(?!({'|'.join(sorted(RESERVED))})$)[A-Za-z_][A-Za-z0-9_]*$"
DURATION = r"^\s*[+]?[0-9.][0-9.eE+-]*\s*([Oo]rbits?|[Tt]urns?)?\s*$"

Schema = dict[str, Any]


def scene_schema() -> Schema:
    """JSON Schema (draft 2020-12) of scene files; only `load_scene` checks how keys depend on each other."""
    systems = list(all_systems.available().values())
    return {
        "$schema": DIALECT,
        "title": "Scene of Precession Atlas",
        "description": "A TOML file that describes one atlas",
        "type": "object",
        "required": ["schema", "system"],
        "additionalProperties": False,
        "properties": _properties(systems),
        "allOf": [
            {
                "if": {"properties": {"system": {"const": system.name}}, "required": ["system"]},
                "then": {"properties": _properties_of(system)},
            }
            for system in systems
        ],
        "oneOf": [
            {"required": ["axes"], "not": {"required": ["points"]}},
            {"required": ["points"], "not": {"anyOf": [{"required": ["axes"]}, {"required": ["refine"]}]}},
        ],
    }


def _properties(systems: list[System]) -> Schema:
    """The keys of a scene, as far as they are the same for every system."""
    text = {"type": "string", "description": "free text, kept in the atlas; the title of its figures"}
    names = {"type": "object", "propertyNames": {"pattern": NAME, "maxLength": checks.MAX_NAME}}
    integration = checks.table_schema(Settings, "integration")
    integration["properties"]["duration"] = {
        "anyOf": [checks.positive.schema, {"type": "string", "pattern": DURATION}],
        "default": 60.0,
        "description": 'time units, or "20 orbits" (satellite), "50 turns" (of n or m, whichever is slower)',
    }
    return {
        "schema": {"const": SCHEMA, "description": "version of the format"},
        "title": text,
        "system": {"enum": [s.name for s in systems], "description": "; ".join(f"{s.name}: {s.title}" for s in systems)},
        "about": _about(),
        "fixed": {**names, "description": "parameters, or names for ties, with one value", "additionalProperties": _NUMBER},
        "axes": {
            **names,
            "description": "the dimensions of the atlas: parameters, or names for ties",
            "minProperties": 1,
            "maxProperties": read.MAX_AXES,
            "additionalProperties": _axis(None),
        },
        "points": _points(),
        "ties": {
            **names,
            "description": "names computed from other names: + - * / **, sqrt, sin, cos, tan, asin, acos, atan, exp, log,"
            " abs, pi",
            "additionalProperties": {"type": "string"},
        },
        "family": {"type": "object", "required": ["name"], "description": "every point starts on these steady motions"},
        "nudge": {
            "type": "object",
            "description": "added to start values after solving",
            "additionalProperties": _NUMBER,
        },
        "integration": integration | {"not": {"required": ["step", "tolerance"]}},
        "labels": checks.table_schema(Settings, "labels"),
        "refine": checks.table_schema(Refine)
        | {"description": "integrate a finer grid near the borders of labels only"},
        "outputs": {"type": "object", "additionalProperties": False, "properties": {"variables": {"type": "array"}, "map": {"type": "string"}}},
    }  # fmt: skip


_NUMBER = checks.number.schema


def _properties_of(system: System) -> Schema:
    """What is particular to one system: its parameters, families and variables."""
    parameters = system.parameters.values()
    values = {p.name: _value(p) for p in parameters}
    starts = {p.name: _NUMBER | {"description": _described(p)} for p in parameters if p.start}
    names = {"type": "string", "enum": list(variables(system))}
    registry = variables(system)
    meanings = "; ".join(f"{name}: {variable.long_name}" for name, variable in registry.items())
    optional = [name for name, variable in registry.items() if variable.optional]
    schema = {
        "fixed": {"properties": values},
        "axes": {"properties": {p.name: _axis(p) for p in parameters}},
        "ties": {"properties": {p.name: {"type": "string", "description": _described(p)} for p in parameters}},
        "nudge": {"properties": starts, "additionalProperties": False},
        "outputs": {
            "properties": {
                "variables": {"items": names, "minItems": 1, "description": f"variables of the atlas (default: all but {', '.join(optional) or 'none'}). {meanings}"},
                "map": names | {"description": "the variable that the map and the page show first"},
            }
        },
    }  # fmt: skip
    if system.families:
        schema["family"] = {"oneOf": [_family(name, system) for name in system.families]}
    if system.observables:
        observables = [observable.name for observable in system.observables]
        schema["labels"] = {"properties": {"std_tolerance": {"propertyNames": {"enum": observables}}}}
    return schema


def _family(name: str, system: System) -> Schema:
    """The table [family] for one family."""
    family = system.families[name]
    conditions = "; ".join(condition.text for condition in family.conditions)
    solve = {
        "type": "array",
        "uniqueItems": True,
        "description": "parameters that put each point on the family",
    }
    if family.solve:
        solve["items"] = {"enum": list(family.solve)}
    else:
        solve["maxItems"] = 0
    return {
        "title": name,
        "additionalProperties": False,
        "properties": {
            "name": {"const": name, "description": f"{family.title}: {conditions}"},
            "solve": solve,
        },
    }


def _described(parameter: Parameter) -> str:
    """Meaning and unit of a parameter."""
    return f"{parameter.meaning} ({parameter.unit})"


def _limits(parameter: Parameter) -> Schema:
    """The range of a parameter."""
    limits: Schema = {}
    if np.isfinite(parameter.low):
        limits["exclusiveMinimum" if parameter.open_low else "minimum"] = parameter.low
    if np.isfinite(parameter.high):
        limits["maximum"] = parameter.high
    return limits


def _value(parameter: Parameter) -> Schema:
    """One value of a parameter."""
    default = {} if np.isnan(parameter.default) else {"default": parameter.default}
    return _NUMBER | {"description": _described(parameter)} | default | _limits(parameter)


def _axis(parameter: Parameter | None) -> Schema:
    """The table of an axis; None: of a name that is no parameter."""
    keys = {
        "from": _NUMBER | {"description": "first value"},
        "to": _NUMBER | {"description": "last value"},
        "count": checks.whole(1, read.MAX_AXIS_COUNT).schema | {"description": "number of values"},
        "spacing": {"enum": list(checks.SPACINGS), "default": "linear"},
        "values": {
            "type": "array",
            "items": _NUMBER,
            "minItems": 1,
            "uniqueItems": True,
            "description": "all values, instead of from, to and count",
        },
        "offset_from_family": {
            "type": "boolean",
            "default": False,
            "description": "the values are distances from what [family] solves",
        },
        "long_name": {"type": "string", "description": "name of the axis in the atlas and in figures"},
        "units": {"type": "string", "description": "unit of the axis in the atlas"},
    }
    schema: Schema = {
        "type": "object",
        "additionalProperties": False,
        "properties": keys,
        "oneOf": [
            {"required": ["from", "to", "count"], "not": {"required": ["values"]}},
            {"required": ["values"], "not": {"anyOf": [{"required": [key]} for key in ("from", "to", "count", "spacing")]}},
        ],
    }  # fmt: skip
    if parameter is not None:
        schema["description"] = _described(parameter)
        if limits := _limits(parameter):
            ends = {"from": limits, "to": limits, "values": {"items": limits}}
            offset = {
                "properties": {"offset_from_family": {"const": True}},
                "required": ["offset_from_family"],
            }
            schema |= {"if": {"not": offset}, "then": {"properties": ends}}
    return schema


def _points() -> Schema:
    """The table [points]."""
    ranges = {
        "type": "object",
        "additionalProperties": False,
        "required": ["from", "to"],
        "properties": {"from": _NUMBER, "to": _NUMBER, "spacing": {"enum": list(checks.SPACINGS)}},
    }
    numbers = {"type": "array", "items": _NUMBER, "minItems": 1}
    keys = {
        **checks.table_schema(points.Sample)["properties"],
        "ranges": {"type": "object", "minProperties": 1, "additionalProperties": ranges},
        "file": {"type": "string", "description": ".csv with names in its first line, or .nc; a path from the scene's folder"},
        "values": {"type": "object", "minProperties": 1, "additionalProperties": numbers},
    }  # fmt: skip
    return {
        "type": "object",
        "description": "a sample, or points of your own, instead of axes",
        "additionalProperties": False,
        "properties": keys,
        "oneOf": [
            {"required": ["sample", "count", "ranges"], "not": {"anyOf": [{"required": ["file"]}, {"required": ["values"]}]}},
            *({"required": [key], "maxProperties": 1} for key in ("file", "values")),
        ],
    }  # fmt: skip


def _about() -> Schema:
    """The table [about]."""
    table = checks.table_schema(About) | {"description": "attributes of the atlas, by the names of ACDD-1.3"}
    table["properties"]["licence"] = table["properties"]["license"]
    return table
