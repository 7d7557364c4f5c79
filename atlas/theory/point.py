"""A start and a steady motion as tuples of numbers, and vectors as tuples of three."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

Vector = tuple[float, float, float]  # in body axes

THIRD = (0.0, 0.0, 1.0)  # the third axis


class Motion(NamedTuple):
    """A motion u = n nu + m s about an axis at rest in the body and an axis at rest in the frame."""

    s: Vector  # unit vector of the axis at rest in the body
    m: float  # rate about it, rad per time unit
    nu: Vector  # unit vector of the axis at rest in the frame, at the start
    n: float  # rate about it, rad per time unit


class Start(NamedTuple):
    """A state and what the equations say of it."""

    w: Vector  # angular velocity
    vectors: tuple[Vector, ...]  # at rest in the frame
    slip: float  # by how much the vectors v fail v' = v x u
    u: Vector  # angular velocity relative to the frame
    frame: Vector  # angular velocity of the frame, w - u
    slope: Vector  # w'
    acceleration: Vector  # u'
    vertical: Vector  # of the frame


def dot(a, b):
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def cross(a, b):
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]


def cross_sum(a, b):
    """Sum of the magnitudes of the terms of a vector product, of magnitudes."""
    return a[1] * b[2] + a[2] * b[1], a[2] * b[0] + a[0] * b[2], a[0] * b[1] + a[1] * b[0]


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
    """The vector over its length, another one where that is 0."""
    size = length(a)
    if size == 0.0:
        return otherwise
    return a[0] / size, a[1] / size, a[2] / size


def rotate(a, axis, cosine, sine):
    """A vector after a turn about a unit vector, by Rodrigues' formula."""
    along, across = dot(axis, a) * (1 - cosine), cross(axis, a)
    return (
        cosine * a[0] + sine * across[0] + along * axis[0],
        cosine * a[1] + sine * across[1] + along * axis[1],
        cosine * a[2] + sine * across[2] + along * axis[2],
    )


def fmax(a, b):
    """The larger one, the other where one is nan."""
    if a != a:
        return b
    return b if b > a else a


def fmin(a, b):
    """The smaller one, the other where one is nan."""
    if a != a:
        return b
    return b if b < a else a
