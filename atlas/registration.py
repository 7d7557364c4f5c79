"""The accessor `ds.atlas`, known to xarray as soon as this module is imported."""

from __future__ import annotations

from typing import Any

import xarray as xr


@xr.register_dataset_accessor("atlas")  # type: ignore[untyped-decorator]
def questions(ds: xr.Dataset) -> Any:
    """`ds.atlas`; its class is imported when it is first used."""
    from .accessor import Atlas

    return Atlas(ds)
