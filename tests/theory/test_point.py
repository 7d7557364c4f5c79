"""Vectors as tuples, and larger and smaller numbers where some are nan: against NumPy."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from atlas.theory import point

A, B = (1.5, -2.0, 0.7), (0.3, 4.0, -1.1)
NAN = float("nan")


@pytest.mark.parametrize(
    ("name", "arguments", "expected"),
    [
        ("dot", (A, B), np.dot(A, B)),
        ("cross", (A, B), np.cross(A, B)),
        ("times", (A, B), np.multiply(A, B)),
        ("divided", (A, 4.0), np.divide(A, 4.0)),
        ("plus", (A, B), np.add(A, B)),
        ("minus", (A, B), np.subtract(A, B)),
        ("scaled", (3.0, A), np.multiply(3.0, A)),
        ("magnitude", (A,), np.abs(A)),
        ("length", (A,), np.linalg.norm(A)),
        ("unit", (A, B), A / np.linalg.norm(A)),
        ("unit", ((0.0, 0.0, 0.0), B), B),
        ("over", (3.0, 4.0), 0.75),
        ("over", (3.0, 0.0), 0.0),
        ("greatest", (A,), 1.5),
        ("smallest", (A,), -2.0),
        ("greatest", (B[::-1],), 4.0),
        ("smallest", ((2.0, 3.0, 1.0),), 1.0),
    ],
)
def test_against_numpy(name, arguments, expected):
    np.testing.assert_allclose(getattr(point, name)(*arguments), expected, rtol=1e-15)


def test_sum_of_the_terms_of_a_vector_product():
    terms = [
        [abs(A[j] * B[k]) for j, k in pairs]
        for pairs in (((1, 2), (2, 1)), ((2, 0), (0, 2)), ((0, 1), (1, 0)))
    ]
    np.testing.assert_allclose(point.cross_sum(point.magnitude(A), point.magnitude(B)), np.sum(terms, 1))


@pytest.mark.parametrize("angle", [0.4, -2.1, np.pi])
def test_a_turn_about_a_unit_vector(angle):
    axis = np.array(B) / np.linalg.norm(B)
    turned = point.rotate(A, tuple(axis), np.cos(angle), np.sin(angle))
    np.testing.assert_allclose(turned, Rotation.from_rotvec(angle * axis).apply(A), rtol=1e-13)


@pytest.mark.parametrize(
    ("name", "reference"),
    [("larger", np.maximum), ("smaller", np.minimum), ("fmax", np.fmax), ("fmin", np.fmin)],
)
def test_larger_and_smaller_numbers(name, reference):
    for a, b in ((1.0, 2.0), (2.0, 1.0), (-1.0, -1.0), (NAN, 2.0), (2.0, NAN), (NAN, NAN)):
        np.testing.assert_equal(getattr(point, name)(a, b), reference(a, b))
    for name_of_three, reference_of_three in (("greatest", np.max), ("smallest", np.min)):
        for place in range(3):
            three = tuple(NAN if i == place else 1.0 for i in range(3))
            assert np.isnan(getattr(point, name_of_three)(three))
            three = tuple(7.0 if i == place else 9.0 - i for i in range(3))
            assert getattr(point, name_of_three)(three) == reference_of_three(three)
