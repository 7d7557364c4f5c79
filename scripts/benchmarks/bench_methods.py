"""Processor time of the methods at the tolerance of each scene, compared with the estimate that `atlas check` prints.

python scripts/benchmarks/bench_methods.py [SCENE ...] [--points 4096] [--rounds 3] [--method rk8]

Default: all scenes of configs/ that set a tolerance. Times are of one thread; the methods take turns, and the least time of the
rounds counts. Points are integrated to the end of their runs, with all statistics. "With theory" is the time of all work for
the same points in a tile of the scene, where runs may end early. The cost of a step is in units of a step of rk4; its median over
the scenes is the `step_cost` of the method in atlas/kernel/tableaux.py. "Other label" counts points with different labels by the
two methods, "unresolved" points without a label by each.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from statistics import median
from typing import TypeVar

import numpy as np

import atlas
from atlas.flags import Label
from atlas.kernel.blocks import Threads
from atlas.kernel.ensemble import Ensemble
from atlas.kernel.tableaux import METHODS
from atlas.label.pipeline import evaluate
from atlas.runs.plan import ScenePlan
from atlas.scene import grid
from atlas.scene.model import Scene

CONFIGS = Path(__file__).parents[2] / "configs"
COLUMNS = (
    "rk4, µs a point", "{} / rk4", "estimated", "with theory", "cost of a step", "other label", "unresolved"
)  # fmt: skip
T = TypeVar("T")


class Comparison:
    """A method compared with rk4 at some points of a scene."""

    def __init__(self, scene: Scene, count: int, rounds: int, method: str):
        indices = np.unique(np.linspace(0, scene.size - 1, count).round().astype(np.int64))
        points = grid.points_at_indices(scene, indices)
        self.points = points.subset(points.exists)
        self.size = self.points.duration.size
        scenes = [replace(scene, settings=replace(scene.settings, method=name)) for name in ("rk4", method)]
        plans = [ScenePlan(each, self.points) for each in scenes]
        self.estimate = plans[0].relative_costs[method]
        sizes = [plan.step_sizes for plan in plans]
        ensemble = Ensemble.of(scene.system, self.points.points)
        integrations = [
            partial(
                ensemble.integrate,
                plan.runs.kernel, size, scene.settings.cylinder, threads=Threads(1),
            )
            for plan, size in zip(plans, sizes, strict=True)
        ]  # fmt: skip
        for integrate in integrations:
            integrate()  # may compile
        self.seconds, _ = seconds_in_turn(integrations, rounds)
        tiles = [partial(evaluate, plan.runs, self.points, threads=Threads(1)) for plan in plans]
        self.tile_seconds, columns = seconds_in_turn(tiles, rounds)
        labels = np.array([values["label"] for values in columns])
        unresolved = labels == Label.UNRESOLVED
        self.unresolved = unresolved.sum(1)
        self.different_labels = int(((labels[0] != labels[1]) & ~unresolved.any(0)).sum())
        steps = [size.steps.sum() for size in sizes]
        self.ratio = self.seconds[1] / self.seconds[0]
        self.step_cost = self.ratio * steps[0] / steps[1]

    def __str__(self) -> str:
        return (
            f"{1e6 * self.seconds[0] / self.size:.1f} | {self.ratio:.2f} | {self.estimate:.2f} |"
            f" {self.tile_seconds[1] / self.tile_seconds[0]:.2f} | {self.step_cost:.1f} |"
            f" {self.different_labels} of {self.size} | {self.unresolved[0]}, {self.unresolved[1]}"
        )


def seconds_in_turn(functions: Sequence[Callable[[], T]], rounds: int) -> tuple[list[float], list[T]]:
    """Least processor time of each function over the rounds, s, and its last result."""
    least, results = [float("inf")] * len(functions), []
    for _ in range(rounds):
        results = []
        for i, function in enumerate(functions):
            began = time.process_time()
            results.append(function())
            least[i] = min(least[i], time.process_time() - began)
    return least, results


def main() -> None:
    parser = argparse.ArgumentParser(description="processor time of the methods at the same tolerance")
    parser.add_argument("scenes", nargs="*", type=Path, default=sorted(CONFIGS.glob("*.toml")))
    parser.add_argument("--points", type=int, default=4096, help="points of a scene (default: %(default)s)")
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--method", default="rk8", choices=sorted(METHODS.keys() - {"rk4"}))
    options = parser.parse_args()
    columns = " | ".join(COLUMNS).format(options.method)
    print(f"| scene | {columns} |\n{'|---' * (1 + len(COLUMNS))}|")
    comparisons = []
    for path in options.scenes:
        scene = atlas.load_scene(path)
        if scene.settings.step is None:
            comparisons.append(Comparison(scene, options.points, options.rounds, options.method))
            print(f"| {path.stem} | {comparisons[-1]} |", flush=True)
    ratios = [comparison.ratio for comparison in comparisons]
    print(
        f"{options.method} / rk4 from {min(ratios):.2f} to {max(ratios):.2f}, median {median(ratios):.2f};"
        f" median cost of a step {median(comparison.step_cost for comparison in comparisons):.1f}"
    )


if __name__ == "__main__":
    main()
