"""Provenance of an atlas: its global attributes."""

from __future__ import annotations

import logging
import platform
from datetime import UTC, datetime
from importlib.metadata import version
from typing import Any

from .. import systems
from .._version import __version__
from ..measure.observables import std_tolerances
from ..scene.model import EMPTY_ABOUT, About, Scene, Settings
from ..systems.base import System


def log_warnings(warnings: list[str]) -> None:
    """Log warnings about the input under the name "atlas"."""
    for warning in warnings:
        logging.getLogger("atlas").warning(warning)


def scene_provenance(
    scene: Scene, kernel_hash: str, *, seconds: float, points: int, warnings: list[str]
) -> dict[str, Any]:
    """Global attributes of the atlas of a scene, see `provenance`."""
    return provenance(
        scene.system, scene.settings, kernel_hash, title=scene.title, scene=scene.toml(), seconds=seconds,
        points=points, warnings=warnings, about=scene.about,
    )  # fmt: skip


def provenance(
    system: System,
    settings: Settings,
    kernel_hash: str,
    *,
    title: str,
    scene: str,
    seconds: float,
    points: int,
    warnings: list[str],
    about: About = EMPTY_ABOUT,
) -> dict[str, Any]:
    """CF and ACDD-1.3 attributes of an atlas, and the program's own, which begin with `atlas_`.

    `points` were integrated in `seconds` of wall-clock time; `scene` is empty where points were given.
    `atlas_tolerance` is nan where a step was given, `atlas_step` where it was not.
    """
    from ..engine.jit import cpu

    packages = ("numpy", "numba", "llvmlite", "xarray", "netCDF4", "scipy")
    now = f"{datetime.now(UTC):%Y-%m-%dT%H:%M:%SZ}"
    reference = system.reference + (f", https://doi.org/{system.doi}" if system.doi else "")
    attributes: dict[str, Any] = {
        "Conventions": "CF-1.12, ACDD-1.3",
        "title": title,
        "source": f"Precession Atlas {__version__}: {system.title}, fixed-step {settings.method}",
        "references": "; ".join([*about.references, reference]),
        "date_created": now,
        "history": f"{now} computed by atlas {__version__}",
        **about.attributes(),
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
    origin = systems.origin(system)
    if origin is not None:
        attributes["atlas_system_package"] = (
            origin.package or "registered in the process that computed the atlas"
        )
        attributes["atlas_system_code"] = origin.code
    if system.has_numeric_bound:
        attributes["atlas_frequency_bound"] = "numeric"
    if system.observables:
        limits = std_tolerances(system, settings)
        attributes["atlas_std_tolerance"] = ", ".join(f"{name} {limit!r}" for name, limit in limits.items())
    if warnings:
        attributes["atlas_warnings"] = "; ".join(warnings)
    return attributes
