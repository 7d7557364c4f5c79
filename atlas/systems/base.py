"""The interface between the physics of a system and the rest of the package."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence, Set
from dataclasses import dataclass, field, replace
from functools import cache, wraps
from types import MappingProxyType, MethodType
from typing import Any, NamedTuple, TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .. import extension
from ..errors import BadInput
from ..flags import Stability, owner_of_family, reserved_families
from .arithmetic import TIME_UNIT
from .jacobian import frequency
from .vectors import turned

Array = NDArray[np.float64]
Flags = NDArray[np.int8]
Mask = NDArray[np.bool_]
# Every parameter of a system by name, as float64 arrays of one common shape.
Points = Mapping[str, Array]

# Formulas of theory may overflow if a parameter exceeds this magnitude or a positive parameter is below 1 / MAX_MAGNITUDE.
MAX_MAGNITUDE = 1e60
# Largest dimensionless residual of the conditions for a start on a family, and largest sin theta of a vertical third axis.
FAMILY_TOLERANCE = 1e-10
# Name that scenes and datasets use for `System.natural_rate`.
NATURAL_RATE = "natural_rate"
NO_RIGID_BODY = "no rigid body has these moments of inertia"
_T = TypeVar("_T")
_F = TypeVar("_F", bound=Callable[..., Any])
_CHUNK = 16384  # number of points identified together, so few that the arrays fit into the cache


@dataclass(frozen=True)
class Parameter:
    """A physical parameter or start value, with its range."""

    name: str
    unit: str  # SI unit in the spelling of UDUNITS; "1" for pure numbers
    meaning: str
    default: float = 0.0  # nan for an optional parameter, which is absent unless given
    low: float = -np.inf
    high: float = np.inf
    open_low: bool = False  # whether the value must lie strictly above `low`
    start: bool = False  # True for a start value, False for a property of the body, its rotor or the fields
    symbol: str = ""  # mathematical form for axis labels, e.g. r"$\theta_0$"


class TwoAxes(NamedTuple):
    """A motion with the angular velocity n fixed_axis + m spin_axis relative to the frame.

    The axis `spin_axis` is at rest in the body, and `fixed_axis` is at rest in the frame. Their components are in body axes at
    the start. The motion is a permanent rotation if one rate is 0 or if the axes are parallel.
    """

    spin_axis: Array  # unit vector, (3, points)
    spin_rate: Array  # m, rad per time unit, (points,)
    fixed_axis: Array  # unit vector, (3, points)
    precession_rate: Array  # n, rad per time unit, (points,)

    def subset(self, where: Any) -> TwoAxes:
        """Return the motions at the points that the indices or the mask `where` select."""
        return TwoAxes(*(values[..., where] for values in self))


class Geometry(NamedTuple):
    """A kind of steady motion. The path of the third axis defines the kind."""

    text: str  # description in one sentence
    # Function of measured variables, of a mask of motions on the vertical, and of the largest rate and angle that count as zero.
    # It returns a mask, and the first geometry that holds is taken. The variables axis_1 and axis_2, measured with axis_in_frame,
    # are means over the run of the third axis' components along the first two axes of the frame.
    holds: Callable[[Mapping[str, Array], Mask, Array | float, float], Mask]


@dataclass(frozen=True)
class Observable:
    """A quantity whose mean, standard deviation, extremes and drift are measured along each motion.

    The equations have a state, or a function of ``(state, constants)``, with the same name.
    """

    name: str
    unit: str  # unit in the spelling of UDUNITS; "1" for pure numbers
    long_name: str  # description in a few words
    # The observable counts as constant if the standard deviation, in `unit`, does not exceed this value. None stands for the
    # scene's rate_tolerance, and with inf any variation is ignored. A scene's labels.std_tolerance replaces this value.
    tolerance: float | None = None
    symbol: str = ""  # mathematical form for axis labels, e.g. r"$x$"
    # Period of measurement in time units, as a number or as arithmetic of pi and constants of the equations, such as "2*pi/w".
    # The observable is measured at the start and after each period, and runs last whole periods. None means measurement at all times.
    every: str | float | None = None


@dataclass(frozen=True)
class Condition:
    """An equation or inequality of a family. The dimensionless `residual` says by how much points violate the condition."""

    text: str
    residual: Callable[[Points], Array]


# For each name in Family.several, a scene may ask for the solution nearest to a value (inf: the largest). Points then hold the value
# under NEAR + name. If a formula solves for the parameter, the formula gets the value under the parameter's own name as well.
NEAR = "near "


@dataclass(frozen=True)
class Family:
    """A family of exact motions, which are steady motions about two axes or motions in a plane."""

    name: str
    flag: int = 0  # number of the family in the dataset variable `family`; `numbered` assigns numbers from 1
    title: str = ""
    equations: str = ""  # numbers of the equations in the paper, or another source
    conditions: tuple[Condition, ...] = ()
    # Formulas for parameters on the family, in the order in which a scene solves them. A formula gives nan where no value exists.
    solve: Mapping[str, Callable[[Points], Array]] = field(default_factory=dict)
    # Text on the default solution, by the name of a parameter that has several solutions. The parameter is in `solve`, or it is a
    # rate in formulas for start values. A scene may choose another solution (see NEAR).
    several: Mapping[str, str] = field(default_factory=dict)
    # Functions of points that return flags.Stability and growth rates, rad per time unit. `rough_stability` has fewer digits.
    stability: Callable[[Points], tuple[Flags, Array]] | None = None
    rough_stability: Callable[[Points], tuple[Flags, Array]] | None = None
    stability_text: str = ""  # text for the catalogue on what decides the stability
    # Closed form of the motion as a function of points and times t. The states have the shape (state, *t.shape, *points.shape).
    motion: Callable[[Points, Array], Array] | None = None
    geometry: str = ""  # name of the Geometry; empty if the geometry depends on the point
    labels: str = ""  # labels of the motion in the frame and in inertial space, as text
    paper_wording: str = ""
    exists: str = ""  # text on limits of existence that the conditions do not contain
    free: tuple[str, ...] = ()  # parameters that the conditions leave free
    # Axes and rates at points, for a family of motions about other axes than the third axis and the vertical.
    axes: Callable[[Points], TwoAxes] | None = None
    # Function of points and durations. It returns the standard deviation, (points,), of the varying rate of turning about the
    # third axis, which is vertical. An infinite duration means whole periods. The function is None if motions are steady.
    rate_std: Callable[[Points, Array], Array] | None = None


def numbered(families: Iterable[Family], after: Collection[str] = ()) -> dict[str, Family]:
    """Return families by name. The flags count the families in the given order, and follow the flags of the families `after`."""
    return {family.name: replace(family, flag=i) for i, family in enumerate(families, 1 + len(after))}


@dataclass(frozen=True)
class PublishedEquation:
    """One equation or statement of the system's paper, as printed and as corrected.

    A residual is computed at random parameters and is near 0 if the equation is true. None means that there is no measure.
    """

    number: str
    family: str  # family that the equation describes; "" for the equations of motion and other formulas
    printed: str
    true: str
    verdict: str  # true, misprint, false, incomplete, or "true at ..., false at ..."
    measure: str = ""  # meaning of the residuals
    residual_printed: Callable[[np.random.Generator], float] | None = None
    residual_true: Callable[[np.random.Generator], float] | None = None
    effect: str = ""  # consequence of the difference between `printed` and `true`


# Function of names of variables, the points without the scene's nudge, the duration and `pause`. It returns values (points,) by name.
GroupValues = Callable[[Collection[str], Points, Array, Callable[[], None]], Mapping[str, NDArray[Any]]]


@dataclass(frozen=True)
class DerivedVariable:
    """A quantity from theory that is computed if a scene lists it among its outputs."""

    name: str
    unit: str
    long_name: str
    # Function of the points without the scene's nudge, the duration and `pause`. It returns values (points,). A long computation
    # calls pause() at least once a second. If the run was interrupted, pause() raises an exception.
    values: Callable[[Points, Array, Callable[[], None]], NDArray[Any]]
    comment: str = ""
    # Raises BadInput if the variable is undefined or takes too long at some points and durations.
    check: Callable[[Points, Array], object] = lambda points, duration: None
    # Meanings of int8 flags by name, in the order of the values 0, 1, 2, ... The mapping is None if `values` returns no flags.
    flags: Mapping[str, str] | None = None
    from_start: bool = False  # whether values describe the motion from t = 0, which forbids a transient
    # Function for several variables. Variables that share intermediate results have the same function here.
    group_values: GroupValues | None = None

    @classmethod
    def of_group(
        cls, group_values: GroupValues, name: str, unit: str, long_name: str, comment: str, **attributes: Any
    ) -> DerivedVariable:
        """Return a variable whose values `group_values` computes together with other variables."""

        def values(points: Points, duration: Array, pause: Callable[[], None]) -> NDArray[Any]:
            return group_values([name], SharedValues(points), duration, pause)[name]

        return cls(name, unit, long_name, values, comment, group_values=group_values, **attributes)


@dataclass(frozen=True, eq=False)
class StressCase:
    """Stiff or extreme points. Arrays have one entry for each point, and numbers hold for all points."""

    name: str
    description: str
    duration: ArrayLike  # time units
    columns: Mapping[str, ArrayLike]  # parameters by name; a missing parameter takes its default
    solve: tuple[str, str] | None = None  # family, and the parameter for which the family is solved
    additions: Mapping[str, ArrayLike] = field(default_factory=dict)  # added to the solved parameters
    may_stay_unresolved: str = ""  # why a point may stay unresolved even with an automatic step
    # Exact motion of the points, as the name of a class or as a function from a point to the motion. "departure" says that
    # `additions` are tiny offsets from an unstable equilibrium. If empty, theory or the reference integrator gives the true label.
    truth: str | Callable[[Points], Any] = ""


def _or_extension(method: _F) -> _F:
    """Decorate a method of `System` so that the method runs only if no extension returns a result."""

    @wraps(method)
    def answer(*arguments: Any, **options: Any) -> Any:
        solve = extension.load("methods", method.__name__)
        result = solve(*arguments, **options) if solve else None
        return method(*arguments, **options) if result is None else result

    return answer  # type: ignore[return-value]


class System(ABC):
    """A physical system, with the members that kernels, labels, scenes and figures use.

    A system is a subclass that defines its names, `equations`, `parameters` and `initial_state`. It also defines either the
    motion of a body relative to a frame (``frame_motion`` of the equations) or `observables`. Other members have defaults.
    `points` maps the name of each parameter to a float64 array. All arrays have the same shape, called ``(points,)`` here.

    The members form three groups:

    Equations
        `equations`, `parameters`, `observables`, `constants`, `integral_scales`, `frequency_bound`, `rate_states`,
        `specialization`.
    Initial values
        `initial_state`, `steady_rates`, `as_euler_angles`, `check`, `warnings`, and what is physically possible:
        `moments_of_inertia`, `possible_start`, `start_condition`.
    Theory
        `families`, `identify_family`, `linear_stability`, `frame_rate`, `geometries`, `derived`, `equilibria`,
        `equilibria_of_bodies`, `stress_cases`.

    Instances are compared and hashed by identity, because kernels are cached by system.
    """

    name: str
    """Name in scenes and files, such as "satellite"."""
    title: str
    """Description in a few words."""
    frame: str = "space"
    """Name of the frame in which theta, psi and phi are measured; its third axis is "the vertical".

    Empty in a registered system with `observables`.
    """
    frame_axes: tuple[str, str, str] = ("$x$", "$y$", "vertical")
    """Labels of the three axes of the frame in figures."""
    frame_text: str = ""
    """Meaning of the axes of the frame, and their other names."""
    reference: str = ""
    """Citation of the paper that the system comes from."""
    doi: str = ""
    """DOI of the paper."""
    bibtex: str = ""
    """BibTeX entry of the paper; if empty, `cite` makes one from `reference`."""

    # Equations.

    equations: Any
    """Module, or class, of plain scalar functions, whose source is pasted into the kernels.

    It defines ``STATE`` and ``CONSTANTS`` (tuples of names), and functions of ``(state, constants)``, two sequences in
    the order of these names. The functions are plain arithmetic with `arithmetic.FUNCTIONS`:

    - ``rhs``: time derivatives of the state;
    - ``frame_motion``, unless the system has `observables`: angular velocity of the body relative to the frame
      (rad per time unit) and the unit vector of the frame's vertical, three components each, in body axes;
    - one function for each observable that is not a state;
    - ``INTEGRALS`` (optional): name of each first integral -> exponent of 1 / time in its unit;
    - ``LOSSES`` (optional): name of a first integral that dissipation changes -> name of the function for its loss per
      time, a number; the integral plus its accumulated loss is constant;
    - ``scaled`` (optional), with a third argument h: state and constants in units in which the time h is 1;
      ``unscaled``, with the same arguments: back from a scaled state; ``ONES``: constants that are 1 in these units;
    - ``OPTIONAL`` (optional): constants that identify a point only if they are not 0, so that a version may add some;
    - ``FRAME_VECTORS`` (optional): triples of states that are unit vectors at rest in the frame, v' = v x u with the
      angular velocity u of ``frame_motion``, so that tangent vectors have fewer components; the last is the vertical, and
      with ``axis_in_frame`` the first of two is the frame's first axis;
    - ``axis_in_frame`` (optional): components of the third body axis along the first two axes of the frame;
    - one function for each first integral: the tuple of its terms.
    """
    parameters: Mapping[str, Parameter]
    """Parameters and start values by name, with units, defaults and allowed ranges."""
    observables: tuple[Observable, ...] = ()
    """Quantities measured in a system without ``frame_motion``; a motion is steady if none of them varies."""
    rate_states: tuple[str, ...] = ()
    """States that are angular velocities; their errors are relative to the frequency bound."""
    moments_of_inertia: tuple[str, str, str] | None = None
    """Names of the parameters for the principal moments of inertia; None: the system is no rigid body."""

    def constants(self, points: Points) -> Array:
        """Return the constants that the kernels read, shape (constants, points), in the order of ``equations.CONSTANTS``.

        The default takes each constant from the parameter of the same name.
        """
        shape = shape_of(points)
        rows = [np.ones(shape) if name == TIME_UNIT else points[name] for name in self.equations.CONSTANTS]
        return np.reshape(np.array(rows, float), (len(rows), *shape))

    def integral_scales(self, points: Points) -> Mapping[str, Array]:
        """Return a lower bound of the scale of each first integral, or nan where the integral is not constant.

        Returns
        -------
        mapping of every name in ``equations.INTEGRALS`` to an array (points,)
            Lower bound, in units of the integral, of the sum of the magnitudes of its terms. The integral's error is divided by
            this sum. The bound is nan where even the sum of the integral and its accumulated loss varies. The default is 0.
        """
        return {name: np.zeros(shape_of(points)) for name in self.equations.INTEGRALS}

    def frequency_bound(self, points: Points) -> Array:
        """Return an upper bound of the fastest frequency of each motion, rad per time unit, shape (points,).

        Step sizes and the check for under-resolved points depend on the bound. It must therefore hold for the whole motion
        and not only at the start. The default is the numeric bound `jacobian.frequency` at the start, which is raised along
        each motion.
        """
        return frequency(self.equations, self.initial_state(points), self.constants(points))

    def natural_rate(self, points: Points) -> Array:
        """Return a characteristic rate of each point, which is the unit of default durations and tolerances.

        Returns
        -------
        array (points,)
            Rates above 0, in rad per time unit. The default is 1.
        """
        return np.ones(shape_of(points))

    @property
    def has_numeric_bound(self) -> bool:
        """Whether the frequency bound is the numeric bound `jacobian.frequency`."""
        return type(self).frequency_bound is System.frequency_bound

    def specialization(
        self, zero: Set[str], equal: Set[tuple[str, str]]
    ) -> tuple[Set[str], Set[tuple[str, str]]]:
        """Return which constants of the equations are 0, or equal, at every point of a scene.

        Every different result needs one more kernel, so there should be few of them. The default returns empty sets.

        Parameters
        ----------
        zero : set of str
            Parameters that are 0 or absent at every point.
        equal : set of pairs of str
            Pairs of parameters that are equal at every point, in the order of `parameters`.

        Returns
        -------
        zero_constants : set of str
            Constants of the equations that are 0.
        equal_constants : set of pairs of str
            Pairs of constants that are equal.
        """
        return set(), set()

    # Initial values.

    @abstractmethod
    def initial_state(self, points: Points) -> Array:
        """Return the state at t = 0, shape (states, points), in the order of ``equations.STATE``."""

    def steady_rates(self, points: Points) -> tuple[Array, Array, Array]:
        """Return the tilt and rates of the steady motion theta' = 0, psi' = n, phi' = m that starts at each point.

        Returns
        -------
        sin_theta, n, m : arrays (points,)
            A pure number, and two rates in rad per time unit. By default the initial state gives all three. Where
            the third axis is exactly vertical, n is 0 and m is the whole rate. All are 0 without ``frame_motion``.
        """
        if self.observables:
            sine, n, m = np.zeros((3, *shape_of(points)))
            return sine, n, m
        u1, u2, u3, g1, g2, g3 = self.equations.frame_motion(
            self.initial_state(points), self.constants(points)
        )
        sine = np.hypot(g1, g2)
        n = np.divide(u1 * g1 + u2 * g2, sine**2, out=np.zeros_like(sine), where=sine**2 > 0)
        return sine, n, u3 - n * g3

    def as_euler_angles(self, points: Points) -> Points:
        """Return the same starts with Euler angles and their rates in place of optional start values.

        Scenes add a nudge of angles to the result. The default returns the points unchanged.
        """
        return points

    start_condition: str = "the initial state must be finite"
    """What `possible_start` tests, such as "the vertical must be a unit vector"."""

    def check(self, points: Points) -> None:
        """Raise BadInput with one line if points are incomplete or contradictory. The default accepts all points."""
        return None

    def possible_start(self, points: Points) -> Mask:
        """Return where the start values are consistent, bool (points,). By default the state must be finite."""
        with np.errstate(all="ignore"):
            return np.asarray(np.isfinite(self.initial_state(points)).all(axis=0))

    def warnings(self, points: Points) -> list[str]:
        """Return one sentence for each thing that a user should know about the points."""
        return []

    def remarks(self, points: Mapping[str, Any]) -> list[str]:
        """Return sentences for users who compare labels with theory. `points` has some or all parameters by name."""
        return []

    # Theory.

    families: Mapping[str, Family] = MappingProxyType({})
    """Families of exact steady motions by name, their flags counted from 1 in this order."""
    geometries: Mapping[str, Geometry] = MappingProxyType({})
    """Geometries of steady motions by name, the values of the flag variable `geometry` counted from 1; 0 is none."""
    derived: Mapping[str, DerivedVariable] = MappingProxyType({})
    """Quantities from theory that a scene may list among its outputs, by name."""
    frame_rate: Callable[[Points], Array] | None = None
    """Rate of the frame about its vertical in inertial space, points -> rad per time unit, shape (points,).

    None: the frame is inertial.
    """

    @_or_extension
    def equilibria(self, body: Mapping[str, float]) -> Mapping[str, NDArray[Any]]:
        """Return all relative equilibria or permanent rotations of one body. By default an extension computes them.

        Parameters
        ----------
        body : mapping of str to float
            Parameters of the body. A missing parameter takes its default.

        Returns
        -------
        mapping of str to array
            Arrays with one entry for each equilibrium.
        """
        missing = extension.not_loaded()
        raise BadInput(f"equilibria: the system {self.name} has no function that computes them{missing}")

    @_or_extension
    def equilibria_of_bodies(
        self, points: Points, pause: Callable[[], None] = lambda: None, **options: Any
    ) -> Mapping[str, NDArray[Any]]:
        """Return all relative equilibria or permanent rotations of many bodies, like `equilibria` for one body.

        Parameters
        ----------
        points : mapping of str to array (bodies,)
            Every parameter.
        pause : callable
            Function that is called at least once a second. It raises an exception if the computation was interrupted.
        **options
            Options of the extension that computes the equilibria.

        Returns
        -------
        mapping of str to array (bodies, places)
            Unused places at the end of each row have the Morse index -1. The array `completeness`, int8 (bodies,), contains
            values of flags.Completeness.
        """
        if type(self).equilibria is System.equilibria:
            self.equilibria({})
        raise BadInput(
            f"body: arrays given; the system {self.name} has equilibria of one body at a time only"
        )

    def identify_family(self, points: Points) -> tuple[Flags, Array]:
        """Return the family of the steady motion that starts at each point.

        Returns
        -------
        flag : int8 array (points,)
            Flag of the first family whose largest condition residual is at most FAMILY_TOLERANCE, or 0 without such a family.
        residual : array (points,)
            Largest condition residual of that family, dimensionless. Without such a family, the least value over all families
            is returned, or inf if the system has no families.
        """
        others = other_families(self)
        return identify(points, [each for each in families_of(self).values() if each not in others], others)

    def linear_stability(self, points: Points, flags: Flags) -> tuple[Flags, Array]:
        """Return the linear stability of the steady motions.

        A motion is stable if every characteristic exponent is imaginary and simple, or if the energy has a minimum. It is
        unstable if an exponent has a positive real part. Zero exponents that come from a symmetry or a conserved momentum are
        ignored. If another exponent is zero up to rounding, or two are equal up to rounding, distances may grow like a power of
        time. The stability is then unknown, but the growth rate is 0. The default uses the formulas of families.

        Parameters
        ----------
        flags : int8 array (points,)
            Flags of families, from `identify_family`.

        Returns
        -------
        stable : int8 array (points,)
            Values of flags.Stability.
        growth_rate : array (points,)
            Largest real part of the characteristic exponents, rad per time unit, or nan where the exponents are unknown.
        """
        stable, growth = np.full(flags.shape, Stability.UNKNOWN, np.int8), np.full(flags.shape, np.nan)
        for family in families_of(self).values():
            members = np.flatnonzero(flags == family.flag)
            if members.size and family.stability is not None:
                stable[members], growth[members] = family.stability(subset(points, members))
        return stable, growth

    def stress_cases(self) -> Sequence[StressCase]:
        """Return stiff and extreme points for the command `atlas stress`."""
        return ()


def possible_body(system: System, points: Points) -> Mask:
    """Return where a rigid body can have the moments of inertia, (points,). Nothing is computed elsewhere.

    No principal moment of a body exceeds the sum of the two others. A flat body has equality. A moment of nan is accepted.
    """
    possible = np.ones(shape_of(points), bool)
    for total, largest, _ in _triangle(system, points):
        possible &= ~(total < largest * (1 - 1e-12))
    return possible


def check_possible(system: System, points: Points) -> None:
    """Raise BadInput with one line unless both the body and the start are possible at some point."""
    body = possible_body(system, points)
    others = f", and none of {body.size} points is possible" if body.size > 1 else ""
    if not body.any():
        for total, largest, (a, b, c) in _triangle(system, points):
            if total.flat[0] < largest.flat[0] * (1 - 1e-12):
                raise BadInput(
                    f"{a} + {b} = {total.flat[0]:g} is less than {c} = {largest.flat[0]:g}:"
                    f" {NO_RIGID_BODY}{others}"
                )
    if not (body & system.possible_start(points)).any():
        raise BadInput(f"{system.start_condition}{others}")


def _triangle(system: System, points: Points) -> Iterator[tuple[Array, Array, tuple[str, str, str]]]:
    """Yield for each moment of inertia the sum of the other two, the moment itself, and all three names in this order."""
    if system.moments_of_inertia is None:
        return
    a, b, c = system.moments_of_inertia
    for names in ((a, b, c), (b, c, a), (c, a, b)):
        with np.errstate(over="ignore"):
            yield points[names[0]] + points[names[1]], points[names[2]], names


def within_range(system: System, points: Points) -> Mask:
    """Return where formulas of theory cannot overflow, (points,). Theory predicts nothing elsewhere.

    All magnitudes are at most MAX_MAGNITUDE there, and all positive parameters are at least 1 / MAX_MAGNITUDE.
    """
    positive = [name for name, p in system.parameters.items() if p.open_low and p.low == 0]
    too_large = [np.abs(values) > MAX_MAGNITUDE for values in points.values()]
    too_small = [points[name] < 1 / MAX_MAGNITUDE for name in positive]
    return ~np.any([*too_large, *too_small], axis=0)


@cache
def families_of(system: System) -> Mapping[str, Family]:
    """Return by name the families of the system, then those of extensions. Extensions of this package have reserved flags."""
    added: dict[str, Family] = {}
    for families in extension.every("families", lambda name: owner_of_family(name) in ("", system.name)):
        added |= families(system)
    if wrong := added.keys() - (extension.parts("families").keys() - system.families.keys()):
        why = "the system has one too" if min(wrong) in system.families else "its record does not name it"
        raise BadInput(f"the system {system.name}: an extension has a family {min(wrong)}: {why}; rename one")
    every, reserved = dict(system.families), reserved_families(system.name)
    titles = {name: family.title for name, family in added.items()} | reserved
    for flag, name in enumerate(dict.fromkeys([*reserved, *added]), 1 + len(every)):
        if name in added:
            every[name] = replace(added[name], name=name, flag=flag, title=titles[name])
    return MappingProxyType(every)


def extensions_of(system: System, variables: Iterable[str]) -> list[extension.Extension]:
    """Return extensions that define one of `variables` or a family of the system. Any start may be on such a family."""
    families = families_of(system).keys() - system.families.keys()
    return extension.used([name for name in variables if name not in system.derived], families)


def stress_cases_of(system: System) -> list[StressCase]:
    """Return the stress cases of a system and then those of extensions."""
    of_extensions = extension.of_each("stress_cases", system.name)
    return [*system.stress_cases(), *(case for cases in of_extensions for case in cases(system))]


def other_families(system: System) -> list[Family]:
    """Return families of motions at a varying rate, or about other axes than the third and the vertical."""
    return [family for family in families_of(system).values() if family.axes or family.rate_std]


def identify(
    points: Points, families: Collection[Family], others: Collection[Family] = ()
) -> tuple[Flags, Array]:
    """Return flag and residual of the first family to which each point belongs, as System.identify_family does.

    A point on no family gets the least residual of the families that are not in `others`. Families in `others` are tested last.
    Their conditions are computed one by one, each only at the points that satisfy the earlier conditions.
    """
    shape = shape_of(points)
    flags, residual = np.zeros(shape, np.int8), np.full(shape, np.inf)
    flat = {name: np.ravel(value) for name, value in points.items()}
    for first in range(0, flags.size, _CHUNK):
        chunk = slice(first, first + _CHUNK)
        whole = len(shape) == 1 and flags.size <= _CHUNK and isinstance(points, SharedValues)
        part = points if whole else SharedValues(subset(flat, chunk))
        flag, least = flags.reshape(-1)[chunk], residual.reshape(-1)[chunk]  # views of the results
        computed: dict[Condition, Array] = {}  # residuals of conditions that families share
        for family in families:
            computed |= {c: _magnitude(c, part) for c in family.conditions if c not in computed}
            worst = np.max([computed[condition] for condition in family.conditions], axis=0)
            free = flag == 0
            least[free] = np.minimum(least[free], worst[free])
            flag[free & (worst <= FAMILY_TOLERANCE)] = family.flag
        with np.errstate(all="ignore"):
            for family in others:
                _identify_members(part, family, flag, least)
    return flags, residual


def _identify_members(points: Points, family: Family, flags: Flags, residual: Array) -> None:
    """Write `flags` and `residual` at the points on this family where `flags` is still 0."""
    members = np.flatnonzero(flags == 0)
    worst = np.zeros(members.size)
    part = points if members.size == flags.size else subset(points, members)
    for condition in family.conditions:
        worst = np.maximum(worst, _magnitude(condition, part))
        kept = worst <= FAMILY_TOLERANCE
        if not kept.all():
            members, worst, part = members[kept], worst[kept], subset(part, kept)
        if not members.size:
            return
    flags[members], residual[members] = family.flag, worst


def _magnitude(condition: Condition, points: Points) -> Array:
    """Return the magnitude of the residual of a condition, with inf in place of nan."""
    value = np.abs(condition.residual(points))
    return np.where(np.isnan(value), np.inf, value)


def time_units(system: System, units: str) -> str:
    """Return `units` of a time or rate, or "1" if all parameters and observables of the system are pure numbers."""
    own = {parameter.unit for parameter in system.parameters.values()}
    own |= {observable.unit for observable in system.observables}
    return "1" if system.observables and own == {"1"} and units in ("s", "s-1") else units


@cache
def derived_variables(system: System) -> Mapping[str, DerivedVariable]:
    """Return by name the quantities from theory that a scene may list. Raise BadInput if an extension repeats a name."""
    variables = dict(system.derived)
    if type(system).natural_rate is not System.natural_rate:
        variables[NATURAL_RATE] = DerivedVariable(
            NATURAL_RATE, "rad s-1", "the body's own rate",
            lambda points, duration, pause: system.natural_rate(points),
            comment="default durations and rate tolerances are measured in it",
        )  # fmt: skip
    for of_system in extension.every("variables"):
        for name, variable in of_system(system).items():
            if name in variables:
                raise BadInput(
                    f"the system {system.name}: an extension has a variable {name} too; rename one"
                )
            variables[name] = variable
    return MappingProxyType(variables)


def derived_values(
    system: System, names: Collection[str], points: Points, duration: Array, pause: Callable[[], None]
) -> dict[str, NDArray[Any]]:
    """Return values of derived variables by name, at points without the scene's nudge. Shared results are computed once."""
    variables = [variable for name, variable in derived_variables(system).items() if name in names]
    points, columns = SharedValues(points), dict[str, NDArray[Any]]()
    for variable in variables:
        if variable.group_values is None:
            columns[variable.name] = variable.values(points, duration, pause)
        elif variable.name not in columns:
            group = [other.name for other in variables if other.group_values is variable.group_values]
            values = variable.group_values(group, points, duration, pause)
            columns |= {name: values[name] for name in group}
    return columns


class SharedValues(dict[str, Array]):
    """Points that also store function values used by several conditions, such as units of residuals."""

    def __init__(self, points: Points):
        super().__init__(points)
        self._values: dict[Callable[[Points], Any], Any] = getattr(points, "_values", {})

    def of(self, function: Callable[[Points], _T]) -> _T:
        """Return the value of a function of the points. The value is computed once, and its arrays are read-only."""
        if function not in self._values:
            value: Any = function(self)
            views = [np.asarray(array).view() for array in (value if isinstance(value, tuple) else (value,))]
            for view in views:
                view.setflags(write=False)
            self._values[function] = tuple(views) if isinstance(value, tuple) else views[0]
        return self._values[function]


def shared(function: _F) -> _F:
    """Decorate a function of points, or of a system and points, so that each SharedValues evaluates it once."""

    @wraps(function)
    def of(*arguments: Any) -> Any:
        *system, points = arguments
        if not isinstance(points, SharedValues):
            return function(*arguments)
        return points.of(MethodType(function, *system) if system else function)

    return of  # type: ignore[return-value]


def subset(columns: Mapping[str, Array], where: Any) -> dict[str, Array]:
    """Return the columns at the points that a mask, indices or a slice select."""
    return {name: values[where] for name, values in columns.items()}


def shape_of(points: Points) -> tuple[int, ...]:
    return np.shape(next(iter(points.values())))


def unsteady(system: System, flags: Flags) -> Mask:
    """Return where `flags` name families whose motions turn about the vertical at a varying rate, (points,)."""
    return np.isin(flags, [each.flag for each in families_of(system).values() if each.rate_std])


def rate_std(system: System, points: Points, flags: Flags, duration: Array) -> Array:
    """Return, for each run, the standard deviation of the rate about the vertical, rad per time unit; 0 for steady motions."""
    result = np.zeros(flags.shape)
    for family in families_of(system).values():
        if family.rate_std and (members := np.flatnonzero(flags == family.flag)).size:
            result[members] = family.rate_std(subset(points, members), duration[members])
    return result


def rough_stability(system: System, points: Points, flags: Flags) -> tuple[Flags, Array]:
    """Return System.linear_stability, with fewer digits of the growth rate for families that have `rough_stability`."""
    rough = {f.flag: f.rough_stability for f in families_of(system).values() if f.rough_stability}
    stable, growth = system.linear_stability(points, np.where(np.isin(flags, list(rough)), 0, flags))
    for flag, decide in rough.items():
        if (members := np.flatnonzero(flags == flag)).size:
            stable[members], growth[members] = decide(subset(points, members))
    return stable, growth


def on_family(family: Family, points: Points) -> Array:
    """Return the largest dimensionless condition residual of a family, or inf where a residual is undefined."""
    return np.max([_magnitude(condition, points) for condition in family.conditions], axis=0)


def motion_about_axes(axes: TwoAxes, vector: Array, t: Array) -> tuple[Array, Array]:
    """Return, in body axes at times `t`, the angular velocity relative to the frame, and `vector`, which rests in the frame.

    The body turns by m t about `spin_axis` and then by n t about `fixed_axis`.
    """
    s, fixed = axes.spin_axis, axes.fixed_axis
    shape = (3, *np.broadcast_shapes(t.shape, s.shape[1:]))
    vector, s, fixed = (
        np.broadcast_to(v.reshape(3, *(1,) * (len(shape) - v.ndim), *v.shape[1:]), shape)
        for v in (vector, s, fixed)
    )
    moved = turned(turned(vector, fixed, -axes.precession_rate * t), s, -axes.spin_rate * t)
    rate = axes.precession_rate * turned(fixed, s, -axes.spin_rate * t) + axes.spin_rate * s
    return rate, moved
