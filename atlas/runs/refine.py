"""Refinement at the borders: an atlas on a fine grid of which only the surroundings of borders are integrated."""

from __future__ import annotations

import math
import sys
import time
from collections.abc import Iterator, Mapping, Sequence

import numpy as np
import xarray as xr
from scipy.ndimage import maximum_filter, minimum_filter

from ..flags import Stability
from ..io import netcdf, provenance
from ..label import theory
from ..label.pipeline import evaluate_tile, scene_kernel_hash
from ..scene import grid
from ..scene.model import Scene
from ..systems.base import Flags
from ..validation import half_step
from ..variables import COMPUTED, variables

# Measured flags; borders of those that the scene asks for are followed, and of the label always.
MEASURED = ("label", "label_inertial", "geometry", "status")
THEORY = ("family", "stable", "predicted", "predicted_inertial")
# Points on either side of a border that are integrated, at each level: with 2, every point of a cell
# whose corners differ, and the cells around it.
BORDER_WIDTH = 2
# Nudged unstable motions that survive the run outside what is integrated: at most so many are expected.
EXPECTED_MISSES = 0.05
SEED = 0


def refined(
    scene: Scene, remarks: list[str], *, threads: int | None = None, progress: bool = True
) -> xr.Dataset:
    """The atlas of a scene that has [refine], on its finest grid, integrated around borders only.

    The coarse grid is integrated; at each level, of half the spacing, so are the points not farther than
    WIDTH from two points with different flags, until every border runs between integrated points. On the
    finest grid the same is done around borders of what theory predicts, which is computed everywhere, where
    instability has hardly time to show, and for a random share of the points left over, the probe; those
    found to differ are followed like borders.

    remarks: the system's warnings, for the attributes. Returns a Dataset as `runner.run` does, with the
    variable `computed`; where that is `interpolated`, measured flags are those of the points around and
    measured numbers are nan. Attributes: atlas_computed_share, of the points integrated among those where
    the family exists; atlas_probe_points and atlas_probe_missed, points of the probe and how many of them
    had other flags than were assumed.
    """
    assert scene.refine is not None
    began = time.perf_counter()
    fine = _FineGrid(scene, threads)
    for level in range(scene.refine.levels + 1):
        fine.level(level)
        if progress:
            done = f"level {level} of {scene.refine.levels}: {fine.integrated} of {fine.points} points"
            print(f"{done} ({100 * fine.integrated / fine.points:.2f} %)", file=sys.stderr)
    fine.follow_theory()
    tried, missed = fine.probe(scene.refine.probe)
    ds = fine.dataset()
    facts = {
        "atlas_computed_share": fine.integrated / fine.points,
        "atlas_probe_points": tried,
        "atlas_probe_missed": missed,
    }
    return ds.assign_attrs(
        provenance.provenance(
            scene.system, scene.settings, scene_kernel_hash(scene), title=scene.title, scene=scene.toml(),
            seconds=time.perf_counter() - began, points=fine.integrated, remarks=remarks,
        ) | facts | half_step.half_step_sample(scene, threads=threads)
    )  # fmt: skip


class _FineGrid:
    """The finest grid: what theory says at every point, what is known, and what is assumed of the rest."""

    def __init__(self, scene: Scene, threads: int | None):
        self.scene, self.threads = scene, threads
        self.kinds = variables(scene.system)
        self.flags = [n for n in MEASURED if n == "label" or n in scene.outputs]
        self.integrated = 0
        numbers = [n for n in scene.outputs if self.kinds[n].flags is None and n != "growth_rate"]
        self.numbers = {name: np.full(scene.size, np.nan) for name in numbers}
        self.solved = {name: np.empty(scene.size) for name in scene.solve}
        self.growth_rate = np.full(scene.size, np.nan)
        self.theory = {n: np.zeros(scene.size, np.int8) for n in THEORY if n in self.kinds}
        there, self.slow = np.empty(scene.size, bool), np.zeros(scene.size, bool)
        for part in _chunks(scene.size):
            indices = np.arange(part.start, part.stop)
            points = grid.points_at_indices(scene, indices)
            for name, column in self.solved.items():
                column[part] = points.base[name]
            there[part], where = points.there, indices[points.there]
            if not where.size:
                continue
            base = {name: values[points.there] for name, values in points.base.items()}
            with np.errstate(all="ignore"):
                found = theory.predict(scene.system, base, scene.settings.rate_tolerance, bool(scene.nudge))
            self.growth_rate[where] = found["growth_rate"]
            for name, flag in self.theory.items():
                flag[where] = found[name]
            grown = found["growth_rate"] * points.duration[points.there]
            self.slow[where] = (found["stable"] == Stability.UNSTABLE) & (grown < _growth_needed(scene))
        self.points = int(there.sum())
        # a point without motion has the code 0, that of not_computed
        self.known = ~there.reshape(scene.shape)
        self.code = np.zeros(scene.shape, np.int16)

    def level(self, level: int) -> None:
        """Go on to a grid; level 0 is the coarse one. Each point begins with the code of one beside it."""
        steps = [max(stride >> level, 1) for stride in self.scene.strides]
        here = tuple(slice(None, None, step) for step in steps)
        if level == 0:
            self._learn(np.flatnonzero(~self.known[here]), steps)
            return
        before = self.code[tuple(slice(None, None, min(2 * step, stride)) for step, stride in
                                 zip(steps, self.scene.strides, strict=True))]  # fmt: skip
        for axis, stride in enumerate(self.scene.strides):
            if stride > 1:
                before = np.repeat(before, 2, axis).take(range(2 * before.shape[axis] - 1), axis)
        self.code[here] = np.where(self.known[here], self.code[here], before)
        self.follow(steps)

    def follow(self, steps: Sequence[int]) -> None:
        """Integrate around borders on the grid of these steps until they run between known points."""
        here = tuple(slice(None, None, step) for step in steps)
        while (todo := np.flatnonzero(self._near(self.code[here]) & ~self.known[here])).size:
            self._learn(todo, steps)

    def follow_theory(self) -> None:
        """Integrate around the borders of what theory says and where it is not sure; follow what is found."""
        said = _code(self.theory, [len(self.kinds[name].flags or ()) for name in self.theory])
        ones = [1] * len(self.scene.shape)
        todo = self._near(said.reshape(self.scene.shape)) | self.slow.reshape(self.scene.shape)
        self._learn(np.flatnonzero(todo & ~self.known), ones)
        self.follow(ones)

    def probe(self, share: float) -> tuple[int, int]:
        """Integrate a random share of the points not known and follow what is found; how many, how many missed."""
        unknown = np.flatnonzero(~self.known)
        tried = np.random.default_rng(SEED).choice(unknown, math.ceil(share * unknown.size), replace=False)
        tried.sort()
        assumed = self.code.flat[tried]
        ones = [1] * len(self.scene.shape)
        self._learn(tried, ones)
        missed = int((self.code.flat[tried] != assumed).sum())
        self.follow(ones)
        return tried.size, missed

    def _near(self, code: np.ndarray) -> np.ndarray:
        """Points within WIDTH of two different codes, along the axes that are refined; bool."""
        window = [1 + 2 * BORDER_WIDTH * (stride > 1) for stride in self.scene.strides]
        return np.asarray(maximum_filter(code, window) != minimum_filter(code, window))

    def _learn(self, places: np.ndarray, steps: Sequence[int]) -> None:
        """Integrate points given by their flat indices in the grid of these steps."""
        coarse = self.known[tuple(slice(None, None, step) for step in steps)].shape
        at = [i * step for i, step in zip(np.unravel_index(places, coarse), steps, strict=True)]
        indices = np.ravel_multi_index(at, self.scene.shape)
        for part in _chunks(indices.size):
            some = indices[part]
            values = evaluate_tile(self.scene, grid.points_at_indices(self.scene, some), threads=self.threads)
            self.code.flat[some] = _code({n: values[n] for n in self.flags}, self._lengths())
            for name, column in self.numbers.items():
                column[some] = values[name]
        self.known.flat[indices] = True
        self.integrated += indices.size

    def _lengths(self) -> list[int]:
        return [len(self.kinds[name].flags or ()) for name in self.flags]

    def dataset(self) -> xr.Dataset:
        """The atlas without provenance."""
        scene, columns = self.scene, dict[str, np.ndarray](self.numbers) | self.theory
        columns["growth_rate"] = self.growth_rate
        for name, values in zip(self.flags, _decoded(self.code.ravel(), self._lengths()), strict=True):
            columns[name] = values
        columns["agreement"] = theory.agreement(columns["label"], self.theory["predicted"])
        ds = netcdf.dataset(
            scene,
            {name: columns[name].reshape(scene.shape) for name in scene.outputs},
            {name: values.reshape(scene.shape) for name, values in self.solved.items()},
        )
        ds["computed"] = netcdf.dims(scene), self.known.astype(np.int8), COMPUTED.attributes()
        return ds


def _growth_needed(scene: Scene) -> float:
    """Growth_rate x duration above which all nudged unstable points of a scene drift, but MISSED of them.

    A nudge survives if less than the share rate_tolerance / nudge exp(-growth) of it is unstable motion.
    Starts of which that is true lie on needles, of this share of all points, thinner than the grid.
    Starts without nudge have none: -inf.
    """
    size = max(map(abs, scene.nudge.values()), default=0.0)
    return (
        math.log(scene.settings.rate_tolerance / size * scene.size / EXPECTED_MISSES) if size else -math.inf
    )


def _chunks(size: int) -> Iterator[slice]:
    for first in range(0, size, grid.MAX_POINTS_PER_TILE):
        yield slice(first, min(first + grid.MAX_POINTS_PER_TILE, size))


def _code(flags: Mapping[str, Flags], lengths: Sequence[int]) -> np.ndarray:
    """Several flags of each point as one number, int16."""
    code = np.zeros(1, np.int16)
    for values, length in zip(flags.values(), lengths, strict=True):
        code = (code * length + values).astype(np.int16)
    return code


def _decoded(code: np.ndarray, lengths: Sequence[int]) -> list[Flags]:
    flags: list[Flags] = []
    for length in reversed(lengths):
        flags.insert(0, (code % length).astype(np.int8))
        code = code // length
    return flags
