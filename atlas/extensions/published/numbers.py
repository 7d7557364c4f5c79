"""Rows of numbers.toml, each with a published number, the computed number, and whether the two agree."""

from __future__ import annotations

import json
import tomllib
from collections.abc import Callable, Mapping
from decimal import Decimal
from functools import cache
from importlib import resources
from typing import Any

import numpy as np

import atlas

from ...analysis.metadata import flag_names
from ...errors import BadInput, one_line

# With these moments, (y1, y2, y3) = SCALES (p, q, r) obey y1' = y2 y3, y2' = -y1 y3, y3' = -0.51 y1 y2.
MOMENTS, SCALES = {"A": 1.196, "B": 1.4, "C": 0.9216}, (7 / 24, 5 / 12, 7 / 25)
# Each function reduces the values of a variable to the number that a row compares.
TAKE: dict[str, Callable[[Any], Any]] = {"only": np.ndarray.item, "least": np.nanmin, "greatest": np.nanmax}
TAKE["number of"] = lambda values: len(np.unique(values.round(9)))


def compared(system: str) -> list[dict[str, str]]:
    """Return rows about the published numbers of a system, in the order of the file."""
    content = tomllib.loads(resources.files(__package__).joinpath("numbers.toml").read_text("utf-8"))
    return [
        {key: source[key] for key in ("source", "place", "reading")}
        | _row(entry, content["computations"][entry["computation"]])
        for source in content["sources"]
        if source["system"] == system
        for entry in source["numbers"]
    ]


def _row(entry: Mapping[str, Any], computation: Mapping[str, Any]) -> dict[str, str]:
    """Return a row. Numbers agree up to half a unit of the last printed digit or, if larger, one unit of the last digit of `ours`."""
    function, arguments = computation["function"], json.dumps(computation["arguments"])
    take, output, (flag_variable, flag) = (
        entry.get("take", "only"),
        entry["output"],
        entry.get("where", ("", "")),
    )
    row = {key: entry.get(key, "") for key in ("quantity", "printed", "ours", "verdict", "remark")}
    where = f" where {flag_variable} is {flag}" if flag else ""
    row |= {"computation": f"{take} {output} of {function}{where}", "arguments": arguments}
    try:
        result = result_of(function, arguments)
    except (BadInput, AttributeError) as refusal:  # the extension with the function is not installed
        return row | {"verdict": f"not computed: {one_line(refusal)}"}
    values = np.asarray(result[output])
    if flag:
        flags = result[flag_variable]
        values = values[flags.values == flag_names(flags).index(flag)]
    ours, printed = float(TAKE[take](values)), Decimal(entry["printed"])
    decimals, difference = -int(printed.as_tuple().exponent), abs(ours - float(printed))
    shown = min(decimals + 1, entry.get("decimals", decimals + 1))
    agrees = difference <= max(0.5 * 10.0**-decimals, 10.0**-shown)
    verdict = "agrees" if agrees else f"differs by {difference:.2g}"
    return row | {"ours": f"{ours:.{shown}f}".removesuffix(".0"), "verdict": verdict}


@cache
def result_of(function: str, arguments: str) -> Any:
    """Return the result of a public function of the package, or of `rigid_body` or `quarter_period`."""
    own: dict[str, Callable[..., Any]] = {"rigid_body": rigid_body, "quarter_period": quarter_period}
    return (own.get(function) or getattr(atlas, function.removeprefix("atlas.")))(**json.loads(arguments))


def rigid_body(time: float) -> dict[str, float]:
    """Return (y1, y2, y3) of the free rigid body that starts at (0, 1, 1)."""
    start = dict(zip(("p0", "q0", "r0"), (0.0, 1 / SCALES[1], 1 / SCALES[2]), strict=True))
    body = MOMENTS | start | {"gamma10": 0.0, "gamma20": 0.6, "gamma30": 0.8}
    tr = atlas.trajectory("fixed_point", body, duration=time, samples=2, method="rk8", tolerance=1e-12)
    return {f"y{i + 1}": SCALES[i] * float(tr[name][-1]) for i, name in enumerate("pqr")}


def quarter_period() -> dict[str, float]:
    """Return the first time at which y2 of `rigid_body` is 0. Newton's method has order 3 there."""
    time = 1.9
    for _ in range(2):
        y = rigid_body(time)
        time += y["y2"] / (y["y1"] * y["y3"])
    return {"K": time}
