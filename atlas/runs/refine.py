"""Refinement: an atlas on a fine grid, integrated only around the boundaries between different flags."""

from __future__ import annotations

import math
import os
import sys
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from typing import ClassVar, TypeAlias

import numpy as np
import xarray as xr

from ..errors import BadInput, say
from ..flags import Stability
from ..io import netcdf
from ..label import theory
from ..scene import grid
from ..systems.base import Flags
from ..validation import half_step
from ..variables import COMPUTED, variables
from .levels import MAX_VALUES, MEASURED
from .plan import ScenePlan

COMPUTED_SHARE = "atlas_computed_share"
# Integrates points by their flat indices in the finest grid, and gives the variables of some of them at a time.
Part: TypeAlias = tuple[slice, Mapping[str, np.ndarray]]
Integrate: TypeAlias = Callable[[np.ndarray], Iterable[Part]]
PREDICTED = ("family", "stable", "predicted", "predicted_inertial")
# Points on either side of a boundary that are integrated, at each level: with 2, every point of a cell
# whose corners differ, and the cells around it.
BOUNDARY_WIDTH = 2
# Expected number of nudged unstable motions that survive the run outside the points that are integrated.
EXPECTED_MISSES = 0.05
SEED = 0
# Points of the grid on which the cost of a refined scene is estimated.
MAX_PREDICTED = 2**18


def refined(
    integrate: Integrate, plan: ScenePlan, *, threads: int | None = None, progress: bool = True
) -> xr.Dataset:
    """Compute the atlas of a scene that has [refine], on its finest grid; its attributes are those stated here.

    The coarse grid is integrated. At each level the spacing is halved and the points within BOUNDARY_WIDTH of
    two points with different flags are integrated, until every boundary runs between integrated points. On
    the finest grid two more sets of points are integrated, and boundaries that appear in them are traced in
    the same way: first the points near boundaries of what theory predicts (it is evaluated at every point),
    and the points where an instability has hardly time to grow; then the probe, a random share of all others.

    Where the variable `computed` is `interpolated`, measured flags are copied from neighbours and measured
    numbers are nan. Attributes: atlas_computed_share, the share of points integrated among the points where
    the family exists; atlas_probe_points and atlas_probe_missed, the size of the probe and how many of its
    points had unexpected flags.
    """
    scene = plan.scene
    assert scene.refine is not None
    numbers = sum(variables(scene.system)[name].flags is None for name in scene.outputs) + len(scene.solve)
    needed = scene.size * (8 * numbers + len(PREDICTED) + 5)
    memory = os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
    if needed > memory:
        raise BadInput(
            f"refine: the finest grid of {scene.size} points needs {needed / 1e9:.3g} GB, this machine has"
            f" {memory / 1e9:.3g} GB; take fewer levels or fewer [outputs]"
        )
    fine = _FineGrid(plan, threads, integrate)
    for level in range(scene.refine.levels + 1):
        fine.refine_to(level)
        if progress:
            line = f"level {level} of {scene.refine.levels}: {fine.n_integrated} of {fine.n_existing} points"
            say(f"{line} ({100 * fine.n_integrated / fine.n_existing:.2f} %)", file=sys.stderr)
    fine.trace_predicted_boundary()
    probe_points, probe_missed = fine.probe(scene.refine.probe)
    ds = fine.dataset()
    attributes = {
        COMPUTED_SHARE: fine.n_integrated / fine.n_existing,
        "atlas_probe_points": probe_points,
        "atlas_probe_missed": probe_missed,
    }
    return ds.assign_attrs(attributes | half_step.half_step_sample(scene, plan.points, threads=threads))


class _FineGrid:
    """The finest grid of a scene: predictions at every point, measurements where points are integrated.

    `flag_code` holds the measured flags of each point as one number: measured where `computed` is true
    (integrated, or without motion), assumed elsewhere. A spacing is a number of fine points for each axis.
    """

    def __init__(self, plan: ScenePlan, threads: int | None, integrate: Integrate):
        self.scene, self.plan, self.threads, self.integrate = plan.scene, plan.points, threads, integrate
        scene = plan.scene
        self.registry = variables(scene.system)
        self.flags = [name for name in MEASURED if name == "label" or name in scene.outputs]
        self.flag_counts = [len(self.registry[name].flags or range(MAX_VALUES)) for name in self.flags]
        self.numbers = {
            name: np.full(scene.size, np.nan)
            for name in scene.outputs
            if self.registry[name].flags is None and name not in ("growth_rate", *self.flags)
        }
        self.solved = {name: np.empty(scene.size) for name in scene.solve}
        self.growth_rates = {
            name: np.full(scene.size, np.nan) for name in ("growth_rate",) if name in scene.outputs
        }
        self.predicted = {name: np.zeros(scene.size, np.int8) for name in PREDICTED if name in self.registry}
        self.slowly_unstable = np.zeros(scene.size, bool)
        # Product of growth rate and duration above which all nudged unstable points but EXPECTED_MISSES drift. A nudge survives
        # if its component along the unstable motion is a smaller share of it than rate_tolerance / nudge * exp(-growth): the
        # share of such starts among all points, in regions narrower than the spacing. Without a nudge no point drifts.
        nudge, self.growth_needed = max(map(abs, scene.nudge.values()), default=0.0), -math.inf
        if nudge > 0:
            missed_without_growth = scene.settings.rate_tolerance / nudge * scene.size
            self.growth_needed = math.log(missed_without_growth / EXPECTED_MISSES)
        reason = np.empty(scene.size, np.int8)
        for chunk in chunks(scene.size):
            reason[chunk] = self._predict(np.arange(chunk.start, chunk.stop))
        exists = reason == grid.Reason.NONE
        self.n_existing, self.n_integrated = int(exists.sum()), 0
        # Points without motion are computed: their flags are 0, not_computed, but for the status.
        self.computed = ~exists.reshape(scene.shape)
        initial = {name: np.zeros(scene.size, np.int8) for name in self.flags}
        if "status" in initial:
            initial["status"] = np.where(exists, 0, grid.status_of(reason))
        self.flag_code = (
            np.broadcast_to(_encode(initial, self.flag_counts), scene.size).reshape(scene.shape).copy()
        )

    def _predict(self, indices: np.ndarray) -> np.ndarray:
        """Evaluate theory at points of the grid; returns why they are not computed, values of grid.Reason."""
        points = grid.points_at_indices(self.scene, indices)
        for name, column in self.solved.items():
            column[indices] = points.base[name]
        existing = indices[points.exists]
        if existing.size:
            # How long a motion about other axes lasts does not count here.
            plan = replace(self.plan, outputs=())
            prediction = theory.predict_runs(plan, points.subset(points.exists), threads=self.threads)
            for name, rates in self.growth_rates.items():
                rates[existing] = prediction.variables[name]
            for name, flags in self.predicted.items():
                flags[existing] = prediction.variables[name]
            unstable = prediction.variables["stable"] == Stability.UNSTABLE
            self.slowly_unstable[existing] = unstable & (prediction.log_growth < self.growth_needed)
        return points.reason

    def refine_to(self, level: int) -> None:
        """Compute all of the grid at level 0; later, new points first assume the flags of a neighbour."""
        coarsening = self.scene.coarsening
        spacing = [max(factor >> level, 1) for factor in coarsening]
        subgrid = _subgrid(spacing)
        if level == 0:
            self._integrate(np.flatnonzero(~self.computed[subgrid]), spacing)
            return
        spacing_before = [min(2 * n, factor) for n, factor in zip(spacing, coarsening, strict=True)]
        assumed = self.flag_code[_subgrid(spacing_before)]
        for axis, factor in enumerate(coarsening):
            if factor > 1:
                assumed = np.repeat(assumed, 2, axis).take(range(2 * assumed.shape[axis] - 1), axis)
        self.flag_code[subgrid] = np.where(self.computed[subgrid], self.flag_code[subgrid], assumed)
        self.trace_boundary(spacing)

    def trace_boundary(self, spacing: Sequence[int]) -> None:
        """Integrate near boundaries, on the grid of this spacing, until they run between computed points."""
        subgrid = _subgrid(spacing)
        while (
            indices := np.flatnonzero(self._near_boundary(self.flag_code[subgrid]) & ~self.computed[subgrid])
        ).size:
            self._integrate(indices, spacing)

    def trace_predicted_boundary(self) -> None:
        """Integrate near boundaries of the predictions and at slowly unstable points, then trace boundaries."""
        code = _encode(self.predicted, [len(self.registry[name].flags or ()) for name in self.predicted])
        code = np.broadcast_to(code, self.scene.size)  # one number if the system has no theory
        near_boundary = self._near_boundary(code.reshape(self.scene.shape))
        chosen = near_boundary | self.slowly_unstable.reshape(self.scene.shape)
        finest = [1] * len(self.scene.shape)
        self._integrate(np.flatnonzero(chosen & ~self.computed), finest)
        self.trace_boundary(finest)

    def probe(self, share: float) -> tuple[int, int]:
        """Integrate a random share of the rest and trace boundaries; the numbers of points and surprises."""
        not_computed = np.flatnonzero(~self.computed)
        count = math.ceil(share * not_computed.size)
        chosen = np.random.default_rng(SEED).choice(not_computed, count, replace=False)
        chosen.sort()
        assumed = self.flag_code.flat[chosen]
        finest = [1] * len(self.scene.shape)
        self._integrate(chosen, finest)
        missed = int((self.flag_code.flat[chosen] != assumed).sum())
        self.trace_boundary(finest)
        return chosen.size, missed

    def _near_boundary(self, code: np.ndarray) -> np.ndarray:
        """Mask of points within BOUNDARY_WIDTH of two different codes, along the axes that are refined."""
        window = [1 + 2 * BOUNDARY_WIDTH * axis.can_be_refined for axis in self.scene.axes.values()]
        return grid.near_change(code, window)

    def _integrate(self, subgrid_indices: np.ndarray, spacing: Sequence[int]) -> None:
        """Integrate points given by their flat indices in the grid of this spacing."""
        subgrid_shape = self.computed[_subgrid(spacing)].shape
        along_axes = np.unravel_index(subgrid_indices, subgrid_shape)
        fine_indices = [index * step for index, step in zip(along_axes, spacing, strict=True)]
        indices = np.ravel_multi_index(fine_indices, self.scene.shape)
        for chunk, values in self.integrate(indices):
            flags = {name: values[name] - self.registry[name].missing for name in self.flags}
            self.flag_code.flat[indices[chunk]] = _encode(flags, self.flag_counts)
            for name, column in self.numbers.items():
                column[indices[chunk]] = values[name]
        self.computed.flat[indices] = True
        self.n_integrated += indices.size

    def dataset(self) -> xr.Dataset:
        """The atlas without provenance."""
        columns = dict[str, np.ndarray](self.numbers) | self.growth_rates | self.predicted | self.solved
        for name, values in zip(self.flags, _decode(self.flag_code.ravel(), self.flag_counts), strict=True):
            variable = self.registry[name]
            columns[name] = (values + variable.missing).astype(variable.dtype)
        if "predicted" in self.predicted:
            columns["agreement"] = theory.agreement(columns["label"], self.predicted["predicted"])
        ds = netcdf.dataset(self.scene, columns)
        ds["computed"] = netcdf.dims(self.scene), self.computed.astype(np.int8), COMPUTED.attributes()
        return ds


class _PredictedGrid(_FineGrid):
    """A finest grid with predictions in place of all measurements, so that no point is integrated."""

    # Measured flag -> the prediction in its place, whose boundaries are the expected ones.
    PREDICTIONS: ClassVar = {
        "label": "predicted",
        "label_inertial": "predicted_inertial",
        "geometry": "family",
        "status": "stable",
    }

    def __init__(self, plan: ScenePlan):
        scene = replace(plan.scene, outputs=tuple(n for n in plan.scene.outputs if n in MEASURED))
        super().__init__(replace(plan, scene=scene), 1, self._predictions)

    def _predictions(self, indices: np.ndarray) -> Iterator[Part]:
        """Predictions in place of the measured flags; 0 where theory predicts nothing of a flag."""
        zero = np.zeros(indices.size, np.int8)
        predictions = {name: self.predicted.get(self.PREDICTIONS.get(name, "")) for name in self.flags}
        yield (
            slice(None),
            {name: zero if flags is None else flags[indices] for name, flags in predictions.items()},
        )


def expected_points(plan: ScenePlan) -> float:
    """Expected number of points that `refined` integrates, from the boundaries that theory predicts.

    The refinement is simulated on a grid of at most MAX_PREDICTED points, with predictions in place of
    measurements. On each finer grid the points near boundaries grow like the length (area, ...) of the
    boundaries in units of the spacing, and the points of slow instabilities like the number of all points. A
    boundary that theory does not predict is not counted.
    """
    scene = plan.scene
    assert scene.refine is not None
    levels, n_axes = scene.refine.levels, sum(factor > 1 for factor in scene.coarsening)
    finer = 0  # levels between the grid of the simulation and the finest one
    while scene.size / 2 ** (n_axes * finer) > MAX_PREDICTED:
        finer += 1
    # The scene with 2^finer times the spacing.
    axes = {
        name: replace(axis, values=axis.values[:: 2**finer]) if axis.can_be_refined else axis
        for name, axis in scene.axes.items()
    }
    coarser = replace(scene.refine, levels=max(levels - finer, 0))
    predicted = _PredictedGrid(replace(plan, scene=replace(scene, axes=axes, refine=coarser)))
    for level in range(max(levels - finer, 0) + 1):
        predicted.refine_to(level)
    predicted.trace_predicted_boundary()
    # Points of the finest grid near a boundary of the flags.
    near = int((predicted._near_boundary(predicted.flag_code) & predicted.computed).sum())
    slow = int(predicted.slowly_unstable.sum())
    existing_share = predicted.n_existing / predicted.scene.size
    expected = float(predicted.n_integrated)
    if finer > levels:  # not even the coarse grid is small enough
        expected = existing_share * math.prod(
            -(-n // f) for n, f in zip(scene.shape, scene.coarsening, strict=True)
        )
    new_share = 1 - 2.0**-n_axes  # share of the points of a level that no coarser level has
    first = max(finer - levels, 0) + 1
    expected += new_share * near * sum(2 ** ((n_axes - 1) * i) for i in range(first, finer + 1))
    expected += slow * (2 ** (n_axes * finer) - 1)
    existing = existing_share * scene.size
    return min(expected + scene.refine.probe * max(existing - expected, 0.0), existing)


def _subgrid(spacing: Sequence[int]) -> tuple[slice, ...]:
    """Slices of the points of the finest grid with this spacing."""
    return tuple(slice(None, None, step) for step in spacing)


def chunks(size: int) -> Iterator[slice]:
    """Slices that cut a range of indices into pieces of at most grid.MAX_POINTS_PER_TILE."""
    for first in range(0, size, grid.MAX_POINTS_PER_TILE):
        yield slice(first, min(first + grid.MAX_POINTS_PER_TILE, size))


def _encode(flags: Mapping[str, Flags], counts: Sequence[int]) -> np.ndarray:
    """Several flags of each point as one number; counts: how many values each flag has."""
    kind = np.min_scalar_type(-math.prod(counts))  # signed, and as short as may be
    code = np.zeros(1, kind)
    for values, count in zip(flags.values(), counts, strict=True):
        code = (code * count + values).astype(kind)
    return code


def _decode(code: np.ndarray, counts: Sequence[int]) -> list[Flags]:
    """Inverse of `_encode`."""
    flags: list[Flags] = []
    for count in reversed(counts):
        flags.insert(0, (code % count).astype(np.int8))
        code = code // count
    return flags
