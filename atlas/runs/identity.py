"""Identity of a computation: programs and processor on which the bits of an atlas depend."""

from __future__ import annotations

import hashlib
import os
import platform
import sys
from collections.abc import Mapping
from functools import cache
from pathlib import Path
from typing import Any

import netCDF4
import numpy as np
import scipy

from .. import sources
from .._version import __version__
from ..errors import BadInput
from ..label.pipeline import scene_kernel_hash
from ..scene.model import Scene
from ..systems.base import System


def identity(scene: Scene) -> dict[str, str]:
    """Everything besides its scene on which the bits of an atlas depend, as it is in the memory of this process.

    Parameters
    ----------
    scene : Scene

    Returns
    -------
    dict of str to str
        Versions of programs and libraries, hashes of this package's sources and of the kernel, and the type
        of processor.

    Raises
    ------
    BadInput
        If sources of the package were written after this process had imported it. What is loaded may then be
        neither the old nor the new code.
    """
    import llvmlite
    import numba

    from ..engine import jit

    kernel = scene_kernel_hash(scene)  # made from source files, so before the look whether they changed
    changed = sources.changed()
    if changed:
        raise BadInput(
            f"{sources.PACKAGE / changed[0]} was written after this process (host {platform.node()}, process"
            f" {os.getpid()}) had imported it: start the process again"
        )
    versions = {module.__name__: str(module.__version__) for module in (np, numba, llvmlite, scipy, netCDF4)}
    return {
        "atlas": __version__,
        "code": sources.code(),
        **_system_code(scene.system),
        "kernel": kernel,
        "cpu": jit.cpu(),
        **{f"NUMBA_{name}": value for name, value in jit.settings().items()},
        "numpy_simd": " ".join(np.show_config(mode="dicts")["SIMD Extensions"].get("found", ())),
        "python": f"{sys.version_info.major}.{sys.version_info.minor}",
        "libc": " ".join(platform.libc_ver()) or platform.release(),
        **versions,
        "HDF5": str(netCDF4.__hdf5libversion__),
    }


@cache
def _system_code(system: System) -> dict[str, str]:
    """Hash of the modules of a system that is not of this package, as they are when it is first asked for."""
    modules = (sys.modules.get(type(system).__module__), system.equations)
    names = [getattr(module, "__file__", None) for module in modules]  # a notebook has none
    files = [Path(name) for name in names if name and not Path(name).is_relative_to(sources.PACKAGE)]
    content = b"".join(file.read_bytes() for file in files)
    return {"system_code": hashlib.sha256(content).hexdigest()[:16]} if files else {}


def differences(
    expected: Mapping[str, Any], actual: Mapping[str, Any], expected_place: str, actual_place: str
) -> str:
    """Entries that differ, in one line.

    Parameters
    ----------
    expected, actual : mapping of str to object
    expected_place, actual_place : str
        Where each of them was taken from, such as "in the run" and "in the worker".

    Returns
    -------
    str
        Empty if all are equal.
    """
    return ", ".join(
        f"{name} ({expected.get(name, 'nothing')} {expected_place}, {actual.get(name, 'nothing')} {actual_place})"
        for name in {**expected, **actual}
        if expected.get(name) != actual.get(name)
    )
