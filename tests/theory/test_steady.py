"""Steady motions by the equations alone: against families, measured labels, motions known exactly, and systems without theory."""

from types import MappingProxyType

import numpy as np
import pytest
from family_starts import STARTS
from plugins import registry
from strategies import in_units, random_fixed_points, random_satellites, steady_motions
from truth import assert_at_points, cases, fixed_point_cases

import atlas
from atlas import systems
from atlas.flags import Label, Status
from atlas.systems import Parameter, System, arithmetic, steady
from atlas.systems.base import families_of
from atlas.systems.steady import polynomial_degree
from atlas.systems.vectors import cross, length
from atlas.theory.steady import Existence

KINDS = [(system, kind) for system, kinds in STARTS.items() for kind in kinds]


def family_rates(system, points):
    """Sine of the angle between the axes, n and m of the family of each start."""
    flags, _ = system.identify_family(points)
    sine, n, m = (np.array(values) for values in system.steady_rates(points))
    for family in families_of(system).values():
        members = np.flatnonzero(flags == family.flag)
        if family.axes is not None and members.size:
            axes = family.axes({name: values[members] for name, values in points.items()})
            sine[members] = np.linalg.norm(np.cross(axes.spin_axis, axes.fixed_axis, axis=0), axis=0)
            n[members], m[members] = axes.precession_rate, axes.spin_rate
    return sine, n, m


@pytest.mark.usual(
    "satellite-cylindrical",
    "satellite-perp_radius",
    "satellite-spherical",
    "fixed_point-conical, n = 0",
    "fixed_point-staude",
    "fixed_point-free_precession",
)
@pytest.mark.parametrize(("name", "kind"), KINDS)
def test_exact_starts_are_steady_in_all_units(name, kind):
    """With the rates and the nutation of the family; the axes differ by rounding errors of derivatives alone."""
    system, rng = systems.get(name), np.random.default_rng(2)
    points = STARTS[name][kind](rng, 40)
    for time, mass in ((1.0, 1.0), (1e8, 3e-8), (7e-9, 2e7)):
        scaled = in_units(points, time, mass)
        motion = steady_motions(system, scaled, 50.0 * time, 1e-5 / time, 1e-5)
        assert_at_points(motion.answer, Existence.EXACT, scaled, 2)
        sine, n, m = family_rates(system, scaled)
        s, spin, nu, turn = motion.axes
        u = system.equations.frame_motion(system.initial_state(scaled), system.constants(scaled))[:3]
        size = length(np.array(u)) + np.abs(turn)
        assert_at_points(length(spin * s + turn * nu - u), 0.0, scaled, 2, atol=1e-12 * size)
        # A rotation about one axis may be written as a precession as well.
        known = (np.abs(n * m * sine) > 1e-3 / time**2) & (np.abs(turn * spin) > 0)
        squares = (turn * spin * length(cross(nu, s))) ** 2, (n * m * sine) ** 2
        assert_at_points(*squares, scaled, 2, where=known, rtol=1e-6)


@pytest.mark.parametrize("kind", ["grioli", "balanced_field"])
def test_growth_of_periodic_motions_has_no_unit(kind):
    """Once in units of 4e-5 the steps of a period were counted by the rates in these, and runs never began."""
    system, rng = systems.get("fixed_point"), np.random.default_rng(7)
    points = STARTS["fixed_point"][kind](rng, 40)
    family, _ = system.identify_family(points)
    stable, growth = system.linear_stability(points, family)
    for time, mass in ((1e8, 3e-8), (7e-9, 2e7)):
        scaled = in_units(points, time, mass)
        assert_at_points(system.identify_family(scaled)[0], family, scaled, 7)
        scaled_stable, scaled_growth = system.linear_stability(scaled, family)
        assert_at_points(scaled_stable, stable, scaled, 7, growth=growth)
        assert_at_points(scaled_growth * time, growth, scaled, 7, rtol=1e-7, atol=1e-9)


@pytest.mark.parametrize(
    ("name", "draw"), [("satellite", random_satellites), ("fixed_point", random_fixed_points)]
)
def test_random_starts_are_far(name, draw):
    points = draw(np.random.default_rng(3), 500)
    motion = steady_motions(systems.get(name), points, 30.0, 1e-5, 1e-5)
    assert_at_points(motion.answer, Existence.FAR, points, 3)


def test_published_cases_are_decided():
    """Cases 38 and 58, a rotor 1 % from the steady one and a tilt of 1e-4, are far by 6.5 and 7 tolerances."""
    durations = np.array([case["T"] for case in cases("fixed_point")])
    motion = steady_motions(systems.get("fixed_point"), fixed_point_cases(), durations, 1e-5, 1e-5)
    # A free precession about an axis that is not the vertical is steady, and drifts about the vertical.
    drifting = np.array([case["label"] == "drifting" and case["id"] != 109 for case in cases("fixed_point")])
    expected = np.where(drifting, Existence.FAR, Existence.EXACT)
    assert_at_points(motion.answer, expected, fixed_point_cases(), None)


# Rates and angles that are moved, by the system.
MOVED = {"satellite": ("theta0", "m", "k3", "theta_dot0"), "fixed_point": ("theta0", "m", "l3", "theta_dot0")}
ABOUT_THIRD = [(name, kind) for name, kind in KINDS if kind.split(",")[0] not in ("grioli", "balanced_field")]


@pytest.mark.long
@pytest.mark.parametrize("count", [6, pytest.param(24, marks=pytest.mark.long)])
@pytest.mark.parametrize("name", STARTS)
def test_moved_starts_are_not_decided_otherwise_than_measured(name, count):
    """Starts moved by 1e-16 to 1e-1, spins up to 1e6, in any units."""
    system, rng = systems.get(name), np.random.default_rng(4)
    names = ["label", "status", "label_any_axis"]
    names += ["label_any_axis_inertial"] if name == "satellite" else []  # the kernel of other tests
    answers = set()
    for kind in [kind for other, kind in ABOUT_THIRD if other == name]:
        points = STARTS[name][kind](rng, count)
        points = {key: values[:count].copy() for key, values in points.items()}
        size = points["A"].size
        which, moves = (
            rng.integers(4, size=size),
            10 ** rng.uniform(-16, -1, size) * rng.choice([-1, 1], size),
        )
        for i, parameter in enumerate(MOVED[name]):
            points[parameter] += np.where((which == i) & np.isnan(points.get("p0", np.nan)), moves, 0.0)
        time, tolerance = 10 ** rng.uniform(-8, 8), 10 ** rng.uniform(-6, -3)
        points = in_units(points, time, 10 ** rng.uniform(-8, 8))
        duration = np.fmin(30.0 * time, 1000 / system.frequency_bound(points))
        answer = steady_motions(system, points, duration, tolerance / time, tolerance).answer
        ds = atlas.label_points(
            name, points, duration=duration, rate_tolerance=tolerance / time, cylinder_tolerance=tolerance,
            variables=names,
        )  # fmt: skip
        ok = ds.status.values == Status.OK
        exact, far = (ok & (answer == each) for each in (Existence.EXACT, Existence.FAR))
        assert_at_points(ds.label, Label.DRIFTING, points, 4, where=far, answer=answer)
        drifts = ds.label_any_axis.values == Label.DRIFTING
        assert_at_points(drifts, False, points, 4, where=exact, answer=answer)
        answers |= set(answer)
    assert answers == {*Existence}


class HeavyTop(System):
    """A heavy body with a rotor in its own notation: states in another order, the vertical upwards."""

    name, title, frame = "heavy_top_of_tests", "heavy top", "space"
    rate_states = ("x", "y", "z")
    names = ("J1", "J2", "J3", "r1", "r2", "r3", "p", "q", "c", "x0", "y0", "z0", "v1", "v2", "v3")
    parameters = MappingProxyType(
        {name: Parameter(name, "1", name, float(name in ("J1", "J2", "J3", "v3"))) for name in names}
    )

    class equations:
        STATE = ("v1", "v2", "v3", "x", "y", "z")
        FRAME_VECTORS = (("v1", "v2", "v3"),)
        CONSTANTS = ("J1", "J2", "J3", "r1", "r2", "r3", "p", "q", "c")

        def rhs(state, constants):
            v1, v2, v3, x, y, z = state
            J1, J2, J3, r1, r2, r3, p, q, c = constants
            L1, L2, L3 = J1 * x + p, J2 * y + q, J3 * z + c
            return (
                v2 * z - v3 * y, v3 * x - v1 * z, v1 * y - v2 * x,
                (L2 * z - L3 * y + r3 * v2 - r2 * v3) / J1,
                (L3 * x - L1 * z + r1 * v3 - r3 * v1) / J2,
                (L1 * y - L2 * x + r2 * v1 - r1 * v2) / J3,
            )  # fmt: skip

        def frame_motion(state, constants):
            v1, v2, v3, x, y, z = state
            return x, y, z, v1, v2, v3

    def initial_state(self, points):
        return np.array([points[name] for name in ("v1", "v2", "v3", "x0", "y0", "z0")])


def tops(rng, count):
    """Random heavy bodies and starts."""
    names = HeavyTop.names
    points = {name: rng.normal(size=count) for name in names}
    parts = rng.uniform(0.3, 1.0, (3, count))
    points |= dict(zip(names[:3], parts.sum(0) - parts, strict=True))
    vertical = rng.normal(size=(3, count))
    return points | dict(zip(names[-3:], vertical / length(vertical), strict=True))


def known_tops(rng, count):
    """Free symmetric precessions, free rotations about a principal axis, and Lagrange's precessions about an axis, in turn."""
    points, kind, axis = tops(rng, count), np.arange(count) % 3, np.arange(count) // 3 % 3
    free = kind < 2
    for i in range(3):
        across = axis != i
        for name in (f"r{i + 1}", "pqc"[i]):
            points[name] = np.where(across | (free & (name[0] == "r")), 0.0, points[name])
        points["xyz"[i] + "0"] = np.where((kind == 1) & across, 0.0, points["xyz"[i] + "0"])
    moments = np.array([points[f"J{i}"] for i in (1, 2, 3)])
    own = np.take_along_axis(moments, axis[None], 0)[0]
    moments = np.where(
        (kind != 1) & (np.arange(3)[:, None] != axis),
        np.fmax(moments[axis - 1, np.arange(count)], own / 2),
        moments,
    )
    # A top about its axis: n (J m + rotor) + (J - A) n^2 cos - weight = 0, the weight against the vertical.
    e, v = np.eye(3)[:, axis], np.array([points[name] for name in HeavyTop.names[-3:]])
    n, m = rng.normal(size=(2, count))
    lagrange, A = n * v + m * e, moments[axis - 1, np.arange(count)]
    rotor = (e * np.array([points[name] for name in "pqc"])).sum(0)
    weight = n * (own * m + rotor) + (own - A) * n**2 * (e * v).sum(0)
    for i in range(3):
        points[f"J{i + 1}"] = moments[i]
        points["xyz"[i] + "0"] = np.where(kind == 2, lagrange[i], points["xyz"[i] + "0"])
        points[f"r{i + 1}"] = np.where(kind == 2, weight * e[i], points[f"r{i + 1}"])
    return points


@pytest.fixture
def top():
    yield systems.register(HeavyTop())
    del systems.SYSTEMS[HeavyTop.name]


def test_motions_of_another_system_that_are_known(top):
    assert polynomial_degree(top) == 2
    for size in (1.0, 1e6):
        points = known_tops(np.random.default_rng(5), 60)
        points = {key: v * {"J": 1, "v": 1, "r": size**2}.get(key[0], size) for key, v in points.items()}
        motion = steady_motions(top, points, 30.0 / size, 1e-5 * size, 1e-5)
        assert_at_points(motion.answer, Existence.EXACT, points, 5)
    drawn = tops(np.random.default_rng(6), 60)
    assert_at_points(steady_motions(top, drawn, 30.0, 1e-5, 1e-5).answer, Existence.FAR, drawn, 6)
    moved = points | {"z0": points["z0"] * 1.01, "c": points["c"] + 0.01 * size}
    assert (steady_motions(top, moved, 30.0 / size, 1e-5 * size, 1e-5).answer != Existence.EXACT)[2::3].all()


class WithFunctions(HeavyTop):
    """The heavy top with a rotor about its third axis of sin(c) + sqrt(q * q)."""

    name = "heavy_top_with_functions_of_tests"

    equations = arithmetic.module_of(
        HeavyTop.equations,
        {name: names for name, names in vars(HeavyTop.equations).items() if name.isupper()},
        {
            name: text.replace("J2 * y + q", "J2 * y").replace("z + c", "z + sin(c) + sqrt(q * q)")
            for name, text in arithmetic.functions(HeavyTop.equations).items()
        },
    )


def test_equations_with_functions_of_constants():
    points = tops(np.random.default_rng(9), 60)
    # Every other one turns about its third axis upright, with its weight and its rotor along it.
    for key in ("r1", "r2", "p", "x0", "y0", "v1", "v2"):
        points[key][::2] = 0.0
    points["v3"][::2] = 1.0
    with registry():
        system = systems.register(WithFunctions())
        motion = steady_motions(system, points, 30.0, 1e-5, 1e-5)
    expected = np.resize([Existence.EXACT, Existence.FAR], 60)
    assert_at_points(motion.answer, expected, points, 9)


class Resonant(System):
    """A body with a precession n nu + m e3 that is steady at n = 3 m alone, where the frequencies n - m and 2 m coincide."""

    name, title, frame = "resonant_of_tests", "resonant", "space"
    rate_states = ("x", "y", "z")
    names = ("m", "a", "b", "c", "x0", "y0", "z0", "v1", "v2", "v3")
    parameters = MappingProxyType({name: Parameter(name, "1", name) for name in names})

    class equations:
        STATE = ("x", "y", "z", "v1", "v2", "v3")
        FRAME_VECTORS = (("v1", "v2", "v3"),)
        CONSTANTS = ("m", "a", "b", "c")

        def rhs(state, constants):
            x, y, z, v1, v2, v3 = state
            m, a, b, c = constants
            return (
                m * y + a * v1 + b * x * v3 + c * (x * x - y * y),
                -m * x + a * v2 + b * y * v3 - 2.0 * c * x * y,
                0.0 * z,
                v2 * z - v3 * y, v3 * x - v1 * z, v1 * y - v2 * x,
            )  # fmt: skip

        def frame_motion(state, constants):
            x, y, z, v1, v2, v3 = state
            return x, y, z, v1, v2, v3

    def initial_state(self, points):
        return np.array([points[name] for name in ("x0", "y0", "z0", "v1", "v2", "v3")])


def test_a_motion_that_is_steady_at_a_resonance_alone():
    """With v across nu, a (v1 + i v2) + b (x + i y) v3 = -a exp(i (n - m) t), and c (x - i y)^2 = a exp(2 i m t)."""
    n, m, sine, cosine, a = np.array([3.0, -3.0, 3.01, 2.0]), 1.0, np.sqrt(0.75), 0.5, 0.7
    points = {"m": np.full(4, m), "a": np.full(4, a), "b": a / (n * (1 - cosine)), "c": a / (n * sine) ** 2}
    points |= {"x0": n * sine, "y0": np.zeros(4), "z0": n * cosine + m}
    points |= {"v1": np.full(4, cosine), "v2": np.zeros(4), "v3": np.full(4, -sine)}
    with registry():
        motion = steady_motions(systems.register(Resonant()), points, 30.0, 1e-5, 1e-5)
    assert (motion.answer == Existence.EXACT).tolist() == [True, False, False, False]


CHANGES = {
    "tanh": (
        "(L1 * y - L2 * x + r2 * v1 - r1 * v2) / J3",
        "tanh(L1 * y - L2 * x) / J3",
        "tanh(L1 * y - L2 * x)",
    ),
    "quotient": ("v2 * z - v3 * y", "v2 * z - v3 / y", "v3 / y"),
    "power": ("v2 * z - v3 * y", "v2 * z - v3 * y**0.5", "y ** 0.5"),
}


@pytest.mark.parametrize("change", CHANGES)
def test_systems_that_are_no_polynomials_have_a_reason(change, monkeypatch):
    old, new, reason = CHANGES[change]
    source = steady.arithmetic.functions(HeavyTop.equations)["rhs"]
    monkeypatch.setattr(steady.arithmetic, "functions", lambda equations: {"rhs": source.replace(old, new)})
    assert new in source.replace(old, new)
    assert polynomial_degree(HeavyTop()) == f"{reason} is no polynomial in the states"


@pytest.mark.parametrize("state", ["t", "charge"])
def test_systems_with_another_state_have_a_reason(state):
    class equations(HeavyTop.equations):
        STATE = (*HeavyTop.equations.STATE, state)

    system = HeavyTop()
    system.equations = equations
    assert f"the state {state} is neither" in polynomial_degree(system)


def test_degrees_of_powers_and_constants(monkeypatch):
    text = "def rhs(state, constants):\n    x, y, z, v1, v2, v3 = state\n    a = -x ** 3\n    b, c = a * y, sin(J1) / J2 ** 0.5\n    return a, b, c * x"
    monkeypatch.setattr(steady.arithmetic, "functions", lambda equations: {"rhs": text})
    assert polynomial_degree(HeavyTop()) == 4
