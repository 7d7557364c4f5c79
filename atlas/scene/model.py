"""The frozen, validated job: a Scene, its axes and settings."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from typing import Any

import tomli_w

from ..engine.tableaux import METHODS
from ..errors import BadInput
from ..systems.base import System
from .expressions import Expression, PointColumn

SCHEMA = 1
DURATION_UNITS = ("orbits", "turns")
# Points that are integrated again at half the step, besides those whose expected error calls for it.
HALF_STEP = ("none", "sample", "all")


def is_number(value: object) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)


@dataclass(frozen=True)
class Settings:
    """How points are integrated and labelled; durations come with the points."""

    method: str = "rk4"
    tolerance: float = 1e-8  # rad, phase error of the fastest frequency at the end of the run
    step: float | None = None  # time units; overrides tolerance
    max_steps: int = 100_000_000
    rate_tolerance: float = 1e-5  # rad per time unit
    cylinder_tolerance: float | None = None  # rad; None: the number of rate_tolerance
    drift_tolerance: float = 1e-5
    check_half_step: str = "none"  # which points are integrated again at half the step: HALF_STEP

    def __post_init__(self) -> None:
        if self.method not in METHODS:
            raise BadInput(f"method = {self.method!r}: allowed: {', '.join(METHODS)}")
        for name in ("tolerance", "step", "rate_tolerance", "cylinder_tolerance", "drift_tolerance"):
            value = getattr(self, name)
            if value is not None and not (is_number(value) and math.isfinite(value) and value > 0):
                raise BadInput(f"{name} = {value!r}: must be a finite number above 0")
        if self.check_half_step not in HALF_STEP:
            raise BadInput(f"check_half_step = {self.check_half_step!r}: allowed: {', '.join(HALF_STEP)}")
        if not (isinstance(self.max_steps, int) and self.max_steps >= 1):
            raise BadInput(f"max_steps = {self.max_steps!r}: must be a whole number, at least 1")

    @property
    def cylinder(self) -> float:
        """Radius of the cylinder in rad."""
        return self.rate_tolerance if self.cylinder_tolerance is None else self.cylinder_tolerance


@dataclass(frozen=True)
class Axis:
    """One dimension of the atlas."""

    name: str
    values: tuple[float, ...]
    offset_from_family: bool = False
    long_name: str = ""
    units: str = ""
    table: Mapping[str, Any] = field(default_factory=dict, compare=False)  # as the scene gives it


@dataclass(frozen=True)
class Duration:
    """Length of the runs: a number of time units, of orbits, or of turns of the slower of n and m."""

    amount: float
    unit: str = ""  # "", "orbits" or "turns"

    def __str__(self) -> str:
        return f"{self.amount:g} {self.unit}".strip()


@dataclass(frozen=True)
class Refine:
    """Borders are followed on grids of half, a quarter, ... the spacing; the axes hold the finest."""

    levels: int  # how often the spacing is halved
    probe: float = 0.01  # share of the points not integrated that are tried in the end


@dataclass(frozen=True)
class Scene:
    """One job, checked: everything that decides what an atlas will hold."""

    title: str
    system: System
    fixed: Mapping[str, float]
    axes: Mapping[str, Axis]
    ties: Mapping[str, Expression]  # in an order in which they can be evaluated
    family: str | None = None
    solve: tuple[str, ...] = ()
    nudge: Mapping[str, float] = field(default_factory=dict)
    duration: Duration = Duration(60.0)
    settings: Settings = Settings()
    outputs: tuple[str, ...] = ()
    refine: Refine | None = None
    points: Mapping[str, Any] | None = None  # the table of points that stand instead of axes, resolved

    @property
    def shape(self) -> tuple[int, ...]:
        return tuple(len(axis.values) for axis in self.axes.values())

    @property
    def nudges_angles(self) -> bool:
        """Is the nudge one of angles and their rates, not of the optional start values of the system?"""
        return bool(self.nudge) and not optional_start_values(self.system, self.nudge)

    @property
    def size(self) -> int:
        return math.prod(self.shape)

    @property
    def strides(self) -> tuple[int, ...]:
        """Distance of the coarse grid's points along each axis, where the scene is refined."""
        assert self.refine is not None
        return tuple(
            2**self.refine.levels if is_refined_axis(axis.table) else 1 for axis in self.axes.values()
        )

    def vanishing(self) -> tuple[frozenset[str], bool]:
        """Parameters that are 0 or absent at every point, and whether A = B at every point."""
        moving = {*self.axes, *self.ties, *self.solve}
        values = {name: p.default for name, p in self.system.parameters.items()} | dict(self.fixed)
        zero = {
            k for k in self.system.parameters if k not in moving and (values[k] == 0 or math.isnan(values[k]))
        }
        tied = {"A", "B"} & moving
        symmetric = (not tied and values["A"] == values["B"]) or (
            len(tied) == 1 and self.ties.get(tied.pop(), Expression("", "0")).text.strip() in {"A", "B"}
        )
        return frozenset(zero), symmetric

    def toml(self) -> str:
        """The scene with every default written out; load_scene of this text gives the same scene."""
        settings = self.settings
        integration: dict[str, Any] = {
            "duration": str(self.duration) if self.duration.unit else self.duration.amount,
            "method": settings.method,
            "max_steps": settings.max_steps,
            "check_half_step": settings.check_half_step,
        }
        integration |= {"tolerance": settings.tolerance} if settings.step is None else {"step": settings.step}
        table: dict[str, Any] = {
            "schema": SCHEMA,
            "title": self.title,
            "system": self.system.name,
            "fixed": dict(self.fixed),
            "ties": {name: tie.text for name, tie in self.ties.items() if not isinstance(tie, PointColumn)},
        }
        if self.points is None:
            table["axes"] = {axis.name: dict(axis.table) for axis in self.axes.values()}
        else:
            table["points"] = dict(self.points)
        if self.refine is not None:
            table["refine"] = {"levels": self.refine.levels, "probe": self.refine.probe}
        if self.family is not None:
            table["family"] = {"name": self.family, "solve": list(self.solve)}
        if self.nudge:
            table["nudge"] = dict(self.nudge)
        table["integration"] = integration
        table["labels"] = {
            "rate_tolerance": settings.rate_tolerance,
            "cylinder_tolerance": settings.cylinder,
            "drift_tolerance": settings.drift_tolerance,
        }
        table["outputs"] = {"variables": list(self.outputs)}
        return tomli_w.dumps(table)


def optional_start_values(system: System, names: Iterable[str]) -> list[str]:
    """Those of the names that a start need not give, because other start values can replace them."""
    return [name for name in names if math.isnan(system.parameters[name].default)]


def is_refined_axis(table: Mapping[str, Any]) -> bool:
    """Is an axis with this table one of those that [refine] halves?"""
    return "count" in table and table["count"] > 1


def check_range(system: System, key: str, name: str, low: float, high: float) -> None:
    """Raise BadInput if values from low to high leave the range of a parameter of the system."""
    parameter = system.parameters[name]
    below = low <= parameter.low if parameter.open_low else low < parameter.low
    if below or high > parameter.high:
        bad = low if below else high
        sign = ">" if parameter.open_low else ">="
        allowed = f"{name} {sign} {parameter.low:g}" if below else f"{name} <= {parameter.high:g}"
        raise BadInput(f"{key} = {bad:g}: allowed: {allowed} ({parameter.meaning})")
