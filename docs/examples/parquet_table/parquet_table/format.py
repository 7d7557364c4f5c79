"""The format of the extension; imported when a name ends in .parquet.

The file has a row for each point, flags by name, and in its metadata the attributes of the atlas and a hash of all.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq
import xarray as xr

from atlas.errors import BadInput, one_line
from atlas.files import atomic_write, check_claim, hash_of
from atlas.scene.read import parse_scene
from atlas.store.dataset import HASH, dataset, dims
from atlas.store.finished import Content, Format
from atlas.variables import data_variables

ATTRIBUTES = "atlas_attributes"  # in the metadata, beside HASH


class Parquet(Format):
    """Atlases as Parquet tables, which are read whole and compared with their hash whenever they are opened."""

    def write(self, content: Content, path: Path | str) -> None:
        ds, names = content.ds, content.names
        axes = {str(dim): ds[dim].values for dim in ds.sizes}
        types = {name: pa.from_numpy_dtype(ds[name].dtype) for name in (*axes, *names)}
        texts = {name: ds[name].attrs.get("flag_meanings") for name in names}
        flags = {name: np.array(text.split()) for name, text in texts.items() if text}
        schema = pa.schema(types | dict.fromkeys(flags, pa.string()))
        hashes = {name: hashlib.sha256() for name in types}
        with (
            atomic_write(Path(path)) as temporary,
            pq.ParquetWriter(temporary, schema, compression="zstd") as file,
        ):
            for box, values in content.blocks:
                along = (axis[part] for axis, part in zip(axes.values(), box, strict=True))
                columns = dict(zip(axes, np.meshgrid(*along, indexing="ij"), strict=True)) | dict(values)
                for name, column in columns.items():
                    hashes[name].update(np.ascontiguousarray(column))
                    columns[name] = (flags[name][column] if name in flags else column).ravel()
                file.write_table(pa.table(columns, schema))
            text = json.dumps(dict(content.attributes()), default=lambda value: value.tolist())
            file.add_key_value_metadata({ATTRIBUTES: text, HASH: _hash(text, hashes)})

    def open_dataset(self, path: Path | str) -> xr.Dataset:
        """The parameters and the attributes of variables are those of the scene."""
        try:
            with pq.ParquetFile(path) as file:
                metadata = file.metadata
                check_claim(8 * metadata.num_rows * metadata.num_columns, Path(path).stat().st_size)
                text, own_hash = (metadata.metadata[key.encode()].decode() for key in (ATTRIBUTES, HASH))
                table = file.read().to_pandas()
            attributes = json.loads(text)
            scene = parse_scene(attributes["atlas_scene"])
            variables = data_variables(scene.system)
            for name in table.columns.intersection([*variables]):
                if flags := variables[name].flags:
                    numbers = {flag: number for number, flag in enumerate(flags)}
                    table[name] = table[name].map(numbers).astype(variables[name].dtype)
            columns = {name: table[name].to_numpy() for name in table}
            hashes = {name: hashlib.sha256(column.tobytes()) for name, column in columns.items()}
            if _hash(text, hashes) != own_hash:
                raise ValueError("its hash differs")
            axes = zip(dims(scene), scene.axes.values(), strict=True)
            places = [pd.Index(axis.values).get_indexer(columns[dim]) for dim, axis in axes]
            order = np.argsort(np.ravel_multi_index(places, scene.shape))
            ds = dataset(scene, {name: column[order] for name, column in columns.items()})
        except Exception as error:  # reading a damaged file may raise any error
            raise BadInput(
                f"{path}: damaged, or not a Parquet file of an atlas ({one_line(error)})"
            ) from None
        ds.encoding["source"] = str(path)
        return ds.assign_attrs(attributes)

    def verify(self, path: Path | str) -> None:
        self.open_dataset(path)

    def has_hash(self, path: Path | str) -> bool:
        with suppress(OSError, ValueError):
            return HASH.encode() in (pq.read_metadata(path).metadata or {})
        return False


def _hash(attributes: str, columns: Mapping[str, Any]) -> str:
    """Hash of the attributes, and of columns by their hashes."""
    return hash_of([attributes, {name: column.hexdigest() for name, column in columns.items()}])


FORMAT = Parquet()
