"""Error and cost of RK4 for Lagrange's and Euler-Poisson's equations of the satellite, at equal steps in NumPy.

    python scripts/tools/lagrange_form.py [--points 200] [--steps 200 400 800 1600]

Random motions are compared with DOP853 at its smallest tolerance, motions of the catalogue with their closed
forms. The error is the largest difference of a component of (w in units of the largest rate, alpha, gamma)
at the end. Near sin theta = 0 the rates of the angles are unbounded, so a run in Euler angles counts as unresolved
if it is not finite, if an angle turned by more than TURN rad in one step, if theta left (0, pi), if the Jacobi
integral drifted by more than DRIFT or if the error of half as many steps is above HALVED.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable

import numpy as np
from scipy.integrate import solve_ivp

from atlas.extensions.yehia2021 import lagrange
from atlas.systems.base import Array, Points
from atlas.systems.satellite import equations
from atlas.systems.satellite.families import FAMILIES, steady_motion
from atlas.systems.satellite.initial import PARAMETERS, constants, initial_state

ANGLES = ("psi0", "theta0", "phi0", "n", "theta_dot0", "m")
TURN, DRIFT, HALVED = 0.3, 1e-5, 1e-3
FORMS = ("Lagrange", "Euler-Poisson")


def rk4(rhs: Callable[..., tuple], state: Array, values: Array, step: float) -> Array:
    """One classical Runge-Kutta step of states (components, points)."""
    k1 = np.array(rhs(state, values))
    k2 = np.array(rhs(state + 0.5 * step * k1, values))
    k3 = np.array(rhs(state + 0.5 * step * k2, values))
    k4 = np.array(rhs(state + step * k3, values))
    return state + step / 6 * (k1 + 2 * (k2 + k3) + k4)


def from_angles(points: Points, angles: Array) -> Array:
    """State of equations.STATE, (9, points), from (psi, theta, phi, psi', theta', phi')."""
    return initial_state({**points, **dict(zip(ANGLES, angles, strict=True))})


def jacobi_drift(first: Array, last: Array, values: Array) -> Array:
    """Change of the Jacobi integral over the sum of the magnitudes of its terms."""
    before, after = (np.array(equations.jacobi(state, values)) for state in (first, last))
    return np.abs(after.sum(0) - before.sum(0)) / np.abs(before).sum(0)


def run(points: Points, duration: float, steps: int, form: str) -> tuple[Array, np.ndarray]:
    """End state (9, points) after equal RK4 steps, and whether the run counts as resolved, bool (points,).

    points: every parameter of the satellite, 1-D; form: one of FORMS.
    """
    values, step = constants(points), duration / steps
    first = initial_state(points)
    with np.errstate(all="ignore"):
        if form == "Euler-Poisson":
            state = first
            for _ in range(steps):
                state = rk4(equations.rhs, state, values, step)
            resolved = np.ones(state.shape[1], bool)
        else:
            angles = np.array([points[name] for name in ANGLES])
            resolved = np.ones(angles.shape[1], bool)
            for _ in range(steps):
                before, angles = angles, rk4(lagrange.rhs, angles, values, step)
                turning = np.abs(np.concatenate([angles[:3] - before[:3], step * angles[3:]])).max(0)
                resolved &= (turning < TURN) & (np.sin(angles[1]) > 0)  # false where not finite
            state = from_angles(points, angles)
        resolved &= np.isfinite(state).all(0) & (jacobi_drift(first, state, values) < DRIFT)
    return state, resolved


def integrate(points: Points, duration: float, steps: int, form: str) -> tuple[Array, np.ndarray]:
    """As `run`; for Lagrange's form the run is also compared with half as many steps, see the module."""
    state, resolved = run(points, duration, steps, form)
    if form == "Lagrange":
        with np.errstate(all="ignore"):
            resolved &= error(points, run(points, duration, steps // 2, form)[0], state) < HALVED
    return state, resolved


def error(points: Points, state: Array, exact: Array) -> Array:
    """Largest difference of two states in a component, see the module, (points,); inf where not finite."""
    first = initial_state(points)
    unit = np.maximum(points["Omega"], np.abs(first[:3]).max(0))
    scale = np.concatenate([np.broadcast_to(unit, (3, unit.size)), np.ones((6, unit.size))])
    largest = np.abs((state - exact) / scale).max(0)
    return np.where(np.isfinite(largest), largest, np.inf)


def reference(points: Points, duration: float) -> Array:
    """End state (9, points) by DOP853 in Euler-Poisson form at its smallest tolerance."""
    values, first = constants(points), initial_state(points)
    ends = [
        solve_ivp(
            lambda _, y, c=values[:, i]: equations.rhs(y, c), (0, duration), first[:, i], "DOP853",
            rtol=1e-13, atol=1e-13,
        ).y[:, -1]
        for i in range(first.shape[1])
    ]  # fmt: skip
    return np.array(ends).T


def random_points(size: int, seed: int, **given: float | Array) -> dict[str, Array]:
    """Random bodies, rotors, magnets and starts of order 1, tilted by 0.5 to 2.6 rad."""
    rng = np.random.default_rng(seed)
    absent = ("damping", "drag1", "drag2", "drag3")  # torques that the paper does not have
    names = [name for name in PARAMETERS if name not in absent]
    points = {name: rng.uniform(-1, 1, size) for name in names} | dict.fromkeys(absent, np.zeros(size))
    points |= {name: rng.uniform(0.7, 1.3, size) for name in ("A", "B", "C")}
    points |= {"Omega": np.ones(size), "theta0": rng.uniform(0.5, 2.6, size)}
    return points | {name: np.broadcast_to(np.asarray(value, float), size) for name, value in given.items()}


def tilted(tilts: Array, psi0: float, family: str, **given: float) -> dict[str, Array]:
    """Exact motions of perp_radius or perp_velocity at the given tilts."""
    points = {name: np.full(tilts.size, parameter.default) for name, parameter in PARAMETERS.items()}
    points |= {"theta0": tilts, "psi0": np.full(tilts.size, psi0), "phi0": np.full(tilts.size, 0.3)}
    points |= {name: np.full(tilts.size, value) for name, value in given.items()}
    return points | {"k3": FAMILIES[family].solve["k3"](points)}


def cost(form: str, size: int, steps: int = 40) -> float:
    """Time of one step of one point, ns."""
    points = random_points(size, 2)
    run(points, 0.2, 2, form)
    began = time.perf_counter()
    run(points, 2.0, steps, form)
    return (time.perf_counter() - began) / size / steps * 1e9


def compare_random(words: str, points: Points, duration: float, counts: list[int]) -> None:
    """Print errors and unresolved shares of both forms for random motions, for several numbers of steps."""
    exact = reference(points, duration)
    for steps in counts:
        runs = [integrate(points, duration, steps, form) for form in FORMS]
        both = np.logical_and.reduce([resolved for _, resolved in runs])
        errors = [error(points, state, exact) for state, _ in runs]
        print(f"{words}, {duration:g} time units, {steps} steps")
        largest = [e[resolved].max(initial=0.0) for e, (_, resolved) in zip(errors, runs, strict=True)]
        for quantity, values in (
            (
                "  median error where both are resolved",
                [np.median(e[both]) if both.any() else np.nan for e in errors],
            ),
            ("  largest error of resolved runs", largest),
            ("  share unresolved", [1 - resolved.mean() for _, resolved in runs]),
        ):
            print(f"{quantity:40s}" + "".join(f"{value:16.2g}" for value in values))


def compare_exact(family: str, psi0: float, duration: float) -> None:
    """Print errors of both forms for exact motions of a family, down to a tilt of 0."""
    print(f"exact motions of {family}, C/A = 1.3, m = 0.5, {duration:g} time units, 200 steps")
    tilts = np.array([1.0, 0.3, 0.1, 1e-2, 1e-4, 1e-6, 1e-8, 0.0])
    points = tilted(tilts, psi0, family, C=1.3, m=0.5)
    closed = steady_motion(points, np.array(duration))
    runs = [integrate(points, duration, 200, form) for form in FORMS]
    for i, tilt in enumerate(tilts):
        cells = [
            f"{error(points, state, closed)[i]:.1e}" if resolved[i] else "unresolved"
            for state, resolved in runs
        ]
        print(f"{f'  theta0 = {tilt:g}':40s}" + "".join(f"{cell:>16s}" for cell in cells))


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--points", type=int, default=200, help="random motions (default: %(default)s)")
    parser.add_argument("--steps", type=int, nargs="+", default=[200, 400, 800, 1600])
    options = parser.parse_args()
    count = options.points
    print(f"{'':40s}" + "".join(f"{form:>16s}" for form in FORMS))
    print(
        f"{'ns for each point and step':40s}" + "".join(f"{cost(form, 20 * count):16.0f}" for form in FORMS)
    )
    near_pole = {"theta0": 10.0 ** np.random.default_rng(0).uniform(-8, 0, count)}
    compare_random("random motions", random_points(count, 1), 10.0, options.steps)
    compare_random("from tilts of 1e-8 to 1", random_points(count, 2, **near_pole), 10.0, options.steps)
    compare_exact("perp_radius", 0.0, 10.0)
    compare_exact("perp_velocity", np.pi / 2, 10.0)


if __name__ == "__main__":
    main()
