"""Labelled points as CSV files."""

from __future__ import annotations

import csv
from pathlib import Path
from typing import Any

import xarray as xr

from ..files import atomic_write


def write(ds: xr.Dataset, path: Path) -> None:
    """Write the coordinates, then the variables of labelled points as a CSV file, whole or not at all."""
    columns: dict[str, list[Any]] = {}
    for name in [*ds.coords, *ds.data_vars]:
        array = ds[name]
        if array.dims == ("point",):
            flags = str(array.attrs.get("flag_meanings", "")).split()
            values = array.values.tolist()
            columns[str(name)] = [flags[value] for value in values] if flags else values
    with atomic_write(path) as temporary, temporary.open("w", encoding="utf-8", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(columns)
        writer.writerows(zip(*columns.values(), strict=True))
