"""What every bit of an atlas depends on beside its scene."""

from __future__ import annotations

import hashlib
from importlib.metadata import version
from pathlib import Path

import netCDF4

from .._version import __version__
from ..label.pipeline import scene_kernel_hash
from ..scene.model import Scene

# Files of the package on which the numbers of an atlas depend.
NUMERIC_SOURCES = (
    "engine/*.py",
    "systems/**/*.py",
    "scene/*.py",
    "label/*.py",
)


def identity(scene: Scene) -> dict[str, str]:
    """What decides every bit of an atlas beside its scene: programs and type of processor."""
    from ..engine.jit import cpu

    code, package = hashlib.sha256(), Path(__file__).parents[1]
    for path in sorted(p for room in NUMERIC_SOURCES for p in package.glob(room)):
        code.update(path.read_bytes())
    packages = {name: version(name) for name in ("numpy", "numba", "llvmlite", "scipy", "netCDF4")}
    return {
        "atlas": __version__,
        "code": code.hexdigest()[:16],
        "kernel": scene_kernel_hash(scene),
        "cpu": cpu(),
        **packages,
        "HDF5": str(netCDF4.__hdf5libversion__),
    }
