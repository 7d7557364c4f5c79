"""Symmetries of the satellite: images, reversed motions and later parts of a motion against each other.

With the moments I, the rotor k, the magnet mu, H = h1 alpha + h3 gamma and w = w' + Omega gamma, all in body axes,

    (I w)' = (I w + k) x w + 3 Omega^2 alpha x (I alpha) + H x mu,   alpha' = alpha x w',   gamma' = gamma x w'.

Let S = diag(+-1, +-1, +-1) have the determinant d, let a = +-1, and let r = -1 reverse the time, r = 1 not. As
S x cross S y = d S (x cross y), a motion becomes another by alpha -> a S alpha, w' -> r d S w' and, so that the orbit
turns the same way, gamma -> r d S gamma, if k -> r d S k, mu -> S mu, h1 -> a h1 and h3 -> r d h3: 32 symmetries.
So w'.gamma and psi' stay, cos(theta) is multiplied by r d S33, theta' by d S33 and phi' by r d S33.
"""

import itertools

import numpy as np
import pytest
from family_starts import satellite_start
from scipy.integrate import solve_ivp
from strategies import SATELLITE_SOLVED, random_satellites, satellite_on_family, select
from truth import assert_at_points, worst_point

import atlas
from atlas.flags import Status
from atlas.systems import SYSTEMS

SYMMETRIES = list(itertools.product(itertools.product((1.0, -1.0), repeat=3), (1.0, -1.0)))
FLAGS = (
    "label",
    "label_inertial",
    "geometry",
    "status",
    "family",
    "stable",
    "predicted",
    "predicted_inertial",
    "agreement",
)
FLAGS += ("label_any_axis", "label_any_axis_inertial", "predicted_any_axis", "predicted_any_axis_inertial")
FLAGS += ("energy_stable", "stability_kind")
MEANS = ("psi_dot_mean", "normal_rate_mean", "phi_dot_mean")
SPREADS = ("theta_dot_rms", "theta_dot_std", "psi_dot_std", "phi_dot_std", "normal_rate_std")
THEORY = ("condition_residual", "growth_rate", "frequency_1", "frequency_2", "frequency_3")
OUTPUTS = (*FLAGS, *MEANS, *SPREADS, *THEORY, "theta_min", "theta_max", "error_estimate")
SATELLITE = SYSTEMS["satellite"]
DURATION = 20.0


def starts(rng, count):
    """Random satellites, and some on and beside each family, without those on the vertical; w, alpha and gamma of each."""
    points = [random_satellites(rng, count)]
    for name in SATELLITE_SOLVED:
        on_family = [point for _ in range(count) if (point := satellite_on_family(name, rng)) is not None]
        points += [*on_family, *(point | {"theta_dot0": np.full(1, 1e-4)} for point in on_family)]
    points = {name: np.concatenate([point[name] for point in points]) for name in points[0]}
    points = select(points, np.abs(np.sin(points["theta0"])) > 1e-9)
    vectors = np.split(SATELLITE.initial_state(points), 3)
    return satellite_start(points, *vectors), vectors


def image(points, vectors, reverses, signs, a):
    """Points that start at the image of w, alpha and gamma, (3, points) each, and the sign of cos(theta)."""
    S, d = np.array(signs)[:, None], np.prod(signs)
    r = -1.0 if reverses else 1.0
    w, alpha, gamma = vectors
    changes = {f"k{i + 1}": r * d * signs[i] for i in range(3)}
    changes |= {f"mu{i + 1}": signs[i] for i in range(3)} | {"h1": a, "h3": r * d}
    changes |= {f"drag{i + 1}": r * a * signs[i] for i in range(3)}
    body = points | {name: points[name] * sign for name, sign in changes.items()}
    return satellite_start(body, r * d * S * w, a * S * alpha, r * d * S * gamma), r * d * signs[2]


def differences(points, other, sign, reverses):
    """Variable -> a point at which it is not that of the image, in words; statistics beside their errors.

    What rounding decides is not compared. At the end of a motion that rounding errors have left another one begins, and
    beside a steady motion theory may say of one instant what it does not say of another.
    """
    options = {"duration": DURATION, "method": "rk8", "variables": OUTPUTS}
    ds, other = (atlas.label_points("satellite", each, **options) for each in (points, other))
    expected = {name: ds[name].values for name in OUTPUTS}
    if sign < 0:
        smallest, largest = expected["theta_min"], expected["theta_max"]
        expected |= {"theta_min": np.pi - largest, "theta_max": np.pi - smallest}
    expected["phi_dot_mean"] = sign * expected["phi_dot_mean"]
    errors = np.fmax(ds["error_estimate"].values, other["error_estimate"].values)
    sure = np.all([each["status"] != Status.ROUNDOFF_DECIDED for each in (ds, other)], axis=0)
    sure &= (errors < 1e-3) | (not reverses)
    assert sure.mean() > 0.7
    wrong = {}
    for name in FLAGS + THEORY:
        unlike = sure & ~np.isclose(other[name], expected[name], equal_nan=True)
        if reverses and name.startswith(("predicted", "agreement")):
            unlike &= (expected[name] != 0) & (other[name].values != 0)
        wrong[name] = unlike & (not (reverses and name == "condition_residual"))
    for name in (*MEANS, *SPREADS, "theta_min", "theta_max"):
        size = np.fmax(np.abs(expected[name]), 1.0)
        wrong[name] = sure & (np.abs(other[name].values - expected[name]) > (10 * errors + 1e-8) * size)
    return {
        name: worst_point(
            points, None, where, image=other[name].values, expected=expected[name], errors=errors
        )
        for name, where in wrong.items()
        if where.any()
    }


def ends(points):
    """w, alpha and gamma at the end of runs by DOP853."""
    state, constants = SATELLITE.initial_state(points), SATELLITE.constants(points)
    for start, column in zip(state.T, constants.T, strict=True):
        run = solve_ivp(
            lambda t, y, c=column: SATELLITE.equations.rhs(y, c),
            (0, DURATION),
            start,
            "DOP853",
            rtol=1e-13,
            atol=1e-14,
        )
        start[:] = run.y[:, -1]
    return np.split(state, 3)


@pytest.mark.long
@pytest.mark.parametrize("reverses", [False, True])
def test_an_image_has_the_labels_and_statistics_of_its_motion(reverses):
    """Reversed motions begin where the others end: both pass the same states."""
    rng = np.random.default_rng(7 + reverses)
    points, vectors = starts(rng, 2)
    vectors = ends(points) if reverses else vectors
    for signs, a in (SYMMETRIES[i] for i in rng.choice(np.arange(1, 16), 3, replace=False)):
        other, sign = image(points, vectors, reverses, signs, a)
        wrong = differences(points, other, sign, reverses)
        assert not wrong, f"{signs}, {a}, seed {7 + reverses}: {wrong}"


@pytest.mark.long
def test_statistics_of_twice_the_time_are_those_of_both_halves():
    """The equations contain no time: the second half is the motion from the end of the first."""
    points, _ = starts(np.random.default_rng(9), 3)
    later = image(points, ends(points), False, (1.0, 1.0, 1.0), 1.0)[0]
    options = {"method": "rk8", "variables": (*MEANS, *SPREADS, "theta_min", "theta_max", "error_estimate")}
    whole = atlas.label_points("satellite", points, duration=2 * DURATION, **options)
    first, second = (
        atlas.label_points("satellite", each, duration=DURATION, **options) for each in (points, later)
    )
    sure = whole["error_estimate"] < 1e-6
    assert sure.mean() > 0.6
    expected = {name: 0.5 * (first[name] + second[name]) for name in MEANS}
    expected["theta_dot_rms"] = np.hypot(first["theta_dot_rms"], second["theta_dot_rms"]) / np.sqrt(2)
    for name in ("psi_dot", "phi_dot", "normal_rate"):
        between = 0.5 * (first[f"{name}_mean"] - second[f"{name}_mean"])
        within = np.hypot(first[f"{name}_std"], second[f"{name}_std"]) / np.sqrt(2)
        expected[f"{name}_std"] = np.hypot(within, between)
    expected["theta_min"] = np.fmin(first["theta_min"], second["theta_min"])
    expected["theta_max"] = np.fmax(first["theta_max"], second["theta_max"])
    for name, values in expected.items():
        assert_at_points(whole[name], values, points, 9, where=sure, rtol=1e-5, atol=1e-7)
