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

# Parameters above this magnitude, or positive ones below its inverse, may have overflowing products and quotients.
MAX_MAGNITUDE = 1e60
# Largest condition residual (dimensionless) of a start on a family, and largest sin theta that counts as on the vertical.
FAMILY_TOLERANCE = 1e-10
# Name of `System.natural_rate` in arithmetic of scenes and in datasets.
NATURAL_RATE = "natural_rate"
NO_RIGID_BODY = "no rigid body has these moments of inertia"
_T = TypeVar("_T")
_F = TypeVar("_F", bound=Callable[..., Any])
_CHUNK = 16384  # points that are identified together; their arrays fit into the cache


@dataclass(frozen=True)
class Parameter:
    """A physical parameter or start value, with its range."""

    name: str
    unit: str  # SI, UDUNITS spelling; "1" for pure numbers
    meaning: str
    default: float = 0.0  # nan: optional, absent unless given
    low: float = -np.inf
    high: float = np.inf
    open_low: bool = False  # True: the value must lie strictly above low
    start: bool = False  # True: a start value, False: the body, its rotor or the fields
    symbol: str = ""  # mathematical form for axis labels, e.g. r"$\theta_0$"


class TwoAxes(NamedTuple):
    """A motion with the angular velocity n fixed_axis + m spin_axis relative to the frame.

    spin_axis is at rest in the body, fixed_axis in the frame; components are in body axes at the start. With a rate of 0 or
    parallel axes the motion is a permanent rotation.
    """

    spin_axis: Array  # unit vector, (3, points)
    spin_rate: Array  # m, rad per time unit, (points,)
    fixed_axis: Array  # unit vector, (3, points)
    precession_rate: Array  # n, rad per time unit, (points,)

    def subset(self, where: Any) -> TwoAxes:
        """The motions at some points, by their indices or a mask."""
        return TwoAxes(*(values[..., where] for values in self))


class Geometry(NamedTuple):
    """A kind of steady motion, by the path of the third axis."""

    text: str  # a sentence
    # (measured variables, mask of motions on the vertical, largest rate and angle that count as zero) -> mask; the first
    # geometry that holds is taken. axis_1 and axis_2, measured with axis_in_frame, are means over the run of the third axis'
    # components along the first two axes of the frame.
    holds: Callable[[Mapping[str, Array], Mask, Array | float, float], Mask]


@dataclass(frozen=True)
class Observable:
    """A quantity whose mean, standard deviation, extremes and drift are measured along each motion.

    The equations have a function of ``(state, constants)``, or a state, of the same name.
    """

    name: str
    unit: str  # UDUNITS spelling; "1" for pure numbers
    long_name: str  # description in a few words
    # Largest standard deviation with which the observable counts as constant, in its unit; None: the scene's rate_tolerance, inf: its
    # variation is ignored. The table labels.std_tolerance of a scene replaces this value.
    tolerance: float | None = None
    symbol: str = ""  # mathematical form for axis labels, e.g. r"$x$"
    # Period of measurement in time units, a number or arithmetic in pi and constants of the equations, such as "2*pi/w": the
    # observable is measured at the start and after each period, and runs last whole periods. None: measured at all times.
    every: str | float | None = None


@dataclass(frozen=True)
class Condition:
    """An equation or inequality of a family; its residual, dimensionless, is the amount by which it fails."""

    text: str
    residual: Callable[[Points], Array]


# If a scene wants the solution nearest to a value, points hold the value under NEAR + name, name a key of Family.several.
NEAR = "near "


@dataclass(frozen=True)
class Family:
    """A family of exact motions: theta = theta0, psi' = n, phi' = m, the same about other axes, or motions in a plane."""

    name: str
    flag: int = 0  # value of the dataset variable `family`, from 1; see `numbered`
    title: str = ""
    equations: str = ""  # numbers of the equations in the paper, or another source
    conditions: tuple[Condition, ...] = ()
    # parameter -> formula for its value on the family, nan where there is none; formulas are used in this order
    solve: Mapping[str, Callable[[Points], Array]] = field(default_factory=dict)
    # parameter with several solutions, or rate from which start values are solved -> text of the default solution. If a scene
    # wants the solution nearest to a value, points hold the value under the name and under NEAR + name; inf: the largest solution
    several: Mapping[str, str] = field(default_factory=dict)
    # points -> (flags.Stability, growth rate in rad per time unit), see System.linear_stability and `rough_stability`
    stability: Callable[[Points], tuple[Flags, Array]] | None = None
    rough_stability: Callable[[Points], tuple[Flags, Array]] | None = None
    stability_text: str = ""  # what decides the stability, for the catalogue
    # closed form of the motion: (points, t) -> state of the equations, shape (state, *t.shape, *points.shape)
    motion: Callable[[Points, Array], Array] | None = None
    geometry: str = ""  # name of its Geometry; empty: it depends on the point
    labels: str = ""  # labels of the motion in the frame and in inertial space, as text
    paper_wording: str = ""
    exists: str = ""  # limits of existence beyond the conditions
    free: tuple[str, ...] = ()  # parameters that the conditions leave free
    # points -> axes and rates of a motion about other axes than the third and the vertical; None: the motion is about these two
    axes: Callable[[Points], TwoAxes] | None = None
    # (points, durations) -> standard deviation, (points,), of the varying rate of a body that turns about its third axis on
    # the vertical; an infinite duration means whole periods. None: the motion is steady
    rate_std: Callable[[Points, Array], Array] | None = None


def numbered(families: Iterable[Family], after: Collection[str] = ()) -> dict[str, Family]:
    """Families by name, with flags counted in this order from 1 + len(after)."""
    return {family.name: replace(family, flag=i) for i, family in enumerate(families, 1 + len(after))}


@dataclass(frozen=True)
class PublishedEquation:
    """One equation or statement of the system's paper, as printed and as corrected.

    The residual at random parameters is near 0 if the equation is true; None: there is no measure.
    """

    number: str
    family: str  # family that the equation describes; "" for the equations of motion and other formulas
    printed: str
    true: str
    verdict: str  # true, misprint, false, incomplete, or "true at ..., false at ..."
    measure: str = ""  # meaning of the residuals
    residual_printed: Callable[[np.random.Generator], float] | None = None
    residual_true: Callable[[np.random.Generator], float] | None = None
    effect: str = ""  # consequence of the difference


# (names of variables, points before the nudge, duration, pause) -> their values (points,) by name.
GroupValues = Callable[[Collection[str], Points, Array, Callable[[], None]], Mapping[str, NDArray[Any]]]


@dataclass(frozen=True)
class DerivedVariable:
    """A quantity from theory, computed if a scene lists it among its outputs."""

    name: str
    unit: str
    long_name: str
    # (points before the nudge, duration, pause) -> (points,). A long computation calls pause() at least once a second,
    # which raises an exception if the run was interrupted.
    values: Callable[[Points, Array, Callable[[], None]], NDArray[Any]]
    comment: str = ""
    # raises BadInput for points and durations at which the variable is undefined or takes too long
    check: Callable[[Points, Array], object] = lambda points, duration: None
    # for int8 flags: name -> sentence, in the order of the values 0, 1, 2, ...
    flags: Mapping[str, str] | None = None
    from_start: bool = False  # for the motion from the start only; refused with a transient
    # Values of several variables by name; variables that share intermediate results have the same function here.
    group_values: GroupValues | None = None

    @classmethod
    def of_group(
        cls, group_values: GroupValues, name: str, unit: str, long_name: str, comment: str, **attributes: Any
    ) -> DerivedVariable:
        """A variable that `group_values` computes with others."""

        def values(points: Points, duration: Array, pause: Callable[[], None]) -> NDArray[Any]:
            return group_values([name], SharedValues(points), duration, pause)[name]

        return cls(name, unit, long_name, values, comment, group_values=group_values, **attributes)


@dataclass(frozen=True, eq=False)
class StressCase:
    """Stiff or extreme points; arrays have one entry for each point, numbers hold for all points."""

    name: str
    description: str
    duration: ArrayLike  # time units
    columns: Mapping[str, ArrayLike]  # parameters; missing ones take their defaults
    solve: tuple[str, str] | None = None  # family, and the parameter that puts the points on it
    additions: Mapping[str, ArrayLike] = field(default_factory=dict)  # added to parameters after solving
    may_stay_unresolved: str = ""  # why a point may stay unresolved even with an automatic step
    # exact motion of the points, as the name of its class or a function from a point to the motion; "departure": additions are
    # tiny offsets from an unstable equilibrium; empty: theory or the reference integrator gives the true label
    truth: str | Callable[[Points], Any] = ""


def _or_extension(method: _F) -> _F:
    """Decorator: a method of `System` that runs only if no extension has a result for it."""

    @wraps(method)
    def answer(*arguments: Any, **options: Any) -> Any:
        solve = extension.load("methods", method.__name__)
        result = solve(*arguments, **options) if solve else None
        return method(*arguments, **options) if result is None else result

    return answer  # type: ignore[return-value]


class System(ABC):
    """A physical system, with the members that kernels, labels, scenes and figures use.

    A system is a subclass that defines its names, `equations`, `parameters` and `initial_state`, and either the motion of
    a body relative to a frame (``frame_motion`` of the equations) or `observables`; every other member has a default.
    `points` maps the name of each parameter to a float64 array, all of one shape, called ``(points,)`` here.

    Members, in three groups:

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
    - ``INTEGRALS`` (optional): name of each first integral -> its power of a rate;
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
        """Constants that the kernels read, shape (constants, points), in the order of ``equations.CONSTANTS``.

        The default takes each from the parameter of the same name.
        """
        shape = shape_of(points)
        rows = [np.ones(shape) if name == TIME_UNIT else points[name] for name in self.equations.CONSTANTS]
        return np.reshape(np.array(rows, float), (len(rows), *shape))

    def integral_scales(self, points: Points) -> Mapping[str, Array]:
        """Where each first integral, with its losses, is constant, and a lower bound of the scale of its error.

        Returns
        -------
        mapping of every name in ``equations.INTEGRALS`` to an array (points,)
            nan where the integral is not constant, even with its losses; elsewhere a lower bound, in units of the integral,
            of the sum of the magnitudes of its terms, by which its error is divided. The default is 0: constant everywhere.
        """
        return {name: np.zeros(shape_of(points)) for name in self.equations.INTEGRALS}

    def frequency_bound(self, points: Points) -> Array:
        """Upper bound of the fastest frequency of each motion, rad per time unit, shape (points,).

        The step sizes and the check for under-resolved points depend on it, so it must hold for the whole
        motion and not only at the start. The default is the numeric bound `jacobian.frequency` at the start, which is
        raised along each motion.
        """
        return frequency(self.equations, self.initial_state(points), self.constants(points))

    def natural_rate(self, points: Points) -> Array:
        """Characteristic rate of each point, the unit of default durations and tolerances.

        Returns
        -------
        array (points,)
            Above 0, rad per time unit. The default is 1.
        """
        return np.ones(shape_of(points))

    @property
    def has_numeric_bound(self) -> bool:
        """Whether the frequency bound is computed numerically."""
        return type(self).frequency_bound is System.frequency_bound

    def specialization(
        self, zero: Set[str], equal: Set[tuple[str, str]]
    ) -> tuple[Set[str], Set[tuple[str, str]]]:
        """Constants of the equations that are 0, or equal, at every point of a scene.

        Each different result is one more kernel to compile, so there should be few. The default leaves nothing out.

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
        """State at t = 0, shape (states, points), in the order of ``equations.STATE``."""

    def steady_rates(self, points: Points) -> tuple[Array, Array, Array]:
        """Tilt and rates of the steady motion theta' = 0, psi' = n, phi' = m with each start.

        Returns
        -------
        sin_theta, n, m : arrays (points,)
            A pure number, and two rates in rad per time unit. The default computes them from the initial state; where
            the third axis is exactly on the vertical, n is 0 and m the whole rate. All are 0 without ``frame_motion``.
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
        """The same starts with optional start values replaced by Euler angles and their rates.

        Scenes add a nudge of angles to the result. The default returns the points unchanged.
        """
        return points

    start_condition: str = "the initial state must be finite"
    """What `possible_start` tests, such as "the vertical must be a unit vector"."""

    def check(self, points: Points) -> None:
        """Raise BadInput with one line for incomplete or contradictory points. The default accepts all."""
        return None

    def possible_start(self, points: Points) -> Mask:
        """Where the start values are consistent, bool (points,). By default: where the state is finite."""
        with np.errstate(all="ignore"):
            return np.asarray(np.isfinite(self.initial_state(points)).all(axis=0))

    def warnings(self, points: Points) -> list[str]:
        """One sentence for each thing that a user should know about the points."""
        return []

    def remarks(self, points: Mapping[str, Any]) -> list[str]:
        """Sentences for users who compare labels with theory; points: some or all parameters by name."""
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
        """All relative equilibria or permanent rotations of one body; by default an extension computes them, else BadInput.

        Parameters
        ----------
        body : mapping of str to float
            Parameters of the body; missing ones take their defaults.

        Returns
        -------
        mapping of str to array
            Arrays over the equilibria.
        """
        missing = extension.not_loaded()
        raise BadInput(f"equilibria: the system {self.name} has no function that computes them{missing}")

    @_or_extension
    def equilibria_of_bodies(
        self, points: Points, pause: Callable[[], None] = lambda: None, **options: Any
    ) -> Mapping[str, NDArray[Any]]:
        """All relative equilibria or permanent rotations of many bodies, as `equilibria`.

        Parameters
        ----------
        points : mapping of str to array (bodies,)
            Every parameter.
        pause : callable
            Called at least once a second; it raises an exception where the computation was interrupted.
        **options
            Options of the extension that computes them.

        Returns
        -------
        mapping of str to array (bodies, places)
            Unused places, at the end of each row, have the Morse index -1. `completeness`, int8 (bodies,), has values of
            flags.Completeness.
        """
        if type(self).equilibria is System.equilibria:
            self.equilibria({})
        raise BadInput(
            f"body: arrays given; the system {self.name} has equilibria of one body at a time only"
        )

    def identify_family(self, points: Points) -> tuple[Flags, Array]:
        """Family of the steady motion that starts at each point.

        Returns
        -------
        flag : int8 array (points,)
            Flag of the first family whose largest condition residual is at most FAMILY_TOLERANCE; 0: none.
        residual : array (points,)
            Largest condition residual of that family, dimensionless; without a family the least over all families (inf
            if there are none).
        """
        others = other_families(self)
        return identify(points, [each for each in families_of(self).values() if each not in others], others)

    def linear_stability(self, points: Points, flags: Flags) -> tuple[Flags, Array]:
        """Linear stability of the steady motions.

        A motion is stable where every characteristic exponent is imaginary and simple, or the energy has a minimum; unstable
        where one has a positive real part. Zero exponents that come from a symmetry or a conserved momentum are ignored. If
        other exponents are zero or equal up to rounding, distances may grow like a power of time: then the stability is unknown and
        the growth rate 0. The default uses the formulas of families.

        Parameters
        ----------
        flags : int8 array (points,)
            Flags of families, from `identify_family`.

        Returns
        -------
        stable : int8 array (points,)
            Values of flags.Stability.
        growth_rate : array (points,)
            Largest real part of the characteristic exponents, rad per time unit; nan where unknown.
        """
        stable, growth = np.full(flags.shape, Stability.UNKNOWN, np.int8), np.full(flags.shape, np.nan)
        for family in families_of(self).values():
            members = np.flatnonzero(flags == family.flag)
            if members.size and family.stability is not None:
                stable[members], growth[members] = family.stability(subset(points, members))
        return stable, growth

    def stress_cases(self) -> Sequence[StressCase]:
        """Stiff and extreme points for the command `atlas stress`."""
        return ()


def possible_body(system: System, points: Points) -> Mask:
    """Where a rigid body can have the moments of inertia, (points,); elsewhere nothing is computed.

    No principal moment exceeds the sum of the two others; equality is a flat body. True where a moment is nan.
    """
    possible = np.ones(shape_of(points), bool)
    for total, largest, _ in _triangle(system, points):
        possible &= ~(total < largest * (1 - 1e-12))
    return possible


def check_possible(system: System, points: Points) -> None:
    """Raise BadInput with one line unless body and start are possible at some point."""
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
    """Yield, for each moment of inertia, the sum of the other two, the moment, and the three names in this order."""
    if system.moments_of_inertia is None:
        return
    a, b, c = system.moments_of_inertia
    for names in ((a, b, c), (b, c, a), (c, a, b)):
        with np.errstate(over="ignore"):
            yield points[names[0]] + points[names[1]], points[names[2]], names


def within_range(system: System, points: Points) -> Mask:
    """Where formulas of theory cannot overflow, (points,); elsewhere theory predicts nothing.

    Magnitudes are at most MAX_MAGNITUDE, and positive parameters at least its inverse.
    """
    positive = [name for name, p in system.parameters.items() if p.open_low and p.low == 0]
    too_large = [np.abs(values) > MAX_MAGNITUDE for values in points.values()]
    too_small = [points[name] < 1 / MAX_MAGNITUDE for name in positive]
    return ~np.any([*too_large, *too_small], axis=0)


@cache
def families_of(system: System) -> Mapping[str, Family]:
    """Families by name, of the system, then of extensions; extensions of this package have reserved flags and titles."""
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
    """Extensions that define one of these variables, or a family of the system, because any start may be on such a family."""
    families = families_of(system).keys() - system.families.keys()
    return extension.used([name for name in variables if name not in system.derived], families)


def stress_cases_of(system: System) -> list[StressCase]:
    """Stress cases of a system, then of extensions."""
    of_extensions = extension.of_each("stress_cases", system.name)
    return [*system.stress_cases(), *(case for cases in of_extensions for case in cases(system))]


def other_families(system: System) -> list[Family]:
    """Families of motions about other axes than the third and the vertical, or at a varying rate, also of extensions."""
    return [family for family in families_of(system).values() if family.axes or family.rate_std]


def identify(
    points: Points, families: Collection[Family], others: Collection[Family] = ()
) -> tuple[Flags, Array]:
    """Flag and residual of the first family that each point belongs to, see System.identify_family.

    Families are tested in order. `others` come last and do not count in the least residual; their conditions are computed
    one by one, at the usually few points that satisfy the earlier ones.
    """
    shape = shape_of(points)
    flags, residual = np.zeros(shape, np.int8), np.full(shape, np.inf)
    flat = {name: np.ravel(value) for name, value in points.items()}
    for first in range(0, flags.size, _CHUNK):
        chunk = slice(first, first + _CHUNK)
        whole = len(shape) == 1 and flags.size <= _CHUNK and isinstance(points, SharedValues)
        part = points if whole else SharedValues(subset(flat, chunk))
        flag, least = flags.reshape(-1)[chunk], residual.reshape(-1)[chunk]  # views
        computed: dict[Condition, Array] = {}  # families share conditions
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
    """Write flag and residual of points on this family whose flag is still 0."""
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
    """Magnitude of the residual of a condition, inf where it is nan."""
    value = np.abs(condition.residual(points))
    return np.where(np.isnan(value), np.inf, value)


def time_units(system: System, units: str) -> str:
    """Units of a time or rate in a system; "1" if all its parameters and observables are pure numbers."""
    own = {parameter.unit for parameter in system.parameters.values()}
    own |= {observable.unit for observable in system.observables}
    return "1" if system.observables and own == {"1"} and units in ("s", "s-1") else units


@cache
def derived_variables(system: System) -> Mapping[str, DerivedVariable]:
    """Quantities from theory that a scene may list, by name: of the system, then of extensions; BadInput for a name given twice."""
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
    """Values of derived variables by name, at points before any nudge; shared results are computed once."""
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
    """Points with stored values of functions that several conditions share, such as units of residuals."""

    def __init__(self, points: Points):
        super().__init__(points)
        self._values: dict[Callable[[Points], Any], Any] = getattr(points, "_values", {})

    def of(self, function: Callable[[Points], _T]) -> _T:
        """Value of a function of the points, computed once; its arrays are read-only."""
        if function not in self._values:
            value: Any = function(self)
            views = [np.asarray(array).view() for array in (value if isinstance(value, tuple) else (value,))]
            for view in views:
                view.setflags(write=False)
            self._values[function] = tuple(views) if isinstance(value, tuple) else views[0]
        return self._values[function]


def shared(function: _F) -> _F:
    """Decorator: a function of points, or of a system and points, is evaluated once for each SharedValues."""

    @wraps(function)
    def of(*arguments: Any) -> Any:
        *system, points = arguments
        if not isinstance(points, SharedValues):
            return function(*arguments)
        return points.of(MethodType(function, *system) if system else function)

    return of  # type: ignore[return-value]


def subset(columns: Mapping[str, Array], where: Any) -> dict[str, Array]:
    """Columns at some of the points, given by a mask, indices or a slice."""
    return {name: values[where] for name, values in columns.items()}


def shape_of(points: Points) -> tuple[int, ...]:
    return np.shape(next(iter(points.values())))


def unsteady(system: System, flags: Flags) -> Mask:
    """Where a family's motions turn about the vertical at a varying rate, (points,)."""
    return np.isin(flags, [each.flag for each in families_of(system).values() if each.rate_std])


def rate_std(system: System, points: Points, flags: Flags, duration: Array) -> Array:
    """Standard deviation, over each run, of the rate about the vertical, rad per time unit, (points,); 0 for steady motions."""
    result = np.zeros(flags.shape)
    for family in families_of(system).values():
        if family.rate_std and (members := np.flatnonzero(flags == family.flag)).size:
            result[members] = family.rate_std(subset(points, members), duration[members])
    return result


def rough_stability(system: System, points: Points, flags: Flags) -> tuple[Flags, Array]:
    """System.linear_stability, with fewer digits of the growth rate for families that have `rough_stability`."""
    rough = {f.flag: f.rough_stability for f in families_of(system).values() if f.rough_stability}
    stable, growth = system.linear_stability(points, np.where(np.isin(flags, list(rough)), 0, flags))
    for flag, decide in rough.items():
        if (members := np.flatnonzero(flags == flag)).size:
            stable[members], growth[members] = decide(subset(points, members))
    return stable, growth


def on_family(family: Family, points: Points) -> Array:
    """Largest condition residual (dimensionless) of a family at each point; inf where a residual is undefined."""
    return np.max([_magnitude(condition, points) for condition in family.conditions], axis=0)


def motion_about_axes(axes: TwoAxes, vector: Array, t: Array) -> tuple[Array, Array]:
    """Angular velocity relative to the frame, and a vector at rest in the frame, in body axes at times t.

    The body turns by m t about its own axis, then by n t about the axis at rest in the frame.
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
