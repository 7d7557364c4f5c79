"""Costs of the integration methods relative to each other, at the same tolerance."""

from __future__ import annotations

from dataclasses import replace

from ..engine.tableaux import METHODS
from ..scene.grid import Grid
from ..scene.model import MAX_STEPS, Scene
from .tiling import step_sizes


def relative_costs(scene: Scene, sample: Grid) -> dict[str, float]:
    """Processor time of the integration by the other methods over the time of the scene's, for complete runs.

    It is the number of steps that a method takes at the points times the cost of a step; compiling and theory
    are not part of it. Empty where the scene sets a step: with the same step, methods have different errors.
    """
    settings = scene.settings
    if settings.step is not None:
        return {}
    costs = {}
    for name, method in METHODS.items():
        sizes = step_sizes(
            replace(scene, settings=replace(settings, method=name, max_steps=MAX_STEPS)), sample
        )
        costs[name] = method.step_cost * float(sizes.steps[sample.exists].mean())
    own = costs.pop(settings.method)
    return {name: cost / own for name, cost in costs.items()}


def method_lines(scene: Scene, sample: Grid) -> list[str]:
    """A sentence on the cost of each other method; none where the scene sets a step."""
    return [
        f'method: {scene.settings.method}; method = "{name}" would integrate in about {ratio:.2g}'
        f" {'of' if ratio < 1 else 'times'} the time at the same tolerance"
        for name, ratio in relative_costs(scene, sample).items()
    ]
