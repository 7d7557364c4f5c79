"""Messages about tensors, attitudes, rates and motions that cannot be used."""

import numpy as np
import pytest
from refusals import assert_refused

import atlas

OR_POINTS = "or (points, ...) of these"
PRODUCTS = np.array([[1.15e-4, 5.2e-5, 2.5e-5], [5.2e-5, 1.53e-4, 3.4e-5], [2.5e-5, 3.4e-5, 1.9e-4]])
NOT_WRITTEN = "is masked or was never written; must be a finite number"

TENSORS = [
    (np.eye(3), {"order": "descending"}, "order = 'descending': did you mean 'ascending'? allowed: nearest, ascending"),
    (np.eye(3), {"order": 1}, "order = 1: must be a text"),
    ([1.0, 2.0, 3.0], {}, f"tensor: its shape is (3,); allowed: (3, 3), {OR_POINTS}"),
    (np.ones((2, 2, 3, 3)), {}, f"tensor: its shape is (2, 2, 3, 3); allowed: (3, 3), {OR_POINTS}"),
    (np.ones((0, 3, 3)), {}, f"tensor: its shape is (0, 3, 3); allowed: (3, 3), {OR_POINTS}"),
    ([[1.0, 2.0], [3.0]], {}, "tensor = [[1.0, 2.0], [3.0]]: must be numbers"),
    ("diag", {}, "tensor = 'diag': must be numbers"),
    (np.eye(3) * np.nan, {}, "tensor = array(...: must be finite numbers"),
    (np.ma.array(np.eye(3), mask=np.eye(3)), {}, f"point 0 (counted from 0): tensor {NOT_WRITTEN}"),
    (np.eye(3) + np.eye(3, k=1) / 8, {}, "tensor: not symmetric, mirrored elements differ by 0.125"),
    (np.diag([1.0, -0.5, 1.0]), {}, "tensor: not positive, its least principal moment is -0.5"),
    (np.diag([1.0, 0.0, 1.0]), {}, "tensor: not positive, its least principal moment is 0"),
    (np.diag([1.0, 2.5, 1.0]), {}, "tensor: C + A = 2 is less than B = 2.5: no rigid body has these moments of inertia"),
    ([np.eye(3), np.diag([1.0, 1.0, 3.0])], {}, "point 1 (counted from 0): tensor: A + B = 2 is less than C = 3: no rigid body ..."),
    (PRODUCTS, {}, "tensor: A + B = 0.000226124 is less than C = 0.000231876: no rigid body has these moments of inertia"),
]  # fmt: skip
STARTS = [
    ("satelite", {}, "system = 'satelite': there is no such system; did you mean 'satellite'? allowed: satellite, fixed_point"),
    ("satellite", {"frame": "LVLH"}, "frame = 'LVLH': did you mean 'lvlh'? allowed: orbital, lvlh, inertial"),
    ("satellite", {"frame": 2}, "frame = 2: must be a text"),
    ("fixed_point", {"frame": "orbital"}, "frame = 'orbital': allowed: space"),
    ("satellite", {"relative_to": "frame"}, "relative_to = 'frame': allowed: orbit, inertial"),
    ("fixed_point", {"relative_to": "orbit"}, "relative_to = 'orbit': allowed: inertial"),
    ("satellite", {"rates_in": "orbit"}, "rates_in = 'orbit': allowed: body, frame"),
    ("satellite", {"units": "deg"}, "units = 'deg': did you mean 'deg/s'? allowed: rad/s, deg/s, rpm"),
    ("fixed_point", {"Omega": 1e-3}, "Omega: the frame of the system fixed_point does not turn; leave it out"),
    ("satellite", {"Omega": -1e-3}, "Omega = -0.001: allowed: Omega >= 0 (angular velocity of the circular orbit)"),
    ("satellite", {"Omega": "1"}, "Omega = '1': must be numbers"),
    ("satellite", {"Omega": np.ones((2, 2))}, f"Omega: its shape is (2, 2); allowed: (), {OR_POINTS}"),
    ("satellite", {"rates": (0, 1)}, f"rates: its shape is (2,); allowed: (3,), {OR_POINTS}"),
    ("satellite", {"rates": (0, 1, np.inf)}, "rates = (0, 1, inf): must be finite numbers"),
    ("satellite", {"rates": [True] * 3}, "rates = [True, True, True]: must be numbers"),
    ("satellite", {"rates": (0, 1, 1j)}, "rates = (0, 1, 1j): must be numbers"),
    ("satellite", {"rates": ("0", "0", "1")}, "rates = ('0', '0', '1'): must be numbers"),
    ("satellite", {"attitude": (0, 0, 1)}, f"attitude: its shape is (3,); allowed: (3, 3) or (4,), {OR_POINTS}"),
    ("satellite", {"attitude": np.eye(4)[:, :3]}, f"attitude: its shape is (4, 3); allowed: (3, 3) or (4,), {OR_POINTS}"),
    ("satellite", {"attitude": (0, 0, 0, 0)}, "attitude: a quaternion of length 0 is no rotation"),
    ("satellite", {"attitude": 2 * np.eye(3)}, "attitude: no rotation, products of its rows differ from 0 and 1 by 3"),
    ("satellite", {"attitude": np.eye(3) + np.eye(3, k=1) / 8}, "attitude: no rotation, products of its rows differ from 0 and 1 by 0.125"),
    ("satellite", {"attitude": 1e200 * np.eye(3)}, "attitude: no rotation, products of its rows differ from 0 and 1 by inf"),
    ("satellite", {"attitude": np.diag([1, 1, -1])}, "attitude: a reflection, no rotation: its determinant is -1, the axes are left-handed"),
    ("satellite", {"axes": -np.eye(3)}, "axes: a reflection, no rotation: its determinant is -1, the axes are left-handed"),
    ("satellite", {"axes": [[1, 0, 0]]}, f"axes: its shape is (1, 3); allowed: (3, 3) or (4,), {OR_POINTS}"),
    ("satellite", {"rates": np.ones((2, 3)), "Omega": [1, 2, 3]}, "points: columns of different lengths (rates: 2, Omega: 3)"),
    ("satellite", {"attitude": [np.eye(3)] * 3, "rates": np.ones((2, 3))}, "points: columns of different lengths (attitude: 3, rates: 2)"),
]  # fmt: skip
MOTIONS = [
    ({"frame": "space"}, "frame = 'space': allowed: orbital, lvlh, inertial"),
    ({"euler": "xyw"}, "euler = 'xyw': Expected axes from ..."),
    ({"euler": "xxy"}, "euler = 'xxy': Expected consecutive axes to be different..."),
    ({"euler": "xyZ"}, "euler = 'xyZ': ..."),
    ({"euler": 3}, "euler = 3: must be a text"),
    ({"axes": np.zeros((3, 3))}, "axes: no rotation, products of its rows differ from 0 and 1 by 1"),
    ({"degrees": 1}, "degrees = 1: must be true or false"),
]  # fmt: skip


@pytest.mark.parametrize(("tensor", "options", "sentence"), TENSORS, ids=[row[-1][:40] for row in TENSORS])
def test_a_mistake_in_a_tensor(tensor, options, sentence):
    assert_refused(lambda: atlas.principal(tensor, **options), sentence)


@pytest.mark.parametrize(("system", "given", "sentence"), STARTS, ids=[row[-1][:40] for row in STARTS])
def test_a_mistake_in_a_start(system, given, sentence):
    given = {"attitude": np.eye(3), "rates": (0, 0, 1)} | given
    assert_refused(lambda: atlas.start(system, **given), sentence)


@pytest.mark.parametrize(("given", "sentence"), MOTIONS, ids=[row[-1][:40] for row in MOTIONS])
def test_a_mistake_about_a_motion(given, sentence):
    motion = atlas.trajectory("satellite", {}, duration=1.0, samples=3)
    assert_refused(lambda: motion.atlas.attitude(**given), sentence)


def test_an_atlas_has_no_attitudes():
    points = atlas.label_points("satellite", {"theta0": [0.1, 0.2]}, duration=1.0)
    needed = "time, w1, w2, w3, a1, a2, a3, g1, g2, g3, Omega"
    assert_refused(points.atlas.attitude, f"not the trajectory of a body: it needs {needed}")
