"""Registration of the accessor `ds.atlas` with xarray, which takes place when this module is imported."""

from __future__ import annotations

from typing import Any

import xarray as xr


@xr.register_dataset_accessor("atlas")  # type: ignore[untyped-decorator]
def questions(ds: xr.Dataset) -> Any:
    """Return the accessor `ds.atlas`. The class of the accessor is imported on first use."""
    from .accessor import Atlas

    return Atlas(ds)
