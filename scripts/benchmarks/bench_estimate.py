"""How often the true error of the statistics exceeds ten times `error_estimate`, expected and measured.

python scripts/benchmarks/bench_estimate.py [--points 384] [--seed 0] [--systems satellite]

Random satellites and bodies about a fixed point: short runs, runs to T = 20, starts beside the vertical at both poles,
slender and symmetric bodies. The true error of a statistic is its difference from `rk8` at a tolerance of 1e-13.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator

import numpy as np
from bench_engine import random_points

import atlas
from atlas.flags import Status
from atlas.kernel.statistics import RATES
from atlas.systems import SYSTEMS

NAMES = (*RATES, "theta_min", "theta_max")
COLUMNS = (("rk4", "none"), ("rk8", "none"), ("rk4", "all"), ("rk8", "all"))
ONE_AXIS = ("k1", "k2", "mu1", "mu2", "l1", "l2", "x0", "y0")


def point_sets(
    system: str, rng: np.random.Generator, count: int
) -> Iterator[tuple[str, dict[str, np.ndarray], np.ndarray]]:
    """Name, points and durations of every set."""
    yield "runs of 0.5 to 8", random_points(system, count, rng), rng.uniform(0.5, 8, count)
    yield "runs of 20", random_points(system, count, rng), np.full(count, 20.0)
    points = random_points(system, count, rng)
    points |= {"theta0": 10 ** rng.uniform(-4.5, -1, count), "theta_dot0": rng.normal(size=count)}
    yield "from beside the vertical", points, rng.uniform(1, 8, count)
    points = random_points(system, count, rng)
    points |= {"theta0": np.pi - 10 ** rng.uniform(-3, -1, count)}
    points |= {"theta_dot0": -0.3 * rng.normal(size=count), "n": 3 * points["n"]}
    yield "slowly, from below", points, rng.uniform(1, 20, count)
    points = random_points(system, count, rng)
    points["C"] = points["A"] * 10 ** rng.uniform(-3, -1, count)
    points["B"] = points["A"] - 0.9 * points["C"]
    yield "slender bodies", points, rng.uniform(0.5, 5, count)
    points = random_points(system, count, rng)
    points |= {"B": points["A"]} | {name: np.zeros(count) for name in ONE_AXIS if name in points}
    yield "symmetric bodies", points, rng.uniform(3, 30, count)


def share_beyond(
    system: str, points: dict[str, np.ndarray], duration: np.ndarray, reference, method: str, check: str
) -> tuple[float, float]:
    """Share of the points with a label beyond 10 times their estimate, and the median of true error over estimate."""
    ds = atlas.label_points(system, points, duration=duration, method=method, check_half_step=check)
    defaults = {name: np.full(duration.size, p.default) for name, p in SYSTEMS[system].parameters.items()}
    bound = SYSTEMS[system].frequency_bound(defaults | points)
    error = np.zeros(duration.size)
    for name in NAMES:
        unit = 1.0 if name.startswith("theta_m") else bound
        error = np.fmax(error, np.abs(ds[name].values - reference[name].values) / unit)
    ok = (ds.status.values == Status.OK) & (reference.status.values == Status.OK)
    ratio = (error / ds.error_estimate.values)[ok]
    return float((ratio > 10).mean()), float(np.median(ratio))


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--points", type=int, default=384)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--systems", nargs="+", choices=SYSTEMS, default=list(SYSTEMS))
    options = parser.parse_args()
    print(
        "| points beyond 10 x `error_estimate` | rk4 | rk8 | rk4, measured | rk8, measured |\n|---|---|---|---|---|"
    )
    for system in options.systems:
        rng = np.random.default_rng(options.seed)
        for name, points, duration in point_sets(system, rng, options.points):
            reference = atlas.label_points(
                system, points, duration=duration, method="rk8", tolerance=1e-13, rate_tolerance=1e-9,
                cylinder_tolerance=1e-5,
            )  # fmt: skip
            shares = [share_beyond(system, points, duration, reference, *column)[0] for column in COLUMNS]
            print(
                f"| {system}: {name} | {' | '.join(f'{100 * share:.1f} %' for share in shares)} |", flush=True
            )


if __name__ == "__main__":
    main()
