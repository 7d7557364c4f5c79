"""Cost of labels about any axis, in scenes that ask for them.

    python scripts/benchmarks/bench_any_axis.py [--points 1024] [--rounds 9] [--systems satellite] [--methods rk4]

Random points with all terms are integrated by three kernels, which measure circles in no frame, in one and in two. Times are
processor times of one thread; a ratio is the median over rounds in which the kernels take turns. States and other statistics are
compared bit by bit.
"""

from __future__ import annotations

import argparse
import time
from statistics import median

import numpy as np

from atlas.kernel.blocks import Threads
from atlas.kernel.ensemble import Ensemble
from atlas.kernel.specialization import kernel
from atlas.kernel.statistics import Row
from atlas.kernel.stepsize import StepSizes
from atlas.kernel.tableaux import METHODS
from atlas.measure.circle import CIRCLES
from atlas.scene.model import Settings
from atlas.systems import SYSTEMS
from atlas.systems.base import Points, System


def random_points(system: System, count: int) -> Points:
    """Random bodies, fields and starts of order 1."""
    rng = np.random.default_rng(0)
    points = {name: np.full(count, p.default) for name, p in system.parameters.items()}
    required = [name for name, values in points.items() if not np.isnan(values).any()]
    points |= {name: rng.normal(size=count) for name in required if name not in ("A", "B", "C", "M")}
    points |= {name: rng.uniform(0.8, 1.5, count) for name in "ABC"}
    return points | {"theta0": rng.uniform(0.3, 2.8, count)}


def measure(system: System, method: str, count: int, rounds: int) -> None:
    """Print the ratios of times for a system and a method."""
    points, settings = random_points(system, count), Settings(method=method).at(1e-5)
    choices = (0, 1) if system.frame_rate is None else (0, 1, 2)
    ensembles = [Ensemble.of(system, points, CIRCLES[:frames]) for frames in choices]
    kernels = [kernel(system, method, plugs=CIRCLES[:frames]) for frames in choices]
    sizes = StepSizes.of(settings, ensembles[0].frequency_bound, np.full(count, 60.0))
    seconds: list[list[float]] = [[] for _ in choices]
    runs = []
    for i in range(rounds + 1):  # the first compiles
        for each, ensemble, module in zip(seconds, ensembles, kernels, strict=True):
            began = time.process_time()
            run = ensemble.integrate(module, sizes, settings.cylinder, threads=Threads(1))
            each.append(time.process_time() - began)
            if i == 0:
                runs.append(run)
    for i in range(1, len(choices)):
        ratio = median(b / a for a, b in zip(seconds[0][1:], seconds[i][1:], strict=True))
        same = np.array_equal(runs[i].final_state, runs[0].final_state, equal_nan=True)
        same &= np.array_equal(runs[i].sums[: len(Row)], runs[0].sums, equal_nan=True)
        steps = sizes.steps.mean() / sizes.intervals.mean()
        print(
            f"{system.name}, {method}, {steps:.1f} steps a node: circles in {choices[i]} frame(s) take {ratio:.3f} times"
            f" the time; states and other statistics {'are the same to the bit' if same else 'DIFFER'}"
        )


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--points", type=int, default=1024)
    parser.add_argument("--rounds", type=int, default=9)
    parser.add_argument("--systems", nargs="+", choices=SYSTEMS, default=list(SYSTEMS))
    parser.add_argument("--methods", nargs="+", choices=METHODS, default=list(METHODS))
    options = parser.parse_args()
    for system in options.systems:
        for method in options.methods:
            measure(SYSTEMS[system], method, options.points, options.rounds)


if __name__ == "__main__":
    main()
