"""Theory of one point: plain Python, machine code and arrays of NumPy agree."""

import numpy as np
import pytest
import steady_oracle
from family_starts import STARTS
from strategies import random_fixed_points, random_satellites, select, steady_motions

from atlas import systems
from atlas.theory.motions import find_motions

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


@pytest.mark.parametrize("name", STARTS)
def test_machine_code_and_plain_python_agree_to_the_bit(name):
    system, points = systems.get(name), starts(name, 77, 6)
    plain, fast = (steady_motions(system, points, 30.0, 1e-5, 1e-4, each) for each in (False, True))
    np.testing.assert_array_equal(plain.answer, fast.answer)
    for own, other in zip(plain.axes, fast.axes, strict=True):
        np.testing.assert_array_equal(own, other)
    nudged = points | {"m": points["m"] + 1e-7}
    settings = 30.0, 1e-5, 1e-4
    _, plain = find_motions(system, points, nudged, *settings, False)
    _, fast = find_motions(system, points, nudged, *settings, True)
    for own, other in zip(plain, fast, strict=True):
        np.testing.assert_array_equal(own, other)
    assert len(set(steady_motions(system, points, 30.0, 1e-5, 1e-4).answer.tolist())) == 3


@pytest.mark.parametrize("name", STARTS)
@pytest.mark.parametrize("tolerances", [(1e-3, 1e-3), (1e-5, 1e-5), (1e-4, 1e-2)])
def test_one_point_at_a_time_gives_the_answers_of_arrays(name, tolerances):
    system, points = systems.get(name), starts(name, 78, 8)
    own, other = (
        each(system, points, 50.0, *tolerances) for each in (steady_motions, steady_oracle.steady_motions)
    )
    np.testing.assert_array_equal(own.answer, other.answer)
    spins = own.axes.spin_rate != 0  # else the spin axis is any
    for one, two in zip(own.axes, other.axes, strict=True):
        each = (one, two) if one is not own.axes.spin_axis else (one[:, spins], two[:, spins])
        np.testing.assert_allclose(*each, rtol=1e-10, atol=1e-10)
    change = find_motions(system, points, points, 50.0, *tolerances)[1].away
    expected = steady_oracle.departure(system, points, np.full(change.size, 50.0), tolerances)
    np.testing.assert_allclose(change, expected, rtol=1e-12)
