"""Reading of a user's points from files, data frames, datasets and mappings into a mapping of column names to values."""

from __future__ import annotations

import array
import csv
import math
import re
from collections import deque
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from functools import partial
from itertools import chain
from pathlib import Path
from typing import TYPE_CHECKING, Any, TextIO, TypeAlias

import numpy as np
from numpy.typing import ArrayLike

from .. import hdf5
from ..errors import BadInput, allowed_text, one_line, shown
from ..systems.base import Array, Parameter, System
from ..variables import POINT
from .checks import check_range
from .other_columns import check_name, check_texts
from .text import open_text

if TYPE_CHECKING:
    import pandas as pd
    import xarray as xr

Values: TypeAlias = "ArrayLike | xr.DataArray"
Table: TypeAlias = (
    "Mapping[str, Values] | Sequence[Mapping[str, float]] | xr.Dataset | pd.DataFrame | str | Path"
)
FORMATS = (".csv", ".nc")
# Fill values of NetCDF by NumPy type. A file contains them where no number was written.
_UNWRITTEN = {"f4": 15 * 2.0**119, "f8": 15 * 2.0**119, "i4": -(2**31) + 1, "i8": -(2**63) + 2}
_NO_RADIANS = re.compile(r"\s*(deg|°|arc|rpm|rev|turn)", re.IGNORECASE)  # units of angles other than rad
IDENTIFIERS = ("id", "index", "name", "number", "point")  # lower-case names of columns that name points


def table(source: Any, parameters: Collection[str], keep: Collection[str] = ()) -> dict[str, Any]:
    """Return columns by name from a .csv or .nc file, a Dataset, a mapping, a list of mappings, a DataFrame or a row.

    Columns of a Dataset are the data variables and the coordinates in `parameters` or `keep`, as DataArrays with all other
    coordinates. A single dimension is renamed "point" and loses its index, unless `parameters` or `keep` has its name. The index of
    a DataFrame becomes the column "point", unless `parameters` or `keep` has the name of the index. An unnamed index 0, 1, ... is dropped.
    """
    import xarray as xr

    names = {*parameters, *keep}
    if isinstance(source, str | Path):
        return read(source, parameters, keep)
    if hasattr(source, "collect") and hasattr(source, "collect_schema"):  # a LazyFrame of polars
        source = source.collect()
    if hasattr(source, "column_names") and hasattr(source, "to_pandas"):  # a table of pyarrow
        source = source.to_pandas()
    if isinstance(source, xr.Dataset):
        columns = [n for n in source.variables if n in source.data_vars or n in names]
        for dim in map(str, source.dims):
            if not any(dim in source[name].dims for name in columns):
                raise BadInput(f"{dim}: no parameter varies along it; {allowed_text(dim, sorted(names))}")
        if len(source.dims) == 1 and (only := next(iter(source.dims))) not in names:
            # The dataset is a list of points. A single-level index merely numbers the points.
            index = [only] if only in source.indexes and source.indexes[only].nlevels == 1 else []
            for name in index:
                check_name(str(name), source[name], {*parameters} - {*columns})
            source = source.drop_vars(index).rename({only: "point"} if only != "point" else {})
        return {str(name): source[name] for name in columns}
    if isinstance(source, CsvColumns):
        return source
    if isinstance(source, Mapping):
        return {str(name): values for name, values in source.items()}
    labels: Any = getattr(source, "index", None)
    of_pandas = hasattr(labels, "nlevels")
    # A lazy table has no length and may warn about access to `columns`. In a table with `column_names`, `columns` may be arrays.
    if hasattr(source, "__len__") and hasattr(source, "columns") and not hasattr(source, "column_names"):
        values: dict[str, Any] = {str(name): np.asanyarray(source[name]) for name in source.columns}
        if not of_pandas:
            return values
        if labels.nlevels > 1:
            raise BadInput(
                f"points: an index of {labels.nlevels} levels; reset_index() makes columns of them"
            )
        if labels.name in names:
            return {str(labels.name): np.asarray(labels)} | values
        check_name(str(labels.name), labels, {*parameters} - {*values})
        numbers_rows = labels.name is None and np.array_equal(labels, range(len(labels)))
        return values if numbers_rows else {POINT: np.asarray(labels)} | values
    if of_pandas and hasattr(source, "to_dict"):  # a DataFrame's row; texts and identifiers are left out
        row = {str(name): value for name, value in source.to_dict().items()}
        naming = {n for n, v in row.items() if isinstance(v, str) or n.lower() in IDENTIFIERS} - names
        _check_others(parameters, {name: row[name] for name in naming}, row, keep)
        return {name: value for name, value in row.items() if name not in naming}
    if isinstance(source, Sequence) and all(isinstance(point, Mapping) for point in source):
        if not source:
            raise BadInput("points: there are none")
        for i, row in enumerate(source):
            if different := set(row) ^ set(source[0]):
                raise BadInput(
                    f"points: number {i} and number 0 differ in {', '.join(sorted(map(str, different)))}"
                )
        return {str(name): [row[name] for row in source] for name in source[0]}
    raise BadInput(
        f"points: {type(source).__name__} cannot be read; allowed: a mapping of columns, a list of mappings,"
        " a Dataset, a DataFrame or a row of it, the name of a .csv or .nc file"
    )


def read(
    path: str | Path,
    parameters: Collection[str],
    keep: Collection[str] = (),
    max_bytes: float = math.inf,
    max_fields: float = math.inf,
) -> dict[str, Any]:
    """Return the columns of a .csv or .nc file, as in `table`. Raise BadInput above the limits on bytes and CSV fields."""
    path = Path(path)
    if path.suffix.lower() not in FORMATS:
        raise BadInput(f"{path}: points are read from files that end in {' or '.join(FORMATS)}")
    try:
        if not path.is_file():
            kind = "a folder" if path.is_dir() else "no regular file"
            raise BadInput(f"{path}: " + (f"this is {kind}" if path.exists() else "there is no such file"))
        size = path.stat().st_size
    except OSError as error:
        raise BadInput(f"{path}: cannot be read: {error.strerror}") from None
    _check_bytes(path, size, max_bytes)
    if path.suffix.lower() == ".csv":
        with open_text(path) as file:
            return read_csv(file, str(path), parameters, max_fields)
    import xarray as xr

    try:
        hdf5.check_contained(path)
        with xr.open_dataset(path, engine="netcdf4", decode_times=False) as ds:
            if len(ds.dims) > 1:
                dims = ", ".join(map(str, ds.dims))
                raise BadInput(f"{path}: has the dimensions {dims}; points need one")
            _check_bytes(path, ds.nbytes, max_bytes)
            ds.load()
    except Exception as error:  # A damaged file may raise any error.
        raise hdf5.unreadable(path, error) from None
    try:
        return table(ds, parameters, keep)
    except BadInput as error:
        raise BadInput(f"{path}: {error}") from None


def kept_columns(
    system: System, table: Mapping[str, Any], keep: Collection[str] = (), ties: Collection[str] = ()
) -> dict[str, xr.DataArray]:
    """Return the columns that name points. Raise BadInput for probably mistyped parameters, and for angles in other units than rad.

    These columns contain texts, or are named in IDENTIFIERS or `keep`. Columns named in `ties` contain numbers and are left out.
    """
    import xarray as xr

    for name in keep:
        if name not in table:
            raise BadInput(f"keep: {shown(name)} is no column of the points")
        if name in system.parameters:
            raise BadInput(f"keep: {shown(name)} is a parameter, which the result contains anyhow")
    for name in (name for name in table if name in system.parameters):
        needed, unit = system.parameters[name].unit, str(getattr(table[name], "attrs", {}).get("units", ""))
        if "rad" in needed and _NO_RADIANS.match(unit):
            raise BadInput(f"{name}: its units are {shown(unit)}; must be {needed}")
    result = {}
    for name, values in ((name, table[name]) for name in table if name not in {*system.parameters, *ties}):
        column = values if isinstance(values, xr.DataArray) else np.asarray(values)
        is_text = column.dtype.kind in "UT"
        if column.dtype.kind == "O":  # such as texts with missing values
            is_text = any(isinstance(value, str) for value in np.ravel(column))
        if is_text or name in keep or name.lower() in IDENTIFIERS:
            if isinstance(column, xr.DataArray) and column.ndim:
                result[name] = column
            elif column.ndim == 1:
                result[name] = xr.DataArray(column, dims="point")
    _check_others(system.parameters, {name: result[name] for name in result.keys() - {*keep}}, table, keep)
    return result


def _check_others(
    parameters: Collection[str], others: Mapping[str, Any], columns: Mapping[str, Any], keep: Collection[str]
) -> None:
    """Raise BadInput if one of the columns `others` may be a mistyped parameter, or if no column is a parameter."""
    source = f"{columns.source}: " if isinstance(columns, CsvColumns) else ""
    try:
        for name in (name for name in columns if name in others and name.lower() not in IDENTIFIERS):
            check_texts(name, others[name], parameters)
        if others and not columns.keys() - others.keys() - {*keep}:
            raise BadInput(
                f"none of the columns is a parameter: {', '.join(columns)}; allowed: {', '.join(parameters)}"
            )
    except BadInput as error:
        raise BadInput(f"{source}{error}") from None


def parameter_arrays(
    system: System, columns: Mapping[str, Any], keep: Collection[str] = (), **others: Any
) -> tuple[tuple[str, ...], tuple[xr.DataArray, ...], dict[str, xr.DataArray]]:
    """Return the names of parameters in a table, aligned float64 arrays (parameters, then `others`), and the columns that name points."""
    import xarray as xr

    name_columns = kept_columns(system, columns, keep)
    names, arrays = tuple(name for name in columns if name not in name_columns), []
    for name in names:
        if name not in system.parameters:
            file = f"{columns.source}: " if isinstance(columns, CsvColumns) else ""
            raise BadInput(
                f"{file}{name}: not a parameter of the {system.name}; {allowed_text(name, system.parameters)}"
            )
    for name, values in [*((name, columns[name]) for name in names), *others.items()]:
        array = _numbers(name, values)
        for coordinate in array.coords.keys() - {*system.parameters, *keep}:
            check_name(str(coordinate), array[coordinate], system.parameters.keys() - columns)
        array = array.drop_vars(array.coords.keys() & system.parameters.keys() - array.indexes.keys())
        if array.dims == (name,):
            array = array.drop_vars(name, errors="ignore").assign_coords({name: array.data})
        arrays.append(array)
    every = zip((*names, *others, *name_columns), (*arrays, *name_columns.values()), strict=True)
    common_size({name: array.sizes["point"] for name, array in every if "point" in array.dims})
    try:
        return names, xr.align(*arrays, join="exact"), name_columns
    except ValueError as error:
        raise BadInput(f"arrays of different points: {one_line(error)}") from None


def _numbers(name: str, values: Any) -> xr.DataArray:
    """Return a number, 1-D array or DataArray as a float64 DataArray. Dask arrays stay lazy. Raise BadInput for other values."""
    import xarray as xr

    check_written(name, values)
    try:
        array = values if hasattr(values, "__dask_graph__") else np.asarray(values)
        kind = array.dtype.kind
        if kind not in "iufO" or (kind == "O" and any(isinstance(v, str | bool) for v in np.ravel(array))):
            raise TypeError
        array = array.astype(np.float64)
    except (TypeError, ValueError, OverflowError):  # for example, rows of different lengths
        raise BadInput(f"{name} = {shown(values)}: must be a number or an array of numbers") from None
    if isinstance(array, xr.DataArray):
        return array
    if array.ndim > 1:
        dimensions = f"{array.ndim} dimensions; give a DataArray, whose dimensions have names"
        raise BadInput(f"{name}: an array of {dimensions} (its shape: {array.shape})")
    return xr.DataArray(array, dims=["point"][: array.ndim])


def check_written(name: str, values: Any) -> None:
    """Raise BadInput if values are masked or are fill values of NetCDF. Lazy arrays are not checked."""
    if getattr(values, "chunks", None) is not None:
        return
    if isinstance(values, Sequence):
        mask = np.array([value is np.ma.masked for value in values])
    else:
        array = np.ma.asarray(values)
        mask = np.ma.getmaskarray(array)
        if (number := _UNWRITTEN.get(array.dtype.str[1:])) is not None:
            mask = mask | (array.data == number)
    if mask.any():
        place = f"point {np.flatnonzero(mask)[0]} (counted from 0): " if mask.ndim else ""
        raise BadInput(f"{place}{name} is masked or was never written; must be a finite number")


def point_columns(system: System, points: Any) -> tuple[dict[str, Array], int]:
    """Return checked columns of every parameter, with nan for absent optional start values, and the number of points."""
    source = table(points, system.parameters)
    names, arrays, _ = parameter_arrays(system, source)
    values = [array.values for array in arrays]
    shape = np.broadcast_shapes(*(each.shape for each in values))
    return flat_columns(system, names, values, shape, source), math.prod(shape)


def flat_columns(
    system: System, names: Sequence[str], values: Sequence[Array], shape: tuple[int, ...], source: Any
) -> dict[str, Array]:
    """Return checked columns of every parameter from arrays that broadcast to `shape`. Messages name a line of `source`."""
    columns, by_name = {}, dict(zip(names, values, strict=True))
    for name, parameter in system.parameters.items():
        column = by_name.get(name, np.asarray(parameter.default))
        if column.ndim:
            column = np.broadcast_to(column, shape).ravel()
        _check_column(parameter, column, source)
        columns[name] = np.broadcast_to(column, math.prod(shape)).astype(np.float64)
    return columns


def _check_column(parameter: Parameter, column: Array, source: Mapping[str, Any] | None) -> None:
    """Raise BadInput if a value is out of range or not finite. Optional start values may be nan."""
    name = parameter.name
    missing = np.isnan(column) & np.isnan(parameter.default)
    if missing.all():
        return
    bad = np.flatnonzero(~(np.isfinite(column) | missing))
    if bad.size:
        location, value = _location(source, column, bad[0]), column.ravel()[bad[0]]
        if np.isnan(value) and isinstance(source, CsvColumns):
            raise BadInput(f"{location}{name} is empty or nan; must be a finite number")
        raise BadInput(f"{location}{name} = {value:g}: must be a finite number")
    for i in (np.nanargmin(column), np.nanargmax(column)):
        value = float(column.ravel()[i])
        try:
            check_range(parameter, name, value, value)
        except BadInput as error:
            raise BadInput(f"{_location(source, column, i)}{error}") from None


def _location(source: Mapping[str, Any] | None, column: Array, point: np.integer) -> str:
    """Return the beginning of an error message about a point of a column."""
    if isinstance(source, CsvColumns):
        return f"{source.location(int(point))}: "
    return f"point {point} (counted from 0): " if column.ndim and source is not None else ""


def common_size(sizes: Mapping[str, int]) -> int:
    """Return the common length of columns, or 1 if there are no columns. Raise BadInput if lengths differ or are 0."""
    if len(set(sizes.values())) > 1:
        lengths = ", ".join(f"{name}: {size}" for name, size in sizes.items())
        raise BadInput(f"points: columns of different lengths ({lengths})")
    size = next(iter(sizes.values()), 1)
    if size == 0:
        raise BadInput("points: there are none")
    return size


def _check_bytes(path: Path, size: float, max_bytes: float) -> None:
    """Raise BadInput if a file, or the variables in a file, have more than `max_bytes` bytes."""
    if size > max_bytes:
        raise BadInput(
            f"{path}: {size:.3g} bytes; a scene reads at most {max_bytes:.3g}: use atlas points or atlas.label_points"
        )


SEPARATORS = ("\t", ";", ",", " ")  # The first that occurs in the line of names separates the fields.
INDEX = "index"  # name for an unnamed first column, which is the index in files of pandas
# Largest numbers of characters of a line and of a table. A file that is no table may be a single line, and a pipe may have no end.
MAX_LINE, MAX_TABLE = 1_000_000, 2**31
MAX_COMMENTS = 20  # names of columns are sought in at most this many comments before the first point


class CsvColumns(dict[str, Any]):
    """Columns of a CSV file by name, with the name of the file, and the line of each point counted from 1."""

    def __init__(self, columns: dict[str, Any], source: str, lines: array.array[int]):
        super().__init__(columns)
        self.source = source
        self.lines = lines

    def location(self, point: int) -> str:
        """Return the file and line of a point as text."""
        return f"{self.source}, line {self.lines[point]}"


def read_csv(file: TextIO, source: str, numeric: Collection[str], max_fields: float = math.inf) -> CsvColumns:
    """Return the columns of a CSV file, with nan for empty fields of `numeric` columns. BadInput names file and line.

    The first line names the columns. If this line has numbers, an earlier comment may name the columns, as in files of numpy.savetxt.
    """
    number = size = 0  # number of the last line read, and number of characters read so far
    comments: deque[str] = deque(maxlen=MAX_COMMENTS)

    def content_lines() -> Iterator[str]:
        """Yield the lines that are neither empty nor comments."""
        nonlocal number, size
        for line in iter(partial(file.readline, MAX_LINE + 1), ""):
            number, size = number + 1, size + len(line)
            if len(line) > MAX_LINE:
                raise BadInput(f"{source}, line {number}: more than {MAX_LINE} characters")
            if size > MAX_TABLE:
                raise BadInput(f"{source}: more than {MAX_TABLE} characters; give larger tables as .nc")
            if line.lstrip().startswith("#"):
                comments.append(line.strip().lstrip("# "))
            elif line.strip():
                yield line

    lines = content_lines()
    names = first = next(lines, "")
    line_numbers = array.array("q")
    try:
        if any(map(_is_number, next(_rows([first], _separator(first)), []))):
            before = max(reversed(comments), key=lambda line: _names_held(line, first, numeric), default="")
            if _names_held(before, first, numeric):
                names, lines = before, chain([first], lines)
        separator = _separator(names)
        header = _header(source, next(_rows([names], separator), []))
        columns: dict[str, Any] = {name: array.array("d") if name in numeric else [] for name in header}

        cells = [(name, columns[name].append, _number if name in numeric else str.strip) for name in header]
        max_rows = max_fields / len(header)
        in_blanks = f", separated by blanks: {', '.join(header)}" if separator == " " else ""
        for row in _rows(lines, separator):
            if len(row) != len(header):
                raise BadInput(
                    f"{source}, line {number}: {len(row)} fields, but the first line names"
                    f" {len(header)} columns{in_blanks}"
                )
            line_numbers.append(number)
            if len(line_numbers) > max_rows:
                raise BadInput(
                    f"{source}: more than {max_fields:.0f} fields; label more with atlas points or"
                    " atlas.label_points"
                )
            for (name, append, convert), field in zip(cells, row, strict=True):
                try:
                    append(convert(field))
                except ValueError:
                    comma = re.fullmatch(r"\s*[-+]?\d+,\d+\s*", field)
                    form = "a number with a decimal point, not a comma" if comma else "a number"
                    raise BadInput(
                        f"{source}, line {number}: {name} = {shown(field)}: must be {form}"
                    ) from None
    except csv.Error as error:
        raise BadInput(f"{source}, line {number}: not a CSV file: {error}") from None
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


def _separator(names: str) -> str:
    """Return the separator of fields in a line of names."""
    return next((each for each in SEPARATORS if each in names.strip(" \r\n")), ",")


def _rows(lines: Iterable[str], separator: str) -> Iterator[list[str]]:
    """Yield the fields of each line."""
    if separator == " ":
        lines = (line.strip() + "\n" for line in lines)
    return csv.reader(lines, delimiter=separator, skipinitialspace=True, strict=True)


def _names_held(comment: str, first: str, numeric: Collection[str]) -> int:
    """Return the number of `numeric` names in a comment, or 0 unless the comment has as many fields as the line `first`."""
    separator = _separator(comment)
    try:
        names, fields = (next(_rows([line], separator), []) for line in (comment, first))
    except csv.Error:
        return 0
    return sum(name.strip() in numeric for name in names) if len(names) == len(fields) else 0


def _is_number(text: str) -> bool:
    """Whether a text is a number."""
    try:
        return not math.isnan(_number(text))
    except ValueError:
        return False


def _number(field: str) -> float:
    """Return the number in a field, or nan for an empty field. Other texts raise ValueError, as does 1_000."""
    if "_" in field:
        raise ValueError
    return float(field.strip() or "nan")


def _header(source: str, fields: list[str]) -> list[str]:
    """Return the names of the columns. Raise BadInput unless all names differ."""
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


def _numbers_if_possible(texts: list[str]) -> np.ndarray:
    """Return a column of numbers if all texts are numbers, otherwise a column of texts."""
    if all(text.isdecimal() and len(text) < 19 for text in texts):
        return np.array([int(text) for text in texts])
    try:
        return np.array([_number(text) for text in texts])
    except ValueError:
        return np.array(texts)
