"""Tables of parameters, and the distortions of names, texts and files by programs and by typing."""

import csv
import io
import re

import numpy as np
import pandas as pd
import pytest
import xarray as xr

from atlas import BadInput
from atlas.scene import tables
from atlas.systems import SYSTEMS

SATELLITE = SYSTEMS["satellite"]
NAMES = ("A", "C", "m", "n", "theta0", "k3", "mu1", "h3", "psi0", "Omega")
EXTRAS = {
    "satellite": ("ALPHA", "UPMSat 2", "4 Vesta", "B-17"),
    "date": ("2026-01-05", "05.01.2026", "5 Jan 2026", "2026-01-05 12:30"),
    "size": ("3U", "6U", "12U XL"),
    "note": ("", "see log", "tumbled, then not", "n/a"),
    "id": ("7", "8", "10"),
}
OTHER_NAMES = ("moment", "spin rate", "x_1", "value", "inertia 3", "tilt")
UNITS = ("kg m2", "kg·m²", "rad/s", "deg", "°", "rpm", "N m s", "A m^2", "T")


def draw(rng, values):
    """A random one of the values."""
    return values[rng.integers(len(values))]


def a_table(rng):
    """Parameters with values other than the defaults, and all columns, in random order, as texts."""
    size = int(rng.integers(1, 5))
    names = rng.permutation(NAMES)[: rng.integers(1, 5)].tolist()
    meant = {name: np.round(rng.uniform(0.61, 0.99, size), 3) for name in names}
    columns = {name: [f"{value:g}" for value in values] for name, values in meant.items()}
    for name in rng.permutation([*EXTRAS])[: rng.integers(0, 3)].tolist():
        columns[name] = [draw(rng, EXTRAS[name]) for _ in range(size)]
    return meant, [[name, *columns[name]] for name in rng.permutation([*columns]).tolist()]


def other_name(rng, column):
    """A column by another name."""
    unit, name = draw(rng, UNITS), column[0]
    forms = (
        name.swapcase(), name.upper(), f"{name} ({unit})", f"{name} [{unit}]", f"{name}, {unit}", f"{name}/{unit}",
        f"{name} {unit}", f"{name}_{unit}", f"{name} in {unit}", f" {name} ", f"{name[:-1]} {name[-1]}",
        f"{name[:-1]}_{name[-1]}", f'"{name}"', f"'{name}'", f"{name}:", f"{name}*", f"moment {name}", f"{name}\u200b",
        f"{name}\u00a0", draw(rng, OTHER_NAMES),
    )  # fmt: skip
    return [draw(rng, forms), *column[1:]]


def other_fields(rng, column):
    """A column with other texts for the same numbers, for all of them or for one."""
    unit = draw(rng, UNITS)
    change = draw(
        rng,
        (
            lambda text: text.replace(".", ","), lambda text: f"{text} {unit}", lambda text: text + unit,
            lambda text: text.replace(".", ",") + f" {unit}", lambda text: f"'{text}'", lambda text: f'"{text}"',
            lambda text: f"\u201c{text}\u201d", lambda text: f"~{text}", lambda text: f"{text}\u00a0", lambda text: f"{text} ± 0.01",
            lambda text: f"+{text}", lambda text: text.replace("0.", "."), lambda text: f"{text}(1)", lambda text: f"{text}E0",
            lambda text: f"{text}D0",
        ),
    )  # fmt: skip
    only = rng.integers(0, 2 * len(column))
    return [
        column[0],
        *(change(t) if only >= len(column) or i == only else t for i, t in enumerate(column[1:])),
    ]


def mangled(rng, table, meant):
    """Columns with other names and fields, or two in one."""
    table = [[*column] for column in table]
    for _ in range(rng.integers(1, 4)):
        i = int(rng.integers(len(table)))
        match rng.integers(4):
            case 0 if table[i][0] in meant:
                table[i] = other_name(rng, table[i])
            case 1 if table[i][0] not in EXTRAS:
                table[i] = other_fields(rng, table[i])
            case 2 if len(table) > 1 and table[i][0] not in OTHER_NAMES:
                j = (i + 1) % len(table)
                joint = draw(rng, (" ", "  ", " | ", "|", ":", ", ", "; ", "/", "\t"))
                both = [a + joint + b for a, b in zip(table[i], table[j], strict=True)]
                table = [both, *(column for k, column in enumerate(table) if k not in (i, j))]
    return table


def as_file(rng, table):
    """The text of a file."""
    rows = list(zip(*table, strict=True))
    if rng.integers(8) == 0:
        rows.insert(1, tuple(draw(rng, UNITS) for _ in table))
    if rng.integers(12) == 0:
        rows[0] = (*rows[0][:-1], "")
    if rng.integers(12) == 0:
        rows = [row[1:] if i == 0 else row for i, row in enumerate(rows)]
    if rng.integers(12) == 0:
        rows = [(*row, "") for row in rows]
    quoting = draw(rng, (csv.QUOTE_MINIMAL, csv.QUOTE_ALL, csv.QUOTE_NONE))

    def text(rows, separator):
        out = io.StringIO()
        if len(separator) == 1 and quoting != csv.QUOTE_NONE:
            csv.writer(out, delimiter=separator, quoting=quoting, lineterminator="\n").writerows(rows)
        else:
            out.writelines(separator.join(row) + "\n" for row in rows)
        return out.getvalue()

    separators = (",", ";", "\t", " ", "  ", "|", " | ", ":", ", ", "/", " , ", "&")
    separator = draw(rng, separators)
    head = text(rows[:1], draw(rng, separators) if rng.integers(6) == 0 else separator)
    if rng.integers(4) == 0:
        head = draw(rng, ("# ", "#", "% ", "// ")) + head
    if rng.integers(5) == 0:
        head = draw(rng, ("# made by hand\n", "Table 3\n", "sep=;\n", "\n\n", "# kg m2, rad/s\n")) + head
    body = text(rows[1:], separator)
    if rng.integers(6) == 0:
        body = "\n" + body.replace("\n", "\n\n", 1) + "# end\n"
    whole = (draw(rng, ("", "\ufeff")) + head + body).replace("\n", draw(rng, ("\n", "\r\n", "\r")))
    return whole.rstrip("\n") if rng.integers(4) == 0 else whole


def as_columns(table):
    """Columns by name, of numbers where all fields are numbers."""
    result = {}
    for name, *fields in table:
        try:
            result[name] = np.array([float(field) for field in fields])
        except ValueError:
            result[name] = np.array(fields, object)
    return result


FORMS = (
    "csv",
    "csv",
    "csv",
    "netcdf",
    "frame",
    "index",
    "row",
    "polars",
    "lazy polars",
    "pyarrow",
    "dictionary",
    "texts",
)


def source(rng, table, form, folder):
    """A table in one of the forms that `label_points` takes."""
    if form == "csv":
        path = folder / "a.csv"
        path.write_bytes(as_file(rng, table).encode())
        return path
    columns = as_columns(table)
    if form == "netcdf":
        variables = {
            re.sub(r"[^\w ()^.]", "|", name.strip("'\" ")): (
                "point",
                values.astype(str) if values.dtype == object else values,
            )
            for name, values in columns.items()
        }
        xr.Dataset(variables).to_netcdf(folder / "a.nc")
        return folder / "a.nc"
    lists = {name: values.tolist() for name, values in columns.items()}
    match form:
        case "frame":
            return pd.DataFrame(columns)
        case "index":
            return pd.DataFrame(columns).set_index(table[0][0])
        case "row":
            return pd.DataFrame(columns).iloc[0]
        case "polars" | "lazy polars":
            polars = pytest.importorskip("polars")
            return (polars.DataFrame if form == "polars" else polars.LazyFrame)(lists)
        case "pyarrow":
            return pytest.importorskip("pyarrow").table(lists)
        case "dictionary":
            return lists
    return {name: fields for name, *fields in table}


def read(source, keep=()):
    """The parameters that are read, as `label_points` reads them, or the sentence that refuses."""
    try:
        columns = tables.table(source, SATELLITE.parameters, keep)
        names, arrays, _ = tables.parameter_arrays(SATELLITE, columns, keep)
        size = max((array.size for array in arrays), default=1)
        tables.flat_columns(SATELLITE, names, [array.values for array in arrays], (size,), columns)
    except BadInput as error:
        return str(error)
    return {name: np.ravel(array).tolist() for name, array in zip(names, arrays, strict=True)}
