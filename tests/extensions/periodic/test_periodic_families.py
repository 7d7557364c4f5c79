"""Families of periodic motions against other integrators, the normal form, elliptic integrals and symmetries."""

from __future__ import annotations

import json
from dataclasses import replace
from itertools import product
from pathlib import Path

import numpy as np
import pytest
import xarray as xr
from scipy.special import ellipk, ellipkm1

import atlas
from atlas import systems
from atlas.extensions.periodic import families
from atlas.extensions.periodic.flow import Flow
from atlas.extensions.periodic.orbits import Family, SteadyMotion
from atlas.extensions.periodic.periodic import slope_at_birth
from atlas.flags import FamilyEnd, OrbitStability, PeriodicEvent
from atlas.scene.tables import point_columns
from tests.refusals import assert_refused

pytestmark = pytest.mark.usefixtures("whole_kernels")

CASES = json.loads((Path(__file__).parents[2] / "reference" / "periodic_orbits.json").read_text())["families"]
OFTEN = {4, 16}  # the others are long
ORACLE = [
    pytest.param(
        case, id=f"{case['name']} {case['frequency']:.3f}", marks=[] if i in OFTEN else pytest.mark.long
    )
    for i, case in enumerate(CASES)
]
STARTS = ("theta0", "psi0", "phi0", "theta_dot0", "n", "m")


def families_of(case, **options):
    return atlas.periodic(
        case["system"], case["body"], motion=case["motion"], frequency=case["frequency"], **options
    )


def states_after(system, body, orbit, times):
    """States at times of the motion that starts as an orbit does, by `trajectory`."""
    point = body | {name: float(orbit[name]) for name in STARTS}
    at = [
        atlas.trajectory(system, point, duration=float(t), samples=2, tolerance=1e-12, method="rk8").isel(
            time=-1
        )
        for t in times
    ]
    return np.array([[float(each[name]) for name in systems.get(system).equations.STATE] for each in at])


def turned(states, chi):
    c, s = np.cos(chi), np.sin(chi)
    return (states.reshape(len(states), -1, 3) @ np.array([[c, s, 0], [-s, c, 0], [0, 0, 1]])).reshape(
        states.shape
    )


@pytest.mark.long
@pytest.mark.parametrize("case", ORACLE)
def test_families_are_those_of_another_code(case):
    """Every orbit at given energies, multipliers, stability and turns, the end, and events that were solved for."""
    energies = [row[0] for row in (*case["orbits"], *case["stable"])]
    ds = families_of(case, energy=energies)
    one = ds.isel(family=0)
    assert one.birth_period.item() == pytest.approx(case["birth_period"], rel=1e-11)
    assert one.birth_energy.item() == pytest.approx(case["birth_energy"], abs=1e-12)
    if case["slope"] is not None:
        assert one.birth_slope.item() == pytest.approx(case["slope"], rel=1e-6)
    assert ds.end.attrs["flag_meanings"].split()[one.end.item()] == case["end"]
    if "limit_energy" in case:
        assert one.end_energy.item() == pytest.approx(case["limit_energy"], abs=1e-9)
        period = case.get("limit_period", np.inf)
        assert one.end_period.item() == pytest.approx(period, rel=1e-10)
    period, multipliers = one.period.values, one.multiplier_real.values + 1j * one.multiplier_imag.values
    for energy, expected, trace in case["orbits"]:
        i = np.abs(np.where(np.abs(one.energy.values - energy) < 1e-11, period, np.inf) - expected).argmin()
        assert period[i] == pytest.approx(expected, abs=1e-9)
        if trace is not None and multipliers.size:
            assert multipliers[i].sum().real == pytest.approx(trace, rel=1e-8, abs=1e-8)
    for energy, expected, turn, low, high, stable, pairs in case["stable"]:
        i = np.abs(np.where(np.abs(one.energy.values - energy) < 1e-11, period, np.inf) - expected).argmin()
        assert period[i] == pytest.approx(expected, abs=1e-9)
        assert np.cos(one.turn.values[i] - turn) == pytest.approx(1.0, abs=1e-14)
        # Extremes over instants.
        assert low - 0.01 < one.theta_min.values[i] < low + 1e-9
        assert high - 1e-9 < one.theta_max.values[i] < high + 0.01
        assert one.orbit_stable.values[i] == (OrbitStability.STABLE if stable else OrbitStability.UNSTABLE)
        others = np.array([complex(*pair) for pair in pairs])
        for mu in multipliers[i]:
            assert np.abs(others - mu).min() < 1e-8 * max(1.0, abs(mu))
    kinds = [PeriodicEvent(int(kind)).name.lower() for kind in one.event_kind.values if np.isfinite(kind)]
    folds = [row[1] for row in case["events"] if row[0] == "fold"]
    for kind, expected, energy, how in case["events"]:
        if how != "solved" or (
            kind == "branch" and np.abs(np.subtract(folds, expected)).min(initial=1) < 1e-6
        ):
            continue
        if abs(expected - one.end_period.item()) < 1e-6:  # where it turns back is no event
            continue
        same = np.array([each == kind for each in kinds])
        gaps = np.abs(one.event_period.values - expected) + np.abs(one.event_energy.values - energy)
        assert np.where(same, gaps, np.inf).min() < 1e-6, (kind, expected)


@pytest.mark.long
@pytest.mark.parametrize("case", [CASES[i] for i in (4, 12, 14)])
def test_orbits_close_and_repeat_up_to_their_turn_by_trajectories(case):
    ds = families_of(case, orbits=5, events=False).isel(family=0)
    assert ds.closing.max() < 1e-11
    assert ds.theta_max.values == pytest.approx(ds.theta0.values, abs=1e-12)
    checked = 0
    for i in range(ds.sizes["orbit"]):
        orbit = ds.isel(orbit=i)
        growth = (
            np.hypot(orbit.multiplier_real, orbit.multiplier_imag).max() if orbit.sizes["multiplier"] else 1.0
        )
        if growth < 30:
            start, end = states_after(case["system"], case["body"], orbit, [1e-12, float(orbit.period)])
            error = np.abs(turned(end[None], float(orbit.turn))[0] - start).max()
            assert error < 1e-11 * max(1.0, np.abs(start).max())
            checked += 1
    assert checked > 1


def events_at_steps(case, monkeypatch, share):
    """Kinds and periods of the events up to 2.9 periods of the birth, at a share of the usual steps, and whether they are complete."""
    monkeypatch.setattr(families, "LONGEST", share * families.LONGEST)
    monkeypatch.setattr(families, "ANGLE", share * families.ANGLE)
    monkeypatch.setattr(families, "GROWTH", share * families.GROWTH)
    one = families_of(case, max_period=3.0).isel(family=0)
    events = one.event_period.values < 2.9 * float(one.birth_period)
    return one.event_kind.values[events], one.event_period.values[events], one.complete.item()


@pytest.mark.parametrize("case", ORACLE)
def test_steps_of_half_the_length_find_no_other_event(case, monkeypatch):
    whole, periods, complete = events_at_steps(case, monkeypatch, 1.0)
    half, others, _ = events_at_steps(case, monkeypatch, 0.5)
    if complete:
        assert whole.tolist() == half.tolist()
        assert periods == pytest.approx(others, rel=1e-6)
    assert complete == (case["name"] != "F4" or case["frequency"] > 1)


def reversors(flow):
    """Signs D of the states with f(D y) = -D f(y), of which the body's integrals know nothing."""
    rng, found = np.random.default_rng(1), []
    for w, first, last in product(product((1, -1), repeat=3), repeat=3):
        signs = np.array([*w, *first, *last][: len(flow.start)])
        y = rng.normal(size=(3, len(flow.start)))
        rates = [np.array(flow.equations.rhs(each.T, flow.constants), float).T for each in (y, signs * y)]
        if np.abs(rates[1] + signs * rates[0]).max() < 1e-12 and not any(
            np.array_equal(signs, s) for s in found
        ):
            found.append(signs)
    return found


@pytest.mark.usual("15")
@pytest.mark.parametrize("index", [7, 8, 9, 14, 15])
def test_symmetric_orbits_are_on_the_fixed_set_again_after_half_a_period(index):
    """States there have zeros where the reversor changes signs; an orbit that meets the set does so twice a period."""
    case = CASES[index]
    system = systems.get(case["system"])
    flow = Flow(system, point_columns(system, case["body"] | case["motion"])[0])
    ds = families_of(case, orbits=5, events=False, max_period=1.5).isel(family=0)
    met = 0
    for i in range(1, ds.sizes["orbit"]):
        start = point_columns(system, case["body"] | {name: float(ds[name][i]) for name in STARTS})[0]
        state, period = system.initial_state(start).T, float(ds.period[i])
        bound = flow.bound(state[0])
        path = flow.nodes(state, period, bound)[0]
        time = period / (len(path) - 1)
        for signs in reversors(flow):
            odd = signs < 0
            near = path[np.argmin((path[:, odd] ** 2).sum(1)) - 1][None]
            if np.abs(near - path[-1]).max() < 1e-6:
                near = path[-2:-1]
            offset = 0.0
            for _ in range(8):  # Gauss and Newton
                here = flow.nodes(near, max(time + offset, 1e-9), 0.0, 8)[:, -1]
                slope = np.array(flow.equations.rhs(here.T, flow.constants), float).T[0, odd]
                offset -= float(here[0, odd] @ slope / (slope @ slope))
                if not abs(offset) < 3 * time:
                    break
            if np.abs(here[0, odd]).max() < 1e-12:
                later = flow.nodes(here, 0.5 * period, bound)[0, -1]
                assert np.abs(later[odd]).max() < 1e-10
                met += 1
    assert met >= 2


def born(system, point):
    """Frequencies of a steady motion, and slopes of its families at their births."""
    flow = Flow(systems.get(system), point_columns(systems.get(system), point)[0])
    flow.rate = max(float(flow.body.turn[0]), float(np.linalg.norm(flow.start[:3])))
    births, slopes = SteadyMotion(flow).births()[0], []
    for birth in births:
        family = Family(SteadyMotion(flow), birth)
        path = families.Path(family)
        members, step = [path.birth], families.FIRST
        while len(members) <= families.BIRTHS:
            if new := path.beside(members[-1], step):
                members.append(new)
            else:
                step /= 2
        slopes.append(slope_at_birth(family, members[1:]))
    return [birth.frequency for birth in births], slopes


@pytest.mark.long
def test_slopes_at_birth_are_those_of_the_normal_form():
    """dT/dh = -4 pi c / frequency^3 with the coefficient c of the square of the action, of 40 random bodies."""
    rng, done = np.random.default_rng(84), 0
    names = ["birkhoff_c20", "birkhoff_c02"]
    while done < 40:
        A, C = 1.0, rng.uniform(0.6, 1.9)
        if done % 2:
            system, point = (
                "satellite",
                {"A": A, "B": A, "C": C, "k3": rng.uniform(-0.5, 1), "m": rng.uniform(-0.5, 1)},
            )
        else:
            B = rng.uniform(1.0, 1.9)
            system, point = "fixed_point", {
                "A": A, "B": B, "C": rng.uniform(B - 0.9, B + 0.9), "Mg": 1.0, "z0": 1.0, "l3": rng.uniform(-1, 1), "m": rng.uniform(-1, 1),
            }  # fmt: skip
        ds = atlas.label_points(system, point, duration=1.0, variables=[*names, "frequency_1", "frequency_2"])
        expected = [float(ds[name].item()) for name in names]
        if not np.isfinite(expected).all():
            continue
        frequencies, slopes = born(system, point)
        ratio = frequencies[0] / frequencies[1]
        if min(abs(ratio - k) for k in (1, 2, 3, 4)) < 0.1:
            continue
        for frequency, slope, c in zip(frequencies, slopes, expected, strict=True):
            assert slope == pytest.approx(-4 * np.pi * c / frequency**3, rel=1e-5, abs=1e-6), (
                point,
                frequency,
            )
        done += 1


def test_planar_librations_have_the_period_of_elliptic_integrals():
    """Of a satellite with a rotor on the normal: T = 4 K(k) / f, energy C f^2 k^2 / 2 above the steady motion."""
    A, B, C = 1.0, 1.25, 1.5
    f = np.sqrt(3 * (B - A) / C)
    squared = np.array([1e-3, 0.3, 0.9, 0.999])
    ds = atlas.periodic(
        "satellite", {"A": A, "B": B, "C": C, "k3": 0.4}, frequency=3, above=list(C * f**2 * squared / 2), events=False
    )  # fmt: skip
    assert ds.frequency.item() == pytest.approx(f, rel=1e-12)
    assert ds.period.values[0] == pytest.approx(4 * ellipk(squared) / f, rel=1e-11)
    assert ds.theta_max.max() < 1e-7
    assert ds.end.item() == FamilyEnd.ASYMPTOTIC
    assert ds.end_energy.item() - ds.birth_energy.item() == pytest.approx(C * f**2 / 2, rel=1e-10)


def test_planar_rotations_have_the_period_of_elliptic_integrals():
    """No family from a steady motion has them, so that their equations are solved alone: T = 4 K(1 / k) / (k f) for a whole turn."""
    A, B, C = 1.0, 1.25, 1.5
    f = np.sqrt(3 * (B - A) / C)
    body = {"A": A, "B": B, "C": C, "k3": 0.4}
    flow = Flow(systems.get("satellite"), point_columns(systems.get("satellite"), body)[0])
    family = Family(SteadyMotion(flow), SteadyMotion(flow).births()[0][2])
    for k in (1.001, 1.1, 3.0):
        period, near, m = 4 * ellipk(1 / k**2) / (k * f), flow.start.copy(), 16
        near[2] += 1.0001 * k * f
        states = np.concatenate(
            [near[None], *(flow.run(near[None], i * period / m, 3.0)[0] for i in range(1, m))]
        )
        guess = replace(family.born(m), states=states, period=1.0001 * period, chi=0.0, bound=3.0 * k)
        energy = family.birth_energy + C * f**2 * k**2 / 2
        assert family.corrected(guess, energy).orbit.period == pytest.approx(period, rel=1e-11)
    above = atlas.periodic("satellite", body, frequency=3, above=1.001 * C * f**2 / 2, events=False)
    assert above.sizes["orbit"] == 0


@pytest.mark.long
def test_a_free_body_has_the_period_of_its_elliptic_functions():
    """Rotations about the axis of the largest moment: T = 4 K(k) / p, the vertical along the angular momentum."""
    A, B, C, m = 1.0, 1.4, 1.9, 0.8
    ds = atlas.periodic(
        "fixed_point", {"A": A, "B": B, "C": C, "Mg": 0.0, "m": m}, orbits=12, max_period=4.0, events=False
    )
    square, largest = (C * m) ** 2, np.inf
    for i in range(ds.sizes["family"]):
        if abs(ds.frequency.values[i] - m * np.sqrt((C - A) * (C - B) / (A * B))) > 1e-9:
            continue
        one = ds.isel(family=i)
        twice = 2 * one.energy.values
        p = np.sqrt((C - B) * (square - twice * A) / (A * B * C))
        k2 = (B - A) * (twice * C - square) / ((C - B) * (square - twice * A))
        largest = np.abs(one.period.values / (4 * ellipkm1(1 - k2) / p) - 1).max()
    assert largest < 1e-11


@pytest.mark.long
def test_arrays_of_bodies_make_an_atlas_over_their_parameters():
    k3, mu3 = xr.DataArray([0.2, 0.4], dims="k3"), xr.DataArray([0.1, 5.0], dims="mu3")
    body = {"A": 1.0, "B": 1.25, "C": 1.5, "k3": k3, "mu3": mu3, "h3": -1.0}
    ds = atlas.periodic("satellite", body, frequency=1, above=0.02, events=False, max_period=1.5)
    assert ds.period.dims == ("k3", "mu3", "family", "orbit")
    alone = {"A": 1.0, "B": 1.25, "C": 1.5, "k3": 0.4, "mu3": 0.1, "h3": -1.0}
    one = atlas.periodic("satellite", alone, frequency=1, above=0.02, events=False, max_period=1.5)
    at = ds.sel(k3=0.4, mu3=0.1).isel(family=0).dropna("orbit")
    np.testing.assert_array_equal(at.period, one.period[0])
    np.testing.assert_array_equal(at.multiplier_real, one.multiplier_real[0])


@pytest.mark.long
def test_datasets_are_written_read_and_labelled(tmp_path):
    ds = families_of(CASES[4], orbits=5, events=False)
    ds.to_netcdf(tmp_path / "families.nc")
    again = xr.open_dataset(tmp_path / "families.nc")
    assert again.end.attrs["flag_meanings"].split()[again.end.item()] == "multiple"
    points = {name: ds[name].values[0] for name in STARTS} | CASES[4]["body"]
    labels = atlas.label_points("satellite", points, duration=30.0, variables=["label", "theta_max"])
    assert labels.theta_max.values == pytest.approx(ds.theta_max.values[0], abs=2e-2)


SATELLITE = {"A": 1.0, "B": 1.25, "C": 1.5}


@pytest.mark.parametrize(
    ("system", "body", "options", "sentence"),
    [
        ("satellite", SATELLITE, {"frequency": "fast"}, 'frequency = \'fast\': must be a number or "all"'),
        ("satellite", SATELLITE, {"frequency": 9}, "frequency = 9: the motion has 1..., in positions from 1 on"),
        ("satellite", SATELLITE, {"frequency": 0.5}, "frequency = 0.5: the motion has 1..., in positions from 1 on"),
        ("satellite", SATELLITE, {"max_period": 1.0}, "max_period = 1: must be above 1"),
        ("satellite", SATELLITE, {"energy": 1.0, "above": 0.1}, "energy and above are both given; allowed: one of them"),
        ("satellite", SATELLITE, {"energy": "high"}, "energy = 'high': must be a number..."),
        ("satellite", SATELLITE, {"orbits": 0}, "orbits = 0...must be...1..."),
        ("satellite", SATELLITE | {"damping": 0.1}, {}, "damping = 0.1: motions of a damped body do not repeat; set it to 0"),
        ("satellite", SATELLITE | {"theta0": 0.3}, {}, "motion: no steady motion starts here; family and solve make one of it"),
        ("satellite", SATELLITE, {"motion": {"family": "ring"}}, "family.name = 'ring': unknown family; ..."),
        ("satellite", SATELLITE, {"motion": {"nutation": 1.0}}, "nutation: not a parameter of the satellite; ..."),
        ("satellite", SATELLITE | {"B": 1.5}, {}, "motion: an exponent is 0, families are not isolated"),
        ("fixed_point", {"C": 0.6, "Mg": 1.0, "z0": 1.0, "m": 1.0}, {}, "motion: the axis of symmetry is on the vertical, where turns about both are the same"),
    ],
)  # fmt: skip
def test_wrong_input_is_refused_in_a_line(system, body, options, sentence):
    assert_refused(lambda: atlas.periodic(system, body, **options), sentence)


def test_without_the_extension_its_name_is_unknown(without_extension):
    without_extension("periodic")
    with pytest.raises(AttributeError, match="periodic"):
        atlas.periodic("satellite", SATELLITE)
