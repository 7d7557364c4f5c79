"""Counts and largest values for the summary of a run, which are collected tile by tile."""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from ..flags import LABELS, Label, Stability

COUNTED = (*LABELS, "regularity", "status", "agreement", "computed")
# These groups of labels have separate histograms of errors, because drifting motions amplify errors and steady motions do not.
GROUPS = {"steady": (Label.REGULAR_PRECESSION, Label.PERMANENT_ROTATION), "drifting": (Label.DRIFTING,)}
# A histogram of errors has BINS bins, each a quarter of a decade wide, from 1e-20 on.
BINS_PER_DECADE, LOWEST_DECADE, BINS = 4, -20, 161


class Tally:
    """Counts of flags, histograms of errors, and largest values."""

    def __init__(self) -> None:
        # `counts` maps each variable to numbers of points by flag, and each group in GROUPS to numbers of points by bin of errors.
        # `largest` has the largest integral_drift, and largest errors of each group, of unstable points, and of other points in any group.
        self.counts, self.largest = defaultdict[str, Counter[str]](Counter), dict[str, float]()

    @classmethod
    def of(cls, columns: Mapping[str, np.ndarray]) -> Tally:
        """Return the tally of points from columns of variables, which are arrays of equal shape."""
        tally = cls()
        counted = {name: columns[name] for name in COUNTED if name in columns}
        if "error_estimate" in columns and "label" in columns:
            labelled = np.isin(columns["label"], sum(GROUPS.values(), ()))
            unstable = columns.get("stable", np.zeros(labelled.shape)) == Stability.UNSTABLE
            for name, where in {"unstable": labelled & unstable, "others": labelled & ~unstable}.items():
                tally.largest[name] = float(np.nanmax(columns["error_estimate"][where], initial=0.0))
            for name, labels in GROUPS.items():
                values = columns["error_estimate"][np.isin(columns["label"], labels)]
                values = values[~np.isnan(values)]
                if values.size:
                    with np.errstate(divide="ignore"):
                        bins = np.ceil(BINS_PER_DECADE * (np.log10(np.fmax(values, 0.0)) - LOWEST_DECADE))
                    counted[name] = np.clip(bins, 0, BINS - 1).astype(np.int64)
                    tally.largest[name] = float(values.max())
        if "integral_drift" in columns:
            tally.largest["integral_drift"] = float(np.nanmax(columns["integral_drift"], initial=0.0))
        for name, values in counted.items():
            unique, counts = np.unique(values, return_counts=True)
            tally.counts[name] = Counter(dict(zip(map(str, unique.tolist()), counts.tolist(), strict=True)))
        return tally

    def add(self, counts: Mapping[str, Mapping[str, int]], largest: Mapping[str, float]) -> None:
        """Add the tally of other points."""
        for name, number in counts.items():
            self.counts[name].update({flag: int(n) for flag, n in number.items()})
        for name, value in largest.items():
            self.largest[name] = max(self.largest.get(name, float(value)), float(value))


@dataclass
class Totals:
    """Sums over a set of tiles."""

    points: int = 0
    seconds: float = 0.0
    by: Counter[str] = field(default_factory=Counter)  # number of tiles by computing threads or workers
    cpu: Counter[str] = field(default_factory=Counter)  # number of tiles by type of processor
    reused: Counter[str] = field(default_factory=Counter)  # number of points taken from each earlier atlas
    tally: Tally = field(default_factory=Tally)

    def add(self, header: Mapping[str, Any]) -> None:
        """Add the numbers in a tile's header, or the numbers that the method `table` of other Totals returned."""
        self.points += header["points"]
        self.seconds += header["seconds"]
        for name, tiles in {"by": self.by, "cpu": self.cpu}.items():
            tiles.update([header[name]] if isinstance(header[name], str) else header[name])
        self.reused.update(header["reused"])
        self.tally.add(**header["tally"])

    def table(self) -> dict[str, Any]:
        """Return the sums in the form of a JSON object."""
        counts = {name: dict(sorted(number.items())) for name, number in sorted(self.tally.counts.items())}
        return vars(self) | {"tally": {"counts": counts, "largest": dict(sorted(self.tally.largest.items()))}}
