"""The linear theory of stability against the closed forms of single families."""

import numpy as np
import pytest
from closed_forms import ROWS, stability
from strategies import default_points

from atlas.flags import Stability
from atlas.systems.fixed_point import FIXED_POINT


@pytest.mark.parametrize("kind", ROWS)
def test_rounding_of_the_body_changes_nothing(kind):
    system, name, draw, _ = ROWS[kind]
    rng = np.random.default_rng(16)
    points = draw(rng, 40)
    flags = np.full(points["A"].size, system.families[name].flag)
    rounding = 4e-16 * rng.choice([-1.0, 0.0, 1.0], (6, points["A"].size))
    rotor = [f"{system.axial_rotor[0]}{i}" for i in (1, 2, 3)]
    moved = points | {each: points[each] * (1 + rounding[i]) for i, each in enumerate("ABC")}
    moved |= {each: points[each] + rounding[i] for i, each in enumerate(rotor, 3)}
    (stable, growth), (expected, rate) = (system.linear_stability(p, flags) for p in (moved, points))
    np.testing.assert_array_equal(stable, expected)
    np.testing.assert_allclose(growth, rate, atol=1e-7)


@pytest.mark.usual(
    "spherical",
    "conical",
    "conical, slow",
    "conical, fast",
    "sleeping",
    "staude",
    "rest",
    "rest, free",
    "free_rotation",
    "free_precession",
    "top, other_axis",
    "spherical_any_axis",
)
@pytest.mark.parametrize("kind", ROWS)
def test_stability_is_that_of_the_closed_form(kind):
    system, name, draw, form = ROWS[kind]
    points = draw(np.random.default_rng(15), 1000)
    stable, growth = system.linear_stability(points, np.full(points["A"].size, system.families[name].flag))
    unstable, expected = stability(*form(points))
    np.testing.assert_array_equal(stable, np.where(unstable, Stability.UNSTABLE, Stability.STABLE))
    difference = growth**2 - np.where(unstable, expected, 0.0) ** 2
    assert (np.abs(difference) < 1e-12 * system.frequency_bound(points) ** 2).all()
    assert stable.size > 300


def test_equal_exponents_have_all_digits():
    """A symmetric body at rest upside down falls alike in every direction."""
    points = default_points("fixed_point", A=1.0, B=1.0, C=1.3, Mg=1.0, z0=0.5, theta0=np.pi)
    assert FIXED_POINT.stability(points)[1] == pytest.approx(np.sqrt(0.5), rel=1e-14)
