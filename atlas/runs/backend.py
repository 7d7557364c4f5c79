"""Engine "atlas" of xarray: `xr.open_dataset` opens run folders, and every atlas that `open_atlas` opens."""

from __future__ import annotations

import os
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import xarray as xr
from xarray.backends import BackendEntrypoint

from ..errors import BadInput, shown
from ..files import read_json


class AtlasBackend(BackendEntrypoint):
    """Engine of xarray for atlases, which compares values with their checksums, as its own engines do not."""

    description = "Opens run folders and atlases of Precession Atlas"
    open_dataset_parameters = ("filename_or_obj", "drop_variables")

    def guess_can_open(self, filename_or_obj: Any) -> bool:
        """Whether a path leads to a run folder."""
        if not isinstance(filename_or_obj, str | os.PathLike):
            return False
        try:
            return {"scene", "identity", "tile"} <= read_json(Path(filename_or_obj) / "manifest.json").keys()
        except (OSError, ValueError):
            return False

    def open_dataset(
        self, filename_or_obj: Any, *, drop_variables: str | Iterable[str] | None = None
    ) -> xr.Dataset:
        """Open an atlas as `atlas.open_atlas` does; of a run folder chunks={} gives a chunk for each tile."""
        from .open import open_atlas

        if not isinstance(filename_or_obj, str | os.PathLike):
            raise BadInput(f"{shown(filename_or_obj)}: the engine atlas opens paths")
        ds = open_atlas(Path(filename_or_obj))
        tile = {dim: lengths[0] for dim, lengths in ds.chunksizes.items()}
        if tile:
            for variable in ds.variables.values():
                variable.encoding["preferred_chunks"] = {dim: tile[dim] for dim in variable.dims}
        names = [drop_variables] if isinstance(drop_variables, str) else list(drop_variables or ())
        result = ds.drop_vars(names, errors="ignore")
        result.set_close(ds.close)
        return result
