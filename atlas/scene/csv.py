"""Points from CSV files, as spreadsheets and pandas write them.

Fields are separated by commas, semicolons or tabs; empty lines and lines that begin with # are skipped. Python's own
reader is used instead of that of pandas, which neither counts the fields of a line nor names the line of an error, and
whose numbers are exact to the last bit only in some versions.
"""

from __future__ import annotations

import array
import csv
import math
import re
from collections.abc import Collection, Iterable, Iterator
from typing import Any

import numpy as np

from ..errors import BadInput, shown

SEPARATORS = ("\t", ";", ",")  # the first one in the line of names
INDEX = "index"  # name of a first column without name, as pandas writes it
MAX_LINE = 1_000_000  # characters; a file that is no table may be one line


class CsvColumns(dict[str, Any]):
    """Columns of a CSV file by name, with the line of the file for each point.

    source: name of the file; lines: line of each point, counted from 1.
    """

    def __init__(self, columns: dict[str, Any], source: str, lines: array.array[int]):
        super().__init__(columns)
        self.source = source
        self.lines = lines

    def location(self, point: int) -> str:
        """File and line of a point."""
        return f"{self.source}, line {self.lines[point]}"


def read(
    lines: Iterable[str], source: str, numeric: Collection[str], max_fields: float = math.inf
) -> CsvColumns:
    """Columns of a CSV file whose first line names them.

    lines: the lines of the file, each with its end; source: name of the file, for error messages. numeric:
    names whose columns must be numbers; an empty field is nan. Other columns may hold text. max_fields:
    number of fields that are read at most. Returns arrays of float64; those of other columns than `numeric`
    may be of int64, or of str where not all fields are numbers. Raises BadInput with one line that names the
    file and the line.
    """
    content = _Lines(lines, source)
    first = next(content, "")
    separator = next((each for each in SEPARATORS if each in first), ",")
    line_numbers = array.array("q")
    try:
        header = _header(source, next(_reader([first], separator), []))
        columns: dict[str, Any] = {name: array.array("d") if name in numeric else [] for name in header}
        cells = [(columns[name].append, _number if name in numeric else str.strip) for name in header]
        max_rows = max_fields / len(header)
        for row in _reader(content, separator):
            if len(row) != len(header):
                raise BadInput(
                    f"{source}, line {content.number}: {len(row)} fields, but the first line names"
                    f" {len(header)} columns"
                )
            line_numbers.append(content.number)
            if len(line_numbers) > max_rows:
                raise BadInput(
                    f"{source}: more than {max_fields:.0f} fields; label more with atlas points or"
                    " atlas.label_points"
                )
            try:
                for (append, convert), field in zip(cells, row, strict=True):
                    append(convert(field))
            except ValueError:
                raise BadInput(
                    f"{source}, line {content.number}: {_field_error(header, row, numeric)}"
                ) from None
    except csv.Error as error:
        raise BadInput(f"{source}, line {content.number}: not a CSV file: {error}") from None
    if not line_numbers:
        raise BadInput(f"{source}: no points: there is only the line of names")
    return CsvColumns(
        {
            name: np.frombuffer(values) if name in numeric else _numbers_if_possible(values)
            for name, values in columns.items()
        },
        source,
        line_numbers,
    )


class _Lines:
    """The lines of a file without empty ones and comments, and the number of the last line read."""

    def __init__(self, lines: Iterable[str], source: str):
        self.number = 0
        self._lines = iter(lines)
        self._source = source

    def __iter__(self) -> Iterator[str]:
        return self

    def __next__(self) -> str:
        for line in self._lines:
            self.number += 1
            if len(line) > MAX_LINE:
                raise BadInput(f"{self._source}, line {self.number}: more than {MAX_LINE} characters")
            if line.strip() and not line.lstrip().startswith("#"):
                return line
        raise StopIteration


def _reader(lines: Iterable[str], separator: str) -> Iterator[list[str]]:
    """Fields of each line."""
    return csv.reader(lines, delimiter=separator, skipinitialspace=True, strict=True)


def _header(source: str, fields: list[str]) -> list[str]:
    """Names of the columns, all different."""
    header = [name.strip() for name in fields]
    if not any(header):
        raise BadInput(f"{source}: empty; its first line must name the columns, such as C,theta0,m")
    if not header[0] and INDEX not in header:
        header[0] = INDEX
    earlier: set[str] = set()
    for name in header:
        if not name or name in earlier:
            problem = f"names {shown(name)} twice" if name else "leaves a column without name"
            raise BadInput(f"{source}: its first line {problem}: {','.join(header)}")
        earlier.add(name)
    return header


def _number(field: str) -> float:
    """The number in a field, nan if it is empty."""
    return float(field.strip() or "nan")


def _field_error(header: list[str], row: list[str], numeric: Collection[str]) -> str:
    """Error message about the first field of a line that must be a number and is none."""
    for name, field in zip(header, row, strict=True):
        try:
            if name in numeric:
                _number(field)
        except ValueError:
            comma = re.fullmatch(r"\s*[-+]?\d+,\d+\s*", field)
            return f"{name} = {shown(field)}: must be a number{' with a decimal point, not a comma' if comma else ''}"
    raise AssertionError("every field is a number")


def _numbers_if_possible(texts: list[str]) -> np.ndarray:
    """The texts of a column, as numbers if all are."""
    if all(text.isdecimal() and len(text) < 19 for text in texts):
        return np.array([int(text) for text in texts])
    try:
        return np.array([float(text) if text else math.nan for text in texts])
    except ValueError:
        return np.array(texts)
