"""Checks of every family of both systems, and of the order in which families are identified."""

import numpy as np
import pytest
from family_starts import STARTS
from scipy.integrate import solve_ivp
from strategies import default_points, in_other_units, random_fixed_points, random_satellites, select
from truth import acceleration_error

from atlas.systems import base
from atlas.systems.base import families_of
from atlas.systems.fixed_point import FIXED_POINT, any_axis
from atlas.systems.fixed_point import equations as fixed_point_equations
from atlas.systems.satellite import SATELLITE
from atlas.systems.satellite import equations as satellite_equations
from atlas.systems.satellite import families as satellite_families
from atlas.theory.motions import condition_residual

# The gyrostat at rest with m = 0 belongs to `rest` before `staude`, with m not 0 after `conical`.
ORDER = {
    SATELLITE: list(families_of(SATELLITE)),
    FIXED_POINT: [
        "sleeping", "rest", "staude", "conical", "rest",
        "grioli", "balanced_field", "free_rotation", "free_precession", "other_axis",
    ],
}  # fmt: skip


# Of points on a family that are on no earlier one: fewer of the satellite's, which overlap.
SHARES = {"spherical_any_axis": 1.0} | dict.fromkeys(STARTS["fixed_point"].keys() & any_axis.FAMILIES, 0.7)
RHS = {SATELLITE: satellite_equations.rhs, FIXED_POINT: fixed_point_equations.rhs}
SYSTEMS = {system.name: system for system in ORDER}
EVERY_FAMILY = pytest.mark.parametrize(
    ("system", "kind"), [(SYSTEMS[name], kind) for name, kinds in STARTS.items() for kind in kinds],
    ids=lambda value: getattr(value, "name", value),
)  # fmt: skip


def starts(system, kind, seed, count):
    """Points on a family, and the family."""
    points = STARTS[system.name][kind](np.random.default_rng(seed), count)
    return points, families_of(system)[kind.partition(",")[0]]


@pytest.mark.usual(
    "satellite-cylindrical",
    "satellite-perp_radius",
    "satellite-other_axis",
    "fixed_point-conical, fast",
    "fixed_point-staude, rotor",
    "fixed_point-grioli",
)
@EVERY_FAMILY
def test_solved_points_are_steady_and_recognised(system, kind):
    points, family = starts(system, kind, 7, 24)
    assert points["A"].size > 10
    flags, distance = system.identify_family(points)
    assert (base.on_family(family, points) < 1e-12).all()
    assert (distance < 1e-10).all()
    assert (flags > 0).all()
    order = ORDER[system]
    earlier = [
        families_of(system)[each].flag
        for each in order[: len(order) - order[::-1].index(kind.partition(",")[0])]
    ]
    assert np.isin(flags, earlier).all()
    assert (flags == family.flag).mean() >= SHARES.get(kind, 1.0 if system is FIXED_POINT else 0.3)
    if system is FIXED_POINT:
        about_third_axis = condition_residual(FIXED_POINT, points)
        if family.flag <= 4:
            assert (about_third_axis < 1e-12).all()
        else:
            assert (about_third_axis[flags == family.flag] > 1e-9).mean() > 0.8
    for i in range(points["A"].size):
        point = select(points, i)
        if system is SATELLITE and kind in satellite_families.FAMILIES:
            assert acceleration_error(point) < 1e-12 * np.abs(system.constants(point)).max() ** 2


@pytest.mark.usual(
    "satellite-cylindrical",
    "satellite-perp_radius",
    "satellite-other_axis",
    "fixed_point-conical, fast",
    "fixed_point-staude, rotor",
    "fixed_point-grioli",
)
@EVERY_FAMILY
def test_closed_forms_are_exact_motions(system, kind):
    """By substitution into the equations at many times, and by integration over 20 radians."""
    points, family = starts(system, kind, 11, 12)
    t, h = np.linspace(0, 2.0, 9), 1e-4
    closed, constants = family.motion(points, t), system.constants(points)
    assert closed.shape == (len(system.initial_state(points)), 9, points["A"].size)
    np.testing.assert_allclose(closed[:, 0], system.initial_state(points), rtol=0, atol=1e-14)
    derivative = (family.motion(points, t + h) - family.motion(points, t - h)) / (2 * h)
    scale = 1 + np.abs(derivative).max()
    rates = np.array(RHS[system](closed, constants[:, None]))
    np.testing.assert_allclose(derivative / scale, rates / scale, atol=3e-5)
    _, growth = system.linear_stability(points, np.full(points["A"].size, family.flag))
    for i in range(3):
        point, first = select(points, i), system.initial_state(select(points, i))[:, 0]
        rate = max(
            *np.abs(first[:3]), *(abs(point[name][0]) for name in ("Omega", "n", "m") if name in point)
        )
        rate = rate or 1.0  # of a body at rest
        times = np.linspace(0, 20 / rate, 9)
        exact = solve_ivp(
            lambda _, y, values: RHS[system](y, values), (0, times[-1]), first, "DOP853", times,
            rtol=1e-12, atol=1e-13, max_step=0.15 / rate, args=(system.constants(point)[:, 0],),
        ).y  # fmt: skip
        # rounding errors of an unstable motion grow at its growth rate
        bound = 1e-10 * rate * (1 + times) * np.exp(1.1 * np.nan_to_num(growth[i]) * times)
        assert (np.abs(family.motion(point, times)[..., 0] - exact).max(0) < bound).all()


@pytest.mark.usual(
    "satellite-cylindrical", "satellite-oblique", "fixed_point-sleeping", "fixed_point-other_axis"
)
@EVERY_FAMILY
def test_stability_does_not_depend_on_the_units(system, kind):
    points, family = starts(system, kind, 3, 10)
    other, time = in_other_units(points)
    flags = np.full(points["A"].size, family.flag)
    # the steps along Grioli's and balanced motions are not those of other units
    accuracy = 1e-7 if kind in ("grioli", "balanced_field") else 1e-12
    for function in (family.stability, system.stability, lambda p: system.linear_stability(p, flags)):
        if function is None:
            continue
        (stable, growth), (expected, expected_growth) = (function(p) for p in (other, points))
        np.testing.assert_array_equal(stable, expected)
        if system is FIXED_POINT and family.flag <= 4:
            np.testing.assert_array_equal(growth, expected_growth / time)
        np.testing.assert_allclose(growth, expected_growth / time, rtol=accuracy)


@pytest.mark.parametrize("system", ORDER, ids=lambda system: system.name)
def test_residuals_do_not_depend_on_the_units(system):
    draw = {SATELLITE: random_satellites, FIXED_POINT: random_fixed_points}[system]
    points = draw(np.random.default_rng(5), 6)
    if system is SATELLITE:
        points["n"][:2] = -points["Omega"][:2]  # slower than the orbital frame
        points["damping"][:] = 0.3
    other, _ = in_other_units(points)
    for name, family in families_of(system).items():
        conditions = [condition.residual for condition in family.conditions]
        for residual in (*conditions, lambda p, family=family: base.on_family(family, p)):
            with np.errstate(invalid="ignore"):  # no balanced motion where N < 0
                np.testing.assert_array_equal(residual(other), residual(points), err_msg=name)


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
        family = families_of(system)[name]
        with np.errstate(all="ignore"):
            worst = base.on_family(family, points)
        if name == "rest" and place == 1:
            no_spin = next(each for each in system.families["staude"].conditions if each.text == "m = 0")
            worst[np.abs(no_spin.residual(points)) > base.FAMILY_TOLERANCE] = np.inf
        holds = worst <= base.FAMILY_TOLERANCE
        about_third_axis = family.axes is None and family.rate_std is None
        residual = np.where((flags == 0) & (holds | about_third_axis), np.minimum(worst, residual), residual)
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
