"""JSON Schema of scenes for editors, made from the registries of parameters, families, methods and variables."""

from __future__ import annotations

from typing import Any

import numpy as np

from .. import systems as all_systems
from ..systems.base import System, families_of
from ..variables import variables
from . import checks, points, read
from .expressions import RESERVED
from .model import SCHEMA, About, Duration, Refine, Settings

DIALECT = "https://json-schema.org/draft/2020-12/schema"
DURATION = r"^\s*[+]?[0-9.][0-9.eE+-]*\s*([Oo]rbits?|[Tt]urns?)?\s*$|[-*/(]|^\s*[A-Za-z_]\w*\s*$"
NAME = f"^(?!({'|'.join(sorted(RESERVED))})$)[A-Za-z_][A-Za-z0-9_]*$"
TIES = (
    "names computed from other names: + - * / **, sqrt, sin, cos, tan, asin, acos, atan, exp, log, abs, pi;"
    " random numbers normal(draw), uniform(draw)"
)
NUMBER, TEXT, TABLE = checks.quantity.schema, checks.text.schema, checks.mapping.schema

Schema = dict[str, Any]


def scene_schema() -> Schema:
    """Return the JSON Schema (draft 2020-12) of scene files. `load_scene` alone checks dependencies between keys."""
    systems = list(all_systems.available().values())
    integration = checks.table_schema(checks.keys_of(Settings, "integration"))
    integration["properties"]["duration"] = {
        "anyOf": [checks.positive.schema, {"type": "string", "pattern": DURATION}],
        "default": Duration().toml,
        "description": 'time units, "20 orbits" (satellite), "50 turns" (of n or m, whichever is slower), or arithmetic in'
        " parameters, axes and natural_rate, the rate of each point",
    }
    labels = checks.table_schema(checks.keys_of(Settings, "labels"))
    labels["properties"]["transient"] = {
        "anyOf": [{"type": "number", "minimum": 0}, {"type": "string", "pattern": DURATION}],
        "default": 0,
        "description": "time before statistics and labels begin, as duration",
    }
    about = checks.table_schema(checks.keys_of(About))
    about["properties"]["licence"] = about["properties"]["license"]
    return {
        "$schema": DIALECT,
        "title": "Scene of Precession Atlas",
        "description": "A TOML file that describes one atlas",
        "type": "object",
        "required": ["schema", "system"],
        "additionalProperties": False,
        "properties": {
            "schema": {"const": SCHEMA, "description": "version of the format"},
            "title": TEXT | {"description": "free text, kept in the atlas; the title of its figures"},
            "system": {
                "enum": [s.name for s in systems],
                "description": "; ".join(f"{s.name}: {s.title}" for s in systems),
            },
            "extensions": checks.texts.schema | {"description": "extensions that must be installed"},
            "seed": checks.SEED.schema | {"default": 0, "description": "seed of normal and uniform in ties"},
            "about": about | {"description": "attributes of the atlas, by the names of ACDD-1.3"},
            "fixed": _table_of("parameters, or names for ties, with one value", NUMBER),
            "axes": _table_of("the dimensions of the atlas: parameters, or names for ties", AXIS)
            | {"minProperties": 1, "maxProperties": read.MAX_AXES},
            "points": POINTS,
            "ties": _table_of(TIES, TEXT),
            "family": TABLE | {"required": ["name"], "description": "every point starts on these steady motions"},
            "nudge": TABLE | {"additionalProperties": NUMBER, "description": "added to start values after solving"},
            "integration": integration | {"not": {"required": ["step", "tolerance"]}},
            "labels": labels,
            "refine": checks.table_schema(checks.keys_of(Refine))
            | {"description": "integrate a finer grid near the borders of labels only"},
            "outputs": {
                "type": "object",
                "additionalProperties": False,
                "properties": {"variables": {"type": "array"}, "map": {"type": "string"}},
            },
        },
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
    }  # fmt: skip


def _table_of(description: str, values: Schema) -> Schema:
    """Return the schema of a table whose keys are names chosen by the user."""
    names = {"propertyNames": {"pattern": NAME, "maxLength": checks.MAX_NAME}}
    return TABLE | names | {"description": description, "additionalProperties": values}


def _without(*keys: str) -> Schema:
    """Return a schema for tables that have none of the given keys."""
    return {"not": {"anyOf": [{"required": [key]} for key in keys]}}


# Schema of each table [axes.NAME].
AXIS: Schema = checks.table_schema({**read.SPACED, **read.LISTED, **read.OF_BOTH}, needed=False) | {
    "oneOf": [
        {"required": ["from", "to", "count"], **_without(*read.LISTED)},
        {"required": ["values"], **_without(*read.SPACED)},
    ]
}
POINTS: Schema = checks.table_schema(points.KEYS, needed=False) | {
    "description": "a sample, or points of your own, instead of axes",
    "oneOf": [
        {"required": ["sample", "count", "ranges"], **_without("file", "values")},
        *({"required": [key], "maxProperties": 1} for key in ("file", "values")),
    ],
}


def _properties_of(system: System) -> Schema:
    """Return the schemas of the tables that contain parameters, families or variables of a system."""
    fixed, axes, ties, nudge, families = {}, {}, {}, {}, []
    for name, parameter in system.parameters.items():
        description, limits = {"description": f"{parameter.meaning} ({parameter.unit})"}, {}
        if np.isfinite(parameter.low):
            limits["exclusiveMinimum" if parameter.open_low else "minimum"] = parameter.low
        if np.isfinite(parameter.high):
            limits["maximum"] = parameter.high
        default = {} if np.isnan(parameter.default) else {"default": parameter.default}
        fixed[name], axes[name] = NUMBER | description | default | limits, AXIS | description
        if limits:
            ends = {"from": limits, "to": limits, "values": {"items": limits}}
            offset = {
                "properties": {"offset_from_family": {"const": True}},
                "required": ["offset_from_family"],
            }
            axes[name] |= {"if": {"not": offset}, "then": {"properties": ends}}
        ties[name] = TEXT | description
        if parameter.start:
            nudge[name] = NUMBER | description
    for name, family in families_of(system).items():
        conditions = "; ".join(condition.text for condition in family.conditions)
        solve: Schema = {"type": "array", "description": "parameters that put each point on the family"}
        items = {"items": {"enum": list(family.solve)}} if family.solve else {"maxItems": 0}
        solve |= {"uniqueItems": True} | items
        title = {"const": name, "description": f"{family.title}: {conditions}"}
        properties = {"name": title, "solve": solve}
        if family.several:
            near = {
                "type": "object",
                "properties": dict.fromkeys(family.several, NUMBER),
                "additionalProperties": False,
            }
            text = "which of several solutions of a rate, by its size"
            properties |= {
                "branch": {"enum": ["slow", "fast"], "description": text},
                "near": {"anyOf": [NUMBER, near]},
            }
        families.append({"title": name, "additionalProperties": False, "properties": properties})
    registry = variables(system)
    names = {"type": "string", "enum": list(registry)}
    meanings = "; ".join(f"{name}: {variable.long_name}" for name, variable in registry.items())
    optional = ", ".join(name for name, variable in registry.items() if variable.optional) or "none"
    variables_text = f"variables of the atlas (default: all but {optional}). {meanings}"
    schema: Schema = {
        "fixed": {"properties": fixed},
        "axes": {"properties": axes},
        "ties": {"properties": ties},
        "nudge": {"properties": nudge, "additionalProperties": False},
        "outputs": {
            "properties": {
                "variables": {"items": names, "minItems": 1, "description": variables_text},
                "map": names | {"description": "the variable that the map and the page show first"},
            }
        },
    }
    if families:
        schema["family"] = {"oneOf": families}
    observables = [observable.name for observable in system.observables]
    if observables:
        schema["labels"] = {"properties": {"std_tolerance": {"propertyNames": {"enum": observables}}}}
    return schema
