"""Identity of a computation: programs and processor on which the bits of an atlas depend."""

from __future__ import annotations

import os
import platform
import sys
from collections.abc import Mapping
from typing import Any

import netCDF4
import numpy as np
import scipy

from .. import sources, systems
from .._version import __version__
from ..errors import BadInput
from ..label.plan import Plan
from ..systems.base import System


def identity(plan: Plan) -> dict[str, str]:
    """Versions, hashes and processor on which bits depend; BadInput if sources changed since the import."""
    import llvmlite
    import numba

    from ..engine import jit

    # The hash is computed from source files, so before the check whether these have changed.
    kernel = plan.kernel_hash
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
        **_system_code(plan.system),
        "kernel": kernel,
        "cpu": jit.cpu(),
        **{f"NUMBA_{name}": value for name, value in jit.settings().items()},
        "numpy_simd": " ".join(np.show_config(mode="dicts")["SIMD Extensions"].get("found", ())),
        "python": f"{sys.version_info.major}.{sys.version_info.minor}",
        "libc": " ".join(platform.libc_ver()) or platform.release(),
        **versions,
        "HDF5": str(netCDF4.__hdf5libversion__),
    }


def _system_code(system: System) -> dict[str, str]:
    """Package and hash of the code of a system that is not of this package, as it was when it was registered."""
    origin = systems.origin(system)
    if origin is None:
        return {}
    changed = origin.changed()
    if changed is not None:
        raise BadInput(
            f"{changed} was written after this process (host {platform.node()}, process {os.getpid()}) had imported it:"
            " start the process again"
        )
    return {"system_code": origin.code, **({"system_package": origin.package} if origin.package else {})}


def differences(
    expected: Mapping[str, Any], actual: Mapping[str, Any], expected_place: str, actual_place: str
) -> str:
    """Entries that differ, in one line with the places, such as "in the run" and "in the worker"."""
    return ", ".join(
        f"{name} ({expected.get(name, 'nothing')} {expected_place}, {actual.get(name, 'nothing')} {actual_place})"
        for name in {**expected, **actual}
        if expected.get(name) != actual.get(name)
    )
