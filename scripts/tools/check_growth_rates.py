"""Growth rates of random satellites on their families against Floquet multipliers of the nine equations of motion.

    PYTHONPATH=tests python scripts/tools/check_growth_rates.py [--points 500] [--seed 0]      (some minutes)

The reference integrates the equations of motion, linearised by difference quotients along the exact motion, with
SciPy's DOP853 over one period, and takes eigenvalues of the differenced Jacobian at equilibria. It shares nothing with
`atlas.systems.satellite.stability` but the right-hand side and the exact motion.
"""

from __future__ import annotations

import argparse
import itertools
import sys

import numpy as np
from scipy.integrate import solve_ivp
from strategies import SATELLITE_SOLVED, Points, satellite_on_family

from atlas.flags import Stability
from atlas.systems.satellite import SATELLITE
from atlas.systems.satellite.equations import rhs
from atlas.systems.satellite.families import FAMILIES
from atlas.systems.satellite.initial import constants

STEP = 1e-3  # of the difference quotients; central ones are exact for quadratic equations but for rounding
LONGEST_PERIOD = 250.0  # longer ones take minutes each


def jacobian(state: np.ndarray, values: np.ndarray) -> np.ndarray:
    """Derivative of the right-hand side by the state, (9, 9)."""
    shift = STEP * np.eye(9)
    ahead = np.array(rhs(state[:, None] + shift, values[:, None]))
    behind = np.array(rhs(state[:, None] - shift, values[:, None]))
    return (ahead - behind) / (2 * STEP)


def reference_growth(name: str, point: Points) -> float:
    """Growth rate of one point from the linearised equations of motion; nan if its period is too long."""
    values = constants(point)[:, 0]
    tilt, n, m = (point[key][0] for key in ("theta0", "n", "m"))
    turn_rate = np.hypot(n * np.sin(tilt), n * np.cos(tilt) + m)

    def motion(t: float) -> np.ndarray:
        return FAMILIES[name].motion(point, np.asarray(t))[:, 0]

    if turn_rate < 1e-12:
        return float(np.linalg.eigvals(jacobian(motion(0.0), values)).real.max())
    period = 2 * np.pi / turn_rate
    if period > LONGEST_PERIOD:
        return np.nan

    def variational(t: float, y: np.ndarray) -> np.ndarray:
        return (jacobian(motion(t), values) @ y.reshape(9, 9)).ravel()

    # pieces, because multipliers of long periods overflow
    monodromy, log_scale = np.eye(9), 0.0
    times = np.linspace(0.0, period, 2 + int(period / 20))
    for first, last in itertools.pairwise(times):
        solution = solve_ivp(variational, (first, last), monodromy.ravel(), "DOP853", rtol=1e-9, atol=1e-11)
        monodromy = solution.y[:, -1].reshape(9, 9)
        size = np.abs(monodromy).max()
        monodromy, log_scale = monodromy / size, log_scale + np.log(size)
    return float(np.log(np.abs(np.linalg.eigvals(monodromy)).max()) + log_scale) / period


def random_points(count: int, seed: int) -> list[tuple[str, Points]]:
    """Random satellites on each family in turn, with the names of their families."""
    rng, points = np.random.default_rng(seed), []
    while len(points) < count:
        name = list(SATELLITE_SOLVED)[len(points) % len(SATELLITE_SOLVED)]
        point = satellite_on_family(name, rng)
        if point is None:
            continue
        if name == "spherical":  # with n and m the motion has two frequencies, and is no Floquet problem
            point["m"] = np.zeros(1)
            point["k3"] = FAMILIES[name].solve["k3"](point)
        if SATELLITE.identify_family(point)[0][0] == FAMILIES[name].flag:
            points.append((name, point))
    return points


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--points", type=int, default=500)
    parser.add_argument("--seed", type=int, default=0)
    arguments = parser.parse_args()
    differences: dict[str, list[float]] = {name: [] for name in SATELLITE_SOLVED}
    unknown = mismatched = 0
    for done, (name, point) in enumerate(random_points(arguments.points, arguments.seed)):
        if done % 50 == 0:
            print(f"{done} points done", file=sys.stderr, flush=True)
        flag, _ = SATELLITE.identify_family(point)
        stable, growth = SATELLITE.linear_stability(point, flag)
        expected = reference_growth(name, point)
        if stable[0] == Stability.UNKNOWN or np.isnan(expected):
            unknown += 1
            continue
        differences[name].append(abs(growth[0] - expected))
        if (stable[0] == Stability.UNSTABLE) != (expected > 1e-4) and abs(growth[0] - expected) > 1e-4:
            mismatched += 1
            print(f"{name}: growth rate {growth[0]:.6g}, reference {expected:.6g}")
    print(f"{'family':20} points  median difference  largest difference (rad per time unit)")
    for name, values in differences.items():
        if values:
            print(f"{name:20} {len(values):6} {np.median(values):18.1e} {np.max(values):19.1e}")
    print(f"{unknown} points without a growth rate or with a period above {LONGEST_PERIOD:g}")
    print(f"{mismatched} points with another stability")


if __name__ == "__main__":
    main()
