"""Points of one's own: columns by name from files, tables and samples; CSV files of labelled points."""

from __future__ import annotations

import csv
import math
import os
import uuid
from collections.abc import Collection, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ..errors import BadInput
from ..systems.base import System
from .model import check_range

if TYPE_CHECKING:
    import xarray as xr

FORMATS = (".csv", ".nc")
SAMPLES = ("latin_hypercube", "sobol")


def table(source: Any, names: Collection[str]) -> dict[str, Any]:
    """Columns by name from whatever holds points, as it gives them, except that CSV fields are numbers.

    source: a path (.csv with names in its first line, .nc with variables along one dimension), an xarray
    Dataset, a mapping name -> values, a sequence of mappings (one for each point), or anything with
    `columns` and [name], such as a pandas.DataFrame. names: those that are meant if a Dataset numbers
    its points by a coordinate; such a coordinate is left out unless its name is among them.

    Raises BadInput with one line for files that are not there or hold no points.
    """
    import xarray as xr

    if isinstance(source, str | Path):
        return read(source, names)
    if isinstance(source, xr.Dataset):
        kept = [name for name in source.variables if name not in source.dims or name in names]
        for name in kept:
            if source[name].ndim > 1:
                raise BadInput(
                    f"{name} lies along {', '.join(map(str, source[name].dims))}: points need one dimension"
                )
        return {str(name): source[name].values for name in kept}
    if isinstance(source, Mapping):
        return {str(name): values for name, values in source.items()}
    if hasattr(source, "columns") and hasattr(source, "__getitem__"):
        return {str(name): np.asarray(source[name]) for name in source.columns}
    if isinstance(source, Sequence) and all(isinstance(point, Mapping) for point in source):
        if not source:
            raise BadInput("points: there are none")
        for i, point in enumerate(source):
            if set(point) != set(source[0]):
                odd = sorted(set(point) ^ set(source[0]))
                raise BadInput(f"points: number {i} and number 0 differ in {', '.join(map(str, odd))}")
        return {str(name): [point[name] for point in source] for name in source[0]}
    raise BadInput(
        f"points: {type(source).__name__} cannot be read; allowed: a mapping of columns, a list of mappings,"
        " a Dataset, a DataFrame, the name of a .csv or .nc file"
    )


def read(path: str | Path, names: Collection[str]) -> dict[str, Any]:
    """Columns of a .csv or .nc file, see `table`; an empty field of a CSV file is nan."""
    path = Path(path)
    if path.suffix not in FORMATS:
        raise BadInput(f"{path}: points are read from files that end in {' or '.join(FORMATS)}")
    if not path.is_file():
        raise BadInput(f"{path}: " + ("this is a folder" if path.is_dir() else "there is no such file"))
    return _read_csv(path) if path.suffix == ".csv" else _read_netcdf(path, names)


def _read_csv(path: Path) -> dict[str, Any]:
    try:
        with path.open(encoding="utf-8-sig", newline="") as file:
            reader = csv.reader(file, strict=True)
            header = [name.strip() for name in next(reader, [])]
            if not any(header):
                raise BadInput(f"{path}: empty; its first line must name the columns, such as C,theta0,m")
            for name in header:
                if not name or header.count(name) > 1:
                    what = f"names {name!r} twice" if name else "leaves a column without name"
                    raise BadInput(f"{path}: its first line {what}: {','.join(header)}")
            rows = []
            for row in reader:
                if not row:
                    continue
                if len(row) != len(header):
                    raise BadInput(
                        f"{path}: line {reader.line_num} has {len(row)} fields; its first line names {len(header)}"
                    )
                try:
                    rows.append([float(field) if field.strip() else math.nan for field in row])
                except ValueError:
                    raise BadInput(f"{path}: line {reader.line_num}: {_not_a_number(header, row)}") from None
    except UnicodeDecodeError:
        raise BadInput(f"{path}: not a text file in UTF-8") from None
    except csv.Error as error:
        raise BadInput(f"{path}: not a CSV file: {error}") from None
    except OSError as error:
        raise BadInput(f"{path}: cannot be read: {error.strerror}") from None
    if not rows:
        raise BadInput(f"{path}: no points: there is only the line of names")
    return dict(zip(header, np.array(rows).T, strict=True))


def _not_a_number(header: list[str], row: list[str]) -> str:
    for name, field in zip(header, row, strict=True):
        try:
            float(field.strip() or "nan")
        except ValueError:
            return f"{name} = {field!r}: must be a number"
    raise AssertionError(row)


def _read_netcdf(path: Path, names: Collection[str]) -> dict[str, Any]:
    import xarray as xr

    try:
        ds = xr.open_dataset(path, engine="netcdf4", decode_times=False)
    except Exception as error:  # whatever a damaged file makes the reader say
        raise BadInput(
            f"{path}: not a NetCDF file that can be read ({' '.join(str(error).split())[:200]})"
        ) from None
    with ds:
        if len(ds.dims) > 1:
            raise BadInput(f"{path}: has the dimensions {', '.join(map(str, ds.dims))}; points need one")
        try:
            return table(ds.load(), names)
        except BadInput as complaint:
            raise BadInput(f"{path}: {complaint}") from None


def sample(kind: str, dimensions: int, count: int, seed: int) -> np.ndarray:
    """Quasi-random numbers in [0, 1), float64 of shape (dimensions, count).

    kind: one of SAMPLES; "sobol" is scrambled, and best where count is a power of two. The numbers
    depend on the arguments and the version of SciPy alone.
    """
    from scipy.stats import qmc

    if kind == "latin_hypercube":
        found = qmc.LatinHypercube(dimensions, seed=seed).random(count)
    else:
        # the next power of two: scipy warns of any other number, whose first points these are
        found = qmc.Sobol(dimensions, seed=seed).random_base2((count - 1).bit_length())[:count]
    return np.ascontiguousarray(found.T)


def write_csv(ds: xr.Dataset, path: Path) -> None:
    """Write labelled points as CSV in one move: parameters, then variables, flags by their names."""
    columns: dict[str, list[Any]] = {}
    for name in [*ds.coords, *ds.data_vars]:
        array = ds[name]
        if array.dims == ("point",):
            meanings = str(array.attrs.get("flag_meanings", "")).split()
            values = array.values.tolist()
            columns[str(name)] = [meanings[value] for value in values] if meanings else values
    temporary = path.with_name(f".{path.name}.{uuid.uuid4().hex}.tmp")
    try:
        with temporary.open("x", encoding="utf-8", newline="") as file:
            writer = csv.writer(file, lineterminator="\n")
            writer.writerow(columns)
            writer.writerows(zip(*columns.values(), strict=True))
            file.flush()
            os.fsync(file.fileno())
        os.replace(temporary, path)
    finally:
        temporary.unlink(missing_ok=True)


def number_column(name: str, values: Any) -> np.ndarray:
    try:
        column = np.asarray(values, dtype=np.float64)
    except (TypeError, ValueError):
        raise BadInput(f"{name} = {values!r}: must be a number or a 1-D array of numbers") from None
    if column.ndim > 1:
        raise BadInput(f"{name} has shape {column.shape}: must be a number or a 1-D array of numbers")
    return column


def point_columns(system: System, points: Any) -> tuple[dict[str, np.ndarray], int]:
    """Every parameter of the system as a float64 column, checked, and their length; see label_points."""
    columns = {}
    for name, values in table(points, system.parameters).items():
        if name not in system.parameters:
            raise BadInput(
                f"{name}: not a parameter of the {system.name}; allowed: {', '.join(system.parameters)}"
            )
        columns[name] = number_column(name, values)
    sizes = {c.size for c in columns.values() if c.ndim}
    if len(sizes) > 1:
        shown = ", ".join(f"{k}: {c.size}" for k, c in columns.items() if c.ndim)
        raise BadInput(f"points: columns of different lengths ({shown})")
    size = sizes.pop() if sizes else 1
    if size == 0:
        raise BadInput("points: there are none")
    full: dict[str, np.ndarray] = {}
    for name, parameter in system.parameters.items():
        column = columns.get(name, np.asarray(parameter.default))
        optional = np.isnan(parameter.default) & np.isnan(column)
        if not (np.isfinite(column) | optional).all():
            raise BadInput(f"{name}: must be finite numbers, found {column[~np.isfinite(column)].ravel()[0]}")
        if column.size and not np.all(optional):
            check_range(system, name, name, np.nanmin(column), np.nanmax(column))
        full[name] = np.broadcast_to(column, (size,)).astype(np.float64)
    return full, size
