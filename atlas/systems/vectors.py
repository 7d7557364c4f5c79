"""Compute products, lengths and quotients of arrays over points. Vectors have the shape (3, points)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


def dot(a: Array, b: Array) -> Array:
    """Return the scalar product, (points,)."""
    return (a * b).sum(0)


def cross(a: Array, b: Array) -> Array:
    """Return the vector product, (3, points)."""
    return np.array([a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]])


def length(vector: Array) -> Array:
    """Return the Euclidean length over the first axis."""
    return np.sqrt((vector**2).sum(0))


def unit(vector: Array, otherwise: Array | float = np.nan) -> Array:
    """Return a vector divided by its length, or `otherwise` where the length is 0."""
    return ratio(vector, length(vector), otherwise)


def across(vector: Array, axis: Array) -> Array:
    """Return the part of a vector that is normal to the unit vector `axis`."""
    return vector - dot(vector, axis) * axis


def turned(vector: Array, axis: Array, angle: Array) -> Array:
    """Return a vector turned by `angle` about the unit vector `axis`, by Rodrigues' formula."""
    cosine, sine = np.cos(angle), np.sin(angle)
    along = dot(axis, vector) * (1 - cosine)
    return cosine * vector + sine * cross(axis, vector) + along * axis


def ratio(value: Array, scale: Array, where_zero: Array | float = 0.0) -> Array:
    """Return value / scale, or `where_zero` where the scale is 0."""
    return np.where(scale == 0, where_zero, value / np.where(scale == 0, 1.0, scale))


def principal(index: NDArray[np.intp]) -> Array:
    """Return unit vectors (3, points) along the principal axes whose indices, 0 to 2, are in `index`."""
    return (np.arange(3).reshape(3, *(1,) * index.ndim) == index).astype(np.float64)
