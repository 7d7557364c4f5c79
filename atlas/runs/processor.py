"""A hash that shows whether two processors give the same bits. Libraries choose different code for different processors."""

from __future__ import annotations

import hashlib
import math
from functools import lru_cache

import numpy as np

SAMPLE, MATRICES = 1001, 99  # Both numbers are odd, so that the last vector register is only partly filled.


@lru_cache(maxsize=1)
def library_bits() -> str:
    """Return a hash of results of NumPy, LAPACK and libm on fixed numbers. Processors that compute other bits give another hash."""
    x = np.arange(1, SAMPLE + 1) / SAMPLE
    reverse = x[::-1]
    matrices = (np.arange(MATRICES * 36) * 7919 % 1009 / 1009 - 0.5).reshape(-1, 6, 6)
    z, symmetric = x + 1j * reverse, matrices + matrices.swapaxes(1, 2)
    functions = (
        np.sin, np.cos, np.tan, np.arcsin, np.arccos, np.exp, np.exp2, np.log, np.log2, np.log10, np.sinc,
    )  # fmt: skip
    results = [
        *(function(x) for function in functions),
        *(function(1000.0 * x) for function in (np.sin, np.cos)),
        *(function(x, reverse) for function in (np.arctan2, np.hypot, np.power)),
        *(function(z) for function in (np.exp, np.sqrt, np.log, np.abs, np.square, np.angle)),
        z * z[::-1],
        z / z[::-1],
        *(np.array([function(value) for value in x.tolist()]) for function in (math.sin, math.cos, math.exp, math.log)),
        np.array([np.sum(x), np.mean(reverse), np.linalg.norm(x)]),
        matrices @ symmetric,
        np.einsum("nij,nj->ni", matrices, matrices[:, 0]),
        np.linalg.solve(matrices + np.eye(6), symmetric),
        np.linalg.det(matrices),
        np.linalg.eigvals(matrices),
        np.linalg.eigvalsh(symmetric),
        *np.linalg.eigh(symmetric),
        *np.linalg.svd(matrices),
    ]  # fmt: skip
    return hashlib.sha256(b"".join(np.ascontiguousarray(each).tobytes() for each in results)).hexdigest()[:16]
