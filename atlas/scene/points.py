"""The table [points] of a scene, which gives points by a sample, a file or a list instead of axes."""

from __future__ import annotations

import re
import tomllib
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ..errors import BadInput, shown
from ..systems.base import System
from . import checks, tables
from .checks import checked
from .expressions import PointColumn
from .tables import CsvColumns
from .text import read_text

SAMPLES = ("latin_hypercube", "sobol")
# Largest number of points of a sample, and largest number of values, which is the number of points times the number of ranges.
MAX_SAMPLED_POINTS = MAX_SAMPLED_NUMBERS = 10**7
MAX_COLUMNS = 100  # largest number of columns of a table or file of points
# Largest size of a points file, in bytes and in CSV fields. Fields may outnumber values, because some columns only name points.
MAX_FILE_BYTES, MAX_FILE_FIELDS = 50_000_000, 5 * checks.MAX_LISTED_NUMBERS

RANGES = checks.Check(
    checks.mapping.read,
    {"type": "object", "minProperties": 1, "additionalProperties": checks.table_schema(checks.INTERVAL)},
)


@dataclass(frozen=True, kw_only=True)
class Sample:
    """Quasi-random points within ranges."""

    sample: str = checked(
        checks.one_of(SAMPLES), description="quasi-random points that fill the ranges evenly"
    )
    count: int = checked(checks.whole(1, MAX_SAMPLED_POINTS), description="number of points")
    seed: int = checked(checks.SEED, 0)  # seed of the random numbers
    ranges: Mapping[str, Any] = checked(RANGES)  # tables with from, to and spacing, by name


KEYS: checks.Keys = {
    **checks.keys_of(Sample),
    "file": checked(
        checks.text, description=".csv with names in its first line, or .nc; a path from the scene's folder"
    ),
    "values": checked(
        checks.Check(
            checks.mapping.read,
            {"type": "object", "minProperties": 1, "additionalProperties": checks.numbers.schema},
        )
    ),
}


def read_points(
    system: System, table: Mapping[str, Any], ties: Mapping[str, Any], folder: Path | None
) -> tuple[dict[str, Any], dict[str, PointColumn]]:
    """Return the table [points] and its columns by name. If the table names a file in `folder`, the file's numbers replace the name."""
    checks.check_keys(table, "points.", KEYS)
    sources = [key for key in ("sample", "file", "values") if key in table]
    if len(sources) != 1:
        present = " and ".join(sources) or "none"
        raise BadInput(f"points: needs one of sample, file and values, found {present}")
    if sources == ["sample"]:
        sample = checks.instance_of(Sample, table, "points")
        return vars(sample), _sampled_columns(system, sample)
    for key in ("count", "seed", "ranges"):
        if key in table:
            raise BadInput(f"points.{key}: only together with sample")
    values: dict[str, Any]
    if sources == ["values"]:
        values = {
            name: checks.numbers(f"points.values.{name}", column)
            for name, column in checks.mapping("points.values", table["values"]).items()
        }
    else:
        if folder is None:
            raise BadInput(
                "points.file: only a scene file may name one; the scene of an atlas has points.values"
            )
        texts = [text for text in ties.values() if isinstance(text, str)]
        words = {word for text in texts for word in re.findall(r"\w+", text)}
        path = folder / checks.text("points.file", table["file"])
        values = tables.read(path, {*system.parameters, *words}, (), MAX_FILE_BYTES, MAX_FILE_FIELDS)
        for name in tables.kept_columns(system, values, ties=words):
            del values[name]
    _check_columns(values)
    location = values.location if isinstance(values, CsvColumns) else None
    columns = {name: _listed_column(system, name, column, location) for name, column in values.items()}
    if not columns:
        raise BadInput("points: there are none")
    size = len(columns) * tables.common_size({name: each.column.size for name, each in columns.items()})
    if size > checks.MAX_LISTED_NUMBERS:
        raise BadInput(
            f"points: {size} numbers; a scene takes at most {checks.MAX_LISTED_NUMBERS};"
            " label more with atlas points or atlas.label_points"
        )
    return {"values": {name: column.column.tolist() for name, column in columns.items()}}, columns


def file_of(scene: Path) -> list[Path]:
    """Return the path of the points file that a scene file names, in a list that is empty if the scene names no file."""
    if not scene.is_file():  # A pipe could not be read a second time.
        return []
    try:
        file = tomllib.loads(read_text(scene))["points"]["file"]
    except (BadInput, ValueError, RecursionError, KeyError, TypeError):
        return []
    return [scene.parent / file] if isinstance(file, str) else []


def quasi_random(kind: str, dimensions: int, count: int, seed: int) -> np.ndarray:
    """Return quasi-random numbers in the unit cube, (dimensions, count). A "sobol" sample is balanced if `count` is a power of 2."""
    from scipy.stats import qmc

    if kind == "latin_hypercube":
        points = qmc.LatinHypercube(dimensions, seed=seed).random(count)
    else:
        # SciPy warns about a count that is no power of two, so take the first points of the next power of two.
        points = qmc.Sobol(dimensions, seed=seed).random_base2((count - 1).bit_length())[:count]
    return np.ascontiguousarray(points.T)


def _sampled_columns(system: System, sample: Sample) -> dict[str, PointColumn]:
    """Return the columns of a sample, which are quasi-random numbers stretched over the range of each name."""
    if not sample.ranges:
        raise BadInput(
            "points.ranges: a sample needs at least one [points.ranges.NAME] table with from and to"
        )
    _check_columns(sample.ranges)
    if sample.count * len(sample.ranges) > MAX_SAMPLED_NUMBERS:
        raise BadInput(
            f"points: {sample.count} points of {len(sample.ranges)} ranges; allowed: at most"
            f" {MAX_SAMPLED_NUMBERS} numbers in all"
        )
    unit_cube = quasi_random(sample.sample, len(sample.ranges), sample.count, sample.seed)
    columns = {}
    for (name, table), fraction in zip(sample.ranges.items(), unit_cube, strict=True):
        key = f"points.ranges.{checks.identifier('points.ranges', name)}"
        if not isinstance(table, Mapping):
            raise BadInput(f"{key} = {shown(table)}: must be a table with from and to")
        ends = checks.from_table(checks.INTERVAL, table, key, rule="a range needs from and to")
        first, last, spacing = checks.interval(key, ends)
        if first == last:
            raise BadInput(f"{key}: from = to = {first:g}; put what does not vary into [fixed]")
        if name in system.parameters:
            checks.check_range(system.parameters[name], key, min(first, last), max(first, last))
        if spacing == "linear":
            columns[name] = PointColumn(key, first + (last - first) * fraction)
        else:
            columns[name] = PointColumn(key, first * (last / first) ** fraction)
    return columns


def _listed_column(
    system: System, name: str, values: Any, location: Callable[[int], str] | None
) -> PointColumn:
    """Return a checked column of a file or list. `location` gives the file and line of a point for messages."""
    key = f"points.values.{checks.identifier('points', name)}"
    tables.check_written(key, values)
    try:
        column = np.asarray(values, np.float64)
    except (TypeError, ValueError, OverflowError):
        raise BadInput(f"{key}: must be numbers") from None
    if column.ndim != 1 or not column.size:
        raise BadInput(f"{key}: must be one number for each point")
    if not np.isfinite(column).all():
        i = int(np.flatnonzero(~np.isfinite(column))[0])
        if location is not None:
            problem = "is empty or nan" if np.isnan(column[i]) else f"= {column[i]:g}"
            raise BadInput(f"{location(i)}: {name} {problem}; must be a finite number")
        raise BadInput(f"{key}: {column[i]} at point {i} (counted from 0); must be finite numbers")
    if name in system.parameters:
        checks.check_range(system.parameters[name], key, column.min(), column.max())
    return PointColumn(key, column)


def _check_columns(columns: Mapping[str, Any]) -> None:
    """Raise BadInput if there are more columns than a scene may have."""
    if len(columns) > MAX_COLUMNS:
        raise BadInput(f"points: {len(columns)} names; allowed: at most {MAX_COLUMNS}")
