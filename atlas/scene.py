"""A TOML job file becomes a frozen, validated Scene: every complaint about input is made here."""

from __future__ import annotations

import math
import re
import tomllib
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import tomli_w

from . import systems
from .engine.runge_kutta import METHODS
from .systems.system import BadInput, System
from .ties import RESERVED, Tie, in_order
from .variables import variables

SCHEMA = 1
MOST_POINTS = 10**12
DURATION_UNITS = ("orbits", "turns")


def _is_number(value: object) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)


@dataclass(frozen=True)
class Settings:
    """How points are integrated and labelled; durations come with the points."""

    method: str = "rk4"
    tolerance: float = 1e-8  # rad, phase error of the fastest frequency at the end of the run
    step: float | None = None  # time units; overrides tolerance
    max_steps: int = 100_000_000
    rate_tolerance: float = 1e-5  # rad per time unit
    cylinder_tolerance: float | None = None  # rad; None: the number of rate_tolerance
    drift_tolerance: float = 1e-5

    def __post_init__(self) -> None:
        if self.method not in METHODS:
            raise BadInput(f"method = {self.method!r}: allowed: {', '.join(METHODS)}")
        for name in ("tolerance", "step", "rate_tolerance", "cylinder_tolerance", "drift_tolerance"):
            value = getattr(self, name)
            if value is not None and not (_is_number(value) and math.isfinite(value) and value > 0):
                raise BadInput(f"{name} = {value!r}: must be a finite number above 0")
        if not (isinstance(self.max_steps, int) and self.max_steps >= 1):
            raise BadInput(f"max_steps = {self.max_steps!r}: must be a whole number, at least 1")

    @property
    def cylinder(self) -> float:
        """Radius of the cylinder in rad."""
        return self.rate_tolerance if self.cylinder_tolerance is None else self.cylinder_tolerance


@dataclass(frozen=True)
class Axis:
    """One dimension of the atlas."""

    name: str
    values: tuple[float, ...]
    offset_from_family: bool = False
    long_name: str = ""
    units: str = ""
    table: Mapping[str, Any] = field(default_factory=dict, compare=False)  # as the scene gives it


@dataclass(frozen=True)
class Duration:
    """Length of the runs: a number of time units, of orbits, or of turns of the slower of n and m."""

    amount: float
    unit: str = ""  # "", "orbits" or "turns"

    def __str__(self) -> str:
        return f"{self.amount:g} {self.unit}".strip()


@dataclass(frozen=True)
class Scene:
    """One job, checked: everything that decides what an atlas will hold."""

    title: str
    system: System
    fixed: Mapping[str, float]
    axes: Mapping[str, Axis]
    ties: Mapping[str, Tie]  # in an order in which they can be evaluated
    family: str | None = None
    solve: tuple[str, ...] = ()
    nudge: Mapping[str, float] = field(default_factory=dict)
    duration: Duration = Duration(60.0)
    settings: Settings = Settings()
    outputs: tuple[str, ...] = ()

    @property
    def shape(self) -> tuple[int, ...]:
        return tuple(len(axis.values) for axis in self.axes.values())

    @property
    def nudges_angles(self) -> bool:
        """Is the nudge one of angles and their rates, not of the optional start values of the system?"""
        return bool(self.nudge) and not _optional(self.system, self.nudge)

    @property
    def size(self) -> int:
        return math.prod(self.shape)

    def vanishing(self) -> tuple[frozenset[str], bool]:
        """Parameters that are 0 or absent at every point, and whether A = B at every point."""
        moving = {*self.axes, *self.ties, *self.solve}
        values = {name: p.default for name, p in self.system.parameters.items()} | dict(self.fixed)
        zero = {k for k in self.system.parameters if k not in moving and (values[k] == 0 or math.isnan(values[k]))}
        tied = {"A", "B"} & moving
        symmetric = (not tied and values["A"] == values["B"]) or (
            len(tied) == 1 and self.ties.get(tied.pop(), Tie("", "0")).text.strip() in {"A", "B"}
        )
        return frozenset(zero), symmetric

    def toml(self) -> str:
        """The scene with every default written out; load_scene of this text gives the same scene."""
        settings = self.settings
        integration: dict[str, Any] = {
            "duration": str(self.duration) if self.duration.unit else self.duration.amount,
            "method": settings.method,
            "max_steps": settings.max_steps,
        }
        integration |= {"tolerance": settings.tolerance} if settings.step is None else {"step": settings.step}
        table: dict[str, Any] = {
            "schema": SCHEMA,
            "title": self.title,
            "system": self.system.name,
            "fixed": dict(self.fixed),
            "axes": {axis.name: dict(axis.table) for axis in self.axes.values()},
            "ties": {name: tie.text for name, tie in self.ties.items()},
        }
        if self.family is not None:
            table["family"] = {"name": self.family, "solve": list(self.solve)}
        if self.nudge:
            table["nudge"] = dict(self.nudge)
        table["integration"] = integration
        table["labels"] = {
            "rate_tolerance": settings.rate_tolerance,
            "cylinder_tolerance": settings.cylinder,
            "drift_tolerance": settings.drift_tolerance,
        }
        table["outputs"] = {"variables": list(self.outputs)}
        return tomli_w.dumps(table)


def load_scene(source: str | Path) -> Scene:
    """Read and check a scene file (a path), or the text of one (anything with a line break).

    Raises BadInput with one line naming key, value and what is allowed.
    """
    if isinstance(source, str) and "\n" in source:
        text, name = source, "scene"
    else:
        path = Path(source)
        name = path.stem
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
    return scene_from(table, name)


def scene_from(table: Mapping[str, Any], name: str = "scene") -> Scene:
    """Check a parsed scene; name is its title if it gives none."""
    _known(table, "", ("schema", "title", "system", "fixed", "axes", "ties", "family", "nudge",
                       "integration", "labels", "outputs"))  # fmt: skip
    for key in ("schema", "system", "axes"):
        if key not in table:
            raise BadInput(f"{key} is missing: a scene needs schema, system and axes")
    if table["schema"] != SCHEMA or isinstance(table["schema"], bool):
        raise BadInput(f"schema = {table['schema']!r}: allowed: {SCHEMA}")
    system = systems.get(_text(table, "system", "system"))
    title = _text(table, "title", "title") if "title" in table else name

    fixed = {k: _parameter_value(system, f"fixed.{k}", k, v) for k, v in _table(table, "fixed").items()}
    axes = {k: _axis(system, k, v) for k, v in _table(table, "axes").items()}
    if not axes:
        raise BadInput("axes: a scene needs at least one [axes.NAME] table")
    parsed = {}
    for k, v in _table(table, "ties").items():
        _name(f"ties.{k}", k)
        if not isinstance(v, str):
            raise BadInput(f'ties.{k} = {v!r}: must be a string of arithmetic, such as "sigma * A"')
        parsed[k] = Tie(f"ties.{k}", v)
    family, solve = _family(system, table)
    for k, places in _places(fixed, axes, parsed, solve).items():
        if len(places) > 1 and not (k in axes and axes[k].offset_from_family and places == ["axes", "solve"]):
            raise BadInput(f"{k} is given in {' and in '.join(places)}: a name has one value")
    _ties_fit(system, fixed, axes, parsed, solve)
    ties = {k: parsed[k] for k in in_order(parsed, {*system.parameters, *fixed, *axes} - set(solve))}
    for k, axis in axes.items():
        if axis.offset_from_family and k not in solve:
            raise BadInput(
                f"axes.{k}.offset_from_family: {k} must be solved by [family], but solve = {list(solve)}"
            )
    nudge = {
        k: _number(f"nudge.{k}", _start_parameter(system, k, v)) for k, v in _table(table, "nudge").items()
    }
    for k in (vector := _optional(system, nudge)):
        if not any(k in places for places in (fixed, axes, ties)):
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
        title, system, fixed, axes, ties, family, solve, nudge, duration, settings, _outputs(system, table)
    )  # fmt: skip
    if scene.size > MOST_POINTS:
        raise BadInput(f"axes: {scene.size:.3g} points in all; allowed: at most {MOST_POINTS:.0e}")
    return scene


def _number(key: str, value: object) -> float:
    if not _is_number(value):
        raise BadInput(f"{key} = {value!r}: must be a number")
    assert isinstance(value, int | float)
    try:
        number = float(value)
    except OverflowError:
        number = math.inf
    if not math.isfinite(number):
        raise BadInput(f"{key} = {value!r}: must be a finite number")
    return number


def _table(table: Mapping[str, Any], key: str) -> Mapping[str, Any]:
    value = table.get(key, {})
    if not isinstance(value, Mapping):
        raise BadInput(f"{key} = {value!r}: must be a table, [{key}]")
    return value


def _text(table: Mapping[str, Any], name: str, key: str) -> str:
    value = table[name]
    if not isinstance(value, str):
        raise BadInput(f"{key} = {value!r}: must be a string")
    return value


def _known(table: Mapping[str, Any], where: str, allowed: tuple[str, ...]) -> None:
    for key in table:
        if key not in allowed:
            raise BadInput(f"{where}{key}: unknown key; allowed: {', '.join(allowed)}")


def _name(key: str, name: str) -> str:
    if not re.fullmatch(r"[A-Za-z_][A-Za-z0-9_]*", name) or name in RESERVED:
        raise BadInput(
            f"{key}: {name!r} cannot be used as a name; allowed: letters, digits and _, not {sorted(RESERVED)}"
        )
    return name


def check_range(system: System, key: str, name: str, low: float, high: float) -> None:
    """Raise BadInput if values from low to high leave the range of a parameter of the system."""
    parameter = system.parameters[name]
    below = low <= parameter.low if parameter.open_low else low < parameter.low
    if below or high > parameter.high:
        bad = low if below else high
        sign = ">" if parameter.open_low else ">="
        allowed = f"{name} {sign} {parameter.low:g}" if below else f"{name} <= {parameter.high:g}"
        raise BadInput(f"{key} = {bad:g}: allowed: {allowed} ({parameter.meaning})")


def _parameter_value(system: System, key: str, name: str, value: object) -> float:
    number = _number(key, value)
    if name in system.parameters:
        check_range(system, key, name, number, number)
    else:
        _name(key, name)
    return number


def _optional(system: System, names: Iterable[str]) -> list[str]:
    """Those of the names that a start need not give, because other start values can replace them."""
    return [name for name in names if math.isnan(system.parameters[name].default)]


def _start_parameter(system: System, name: str, value: object) -> object:
    starts = [p.name for p in system.parameters.values() if p.start]
    if name not in starts:
        raise BadInput(f"nudge.{name}: unknown key; allowed: {', '.join(starts)}")
    return value


def _axis(system: System, name: str, table: object) -> Axis:
    key = f"axes.{name}"
    _name(key, name)
    if not isinstance(table, Mapping):
        raise BadInput(f"{key} = {table!r}: must be a table with from, to and count, or values")
    _known(
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
        spacing = table.get("spacing", "linear")
        if spacing == "log":
            if not (first > 0 and last > 0):
                raise BadInput(
                    f"{key}.spacing = 'log': from and to must be above 0, found {first:g} and {last:g}"
                )
            values = list(np.geomspace(first, last, count))
        elif spacing == "linear":
            values = list(np.linspace(first, last, count))
        else:
            raise BadInput(f"{key}.spacing = {spacing!r}: allowed: 'linear', 'log'")
        if count > 1 and first == last:
            raise BadInput(
                f"{key}: from = to = {first:g} with count = {count}; an axis needs distinct values"
            )
    if len(set(values)) < len(values):
        raise BadInput(f"{key}.values: some values occur twice; an axis needs distinct values")
    offset = table.get("offset_from_family", False)
    if not isinstance(offset, bool):
        raise BadInput(f"{key}.offset_from_family = {offset!r}: must be true or false")
    if name in system.parameters and not offset:
        check_range(system, key, name, min(values), max(values))
    words = {k: _text(table, k, f"{key}.{k}") for k in ("long_name", "units") if k in table}
    return Axis(name, tuple(float(v) for v in values), offset, table=table, **words)


def _family(system: System, table: Mapping[str, Any]) -> tuple[str | None, tuple[str, ...]]:
    if "family" not in table:
        return None, ()
    given = _table(table, "family")
    _known(given, "family.", ("name", "solve"))
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


def _places(*given: Any) -> dict[str, list[str]]:
    places: dict[str, list[str]] = {}
    for where, names in zip(("fixed", "axes", "ties", "solve"), given, strict=True):
        for name in names:
            places.setdefault(name, []).append(where)
    return places


def _ties_fit(system: System, fixed: Any, axes: Any, ties: Mapping[str, Tie], solve: tuple[str, ...]) -> None:
    used = {name for tie in ties.values() for name in tie.names}
    for where, names in (("fixed", fixed), ("axes", axes), ("ties", ties)):
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
    _known(integration, "integration.", ("duration", "method", "tolerance", "step", "max_steps"))
    _known(labels, "labels.", ("rate_tolerance", "cylinder_tolerance", "drift_tolerance"))
    if "step" in integration and "tolerance" in integration:
        raise BadInput("integration: step and tolerance are both given; a scene has one of them")
    values: dict[str, Any] = {k: v for k, v in integration.items() if k != "duration"} | dict(labels)
    for key, value in values.items():
        if key == "method":
            _text(integration, "method", "integration.method")
        elif key != "max_steps":
            where = "labels" if key in labels else "integration"
            values[key] = _number(f"{where}.{key}", value)
    if isinstance(values.get("max_steps"), bool):
        raise BadInput(f"integration.max_steps = {values['max_steps']!r}: must be a whole number, at least 1")
    duration = _duration(integration["duration"]) if "duration" in integration else Duration(60.0)
    return duration, Settings(**values)


def _outputs(system: System, table: Mapping[str, Any]) -> tuple[str, ...]:
    given = _table(table, "outputs")
    _known(given, "outputs.", ("variables",))
    allowed = variables(system)
    listed = given.get("variables", [name for name in allowed if name not in system.layers])
    if not isinstance(listed, list) or not listed:
        raise BadInput(f"outputs.variables = {listed!r}: must be a list of at least one variable name")
    for name in listed:
        if name not in allowed:
            raise BadInput(f"outputs.variables: {name!r} is unknown; allowed: {', '.join(allowed)}")
    return tuple(name for name in allowed if name in listed)
