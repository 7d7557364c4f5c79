"""Stability by the energy: second variations by difference quotients, and the classical diagrams."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.linalg import null_space
from scipy.spatial.transform import Rotation
from truth import default_points

import atlas
from atlas.flags import EnergyStability, Stability, StabilityKind
from atlas.systems.fixed_point import FIXED_POINT
from atlas.systems.gyrostat.body import Body, Direction
from atlas.systems.gyrostat.oscillations import Equilibria
from atlas.systems.gyrostat.system import stability_kind
from atlas.systems.satellite import SATELLITE

pytestmark = pytest.mark.usefixtures("whole_kernels")

YES, NO, UNKNOWN = EnergyStability.YES, EnergyStability.NO, EnergyStability.UNKNOWN
AXIAL = StabilityKind.ENERGY_STABLE_AXIAL
SIGNED_PERMUTATIONS = np.array(
    [np.eye(3), np.roll(np.eye(3), 1, 0), np.roll(np.eye(3), 2, 0), [[0, -1, 0], [1, 0, 0], [0, 0, 1]]]
)


def derived(system, name, points):
    return system.derived[name].values(points, np.ones(len(points["A"])), lambda: None)


def linear(system, points):
    return system.linear_stability(points, system.identify_family(points)[0])[0]


def second_differences(function, size, step=1e-3):
    """Hessian of a function of `size` variables at 0."""
    hessian = np.zeros((size, size))
    for i in range(size):
        for j in range(size):
            e, f = np.eye(size)[i] * step, np.eye(size)[j] * step
            ahead = function(e + f) + function(-e - f)
            hessian[i, j] = (ahead - function(e - f) - function(f - e)) / (4 * step**2)
    return hessian


def jacobi_hessian(points, constant=()):
    """Second variation of the Jacobi integral in the changes of w and a rotation of the body, but for the constant ones.

    Where the momentum about the third axis is an integral, (2, 5): it is kept, and the angle about that axis is left out.
    """
    p = {name: value[0] for name, value in points.items()}
    inertia = np.array([p["A"], p["B"], p["C"]])
    k, mu = (np.array([p[f"{name}{i}"] for i in (1, 2, 3)]) for name in ("k", "mu"))
    w, alpha, gamma = np.split(SATELLITE.initial_state(points)[:, 0], 3)
    varied = [i for i in range(6) if i not in constant]

    def jacobi(change):
        full = np.zeros(6)
        full[varied] = change
        x, (a, b, c) = w + full[:3], full[3:]
        hat = np.array([[0, -c, b], [c, 0, -a], [-b, a, 0]])
        turn = np.eye(3) + hat + hat @ hat / 2 + hat @ hat @ hat / 6 + hat @ hat @ hat @ hat / 24
        r, g = alpha @ turn, gamma @ turn
        kinetic = 0.5 * inertia @ x**2 - p["Omega"] * g @ (inertia * x + k)
        return kinetic + 1.5 * p["Omega"] ** 2 * inertia @ r**2 + mu @ (p["h1"] * r + p["h3"] * g)

    return second_differences(jacobi, len(varied))


@pytest.mark.extension("equilibria")
def test_satellites_at_rest_have_the_second_variation_of_their_jacobi_integral():
    rng = np.random.default_rng(0)
    flags = []
    for _ in range(4):
        body = dict(zip("ABC", 1 + 0.7 * rng.uniform(size=3), strict=True)) | {
            "Omega": 0.9,
            "h1": 0.4,
            "h3": -0.2,
        }
        body |= {f"{name}{i}": 0.4 * rng.normal() for name in ("k", "mu") for i in (1, 2, 3)}
        ds = atlas.equilibria("satellite", body)
        for i in range(ds.sizes["equilibrium"]):
            angles = {name: ds[name].values[i] for name in ("theta0", "psi0", "phi0")}
            points = default_points("satellite", **body, **angles)
            least = np.linalg.eigvalsh(jacobi_hessian(points))[0]
            assert abs(least) > 1e-4
            assert derived(SATELLITE, "energy_stable", points)[0] == (YES if least > 0 else NO)
            flags.append((derived(SATELLITE, "stability_kind", points)[0], linear(SATELLITE, points)[0]))
    assert {kind for kind, _ in flags} == {
        StabilityKind.ENERGY_STABLE, StabilityKind.GYROSCOPIC, StabilityKind.UNSTABLE,
    }  # fmt: skip
    assert all((kind == StabilityKind.UNSTABLE) == (stable == Stability.UNSTABLE) for kind, stable in flags)


@pytest.mark.usual("0.0")
@pytest.mark.parametrize("psi0", [0.0, np.pi / 2])
def test_spinning_satellites_have_it_on_the_level_of_their_momentum(psi0):
    rng = np.random.default_rng(1)
    flags = set()
    for _ in range(20):
        sigma, theta, m = rng.uniform(0.2, 1.9), rng.uniform(0.2, 2.8), 2 * rng.normal()
        factor = 1.0 if psi0 == 0.0 else 4.0
        k3 = factor * np.cos(theta) * (1 - sigma) - sigma * m
        points = default_points("satellite", C=sigma, theta0=theta, psi0=psi0, m=m, k3=k3)
        assert SATELLITE.identify_family(points)[0] > 0
        least = np.linalg.eigvalsh(jacobi_hessian(points, (2, 5)))[0]
        # Dissipation inside the body changes the momentum: a spinning satellite is no minimum without it.
        assert derived(SATELLITE, "energy_stable", points)[0] == NO
        kind = derived(SATELLITE, "stability_kind", points)[0]
        energy = YES if kind == AXIAL else NO
        assert energy == (YES if least > 0 else NO)
        # Damping destroys the momentum: at rest all changes but the angle of symmetry count.
        damped = points | {"m": np.zeros(1), "k3": points["k3"] + sigma * m, "damping": np.full(1, 0.2)}
        least = np.linalg.eigvalsh(jacobi_hessian(damped, (5,)))[0]
        damped_energy = derived(SATELLITE, "energy_stable", damped)[0]
        assert damped_energy == (YES if least > 0 else NO)
        flags.add((energy, damped_energy))
    assert flags == {(YES, YES if psi0 else NO), (NO, NO)}


def test_the_gravity_gradient_diagram():
    """C > B > A: by the energy; the region of DeBra and Delp: gyroscopic; elsewhere unstable."""
    rng = np.random.default_rng(2)
    k1, k3 = rng.uniform(-0.95, 0.95, (2, 4000))
    A = (1 - k1) / (1 - k3)
    points = default_points("satellite", A=A, B=np.ones(4000), C=A + k1)
    kind = derived(SATELLITE, "stability_kind", points)
    lagrange = (points["C"] > 1) & (A < 1)
    with np.errstate(invalid="ignore"):
        roll_yaw = (k1 * k3 > 0) & (1 + 3 * k1 + k1 * k3 > 4 * np.sqrt(k1 * k3)) & (k1 > k3)
    assert (kind[lagrange] == StabilityKind.ENERGY_STABLE).all()
    assert (kind[roll_yaw & ~lagrange] == StabilityKind.GYROSCOPIC).all()
    assert (kind[~roll_yaw] == StabilityKind.UNSTABLE).all()
    assert min(lagrange.sum(), (roll_yaw & ~lagrange).sum()) > 20


def test_the_diagram_of_likins_and_thomson():
    """b = C (1 + m/Omega)/A: by the energy where b > 1 and b + 3 C/A > 4."""
    rng = np.random.default_rng(3)
    sigma, b = rng.uniform(0.05, 2.0, 2000), rng.uniform(-4, 4, 2000)
    points = default_points("satellite", C=sigma, m=b / sigma - 1)
    assert (derived(SATELLITE, "energy_stable", points) == NO).all()
    kind = derived(SATELLITE, "stability_kind", points)
    assert ((kind == AXIAL) == ((b > 1) & (b + 3 * sigma > 4))).all()
    assert ((kind == StabilityKind.UNSTABLE) == (linear(SATELLITE, points) == Stability.UNSTABLE)).all()
    assert (kind == StabilityKind.GYROSCOPIC).any()


@pytest.mark.long
@pytest.mark.extension("equilibria")
def test_permanent_rotations_have_the_second_variation_on_the_leaf():
    """Of energy - n M.gamma - a gamma^2 / 2 on the tangents of |gamma| and M.gamma, M = I w + l."""
    rng = np.random.default_rng(4)
    kinds = set()
    for _ in range(8):
        body = dict(zip("ABC", 1 + 0.9 * rng.uniform(size=3), strict=True)) | {
            "Mg": 1.0,
            "N": 0.3,
            "n": 2 * rng.normal(),
        }
        body |= {f"{name}0": rng.normal() for name in "xyz"} | {f"l{i}": rng.normal() for i in (1, 2, 3)}
        ds = atlas.equilibria("fixed_point", body)
        for i in range(ds.sizes["equilibrium"]):
            points = default_points("fixed_point", **body, theta0=ds.theta0.values[i], phi0=ds.phi0.values[i])
            state, constants = FIXED_POINT.initial_state(points)[:, 0], FIXED_POINT.constants(points)[:, 0]
            inertia = np.array([body["A"], body["B"], body["C"]])
            momentum = inertia * state[:3] + np.array([body["l1"], body["l2"], body["l3"]])
            gamma, n = state[3:], body["n"]

            def energy(change, state=state, inertia=inertia, constants=constants):
                moved = state + np.concatenate([change[:3] / inertia, change[3:]])
                return sum(FIXED_POINT.equations.energy(moved, constants))

            gradient = np.array([(energy(1e-4 * e) - energy(-1e-4 * e)) / 2e-4 for e in np.eye(6)])
            a = gamma @ (gradient[3:] - n * momentum)
            np.testing.assert_allclose(gradient[3:], a * gamma + n * momentum, atol=1e-7)
            hessian = second_differences(energy, 6)
            hessian[:3, 3:] -= n * np.eye(3)
            hessian[3:, :3] -= n * np.eye(3)
            hessian[3:, 3:] -= a * np.eye(3)
            tangent = null_space(np.array([[0, 0, 0, *gamma], [*gamma, *momentum]]))
            least = np.linalg.eigvalsh(tangent.T @ hessian @ tangent)[0]
            assert abs(least) > 1e-5
            value = derived(FIXED_POINT, "energy_stable", points)[0]
            assert value == (YES if least > 0 else NO)
            kinds.add(derived(FIXED_POINT, "stability_kind", points)[0])
    assert kinds == {StabilityKind.ENERGY_STABLE, StabilityKind.GYROSCOPIC, StabilityKind.UNSTABLE}


def test_sleeping_tops_and_free_bodies():
    spin = np.array([1.0, 5.0])
    points = default_points("fixed_point", C=0.6, Mg=2.0, z0=-0.7, m=spin)
    assert derived(FIXED_POINT, "energy_stable", points).tolist() == [NO, NO]
    assert derived(FIXED_POINT, "stability_kind", points).tolist() == [StabilityKind.UNSTABLE, AXIAL]
    free = default_points(
        "fixed_point",
        A=np.array([1.0, 2.0, 1.0]),
        B=np.array([1.4, 1.6, 2.0]),
        C=np.full(3, 1.5),
        m=1.0,
        theta0=0.4,
    )
    assert derived(FIXED_POINT, "energy_stable", free).tolist() == [YES, NO, NO]
    kinds = [StabilityKind.ENERGY_STABLE, StabilityKind.GYROSCOPIC, StabilityKind.UNSTABLE]
    assert derived(FIXED_POINT, "stability_kind", free).tolist() == kinds


@pytest.mark.long
def test_free_spins_with_dissipation_at_constant_angular_momentum():
    """M' = M x w + M x (M x w) keeps |M| and lowers the energy: a spin about the greatest moment stays, every other one leaves."""
    rng, every = np.random.default_rng(11), np.ones(100, np.int8)
    inertia, rotor, spin = np.empty((3, 100)), np.zeros((3, 100)), np.zeros((3, 100))
    for i in range(100):
        axis, others = i % 3, [(i + 1) % 3, (i + 2) % 3]
        far = 0.0
        while far < 0.03:  # from a border of stability
            inertia[:, i] = 1 + 0.9 * rng.random(3)
            if i % 4 == 0:  # about its axis of symmetry
                inertia[others[0], i] = inertia[others[1], i]
            spin[axis, i], rotor[axis, i] = rng.choice([-1.0, 1.0]), rng.normal() * (i % 8 < 3)
            momentum = inertia[axis, i] * spin[axis, i] + rotor[axis, i]
            far = np.abs(1 / inertia[others, i] - spin[axis, i] / momentum).min() * min(momentum**2, 1.0)
    given = dict(zip((*"ABC", "l1", "l2", "l3", "p0", "q0", "r0"), [*inertia, *rotor, *spin], strict=True))
    given |= dict(zip(("gamma10", "gamma20", "gamma30"), rng.normal(size=(3, 100)), strict=True))
    points = default_points("fixed_point", **given, Mg=0.0, N=0.0)
    start = inertia * spin + rotor
    M = start + 1e-3 * rng.normal(size=start.shape)
    size = np.linalg.norm(M, axis=0)

    def slope(M):
        torque = np.cross(M, (M - rotor) / inertia, axis=0)
        return torque + np.cross(M, torque, axis=0)

    h = 0.05
    for _ in range(10000):
        a = slope(M)
        b = slope(M + h / 2 * a)
        c = slope(M + h / 2 * b)
        M = M + h / 6 * (a + 2 * b + 2 * c + slope(M + h * c))
    np.testing.assert_allclose(np.linalg.norm(M, axis=0), size, rtol=1e-3)
    left = np.linalg.norm(M / size - start / np.linalg.norm(start, axis=0), axis=0) > 0.05
    assert 20 < left.sum() < 80
    verdict = FIXED_POINT.energy_stability(points, every)
    np.testing.assert_array_equal(verdict, np.where(left, NO, YES))
    held, axial = FIXED_POINT.conservative_stability(points, every)
    assert (held[~left] == YES).all()
    np.testing.assert_array_equal(axial, np.arange(100) % 4 == 0)


def slope_with_ball(system, body, ball, drag):
    """Of the body without a ball in it that turns at s against a viscous fluid: w, s and the directions of the frame."""
    moments = np.array([body[name] for name in "ABC"])
    names = ("k", "mu") if system is SATELLITE else ("l",)
    rotor, *field = (np.array([body.get(f"{name}{i}", 0.0) for i in (1, 2, 3)]) for name in names)
    turn, inertia = body.get("Omega", 0.0), moments - ball
    weight = body.get("Mg", 0.0) * np.array([body.get(f"{name}0", 0.0) for name in "xyz"])

    def slope(y):
        w, s, *directions = y.reshape(-1, 3)
        gamma = directions[-1]
        if system is SATELLITE:
            (mu,), alpha = field, directions[0]
            torque = np.cross(alpha, 3 * turn**2 * moments * alpha + body["h1"] * mu)
            torque += np.cross(gamma, body["h3"] * mu)
        else:
            torque = np.cross(gamma, body["N"] * moments * gamma - weight)
        friction, u = drag * (w - s), w - turn * gamma
        w_dot = (np.cross(inertia * w + rotor, w) + torque - friction) / inertia
        turned = [np.cross(direction, u) for direction in directions]
        return np.concatenate([w_dot, np.cross(s, w) + friction / ball, *turned])

    return slope


@pytest.mark.long
@pytest.mark.extension("equilibria")
def test_a_damper_in_the_body_leaves_minima_alone():
    """Tops and satellites with a ball that turns against a viscous fluid in them, a pervasive internal damper, linearised.

    The motions are steady with it, and stable where the energy of the whole body has a minimum (Kelvin, Tait and Chetaev).
    """
    rng = np.random.default_rng(14)
    verdicts_met = set()
    for trial in range(20):
        moments = 1 + 0.9 * rng.random(3)
        symmetric, system = bool(trial % 2), (FIXED_POINT, SATELLITE)[trial // 2 % 2]
        if symmetric:
            moments[1] = moments[0]
        body = dict(zip("ABC", moments, strict=True))
        if system is SATELLITE:
            body |= {"Omega": 0.9, "h1": 0.4, "h3": -0.2}
            given = ("k3", "mu3") if symmetric else ("k1", "k2", "k3", "mu1", "mu2", "mu3")
            body |= {name: (1.0 if symmetric else 0.5) * rng.normal() for name in given}
        else:
            body |= {"Mg": 1.0, "N": 0.3 * (trial % 3 == 0), "n": 2 * rng.normal()}
            given = ("z0", "l3") if symmetric else ("x0", "y0", "z0", "l1", "l2", "l3")
            body |= {name: rng.normal() for name in given}
        ds = atlas.equilibria(system.name, body)
        for i in range(ds.sizes["equilibrium"]):
            start = {name: ds[name].values[i] for name in ("theta0", "psi0", "phi0") if name in ds}
            points = system.with_defaults(body | start)
            state = system.initial_state(points)[:, 0]
            state = np.concatenate([state[:3], state])
            slope = slope_with_ball(system, body, 0.3 * moments.min(), 0.5)
            assert np.abs(slope(state)).max() < 1e-8
            steps = 1e-6 * np.eye(len(state))
            matrix = np.array([(slope(state + h) - slope(state - h)) / 2e-6 for h in steps]).T
            growth = np.linalg.eigvals(matrix).real.max()
            every = np.ones(1, np.int8)
            verdict = system.energy_stability(points, every)[0]
            assert verdict == (NO if growth > 1e-5 else YES), (trial, i, growth)
            held, axial = system.conservative_stability(points, every)
            verdicts_met.add((system.name, verdict, held[0], bool(axial[0])))
    both = {(YES, YES, False), (NO, NO, False), (YES, YES, True), (NO, YES, True)}
    assert {(name, *verdicts) for name in ("satellite", "fixed_point") for verdicts in both} <= verdicts_met


@pytest.mark.parametrize("system", ["fixed_point", "satellite"])
def test_the_word_does_not_flip_beside_a_symmetric_body(system):
    """A spin about the least moment, and one about the greatest (Explorer 1)."""
    given = {"Mg": 0.0} if system == "fixed_point" else {"Omega": 1.08e-3}
    for B in (1.0, 1.0001):
        points = default_points(system, B=B, C=np.array([0.5, 1.5]), m=1.0, **given)
        energy = derived(atlas.systems.get(system), "energy_stable", points).tolist()
        if system == "fixed_point":
            assert energy == [NO, YES]
            kinds = derived(FIXED_POINT, "stability_kind", points)
            assert kinds.tolist() == [
                AXIAL if B == 1.0 else StabilityKind.GYROSCOPIC,
                StabilityKind.ENERGY_STABLE,
            ]
        elif B == 1.0:
            assert energy == [NO, NO]
            assert (derived(SATELLITE, "stability_kind", points) == AXIAL).all()


def test_nothing_is_claimed_off_families_and_of_periodic_equations():
    off = default_points("satellite", B=1.3, C=1.7, theta0=0.3)
    assert derived(SATELLITE, "stability_kind", off)[0] == StabilityKind.UNKNOWN
    beside = default_points("satellite", B=1.3, C=1.7, theta0=1e-8)
    assert SATELLITE.identify_family(beside)[0] == 0
    assert derived(SATELLITE, "energy_stable", beside)[0] == UNKNOWN
    tilted = default_points("satellite", B=1.3, C=1.7, theta0=np.pi / 3, psi0=np.pi / 2, m=-1.0, k3=0.6)
    assert derived(SATELLITE, "energy_stable", tilted)[0] == UNKNOWN
    stable = linear(SATELLITE, tilted)[0] == Stability.STABLE
    expected = StabilityKind.LINEARLY_STABLE if stable else StabilityKind.UNSTABLE
    assert derived(SATELLITE, "stability_kind", tilted)[0] == expected


@pytest.mark.long
def test_verdicts_on_a_sphere_do_not_depend_on_its_axes():
    rng = np.random.default_rng(7)
    drawings = np.concatenate([SIGNED_PERMUTATIONS, Rotation.random(3, random_state=7).as_matrix()])
    for trial in range(60):
        alpha, gamma = Rotation.random(random_state=trial).as_matrix()[:2]
        line = (np.eye(3)[trial % 3], gamma, alpha, np.array([0.6, 0.0, 0.8]))[trial % 4]
        rotor, field = rng.normal(size=(2, 1)) * line * (rng.random((2, 1)) < 0.5)
        turn = rng.uniform(0.3, 1.5)
        w = turn * gamma
        if trial % 2:  # a top that precesses at a rate N: N (m + rotor) = field along the line
            rate = rng.normal()
            w = rate * gamma + (field / rate - rotor)
        verdicts = set()
        for axes in drawings:
            vectors = (axes @ v for v in (rotor, field, w, alpha, gamma))
            k, h, *start = (np.array([v]) for v in vectors)
            body = Body(
                np.ones((1, 3)), k, np.array([turn]), Direction(np.full(1, 3 * turn**2), 0 * h),
                Direction(np.zeros(1), 0 * h), Direction(np.zeros(1), h), np.zeros(1),
            )  # fmt: skip
            in_space, by_energy = (Equilibria.of(body, *start, from_space=x) for x in (True, False))
            known = in_space.points.size > 0
            verdicts.add((in_space.stability()[0][0], by_energy.energy_stability()[0]) if known else None)
        assert len(verdicts) == 1, (trial, verdicts)


def test_free_spheres_are_stable():
    half = np.array([0.0, 0.5 * np.pi])
    points = default_points("satellite", C=1.0, theta0=np.pi / 2, psi0=np.pi / 2, phi0=half)
    assert (linear(SATELLITE, points) == Stability.STABLE).all()
    assert (derived(SATELLITE, "energy_stable", points) == YES).all()


def test_marginal_motions():
    """A sphere at rest in space has nothing but zero exponents; at b = 1 the cylindrical motion has a zero pair."""
    sphere = default_points("satellite", C=1.0, Omega=0.0)
    assert derived(SATELLITE, "stability_kind", sphere)[0] == StabilityKind.MARGINAL
    border = default_points("satellite", C=1.25, m=-0.2)
    assert derived(SATELLITE, "stability_kind", border)[0] == StabilityKind.MARGINAL
    stable, growth = (
        [Stability.STABLE, Stability.STABLE, Stability.UNKNOWN, Stability.UNKNOWN],
        [0, 0, 0, np.nan],
    )
    kinds = stability_kind(np.array(stable), np.array(growth), np.array([UNKNOWN, NO, NO, NO]))
    axial = np.array([False, True, False, False])
    assert (
        stability_kind(np.array(stable), np.array(growth), np.array([UNKNOWN, NO, NO, NO]), axial)[1] == AXIAL
    )
    expected = ["LINEARLY_STABLE", "GYROSCOPIC", "MARGINAL", "UNKNOWN"]
    np.testing.assert_array_equal(kinds, [StabilityKind[name] for name in expected])


def test_scenes_and_points_write_flags():
    ds = atlas.label_points(
        "satellite",
        {"A": 1.0, "B": 1.3, "C": 1.7},
        duration=1.0,
        variables=["energy_stable", "stability_kind", "frequency_1"],
    )
    assert ds.energy_stable.dtype == ds.stability_kind.dtype == np.int8
    assert ds.stability_kind.attrs["flag_meanings"].split()[1:3] == ["energy_stable", "gyroscopic"]
    assert ds.stability_kind.attrs["flag_meanings"].split()[-1] == "energy_stable_axial"
    assert ds.energy_stable.attrs["flag_meanings"] == "unknown yes no"
    assert ds.stability_kind.item() == StabilityKind.ENERGY_STABLE
