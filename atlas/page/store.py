"""Arrays of an atlas as compact text: each only over the axes along which it varies, compressed, in base64."""

from __future__ import annotations

import base64
import zlib
from typing import Any

import numpy as np

# Types of JavaScript's typed arrays, by their names there.
_TYPES = {"int8": "Int8Array", "int32": "Int32Array", "float32": "Float32Array", "float64": "Float64Array"}
_LEVEL = 9


class Store:
    """Arrays over the points of an atlas, each stored once.

    shape: shape of the points.

    nbytes: bytes of the arrays before compression.
    """

    def __init__(self, shape: tuple[int, ...]):
        self.shape = shape
        self.nbytes = 0
        self._arrays: list[np.ndarray] = []
        self._numbers: dict[tuple[str, bytes], int] = {}

    def add(self, values: np.ndarray) -> dict[str, Any]:
        """Keep an array over the points.

        values: of a type of `_TYPES` and of the shape of the points. Returns "array", the number of its
        entry, and "over", the axes along which it varies, in C order.
        """
        over = []
        bits = np.broadcast_to(values, self.shape)
        bits = np.ascontiguousarray(bits).view(f"u{values.dtype.itemsize}")
        for axis in range(len(self.shape)):
            first = bits.take([0], axis)
            if bits.shape[axis] > 1 and (bits == first).all():
                bits = first
            elif bits.shape[axis] > 1:
                over.append(axis)
        bits = np.ascontiguousarray(bits).ravel()
        key = values.dtype.name, bits.tobytes()
        if key not in self._numbers:
            self._numbers[key] = len(self._arrays)
            self._arrays.append(bits.view(values.dtype))
            self.nbytes += bits.nbytes
        return {"array": self._numbers[key], "over": over}

    def packed(self) -> list[dict[str, Any]]:
        """The arrays as entries of a table.

        Returns for each array its "type" in JavaScript, its "size" and its "data": the bytes, all first ones
        before all second ones and so on, compressed by zlib, in base64.
        """
        return [_packed(array) for array in self._arrays]


def float_array(values: np.ndarray) -> np.ndarray:
    """Numbers as float32, seven digits; as float64 where their magnitudes need it."""
    values = np.asarray(values, np.float64)
    size = np.abs(values[np.isfinite(values) & (values != 0.0)])
    fits = not size.size or bool(size.max() < 1e38 and size.min() > 1e-37)
    return values.astype(np.float32) if fits else values


def _packed(array: np.ndarray) -> dict[str, Any]:
    """One entry of a store."""
    little = array.astype(array.dtype.newbyteorder("<"))
    columns = little.view(np.uint8).reshape(array.size, array.itemsize).T
    compressed = zlib.compress(np.ascontiguousarray(columns).tobytes(), _LEVEL)
    return {
        "type": _TYPES[array.dtype.name],
        "size": array.size,
        "data": base64.b64encode(compressed).decode("ascii"),
    }
