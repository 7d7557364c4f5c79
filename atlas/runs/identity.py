"""Identity of a computation: programs and processor on which the bits of an atlas depend."""

from __future__ import annotations

import hashlib
from importlib.metadata import version
from pathlib import Path

import netCDF4

from .._version import __version__
from ..label.pipeline import scene_kernel_hash
from ..scene.model import Scene

# Files of the package on which the numbers of an atlas depend.
NUMERIC_SOURCES = ("engine/**/*.py", "systems/**/*.py", "scene/**/*.py", "label/**/*.py", "flags.py")


def identity(scene: Scene) -> dict[str, str]:
    """Everything besides its scene on which the bits of an atlas depend.

    Parameters
    ----------
    scene : Scene

    Returns
    -------
    dict of str to str
        Versions of programs and libraries, hashes of this package's sources and of the kernel, and the type
        of processor.
    """
    from ..engine.jit import cpu

    code, package = hashlib.sha256(), Path(__file__).parents[1]
    for path in sorted(path for pattern in NUMERIC_SOURCES for path in package.glob(pattern)):
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
