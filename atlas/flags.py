"""Names, numbers and meanings of the values of flag variables."""

from __future__ import annotations

from enum import IntEnum


class Flag(IntEnum):
    """Value of a flag variable, with a sentence that explains the value. Files use the value's name in lower case."""

    sentence: str

    def __new__(cls, value: int, sentence: str) -> Flag:
        flag = int.__new__(cls, value)
        flag._value_ = value
        flag.sentence = sentence
        return flag

    @classmethod
    def meanings(cls) -> dict[str, str]:
        """Return the sentence of every flag by name, in the order of the values 0, 1, 2, ..."""
        return {flag.name.lower(): flag.sentence for flag in cls}


class Label(Flag):
    """Kind of motion."""

    NOT_COMPUTED = 0, "not computed"
    REGULAR_PRECESSION = 1, "theta, psi' and phi' are constant, psi' and phi' are not zero"
    PERMANENT_ROTATION = 2, "theta, psi' and phi' are constant and psi' or phi' is zero, or the third axis stays on the vertical"  # fmt: skip
    DRIFTING = 3, "theta, psi' or phi' varies"
    UNRESOLVED = 4, "not decided: see status"


# Variables with values of `Label`. Two are for the third axis and two for any axis, in the system's frame and in inertial space.
LABELS = ("label", "label_inertial", "label_any_axis", "label_any_axis_inertial")


class Steadiness(Flag):
    """Kind of motion of a system with observables. The numbers agree with `Label`."""

    NOT_COMPUTED = 0, "not computed"
    STEADY = 1, "no observable varies: all standard deviations are within their tolerances"
    UNUSED = 2, "no such motion of this system"
    DRIFTING = 3, "an observable varies"
    UNRESOLVED = 4, "not decided: see status"


class Status(Flag):
    """How far a label can be trusted."""

    NOT_COMPUTED = 0, "not computed: no motion of the family, no start or no duration is defined here"  # fmt: skip
    OK = 1, "integrated and resolved"
    NOT_FINITE = 2, "the state or a statistic overflowed or became NaN"
    DRIFT_EXCEEDED = 3, "a first integral changed by more than drift_tolerance"
    UNDER_RESOLVED = 4, "the step is too long for the fastest frequency of the point"
    STEP_SENSITIVE = (
        5,
        "the label changes when the step is halved, or could by as much as the measurements did, or another step changes a statistic more than errors explain",
    )
    ROUNDOFF_DECIDED = 6, "rounding errors decide: the start is exactly on an unstable motion, or what varies may be rounding alone"  # fmt: skip
    IMPOSSIBLE_BODY = 7, "not computed: no rigid body has these moments of inertia, one is larger than the sum of the others"  # fmt: skip


class Agreement(Flag):
    """Result of comparing the measured label with theory."""

    NOT_COMPARED = 0, "nothing to compare: unresolved, or theory makes no prediction"
    AGREE = 1, "measured label and theory agree"
    THEORY_ONLY = 2, "steady by theory, drifting as measured"
    NUMERICS_ONLY = 3, "drifting by theory, steady as measured"
    DIFFER = 4, "both steady, with different labels"


class Stability(Flag):
    """Linear stability of a steady motion."""

    UNKNOWN = 0, "linear stability unknown, or no steady motion"
    STABLE = 1, "no characteristic exponent has a positive real part"
    UNSTABLE = 2, "some characteristic exponent has a positive real part"


class EnergyStability(Flag):
    """Whether the energy of a steady motion is a minimum for given values of the quantities that internal dissipation conserves."""

    UNKNOWN = 0, "not known, or the second variation is degenerate"
    YES = 1, "a minimum of the energy on the level of what internal dissipation keeps: stable, also with it"
    NO = 2, "no such minimum: unstable, or stable by gyroscopic terms or a momentum that internal dissipation destroys"  # fmt: skip


class StabilityKind(Flag):
    """Combination of linear stability and stability by the energy."""

    UNKNOWN = 0, "linear stability unknown, or no steady motion"
    ENERGY_STABLE = 1, "stable by the energy: small dissipation inside the body leaves it stable"
    GYROSCOPIC = 2, "linearly stable and no minimum of the energy: dissipation destroys the stability"
    MARGINAL = 3, "no exponent grows, but exponents coincide or the energy is degenerate: may grow like a power of time"  # fmt: skip
    LINEARLY_STABLE = 4, "linearly stable; stability by the energy is not known"
    UNSTABLE = 5, "some characteristic exponent has a positive real part"
    ENERGY_STABLE_AXIAL = 6, "stable by the energy as long as the axial momentum is kept: internal dissipation changes it"  # fmt: skip


class NonlinearStability(Flag):
    """Stability of a steady motion in the full equations, as far as there is a proof."""

    UNKNOWN = 0, "linear stability unknown, or no steady motion"
    ENERGY = 1, "stable by the energy on the level of every constant momentum, as nothing dissipates"
    ARNOLD_MOSER = 2, "stable by the theorem of Arnold and Moser: two degrees of freedom, D is not 0"
    RESONANCE_STABLE = 3, "at a resonance 2:1 or 3:1, and stable by the criterion of Markeev"
    RESONANCE_UNSTABLE = 4, "at a resonance 2:1 or 3:1, and unstable by the criterion of Markeev"
    DEGENERATE = 5, "resonance 1:1, a zero exponent or D = 0: terms up to degree 4 decide nothing"
    UNDECIDED = 6, "linearly stable, not by the energy, with three degrees of freedom: not decided"
    LINEARLY_UNSTABLE = 7, "some characteristic exponent has a positive real part"


class PeriodicSolution(Flag):
    """Linear stability of a periodic solution, decided by the two multipliers rho and 1/rho that are not 1."""

    NOT_REACHED = 0, "no periodic solution is reached from eps = 0"
    STABLE = 1, "rho is on the unit circle"
    UNSTABLE = 2, "rho is real, and one multiplier is larger than 1 in magnitude"
    MARGINAL = 3, "rho is 1 or -1 to rounding errors"


class FamilyEnd(Flag):
    """How a family of periodic motions ends."""

    UNBOUNDED = 0, "rates grow without bound"
    STEADY_MOTION = 1, "at another steady motion, with one of its frequencies"
    ASYMPTOTIC = (
        2,
        "the period grows without bound, at motions that leave a steady motion and come back to it",
    )
    MULTIPLE = 3, "on an orbit of another family that is run through several times"
    MIRROR = 4, "on its mirror image, at an orbit that is its own"
    PERIOD_LIMIT = 5, "not followed further: the period reached its limit"
    STEP_LIMIT = 6, "not followed further: the number of steps reached its limit"
    LOST = 7, "not followed further: no step leads to another orbit; or there is no such family"


class OrbitStability(Flag):
    """Linear stability of a periodic motion against disturbances that do not change the momenta."""

    UNKNOWN = 0, "no such orbit"
    STABLE = 1, "every multiplier is on the unit circle"
    UNSTABLE = 2, "a multiplier is off the unit circle"


class EventsComplete(Flag):
    """Whether the list of events is complete for periods below three times the period with which the family begins."""

    NO = 0, "some may be missing"
    YES = 1, "steps of half the length find no others"


class PeriodicEvent(Flag):
    """What happens at an orbit of a family of periodic motions."""

    NONE = 0, "no event"
    FOLD = 1, "the energy is extreme, and a multiplier is 1"
    PERIOD_FOLD = 2, "the period is extreme"
    DOUBLING = 3, "a multiplier is -1: orbits of twice the period branch off"
    BRANCH = 4, "a multiplier is 1: another family crosses"
    KREIN = 5, "two pairs of multipliers meet"


class Completeness(Flag):
    """Whether the equilibria of a body are all listed."""

    COMPLETE = 0, "every equilibrium is listed, and none is near a bifurcation"
    NEAR_BIFURCATION = 1, "equilibria merge or appear near this body: their number is not certain"
    NOT_ISOLATED = 2, "some equilibria form circles or larger sets, each of which is listed once"
    NOT_LISTED = 3, "none is listed: they form surfaces, merge here, or the numbers of the body differ too much in magnitude"  # fmt: skip
    IMPOSSIBLE_BODY = 4, "no rigid body has these moments of inertia"


class SettledBy(Flag):
    """Evidence for the equilibrium in which a motion ends."""

    NOT = 0, "not settled, or unresolved: see status"
    PROVED = 1, "the energy holds the body in the well of one minimum, in which every motion ends"
    MEASURED = (
        2,
        "attitude and rates are within 1e-3 (rad, and of the frame's or the natural rate) of the equilibrium; a saddle (end_index above 0) may only"
        " be passed",
    )
    UNDECIDED = 3, "an error of the size of the tolerance at the start can change the motion before it settles: no end"  # fmt: skip


class BifurcationKind(Flag):
    """Kinds of points where branches of equilibria meet."""

    UNRESOLVED = 0, "branches end or change their stability between two values, and no single bifurcation explains it"  # fmt: skip
    FOLD = 1, "two branches end in each other"
    PITCHFORK = 2, "a branch changes its stability, and others end at it on one side"
    EXCHANGE = 3, "a branch changes its stability, and no other ends there"


class Regularity(Flag):
    """Whether neighbouring motions separate exponentially."""

    NOT_COMPUTED = 0, "not computed, or unresolved: see status"
    STEADY = 1, "a steady motion whose neighbours stay near it for the run"
    REGULAR = 2, "not steady, mean MEGNO below 2.5: no exponential separation during the run"
    CHAOTIC = 3, "not steady, mean MEGNO above 5: neighbouring motions separate exponentially"
    UNDECIDED = 4, "not steady, mean MEGNO between 2.5 and 5, or growth that one passage of an unstable motion explains"  # fmt: skip
    HYPERBOLIC = 5, "mean MEGNO above 5 of a steady motion, or from a start on an unstable one: not chaotic"


_RESERVED_FAMILIES = {
    "satellite": {
        "plane_libration": "libration in the plane of the orbit, third axis on the normal, asymmetric body with axial rotor",
        "plane_rotation": (
            "rotation in the plane of the orbit at a varying rate, third axis on the normal, asymmetric body with axial rotor"
        ),
    }
}


def owner_of_family(name: str) -> str:
    """Return the system for which the family `name` of an extension is reserved, or an empty text."""
    return next((system for system, families in _RESERVED_FAMILIES.items() if name in families), "")


def reserved_families(system: str) -> dict[str, str]:
    """Return a description of each family that is reserved for extensions of a system, by name, in the order of the families' flags."""
    return _RESERVED_FAMILIES.get(system, {})
