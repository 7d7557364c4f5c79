"""A TOML job file becomes a frozen, validated Scene: every complaint about input is made here."""

from __future__ import annotations

import math
import re
import tomllib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from .. import systems
from ..errors import BadInput
from ..systems.base import System
from ..variables import variables
from . import tables as own_points
from .expressions import RESERVED, Expression, PointColumn, evaluation_order
from .model import (
    DURATION_UNITS,
    SCHEMA,
    Axis,
    Duration,
    Refine,
    Scene,
    Settings,
    check_range,
    is_number,
    is_refined_axis,
    optional_start_values,
)

MAX_POINTS = 10**12
# Numbers of a points file that a scene takes up, for they stand in the text of the resolved scene.
MAX_LISTED_NUMBERS = 200_000
MAX_SAMPLED_POINTS = 10**7
# Points of the fine grid of a refined scene, which is held in memory.
MAX_REFINED_POINTS = 2 * 10**8


def load_scene(source: str | Path) -> Scene:
    """Read and check a scene file (a path), or the text of one (anything with a line break).

    Raises BadInput with one line naming key, value and what is allowed.
    """
    if isinstance(source, str) and "\n" in source:
        text, name, folder = source, "scene", Path()
    else:
        path = Path(source)
        name, folder = path.stem, path.parent
        try:
            text = path.read_text(encoding="utf-8")
        except FileNotFoundError:
            raise BadInput(f"{path}: there is no such file") from None
        except IsADirectoryError:
            raise BadInput(f"{path}: this is a folder, not a scene file") from None
        except UnicodeDecodeError:
            raise BadInput(f"{path}: not a text file in UTF-8") from None
        except OSError as error:
            raise BadInput(f"{path}: cannot be read: {error.strerror}") from None
    try:
        table = tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        raise BadInput(f"{name}: not valid TOML: {error}") from None
    except RecursionError:
        raise BadInput(f"{name}: not valid TOML: nested too deeply") from None
    return scene_from(table, name, folder)


def scene_from(table: Mapping[str, Any], name: str = "scene", folder: Path = Path()) -> Scene:
    """Check a parsed scene; name is its title if it gives none, folder where it looks for its points."""
    _check_keys(table, "", ("schema", "title", "system", "fixed", "axes", "points", "ties", "family", "nudge",
                       "integration", "labels", "refine", "outputs"))  # fmt: skip
    for key in ("schema", "system", "axes"):
        if key not in table and not (key == "axes" and "points" in table):
            raise BadInput(f"{key} is missing: a scene needs schema, system and axes (or points)")
    for key in ("axes", "refine"):
        if key in table and "points" in table:
            raise BadInput(f"points and {key} are both given; a scene has one of them")
    if table["schema"] != SCHEMA or isinstance(table["schema"], bool):
        raise BadInput(f"schema = {table['schema']!r}: allowed: {SCHEMA}")
    system = systems.get(_text(table, "system", "system"))
    title = _text(table, "title", "title") if "title" in table else name

    fixed = {k: _parameter_value(system, f"fixed.{k}", k, v) for k, v in _table(table, "fixed").items()}
    refine = _refine(table)
    levels = 0 if refine is None else refine.levels
    axes = {k: _axis(system, k, v, levels) for k, v in _table(table, "axes").items()}
    given, columns = _points(system, table, folder) if "points" in table else (None, {})
    if given is not None:
        count = next(iter(columns.values())).values.size
        axes["point"] = Axis("point", tuple(map(float, range(count))), long_name="number of the point")
    if not axes:
        raise BadInput("axes: a scene needs at least one [axes.NAME] table")
    if refine is not None:
        _check_refine(axes)
    parsed = {}
    for k, v in _table(table, "ties").items():
        _name(f"ties.{k}", k)
        if not isinstance(v, str):
            raise BadInput(f'ties.{k} = {v!r}: must be a string of arithmetic, such as "sigma * A"')
        parsed[k] = Expression(f"ties.{k}", v)
    family, solve = _family(system, table)
    for k, places in _origins(fixed, axes, parsed, solve, columns).items():
        if len(places) > 1 and not (k in axes and axes[k].offset_from_family and places == ["axes", "solve"]):
            raise BadInput(f"{k} is given in {' and in '.join(places)}: a name has one value")
    _check_expressions(system, fixed, axes if given is None else {}, columns, parsed, solve)
    parsed |= columns
    ties = {k: parsed[k] for k in evaluation_order(parsed, {*system.parameters, *fixed, *axes} - set(solve))}
    for k, axis in axes.items():
        if axis.offset_from_family and k not in solve:
            raise BadInput(
                f"axes.{k}.offset_from_family: {k} must be solved by [family], but solve = {list(solve)}"
            )
    nudge = {
        k: _number(f"nudge.{k}", _start_parameter(system, k, v)) for k, v in _table(table, "nudge").items()
    }
    for k in (vector := optional_start_values(system, nudge)):
        if not any(k in places for places in (fixed, axes, parsed)):
            raise BadInput(f"nudge.{k}: the scene gives no {k} to which it could be added; nudge theta0 .. m")
    if vector and vector != list(nudge):
        raise BadInput(
            f"nudge: {', '.join(nudge)} together: allowed: angles and their rates, or {', '.join(vector)} alone"
        )
    duration, settings = _integration(table)
    if duration.unit == "orbits" and system.frame_rate is None:
        raise BadInput(
            f"integration.duration = {str(duration)!r}: the {system.name} has no orbit; use time units or turns"
        )
    scene = Scene(
        title, system, fixed, axes, ties, family, solve, nudge, duration, settings, _outputs(system, table),
        refine, given,
    )  # fmt: skip
    if scene.size > MAX_POINTS:
        raise BadInput(f"axes: {scene.size:.3g} points in all; allowed: at most {MAX_POINTS:.0e}")
    return scene


def _number(key: str, value: object) -> float:
    if not is_number(value):
        raise BadInput(f"{key} = {value!r}: must be a number")
    assert isinstance(value, int | float)
    try:
        number = float(value)
    except OverflowError:
        number = math.inf
    if not math.isfinite(number):
        raise BadInput(f"{key} = {value!r}: must be a finite number")
    return number


def _table(table: Mapping[str, Any], key: str, where: str = "") -> Mapping[str, Any]:
    value = table.get(key, {})
    if not isinstance(value, Mapping):
        raise BadInput(f"{where}{key} = {value!r}: must be a table, [{where}{key}]")
    return value


def _text(table: Mapping[str, Any], name: str, key: str) -> str:
    value = table[name]
    if not isinstance(value, str):
        raise BadInput(f"{key} = {value!r}: must be a string")
    return value


def _check_keys(table: Mapping[str, Any], where: str, allowed: tuple[str, ...]) -> None:
    for key in table:
        if key not in allowed:
            raise BadInput(f"{where}{key}: unknown key; allowed: {', '.join(allowed)}")


def _name(key: str, name: str) -> str:
    if not re.fullmatch(r"[A-Za-z_][A-Za-z0-9_]*", name) or name in RESERVED:
        raise BadInput(
            f"{key}: {name!r} cannot be used as a name; allowed: letters, digits and _, not {sorted(RESERVED)}"
        )
    return name


def _parameter_value(system: System, key: str, name: str, value: object) -> float:
    number = _number(key, value)
    if name in system.parameters:
        check_range(system, key, name, number, number)
    else:
        _name(key, name)
    return number


def _start_parameter(system: System, name: str, value: object) -> object:
    starts = [p.name for p in system.parameters.values() if p.start]
    if name not in starts:
        raise BadInput(f"nudge.{name}: unknown key; allowed: {', '.join(starts)}")
    return value


def _axis(system: System, name: str, table: object, levels: int) -> Axis:
    """levels: how often [refine] halves the spacing of an axis."""
    key = f"axes.{name}"
    _name(key, name)
    if not isinstance(table, Mapping):
        raise BadInput(f"{key} = {table!r}: must be a table with from, to and count, or values")
    _check_keys(
        table,
        f"{key}.",
        ("from", "to", "count", "spacing", "values", "offset_from_family", "long_name", "units"),
    )
    if "values" in table:
        for other in ("from", "to", "count", "spacing"):
            if other in table:
                raise BadInput(f"{key}.{other}: not together with values")
        listed = table["values"]
        if not isinstance(listed, list) or not listed:
            raise BadInput(f"{key}.values = {listed!r}: must be a list of at least one number")
        values = [_number(f"{key}.values", v) for v in listed]
    else:
        for needed in ("from", "to", "count"):
            if needed not in table:
                raise BadInput(f"{key}.{needed} is missing: an axis needs from, to and count, or values")
        first, last = _number(f"{key}.from", table["from"]), _number(f"{key}.to", table["to"])
        count = table["count"]
        if not isinstance(count, int) or isinstance(count, bool) or not 1 <= count <= 10**8:
            raise BadInput(f"{key}.count = {count!r}: must be a whole number from 1 to 100000000")
        if (count - 1) * 2**levels >= MAX_REFINED_POINTS:
            raise BadInput(f"{key}.count = {count}: too many for {levels} levels of [refine]")
        if count > 1 and first == last:
            raise BadInput(
                f"{key}: from = to = {first:g} with count = {count}; an axis needs distinct values"
            )
        places = np.linspace if _spacing(key, table, first, last) == "linear" else np.geomspace
        values = list(places(first, last, (count - 1) * 2**levels + 1))
    if len(set(values)) < len(values):
        raise BadInput(f"{key}.values: some values occur twice; an axis needs distinct values")
    offset = table.get("offset_from_family", False)
    if not isinstance(offset, bool):
        raise BadInput(f"{key}.offset_from_family = {offset!r}: must be true or false")
    if name in system.parameters and not offset:
        check_range(system, key, name, min(values), max(values))
    words = {k: _text(table, k, f"{key}.{k}") for k in ("long_name", "units") if k in table}
    return Axis(name, tuple(float(v) for v in values), offset, table=table, **words)


def _spacing(key: str, table: Mapping[str, Any], first: float, last: float) -> str:
    spacing = table.get("spacing", "linear")
    if spacing not in ("linear", "log"):
        raise BadInput(f"{key}.spacing = {spacing!r}: allowed: 'linear', 'log'")
    if spacing == "log" and not (first > 0 and last > 0):
        raise BadInput(f"{key}.spacing = 'log': from and to must be above 0, found {first:g} and {last:g}")
    return str(spacing)


def _refine(table: Mapping[str, Any]) -> Refine | None:
    if "refine" not in table:
        return None
    given = _table(table, "refine")
    _check_keys(given, "refine.", ("levels", "probe"))
    levels = given.get("levels")
    if not isinstance(levels, int) or isinstance(levels, bool) or not 1 <= levels <= 8:
        raise BadInput(f"refine.levels = {levels!r}: must be a whole number from 1 to 8")
    probe = _number("refine.probe", given.get("probe", Refine.probe))
    if not 0 <= probe <= 1:
        raise BadInput(f"refine.probe = {probe:g}: must be a share of the points, from 0 to 1")
    return Refine(levels, probe)


def _check_refine(axes: Mapping[str, Axis]) -> None:
    if not any(is_refined_axis(axis.table) for axis in axes.values()):
        raise BadInput("refine: no axis has from, to and a count above 1, so that there is nothing to refine")
    size = math.prod(len(axis.values) for axis in axes.values())
    if size > MAX_REFINED_POINTS:
        raise BadInput(
            f"refine: {size:.3g} points on the finest grid; allowed: at most {MAX_REFINED_POINTS:.0e}"
        )


def _points(
    system: System, table: Mapping[str, Any], folder: Path
) -> tuple[dict[str, Any], dict[str, PointColumn]]:
    """The table of points, as the resolved scene holds it, and its columns."""
    given = _table(table, "points")
    _check_keys(given, "points.", ("sample", "count", "seed", "ranges", "file", "values"))
    kinds = [key for key in ("sample", "file", "values") if key in given]
    if len(kinds) != 1:
        found = " and ".join(kinds) or "none"
        raise BadInput(f"points: needs one of sample, file and values, found {found}")
    if kinds == ["sample"]:
        return _sampled(system, given)
    for key in ("count", "seed", "ranges"):
        if key in given:
            raise BadInput(f"points.{key}: only together with sample")
    if kinds == ["values"]:
        values = dict(_table(given, "values", "points."))
        for name, column in values.items():
            if not isinstance(column, list) or not column:
                raise BadInput(f"points.values.{name}: must be a list of at least one number")
            values[name] = [_number(f"points.values.{name}", value) for value in column]
    else:
        path, named = _text(given, "file", "points.file"), _table(table, "ties").values()
        words = {word for text in named for word in re.findall(r"\w+", str(text))}
        values = own_points.read(folder / path, {*system.parameters, *words})
    columns = {}
    for name, column in values.items():
        key = f"points.values.{_name('points', name)}"
        try:
            numbers = np.asarray(column, np.float64)
        except (TypeError, ValueError):
            raise BadInput(f"{key}: must be numbers") from None
        if numbers.ndim != 1 or not numbers.size:
            raise BadInput(f"{key}: must be one number for each point")
        if not np.isfinite(numbers).all():
            bad = int(np.flatnonzero(~np.isfinite(numbers))[0])
            raise BadInput(f"{key}: {numbers[bad]} at point {bad} (counted from 0); must be finite numbers")
        if name in system.parameters:
            check_range(system, key, name, numbers.min(), numbers.max())
        columns[name] = PointColumn(key, numbers)
    sizes = {name: column.values.size for name, column in columns.items()}
    if len(set(sizes.values())) != 1:
        shown = ", ".join(f"{name}: {size}" for name, size in sizes.items()) or "there are none"
        raise BadInput(f"points: columns of different lengths ({shown})" if sizes else f"points: {shown}")
    if sum(sizes.values()) > MAX_LISTED_NUMBERS:
        raise BadInput(
            f"points: {sum(sizes.values())} numbers; a scene takes at most {MAX_LISTED_NUMBERS};"
            " label more with atlas points or atlas.label_points"
        )
    return {"values": {name: column.values.tolist() for name, column in columns.items()}}, columns


def _sampled(system: System, given: Mapping[str, Any]) -> tuple[dict[str, Any], dict[str, PointColumn]]:
    kind = _text(given, "sample", "points.sample")
    if kind not in own_points.SAMPLES:
        raise BadInput(f"points.sample = {kind!r}: allowed: {', '.join(own_points.SAMPLES)}")
    count, seed = given.get("count"), given.get("seed", 0)
    if not isinstance(count, int) or isinstance(count, bool) or not 1 <= count <= MAX_SAMPLED_POINTS:
        raise BadInput(f"points.count = {count!r}: must be a whole number from 1 to {MAX_SAMPLED_POINTS}")
    if not isinstance(seed, int) or isinstance(seed, bool) or seed < 0:
        raise BadInput(f"points.seed = {seed!r}: must be a whole number, at least 0")
    ranges = _table(given, "ranges", "points.")
    if not ranges:
        raise BadInput(
            "points.ranges: a sample needs at least one [points.ranges.NAME] table with from and to"
        )
    columns = {}
    for (name, span), share in zip(
        ranges.items(), own_points.sample(kind, len(ranges), count, seed), strict=True
    ):
        key = f"points.ranges.{_name('points.ranges', name)}"
        if not isinstance(span, Mapping):
            raise BadInput(f"{key} = {span!r}: must be a table with from and to")
        _check_keys(span, f"{key}.", ("from", "to", "spacing"))
        for needed in ("from", "to"):
            if needed not in span:
                raise BadInput(f"{key}.{needed} is missing: a range needs from and to")
        first, last = (_number(f"{key}.{end}", span[end]) for end in ("from", "to"))
        if first == last:
            raise BadInput(f"{key}: from = to = {first:g}; put what does not vary into [fixed]")
        if name in system.parameters:
            check_range(system, key, name, min(first, last), max(first, last))
        if _spacing(key, span, first, last) == "linear":
            columns[name] = PointColumn(key, first + (last - first) * share)
        else:
            columns[name] = PointColumn(key, first * (last / first) ** share)
    return {"sample": kind, "count": count, "seed": seed, "ranges": ranges}, columns


def _family(system: System, table: Mapping[str, Any]) -> tuple[str | None, tuple[str, ...]]:
    if "family" not in table:
        return None, ()
    given = _table(table, "family")
    _check_keys(given, "family.", ("name", "solve"))
    if "name" not in given:
        raise BadInput(f"family.name is missing; allowed: {', '.join(system.families)}")
    name = _text(given, "name", "family.name")
    if name not in system.families:
        raise BadInput(f"family.name = {name!r}: unknown family; allowed: {', '.join(system.families)}")
    solve = given.get("solve", [])
    if not isinstance(solve, list) or not all(isinstance(s, str) for s in solve):
        raise BadInput(f"family.solve = {solve!r}: must be a list of parameter names")
    can = system.families[name].solve
    for wanted in solve:
        if wanted in system.families[name].free:
            raise BadInput(
                f"family.solve = {wanted!r}: the family {name} leaves it free, every value is one;"
                " give it in [fixed], [axes] or [ties]"
            )
        if wanted not in can:
            raise BadInput(
                f"family.solve = {wanted!r}: the family {name} cannot be solved for it;"
                f" allowed: {', '.join(can) or 'nothing'}"
            )
    if len(set(solve)) < len(solve):
        raise BadInput(f"family.solve = {solve!r}: a parameter is named twice")
    return name, tuple(p for p in can if p in solve)


def _origins(*given: Any) -> dict[str, list[str]]:
    places: dict[str, list[str]] = {}
    for where, names in zip(("fixed", "axes", "ties", "solve", "points"), given, strict=True):
        for name in names:
            places.setdefault(name, []).append(where)
    return places


def _check_expressions(
    system: System,
    fixed: Any,
    axes: Any,
    columns: Any,
    ties: Mapping[str, Expression],
    solve: tuple[str, ...],
) -> None:
    used = {name for tie in ties.values() for name in tie.names}
    for where, names in (("fixed", fixed), ("axes", axes), ("points", columns), ("ties", ties)):
        for name in names:
            if name not in system.parameters and name not in used:
                raise BadInput(
                    f"{where}.{name}: not a parameter of the {system.name}, and no tie uses it;"
                    f" parameters: {', '.join(system.parameters)}"
                )
    for name, tie in ties.items():
        for solved in tie.names & set(solve):
            raise BadInput(f"ties.{name} = {tie.text!r}: {solved} is only known once [family] has solved it")


def _duration(value: object) -> Duration:
    key = "integration.duration"
    if isinstance(value, str):
        match = re.fullmatch(r"\s*([-+0-9.eE]+)\s+(\w+)\s*", value)
        if match is None or match[2] not in DURATION_UNITS:
            raise BadInput(f'{key} = {value!r}: allowed: a number of time units, "20 orbits" or "50 turns"')
        try:
            amount, unit = float(match[1]), match[2]
        except ValueError:
            raise BadInput(f"{key} = {value!r}: {match[1]!r} is not a number") from None
    else:
        amount, unit = _number(key, value), ""
    if not (math.isfinite(amount) and amount > 0):
        raise BadInput(f"{key} = {value!r}: must be a finite number above 0")
    return Duration(amount, unit)


def _integration(table: Mapping[str, Any]) -> tuple[Duration, Settings]:
    integration, labels = _table(table, "integration"), _table(table, "labels")
    _check_keys(integration, "integration.", ("duration", "method", "tolerance", "step", "max_steps",
                                          "check_half_step"))  # fmt: skip
    _check_keys(labels, "labels.", ("rate_tolerance", "cylinder_tolerance", "drift_tolerance"))
    if "step" in integration and "tolerance" in integration:
        raise BadInput("integration: step and tolerance are both given; a scene has one of them")
    values: dict[str, Any] = {k: v for k, v in integration.items() if k != "duration"} | dict(labels)
    for key, value in values.items():
        if key in ("method", "check_half_step"):
            _text(integration, key, f"integration.{key}")
        elif key != "max_steps":
            where = "labels" if key in labels else "integration"
            values[key] = _number(f"{where}.{key}", value)
    if isinstance(values.get("max_steps"), bool):
        raise BadInput(f"integration.max_steps = {values['max_steps']!r}: must be a whole number, at least 1")
    duration = _duration(integration["duration"]) if "duration" in integration else Duration(60.0)
    return duration, Settings(**values)


def _outputs(system: System, table: Mapping[str, Any]) -> tuple[str, ...]:
    given = _table(table, "outputs")
    _check_keys(given, "outputs.", ("variables",))
    allowed = variables(system)
    listed = given.get("variables", [name for name in allowed if name not in system.derived])
    if not isinstance(listed, list) or not listed:
        raise BadInput(f"outputs.variables = {listed!r}: must be a list of at least one variable name")
    for name in listed:
        if name not in allowed:
            raise BadInput(f"outputs.variables: {name!r} is unknown; allowed: {', '.join(allowed)}")
    return tuple(name for name in allowed if name in listed)
