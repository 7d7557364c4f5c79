"""Labels proved for every duration: verified cases, what is refused, and what atlases and points show of them."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from family_starts import STARTS
from strategies import select

import atlas
from atlas.extensions.certificate.proofs import PROOFS, Proof
from atlas.flags import Label
from atlas.measure.instrument import Tolerances
from atlas.systems.fixed_point import FIXED_POINT
from atlas.systems.satellite import SATELLITE

pytestmark = pytest.mark.usefixtures("whole_kernels")

SYSTEMS = {"satellite": SATELLITE, "fixed_point": FIXED_POINT}
CASES = json.loads((Path(__file__).parents[2] / "reference" / "energy_cases.json").read_text())
NONE, ENERGY, MOMENTA = Proof
VARIABLES = ["label", "predicted", "agreement", "label_proof", "proof_bound"]


def proofs(system, rate=1e-3, angle=None, **points):
    """What is proved of some points, with numbers for the parameters that have one value."""
    given = SYSTEMS[system]
    size = np.broadcast_shapes(*(np.shape(value) for value in points.values()), (1,))
    columns = {
        k: np.broadcast_to(points.get(k, p.default), size).astype(float) for k, p in given.parameters.items()
    }
    assert points.keys() <= columns.keys()
    return PROOFS.proofs(given, columns, Tolerances(rate, rate if angle is None else angle))


@pytest.mark.parametrize("case", CASES, ids=[each["kind"] for each in CASES])
def test_verified_cases(case):
    """Labels and statistics measured by another integrator to T = 1000, bounds by the author of the cases."""
    start, rate, angle = (
        case["parameters"] | case["start"],
        case["rate_tolerance"],
        case["cylinder_tolerance"],
    )
    result = {name: values[0] for name, values in proofs(case["system"], rate, angle, **start).items()}
    kind = MOMENTA if case["kind"].startswith("top") else ENERGY
    assert result["label_proof"] == (kind if case["proved"] else NONE)
    if case["proved"]:
        assert (
            result["predicted"]
            == Label[case["label_proved"].upper()]
            == Label[case["label_measured"].upper()]
        )
        measured = case["measured"]
        rates = ["normal_rate_std"] if case["cylinder"] else ["theta_dot_rms", "psi_dot_std", "phi_dot_std"]
        assert max(measured[name] for name in rates) <= result["proof_bound"] <= 1.02 * case["bound"]
        assert proofs(case["system"], 0.99 * result["proof_bound"], angle, **start)["label_proof"] == NONE


def test_inertial_labels_need_a_rate_that_is_clearly_zero_or_not():
    """A symmetric satellite that points to the radius turns once in an orbit in space; its spin may be 0, or too near to tell."""
    body = {"A": 1.0, "B": 1.0, "C": 0.6, "theta0": np.pi / 2, "psi0": np.pi / 2 + 1e-5}
    spin = np.array([0.0, 9.8e-4, 1e-3, 1.02e-3, 0.4])
    result = proofs("satellite", m=spin, k3=-0.6 * spin, **body)
    assert [*result["predicted"]] == 5 * [Label.PERMANENT_ROTATION]
    assert [*result["label_proof"]] == 5 * [ENERGY]
    kinds = [
        Label.PERMANENT_ROTATION,
        Label.PERMANENT_ROTATION,
        0,
        Label.REGULAR_PRECESSION,
        Label.REGULAR_PRECESSION,
    ]
    assert [*result["predicted_inertial"]] == kinds
    assert [*result["label_inertial_proof"]] == [ENERGY, ENERGY, NONE, ENERGY, ENERGY]
    for orbit, label in ((1e-4, 2), (2e-3, 1)):  # the slow orbit alone turns the axis
        result = proofs("satellite", **body | {"m": 0.4, "k3": -0.24, "Omega": orbit, "psi0": np.pi / 2})
        assert (result["predicted_inertial"], result["predicted"]) == (label, 2)


@pytest.mark.parametrize(
    ("system", "points"),
    [
        ("satellite", {"C": 1.5, "k3": -4.5}),
        ("satellite", {"B": 1.1, "C": 0.9}),
        ("fixed_point", {"A": 1.0, "B": 1.1, "C": 0.5, "Mg": 1.0, "z0": -0.5, "m": 30.0}),
    ],
)
def test_gyroscopic_stability_is_no_proof_by_the_energy(system, points):
    """Motions that stay, at a maximum or a saddle of the energy."""
    tilt = np.array([0.0, 1e-5])
    result = atlas.label_points(
        system,
        points | {"theta0": tilt},
        duration=60.0,
        rate_tolerance=1e-3,
        variables=[*VARIABLES, "stable"],
    )
    assert result["stable"][0] == 1
    assert [*result["label"]] == [Label.PERMANENT_ROTATION, Label.PERMANENT_ROTATION]
    assert [*result["label_proof"]] == [NONE, NONE]


def test_what_the_second_variation_of_the_energy_decides_is_proved():
    """Exact equilibria of a satellite with a rotor: a proof where the energy has a minimum, gyroscopic stability or not elsewhere."""
    for body in ({"A": 1.0, "B": 1.1, "C": 0.9}, {"A": 1.1, "B": 1.0, "C": 1.4}):
        points = SATELLITE.with_defaults(body | {"phi0": 0.0 if body["A"] < body["B"] else np.pi / 2})
        points = {name: np.repeat(value, 64) for name, value in points.items()} | {
            "k3": np.linspace(-8, 8, 64)
        }
        stable = SATELLITE.energy_stability(points, np.ones(64, np.int8))
        assert {*stable} == {1, 2}
        assert [*proofs("satellite", **points)["label_proof"]] == [*(stable == 1)]


def test_two_momenta_prove_a_sleeping_top():
    """Inverted: fast it sleeps, slow it falls."""
    upright = {
        "Mg": 1.0,
        "z0": -0.5,
        "A": 1.0,
        "B": 1.0,
        "C": 0.5,
        "m": np.array([30.0, 1.0]),
        "theta0": 1e-5,
    }
    result = proofs("fixed_point", **upright)
    assert [*result["label_proof"]] == [MOMENTA, NONE]
    assert result["predicted"][0] == Label.PERMANENT_ROTATION


def test_nothing_is_proved_across_a_barrier():
    """With enough energy a satellite turns over its nearest saddle, whatever the tolerance; with less it is held."""
    body = {"A": 1.0, "B": 1.2, "C": 1.5, "k1": 0.02, "k2": 0.01, "k3": 0.3}
    rates = np.array([0.01, 0.1, 0.3, 1.0, 2.0])
    result = proofs("satellite", 10.0, 1e-5, theta0=0.6, phi0=0.3, n=rates, **body)
    assert result["label_proof"].sum() == 0
    rest = atlas.equilibria("satellite", body)
    at = {
        name: float(rest[name][np.flatnonzero(rest["index"] == 0)[0]]) for name in ("theta0", "psi0", "phi0")
    }
    result = proofs("satellite", 10.0, 1e-9, theta_dot0=rates, **body | at)
    assert 0 < (result["label_proof"] == ENERGY).sum() < rates.size


def test_a_start_beyond_the_rim_is_held_by_no_minimum():
    """With x = 1 - cos(theta) the potential of a tilt about the radius is 0.04 x - 0.2 x^2, which has its rim at theta = 0.45."""
    tilt = {"theta0": np.array([0.2, 0.4, 0.5, 0.6, 1.2])}
    result = proofs("satellite", 1.0, 1.3, A=1.0, B=1.2, C=1.6, k3=-0.36, **tilt)
    assert [*result["label_proof"]] == [ENERGY, ENERGY, NONE, NONE, NONE]


def test_without_torque_there_is_no_minimum():
    """A slow orbit, and none."""
    result = proofs("satellite", A=1.0, B=1.2, C=1.5, Omega=np.array([1e-3, 0.0]))
    assert [*result["label_proof"]] == [ENERGY, NONE]


def test_circles_of_minima_are_refused():
    """A symmetric satellite without spin rests at any phi0; damping takes away the momentum that would hold it."""
    body = {"A": 1.0, "B": 1.0, "C": 0.6, "theta0": np.pi / 2, "psi0": np.pi / 2, "m": np.array([0.0, 1e-4])}
    assert [*proofs("satellite", **body)["label_proof"]] == [ENERGY, ENERGY]
    assert [*proofs("satellite", damping=0.1, **body)["label_proof"]] == [NONE, NONE]
    # About the normal the tilt alone counts.
    assert proofs("satellite", C=1.5, theta0=1e-4, damping=np.array([0.1, 0.0]))["label_proof"].all()


def test_damping_leaves_no_momentum():
    top = {"A": 1.0, "B": 1.0, "C": 1.5, "Mg": 1.0, "z0": 0.4, "theta0": 1.0, "n": 1.2, "m": 1.0}
    top["l3"] = 1.2 * np.cos(1.0) - 0.4 / 1.2 - 1.5 * (1.0 + 1.2 * np.cos(1.0))
    hanging = {"A": 1.2, "B": 1.0, "C": 1.5, "Mg": 1.0, "z0": 0.4, "theta0": 1e-5}
    for damping, kinds in ((0.0, [MOMENTA, ENERGY, ENERGY]), (0.1, [NONE, NONE, ENERGY])):
        result = [proofs("fixed_point", damping=damping, **p) for p in (top, hanging | {"m": 1.0}, hanging)]
        assert [each["label_proof"][0] for each in result] == kinds


def test_a_motion_that_may_leave_the_cylinder_is_refused():
    """A tilt of 1e-4 inside the cylinder and outside it, and inside one that it will leave."""
    body = {"A": 1.0, "B": 1.3, "C": 1.6, "k3": 0.3, "theta0": 1e-4}
    kinds = [proofs("satellite", 1e-3, angle, **body)["label_proof"][0] for angle in (1e-3, 0.99e-4, 1e-5)]
    assert kinds == [ENERGY, NONE, NONE]
    moving = np.array([1e-4, 1e-3])
    assert [*proofs("satellite", 1e-2, 1e-3, theta_dot0=moving, **body)["label_proof"]] == [ENERGY, NONE]
    sleeping = {"A": 1.0, "B": 1.0, "C": 1.5, "Mg": 1.0, "z0": 0.4, "m": 1.0, "theta0": 1e-4}
    kinds = [proofs("fixed_point", 1.0, angle, **sleeping)["label_proof"][0] for angle in (1e-3, 0.99e-4)]
    assert kinds == [MOMENTA, NONE]


def test_rounding_errors_are_part_of_the_bounds():
    """Momenta that cancel hide as much of the energy as their rounding errors are; so do a fast frame and a heavy body."""
    spin = np.array([0.0, 1e3, 1e6])
    body = {
        "A": 1.0,
        "B": 1.0,
        "C": 0.6,
        "theta0": np.pi / 2,
        "psi0": np.pi / 2,
        "m": spin,
        "k3": -0.6 * spin,
    }
    still, slow, fast = proofs("satellite", **body)["proof_bound"]
    assert 1e-8 < still < 3e-7 < slow < 1e-4 < fast < 1e-2
    assert 1e-8 < proofs("satellite", B=1.3, C=1.6, k3=0.3)["proof_bound"] < 1e-6
    # A start that differs by one rounding of the momentum has its energy within these bounds.
    nudged = proofs("satellite", **body | {"k3": -0.6 * spin * (1 + 2.0**-52)})["proof_bound"]
    assert nudged[2] < 1.5 * fast
    top = {
        "A": 1.0,
        "B": 1.0,
        "C": 1.0,
        "Mg": 1.0,
        "z0": -0.1,
        "theta0": 1e-6,
        "m": spin[1:],
        "l3": 10 - spin[1:],
    }
    assert np.all(np.diff(proofs("fixed_point", 1e-3, 1e-2, **top)["proof_bound"]) > 0)


@pytest.mark.long
def test_no_measured_label_contradicts_a_proof():
    """Starts about the border of what can be proved, in units in which the frame turns slowly or fast."""
    rng, count = np.random.default_rng(6), 150
    size = 10 ** rng.uniform(-5, -2, count)
    nudge = dict(
        zip(
            ("theta0", "psi0", "phi0", "theta_dot0", "n", "m"),
            size * rng.normal(size=(6, count)),
            strict=True,
        )
    )
    x = rng.dirichlet((2, 2, 2), count).T
    body = dict(zip("ABC", np.sort(x.sum(0) - x, axis=0), strict=True))
    scale = rng.choice([0.1, 1.0, 10.0], count)
    for name in ("theta_dot0", "n", "m"):
        nudge[name] = nudge[name] * scale
    points = body | nudge | {"Omega": scale, "k3": 0.1 * scale * body["C"]}
    result = atlas.label_points(
        "satellite", points, duration=60 / scale, rate_tolerance=1e-3, method="rk8", tolerance=1e-6,
        variables=[*VARIABLES, "label_inertial", "predicted_inertial", "label_inertial_proof"],
    )  # fmt: skip
    proved = result["label_proof"] > 0
    assert 20 < proved.sum() < count - 20
    assert (result["label"] == result["predicted"]).where(proved, True).all()
    assert (result["predicted"] > 0).where(proved, True).all()
    assert (result["agreement"] == 1).where(proved, True).all()
    proved = result["label_inertial_proof"] > 0
    assert (result["label_inertial"] == result["predicted_inertial"]).where(proved, True).all()


@pytest.mark.usual("satellite")
@pytest.mark.parametrize("name", STARTS)
def test_points_are_independent_of_each_other_and_of_machine_code(name):
    """Points of every family, half of them slow, as plain Python one by one and together in machine code: the same bits."""
    rng = np.random.default_rng(7)
    parts = [select(draw(rng, 4), slice(0, 4)) for draw in STARTS[name].values()]
    points = {key: np.concatenate([part[key] for part in parts]) for key in parts[0]}
    slow = 10.0 ** rng.uniform(-8, 0, points["A"].size)
    points |= {key: points[key] * slow for key in ("n", "m", "theta_dot0")}
    system, tolerances = SYSTEMS[name], Tolerances(1e-2, 1e-3)
    every = PROOFS.proofs(system, points, tolerances, in_machine_code=True)
    assert len(set(every["label_proof"].tolist())) == (2 if name == "satellite" else 3)
    for i in range(points["A"].size):
        one = PROOFS.proofs(system, select(points, [i]), tolerances)
        for column, values in every.items():
            np.testing.assert_array_equal(values[i], one[column][0])
