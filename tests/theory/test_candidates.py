"""The steps of the test of steady motions, by numbers of one start: candidates, phases, residuals, departures."""

from types import FunctionType

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from strategies import default_points, fixed_points_on_family

from atlas import systems
from atlas.theory import prediction, steady
from atlas.theory.compiled import of_system
from atlas.theory.motions import Starts, body_at
from atlas.theory.point import THIRD, Motion, Start
from atlas.theory.steady import Existence

TOP, SATELLITE = systems.get("fixed_point"), systems.get("satellite")
ZERO = (0.0, 0.0, 0.0)


def of(function, system=TOP):
    """A function of the theory in plain Python, with the equations of a system."""
    return of_system(function, system, False)


def unit(*components):
    return tuple(np.array(components) / np.linalg.norm(components))


LEAN, FIXED = unit(0.6, -0.3, 0.8), unit(0.2, 0.7, -0.4)


def start_of(s, m, nu, n, vertical=None, frame=ZERO, vectors=()):
    """A start whose angular velocity moves as in this motion, with u''."""
    s, nu = np.array(s), np.array(nu)
    u = n * nu + m * s
    acceleration = n * m * np.cross(nu, s)
    second = m * np.cross(acceleration, s)
    vertical = tuple(nu) if vertical is None else vertical
    w = tuple(u + frame)
    return Start(w, vectors, 0.0, tuple(u), frame, ZERO, tuple(acceleration), vertical), tuple(second)


@pytest.mark.parametrize(
    ("which", "motion", "vertical"),
    [
        (0, (LEAN, 3.0, LEAN, 0.0), FIXED),
        (1, (LEAN, 3.0, FIXED, -2.0), FIXED),
        (2, (THIRD, -3.0, FIXED, 2.0), LEAN),
        (3, (LEAN, 3.0, FIXED, 2.0), THIRD),
    ],
)
def test_candidates_are_the_motions_of_their_angular_velocity(which, motion, vertical):
    """About one axis, about the vertical, about the third axis, and with neither known; each sign of both axes is the same."""
    start, second = start_of(*motion, vertical)
    s, m, nu, n = of(steady.candidate)(which, start, second, 4.0)
    expected_s, expected_m, expected_nu, expected_n = motion
    np.testing.assert_allclose(np.multiply(m, s), np.multiply(expected_m, expected_s), atol=1e-14)
    np.testing.assert_allclose(np.multiply(n, nu), np.multiply(expected_n, expected_nu), atol=1e-14)
    assert (np.linalg.norm(s), np.linalg.norm(nu)) == pytest.approx((1.0, 1.0))
    rate, change = of(steady.rest_of)(start, Motion(s, m, nu, n))
    np.testing.assert_allclose([rate, change], np.zeros((2, 3)), atol=1e-13)
    assert of(steady.is_beside)(start, Motion(s, m, nu, n), 4.0)
    other = (second[0] + 1.0, *second[1:])
    if which > 1:  # u'' is not that of a steady motion
        assert np.isnan(of(steady.candidate)(2, start, other, 1e-3).m)


def test_what_a_candidate_leaves():
    start, _ = start_of(LEAN, 3.0, FIXED, 2.0)
    rate, change = of(steady.rest_of)(start, Motion(FIXED, 1.0, LEAN, -2.0))
    np.testing.assert_allclose(rate, np.add(np.multiply(5.0, LEAN), FIXED))
    np.testing.assert_allclose(change, 6 * np.cross(FIXED, LEAN) + 2 * np.cross(LEAN, FIXED))
    gate = steady.GATE
    for share, expected in ((0.9, True), (1.1, False)):
        moved = start._replace(u=tuple(np.add(start.u, np.multiply(share * gate * 5.0, FIXED))))
        assert of(steady.is_beside)(moved, Motion(LEAN, 3.0, FIXED, 2.0), 5.0) == expected
        turned = tuple(np.add(start.acceleration, np.multiply(share * gate * 25.0, FIXED)))
        moved = start._replace(acceleration=turned)
        assert of(steady.is_beside)(moved, Motion(LEAN, 3.0, FIXED, 2.0), 5.0) == expected


def test_the_rate_about_an_axis():
    rate_about = of(steady.rate_about)
    assert rate_about((0.0, 2.0, 1.0), (1.0, 0.0, 0.0), (5.0, -6.0, -3.0), 0.1) == -3.0
    assert rate_about((0.0, 2.0, 0.0), (1.0, 0.0, 0.0), (0.0, 0.19, 0.0), 0.1) == 0.0
    assert rate_about((0.0, 2.0, 0.0), (1.0, 0.0, 0.0), (0.0, 0.21, 0.0), 0.1) == 0.105
    small = 0.9 * steady.GATE
    assert np.isnan(rate_about((0.0, small, 0.0), (1.0, 0.0, 0.0), (0.0, 1.0, 0.0), 0.1))
    assert rate_about((0.0, 2 * small, 0.0), (1.0, 0.0, 0.0), (0.0, 2 * small, 0.0), 0.1) == pytest.approx(
        1.0
    )


@pytest.mark.parametrize(
    ("n", "m", "expected"),
    [
        (1.0, 1.0, (1, 1)), (2.0, -3.0, (2, 3)), (-3.0, 1.0, (3, 1)), (4.0, 3.0, (4, 3)), (np.pi, 1.0, (1, 5)),
        (5.0, 1.0, (1, 5)), (1.0, 1.0 + 1e-8, (1, 5)), (1.0, 1.0 + 1e-10, (1, 1)), (2.0, 0.0, (1, 0)), (0.0, 2.0, (0, 1)),
        (0.0, 0.0, (0, 0)),
    ],
)  # fmt: skip
def test_phases(n, m, expected):
    """Of equations of degree 2: ratios of numbers up to 4, else the line 1 : 5."""
    start, _ = start_of(LEAN, m, FIXED, n, vectors=(THIRD,))
    assert of(steady.phases)(start, Motion(LEAN, m, FIXED, n)) == expected
    along = start._replace(vectors=(FIXED,))
    assert of(steady.phases)(along, Motion(LEAN, m, FIXED, n)) == (0, 1 if m else 0)


def starts_of(system, points):
    starts = Starts.of(system, points)
    return [body_at_of(system)(starts, i) for i in range(starts.bound.size)]


def body_at_of(system):
    return of(body_at, system)


@pytest.mark.parametrize("name", ["fixed_point", "satellite"])
def test_the_residual_is_that_of_the_equations(name):
    """w' at the turned vectors less what the motion needs, by rotation matrices and the equations of the system."""
    system, rng = systems.get(name), np.random.default_rng(3)
    given = {
        key: rng.normal(size=2)
        for key in system.parameters
        if not key.startswith(("damping", "p0", "q0", "r0", "gamma"))
    }
    given |= {"A": 1.0, "B": 1.3, "C": 0.8, "theta0": 0.7}
    points = default_points(name, 2, **given)
    states, constants = system.initial_state(points), system.constants(points)
    place = system.equations.STATE.index
    of_w = [place(each) for each in system.rate_states]
    of_vectors = [[place(each) for each in triple] for triple in system.equations.FRAME_VECTORS]
    for i, body in enumerate(starts_of(system, points)):
        start = of(steady.start_at, system)(body.w, body.vectors, body.constants)
        frame = np.array(start.frame)
        u, g = np.split(np.array(system.equations.frame_motion(states[:, i], constants[:, i])), 2)
        np.testing.assert_allclose(frame, states[of_w, i] - u, atol=1e-14)
        np.testing.assert_allclose(start.vertical, g)
        slope = np.array(system.equations.rhs(states[:, i], constants[:, i]))
        np.testing.assert_allclose(start.slope, slope[of_w])
        np.testing.assert_allclose(start.acceleration, slope[of_w] - np.cross(frame, u), atol=1e-13)
        assert start.slip < 1e-13
        # A motion about the vertical, as fast in the frame as the frame is; it is no motion of the body.
        motion = Motion(LEAN, 1.7, tuple(g / np.linalg.norm(g)), -0.6)
        alpha, beta = 0.9, -2.3
        turn = Rotation.from_rotvec(-beta * np.array(LEAN)) * Rotation.from_rotvec(
            -alpha * np.array(motion.nu)
        )
        nu = Rotation.from_rotvec(-beta * np.array(LEAN)).apply(motion.nu)
        rate, state = -0.6 * nu + 1.7 * np.array(LEAN), states[:, i].copy()
        for triple in of_vectors:
            state[triple] = turn.apply(state[triple])
        state[of_w] = rate + turn.apply(frame)
        slope = np.array(system.equations.rhs(state, constants[:, i]))[of_w]
        needed = np.cross(turn.apply(frame), rate) - 0.6 * 1.7 * np.cross(nu, LEAN)
        residual = of(steady.residual_at, system)(start, body.constants, motion, alpha, beta)
        np.testing.assert_allclose(residual, np.abs(slope - needed), rtol=1e-12)
        terms = of(steady.rounding, system)(start, body.constants, motion)
        assert (np.array(terms) >= np.abs(slope - needed)).all()


def test_steady_motions_of_a_top():
    """A regular precession on its cone is exact at every node; a rate that is wrong by a millionth is none."""
    points = fixed_points_on_family(
        "conical", default_points("fixed_point", 1, C=0.7, Mg=1.0, z0=1.0, theta0=0.9, n=1.2, m=2.0), "l3"
    )
    for change, expected in ((0.0, True), (1e-6, False)):
        (body,) = starts_of(TOP, points | {"l3": points["l3"] + change})
        start = of(steady.start_at)(body.w, body.vectors, body.constants)
        motion = of(steady.motion_about_third)(start, body.rates)
        assert motion == Motion(THIRD, body.rates[2], start.vertical, body.rates[1])
        assert of(steady.is_steady)(start, body.constants, motion, body.bound, False) == expected
    answer, _ = of(steady.steady_motion)(
        body.w, body.vectors, body.constants, body.rates, body.bound, 50.0, 1e-9, 1e-9
    )
    assert answer == Existence.FAR


def test_rates_that_are_rounding_are_none():
    tiny = 0.9 * steady.UNIT_ERROR
    start, _ = start_of(THIRD, 3.0, unit(0.0, 0.6, 0.8), 2.0)
    sine = 0.6
    motion = of(steady.motion_about_third)
    assert motion(start, (sine, 2.0, 3.0))[1::2] == (3.0, 2.0)
    upright = start._replace(u=(0.0, 0.0, 5.0))
    assert motion(upright, (0.0, 2.0, 3.0))[1::2] == (5.0, 0.0)
    assert motion(start, (sine, 2.0, tiny * (start.w[2] + 1.6)))[1] == 0.0
    assert motion(start, (sine, 2.0, 1.2 * tiny * (start.w[2] + 1.6)))[1] != 0.0
    across = np.hypot(start.w[0], start.w[1])
    assert motion(start, (sine, tiny * across / sine, 3.0))[1::2] == (start.u[2], 0.0)
    assert motion(start, (sine, 1.2 * tiny * across / sine, 3.0))[3] != 0.0


def departure(start, motion, duration=50.0, rate=1e-2, angle=1e-3, bound=2.0, damping=0.0):
    constants = body_of_top(damping).constants
    return of(steady.departure)(start, constants, motion, bound, duration, rate, angle)


def body_of_top(damping=0.0):
    (body,) = starts_of(TOP, default_points("fixed_point", 1, C=1.0, damping=damping))
    return body


def test_departure_of_a_start_outside_the_cone():
    """The larger of |u' - n m gamma x e3| over the bound, or in a shorter run, and of the offset of u, in tolerances."""
    nu = unit(0.0, 0.6, 0.8)
    start, _ = start_of(THIRD, 3.0, nu, 2.0, vectors=(nu,))
    motion = Motion(THIRD, 3.0, nu, 2.0)
    assert departure(start, motion) == pytest.approx(0.0, abs=1e-12)
    pulled = start._replace(acceleration=tuple(np.add(start.acceleration, (0.3, 0.0, 0.4))))
    once = 0.25 / 1e-2  # an acceleration of 0.5 in half a unit of time
    assert departure(pulled, motion, duration=0.1) == pytest.approx(0.05 / 1e-2)
    assert departure(pulled, motion, duration=0.5) == pytest.approx(once)
    # In a long run damping may take it away: by the root of what it leaves, but of the time over the duration at most.
    for damping, left in ((0.01, np.sqrt(1 / 1.5)), (1.0, 0.1)):
        assert departure(pulled, motion, damping=damping) == pytest.approx(left * once, rel=1e-6)
    assert departure(pulled, motion, duration=50.0) == pytest.approx(once)
    offset = start._replace(u=tuple(np.add(start.u, (0.0, 0.3, 0.0))))
    assert departure(offset, motion, duration=0.5) == pytest.approx(30.0)


def test_departure_of_a_start_in_the_cone():
    """The tilt, by the change of the angular velocity in the time, or the change of the rate about the vertical."""
    nu = unit(0.0, 1e-4, 1.0)
    start = Start((0.0, 0.0, 2.0), (nu,), 0.0, (0.0, 0.0, 2.0), ZERO, ZERO, (0.004, 0.0, 0.0), nu)
    motion = Motion(THIRD, 1.0, nu, 1.0)
    for angle, rate, expected in ((1e-3, 1e-4, 1.0), (1e-3, 1e-2, 0.2), (1e-5, 1e-4, 19.5)):
        found = departure(start, motion, duration=0.5, angle=angle, rate=rate)
        assert found == pytest.approx(expected, rel=1e-3)
    spun = start._replace(acceleration=(0.0, 0.0, 0.05))
    assert departure(spun, motion, duration=0.5) == pytest.approx(0.05 * 0.5 / 1e-2, rel=1e-6)


def test_what_damping_leaves():
    """The divergence of three moments 1 that lose 0.2 each is 0.6: the root of 1 over that and the duration."""
    body = body_of_top(0.2)
    start = of(steady.start_at)(body.w, body.vectors, body.constants)
    assert of(steady.undamped)(start, body.constants, 20.0) == pytest.approx(np.sqrt(1 / 12))
    assert of(steady.undamped)(start, body.constants, 1.0) == 1.0
    free = body_of_top()
    assert of(steady.undamped)(start, free.constants, 20.0) == 1.0


def bodies(**given):
    """A start on the cone of a top and one moved by these, before and after a nudge."""
    points = fixed_points_on_family(
        "conical", default_points("fixed_point", 1, C=0.7, Mg=1.0, z0=1.0, theta0=0.9, n=1.2, m=2.0), "l3"
    )
    moved = points | {name: points[name] + value for name, value in given.items()}
    return starts_of(TOP, points)[0], starts_of(TOP, moved)[0]


def found(before, after, nudged=True, lacks=False, duration=50.0, rate=1e-4, angle=1e-3):
    return of(prediction.find)(before, after, duration, rate, angle, nudged, lacks)[1]


def test_what_the_equations_say_of_a_nudge():
    before, after = bodies(theta0=1e-3)
    for nudged in (False, True):
        same = found(before, before, nudged)
        assert (same.answer, same.elsewhere, same.may_be_member, same.kept, same.pushed) == (
            1,
            False,
            True,
            True,
            False,
        )
        assert same.residual <= 1e-13
    moved = found(before, after)
    assert (moved.answer, moved.kept, moved.pushed) == (Existence.EXACT, False, True)
    assert moved.away > 0
    assert moved.change == pytest.approx(moved.away / np.sin(0.9 + 1e-3))
    far = found(after, after, nudged=False, rate=1e-6)
    assert (far.answer, far.may_be_member, far.kept, far.pushed) == (Existence.FAR, False, True, False)
    assert found(after, after, nudged=False, lacks=True).answer == Existence.NEAR
    assert found(before, before, nudged=False, lacks=True).answer == Existence.EXACT
    beyond = before._replace(in_range=False)
    assert found(beyond, beyond).answer == Existence.NEAR
    assert not found(before, beyond).kept
    assert found(before, beyond).change == 0.0
    slight = found(*bodies(theta0=1e-9), nudged=True)
    assert (slight.kept, slight.pushed) == (False, True)


def test_changes_inside_the_cone_are_those_of_the_angular_velocity():
    """Upright, where the tilt is no measure: a change of m by 3e-3 of a tolerance of 1e-4."""
    points = default_points("fixed_point", 1, C=0.7, m=2.0, theta0=1e-6)
    (before,), (after,) = starts_of(TOP, points), starts_of(TOP, points | {"m": points["m"] + 3e-3})
    assert found(before, after).change == pytest.approx(30.0, rel=1e-6)
    assert found(before, after, angle=1e-7).change != pytest.approx(30.0, rel=0.1)


def test_motions_about_other_axes_are_elsewhere():
    """A free sphere turns about its angular velocity: about the third axis it is not elsewhere."""
    sphere = {"A": 1.0, "B": 1.0, "C": 1.0, "Mg": 0.0, "gamma10": 0.6, "gamma20": 0.0, "gamma30": 0.8}
    for w, elsewhere in (((0.0, 0.0, 2.0), False), ((1.0, 0.5, 2.0), True)):
        given = dict(zip(("p0", "q0", "r0"), w, strict=True))
        points = {
            name: np.array([{**sphere, **given}.get(name, parameter.default)], float)
            for name, parameter in TOP.parameters.items()
        }
        (body,) = starts_of(TOP, points)
        answer = found(body, body, nudged=False)
        assert (answer.answer, answer.elsewhere) == (Existence.EXACT, elsewhere)


def test_rates_far_beyond_the_bound_are_no_motion():
    """A free symmetric top about axes that are its own: with a bound far below its rates they would be what cancels."""
    top = {
        "A": 1.0,
        "B": 1.0,
        "C": 0.6,
        "p0": 0.7,
        "q0": 1.1,
        "r0": 5.0,
        "gamma10": 0.6,
        "gamma20": 0.0,
        "gamma30": 0.8,
    }
    points = {
        name: np.array([top.get(name, parameter.default if name != "Mg" else 0.0)], float)
        for name, parameter in TOP.parameters.items()
    }
    (body,) = starts_of(TOP, points)
    momentum = np.linalg.norm([0.7, 1.1, 3.0])
    for bound, expected in ((momentum / 7, Existence.EXACT), (momentum / 9, Existence.NEAR)):
        answer, motion = of(steady.steady_motion)(
            body.w, body.vectors, body.constants, body.rates, bound, 1.0, np.inf, np.inf
        )
        assert answer == expected
        assert (motion.n == pytest.approx(momentum)) == (expected == Existence.EXACT)


def test_the_residual_of_a_start():
    """|u' - n m gamma x e3| over the squared unit and |u - n gamma| across the third axis over the unit, the larger; less upright."""
    residual_of = of(prediction.residual_of)
    before, _ = bodies()
    assert residual_of(before) <= 1e-15
    u, g = np.array(before.w), np.array(before.vectors[0])
    sine, n, m = before.rates
    slope = np.array(TOP.equations.rhs([*u, *g], before.constants))[:3]
    bend = np.linalg.norm(slope - n * (m - 1.0) * np.cross(g, [0, 0, 1])) / before.square
    assert residual_of(before._replace(rates=(sine, n, m - 1.0))) == pytest.approx(bend, rel=1e-12)
    rest = np.hypot(*(u - (n + 0.3) * g)[:2]) / np.sqrt(before.square)
    other = before._replace(rates=(sine, n + 0.3, n * m / (n + 0.3)))
    assert residual_of(other) == pytest.approx(rest, rel=1e-12)
    upright = before._replace(w=(1e-13, 0.0, 2.0), vectors=((0.0, 1e-12, 1.0),), rates=(1e-12, 5e9, 0.0))
    assert residual_of(upright) < 1.0


@pytest.mark.parametrize(
    ("m", "n", "p", "q"), [(-2.0, 4.0, 2, 1), (3.0, 1.0, 1, 3), (2.0, -np.pi, 1, 5), (0.0, 2.0, 1, 0)]
)
def test_the_nodes_of_the_test_are_equidistant_in_both_phases(m, n, p, q):
    """For a right-hand side of degree 2: 4 (p + q) + 1 parts of p and q turns, against the sense of the rates, the first the last."""
    nodes = []

    def residual_at(*arguments):
        nodes.append(arguments[-2:])
        return ZERO

    namespace = vars(steady) | {"DEGREE": 2, "PERIODS": of(steady.phases).__wrapped__.__globals__["PERIODS"]}
    namespace |= {"residual_at": residual_at, "rounding": lambda *_: (1.0, 1.0, 1.0)}
    for function in (steady.is_steady, steady.phases):
        namespace[function.__name__] = FunctionType(function.__code__, namespace)
    start, _ = start_of(LEAN, m, FIXED, n, vectors=(LEAN,))
    assert namespace["is_steady"](start, (), Motion(LEAN, m, FIXED, n), 4.0, False)
    angle = -2 * np.pi * np.arange(1, 4 * (p + q) + 2) / (4 * (p + q) + 1)
    np.testing.assert_allclose(
        nodes, np.transpose([np.sign(n) * p * angle, np.sign(m) * q * angle]), rtol=1e-14
    )
