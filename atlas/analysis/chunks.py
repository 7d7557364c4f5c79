"""Chunks of an atlas: one larger than memory is read some points at a time."""

from __future__ import annotations

import math
from collections.abc import Hashable, Iterator, Mapping, Sequence
from typing import Any

from ..runs.tiling import Tiling

# Points read at a time.
MAX_POINTS = 4_000_000


def chunks(
    sizes: Mapping[Any, int], dims: Sequence[Hashable], cell_side: int = 0
) -> Iterator[dict[Hashable, slice]]:
    """Slices that cut dimensions into boxes of about MAX_POINTS points, in C order.

    sizes: length of every dimension; those that are not in `dims` stay whole. dims: the dimensions to cut, in
    the order of the array. cell_side: 0: every point is in one box. Else boxes consist of whole cells with
    sides of so many points, and share the points on their borders with their neighbours; points at the end of
    an axis that do not fill a cell are in no box. Returns dimension -> slice, for the dimensions to cut.
    """
    step = max(cell_side, 1)
    counts = [(sizes[dim] - 1) // step if cell_side else max(sizes[dim], 1) for dim in dims]
    points_per_count = step ** len(dims) * math.prod(n for dim, n in sizes.items() if dim not in dims)
    tiling = Tiling.of(tuple(counts), MAX_POINTS // points_per_count)
    for tile in range(tiling.count):
        yield {
            dim: slice(step * part.start, step * part.stop + (cell_side > 0))
            for dim, part in zip(dims, tiling.slices(tile), strict=True)
        }
