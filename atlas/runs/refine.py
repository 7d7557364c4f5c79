"""Refinement computes an atlas on a fine grid, but integrates only points near boundaries between different flags."""

from __future__ import annotations

import math
import os
import shutil
import sys
import tempfile
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import replace
from itertools import count, repeat
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np

from ..errors import BadInput, say
from ..flags import Stability
from ..kernel.blocks import Threads
from ..label import half_step, theory
from ..scene import grid
from ..scene.model import Scene
from ..store.dataset import Box
from ..store.tiling import Tiling
from ..systems.base import Flags, Mask
from ..variables import COMPUTED, variables
from .levels import MAX_VALUES, Part, traced
from .plan import ScenePlan

# A function that integrates the points with given flat indices in the finest grid, and yields the variables part by part.
Integrate: TypeAlias = Callable[[np.ndarray], Iterable[Part]]
PREDICTED = ("family", "stable", "predicted", "predicted_inertial")
# Number of points integrated on either side of a boundary at each level. Two points cover the crossed cell and one cell beyond.
BOUNDARY_WIDTH = 2
# Unstable points of fast growth need no integration, because nearly all drift. This is the largest expected number of exceptions.
EXPECTED_MISSES = 0.05
SEED = 0
# `expected_points` estimates the cost of a refined scene on a grid of at most this many points.
MAX_PREDICTED = 2**18
# `expected_points` replaces a measured flag by the prediction given here.
PREDICTIONS = {
    "label": "predicted", "label_inertial": "predicted_inertial", "geometry": "family", "status": "stable",
}  # fmt: skip
# Boundaries are sought in boxes of at most this many points, so that the memory does not grow with the grid.
MAX_BOX_POINTS = 2**20


def refined(
    integrate: Integrate, plan: ScenePlan, folder: Path | None, threads: Threads, *, progress: bool
) -> tuple[FineGrid, dict[str, Any]]:
    """Return the finest grid of a scene with [refine], and attributes of the atlas. With a `folder` the grid has no measured numbers."""
    scene = plan.scene
    assert scene.refine is not None
    fine = FineGrid(plan, integrate, folder)
    fine.trace(scene.refine.levels, progress)
    size, missed = fine.probe(scene.refine.probe)
    share = fine.n_integrated / fine.n_existing
    attributes = {"atlas_computed_share": share, "atlas_probe_points": size, "atlas_probe_missed": missed}
    return fine, attributes | half_step.half_step_sample(scene, plan.runs, threads=threads)


class FineGrid:
    """The finest grid of a scene, with predictions and flags at every point. Flags are measured or copied from neighbours."""

    def __init__(self, plan: ScenePlan, integrate: Integrate, folder: Path | None):
        self.scene, self.plan, self.integrate = plan.scene, plan.runs, integrate
        scene = plan.scene
        self.registry = variables(scene.system)
        self.flags = traced(scene)
        self.flag_counts = [len(self.registry[name].flags or range(MAX_VALUES)) for name in self.flags]
        self.predicted_flags = [name for name in PREDICTED if name in self.registry]
        self.predicted_counts = [len(self.registry[name].flags or ()) for name in self.predicted_flags]
        numbers = {n for n in scene.outputs if self.registry[n].flags is None} - {*self.flags}
        self.measured = set[str]() if folder else numbers - {"growth_rate"}
        held = [*scene.solve, *(numbers & {"growth_rate"} | self.measured)]
        codes = (np.min_scalar_type(-math.prod(each)) for each in (self.flag_counts, self.predicted_counts))
        arrays = _zeros(scene, (*codes, bool, bool, *len(held) * [float]), folder)
        # `flag_code` encodes all flags of a point, which are copied from a neighbour unless `computed` is true.
        self.flag_code, self.predicted, self.computed, self.slowly_unstable, *columns = arrays
        self.numbers = dict(zip(held, columns, strict=True))
        for column in columns:
            column.fill(np.nan)
        self.n_existing, self.n_integrated, self.finest = 0, 0, (slice(None, None, 1),) * len(scene.shape)
        for (chunk,) in Tiling.of((scene.size,), grid.MAX_POINTS_PER_TILE):
            self._predict(chunk)

    def _predict(self, chunk: slice) -> None:
        """Predict the motions at a slice of flat indices. Points without a motion count as computed; only their status is set."""
        points = grid.points_at_indices(self.scene, np.arange(chunk.start, chunk.stop))
        self.n_existing += int(points.exists.sum())
        self.computed.reshape(-1)[chunk] = ~points.exists
        status = np.where(points.exists, 0, grid.status_of(points.reason))
        initial = [status * (name == "status") for name in self.flags]
        self.flag_code.reshape(-1)[chunk] = _encode(initial, self.flag_counts)
        for name in self.scene.solve:
            self.numbers[name].reshape(-1)[chunk] = points.base[name]
        existing = chunk.start + np.flatnonzero(points.exists)
        if existing.size:
            # Without outputs, motions about axes other than the third and the vertical count as drifting and have a `log_growth` of 0.
            plan = replace(self.plan, outputs=())
            prediction = theory.predict_runs(plan, (part := points.subset(points.exists)))
            for name in self.numbers.keys() & {"growth_rate"}:
                self.numbers[name].reshape(-1)[existing] = prediction.variables[name]
            flags = [prediction.variables[name] for name in self.predicted_flags]
            self.predicted.reshape(-1)[existing] = _encode(flags, self.predicted_counts)
            # Growth is the growth rate times the duration. A nudged unstable point does not drift if the unstable component of the
            # nudge is below the fraction f = rate_tolerance / nudge * exp(-growth) of the nudge. This happens at a fraction f of
            # the points at most. At growth `needed`, f times the grid size is EXPECTED_MISSES. Without a nudge no point drifts.
            nudge = max(map(abs, self.scene.nudge.values()), default=0.0)
            with np.errstate(divide="ignore"):
                needed = np.log(part.rate_tolerance / nudge * self.scene.size / EXPECTED_MISSES)
            slow = prediction.log_growth < (needed if nudge > 0 else -np.inf)
            slow &= prediction.variables["stable"] == Stability.UNSTABLE
            self.slowly_unstable.reshape(-1)[existing] = slow

    def trace(self, levels: int, progress: bool) -> None:
        """Integrate points near measured boundaries level by level, then near predicted boundaries and at slow instabilities."""
        for level in range(levels + 1):
            self.refine_to(level)
            if progress:
                line = f"level {level} of {levels}: {self.n_integrated} of {self.n_existing} points"
                say(f"{line} ({100 * self.n_integrated / self.n_existing:.2f} %)", file=sys.stderr)
        slow = (self.slowly_unstable[box] for box in Tiling.of(self.scene.shape, MAX_BOX_POINTS))
        masks = map(np.logical_or, self._near_boundary(self.predicted), slow)
        self._integrate(self._not_computed(self.finest, masks))
        self.trace_boundary(self.finest)

    def refine_to(self, level: int) -> None:
        """Integrate the whole grid of level 0. At later levels, copy flags from neighbours to new points and trace boundaries."""
        steps = [[max(k * n >> level, 1) for n in self.scene.coarsening] for k in (1, 2)]
        subgrid, before = (tuple(slice(None, None, step) for step in each) for each in steps)
        if level == 0:
            self._integrate(self._not_computed(subgrid, repeat(True)))
            return
        code, computed, coarse = self.flag_code[subgrid], self.computed[subgrid], self.flag_code[before]
        for box in Tiling.of(code.shape, MAX_BOX_POINTS):
            ranges = zip(box, subgrid, before, strict=True)
            neighbours = [np.arange(a.start, a.stop) // (wide.step // fine.step) for a, fine, wide in ranges]
            np.copyto(code[box], coarse[np.ix_(*neighbours)], where=~computed[box])
        self.trace_boundary(subgrid)

    def trace_boundary(self, subgrid: Box) -> None:
        """Integrate points near boundaries in `subgrid`, until all points near boundaries are computed."""
        while self._integrate(self._not_computed(subgrid, self._near_boundary(self.flag_code[subgrid]))):
            pass

    def probe(self, share: float) -> tuple[int, int]:
        """Integrate a random sample of the points with copied flags. Return the size of the sample, and how many copies were wrong."""
        rest, first, probed = self.n_existing - self.n_integrated, 0, list[np.ndarray]()
        places = np.random.default_rng(SEED).choice(rest, math.ceil(share * rest), replace=False)
        places.sort()
        for indices in self._not_computed(self.finest, repeat(True)):
            inside = slice(*np.searchsorted(places, (first, first + indices.size)))
            probed.append(indices[places[inside] - first])
            first += indices.size
        indices_probed = np.concatenate(probed)
        assumed = self.flag_code.reshape(-1)[indices_probed]
        self._integrate([indices_probed])
        missed = int((self.flag_code.reshape(-1)[indices_probed] != assumed).sum())
        self.trace_boundary(self.finest)
        return indices_probed.size, missed

    def _near_boundary(self, code: np.ndarray) -> Iterator[Mask]:
        """Yield a mask for each box, true within BOUNDARY_WIDTH points of a change of `code` along refined axes."""
        reach = [BOUNDARY_WIDTH * axis.can_be_refined for axis in self.scene.axes.values()]
        for box in Tiling.of(code.shape, MAX_BOX_POINTS):
            around = tuple(slice(max(a.start - n, 0), a.stop + n) for a, n in zip(box, reach, strict=True))
            pairs = zip(box, around, strict=True)
            inside = tuple(slice(a.start - b.start, a.stop - b.start) for a, b in pairs)
            yield grid.near_change(code[around], [1 + 2 * n for n in reach])[inside]

    def _not_computed(self, subgrid: Box, masks: Iterable[Mask | bool]) -> Iterator[np.ndarray]:
        """Yield, for each box, the flat indices of the points in `subgrid` that are not computed and that the mask of the box selects."""
        computed = self.computed[subgrid]
        for box, mask in zip(Tiling.of(computed.shape, MAX_BOX_POINTS), masks, strict=False):
            along_axes = zip(np.nonzero(mask & ~computed[box]), box, subgrid, strict=True)
            indices = [(part.start + index) * fine.step for index, part, fine in along_axes]
            yield np.ravel_multi_index(indices, self.scene.shape)

    def _integrate(self, parts: Iterable[np.ndarray]) -> int:
        """Integrate the points with the flat indices in `parts`, and return the number of points."""
        indices = np.concatenate([*parts])
        if not indices.size:
            return 0
        for some, values in self.integrate(indices):
            flags = [values[name] - self.registry[name].missing for name in self.flags]
            self.flag_code.reshape(-1)[some] = _encode(flags, self.flag_counts)
            for name in self.measured:
                self.numbers[name].reshape(-1)[some] = values[name]
        self.computed.reshape(-1)[indices] = True
        self.n_integrated += indices.size
        return indices.size

    def values(self, part: tuple[Any, ...]) -> dict[str, np.ndarray]:
        """Return variables and solved parameters at indices `part` along the axes."""
        columns = {name: column[part] for name, column in self.numbers.items()}
        predictions = _decode(self.predicted[part], self.predicted_counts)
        columns |= zip(self.predicted_flags, predictions, strict=True)
        flags = _decode(self.flag_code[part], self.flag_counts)
        for name, values in zip(self.flags, flags, strict=True):
            variable = self.registry[name]
            columns[name] = (values + variable.missing).astype(variable.dtype)
        if "predicted" in columns:
            columns["agreement"] = theory.agreement(columns["label"], columns["predicted"])
        return columns | {COMPUTED.name: self.computed[part].astype(np.int8)}


def expected_points(plan: ScenePlan) -> float:
    """Return the number of points that `refined` is expected to integrate, from a simulation with predicted flags."""
    scene = plan.scene
    assert scene.refine is not None
    levels, n_axes = scene.refine.levels, sum(factor > 1 for factor in scene.coarsening)
    # The simulated grid has at most MAX_PREDICTED points. The spacing is 2^finer times that of the finest grid.
    finer = next(i for i in count() if scene.size / 2 ** (n_axes * i) <= MAX_PREDICTED)
    axes = {
        name: replace(axis, values=axis.values[:: 2**finer]) if axis.can_be_refined else axis
        for name, axis in scene.axes.items()
    }
    simulated_levels = max(levels - finer, 0)
    coarser = replace(scene.refine, levels=simulated_levels)

    def predictions(indices: np.ndarray) -> Iterator[Part]:
        """Yield predictions as if they were measured flags, and 0 for flags that theory does not predict."""
        values = predicted.values(np.unravel_index(indices, predicted.scene.shape))
        zero = np.zeros(indices.size, np.int8)
        yield indices, {name: values.get(PREDICTIONS.get(name, ""), zero) for name in predicted.flags}

    simulated = replace(scene, axes=axes, refine=coarser, outputs=tuple(traced(scene)))
    predicted = FineGrid(replace(plan, scene=simulated), predictions, None)
    predicted.trace(simulated_levels, progress=False)
    near = sum(map(np.count_nonzero, predicted._near_boundary(predicted.flag_code)))
    existing_share, simulated_points = (
        predicted.n_existing / predicted.scene.size,
        float(predicted.n_integrated),
    )
    if finer > levels:  # even the grid of level 0 has more than MAX_PREDICTED points
        coarse = (-(-n // f) for n, f in zip(scene.shape, scene.coarsening, strict=True))
        simulated_points = existing_share * math.prod(coarse)
    new_share = 1 - 2.0**-n_axes  # fraction of the points of a level that the previous level does not contain
    first = max(finer - levels, 0) + 1
    # If the spacing is halved, the number of points near boundaries grows by the factor 2^(n_axes - 1).
    near_boundaries = new_share * near * sum(2 ** ((n_axes - 1) * i) for i in range(first, finer + 1))
    at_slow_instabilities = int(predicted.slowly_unstable.sum()) * (2 ** (n_axes * finer) - 1)
    expected = simulated_points + near_boundaries + at_slow_instabilities
    existing = existing_share * scene.size
    return min(expected + scene.refine.probe * max(existing - expected, 0.0), existing)


def _zeros(scene: Scene, types: Sequence[Any], folder: Path | None) -> Iterator[np.ndarray]:
    """Yield arrays of zeros in memory, or in unnamed files in `folder`. Raise BadInput if the arrays do not fit."""
    bytes_per_point = sum(np.dtype(kind).itemsize for kind in types)
    bytes_per_point += 0 if folder else len(scene.outputs)  # flags in memory take a byte each
    place, room = "this machine has", os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
    if folder:
        place, room = f"free on the disk of {folder} are", shutil.disk_usage(folder).free
    if scene.size * bytes_per_point > room:
        raise BadInput(
            f"refine: the finest grid of {scene.size} points needs {scene.size * bytes_per_point / 1e9:.3g} GB, {place}"
            f" {room / 1e9:.3g} GB; take fewer levels or fewer [outputs]"
        )
    for kind in types:
        if folder is None:
            yield np.zeros(scene.shape, kind)
            continue
        with tempfile.TemporaryFile(dir=folder) as file:
            if hasattr(os, "posix_fallocate"):  # on a full disk, a write to mapped memory kills the process
                os.posix_fallocate(file.fileno(), 0, scene.size * np.dtype(kind).itemsize)
            yield np.asarray(np.memmap(file, kind, "r+", shape=scene.shape))


def _encode(flags: Sequence[Flags], counts: Sequence[int]) -> np.ndarray:
    """Encode the flags of each point in one number. counts[i] is the number of values that flags[i] may have."""
    return np.ravel_multi_index(tuple(flags), tuple(counts), mode="clip")


def _decode(code: np.ndarray, counts: Sequence[int]) -> list[Flags]:
    """Return the flags that `_encode` encoded."""
    steps = (math.prod(counts[i + 1 :]) for i in range(len(counts)))
    return [(code // step % n).astype(np.int8) for step, n in zip(steps, counts, strict=True)]
