"""Rounding alone makes no drift: exact motions at high rates and with tolerances near rounding."""

import numpy as np
import pytest
from family_starts import exact_starts, grioli_points, points_of_family
from numpy import sqrt
from strategies import DRAG, default_points
from truth import assert_at_points

import atlas
from atlas import systems
from atlas.flags import Label, Stability, Status, Steadiness

pytestmark = pytest.mark.usefixtures("whole_kernels")

# Powers of a rate in the units of parameters of bodies whose moments of inertia stay.
POWERS = dict.fromkeys(("Omega", "n", "m", "theta_dot0", "p0", "q0", "r0"), 1)
POWERS |= dict.fromkeys(("k1", "k2", "k3", "l1", "l2", "l3"), 1)
POWERS |= dict.fromkeys((*DRAG, "mu1", "mu2", "mu3", "Mg", "N"), 2)
# A unit of rates, and the tolerance
UNITS = [(2.0**30, 1e-5), (1e10, 1e-5), (1e12, 1e-5), (1.0, 1e-14), (1.0, 1e-15)]


def starts():
    """Starts on families about the third axis and the vertical, and about other axes, by system."""
    starts = exact_starts(seed=1, size=4)
    for name in ("conical", "conical, fast", "sleeping", "staude"):
        yield "fixed_point", starts[name]
    yield "fixed_point", grioli_points(np.random.default_rng(1), 4)
    for name in ("cylindrical", "perp_velocity", "oblique"):
        yield "satellite", points_of_family(name, 4, seed=1)


@pytest.mark.long
@pytest.mark.parametrize("method", ["rk4", "rk8"])
def test_an_exact_stable_motion_has_its_label_or_none(method):
    refused = 0
    for system, points in starts():
        points = default_points(system, len(points["A"]), **points)
        duration = 60.0 / systems.get(system).frequency_bound(points)
        names = [
            f"{kind}{axes}{frame}"
            for axes in ("", "_any_axis")
            for frame in ("", "_inertial")[: 1 + (system == "satellite")]
            for kind in ("label", "predicted")
        ]
        for unit, tolerance in UNITS[:2] if method == "rk4" else UNITS:
            fast = {name: values * unit ** POWERS.get(name, 0) for name, values in points.items()}
            ds = atlas.label_points(
                system, fast, duration=duration / unit, method=method, rate_tolerance=tolerance,
                max_steps=100_000, check_half_step="all", variables=[*names, "status", "stable"],
            )  # fmt: skip
            stable, status = ds.stable.values == Stability.STABLE, ds.status.values
            known = np.isin(status, (Status.OK, Status.ROUNDOFF_DECIDED))
            assert_at_points(known, True, fast, 1, where=stable, status=status)
            for label, predicted in zip(names[::2], names[1::2], strict=True):
                known = stable & (status == Status.OK) & (ds[predicted].values != Label.NOT_COMPUTED)
                assert_at_points(ds[label], ds[predicted], fast, 1, where=known)
            refused += (status[stable] == Status.ROUNDOFF_DECIDED).sum()
    assert refused > 20


@pytest.mark.usual("rk8")
@pytest.mark.parametrize("rate", [1e9, 1e10, 1e12])
@pytest.mark.parametrize("method", ["rk4", "rk8"])
def test_precession_of_a_levitated_rotor(rate, method):
    """The free symmetric top precesses exactly; with a tolerance above rounding the label says so, and drift stays drift."""
    A, C, theta = 1.0, 0.5, 0.6
    top = {
        "A": A,
        "B": A,
        "C": C,
        "Mg": 0.0,
        "theta0": theta,
        "n": rate,
        "m": (A - C) / C * rate * np.cos(theta),
    }
    settings = {"duration": 20.0 / rate, "method": method, "max_steps": 100_000, "cylinder_tolerance": 1e-5}
    names = ["label", "status", "label_any_axis"]
    ds = atlas.label_points("fixed_point", top, rate_tolerance=1e-17 * rate, variables=names, **settings)
    assert (ds.label.item(), ds.status.item()) == (Label.UNRESOLVED, Status.ROUNDOFF_DECIDED)
    assert ds.label_any_axis.item() == Label.UNRESOLVED
    only_label = atlas.label_points(
        "fixed_point", top, rate_tolerance=1e-17 * rate, variables=["label", "status"], **settings
    )
    assert only_label.status.item() == Status.ROUNDOFF_DECIDED
    ds = atlas.label_points("fixed_point", top, rate_tolerance=1e-11 * rate, variables=names, **settings)
    assert (ds.label.item(), ds.status.item()) == (Label.REGULAR_PRECESSION, Status.OK)
    kick = 1e-11 * rate  # of theta', far above rounding
    ds = atlas.label_points(
        "fixed_point", top | {"theta_dot0": kick}, rate_tolerance=1e-13 * rate, **settings
    )
    assert (ds.label.item(), ds.status.item()) == (Label.DRIFTING, Status.OK)


class Circling(systems.System):
    """A point in the field of a centre, on a circle where `faster` is 0."""

    class equations:
        STATE, CONSTANTS = ("x", "y", "vx", "vy"), ("pull",)

        def rhs(state, constants):
            x, y, vx, vy = state
            (pull,) = constants
            square = x * x + y * y
            size = -pull / (square * sqrt(square))
            return vx, vy, size * x, size * y

        def radius(state, constants):
            x, y, vx, vy = state
            return sqrt(x * x + y * y)

        def radial(state, constants):  # 0 on a circle: two terms cancel
            x, y, vx, vy = state
            return x * vx + y * vy

    name = title = "circling"
    parameters = {  # noqa: RUF012
        name: systems.Parameter(name, "1", name, default, start=name != "pull")
        for name, default in {"pull": 1.0, "radius0": 1.0, "turn": 0.0, "faster": 0.0}.items()
    }
    observables = tuple(systems.Observable(name, "1", name) for name in ("radius", "radial"))

    def initial_state(self, points):
        speed = np.sqrt(points["pull"] / points["radius0"]) * (1.0 + points["faster"])
        x, y = np.cos(points["turn"]), np.sin(points["turn"])
        return np.array([points["radius0"] * x, points["radius0"] * y, -speed * y, speed * x])


@pytest.mark.long
@pytest.mark.parametrize("observable", ["radius", "radial"])
@pytest.mark.parametrize("method", ["rk4", "rk8"])
def test_an_observable_of_a_circle_is_constant_or_not_known_to_be(own_systems, observable, method):
    atlas.register(Circling)
    rng = np.random.default_rng(2)
    points = {"pull": np.exp(rng.uniform(0, 40, 3)), "radius0": np.exp(rng.uniform(-5, 20, 3))}
    points["turn"] = np.append(0.0, rng.uniform(0, 6, 2))
    period = 2 * np.pi * np.sqrt(points["radius0"] ** 3 / points["pull"])
    size = points["radius0"] if observable == "radius" else points["radius0"] ** 2 / period
    other = {"radius": "radial", "radial": "radius"}[observable]

    def run(i, share, faster):
        one = {name: values[i] for name, values in points.items()} | {"faster": faster}
        limits = {observable: share * size[i], other: 1e300}
        ds = atlas.label_points(
            "circling", one, duration=4 * period[i], method=method, tolerance=1e-13, std_tolerance=limits
        )
        return ds.label.item(), ds.status.item()

    for i in range(3):
        assert run(i, 1e-17, 0.0) == (Steadiness.UNRESOLVED, Status.ROUNDOFF_DECIDED)
        assert run(i, 1e-8, 0.0) == (Steadiness.STEADY, Status.OK)
        assert run(i, 1e-17, 1e-6) == (Steadiness.DRIFTING, Status.OK)
