"""Families of starts by `base.identify`, against the conditions of each family by itself."""

import numpy as np
import pytest
from strategies import default_points, select

from atlas.systems import base
from atlas.systems.fixed_point import FIXED_POINT
from atlas.systems.satellite import SATELLITE

# The gyrostat at rest with m = 0 belongs to `rest` before `staude`, with m not 0 after `conical`.
ORDER = {
    SATELLITE: list(SATELLITE.families),
    FIXED_POINT: [
        "sleeping", "rest", "staude", "conical", "rest",
        "grioli", "balanced_field", "free_rotation", "free_precession", "other_axis",
    ],
}  # fmt: skip


def points_on_and_off_families(system, count=3000):
    """Starts of which most parameters are 0 or equal to others, so that many belong to one or several families."""
    rng = np.random.default_rng(6)
    choices = dict.fromkeys("ABC", (1.0, 1.0, 1.3)) | {"Omega": (0.0, 1.0), "damping": (0.0, 0.0, 0.1)}
    choices |= {"theta0": (0.0, np.pi / 2, np.pi / 3, np.pi, 0.7), "phi0": (0.0, np.pi / 2, 0.4)}
    choices |= {"psi0": choices["phi0"], "n": (0.0, 0.0, 1.0, -1.0), "m": (0.0, 0.0, -1.0, 1e-13)}
    optional = [name for name, parameter in system.parameters.items() if np.isnan(parameter.default)]
    drawn = {
        name: rng.choice(choices.get(name, (0.0,) * 9 + (1.0, 0.5, 1e-12)), count)
        for name in system.parameters
        if name not in optional
    }
    return default_points(system.name, count, **drawn)


def expected_families(system, points):
    """Flag and residual of the first family of ORDER whose conditions hold; else the least about the third axis."""
    size = points["A"].size
    flags, residual = np.zeros(size, int), np.full(size, np.inf)
    for place, name in enumerate(ORDER[system]):
        family = system.families[name]
        with np.errstate(all="ignore"):
            worst = base.on_family(family, points)
        if name == "rest" and place == 1:
            no_spin = next(each for each in system.families["staude"].conditions if each.text == "m = 0")
            worst[np.abs(no_spin.residual(points)) > base.FAMILY_TOLERANCE] = np.inf
        holds = worst <= base.FAMILY_TOLERANCE
        residual = np.where(
            (flags == 0) & (holds | (family.axes is None)), np.minimum(worst, residual), residual
        )
        flags[(flags == 0) & holds] = family.flag
    return flags, residual


@pytest.mark.parametrize("system", ORDER, ids=lambda system: system.name)
def test_the_first_family_whose_conditions_hold(system):
    points = points_on_and_off_families(system)
    flags, residual = system.identify_family(points)
    expected, expected_residual = expected_families(system, points)
    assert len(set(expected)) > 6
    np.testing.assert_array_equal(flags, expected)
    np.testing.assert_array_equal(residual, expected_residual)


@pytest.mark.parametrize("system", ORDER, ids=lambda system: system.name)
def test_no_family_depends_on_the_other_points(system, monkeypatch):
    points = points_on_and_off_families(system, 60)
    together = system.identify_family(points)
    monkeypatch.setattr(base, "_CHUNK", 7)
    for values, in_chunks in zip(together, system.identify_family(points), strict=True):
        np.testing.assert_array_equal(values, in_chunks)
    for i in range(60):
        for values, alone in zip(together, system.identify_family(select(points, i)), strict=True):
            assert values[i] == alone[0]


@pytest.mark.parametrize("system", ORDER, ids=lambda system: system.name)
@pytest.mark.parametrize("shape", [(), (0,), (3, 4)])
def test_results_have_the_shape_of_the_points(system, shape):
    points = {name: np.full(shape, parameter.default) for name, parameter in system.parameters.items()}
    flags, residual = system.identify_family(points)
    assert np.shape(flags) == np.shape(residual) == shape
    assert (flags > 0).all()
