"""Atlases as Parquet tables: the record of the extension, which imports nothing else."""

from atlas.extension import Extension

EXTENSION = Extension(
    "parquet_table", __name__, "atlases as Parquet tables", formats={".parquet": "format:FORMAT"}
)
