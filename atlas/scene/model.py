"""The classes of a scene and of the parts of a scene. They are frozen dataclasses, complete and checked."""

from __future__ import annotations

import html
import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, fields, replace
from itertools import combinations
from typing import Any

import tomli_w

from .. import extension
from ..errors import MAX_TEXT, printable, shown
from ..kernel.tableaux import METHODS
from ..measure.instrument import RunSettings, Tolerances
from ..systems.base import NATURAL_RATE, Array, System
from . import checks
from .checks import checked
from .expressions import PointColumn, Tie
from .text import Source

SCHEMA = 1
# Largest allowed `max_steps`. No practical run needs more, and sums over many runs fit into an int64.
MAX_STEPS = 10**12
DURATION_UNITS = ("orbits", "turns")
DEFAULT_ANGLE = 1e-5  # default cylinder tolerance in rad, if the rate tolerance is a formula
HALF_STEP = ("none", "sample", "all")
MAX_REFINEMENT_LEVELS = 8
# The repr of a scene lists at most this many axes, parameters or ties.
MAX_SHOWN = 8
MAX_TIE_SHOWN = 30  # largest number of characters of a tie in the repr of a scene


@dataclass(frozen=True)
class Settings:
    """Settings of integration and labels, except the duration. A value out of range raises BadInput."""

    method: str = checked(checks.one_of(METHODS), "rk4", "integration", "Runge-Kutta method")
    # The tolerance is at most 1, because nothing is known of a phase with an error above 1 rad.
    tolerance: float = checked(
        checks.at_most_one, 1e-8, "integration",
        "expected phase error of the fastest frequency at the end of the run (rad)",
    )  # fmt: skip
    step: float | None = checked(
        checks.positive, None, "integration", "step size in time units, instead of tolerance"
    )
    max_steps: int = checked(
        checks.whole(1, MAX_STEPS), 100_000_000, "integration", "largest number of steps of a run"
    )
    rate_tolerance: float | str = checked(
        checks.positive_at_points, f"1e-5 * {NATURAL_RATE}", "labels",
        "variation of a rate that counts as none (rad per time unit): a number, or arithmetic in parameters, axes and"
        " natural_rate, the rate of each point",
    )  # fmt: skip
    cylinder_tolerance: float | None = checked(
        checks.positive, None, "labels",
        "radius of the cap about the vertical in which the third axis counts as vertical (rad; default: the number of"
        f" rate_tolerance, or {DEFAULT_ANGLE:g} where that is arithmetic)",
    )  # fmt: skip
    drift_tolerance: float = checked(
        checks.positive, 1e-5, "labels", "largest relative change of a first integral"
    )
    # An observable without an entry has the default `systems.base.Observable.tolerance`.
    std_tolerance: Mapping[str, float] | None = checked(
        checks.positive_numbers, None, "labels",
        "largest standard deviation with which an observable counts as constant, by its name, for systems with"
        " observables",
    )  # fmt: skip
    check_half_step: str = checked(
        checks.one_of(HALF_STEP), "none", "integration", "points that are integrated again at half the step"
    )
    prove: bool = checked(
        checks.boolean, False, "integration", "whether points whose labels are proved are not integrated"
    )

    def __post_init__(self) -> None:
        for f in fields(self):
            if (value := getattr(self, f.name)) is not None or f.default is not None:
                object.__setattr__(self, f.name, f.metadata["check"](f.name, value))

    @property
    def cylinder(self) -> float:
        """Largest angle from the vertical, in rad, at which the third axis counts as vertical."""
        if self.cylinder_tolerance is not None:
            return self.cylinder_tolerance
        return DEFAULT_ANGLE if isinstance(self.rate_tolerance, str) else self.rate_tolerance

    def with_number(self, rate_tolerance: float) -> Settings:
        """Return a copy with the given rate tolerance (rad per time unit) and the same cylinder tolerance."""
        return replace(self, rate_tolerance=rate_tolerance, cylinder_tolerance=self.cylinder)

    def at(self, rate_tolerance: Array | float, transient: Array | float = 0.0) -> RunSettings:
        """Return run settings with a rate tolerance (rad per time unit) and transient (time units), each a number or an array."""
        return RunSettings(
            self.method, self.tolerance, self.step, self.max_steps, Tolerances(rate_tolerance, self.cylinder),
            self.drift_tolerance, self.std_tolerance, self.check_half_step, transient,
        )  # fmt: skip


DEFAULTS = Settings()


def rate_text(rate_tolerance: float | str) -> str:
    """Return a rate tolerance as text."""
    return rate_tolerance if isinstance(rate_tolerance, str) else f"{rate_tolerance:g}"


@dataclass(frozen=True, eq=False)
class Axis:
    """A dimension of the atlas. If `long_name` or `units` is empty, the coordinate has the attribute of the parameter."""

    name: str  # name of a parameter, or a name that ties use
    values: Array  # the values along the axis, all different, float64 of shape (count,)
    offset_from_family: bool = False  # whether the values are added to the solution of the family
    long_name: str = ""  # attribute of the coordinate
    units: str = ""  # attribute of the coordinate
    display_units: str = ""  # attribute of the coordinate, "deg" for figures with degrees
    table: Mapping[str, Any] = field(default_factory=dict)  # the table [axes.NAME] of the scene

    @property
    def dim(self) -> str:
        """Name of the axis as a dimension of the atlas."""
        return f"{self.name}_offset" if self.offset_from_family else self.name

    @property
    def can_be_refined(self) -> bool:
        """Whether [refine] halves the spacing, which requires a count above 1 and no listed values."""
        return self.table.get("count", 1) > 1

    def __str__(self) -> str:
        first, last, count = self.values[0], self.values[-1], len(self.values)
        kind = "offset from the family, " if self.offset_from_family else ""
        extent = f"{first:g}" if count == 1 else f"{count} values from {first:g} to {last:g}"
        return f"{self.name}: {kind}{extent}"


@dataclass(frozen=True)
class Duration:
    """Length of the runs."""

    amount: float | str = f"60 / {NATURAL_RATE}"  # number in `unit`, or arithmetic that gives time units
    unit: str = ""  # "orbits", "turns" (periods of psi or phi, whichever is slower), or "" for time units

    @property
    def toml(self) -> float | str:
        """The value of the key `duration` or `transient` in a scene file."""
        return str(self) if self.unit else self.amount

    def __str__(self) -> str:
        unit = self.unit.removesuffix("s") if self.amount == 1 else self.unit
        amount = self.amount if isinstance(self.amount, str) else repr(self.amount).removesuffix(".0")
        return f"{amount} {unit}".strip()


@dataclass(frozen=True)
class Refine:
    """Refinement near borders of labels, which halves the spacing of the grid `levels` times."""

    # The axes of a scene contain the values of the finest grid.
    levels: int = checked(
        checks.whole(1, MAX_REFINEMENT_LEVELS), description="how often the spacing is halved"
    )
    probe: float = checked(
        checks.fraction, 0.01, description="share of the other points that are integrated at random"
    )


@dataclass(frozen=True)
class Creator:
    """The person or institution responsible for an atlas."""

    name: str = checked(checks.text, "")
    email: str = checked(checks.text, "")
    url: str = checked(checks.text, "")
    institution: str = checked(checks.text, "")


EMPTY_CREATOR = Creator()


@checks.accepts(**checks.table_schema(checks.keys_of(Creator)))
def creator(key: str, value: object) -> Creator:
    """Return a Creator from a table. Messages name the table by `key`."""
    return checks.instance_of(Creator, checks.mapping(key, value), key)


@dataclass(frozen=True)
class About:
    """Global attributes of an atlas, apart from the title. The names are those of ACDD-1.3."""

    summary: str = checked(checks.text, "")  # a paragraph about the content of the atlas
    license: str = checked(checks.text, "")  # such as "CC-BY-4.0"
    keywords: tuple[str, ...] = checked(checks.texts, ())
    references: tuple[str, ...] = checked(checks.texts, ())  # without the reference of the system
    acknowledgement: str = checked(checks.text, "")
    comment: str = checked(checks.text, "")
    project: str = checked(checks.text, "")
    id: str = checked(checks.text, "")  # unique identifier, such as a DOI
    creator: Creator = checked(creator, EMPTY_CREATOR)  # noqa: RUF009 - Creator is frozen

    def attributes(self) -> dict[str, str]:
        """Return the attributes that are not empty, except the references, by the names of ACDD-1.3."""
        attributes = {f.name: getattr(self, f.name) for f in fields(self)}
        del attributes["references"]
        attributes |= {f"creator_{name}": value for name, value in vars(attributes.pop("creator")).items()}
        attributes["keywords"] = ", ".join(self.keywords)
        return {name: value for name, value in attributes.items() if value}

    def table(self) -> dict[str, Any]:
        """Return the table [about] of a scene, without empty entries."""
        table = {
            name: list(value) if isinstance(value, tuple) else value for name, value in vars(self).items()
        }
        table["creator"] = {name: value for name, value in vars(self.creator).items() if value}
        return {name: value for name, value in table.items() if value}


EMPTY_ABOUT = About()


@dataclass(frozen=True, repr=False)
class Scene:
    """A checked scene, which determines the content of an atlas."""

    title: str  # free text, kept in the atlas
    system: System  # equations, parameters and families
    fixed: Mapping[str, float]  # constant values of parameters and of names that ties use
    axes: Mapping[str, Axis]  # dimensions of the atlas in order, or the single axis "point" for [points]
    ties: Mapping[str, Tie]  # expressions by the names that they define, in order of evaluation
    family: str | None = None  # name of the family of steady motions on which every point starts
    solve: tuple[str, ...] = ()  # parameters that formulas of the family compute, in this order
    choice: Mapping[str, Any] = field(default_factory=dict)  # `branch` or `near` -> value, from [family]
    nudge: Mapping[str, float] = field(default_factory=dict)  # amounts added to start values after solving
    duration: Duration = Duration()  # length of the runs
    transient: Duration = Duration(0.0)  # time before statistics and labels begin
    settings: Settings = DEFAULTS  # settings of integration and labels
    outputs: tuple[str, ...] = ()  # variables of the atlas
    map: str = ""  # variable shown first on maps and pages, or empty to leave the choice to `map_variable`
    seed: int = 0  # seed of the random numbers in ties
    refine: Refine | None = None  # refinement near borders of labels
    points: Mapping[str, Any] | None = None  # the table [points]; numbers from a file replace the file's name
    about: About = EMPTY_ABOUT  # global attributes of the atlas
    source: Source | None = field(default=None, compare=False)  # the file of the scene, for error messages

    @property
    def shape(self) -> tuple[int, ...]:
        """Number of values along each axis."""
        return tuple(len(axis.values) for axis in self.axes.values())

    @property
    def size(self) -> int:
        """Number of points of the grid."""
        return math.prod(self.shape)

    @property
    def extensions(self) -> list[str]:
        """Names, in alphabetical order, of the extensions that define outputs or the family of the scene."""
        variables = [name for name in self.outputs if name not in self.system.derived]
        families = [] if self.family is None or self.family in self.system.families else [self.family]
        return [each.name for each in extension.used(variables, families)]

    @property
    def solved_text(self) -> str:
        """Text of the solved parameters and the chosen branch, or an empty text if nothing is solved."""
        choice = [f"{key} = {shown(value)}" for key, value in self.choice.items()]
        return ", ".join([f"solved for {', '.join(self.solve)}", *choice]) if self.solve else ""

    @property
    def nudges_angles(self) -> bool:
        """Whether the nudge changes Euler angles and their rates, rather than optional start values."""
        return bool(self.nudge) and not optional_start_values(self.system, self.nudge)

    @property
    def coarsening(self) -> tuple[int, ...]:
        """Spacing of the coarsest grid along each axis, in points of the finest grid."""
        assert self.refine is not None
        return tuple(2**self.refine.levels if axis.can_be_refined else 1 for axis in self.axes.values())

    def zero_and_equal_parameters(self) -> tuple[frozenset[str], frozenset[tuple[str, str]]]:
        """Return parameters that are 0 or absent at every point, and pairs of equal parameters. Kernels omit vanishing terms."""
        parameters, varying = self.system.parameters, {*self.axes, *self.ties, *self.solve}
        constants = {
            name: self.fixed.get(name, parameters[name].default) for name in parameters if name not in varying
        }
        zero, equal = zero_and_equal(constants)
        copies = [{name, tie.text} for name, tie in self.ties.items() if tie.text in constants]
        return zero, equal | {(a, b) for a, b in combinations(parameters, 2) if {a, b} in copies}

    def toml(self) -> str:
        """Return the scene as TOML text with every default written out. `load_scene` reads the same scene from the text."""
        settings = self.settings
        table: dict[str, Any] = {
            "extensions": self.extensions,
            "seed": self.seed,
            "about": self.about.table(),
            "axes": {} if self.points else {axis.name: dict(axis.table) for axis in self.axes.values()},
            "points": self.points and dict(self.points),
            "refine": self.refine and vars(self.refine),
            "family": self.family and {"name": self.family, "solve": list(self.solve)} | dict(self.choice),
            "nudge": dict(self.nudge),
        }
        table = {
            "schema": SCHEMA,
            "title": self.title,
            "system": self.system.name,
            "fixed": dict(self.fixed),
            "ties": {name: tie.text for name, tie in self.ties.items() if not isinstance(tie, PointColumn)},
            **{name: value for name, value in table.items() if value},
            "integration": {"duration": self.duration.toml},
            "labels": {"transient": self.transient.toml} if self.transient.amount else {},
        }
        for f in fields(settings):
            value = settings.cylinder if f.name == "cylinder_tolerance" else getattr(settings, f.name)
            if value is not None:
                table[f.metadata["section"]][f.name] = value
        if settings.step is not None:
            del table["integration"]["tolerance"]
        table["outputs"] = {"variables": list(self.outputs)} | ({"map": self.map} if self.map else {})
        return tomli_w.dumps(table)

    def __repr__(self) -> str:
        settings = self.settings
        lines = [
            f"{printable(self.title, MAX_TEXT)}: {self.size} points of the {self.system.name}",
            *(str(axis) for axis in list(self.axes.values())[:MAX_SHOWN]),
        ]
        if len(self.axes) > MAX_SHOWN:
            lines.append(f"and {len(self.axes) - MAX_SHOWN} axes more")
        columns = {name for name, tie in self.ties.items() if isinstance(tie, PointColumn)}
        ties = {name: printable(tie.text, MAX_TIE_SHOWN) for name, tie in self.ties.items()}
        sections = {
            "columns": [name for name in ties if name in columns],
            "fixed": [f"{name} = {value:g}" for name, value in self.fixed.items()],
            "nudge": [f"{name} = {value:g}" for name, value in self.nudge.items()],
            "ties": [f"{name} = {text}" for name, text in ties.items() if name not in columns],
        }
        for title, items in sections.items():
            if items:
                rest = [f"and {len(items) - MAX_SHOWN} more"] if len(items) > MAX_SHOWN else []
                lines.append(f"{title}: {', '.join([*items[:MAX_SHOWN], *rest])}")
        if self.family is not None:
            lines.append(f"family: {self.family}, {self.solved_text or 'solved for nothing'}")
        accuracy = f"tolerance {settings.tolerance:g}" if settings.step is None else f"step {settings.step:g}"
        transient = f" after a transient of {self.transient}" if self.transient.amount else ""
        lines.append(f"duration {self.duration}{transient}, {settings.method}, {accuracy}")
        lines.append(
            f"rate tolerance {rate_text(settings.rate_tolerance)}, cylinder tolerance {settings.cylinder:g}"
        )
        return "\n  ".join(lines)

    def _repr_html_(self) -> str:
        return f"<pre>{html.escape(str(self))}</pre>"


def zero_and_equal(constants: Mapping[str, float]) -> tuple[frozenset[str], frozenset[tuple[str, str]]]:
    """Return the names of constants that are 0 or absent (nan), and pairs of names with equal values."""
    zero = {name for name, value in constants.items() if value == 0 or math.isnan(value)}
    return frozenset(zero), frozenset(
        (a, b) for a, b in combinations(constants, 2) if constants[a] == constants[b]
    )


def optional_start_values(system: System, names: Iterable[str]) -> list[str]:
    """Return the names of optional start values, whose default is nan."""
    return [name for name in names if math.isnan(system.parameters[name].default)]
