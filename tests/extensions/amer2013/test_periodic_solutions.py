"""Exact periodic solutions: against DOP853 with variational equations, harmonic collocation and closed forms."""

import numpy as np
import pytest
from strategies import default_points
from truth import jacobian_matrices, monodromy_matrix

import atlas
from atlas.extensions.amer2013 import fast_spin, periodic, published
from atlas.flags import PeriodicSolution
from atlas.systems.fixed_point import equations, initial

pytestmark = pytest.mark.usefixtures("whole_kernels")


def gyrostats(eps, rotor, C, z0=1.0, N=0.0, gamma0=0.352):
    """Bodies with A = 1 and the rotor l1 = l2 = l3 = rotor A r0, in the unit c sqrt(gamma0'') = 1 of p and q."""
    eps, rotor, C, z0, N = (
        np.ravel(x).astype(float) for x in np.broadcast_arrays(*map(np.atleast_1d, (eps, rotor, C, z0, N)))
    )
    momentum, one = rotor / eps, np.ones_like(eps)
    return fast_spin.FastSpin(
        one, C, z0 * C / gamma0, N, momentum, momentum, momentum, 1 / eps, gamma0
    ).of_shape(eps.shape)


# eps, rotor, C, z0', N: fast and slow, stable and unstable
CASES = [
    (0.003, 0.01, 1.58, 1.0, 0.0),
    (0.1, 0.05, 1.3, -1.0, 0.0),
    (0.2, 0.05, 1.5, 1.0, 1.0),
    (0.1, 0.1, 0.8, -1.0, 0.0),
    (0.4, 0.1, 1.2, -1.0, 0.0),
    (0.3, 0.1, 0.39, -1.0, 0.0),
]
SPINS = gyrostats(*np.array(CASES).T)


@pytest.fixture(scope="module")
def orbits():
    return periodic.solutions(SPINS)


def case(i):
    """The body of a case."""
    return fast_spin.FastSpin(*(getattr(SPINS, name)[i] for name in SPINS.__dataclass_fields__))


def in_dimensions(spin):
    """Units of the state, and constants of the equations of motion."""
    given = {"A": 1.0, "B": 1.0, "C": spin.C, "Mg": abs(spin.weight), "z0": spin.z, "N": spin.N}
    given |= {name: getattr(spin, name) for name in ("l1", "l2", "l3")}
    points = default_points("fixed_point", 1, **given)
    return fast_spin.dimensional(spin, np.ones(6)), initial.constants(points)[:, 0]


@pytest.mark.long
def test_cases_are_stable_and_unstable(orbits):
    stable, unstable = PeriodicSolution.STABLE, PeriodicSolution.UNSTABLE
    assert list(orbits.stability) == [stable, stable, stable, unstable, unstable, unstable]
    assert orbits.trace[5] < -2  # by parametric resonance
    assert orbits.trace[3:5].min() > 2


@pytest.mark.parametrize("i", range(len(CASES)))
def test_against_dop853_and_the_variational_equations(i, orbits):
    """The equations of motion themselves return to the start, and their monodromy matrix has the trace."""
    spin = case(i)
    unit, constants = in_dimensions(spin)
    state, duration = unit * orbits.start[:, i], float(orbits.period[i] / SPINS.r0[i])
    matrix = monodromy_matrix(equations.rhs, state, constants, duration)
    assert np.trace(matrix) - 4 == pytest.approx(orbits.trace[i], abs=1e-8)
    multipliers = np.linalg.eigvals(matrix / unit[:, None] * unit)
    assert np.sort(np.abs(multipliers - 1))[3] < 1e-3  # four of them; a double one has the root of the error
    exact = fast_spin.integrate(spin, orbits.start[:, i], np.array([0.0, orbits.period[i]]))
    np.testing.assert_allclose((exact[:, 1] - exact[:, 0]) * unit / unit[2], 0, atol=2e-9)


def collocation(spin, y, frequency):
    """States at equal instants of a period, its frequency and Hill's exponents, from a guess, by Newton's method.

    A trigonometric polynomial satisfies the equations of motion at its instants: no initial-value problem is solved.
    """
    unit, constants = in_dimensions(spin)
    r0, count = float(spin.r0), y.shape[1]
    waves = 1j * np.fft.fftfreq(count, 1 / count)[:, None]
    derivative = np.fft.ifft(waves * np.fft.fft(np.eye(count), axis=0), axis=0).real
    scale = np.array([spin.eps, spin.eps, 1, 1, 1, 1])
    unit = unit / scale  # of states in which eps p1 and eps q1 are of order 1
    z, columns = y * scale[:, None], np.tile(constants[:, None], count)

    def conditions(start):
        """What vanishes at the first instant: r1 - 1, g1'' - 1, the error of |gamma|^2 and gamma2'."""
        phase = fast_spin.to_quasilinear(spin, start / scale)[3]
        return np.array([start[2] - 1, start[5] - 1, (start[3:] ** 2).sum() - spin.gamma0**-2, phase])

    def linear(z):
        matrices = (
            jacobian_matrices(equations.rhs, unit[:, None] * z, constants[:, None]) * unit / unit[:, None]
        )
        return np.moveaxis(matrices / r0, 0, -1)

    def operator(z):
        diagonal = np.einsum("abt,ts->atbs", linear(z), np.eye(count))
        turning = np.einsum("ab,ts->atbs", np.eye(6), frequency * derivative)
        return (diagonal - turning).reshape(6 * count, 6 * count)

    for _ in range(15):
        rate = np.array(equations.rhs(unit[:, None] * z, columns)) / unit[:, None] / r0
        moving = z @ derivative.T
        first = np.zeros((4, 6, count))
        first[:, :, 0] = np.array(
            [(conditions(z[:, 0] + 1e-4 * e) - conditions(z[:, 0] - 1e-4 * e)) / 2e-4 for e in np.eye(6)]
        ).T
        matrix = np.block([[operator(z), -moving.reshape(-1, 1)], [first.reshape(4, -1), np.zeros((4, 1))]])
        error = np.concatenate([(rate - frequency * moving).ravel(), conditions(z[:, 0])])
        change = np.linalg.lstsq(matrix, -error, rcond=1e-13)[0]
        z, frequency = z + change[:-1].reshape(6, count), frequency + change[-1]
        if np.abs(change).max() < 1e-11:
            return z / scale[:, None], frequency, np.linalg.eigvals(operator(z))
    raise AssertionError("no convergence")


@pytest.mark.parametrize("i", range(len(CASES)))
def test_against_harmonic_collocation(i, orbits):
    spin, count = case(i), 41
    phase = 2 * np.pi * np.arange(count) / count
    if i < 3:
        guess, frequency = fast_spin.first_order(spin, phase), 1.0
    else:  # far from the first order: the path that shooting gives, disturbed
        frequency = 2 * np.pi / orbits.period[i]
        guess = fast_spin.integrate(spin, orbits.start[:, i], phase / frequency)
        guess, frequency = (
            guess * (1 + 1e-2 * np.random.default_rng(i).normal(size=guess.shape)),
            1.01 * frequency,
        )
    y, frequency, exponents = collocation(spin, guess, frequency)
    assert 2 * np.pi / frequency == pytest.approx(orbits.period[i], abs=1e-9)
    scale = np.array([spin.eps, spin.eps, 1, 1, 1, 1])
    np.testing.assert_allclose(y[:, 0] * scale, orbits.start[:, i] * scale, atol=1e-9)
    traces = 2 * np.cosh(exponents * orbits.period[i])
    assert np.abs(traces - orbits.trace[i]).min() < 1e-6


@pytest.mark.usual("1.5")
@pytest.mark.parametrize(("C", "z0", "N"), [(1.5, 1.0, 0.0), (0.6, -1.0, 0.0), (1.3, -1.0, 0.5)])
def test_without_a_transverse_rotor_it_is_the_regular_precession(C, z0, N):
    """Rate, period and nutation frequency in closed form, up to the spin at which the precession ends."""
    eps = np.array([0.05, 0.2, 0.3])
    spin = gyrostats(eps, 0.1, C, z0, N)
    spin = fast_spin.FastSpin(
        *(getattr(spin, f) * (f not in ("l1", "l2")) for f in spin.__dataclass_fields__)
    )
    reached = periodic.solutions(spin)
    c, momentum, field = spin.gamma0, spin.C * spin.r0 + spin.l3, spin.weight - spin.N * (C - 1) * spin.gamma0
    n = (momentum - np.sqrt(momentum**2 + 4 * c * field)) / (2 * c)
    nutation = (n**2 + spin.N * (C - 1)) * (1 - c**2) + (momentum - 2 * n * c) ** 2
    turning = spin.r0 - n * c
    np.testing.assert_allclose(reached.period, 2 * np.pi * spin.r0 / turning, atol=1e-9)
    np.testing.assert_allclose(reached.trace, 2 * np.cos(2 * np.pi * np.sqrt(nutation) / turning), atol=1e-7)
    np.testing.assert_allclose(spin.scale * reached.start[0], n * np.sqrt(1 - c**2), rtol=1e-8)


@pytest.mark.long
def test_an_upright_top_has_the_solution_while_its_precession_exists():
    """(C r0 + l3)^2 > 4 A Mg |z0| cos theta0, without a transverse rotor."""
    limit = np.sqrt((0.7 + 0.1) ** 2 / (4 * 0.7))  # at a tilt for which no nutation is in resonance before
    spin = gyrostats(limit * np.array([0.9, 0.98, 1.02, 1.1]), 0.1, 0.7, -1.0, gamma0=0.95)
    spin = fast_spin.FastSpin(
        *(getattr(spin, f) * (f not in ("l1", "l2")) for f in spin.__dataclass_fields__)
    )
    reached = periodic.solutions(spin).stability != PeriodicSolution.NOT_REACHED
    assert list(reached) == [True, True, False, False]


@pytest.mark.long
def test_shooting_from_the_printed_solution_leads_to_the_same_orbit():
    """The printed (33) lacks the forced part, and both starts differ from the orbit by their orders."""
    spin = gyrostats([0.002, 0.02], 0.01, 1.58)
    exact = periodic.solutions(spin)
    distances = []
    for module in (published, fast_spin):
        y = module.first_order(spin, np.zeros(2))
        x = np.array([spin.eps * y[0], spin.eps * y[1], np.arctan2(y[4], y[3]), np.full(2, 2 * np.pi)])
        distances.append(np.abs(spin.eps * (y - exact.start))[0])
        x, defect = periodic.correct(spin, x, 6)
        assert defect.max() < 1e-9
        np.testing.assert_allclose(
            periodic.of_unknowns(spin, x).start * spin.eps, exact.start * spin.eps, atol=1e-9
        )
    np.testing.assert_allclose(distances[0], np.abs(spin.eps * spin.forced.real), rtol=0.05)
    assert np.all(distances[1] < 0.05 * distances[0])


def test_first_order_differs_from_the_exact_solution_by_second_order():
    spin = gyrostats([0.002, 0.001], [0.01, 0.005], 1.58)
    exact = periodic.solutions(spin)
    error = np.abs(fast_spin.first_order(spin, np.zeros(2)) - exact.start)[[0, 1, 3, 4]]
    error = np.vstack([error * spin.eps ** np.array([1, 1, 0, 0])[:, None], exact.period - 2 * np.pi])
    assert np.all(error[:, 1] < 0.3 * np.abs(error[:, 0]) + 1e-11)
    np.testing.assert_allclose(exact.period - 2 * np.pi, fast_spin.period_correction(spin), rtol=0.03)


@pytest.mark.long
def test_near_the_resonance_omega_1_the_path_ends_in_a_fold():
    """rho comes to 1, and the solution moves ever faster with the field; bodies beside it have the solution."""
    share = np.array([0.02, 0.06, 0.08, 0.086, 0.1])
    spin = gyrostats(0.1 * np.sqrt(share), 0.1, 1.91, -1.0)
    assert spin.Omega == pytest.approx(np.full(5, 1.01))
    reached = periodic.solutions(spin)
    assert list(reached.stability) == [
        *3 * [PeriodicSolution.STABLE], PeriodicSolution.UNSTABLE, PeriodicSolution.NOT_REACHED,
    ]  # fmt: skip
    speed = np.abs(np.diff(spin.eps * reached.start[1]) / np.diff(share))[:3]
    assert np.all(np.diff(speed) > 0)
    assert speed[2] > 3 * speed[0]
    assert np.all(np.diff(reached.trace[:4]) > 0)
    beside = periodic.solutions(gyrostats(0.1, 0.1, [1.88, 1.95], -1.0))
    assert list(beside.stability) == 2 * [PeriodicSolution.STABLE]


@pytest.mark.usual("0.75", "0.86")
@pytest.mark.parametrize(
    ("C", "stable"), [(0.70, True), (0.75, True), (0.78, False), (0.86, False), (0.95, True)]
)
def test_an_unstable_band_remains_for_the_fastest_spin(C, stable):
    """The free gyrostat: Omega^2 + (l3 / A r0) a |eps mu|^2 / Omega < 0, though omega'^2 > 0 as printed."""
    spin = gyrostats(1e-3, 0.1, C)
    squared = spin.Omega**2 + 0.1 * spin.a * np.abs(spin.eps * spin.mu) ** 2 / spin.Omega
    assert (squared[0] > 0) == stable
    assert published.frequency_squared(spin)[0] > 0
    reached = periodic.solutions(spin)
    assert reached.stability[0] == (PeriodicSolution.STABLE if stable else PeriodicSolution.UNSTABLE)
    size = np.sqrt(1 + np.abs(spin.eps * spin.forced) ** 2)  # of the angular velocity, over r0
    assert reached.trace[0] == pytest.approx(
        2 * np.cos(2 * np.pi * np.emath.sqrt(squared)[0] / size[0]).real, abs=1e-4
    )


@pytest.mark.long
def test_unstable_solutions_are_left_and_stable_ones_are_not(orbits):
    """The full equations from a start beside the exact one."""
    for i in (1, 3, 5):
        spin, start = case(i), orbits.start[:, i].copy()
        start[0] += 1e-6 / spin.eps
        turns = np.arange(45) * orbits.period[i]
        y = fast_spin.integrate(spin, start, turns)
        distance = spin.eps * np.abs(y[0] - orbits.start[0, i])
        assert (distance.max() > 1e-4) == (orbits.stability[i] == PeriodicSolution.UNSTABLE)


# Variables of an atlas.


@pytest.mark.long
def test_a_scene_contains_stability_period_and_trace():
    ds = atlas.label_points(
        "fixed_point",
        {"A": 1.0, "B": 1.0, "C": np.array([1.2, 0.8, 1.2]), "Mg": np.array([1.2, 0.8, 1.2]) / 0.352, "z0": -1.0,
         "l1": np.array([1.0, 1.0, 0.005]), "l2": np.array([1.0, 1.0, 0.005]), "l3": np.array([1.0, 1.0, 0.005]),
         "m": np.array([10.0, 10.0, 0.05]), "theta0": np.arccos(0.352)},
        duration=0.1, variables=["periodic_stability", "periodic_period", "periodic_trace"],
    )  # fmt: skip
    expected = periodic.solutions(gyrostats([0.1, 0.1, 20.0], 0.1, [1.2, 0.8, 1.2], -1.0))
    np.testing.assert_array_equal(ds.periodic_stability, expected.stability)
    assert list(ds.periodic_stability.values) == [
        PeriodicSolution.STABLE, PeriodicSolution.UNSTABLE, PeriodicSolution.NOT_REACHED,
    ]  # fmt: skip
    np.testing.assert_allclose(ds.periodic_period, expected.period * np.array([0.1, 0.1, 20.0]), rtol=1e-9)
    np.testing.assert_allclose(ds.periodic_trace, expected.trace, rtol=1e-7)


def test_an_interruption_ends_the_shooting():
    class Interruption(Exception):
        pass

    def pause():
        raise Interruption

    with pytest.raises(Interruption):
        periodic.solutions(SPINS, pause)
