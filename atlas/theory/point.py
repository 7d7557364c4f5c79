"""A start and a steady motion as tuples of numbers. Vectors are tuples of three numbers."""

from __future__ import annotations

from typing import Any, NamedTuple, TypeAlias

import numpy as np

Vector: TypeAlias = tuple[float, float, float]  # components in body axes
Value: TypeAlias = Any  # a number for one start, or an array (points,) for many

THIRD = (0.0, 0.0, 1.0)  # the third axis


class Motion(NamedTuple):
    """A motion u = n nu + m s about the axis s at rest in the body and the axis nu at rest in the frame."""

    s: Vector  # unit vector of the axis at rest in the body
    m: float  # rate about the axis at rest in the body, rad per time unit
    nu: Vector  # value at the start of the unit vector of the axis at rest in the frame
    n: float  # rate about the axis at rest in the frame, rad per time unit


class Body(NamedTuple):
    """A body at the start of a run."""

    w: Vector  # angular velocity
    vectors: tuple[Vector, ...]  # vectors at rest in the frame
    constants: tuple[float, ...]  # constants of the equations
    rates: Vector  # sin theta, n, m of System.steady_rates
    bound: float  # upper bound of frequencies, rad per time unit
    square: float  # squared unit of rates
    in_range: bool  # whether no formula of theory overflows


class Start(NamedTuple):
    """A state, and quantities that follow from this state by the equations."""

    w: Vector  # angular velocity
    vectors: tuple[Vector, ...]  # vectors at rest in the frame
    slip: float  # sum over the vectors v of |v' - v x u|, with u below; 0 if all v are at rest in the frame
    u: Vector  # angular velocity relative to the frame
    frame: Vector  # angular velocity of the frame, which is the field w minus the field u
    slope: Vector  # derivative of the angular velocity w
    acceleration: Vector  # derivative of the relative angular velocity u
    vertical: Vector  # vertical of the frame


class SteadyTest(NamedTuple):
    """Test of a start by the equations. Unless a comment says otherwise, a field describes the start before a nudge of start values."""

    answer: Value  # value of Existence
    elsewhere: Value  # whether the start is a steady motion about other axes than the third and the vertical
    may_be_member: Value  # whether the start may be on a family
    kept: Value  # whether the nudged start is a steady motion as exactly as rounding allows
    pushed: Value  # whether the nudge of start values moved the start off the motions about the third axis and the vertical
    residual: Value  # residual of a steady motion about the third axis and the vertical, at the nudged start
    change: Value  # largest change of the rates of a steady motion by the nudge, in tolerances
    away: Value  # departure of the nudged start from a steady motion, in tolerances


class Membership(NamedTuple):
    """Test of a start by the families. A nudge is an amount that the scene adds to start values."""

    varies: Value  # whether the motion turns about the vertical at a varying rate
    elsewhere: Value  # whether the motion is about other axes than the third and the vertical
    residual: Value  # residual of the family's conditions before the nudge, inf without a family
    nudged_residual: Value  # residual of the family's conditions after the nudge
    stable: Value  # value of Stability
    growth: Value  # logarithm of the factor by which a distance from the motion grows during the run; nan if unknown


class StartLabels(NamedTuple):
    """Prediction of theory for a start."""

    label: Value  # value of Label, in the system's frame
    inertial: Value  # value of Label, in inertial space
    answer: Value  # value of Existence
    growth: Value  # logarithm of the factor by which a distance grows; 0 if unknown or irrelevant


def dot(a, b):
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def cross(a, b):
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]


def cross_sum(a, b):
    """Return the vector product with + in place of -. If `a` and `b` hold magnitudes, the result bounds the vector product."""
    return a[1] * b[2] + a[2] * b[1], a[2] * b[0] + a[0] * b[2], a[0] * b[1] + a[1] * b[0]


def times(a, b):
    """Return the products of the components."""
    return a[0] * b[0], a[1] * b[1], a[2] * b[2]


def divided(a, k):
    return a[0] / k, a[1] / k, a[2] / k


def plus(a, b):
    return a[0] + b[0], a[1] + b[1], a[2] + b[2]


def minus(a, b):
    return a[0] - b[0], a[1] - b[1], a[2] - b[2]


def scaled(k, a):
    return k * a[0], k * a[1], k * a[2]


def magnitude(a):
    return abs(a[0]), abs(a[1]), abs(a[2])


def length(a):
    return np.sqrt(a[0] * a[0] + a[1] * a[1] + a[2] * a[2])


def unit(a, otherwise):
    """Return a vector divided by its length, or `otherwise` if the length is 0."""
    size = length(a)
    return otherwise if size == 0.0 else divided(a, size)


def rotate(a, axis, cosine, sine):
    """Return a vector turned about the unit vector `axis`, by Rodrigues' formula."""
    along, across = dot(axis, a) * (1 - cosine), cross(axis, a)
    return (
        cosine * a[0] + sine * across[0] + along * axis[0],
        cosine * a[1] + sine * across[1] + along * axis[1],
        cosine * a[2] + sine * across[2] + along * axis[2],
    )


def over(value, scale):
    """Return value / scale, or 0 if the scale is 0."""
    return 0.0 if scale == 0 else value / scale


def larger(a, b):
    """Return the larger number, or nan if a number is nan."""
    return a if a != a or a > b else b


def smaller(a, b):
    """Return the smaller number, or nan if a number is nan."""
    return a if a != a or a < b else b


def greatest(a):
    """Return the largest component, or nan if a component is nan."""
    return larger(a[0], larger(a[1], a[2]))


def smallest(a):
    """Return the smallest component, or nan if a component is nan."""
    return smaller(a[0], smaller(a[1], a[2]))


def fmax(a, b):
    """Return the larger number. If only one number is nan, return the other number."""
    if a != a:
        return b
    return b if b > a else a


def fmin(a, b):
    """Return the smaller number. If only one number is nan, return the other number."""
    if a != a:
        return b
    return b if b < a else a
