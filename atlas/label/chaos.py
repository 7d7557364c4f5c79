"""The variables of CHAOS of a set of points: mean MEGNO and Lyapunov exponent from runs with a tangent vector."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from types import ModuleType

import numpy as np

from ..engine.chaos import METHOD, RELATIVE_COST, Separation, TangentSteps
from ..engine.ensemble import Ensemble
from ..engine.specialization import Specialization, tangent_kernel
from ..engine.stepsize import StepSizes
from ..engine.tableaux import METHODS
from ..flags import Regularity, Status
from ..scene.model import Settings
from ..systems.base import Array, Points, System
from .regularity import regularity


@dataclass(frozen=True)
class TangentRuns:
    """Points ready to be integrated with a tangent vector; arrays of shape (points,)."""

    system: System
    kernel: ModuleType  # see `specialization.tangent_kernel`
    ensemble: Ensemble
    steps: TangentSteps
    rate_unit: Array  # see `System.rate_unit`
    share: float  # of these runs in the work of all runs of the points

    @classmethod
    def of(
        cls,
        system: System,
        specialization: Specialization,
        ensemble: Ensemble,
        points: Points,
        duration: Array,
        settings: Settings,
        step_sizes: StepSizes,
    ) -> TangentRuns:
        """The runs of points that are integrated without a tangent vector as well, with step_sizes."""
        with np.errstate(all="ignore"):
            steps = TangentSteps.of(ensemble.frequency_bound, duration, settings.step, settings.max_steps)
            rate_unit = np.asarray(system.rate_unit(points))
        own = METHODS[settings.method].step_cost * float(step_sizes.without_unresolved().steps.sum())
        work = RELATIVE_COST * METHOD.step_cost * float(steps.steps[steps.resolved].sum())
        kernel = tangent_kernel(system, specialization)
        return cls(system, kernel, ensemble, steps, rate_unit, work / (own + work))

    def variables(
        self, columns: Mapping[str, np.ndarray], threads: int | None, progress: Callable[[float], None]
    ) -> dict[str, np.ndarray]:
        """The variables of CHAOS; nan and NOT_COMPUTED where the status is not ok.

        columns: label and status; threads: see `blocks.integrate`; progress: called with points done, in all
        `share` of their number.
        """
        size = self.rate_unit.size
        megno, lyapunov = np.full(size, np.nan), np.full(size, np.nan)
        flags = np.full(size, Regularity.NOT_COMPUTED, np.int8)
        where = np.flatnonzero(columns["status"] == Status.OK)
        if not where.size:
            progress(size * self.share)
            return {"megno": megno, "lyapunov": lyapunov, "regularity": flags}
        steps = self.steps.subset(where)
        points_per_step = size * self.share / float(steps.steps.sum())
        separation = Separation(
            self.system, self.kernel, self.ensemble.subset(where), steps, self.rate_unit[where]
        )
        separation.integrate(
            threads=threads, progress=lambda point_steps: progress(points_per_step * point_steps)
        )
        values = np.array([separation.megno, separation.lyapunov])
        values[:, ~np.isfinite(values).all(0)] = np.nan
        kind = regularity(columns["label"][where].astype(np.int8), values[0])
        drifting = np.isin(kind, (Regularity.REGULAR, Regularity.CHAOTIC, Regularity.UNDECIDED))
        values[:, drifting & separation.passes_unstable_motion] = np.nan
        chaotic = np.flatnonzero(kind == Regularity.CHAOTIC)
        sustained = separation.is_sustained(chaotic, threads=threads, progress=lambda steps: progress(0.0))
        kind[chaotic[~sustained]] = Regularity.UNDECIDED
        values[:, chaotic[~sustained]] = np.nan
        (megno[where], lyapunov[where]), flags[where] = values, kind
        return {"megno": megno, "lyapunov": lyapunov, "regularity": flags}
