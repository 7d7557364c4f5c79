"""Points of one's own as columns by name: from files, data frames, datasets and mappings."""

from __future__ import annotations

import array
import csv
import math
from collections.abc import Collection, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from ..errors import BadInput, shown
from ..files import one_line, open_text
from ..systems.base import Array, System
from .checks import check_range

FORMATS = (".csv", ".nc")


def table(source: Any, names: Collection[str]) -> dict[str, Any]:
    """Columns by name from anything that holds points.

    Parameters
    ----------
    source : path, Dataset, mapping, sequence of mappings or data frame
        A file (.csv with names in its first line, or .nc with variables along one dimension), an xarray
        Dataset, a mapping name -> values, a list with one mapping for each point, or any object with
        `columns` and [name], such as a pandas.DataFrame.
    names : collection of str
        Names that are wanted: the coordinate that numbers the points of a Dataset is a column only if
        its name is among them.

    Returns
    -------
    dict
        Name -> values as the source holds them; numbers for a CSV file.

    Raises
    ------
    BadInput
        With one line, if the source cannot be read or holds no points.
    """
    import xarray as xr

    if isinstance(source, str | Path):
        return read(source, names)
    if isinstance(source, xr.Dataset):
        return _dataset_columns(source, names)
    if isinstance(source, Mapping):
        return {str(name): values for name, values in source.items()}
    if hasattr(source, "columns") and hasattr(source, "__getitem__"):
        return {str(name): np.asarray(source[name]) for name in source.columns}
    if isinstance(source, Sequence) and all(isinstance(point, Mapping) for point in source):
        return _columns_of_rows(source)
    raise BadInput(
        f"points: {type(source).__name__} cannot be read; allowed: a mapping of columns, a list of mappings,"
        " a Dataset, a DataFrame, the name of a .csv or .nc file"
    )


def read(path: str | Path, names: Collection[str], max_bytes: float = math.inf) -> dict[str, Any]:
    """Columns of a .csv or .nc file, as `table`; an empty field of a CSV file is nan.

    max_bytes: size of the file, and of its variables in memory, beyond which it is not read.
    """
    path = Path(path)
    if path.suffix not in FORMATS:
        raise BadInput(f"{path}: points are read from files that end in {' or '.join(FORMATS)}")
    try:
        if not path.is_file():
            raise BadInput(f"{path}: " + ("this is a folder" if path.is_dir() else "there is no such file"))
        size = path.stat().st_size
    except OSError as error:
        raise BadInput(f"{path}: cannot be read: {error.strerror}") from None
    _check_bytes(path, size, max_bytes)
    return _read_csv(path) if path.suffix == ".csv" else _read_netcdf(path, names, max_bytes)


def point_columns(system: System, points: Any) -> tuple[dict[str, Array], int]:
    """Every parameter of the system as a column, checked.

    Parameters
    ----------
    system : System
        The system whose parameters the points give; those left out take their defaults.
    points : mapping or other table
        Parameter -> number or 1-D array (all arrays of one length), or any other source of `table`.

    Returns
    -------
    columns : dict of str to ndarray
        Every parameter, float64 of shape (points,); nan for an optional start value that is not given.
    size : int
        Number of points.

    Raises
    ------
    BadInput
        For unknown names, columns of different lengths, and values that are not finite or out of range.
    """
    given: dict[str, Array] = {}
    for name, values in table(points, system.parameters).items():
        if name not in system.parameters:
            raise BadInput(
                f"{name}: not a parameter of the {system.name}; allowed: {', '.join(system.parameters)}"
            )
        given[name] = number_column(name, values)
    size = _common_size({name: column.size for name, column in given.items() if column.ndim})
    columns: dict[str, Array] = {}
    for name, parameter in system.parameters.items():
        column = given.get(name, np.asarray(parameter.default))
        absent = np.isnan(parameter.default) & np.isnan(column)
        if not (np.isfinite(column) | absent).all():
            raise BadInput(f"{name}: must be finite numbers, found {column[~np.isfinite(column)].ravel()[0]}")
        if column.size and not np.all(absent):
            check_range(parameter, name, np.nanmin(column), np.nanmax(column))
        columns[name] = np.broadcast_to(column, (size,)).astype(np.float64)
    return columns, size


def number_column(name: str, values: Any) -> Array:
    """A number or a 1-D array of numbers as a float64 array; BadInput for anything else."""
    try:
        column = np.asarray(values, dtype=np.float64)
    except (TypeError, ValueError, OverflowError):
        raise BadInput(f"{name} = {shown(values)}: must be a number or a 1-D array of numbers") from None
    if column.ndim > 1:
        raise BadInput(f"{name} has shape {column.shape}: must be a number or a 1-D array of numbers")
    return column


def _common_size(sizes: Mapping[str, int]) -> int:
    """Length of the columns, 1 if there are only numbers; BadInput if they differ or are empty."""
    if len(set(sizes.values())) > 1:
        lengths = ", ".join(f"{name}: {size}" for name, size in sizes.items())
        raise BadInput(f"points: columns of different lengths ({lengths})")
    size = next(iter(sizes.values()), 1)
    if size == 0:
        raise BadInput("points: there are none")
    return size


def _dataset_columns(ds: Any, names: Collection[str]) -> dict[str, Any]:
    """Variables of a Dataset, with those coordinates of its dimension that are wanted."""
    columns = {}
    for name in ds.variables:
        if name in ds.dims and name not in names:
            continue
        if ds[name].ndim > 1:
            dims = ", ".join(map(str, ds[name].dims))
            raise BadInput(f"{name} lies along {dims}: points need one dimension")
        columns[str(name)] = ds[name].values
    return columns


def _columns_of_rows(rows: Sequence[Mapping[Any, Any]]) -> dict[str, Any]:
    """Columns of points that are given one by one."""
    if not rows:
        raise BadInput("points: there are none")
    for i, row in enumerate(rows):
        if different := set(row) ^ set(rows[0]):
            raise BadInput(
                f"points: number {i} and number 0 differ in {', '.join(sorted(map(str, different)))}"
            )
    return {str(name): [row[name] for row in rows] for name in rows[0]}


def _read_csv(path: Path) -> dict[str, Any]:
    """Columns of a CSV file whose first line names them."""
    numbers = array.array("d")  # of all rows: millions of lists would take ten times the memory
    with open_text(path, newline="") as file:
        try:
            reader = csv.reader(file, strict=True)
            header = _csv_header(path, next(reader, []))
            for row in reader:
                if row:
                    numbers.extend(_csv_row(path, reader.line_num, header, row))
        except csv.Error as error:
            raise BadInput(f"{path}: not a CSV file: {error}") from None
    if not numbers:
        raise BadInput(f"{path}: no points: there is only the line of names")
    columns = np.frombuffer(numbers).reshape(-1, len(header))
    return {name: columns[:, i].copy() for i, name in enumerate(header)}


def _csv_header(path: Path, fields: list[str]) -> list[str]:
    """Names of the columns, all different."""
    header = [name.strip() for name in fields]
    if not any(header):
        raise BadInput(f"{path}: empty; its first line must name the columns, such as C,theta0,m")
    for name in header:
        if not name or header.count(name) > 1:
            problem = f"names {shown(name)} twice" if name else "leaves a column without name"
            raise BadInput(f"{path}: its first line {problem}: {','.join(header)}")
    return header


def _csv_row(path: Path, line: int, header: list[str], fields: list[str]) -> list[float]:
    """Numbers of one line, nan for an empty field."""
    if len(fields) != len(header):
        raise BadInput(f"{path}: line {line} has {len(fields)} fields; its first line names {len(header)}")
    row = []
    for name, field in zip(header, fields, strict=True):
        try:
            row.append(float(field) if field.strip() else math.nan)
        except ValueError:
            raise BadInput(f"{path}: line {line}: {name} = {shown(field)}: must be a number") from None
    return row


def _check_bytes(path: Path, size: float, max_bytes: float) -> None:
    """Raise BadInput for a file, or its variables, of more bytes than allowed."""
    if size > max_bytes:
        raise BadInput(
            f"{path}: {size:.3g} bytes; a scene reads at most {max_bytes:.3g}: use atlas points or atlas.label_points"
        )


def _read_netcdf(path: Path, names: Collection[str], max_bytes: float) -> dict[str, Any]:
    """Columns of a NetCDF file with one dimension."""
    import xarray as xr

    try:
        with xr.open_dataset(path, engine="netcdf4", decode_times=False) as ds:
            if len(ds.dims) > 1:
                dims = ", ".join(map(str, ds.dims))
                raise BadInput(f"{path}: has the dimensions {dims}; points need one")
            _check_bytes(path, ds.nbytes, max_bytes)
            ds.load()
    except BadInput:
        raise
    except (
        Exception
    ) as error:  # a damaged file can raise an exception of any type, also while values are read
        raise BadInput(f"{path}: not a NetCDF file that can be read ({one_line(error)})") from None
    try:
        return table(ds, names)
    except BadInput as error:
        raise BadInput(f"{path}: {error}") from None
