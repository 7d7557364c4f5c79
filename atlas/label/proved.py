"""Points that need no run, because their labels are proved for every duration."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..flags import Status
from ..scene.grid import Grid
from ..systems.base import Mask, derived_values
from ..variables import PREDICTED, proofs_of_labels
from .plan import Plan
from .theory import predict_runs


def proved_points(plan: Plan, tile: Grid) -> tuple[Mask, dict[str, NDArray[Any]]]:
    """Return whether all provable labels of each point are proved, and the variables that instruments give without a run."""
    columns = plan.proofs(tile)
    proofs = [
        proof for label, proof in proofs_of_labels().items() if label in plan.names and proof in columns
    ]
    return np.all([columns[proof] != 0 for proof in proofs] or [tile.duration < 0], axis=0), columns


def by_proof(
    plan: Plan, tile: Grid, progress: Callable[[float], None]
) -> tuple[Mask, dict[str, NDArray[Any]]]:
    """Return whether the labels of each point are proved, and the variables of the proved points. `progress` counts proved points."""
    proved, columns = proved_points(plan, tile)
    if not proved.any():
        return proved, {}
    tile, predicted = tile.subset(proved), dict[str, NDArray[Any]]()
    if plan.outputs is None or not PREDICTED.isdisjoint(plan.outputs):
        theory = predict_runs(plan, tile)
        predicted = {**theory.variables, "condition_residual": theory.test.residual}
    progress(float(tile.duration.size))
    return proved, {
        **predicted,
        **derived_values(plan.system, plan.names, tile.base, tile.duration, lambda: progress(0.0)),
        **{name: values[proved] for name, values in columns.items()},
        **{
            label: columns[label.replace("label", "predicted")][proved]
            for label in proofs_of_labels().keys() & set(plan.names)
        },
        "status": np.full(tile.duration.shape, Status.OK, np.int8),
    }
