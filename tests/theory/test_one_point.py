"""Theory of one point: plain Python, machine code and arrays of NumPy agree."""

import numpy as np
import pytest
from family_starts import STARTS
from strategies import random_fixed_points, random_satellites, select, steady_motions
from truth import assert_at_points

from atlas import systems
from atlas.theory.motions import find_motions
from atlas.theory.steady import FAR

MOVED = {"satellite": ("theta0", "m", "k3", "theta_dot0"), "fixed_point": ("theta0", "m", "l3", "theta_dot0")}


def starts(name, seed, count):
    """Starts on every family, half of them moved by 1e-16 to 1e-1, and random ones."""
    rng = np.random.default_rng(seed)
    draw = random_satellites if name == "satellite" else random_fixed_points
    parts = [select(STARTS[name][kind](rng, count), slice(0, count)) for kind in STARTS[name]]
    parts.append(draw(rng, count))
    points = {key: np.concatenate([part[key] for part in parts]) for key in parts[0]}
    size = points["A"].size
    which, change = rng.integers(8, size=size), 10 ** rng.uniform(-16, -1, size)
    for i, parameter in enumerate(MOVED[name]):
        points[parameter] = points[parameter] + np.where(which == i, change, 0.0)
    return points


@pytest.mark.usual("satellite")
@pytest.mark.parametrize("name", STARTS)
def test_machine_code_and_plain_python_agree_to_the_bit(name):
    system, points = systems.get(name), starts(name, 77, 6)
    plain, fast = (steady_motions(system, points, 30.0, 1e-5, 1e-4, each) for each in (False, True))
    assert_at_points(plain.answer, fast.answer, points, 77)
    for own, other in zip(plain.axes, fast.axes, strict=True):
        assert_at_points(own, other, points, 77)
    nudged = points | {"m": points["m"] + 1e-7}
    settings = 30.0, 1e-5, 1e-4
    _, plain = find_motions(system, points, nudged, *settings, False)
    _, fast = find_motions(system, points, nudged, *settings, True)
    for own, other in zip(plain, fast, strict=True):
        assert_at_points(own, other, nudged, 77)
    assert len(set(steady_motions(system, points, 30.0, 1e-5, 1e-4).answer.tolist())) == 3


@pytest.mark.parametrize("damping", [0.0, 4.0])
def test_a_heavy_body_at_rest_departs_by_its_angular_acceleration(damping):
    """|f| over the frequency bound, in tolerances; what damping leaves of it counts where that is within them."""
    system, tilt = systems.get("fixed_point"), 0.4
    points = {name: np.full(1, p.default) for name, p in system.parameters.items()}
    points |= {
        "Mg": np.ones(1),
        "z0": np.full(1, 0.3),
        "theta0": np.full(1, tilt),
        "damping": np.full(1, damping),
    }
    acceleration = 0.3 * np.sin(tilt) / points["A"][0]
    bound, duration = system.frequency_bound(points)[0], 80.0
    for share in (3.0, 300.0):
        tolerance = acceleration / bound / share
        away = find_motions(system, points, points, duration, tolerance, 1e-3)[1].away[0]
        root_mean_square = share / np.sqrt(bound * duration)
        left = share * np.sqrt(1 / max(1.0, damping * duration * sum(1 / points[name][0] for name in "ABC")))
        expected = max(root_mean_square, left) if root_mean_square <= FAR else root_mean_square
        assert away == pytest.approx(expected, rel=1e-12)
