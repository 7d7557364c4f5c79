"""Importing this module registers the accessor `ds.atlas` with xarray."""

from __future__ import annotations

from typing import Any

import xarray as xr


@xr.register_dataset_accessor("atlas")  # type: ignore[untyped-decorator]
def questions(ds: xr.Dataset) -> Any:
    """`ds.atlas`; its class is imported on first use."""
    from .accessor import Atlas

    return Atlas(ds)
