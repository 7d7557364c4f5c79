"""The plan of a scene predicts steps, work and warnings from a sample of the points, and divides the grid into tiles. The identity
of a computation names the programs and the processor on which the bits of an atlas depend. This module imports no compiler.
"""

from __future__ import annotations

import math
import os
import platform
import sys
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any

import netCDF4
import numpy as np
from numpy.typing import NDArray

from .. import sources, systems
from .._version import __version__
from ..errors import BadInput
from ..flags import Label
from ..kernel import blocks, numeric_bound
from ..kernel.stepsize import StepSizes
from ..kernel.tableaux import METHODS, TANGENT_METHOD
from ..measure.chaos import Chaos
from ..scene import grid
from ..scene.model import MAX_STEPS, Scene, Settings
from ..systems.base import Array, extensions_of
from ..variables import proofs_of_labels
from .processor import library_bits

if TYPE_CHECKING:
    from ..label.plan import Plan
    from ..store.tiling import Tiling


# A warning is given if a run is shorter than MIN_ORBITS revolutions of the frame, because it would miss much of the chaos. If the
# frame does not turn, the limit is MIN_PERIODS periods of the frequency bound.
MIN_ORBITS, MIN_PERIODS = 80, 400
MAX_PREDICTED = 400  # Before a run, theory predicts the motions of at most this many sample points.
LONG = 2 * 3600.0  # A run that is expected to take more seconds than this announces the expected time.
COSTLY_SHARE = 0.3  # A warning is given if 1 % of the points take a larger fraction of all steps.


@dataclass(frozen=True, eq=False)
class ScenePlan:
    """The plan of a scene, with the steps, the work and the tiles of the run."""

    scene: Scene
    sample: grid.Grid  # sample of the scene's points, from `grid.check`

    @classmethod
    def of(cls, scene: Scene) -> ScenePlan:
        """Return the plan of a scene. Raise BadInput if no point can be computed."""
        return cls(scene, grid.check(scene))

    @cached_property
    def runs(self) -> Plan:
        """The plan by which the points of the scene are integrated and labelled."""
        from ..label.plan import Plan

        return Plan.of(self.scene)

    def limited(self, max_steps: int) -> Settings:
        """Return the settings of the scene with `max_steps` replaced."""
        return replace(self.scene.settings, max_steps=max_steps)

    @cached_property
    def _bound(self) -> Array:
        """Frequency bounds of the sample points, of shape (points,), found without integration."""
        with np.errstate(all="ignore"):
            return numeric_bound.before_run(self.scene.system, self.sample.points, self.sample.until)

    def step_sizes_by(self, settings: Settings) -> StepSizes:
        """Return the step sizes of the sample points under `settings`, and the expected errors of the steps."""
        with np.errstate(all="ignore"):
            settings_at_points = settings.at(self.sample.rate_tolerance)
            return StepSizes.of(settings_at_points, self._bound, self.sample.until)

    @cached_property
    def step_sizes(self) -> StepSizes:
        """Step sizes of the sample points under the settings of the scene."""
        return self.step_sizes_by(self.scene.settings)

    @cached_property
    def mean_steps(self) -> float:
        """Mean number of integration steps of a sample point."""
        return float(self.step_sizes.without_unresolved().steps[self.sample.exists].mean())

    @cached_property
    def has_chaos(self) -> bool:
        """Whether points are integrated with tangent vectors as well."""
        return Chaos().wanted(self.scene.system, self.scene.outputs)

    @cached_property
    def mean_work(self) -> float:
        """Mean work for a point, in steps of the method of the scene. The work for chaos indicators is included."""
        return self.mean_steps + (self._tangent_work(self.sample.duration) if self.has_chaos else 0.0)

    @cached_property
    def growth_work(self) -> float:
        """Mean work per point for computing the growth of errors at every point, in steps of the scene's method."""
        from ..measure.rates import tolerated_error

        if not self.runs.needs_growth:
            return 0.0
        settings = self.scene.settings.at(self.sample.rate_tolerance)
        error = tolerated_error(settings, self.step_sizes, self._bound)
        return self._tangent_work(self.sample.until, error)

    def _tangent_work(self, duration: Array, error: Array | None = None) -> float:
        """Return the mean work for the tangent vector of a point, in steps of the method of the scene."""
        from ..measure.tangent_runs import RELATIVE_COST, TangentSteps

        settings = self.scene.settings
        with np.errstate(all="ignore"):
            sizes = TangentSteps.of(self._bound, duration, settings.step, settings.max_steps, error)
        cost = RELATIVE_COST * TANGENT_METHOD.step_cost / METHODS[settings.method].step_cost
        return float(np.where(sizes.resolved, cost * sizes.steps, 0.0)[self.sample.exists].mean())

    @cached_property
    def tiling(self) -> Tiling:
        """The division of the grid into tiles, which depends only on the scene and on ATLAS_TILE_POINTS."""
        from ..store import tiling

        least = max(tiling.MIN_POINTS_PER_TILE, 3 * self.scene.size / tiling.MAX_TILES)
        points = max(tiling.TILE_POINT_STEPS / self.mean_work, least)
        # The number is rounded to a power of two, because the last bits of `mean_work` may differ between machines.
        most = min(2 ** round(math.log2(points)), grid.max_points_per_tile())
        return tiling.Tiling.of(self.scene.shape, most)

    def tiles_in_flight(self, threads: int | None) -> int:
        """Return how many tiles are computed at the same time. The smaller the tiles, the more are needed to occupy all threads."""
        threads = threads or blocks.available_threads()
        if threads == 1:
            return 1
        calls_per_tile = math.prod(self.tiling.tile) * self.mean_steps / blocks.CHUNK
        return min(1 + math.ceil(threads / max(calls_per_tile, 1.0)), threads + 1, self.tiling.count)

    def step_warnings(self) -> list[str]:
        """Return warnings about points that `max_steps` limits, costly points, and points with steps too long for a label."""
        exists, sizes, warnings = self.sample.exists, self.step_sizes, list[str]()
        limited = float((sizes.steps < self.step_sizes_by(self.limited(MAX_STEPS)).steps)[exists].mean())
        unresolved = float((~sizes.resolved)[exists].mean())
        if limited > 0:
            warnings.append(
                f"max_steps = {self.scene.settings.max_steps} cuts short {100 * limited:.3g} % of the points, whose errors are"
                " larger than the tolerance"
            )
        steps = sizes.steps[exists].astype(np.float64)
        costly = np.argsort(-steps, kind="stable")[: steps.size // 100]
        share = steps[costly].sum() / max(steps.sum(), 1.0)
        if share > COSTLY_SHARE:
            text = f"1 % of the points take {100 * share:.0f} % of the steps"
            for name, values in self.sample.points.items():
                some, every = values[exists][costly], values[exists]
                if name in self.scene.axes and np.ptp(some) < 0.5 * np.ptp(every):
                    text += f", {name} from {some.min():.3g} to {some.max():.3g}"
            warnings.append(f"{text}; max_steps would cut them short")
        if unresolved > 0:
            warnings.append(
                f"{100 * unresolved:.3g} % of the points have steps too long for their fastest frequency: they get no label"
                " and are hardly integrated; a shorter duration or more max_steps would help"
            )
        return warnings

    @cached_property
    def warnings(self) -> list[str]:
        """Warnings that are given before the run of the scene."""
        return [*grid.warnings(self.scene, self.sample), *self.chaos_warnings()]

    def chaos_warnings(self) -> list[str]:
        """Return a warning, in a list, if runs are too short to tell regular from chaotic motions."""
        exists, system = self.sample.exists, self.scene.system
        if not self.has_chaos or not exists.any():
            return []
        with np.errstate(all="ignore"):
            least = MIN_PERIODS * 2 * np.pi / self._bound
            if system.frame_rate is not None:
                rate = np.abs(system.frame_rate(self.sample.points))
                least = np.where(rate > 0, MIN_ORBITS * 2 * np.pi / rate, least)
            share = (self.sample.duration / least)[exists]
        short = share < 1 - 1e-9
        if not short.any():
            return []
        return [
            f"megno, lyapunov and regularity: {100 * short.mean():.3g} % of the runs are too short to show most"
            f" chaos (exponents below 10 / duration are invisible); take a duration {1 / share.min():.3g} times as long,"
            " which takes as many times the time"
        ]

    @cached_property
    def relative_costs(self) -> dict[str, float]:
        """Expected processor time of each other method, divided by the time of the method of the scene."""
        exists = self.sample.exists
        return self.runs.relative_costs(self._bound[exists], self.sample.subset(exists))

    def method_lines(self) -> list[str]:
        """Return a sentence on the cost of each other method, or no sentence if the scene gives the step."""
        from ..label.plan import method_lines

        return method_lines(self.scene.settings.method, self.relative_costs)

    @property
    def _few_points(self) -> NDArray[np.int64]:
        """Indices of at most MAX_PREDICTED existing points, evenly spread over the sample."""
        exists = np.flatnonzero(self.sample.exists)
        places = np.linspace(0, exists.size - 1, min(exists.size, MAX_PREDICTED))
        return exists[places.astype(np.int64)]

    def proof_lines(self) -> list[str]:
        """Return a sentence on the points whose labels could be proved, if the run needs labels alone and has such points."""
        scene = self.scene
        every = proofs_of_labels(scene.system)
        proofs = [proof for label, proof in every.items() if label in scene.outputs]
        if not proofs or scene.settings.prove or scene.refine or not self.runs.may_stop_early:
            return []
        from ..label.proved import proved_points

        plan = replace(self.runs, outputs=[*scene.outputs, *proofs], in_machine_code=False)
        proved, _ = proved_points(plan, self.sample.subset(self._few_points))
        steps = self.step_sizes.without_unresolved().steps[self._few_points]
        if not proved.any():
            return []
        return [
            f"prove: the labels of {100 * proved.mean():.3g} % of the points are proved for every duration; with prove = true"
            f" these need no run, which saves {100 * steps[proved].sum() / steps.sum():.3g} % of the steps of whole runs"
        ]

    def statistics_lines(self) -> list[str]:
        """Return a sentence if a transient, or the need for statistics, prevents runs from ending early."""
        before, until = np.sum(self.sample.transient), self.sample.until.sum()
        if self.runs.may_stop_early and before > 0:
            return [
                f"transient: {100 * before / until:.3g} % of the time of all runs, in which none ends early, however certain its label"
            ]
        if self.runs.without_statistics is None:
            return []
        from ..label.theory import predict_runs

        # `atlas check` calls this method and must load no compiler.
        plan = replace(self.runs, in_machine_code=False)
        drifting = (
            predict_runs(plan, self.sample.subset(self._few_points)).variables["predicted"] == Label.DRIFTING
        )
        if not drifting.any():
            return []
        return [
            f"statistics: they need whole runs; without them the {100 * drifting.mean():.3g} % of the points that drift by theory"
            " would end once that is certain"
        ]


def identity(plan: Plan) -> dict[str, str]:
    """Return versions, hashes and processor properties on which an atlas's bits depend. Raise BadInput if sources changed after import."""
    import llvmlite
    import numba
    import scipy

    from ..kernel import machine_code

    # `kernel_hash` reads source files and is computed first, so that the check below also covers the time of reading.
    kernel, origin = plan.kernel_hash, systems.origin(plan.system)
    extensions = extensions_of(plan.system, plan.names)
    changed: Any = sources.changed(each.folder for each in extensions) or [origin and origin.changed()]
    if changed[0]:
        raise BadInput(
            f"{changed[0]} was written after this process (host {platform.node()}, process {os.getpid()}) had imported it:"
            " start the process again"
        )
    # For a system that is not built in, `origin.code` is the hash of the source code when the system was registered.
    system_code = {} if origin is None else {"system_code": origin.code}
    if origin is not None and origin.package:
        system_code["system_package"] = origin.package
    return {
        "atlas": __version__,
        "code": sources.code(),
        **{f"extension_{each.name}": each.code for each in extensions},
        **system_code,
        "kernel": kernel,
        "architecture": machine_code.architecture(),
        "library_bits": library_bits(),
        **{f"NUMBA_{name}": value for name, value in machine_code.numeric_settings().items()},
        "python": f"{sys.version_info.major}.{sys.version_info.minor}",
        "libc": " ".join(platform.libc_ver()) or platform.release(),
        **{module.__name__: str(module.__version__) for module in (np, numba, llvmlite, scipy, netCDF4)},
        "HDF5": str(netCDF4.__hdf5libversion__),
    }


def differences(
    expected: Mapping[str, Any], actual: Mapping[str, Any], expected_place: str, actual_place: str
) -> str:
    """Return, in one line, the entries that differ. The places say where the values are, such as "in the run"."""
    return ", ".join(
        f"{name} ({expected.get(name, 'nothing')} {expected_place}, {actual.get(name, 'nothing')} {actual_place})"
        for name in {**expected, **actual}
        if expected.get(name) != actual.get(name)
    )
