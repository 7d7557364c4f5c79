"""The atlas file: provenance, writing in one move, opening with every complaint in one line."""

from __future__ import annotations

import os
import platform
import tempfile
from datetime import UTC, datetime
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr

from . import __version__
from .scene import Settings
from .systems.system import BadInput, System

COMPRESSION = {"zlib": True, "complevel": 4, "shuffle": True}
SUFFIX = ".nc"


def provenance(
    system: System,
    settings: Settings,
    kernel_hash: str,
    *,
    title: str,
    scene: str,
    seconds: float,
    points: int,
    remarks: list[str],
) -> dict[str, Any]:
    """Global attributes of an atlas: what it is, from which scene and programs, and how long it took."""
    from .engine.jit import cpu

    packages = ("numpy", "numba", "llvmlite", "xarray", "netCDF4", "scipy")
    found = {
        "Conventions": "CF-1.12",
        "title": title,
        "source": f"Precession Atlas {__version__}: {system.title}, fixed-step {settings.method}",
        "references": system.reference + (f", https://doi.org/{system.doi}" if system.doi else ""),
        "history": f"{datetime.now(UTC):%Y-%m-%dT%H:%M:%SZ} computed by atlas {__version__}",
        "atlas_version": __version__,
        "atlas_system": system.name,
        "atlas_scene": scene,
        "atlas_method": settings.method,
        "atlas_rate_tolerance": settings.rate_tolerance,
        "atlas_cylinder_tolerance": settings.cylinder,
        "atlas_drift_tolerance": settings.drift_tolerance,
        "atlas_tolerance": settings.tolerance if settings.step is None else float("nan"),
        "atlas_step": float("nan") if settings.step is None else settings.step,
        "atlas_kernel_hash": kernel_hash,
        "atlas_cpu": cpu(),
        "atlas_platform": f"{platform.system()} {platform.machine()}, Python {platform.python_version()}",
        "atlas_versions": ", ".join(f"{name} {version(name)}" for name in packages),
        "atlas_seconds": seconds,
        "atlas_points_per_second": points / seconds if seconds > 0 else float("nan"),
    }
    if remarks:
        found["atlas_warnings"] = "; ".join(remarks)
    return found


def writable(out: str | Path, *, force: bool) -> Path:
    """The path of an atlas to be written; BadInput if it cannot be, or exists and force is false."""
    path = Path(out)
    if path.suffix != SUFFIX:
        raise BadInput(f"{path}: the name of an atlas ends in {SUFFIX}")
    check_folder(path)
    if path.is_dir():
        raise BadInput(f"{path}: this is a folder")
    if path.exists() and not force:
        raise BadInput(f"{path}: this file exists; --force (force=True) replaces it")
    return path


def check_folder(path: Path) -> None:
    """Raise BadInput unless a file can be made beside where `path` will be."""
    folder = path.parent
    if not folder.is_dir():
        raise BadInput(f"{path}: there is no folder {folder}")
    try:
        with tempfile.TemporaryFile(dir=folder):
            pass
    except OSError as error:
        raise BadInput(f"{path}: cannot be written: {error.strerror}") from None


def write(ds: xr.Dataset, path: Path) -> None:
    """Write under a temporary name beside `path`, sync, and move into place: never half a file."""
    encoding: dict[str, dict[str, Any]] = {}
    for name, variable in ds.variables.items():
        encoding[str(name)] = {"_FillValue": None}
        if variable.dtype.kind == "f":
            encoding[str(name)] = {"_FillValue": np.nan if name in ds.data_vars else None}
        if variable.ndim:
            encoding[str(name)] |= COMPRESSION
    handle, temporary = tempfile.mkstemp(prefix=f".{path.name}.", suffix=".tmp", dir=path.parent)
    os.close(handle)
    try:
        ds.to_netcdf(temporary, engine="netcdf4", format="NETCDF4", encoding=encoding)
        with open(temporary, "rb+") as file:
            os.fsync(file.fileno())
        os.chmod(temporary, 0o666 & ~_umask())
        os.replace(temporary, path)
    except BaseException:
        Path(temporary).unlink(missing_ok=True)
        raise


def _umask() -> int:
    mask = os.umask(0)
    os.umask(mask)
    return mask


def open_atlas(path: str | Path) -> xr.Dataset:
    """Open an atlas file lazily, as a Dataset with plain integer flags.

    Raises BadInput with one line if there is no such file, if it is damaged or no atlas.
    """
    path = Path(path)
    if not path.exists():
        raise BadInput(f"{path}: there is no such file")
    if path.is_dir():
        raise BadInput(f"{path}: this is a folder, not an atlas file")
    try:
        ds = xr.open_dataset(path, engine="netcdf4", chunks=None)
    except Exception as error:  # whatever a damaged file makes the reader say
        raise BadInput(f"{path}: not a NetCDF file that can be read ({_one_line(error)})") from None
    missing = [name for name in ("atlas_system", "atlas_version") if name not in ds.attrs]
    if missing:
        ds.close()
        raise BadInput(f"{path}: not an atlas: the attribute {missing[0]} is missing")
    return ds


def _one_line(error: Exception) -> str:
    return " ".join(str(error).split())[:200]
