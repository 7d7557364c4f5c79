"""Numbers for the summary of a run, added or compared tile by tile."""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from ..flags import LABELS, Label, Stability

COUNTED = (*LABELS, "regularity", "status", "agreement", "computed")
# Groups of points with separate histograms of errors: drifting motions amplify errors, steady ones do not.
GROUPS = {"steady": (Label.REGULAR_PRECESSION, Label.PERMANENT_ROTATION), "drifting": (Label.DRIFTING,)}
# Histogram of errors: quarters of a decade from 1e-20 on.
BINS_PER_DECADE, LOWEST_DECADE, BINS = 4, -20, 161


class Tally:
    """Counts of flags and of errors, and largest values."""

    def __init__(self) -> None:
        # Points by flag variable and flag, or by group of GROUPS and bin of errors; largest values by variable or group,
        # and errors by whether theory finds the motion unstable.
        self.counts, self.largest = defaultdict[str, Counter[str]](Counter), dict[str, float]()

    @classmethod
    def of(cls, columns: Mapping[str, np.ndarray]) -> Tally:
        """Tally of points by their variables, arrays of one shape."""
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
    """Sums over some tiles."""

    points: int = 0
    seconds: float = 0.0
    by: Counter[str] = field(default_factory=Counter)  # tiles by the processes that computed them
    cpu: Counter[str] = field(default_factory=Counter)  # tiles by the processor
    reused: Counter[str] = field(default_factory=Counter)  # points by the earlier atlas
    tally: Tally = field(default_factory=Tally)

    def add(self, header: Mapping[str, Any]) -> None:
        """Add a tile by its header, or other totals by `table`."""
        self.points += header["points"]
        self.seconds += header["seconds"]
        for name, tiles in {"by": self.by, "cpu": self.cpu}.items():
            tiles.update([header[name]] if isinstance(header[name], str) else header[name])
        self.reused.update(header["reused"])
        self.tally.add(**header["tally"])

    def table(self) -> dict[str, Any]:
        """The sums as entries of JSON."""
        counts = {name: dict(sorted(number.items())) for name, number in sorted(self.tally.counts.items())}
        return vars(self) | {"tally": {"counts": counts, "largest": dict(sorted(self.tally.largest.items()))}}
