"""Shares of points whose statistics err by more than ten times `error_estimate`, and whose final states err by more than the tolerance.

python scripts/benchmarks/bench_estimate.py [--points 384] [--seed 0] [--systems satellite]

The points are random satellites and bodies about a fixed point: short runs, runs to T = 20, starts near theta = 0 and pi, slender
and symmetric bodies. The true error is the difference from `rk8` at a tolerance of 1e-13. The error of the final state over the
tolerance is printed for random bodies to T = 50, and for points of some example scenes.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from dataclasses import replace

import numpy as np
from bench_engine import random_points

import atlas
from atlas.flags import Status
from atlas.kernel.ensemble import Ensemble
from atlas.kernel.specialization import kernel
from atlas.kernel.statistics import RATES
from atlas.kernel.stepsize import StepSizes
from atlas.label.pipeline import evaluate
from atlas.label.plan import Plan
from atlas.measure.rates import state_distance
from atlas.scene.grid import Grid, points_at_indices
from atlas.scene.model import Settings
from atlas.systems import SYSTEMS

NAMES = (*RATES, "theta_min", "theta_max")
COLUMNS = (("rk4", "none"), ("rk8", "none"), ("rk4", "all"), ("rk8", "all"))
SCENES = ("capture", "fast_spin_survival", "periodic_solution", "quickstart", "stability_perp_velocity")
ONE_AXIS = ("k1", "k2", "mu1", "mu2", "l1", "l2", "x0", "y0")


def point_sets(
    system: str, rng: np.random.Generator, count: int
) -> Iterator[tuple[str, dict[str, np.ndarray], np.ndarray]]:
    """Name, points and durations of every set of random points."""
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
    """Share of the labelled points with errors above 10 estimates, and the median of true error over estimate."""
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


def random_scene(system: str, count: int, rng: np.random.Generator) -> tuple[Plan, Grid]:
    """A plan for random bodies, and their points, with runs to T = 50."""
    points = {name: np.full(count, p.default) for name, p in SYSTEMS[system].parameters.items()}
    points |= random_points(system, count, rng)
    return Plan(SYSTEMS[system], Settings()), Grid(
        points, points, np.zeros(count, np.int8), np.full(count, 50.0), np.full(count, 1e-5)
    )


def example_scene(name: str, count: int) -> tuple[Plan, Grid]:
    """The plan of an example scene, for all variables, and points spread evenly over it."""
    scene = atlas.load_scene(atlas.example(name))
    points = points_at_indices(scene, np.linspace(0, scene.size - 1, count).astype(np.int64))
    return replace(Plan.of(scene), outputs=None), points.subset(np.flatnonzero(points.exists))


def errors_over_tolerance(plan: Plan, points: Grid, method: str, tolerance: float) -> str:
    """Cells of a row: quantiles of the error of the final state over the tolerance; share above 1; share of these within 10 estimates."""
    ensemble, states = Ensemble.of(plan.system, points.points), []
    settings = replace(plan.settings, method=method, tolerance=tolerance, step=None)
    for each in (settings, replace(settings, method="rk8", tolerance=1e-13)):
        sizes = StepSizes.of(each.at(1e30), ensemble.frequency_bound, points.duration)
        states.append(ensemble.final_states(kernel(plan.system, each.method), sizes.steps, sizes.step_size))
    error = state_distance(plan.system, *states, ensemble.frequency_bound)
    estimate = evaluate(replace(plan, settings=settings), points)["error_estimate"]
    above = error > tolerance
    within = (error <= 10 * estimate)[above]
    quantiles = " | ".join(f"{value:.1g}" for value in np.quantile(error / tolerance, (0.5, 0.9, 0.99)))
    shares = f"{100 * above.mean():.1f} % | {f'{100 * within.mean():.0f} %' if within.size else ''}"
    return f"{method} | {tolerance:.0e} | {quantiles} | {shares}"


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
    print(
        "\n| points | method | tolerance | error over tolerance, 50 % | 90 % | 99 % | above it | of these within 10 x `error_estimate` |\n"
        "|---|---|---|---|---|---|---|---|"
    )
    rng = np.random.default_rng(options.seed)
    sets = {
        f"{name}: random bodies to T = 50": random_scene(name, options.points, rng)
        for name in options.systems
    } | {f"`{name}`": example_scene(name, options.points) for name in SCENES}
    for words, points in sets.items():
        for method, tolerance in (("rk4", 1e-4), ("rk8", 1e-4), ("rk8", 1e-8)):
            print(f"| {words} | {errors_over_tolerance(*points, method, tolerance)} |", flush=True)


if __name__ == "__main__":
    main()
