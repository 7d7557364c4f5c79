"""The shape of a system: what the engine, the labels and the scenes may ask of its physics."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence, Set
from dataclasses import dataclass, field
from types import ModuleType

import numpy as np
from numpy.typing import NDArray

from ..errors import BadInput

Array = NDArray[np.float64]
Flags = NDArray[np.int8]
Mask = NDArray[np.bool_]
# Every parameter of a system by name, as float64 arrays of one common shape.
Points = Mapping[str, Array]


@dataclass(frozen=True)
class Parameter:
    """One physical parameter or start value; the table in the docs is printed from these."""

    name: str
    unit: str  # SI, UDUNITS spelling; "1" for pure numbers
    meaning: str
    default: float = 0.0  # nan: optional, absent unless given
    low: float = -np.inf
    high: float = np.inf
    open_low: bool = False  # True: the value must lie strictly above low
    start: bool = False  # True: a start value, False: the body, its rotor or the fields
    symbol: str = ""  # mathematical form for axis labels, e.g. r"$\theta_0$"


@dataclass(frozen=True)
class Condition:
    """One equation or inequality that a family of steady motions needs.

    residual(points) is dimensionless, zero where the condition holds, and says by how much it fails
    elsewhere (an inequality returns the amount of its violation); shape and dtype of the points.
    """

    text: str
    residual: Callable[[Points], Array]


@dataclass(frozen=True)
class Family:
    """A family of exact steady motions theta = theta0, psi' = n, phi' = m.

    solve maps a parameter to the formula that puts a point on the family, in the order in which
    the formulas may be used together; a formula gives nan where the family does not exist.
    stability(points) -> (stable, growth_rate): 0 unknown, 1 stable, 2 unstable (linear), and the
    largest real part of the characteristic exponents in rad per time unit (nan where unknown).
    """

    name: str
    flag: int  # value of the dataset variable `family`; 0 means none
    title: str
    equations: str  # numbers in the paper, or where it was derived
    conditions: tuple[Condition, ...]
    solve: Mapping[str, Callable[[Points], Array]] = field(default_factory=dict)
    stability: Callable[[Points], tuple[Flags, Array]] | None = None
    # closed form of the motion: (points, t) -> state of the equations, shape (state, *t.shape, *points.shape)
    motion: Callable[[Points, Array], Array] | None = None
    geometry: str = ""  # flag of the variable `geometry`; empty where it depends on the point
    labels: str = ""  # what the motion is called, by its kinematics, in the frame and in space
    paper_wording: str = ""
    exists: str = ""  # limits of existence beyond the conditions
    free: tuple[str, ...] = ()  # parameters that the conditions leave free


@dataclass(frozen=True)
class PublishedEquation:
    """One printed equation or claim of the system's paper, as printed and as true.

    residual_printed and residual_true measure the two readings at random parameters; `measure` says
    what the number is. Near 0 is true of a reading; None where there is nothing to measure.
    """

    number: str
    family: str  # name of the family that it is about; "" for the equations of motion and other formulas
    printed: str
    true: str
    verdict: str  # true, misprint, false, incomplete, or "true at ..., false at ..."
    measure: str = ""
    residual_printed: Callable[[np.random.Generator], float] | None = None
    residual_true: Callable[[np.random.Generator], float] | None = None
    effect: str = ""  # what comes of the difference


@dataclass(frozen=True)
class DerivedVariable:
    """A quantity from theory that a scene may ask for as one more variable; computed only then."""

    name: str
    unit: str
    long_name: str
    values: Callable[[Points, Array], Array]  # (points before the nudge, duration) -> (points,)
    comment: str = ""
    check: Callable[[Points], object] = lambda points: None  # raises BadInput where it has no meaning


@dataclass(frozen=True, eq=False)
class System:
    """One system of the mission: equations for the kernels, start, theory and names."""

    name: str
    title: str
    frame: str  # the frame in which psi' and theta' are measured: "orbital" or "space"
    reference: str  # citation of the paper
    doi: str
    equations: ModuleType  # STATE, CONSTANTS, ONES, INTEGRALS and plain scalar functions for the kernels
    parameters: Mapping[str, Parameter]
    constants: Callable[[Points], Array]  # (constants, points), what the kernels read
    initial_state: Callable[[Points], Array]  # (state, points)
    check: Callable[[Points], None]  # raises BadInput on what no body can be
    # by integral: nan where it is not conserved, else a floor for the sum of its terms' magnitudes
    integral_scales: Callable[[Points], Mapping[str, Array]]
    frequency_bound: Callable[[Points], Array]  # rad per time unit, never below the fastest frequency
    # (sin theta, n, m) of the steady motion a start would belong to, nan where it has none
    steady_rates: Callable[[Points], tuple[Array, Array, Array]]
    families: Mapping[str, Family]
    # (points) -> (flag of the first family whose conditions hold or 0, residual)
    identify_family: Callable[[Points], tuple[Flags, Array]]
    condition_residual: Callable[[Points], Array]
    # (points, family flags) -> (stable, growth_rate) of the steady motions, for every family at once
    linear_stability: Callable[[Points, Flags], tuple[Flags, Array]]
    geometries: Mapping[str, str]  # flag name -> sentence, in the order of the flag values
    # (measured, steady, cylinder, rate_tolerance, angle_tolerance) -> flags of geometries
    geometry: Callable[..., Flags]
    # rate of the frame's vertical in inertial space, added to n for label_inertial; None: same frame
    frame_rate: Callable[[Points], Array] | None = None
    # bool: where the families are all there is, so that a start off them is predicted to drift
    complete: Callable[[Points], Mask] = lambda points: np.zeros(points["n"].shape, bool)
    warnings: Callable[[Points], list[str]] = lambda points: []
    # the same starts given by theta0 .. m, where optional start values give them; what angles are nudged from
    as_euler_angles: Callable[[Points], Points] = lambda points: points
    derived: Mapping[str, DerivedVariable] = field(default_factory=dict)
    # (parameters that are 0 or absent in a whole scene, A = B throughout) -> (kernel constants that are
    # then 0, pairs of constants of which the first equals the second); few different answers, for each
    # is a kernel of its own
    specialization: Callable[[Set[str], bool], tuple[Set[str], Set[tuple[str, str]]]] = (
        lambda zero, symmetric: (
            set(),
            set(),
        )
    )
    # the paper's equations; called when a table is asked for
    published: Callable[[], Sequence[PublishedEquation]] = tuple
    # (parameter -> number) -> arrays over the relative equilibria or permanent rotations of one body
    equilibria: Callable[[Mapping[str, float]], Mapping[str, NDArray]] | None = None


def stability_by_family(families: Mapping[str, Family], points: Points, flags: Flags) -> tuple[Flags, Array]:
    """Linear stability from each family's own formulas: unknown (0, nan) off them and where they are silent."""
    stable, growth = np.zeros(flags.shape, np.int8), np.full(flags.shape, np.nan)
    for family in families.values():
        on = np.flatnonzero(flags == family.flag)
        if on.size and family.stability is not None:
            stable[on], growth[on] = family.stability({name: values[on] for name, values in points.items()})
    return stable, growth


def on_family(family: Family, points: Points) -> Array:
    """Largest condition residual of the family at each point: 0 on it, nan -> inf (no such motion)."""
    worst = np.zeros(np.shape(next(iter(points.values()))))
    for condition in family.conditions:
        residual = np.abs(condition.residual(points))
        worst = np.maximum(worst, np.where(np.isnan(residual), np.inf, residual))
    return worst


def check_inertia(points: Points) -> None:
    """Triangle inequality of the principal moments; equality is a flat body.

    Raises BadInput where no rigid body has the moments.
    """
    for one, two, three in (("A", "B", "C"), ("B", "C", "A"), ("C", "A", "B")):
        total, other = points[one] + points[two], points[three]
        bad = np.flatnonzero(~(total >= other * (1 - 1e-12)))
        if bad.size:
            i = bad[0]
            raise BadInput(
                f"{one} + {two} = {total[i]:g} is less than {three} = {other[i]:g}"
                f" ({bad.size} of {total.size} points): no rigid body has these moments of inertia"
            )
