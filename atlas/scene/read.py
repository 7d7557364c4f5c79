"""Reading of a TOML scene file into a checked Scene. Every error is one line that names the key."""

from __future__ import annotations

import math
import re
import tomllib
from collections.abc import Collection, Iterable, Mapping
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from .. import extension, systems
from ..errors import BadInput, allowed_text, shown
from ..flags import reserved_families
from ..systems.base import NATURAL_RATE, Array, System, families_of
from ..variables import (
    POINT,
    data_variables,
    default_variables,
    listed_variables,
    proofs_of_labels,
    variables,
)
from . import checks
from .checks import checked
from .expressions import Expression, PointColumn, Tie, evaluation_order
from .family import free_message, near_values
from .model import (
    DURATION_UNITS,
    SCHEMA,
    About,
    Axis,
    Duration,
    Refine,
    Scene,
    Settings,
    optional_start_values,
)
from .text import MAX_CHARACTERS, Source, read_text

# With these limits any text is read and checked within a few seconds and 500 MB.
MAX_TABLES = 2000
MAX_JOINED_NAMES = 16  # largest number of names in a dotted key such as a.b.c
MAX_NAMES = 200  # largest number of names in [fixed], [axes] and [ties] together
MAX_TIE_CHARACTERS = 10_000  # largest number of characters of all ties together
MAX_AXES = 32
MAX_AXIS_COUNT = 10**7
MAX_POINTS = 10**11
# Largest number of points in the finest grid of a refined scene, because theory predicts the label of each point.
MAX_REFINED_POINTS = 2 * 10**8
_KEY = r"""(?:[\w-]++|"(?:[^"\\\n]|\\.)*+"|'[^'\n]*+')"""
_JOINED_KEYS = re.compile(rf"(?<![\w-]){_KEY}(?:[ \t]*+\.[ \t]*+{_KEY}){{{MAX_JOINED_NAMES}}}")
TABLES = (
    *("about", "fixed", "axes", "points", "ties", "family", "nudge", "integration", "labels", "refine"),
    "outputs",
)
# First bytes of NetCDF files in the HDF5 format and in classic formats.
NETCDF_BEGINS = (b"\x89HDF", b"CDF")
KEYS = ("schema", "title", "system", "extensions", "seed", *TABLES)


def load_scene(source: str | Path | Mapping[str, Any] | Scene) -> Scene:
    """Read and check a scene.

    Parameters
    ----------
    source : str, Path, mapping or Scene
        Path of a scene file, text of a scene file, or nested mappings with the keys of a scene file. A string with a line break is
        a text. Values in mappings may be NumPy numbers and 1-D arrays. A Scene is returned as it is.

    Returns
    -------
    Scene
        The scene, with every default filled in.

    Raises
    ------
    BadInput
        If the scene is not valid. The message names the file, the line, the key and what is allowed.

    Examples
    --------
    >>> scene = atlas.load_scene({
    ...     "schema": 1,
    ...     "system": "satellite",
    ...     "fixed": {"k3": 0.2},
    ...     "axes": {"theta0": {"from": 0.1, "to": 1.5, "count": 15}},
    ... })
    """
    if isinstance(source, Scene):
        return source
    if isinstance(source, Mapping):
        from .dictionary import text_of

        return parse_scene(text_of(source), folder=Path())
    if not isinstance(source, str | Path):
        raise BadInput(
            f"scene: found {shown(source)}; must be the path of a scene file, the text of one, a dictionary of its keys,"
            " or a Scene of atlas.load_scene"
        )
    if isinstance(source, str) and ("\n" in source or "\r" in source):
        return parse_scene(source, folder=Path())
    path, is_atlas = Path(source), False
    with suppress(OSError, ValueError):  # `read_text` below reports the same error to the user
        is_atlas = (path / "manifest.json").exists()
        if path.is_file():  # A pipe could not be read a second time.
            with path.open("rb") as file:
                is_atlas = file.read(4).startswith(NETCDF_BEGINS)
    if is_atlas:
        raise BadInput(
            f"{path}: this is an atlas, not a scene; its attribute atlas_scene is the text of the scene that it was"
            " computed from"
        )
    return parse_scene(read_text(path), path.stem, path.parent, str(path))


def parse_scene(
    text: str,
    name: str = "scene",
    folder: Path | None = None,
    path: str | None = None,
    *,
    of_atlas: bool = False,
) -> Scene:
    """Return the scene of a TOML text. BadInput names path, line and key.

    A points file is read from `folder`, and refused if `folder` is None. `of_atlas` drops outputs that nothing installed computes.
    """
    text = text.removeprefix("\ufeff").replace("\r\n", "\n").replace("\r", "\n")
    source = Source(path or name, text)
    # Texts that are far longer than any scene, or have far more tables, are refused because parsing would take long.
    if len(text) > MAX_CHARACTERS:
        raise BadInput(f"{source.path}: too many characters; allowed: at most {MAX_CHARACTERS}")
    tables = text.count("{") + len(re.findall(r"^[ \t]*+\[", text, re.MULTILINE))
    if tables > MAX_TABLES:
        raise BadInput(f"{source.path}: {tables} tables; allowed: at most {MAX_TABLES}")
    if _JOINED_KEYS.search(text):
        raise BadInput(f"{source.path}: more than {MAX_JOINED_NAMES} names joined by points")
    try:
        table = tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        raise source.of_toml(str(error)) from None
    except RecursionError:
        raise source.of_toml("nested too deeply") from None
    except ValueError:
        raise BadInput(f"{source.path}: a number has more digits than can be read") from None
    if path is None:
        return scene_from(table, name, folder, of_atlas=of_atlas)
    try:
        return replace(scene_from(table, name, folder), source=source)
    except BadInput as error:
        raise source.located(error) from None


def scene_from(
    table: Mapping[str, Any], name: str = "scene", folder: Path | None = Path(), *, of_atlas: bool = False
) -> Scene:
    """Return the scene of a parsed TOML text. The arguments are those of `parse_scene`."""
    checks.check_keys(table, "", KEYS)
    for key in ("schema", "system", "axes"):
        if key not in table and not (key == "axes" and "points" in table):
            raise BadInput(f"{key} is missing: a scene needs schema, system and axes (or points)")
    for key in ("axes", "refine"):
        if key in table and "points" in table:
            raise BadInput(f"points and {key} are both given; a scene has one of them")
    if table["schema"] != SCHEMA or isinstance(table["schema"], bool):
        raise BadInput(f"schema = {shown(table['schema'])}: allowed: {SCHEMA}")
    section = {key: checks.mapping(key, table.get(key, {})) for key in TABLES}
    if (count := sum(len(section[key]) for key in ("fixed", "axes", "ties"))) > MAX_NAMES:
        raise BadInput(f"{count} names are given values; allowed: at most {MAX_NAMES}")
    system = systems.get(checks.text("system", table["system"]))
    for each in checks.texts("extensions", table.get("extensions", [])):
        if each not in (installed := extension.extensions()) and not of_atlas:
            raise BadInput(
                f"extensions: {shown(each)} is not installed; installed: {', '.join(installed)}{extension.not_loaded()}"
            )
    title = checks.text("title", table.get("title", name))
    fixed = {key: checks.quantity(f"fixed.{key}", value) for key, value in section["fixed"].items()}
    for key, number in fixed.items():
        if key in system.parameters:
            checks.check_range(system.parameters[key], f"fixed.{key}", number, number)
        else:
            checks.identifier(f"fixed.{key}", key)
    refine = checks.instance_of(Refine, section["refine"], "refine") if "refine" in table else None
    axes = _axes(system, section["axes"], refine)
    points: Mapping[str, Any] | None = None
    columns: dict[str, PointColumn] = {}
    if "points" in table:
        from .points import read_points

        points, columns = read_points(system, section["points"], section["ties"], folder)
        count = next(iter(columns.values())).column.size
        axes[POINT] = Axis(POINT, np.arange(count, dtype=np.float64), long_name="number of the point")
    if not axes:
        raise BadInput("axes: a scene needs at least one [axes.NAME] table")
    seed = checks.SEED("seed", table.get("seed", 0))
    expressions = _expressions(section["ties"], seed)
    family, solve, choice = parse_family(system, section["family"]) if "family" in table else (None, (), {})
    ties: dict[str, Tie] = expressions | columns
    _check_ties(axes, expressions, solve, is_refined=refine is not None)
    order = evaluation_order(ties, {*system.parameters, *fixed, *axes} - set(solve))
    names: dict[str, Iterable[str]] = {
        "fixed": fixed,
        "axes": axes,
        "ties": expressions,
        "solve": solve,
        "points": columns,
    }
    _check_names(system, names, axes, ties)
    duration, transient, settings = _integration(
        system, section["integration"], section["labels"], {*system.parameters, *fixed, *axes, *ties}
    )
    outputs, map_variable = _outputs(system, section["outputs"], of_atlas)
    if settings.prove and not of_atlas:
        outputs = _with_proofs(system, outputs, is_refined=refine is not None)
    about = section["about"]
    if "licence" in about and "license" not in about:  # both spellings are allowed
        about = {"license" if key == "licence" else key: value for key, value in about.items()}
    return Scene(
        title=title,
        system=system,
        fixed=fixed,
        axes=axes,
        ties={key: ties[key] for key in order},
        family=family,
        solve=solve,
        choice=choice,
        nudge=_nudge(system, section["nudge"], {*fixed, *axes, *ties}),
        duration=duration,
        transient=transient,
        settings=settings,
        outputs=outputs,
        map=map_variable,
        seed=seed,
        refine=refine,
        points=points,
        about=checks.instance_of(About, about, "about"),
    )


def _expressions(table: Mapping[str, Any], seed: int) -> dict[str, Expression]:
    """Return the ties of the table [ties] as expressions."""
    expressions = {}
    for key, value in table.items():
        checks.identifier(f"ties.{key}", key)
        if not isinstance(value, str):
            raise BadInput(
                f'ties.{key} = {shown(value)}: must be a string of arithmetic, such as "sigma * A"'
            )
        expressions[key] = Expression(f"ties.{key}", value, seed)
    if (length := sum(len(tie.text) for tie in expressions.values())) > MAX_TIE_CHARACTERS:
        raise BadInput(f"ties: {length} characters in all; allowed: at most {MAX_TIE_CHARACTERS}")
    return expressions


def _outputs(system: System, table: Mapping[str, Any], of_atlas: bool) -> tuple[tuple[str, ...], str]:
    """Return the outputs in the order of the registry, and the variable that maps show, or "". If `of_atlas`, drop unknown outputs."""
    checks.check_keys(table, "outputs.", ("variables", "map"))
    registry = variables(system)
    listed = table.get("variables", default_variables(system))
    if not isinstance(listed, list) or not listed:
        raise BadInput(f"outputs.variables = {shown(listed)}: must be a list of at least one variable name")
    unknown = [name for name in listed if not isinstance(name, str) or name not in registry]
    for name in [] if of_atlas else unknown:
        raise BadInput(
            f"outputs.variables: {shown(name)} is unknown; {extension.available_text(name, registry)}"
        )
    # The outputs of a finished atlas are complete and get no further variables.
    outputs = tuple(
        [name for name in registry if name in listed] if of_atlas else listed_variables(system, listed)
    )
    allowed = (*outputs, *unknown)
    return outputs, checks.choice("outputs.map", table["map"], allowed) if "map" in table else ""


def _with_proofs(system: System, outputs: tuple[str, ...], is_refined: bool) -> tuple[str, ...]:
    """Add the variables that say where labels are proved. Raise BadInput if no label can be proved, or for a refined scene."""
    if is_refined:
        raise BadInput(
            "integration.prove = true: not together with refine, whose borders are those of measured labels"
        )
    registry = variables(system)
    every = proofs_of_labels(system)
    wanted = {proof for label, proof in every.items() if label in outputs}
    if not wanted:
        labels = "no installed extension proves its labels"
        if every:
            labels = f"name {' or '.join(every)} in outputs.variables"
        raise BadInput(
            f"integration.prove = true: no label of the {system.name} can be proved here; {labels}"
        )
    return tuple(name for name in registry if name in wanted or name in outputs)


# A table [axes.NAME] has the keys SPACED for evenly spaced values or LISTED for listed values, and in both cases OF_BOTH.
SPACED: checks.Keys = {
    "from": checks.INTERVAL["from"],
    "to": checks.INTERVAL["to"],
    "count": checked(checks.whole(1, MAX_AXIS_COUNT), description="number of values"),
    "spacing": checks.INTERVAL["spacing"],
}
LISTED: checks.Keys = {
    "values": checked(checks.distinct_numbers, description="all values, instead of from, to and count")
}
OF_BOTH: checks.Keys = {
    "offset_from_family": checked(
        checks.boolean, False, description="the values are distances from what [family] solves"
    ),
    "long_name": checked(checks.text, "", description="name of the axis in the atlas and in figures"),
    "units": checked(checks.text, "", description="unit of the axis in the atlas"),
    "display_units": checked(
        checks.one_of(("rad", "deg")), "", description="units of an angle in rad on maps and pages"
    ),
}


def _axes(system: System, tables: Mapping[str, Any], refine: Refine | None) -> dict[str, Axis]:
    """Return the axes of the table [axes] on the finest grid. Sizes are checked before values are allocated."""
    if len(tables) > MAX_AXES:
        raise BadInput(f"axes: {len(tables)} of them; allowed: at most {MAX_AXES}")
    if POINT in tables:
        raise BadInput(f"axes.{POINT}: this is the dimension of scenes with [points]; choose another name")
    levels = 0 if refine is None else refine.levels
    checked_tables, counts = {}, {}
    for name, table in tables.items():
        key = f"axes.{name}"
        checks.identifier(key, name)
        if not isinstance(table, Mapping):
            raise BadInput(f"{key} = {shown(table)}: must be a table with from, to and count, or values")
        checks.check_keys(table, f"{key}.", {**SPACED, **LISTED, **OF_BOTH})
        for other in SPACED:
            if other in table and "values" in table:
                raise BadInput(f"{key}.{other}: not together with values")
        needed = LISTED if "values" in table else SPACED
        rule = "an axis needs from, to and count, or values"
        checked_tables[name] = checks.from_table({**needed, **OF_BOTH}, table, key, rule=rule)
        counts[name] = len(table["values"]) if "values" in table else (table["count"] - 1) * 2**levels + 1
        if "count" in table and counts[name] > MAX_AXIS_COUNT:
            raise BadInput(f"{key}.count = {table['count']}: too many for {levels} levels of [refine]")
    size = math.prod(counts.values())
    if size > MAX_POINTS:
        raise BadInput(f"axes: {size:.3g} points in all; allowed: at most {MAX_POINTS:.0e}")
    if refine is not None:
        if not any(table.get("count", 1) > 1 for table in tables.values()):
            raise BadInput(
                "refine: no axis has from, to and a count above 1, so that there is nothing to refine"
            )
        if size > MAX_REFINED_POINTS:
            raise BadInput(
                f"refine: {size:.3g} points on the finest grid; allowed: at most {MAX_REFINED_POINTS:.0e}"
            )
    axes = {}
    for name, table in checked_tables.items():
        is_list = "values" in table
        values = np.array(table["values"]) if is_list else _even_values(f"axes.{name}", table, counts[name])
        offset = table.get("offset_from_family", False)
        if name in system.parameters and not offset:
            checks.check_range(system.parameters[name], f"axes.{name}", values.min(), values.max())
        values.flags.writeable = False
        own = system.parameters[name].unit if name in system.parameters else "1"
        if "display_units" in table and (unit := table.get("units") or own) != "rad":
            raise BadInput(
                f"axes.{name}.display_units = {table['display_units']!r}: only of angles with units = 'rad'; {name} has {unit!r}"
            )
        texts = {key: table.get(key, "") for key in ("long_name", "units", "display_units")}
        axes[name] = Axis(name, values, offset, **texts, table=tables[name])
    return axes


def _even_values(key: str, table: Mapping[str, Any], count: int) -> Array:
    """Return `count` distinct values between the ends in `table`, with even spacing of the values or of the logarithms."""
    first, last, spacing = checks.interval(key, table)
    if count > 1 and first == last:
        raise BadInput(f"{key}: from = to = {first:g} with count = {count}; an axis needs distinct values")
    with np.errstate(all="ignore"):  # Rounding in geomspace may overflow near the largest float.
        values = np.asarray((np.linspace if spacing == "linear" else np.geomspace)(first, last, count))
    if not (values[1:] != values[:-1]).all():
        raise BadInput(f"{key}.values: some values occur twice; an axis needs distinct values")
    return values


def parse_family(system: System, table: Mapping[str, Any]) -> tuple[str, tuple[str, ...], dict[str, Any]]:
    """Return the name of the family, the solved parameters in the order of the formulas, and the entry `branch` or `near`."""
    checks.check_keys(table, "family.", ("name", "solve", "branch", "near"))
    families = families_of(system)
    if "name" not in table:
        raise BadInput(f"family.name is missing; {allowed_text(None, families)}")
    name = checks.text("family.name", table["name"])
    if name not in families:
        from ..systems.wording import unknown_family

        why = "of a missing extension" if name in reserved_families(system.name) else "unknown family"
        raise BadInput(f"family.name = {shown(name)}: {why}; {unknown_family(name, families)}")
    family = families[name]
    solve = table.get("solve", [])
    if not isinstance(solve, list) or not all(isinstance(parameter, str) for parameter in solve):
        raise BadInput(f"family.solve = {shown(solve)}: must be a list of parameter names")
    for parameter in solve:
        if parameter in family.free:
            raise BadInput(free_message(family, parameter))
        if parameter not in family.solve:
            raise BadInput(
                f"family.solve = {shown(parameter)}: the family {name} cannot be solved for it;"
                f" {allowed_text(parameter, family.solve)}"
            )
    if len(set(solve)) < len(solve):
        raise BadInput(f"family.solve = {shown(solve)}: a parameter is named twice")
    ordered = tuple(parameter for parameter in family.solve if parameter in solve)
    near_values(system, family, ordered, table)
    return name, ordered, {key: value for key, value in table.items() if key in ("branch", "near")}


def _check_names(
    system: System, names: Mapping[str, Iterable[str]], axes: Mapping[str, Axis], ties: Mapping[str, Tie]
) -> None:
    """Raise BadInput for a name that is unused or in two sections. An axis with offset_from_family may also be solved."""
    sections: dict[str, list[str]] = {}
    for section, section_names in names.items():
        for name in section_names:
            sections.setdefault(name, []).append(section)
    for name, given_in in sections.items():
        is_offset = given_in == ["axes", "solve"] and axes[name].offset_from_family
        if len(given_in) > 1 and not is_offset:
            raise BadInput(f"{name} is given in {' and in '.join(given_in)}: a name has one value")
    # A name in a dataset cannot be a variable and also a parameter or dimension.
    variables_of_file = data_variables(system)
    for name, given_in in sections.items():
        if name in variables_of_file:
            raise BadInput(f"{given_in[0]}.{name}: an atlas has a variable of this name; choose another name")
    dims: dict[str, str] = {}
    for key, axis in axes.items():
        if axis.dim != key and axis.dim in {*system.parameters, *variables_of_file}:
            raise BadInput(
                f"axes.{key}: its dimension would be {axis.dim}, which is a parameter or variable of the {system.name}"
            )
        if axis.dim in dims:
            raise BadInput(
                f"axes.{dims[axis.dim]} and axes.{key} would both be the dimension {axis.dim} of the atlas;"
                f" choose another name for axes.{axis.dim}"
            )
        dims[axis.dim] = key
    names_in_ties = {name for tie in ties.values() for name in tie.names}
    for name, given_in in sections.items():
        if name not in system.parameters and name not in names_in_ties:
            raise BadInput(
                f"{given_in[0]}.{name}: not a parameter of the {system.name}, and no tie uses it;"
                f" {allowed_text(name, system.parameters)}"
            )


def _check_ties(
    axes: Mapping[str, Axis],
    expressions: Mapping[str, Expression],
    solve: tuple[str, ...],
    *,
    is_refined: bool,
) -> None:
    """Raise BadInput if a tie uses a solved parameter, an unsolved parameter has offsets, or random numbers depend on a refined axis."""
    for name, expression in expressions.items():
        for solved in sorted(expression.names & set(solve)):
            raise BadInput(
                f"ties.{name} = {shown(expression.text)}: {solved} is only known once [family] has solved it"
            )
    for name, axis in axes.items():
        if axis.offset_from_family and name not in solve:
            raise BadInput(
                f"axes.{name}.offset_from_family: {name} must be solved by [family], but solve = {list(solve)}"
            )
    for name in {name for tie in expressions.values() for name in tie.drawn} & axes.keys():
        if is_refined and axes[name].can_be_refined:
            raise BadInput(
                f"axes.{name}: its values number draws, between which [refine] can interpolate nothing; list them as values = [...]"
            )


def _nudge(system: System, table: Mapping[str, Any], names: set[str]) -> dict[str, float]:
    """Return the amounts of the table [nudge] by start value. `names` are all names with a value in the scene."""
    starts = [parameter.name for parameter in system.parameters.values() if parameter.start]
    checks.check_keys(table, "nudge.", starts)
    nudge = {name: checks.quantity(f"nudge.{name}", value) for name, value in table.items()}
    optional = optional_start_values(system, nudge)
    for name in optional:
        if name not in names:
            raise BadInput(
                f"nudge.{name}: the scene gives no {name} to which it could be added; nudge theta0 .. m"
            )
    if optional and optional != list(nudge):
        raise BadInput(
            f"nudge: {', '.join(nudge)} together: allowed: angles and their rates, or {', '.join(optional)} alone"
        )
    return nudge


def _integration(
    system: System, integration: Mapping[str, Any], labels: Mapping[str, Any], names: Collection[str]
) -> tuple[Duration, Duration, Settings]:
    """Return duration, transient and settings from [integration] and [labels]. Arithmetic may use `names`."""
    values = checks.from_table(
        checks.keys_of(Settings, "integration"), integration, "integration", also=["duration"]
    )
    values |= checks.from_table(checks.keys_of(Settings, "labels"), labels, "labels", also=["transient"])
    if "step" in values and "tolerance" in values:
        raise BadInput("integration: step and tolerance are both given; a scene has one of them")
    duration = Duration()
    if "duration" in integration:
        duration = parse_duration(integration["duration"], "integration.duration", names)
    check_unit(system, duration, "integration.duration")
    transient = parse_transient(system, labels.get("transient", 0), "labels.transient", names)
    check_std_tolerance(system, values.get("std_tolerance"), "labels.std_tolerance")
    settings = Settings(**values)
    check_at_points("labels.rate_tolerance", settings.rate_tolerance, names)
    return duration, transient, settings


def check_std_tolerance(
    system: System, tolerances: Mapping[str, float] | None, key: str = "std_tolerance"
) -> None:
    """Raise BadInput if the name of a tolerance is no observable of the system."""
    names = [observable.name for observable in system.observables]
    for name in tolerances or ():
        if name not in names:
            raise BadInput(
                f"{key}.{name}: not an observable of the {system.name}; {allowed_text(name, names)}"
            )


def parse_duration(value: object, key: str = "duration", names: Collection[str] = ()) -> Duration:
    """Return a duration from a number of time units or from a text, such as "60", "20 orbits" or arithmetic in `names`."""
    if not isinstance(value, str):
        return Duration(checks.positive(key, value))
    match = re.fullmatch(r"([-+]?[0-9.][-+0-9.eE]*)\s*([A-Za-z]+)", value.strip())
    unit = match[2].lower() if match else ""
    unit = unit + "s" if f"{unit}s" in DURATION_UNITS else unit
    if match is None or unit not in DURATION_UNITS:
        try:
            Expression(key, value)
        except BadInput:
            raise BadInput(
                f'{key} = {shown(value)}: allowed: a number of time units, "20 orbits" or "50 turns", or arithmetic such as'
                f' "60 / {NATURAL_RATE}"'
            ) from None
        amount = checks.positive_at_points(key, value)
        check_at_points(key, amount, names)
        return Duration(amount)
    try:
        amount = float(match[1])
    except ValueError:
        raise BadInput(f"{key} = {shown(value)}: {shown(match[1])} is not a number") from None
    if not (math.isfinite(amount) and amount > 0):
        raise BadInput(f"{key} = {shown(value)}: must be a finite number above 0")
    return Duration(amount, unit)


def parse_transient(system: System, value: object, key: str, names: Collection[str]) -> Duration:
    """Return a transient, which is 0 or a duration that `parse_duration` reads."""
    if value in (0, "0") and not isinstance(value, bool):
        return Duration(0.0)
    check_unit(system, transient := parse_duration(value, key, names), key)
    return transient


def check_at_points(key: str, amount: float | str, names: Collection[str]) -> None:
    """Raise BadInput if arithmetic uses names other than `names` and natural_rate."""
    known = {*names, NATURAL_RATE}
    for name in sorted(Expression(key, amount).names - known if isinstance(amount, str) else ()):
        raise BadInput(
            f"{key} = {shown(amount)}: {shown(name)} has no value at the points;"
            f" {allowed_text(name, sorted(known))}"
        )


def check_unit(system: System, duration: Duration, key: str = "duration") -> None:
    """Raise BadInput if a duration is in turns or orbits and the system has none. The message begins with `key`."""
    if duration.unit and not system.frame:
        raise BadInput(f"{key} = {shown(str(duration))}: nothing turns in the {system.name}; use time units")
    if duration.unit == "orbits" and system.frame_rate is None:
        raise BadInput(
            f"{key} = {shown(str(duration))}: the {system.name} has no orbit; use time units or turns"
        )
