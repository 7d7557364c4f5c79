"""Random numbers in formulas of scenes. A number depends only on the arguments of a draw, and not on tiles, threads or order of points."""

from __future__ import annotations

from hashlib import blake2b

import numpy as np
from numpy.typing import NDArray

from ..systems.base import Array


def mixed(counter: NDArray[np.uint64]) -> NDArray[np.uint64]:
    """Return random bits from a counter by the algorithm SplitMix64 of G. L. Steele, D. Lea & C. H. Flood, OOPSLA 2014."""
    bits = (counter + np.uint64(1)) * np.uint64(0x9E3779B97F4A7C15)
    bits = (bits ^ (bits >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    bits = (bits ^ (bits >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    return np.asarray(bits ^ (bits >> np.uint64(31)))


def uniform(key: str, *values: Array) -> Array:
    """Return uniform random numbers in (0, 1) that `key` and `values` determine. A value that is not finite gives nan."""
    bits: NDArray[np.uint64] = np.frombuffer(blake2b(key.encode(), digest_size=8).digest(), "<u8")[0]
    no_number = np.asarray(0.0)
    for value in values:
        bits = mixed(bits ^ np.asarray(value + 0.0).view(np.uint64))  # the sum turns -0.0 into 0.0
        no_number = np.asarray(no_number + 0.0 * value)
    return np.asarray(((bits >> np.uint64(12)).astype(np.float64) + 0.5) * 2.0**-52 + no_number)


def normal(key: str, *values: Array) -> Array:
    """Return standard normal random numbers. The arguments are those of `uniform`."""
    from scipy.special import ndtri  # The import is slow, and most scenes do not need it.

    return np.asarray(ndtri(uniform(key, *values)))


DRAWS = {"normal": normal, "uniform": uniform}
