"""Regular or chaotic: the flag that follows from a label and mean MEGNO, and how long a run must be for it."""

from __future__ import annotations

from collections.abc import Collection

import numpy as np

from ..engine import numeric_bound
from ..engine.chaos import METHOD, RELATIVE_COST, TangentSteps
from ..engine.tableaux import METHODS
from ..flags import Label, Regularity
from ..scene.grid import Grid
from ..scene.model import Scene
from ..systems.base import Array, Flags
from ..variables import CHAOS

# Mean MEGNO below the first is regular, above the second chaotic. It tends to 2 or less, or grows as lambda T / 2.
MAX_REGULAR, MIN_CHAOTIC = 2.5, 5.0
# Shortest run that shows most chaos: revolutions of the frame, or, where the frame does not turn, periods of the bound
# of the fastest frequency.
MIN_ORBITS, MIN_PERIODS = 80, 400


def regularity(label: Flags, megno: Array) -> Flags:
    """Flag of each point.

    label: values of flags.Label, unresolved where the status is not ok. megno: mean MEGNO at the end of the
    run; nan: not computed. Returns values of flags.Regularity.
    """
    steady = np.isin(label, (Label.REGULAR_PRECESSION, Label.PERMANENT_ROTATION))
    drifting = label == Label.DRIFTING
    conditions = {
        Regularity.NOT_COMPUTED: np.isnan(megno),
        Regularity.HYPERBOLIC: steady & (megno > MIN_CHAOTIC),
        Regularity.STEADY: steady,
        Regularity.CHAOTIC: drifting & (megno > MIN_CHAOTIC),
        Regularity.REGULAR: drifting & (megno < MAX_REGULAR),
        Regularity.UNDECIDED: drifting,
    }
    flags = np.select(list(conditions.values()), list(conditions), Regularity.NOT_COMPUTED)
    return np.asarray(flags, np.int8)


def has_chaos(names: Collection[str]) -> bool:
    """Whether a variable of CHAOS is among these variables."""
    return not CHAOS.isdisjoint(names)


def warnings(scene: Scene, sample: Grid) -> list[str]:
    """One sentence if the runs of a scene are too short to tell regular motions from chaotic ones.

    sample: points of the scene, from `grid.check`.
    """
    if not has_chaos(scene.outputs) or not sample.exists.any():
        return []
    existing = sample.subset(sample.exists)
    share = existing.duration / min_duration(scene, existing)
    if not (share < 1 - 1e-9).any():
        return []
    return [
        f"megno, lyapunov and regularity: {100 * (share < 1 - 1e-9).mean():.3g} % of the runs are too short to show most"
        f" chaos (exponents below 10 / duration are invisible); take a duration {1 / share.min():.3g} times as long,"
        " which takes as many times the time"
    ]


def min_duration(scene: Scene, sample: Grid) -> Array:
    """Duration in time units below which much chaos is missed, (points,)."""
    with np.errstate(all="ignore"):
        bound = numeric_bound.before_run(scene.system, sample.points, sample.duration)
        periods = MIN_PERIODS * 2 * np.pi / bound
        if scene.system.frame_rate is None:
            return np.asarray(periods)
        rate = np.abs(scene.system.frame_rate(sample.points))
        return np.where(rate > 0, MIN_ORBITS * 2 * np.pi / rate, periods)


def equivalent_steps(scene: Scene, sample: Grid) -> Array:
    """Steps of the scene's method that take as long as the runs with tangent vectors, (points,); 0 if none are wanted."""
    if not has_chaos(scene.outputs):
        return np.zeros(sample.duration.shape)
    with np.errstate(all="ignore"):
        bound = numeric_bound.before_run(scene.system, sample.points, sample.duration)
        sizes = TangentSteps.of(bound, sample.duration, scene.settings.step, scene.settings.max_steps)
    cost = RELATIVE_COST * METHOD.step_cost / METHODS[scene.settings.method].step_cost
    return np.where(sizes.resolved, cost * sizes.steps, 0.0)
