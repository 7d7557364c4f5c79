"""Reference results that are independent of the code under test.

The Lagrangian of the satellite by computer algebra, the cases verified outside this project, linearisation by
complex steps, and equality of data sets to the byte and of values at points.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from functools import cache
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import xarray as xr
from scipy.integrate import solve_ivp
from strategies import default_points

import atlas
from atlas.systems import SYSTEMS

REFERENCE = Path(__file__).parent / "reference"

# The satellite, from the Lagrangian (2) with (3) of the paper.

BODY_NAMES = (
    "A",
    "B",
    "C",
    "Omega",
    "k1",
    "k2",
    "k3",
    "mu1",
    "mu2",
    "mu3",
    "h1",
    "h3",
    "drag1",
    "drag2",
    "drag3",
)


@cache
def satellite_symbols():
    """Symbols of the Euler angles, their first and second derivatives, and the parameters of the body."""
    import sympy as sp

    angles = sp.symbols("psi theta phi")
    rates = sp.symbols("psi_dot theta_dot phi_dot")
    accelerations = sp.symbols("psi_accel theta_accel phi_accel")
    return angles, rates, accelerations, sp.symbols(BODY_NAMES)


@cache
def paper_vectors():
    """alpha, beta, gamma and the relative rate w' of (1)."""
    import sympy as sp

    (psi, theta, phi), (psi_dot, theta_dot, phi_dot), _, _ = satellite_symbols()
    s, c, sf, cf = sp.sin(theta), sp.cos(theta), sp.sin(phi), sp.cos(phi)
    sy, cy = sp.sin(psi), sp.cos(psi)
    alpha = sp.Matrix([cy * cf - c * sf * sy, -cy * sf - c * cf * sy, s * sy])
    beta = sp.Matrix([sy * cf + c * sf * cy, -sy * sf + c * cf * cy, -s * cy])
    gamma = sp.Matrix([s * sf, s * cf, c])
    relative_rate = [
        psi_dot * s * sf + theta_dot * cf,
        psi_dot * s * cf - theta_dot * sf,
        psi_dot * c + phi_dot,
    ]
    return alpha, beta, gamma, sp.Matrix(relative_rate)


@cache
def lagrangian_functions():
    """Functions of (angles, rates, accelerations, body), all from the Lagrangian (2) with (3) and drag.beta.

    Left sides of Lagrange's equations, mass matrix, Jacobi integral, derivative of the absolute rates.
    """
    import sympy as sp

    angles, rates, accelerations, body = satellite_symbols()
    A, B, C, Omega, k1, k2, k3, mu1, mu2, mu3, h1, h3, *drag = body
    alpha, beta, gamma, relative_rate = paper_vectors()
    inertia, rotor, moment = sp.diag(A, B, C), sp.Matrix([k1, k2, k3]), sp.Matrix([mu1, mu2, mu3])
    w = relative_rate + Omega * gamma
    potential = sp.Rational(3, 2) * Omega**2 * alpha.dot(inertia * alpha) + moment.dot(
        h1 * alpha + h3 * gamma
    )
    potential += beta.dot(sp.Matrix(drag))
    lagrangian = w.dot(inertia * w) / 2 + w.dot(rotor) - potential
    momenta = sp.Matrix([lagrangian]).jacobian(rates).T
    mass = momenta.jacobian(rates)
    momentum_rates = mass * sp.Matrix(accelerations) + momenta.jacobian(angles) * sp.Matrix(rates)
    left_sides = momentum_rates - sp.Matrix([lagrangian]).jacobian(angles).T
    jacobi = momenta.dot(sp.Matrix(rates)) - lagrangian
    w_dot = w.jacobian(angles) * sp.Matrix(rates) + w.jacobian(rates) * sp.Matrix(accelerations)
    expressions = {"left_sides": left_sides, "mass": mass, "jacobi": jacobi, "w_dot": w_dot}
    arguments = (*angles, *rates, *accelerations, *body)
    return {
        name: sp.lambdify(arguments, expression, modules="numpy", cse=True)
        for name, expression in expressions.items()
    }


def lagrangian_arguments(points, accelerations=None):
    """Arguments of the functions of `lagrangian_functions` at points; accelerations are 0 unless given."""
    states = [points[name] for name in ("psi0", "theta0", "phi0", "n", "theta_dot0", "m")]
    zero = np.zeros_like(points["A"])
    return (
        *states,
        *(accelerations if accelerations is not None else [zero] * 3),
        *(points[i] for i in BODY_NAMES),
    )


# Linearised equations of motion.


def jacobian_matrices(rhs, state, constants):
    """Matrices of the equations linearised at states of shape (d, samples), by complex steps: (samples, d, d)."""
    shifted = (
        state[:, None] + 1e-30j * np.eye(len(state))[:, :, None]
    )  # (d, one state for each column, samples)
    return np.moveaxis(np.array(rhs(shifted, constants)).imag / 1e-30, -1, 0)


def exponents_along_runs(rhs, states, constants, duration):
    """For each point the states along its run, (d, instants), and the exponents of the equations linearised there."""
    for state, column in zip(states.T, constants.T, strict=True):
        run = solve_ivp(
            lambda t, y, c=column: rhs(y, c),
            (0, duration),
            state,
            "LSODA",
            rtol=1e-8,
            atol=1e-8,
            max_step=0.1,
        )
        yield run.y, np.linalg.eigvals(jacobian_matrices(rhs, run.y, column[:, None]))


def monodromy_matrix(rhs, state, constants, duration):
    """Derivative of the final state by the initial state of shape (d,), from the variational equations: (d, d)."""
    d, numbers = state.size, constants.tolist()

    def variational(_, y):
        matrix = jacobian_matrices(rhs, y[:d, None], numbers)[0]
        return np.concatenate([rhs(y[:d], numbers), (matrix @ y[d:].reshape(d, d)).ravel()])

    start = np.concatenate([state, np.eye(d).ravel()])
    solution = solve_ivp(variational, (0, duration), start, "DOP853", rtol=1e-11, atol=1e-12)
    return solution.y[d:, -1].reshape(d, d)


# Gyrostats about a fixed point by plain equations in vectors and an adaptive integrator.


def gyrostat_start(theta, phi, theta_dot, n, m):
    """Angular velocity n gamma + m e3 + theta' about the node, and gamma, in body axes."""
    gamma = np.array([np.sin(theta) * np.sin(phi), np.sin(theta) * np.cos(phi), np.cos(theta)])
    return n * gamma + [theta_dot * np.cos(phi), -theta_dot * np.sin(phi), m], gamma


def gyrostat_run(inertia, rotor, weight, start, duration, frame_rate=0.0):
    """State and statistics of a run by DOP853 at a relative tolerance of 1e-13, with the statistics as quadratures.

    inertia, rotor, weight (Mg r_c): (3,); start: w and gamma. Returns a function of time (w and gamma, (6, times)) and
    the statistics by name; psi' and the rate about the vertical are relative to a frame that turns at frame_rate.
    """

    def cross(a, b):  # np.cross would take most of the time of a run
        return np.array([
            a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]
        ])  # fmt: skip

    def rates(w, gamma):
        sine = np.hypot(gamma[0], gamma[1])
        psi_dot = (w[0] * gamma[0] + w[1] * gamma[1]) / sine**2
        theta_dot = (w[0] * gamma[1] - w[1] * gamma[0]) / sine
        return np.array([
            theta_dot, psi_dot - frame_rate, w[2] - psi_dot * gamma[2], (w * gamma).sum(0) - frame_rate
        ])  # fmt: skip

    def slope(_, y):
        w, gamma = y[:3], y[3:6]
        torque = cross(inertia * w + rotor, w) + cross(weight, gamma)
        now = rates(w, gamma)
        return np.concatenate([torque / inertia, cross(gamma, w), now, now**2])

    def turn(_, y):
        return y[4] * y[0] - y[3] * y[1]

    begin = np.concatenate([*start, np.zeros(8)])
    run = solve_ivp(
        slope, (0, duration), begin, "DOP853", events=turn, dense_output=True, rtol=1e-13, atol=1e-14
    )
    mean, square = run.y[6:10, -1] / duration, run.y[10:, -1] / duration
    result = {"theta_dot_rms": np.sqrt(square[0])}
    for i, name in enumerate(("theta_dot", "psi_dot", "phi_dot", "normal_rate")):
        result[f"{name}_mean"] = mean[i]
        result[f"{name}_std"] = np.sqrt(max(square[i] - mean[i] ** 2, 0.0))
    del result["theta_dot_mean"]
    gamma = np.concatenate([run.y[3:6, [0, -1]], run.y_events[0].reshape(-1, 14)[:, 3:6].T], 1)
    theta = np.arctan2(np.hypot(gamma[0], gamma[1]), gamma[2])
    return lambda t: run.sol(t)[:6], result | {"theta_min": theta.min(), "theta_max": theta.max()}


def fundamental_matrix(rhs, motion, constants, duration, step=0.01):
    """Fundamental matrix of the equations linearised along the exact motion t -> states (d, *t.shape), by RK4.

    It may overflow: the result is a matrix of largest entry 1 and the logarithm of its factor.
    """
    count = int(np.ceil(duration / step))
    h = duration / count
    identity = monodromy = np.eye(len(motion(np.zeros(1))))
    log_scale = 0.0
    for first in range(0, count, 256):  # steps at once, whose arrays fit in the processor's cache
        instants = np.arange(2 * first, 2 * min(first + 256, count) + 1) * (h / 2)
        matrices = jacobian_matrices(rhs, motion(instants), constants[:, None])
        begin, middle, end = matrices[:-1:2], matrices[1::2], matrices[2::2]
        second = middle @ (identity + h / 2 * begin)
        third = middle @ (identity + h / 2 * second)
        fourth = end @ (identity + h * third)
        products = identity + h / 6 * (begin + 2 * second + 2 * third + fourth)
        while half := len(products) // 2:  # products of neighbours, the later factor on the left
            pairs = products[1::2] @ products[: 2 * half : 2]
            products = np.concatenate([pairs, products[2 * half :]])
        monodromy = products[0] @ monodromy
        size = np.abs(monodromy).max()
        monodromy, log_scale = monodromy / size, log_scale + np.log(size)
    return monodromy, log_scale


# Cases verified outside this project.


@cache
def cases(kind: str) -> list[dict]:
    """The verified cases of a kind, "satellite", "fixed_point" or "any_axis", as dictionaries."""
    return json.loads((REFERENCE / f"{kind}_cases.json").read_text())["cases"]


def columns_of(system: str, points: Sequence[Mapping[str, object]]) -> dict[str, np.ndarray]:
    """Columns of the parameters of points, which are mappings; missing parameters have their defaults."""
    defaults = {name: parameter.default for name, parameter in SYSTEMS[system].parameters.items()}
    return {
        name: np.array([point.get(name, default) for point in points], float)
        for name, default in defaults.items()
    }


def satellite_cases() -> dict[str, np.ndarray]:
    """Points of the verified cases of the satellite."""

    def column(value_of):
        return np.array([float(value_of(case)) for case in cases("satellite")])

    points = columns_of("satellite", cases("satellite"))
    for i in range(3):
        points[f"k{i + 1}"] = column(lambda case, i=i: case["k"][i])
        points[f"mu{i + 1}"] = column(lambda case, i=i: case["mu"][i])
    return points


def fixed_point_cases() -> dict[str, np.ndarray]:
    """Points of the verified cases of the fixed point."""

    def column(value_of):
        return np.array([value_of(case) for case in cases("fixed_point")], float)

    given = {name: column(lambda case, name=name: case[name]) for name in ("A", "B", "C", "Mg", "N")}
    vectors = {
        "rc": ("x0", "y0", "z0"),
        "l": ("l1", "l2", "l3"),
        "w0": ("p0", "q0", "r0"),
        "gamma0": ("gamma10", "gamma20", "gamma30"),
    }
    for key, names in vectors.items():
        given |= {name: column(lambda case, key=key, i=i: case[key][i]) for i, name in enumerate(names)}
    return default_points("fixed_point", **given)


def worst_point(points, seed, size, **values) -> str:
    """Text about the point with the largest size: its parameters, its values, and the seed of all points."""
    size = np.nan_to_num(np.asarray(size, float), nan=np.inf)
    i = int(size.argmax())

    def texts(columns):
        rows = {
            name: np.broadcast_to(column, (*np.shape(column)[:-1], size.size))
            for name, column in columns.items()
        }
        return ", ".join(f"{name} = {row[..., i].tolist()!r}" for name, row in rows.items())

    return f"the worst of {size.size} points of seed {seed} is {i}: {texts(values)}\nat {texts(points)}"


def assert_at_points(actual, expected, points, seed, *, where=True, rtol=0.0, atol=0.0, **values) -> None:
    """Assert that values, (..., points), are the expected ones, nan where these are; else name the worst point.

    where: mask of the points to compare; values: further values of the worst point to print.
    """
    __tracebackhide__ = True
    actual, expected = np.broadcast_arrays(np.asarray(actual, float), np.asarray(expected, float))
    with np.errstate(invalid="ignore"):
        excess = np.abs(actual - expected) - (atol + rtol * np.abs(expected))
    same = (actual == expected) | (np.isnan(actual) & np.isnan(expected))
    excess = np.where(same, -np.inf, np.nan_to_num(excess, nan=np.inf)).reshape(-1, actual.shape[-1]).max(0)
    excess = np.where(where, excess, -np.inf)
    if (excess > 0).any():
        words = worst_point(points, seed, excess, actual=actual, expected=expected, **values)
        raise AssertionError(f"{(excess > 0).sum()} points differ; {words}")


def assert_shards_and_threads_agree(scene, folder: Path) -> None:
    """Assert that a run in one thread, and two shards in a run folder, give the same atlas."""
    whole = atlas.run(scene, progress=False, threads=1)
    for shard in ((1, 2), (2, 2)):
        atlas.run(scene, f"{folder}/run/", progress=False, shard=shard)
    with atlas.open_atlas(folder / "run") as ds:
        for name in whole.data_vars:
            np.testing.assert_array_equal(ds[name], whole[name])


def assert_same_bytes(expected: xr.Dataset, dataset: xr.Dataset) -> None:
    """Assert that variables and coordinates agree in every byte, in type, dimensions and names of attributes."""
    assert set(expected.variables) == set(dataset.variables)
    expected, dataset = expected.compute(), dataset.compute()  # all variables at once
    for name, variable in expected.variables.items():
        actual = dataset.variables[name]
        assert (variable.dtype, variable.dims) == (actual.dtype, actual.dims), name
        assert variable.values.tobytes() == actual.values.tobytes(), name
        assert set(variable.attrs) == set(actual.attrs), name


def tile_path(tiles, tile, suffix=".tile"):
    """Path of a tile of a run in a folder, or of its claim."""
    return tiles.place.path / tiles.name(tile, suffix)


def state(tiles):
    """Numbers of the whole tiles, of the damaged ones with reasons, and of the missing ones, after all of them are read."""
    missing = tiles.missing()
    written = sorted({*range(tiles.tiling.count)} - {*missing})
    damaged = tiles.check(written)[1]
    return SimpleNamespace(
        done=[tile for tile in written if tile not in damaged], damaged=damaged, missing=missing
    )


def with_key(manifest):
    """A changed manifest of a run with the key that matches it."""
    from atlas.runs import run

    return manifest | {"key": run._key(manifest)}


def check_whole_periods(motion):
    """Assert that an exact motion has its period, and that statistics of many periods and a rest are sums over these parts."""
    from atlas.extensions.studies import exact

    time = np.linspace(0, 2 * motion.period, 40)
    now, later = motion(time), motion(time + motion.period)
    np.testing.assert_allclose(later, now, rtol=0, atol=1e-12)
    duration = 3.3 * motion.period
    whole = exact.statistics(motion, duration)
    nodes, weight = exact._quadrature(motion, duration)
    for name, value in exact.moments(motion(nodes), weight / duration).items():
        np.testing.assert_allclose(whole[name], value, rtol=1e-12, atol=1e-12)


def acceleration_error(point):
    """Largest error of the angular acceleration of one satellite at 13 instants of w' = n gamma + m e3."""
    from atlas.systems.satellite.equations import rhs
    from atlas.systems.satellite.families import steady_motion
    from atlas.systems.satellite.initial import constants

    w, state = point["n"] + point["Omega"], steady_motion(point, np.linspace(0.0, 13.0, 13))
    needed = w * point["m"] * np.array([state[7], -state[6], np.zeros_like(state[6])])
    return float(np.abs(np.array(rhs(state, constants(point)[:, None]))[:3] - needed).max())
