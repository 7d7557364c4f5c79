"""The comparison of an atlas with theory, in plain text."""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping, Sequence

import numpy as np
import xarray as xr

from ..errors import BadInput, attribute_text, printable, text_table
from ..flags import Agreement, Label, Regularity, Stability
from ..label.theory import agreement
from ..scene import grid
from ..scene.checks import whole_number
from ..systems.base import Flags, families_of, unsteady
from ..variables import proofs_of_labels
from .degrees import DEGREE, in_degrees
from .metadata import (
    flags_of,
    in_order,
    is_numeric_axis,
    neighbour_axes,
    numeric_coordinates,
    scene_problem,
    system_of,
    with_measured_labels,
)

# A point is near the analytical boundary if its distance from the boundary is below this fraction of the axis range. Near the
# boundary, growth is slow and stable motions have large amplitudes.
BAND = 0.02
# An unstable motion may be labelled steady while the product of growth_rate and duration is below this number, because growth by
# a factor of e^12 = 160 000 may still leave the effect of a small nudge within the tolerance.
MAX_SURVIVED_GROWTH = 12.0
# Variations of the rates. The largest of these variations is the unsteadiness of a point.
VARIATIONS = ("theta_dot_rms", "psi_dot_std", "phi_dot_std", "normal_rate_std")
# Variables that are needed to compare motions in the plane with the stability that theory gives.
OF_PLANE = ("stable", "growth_rate", "end_time", "family", "regularity", "lyapunov")


def report(ds: xr.Dataset, worst: int = 5, degrees: bool | None = None) -> str:
    """Return a text that compares labels with theory. The text lists the clearest disagreements, at most `worst` in number."""
    whole_number("worst", worst, 0)
    whole = with_measured_labels(ds)
    ds = _variables_to_compare(whole)
    axes = neighbour_axes(ds)
    ds = in_order(ds.transpose(..., *axes), dict.fromkeys(axes, 1))
    label, predicted = ds["label"].values, ds["predicted"].values
    result = agreement(label, predicted)
    counts = np.bincount(result.ravel(), minlength=len(Agreement))
    compared = result.size - counts[Agreement.NOT_COMPARED]
    share = f"{100 * counts[Agreement.AGREE] / compared:.3f} %" if compared else "nothing"
    lines = confusion("theory \\ measured", predicted, label, list(Label.meanings()))
    lines.append(f"compared: {compared} of {result.size} points, {share} agree")
    lines += [f"  {name}: {n}" for name, n in zip(Agreement.meanings(), counts, strict=True) if n]
    if {"stable", "growth_rate", "end_time"} <= set(ds):
        lines += _stability_lines(ds, axes)
    lines += _plane_lines(ds)
    lines += _proof_lines(whole, worst)
    lines += _worst_lines(in_degrees(ds, degrees), result.ravel(), worst)
    if "atlas_system" in whole.attrs and "label_any_axis" not in whole:
        system = system_of(whole)
        lines += system.remarks({name: whole[name] for name in system.parameters if name in whole.coords})
    if problem := scene_problem(whole):
        lines.append(problem)
    return "\n".join(lines)


def _variables_to_compare(ds: xr.Dataset) -> xr.Dataset:
    """Return label, predicted and variables that explain differences. Raise BadInput if label and predicted are of different points."""
    if "atlas_system" in ds.attrs and not families_of(system_of(ds)):
        raise BadInput(
            f"theory predicts nothing of the system {system_of(ds).name}: it has no families to compare with"
        )
    for flags in ("label", "predicted"):
        if flags not in ds:
            raise BadInput(
                f"{flags}: not in this dataset; a comparison needs label and predicted, from [outputs] of the scene"
            )
        flags_of(ds, flags, len(Label), "damaged, averaged or masked")
    ds = ds[[name for name in ("label", "predicted", *OF_PLANE, *VARIATIONS) if name in ds]]
    label = ds["label"]
    for variable, array in ds.items():
        if {*array.dims} != {*label.dims} or (variable == "predicted" and array.dims != label.dims):
            raise BadInput(f"label and {variable} lie along different dimensions: not an atlas")
    if not label.size:
        raise BadInput("label: has no values here: the dataset is empty")
    return ds


def confusion(
    corner: str, down: Flags, across: Flags, names: Sequence[str], columns: Sequence[str] | None = None
) -> list[str]:
    """Return a table of the numbers of points with each pair of flags. Rows are `names`, and columns are `columns`, by default `names`."""
    shape = len(names), len(columns or names)
    pairs = np.ravel(down).astype(np.intp) * shape[1] + np.ravel(across)
    table = np.bincount(pairs, minlength=math.prod(shape)).reshape(shape)
    used = np.flatnonzero(table.any(0) if columns else table.any(0) | table.any(1)).tolist()
    rows = [[name, *map(str, row[used])] for name, row in zip(names, table, strict=True) if row.any()]
    return text_table([[corner, *((columns or names)[j] for j in used)], *rows], right=True).split("\n")


def _stability_lines(ds: xr.Dataset, axes: Sequence[str]) -> list[str]:
    """Return lines with the numbers of drifting stable and steady unstable points, with and without points near the limit of stability."""
    label, stable = ds["label"].values, ds["stable"].values
    log_growth = ds["growth_rate"].values * ds["end_time"].values
    near = near_boundary(stable, range(stable.ndim - len(axes), stable.ndim))
    steady = (label == Label.REGULAR_PRECESSION) | (label == Label.PERMANENT_ROTATION)
    drift = (stable == Stability.STABLE) & (label == Label.DRIFTING)
    drift &= ds["predicted"].values != Label.DRIFTING  # points at which theory predicts drift do not count
    survive = (stable == Stability.UNSTABLE) & steady
    lines = [
        f"linearly {description}: {points.sum()}"
        + f", of these {(points & ~near).sum()} outside a band of {100 * BAND:g} % of the axis range around the"
        " analytical boundary" * bool(axes)
        for description, points in (
            ("stable points that drift", drift),
            ("unstable points that survive", survive),
        )
    ]
    if survive.any():
        lines.append(
            f"  survivors with growth_rate x duration < {MAX_SURVIVED_GROWTH:g} (no time to grow):"
            f" {(survive & (log_growth < MAX_SURVIVED_GROWTH)).sum()} of {survive.sum()};"
            f" largest growth_rate x duration: {log_growth[survive].max():.2f}"
        )
    return lines


def _plane_lines(ds: xr.Dataset) -> list[str]:
    """Return lines that compare the predicted stability of motions in the plane with measured regularity and Lyapunov exponents."""
    if not {*OF_PLANE, "atlas_system"} <= {*ds, *ds.attrs}:
        return []
    where = unsteady(system_of(ds), ds["family"].values.astype(np.int8))
    stable, growth, time, _, kind, exponent = (ds[name].values[where] for name in OF_PLANE)
    corner = "motions in the plane, stability out of it \\ regularity"
    lines = confusion(corner, stable, kind, list(Stability.meanings()), list(Regularity.meanings()))
    unstable = stable == Stability.UNSTABLE
    if (missed := unstable & (kind == Regularity.REGULAR)).any():
        text = "  unstable ones that read as regular: growth_rate x duration at most"
        lines.append(f"{text} {(growth * time)[missed].max():.3g}; below about 10 it cannot be seen")
    if (seen := unstable & (kind == Regularity.HYPERBOLIC)).any():
        low, high = np.nanpercentile(exponent[seen] / growth[seen], [5, 95])
        text = "  lyapunov / growth_rate of hyperbolic ones:"
        lines.append(f"{text} {low:.3f} to {high:.3f} (5 to 95 %)")
    return lines if where.any() else []


def _proof_lines(ds: xr.Dataset, worst: int) -> list[str]:
    """Return lines that compare proved labels with measured labels. At most `worst` contradictions are listed for each label variable."""
    lines = []
    for label, proof in proofs_of_labels().items():
        predicted = label.replace("label", "predicted")
        if not {label, proof, predicted} <= {*ds}:
            continue
        proved = ds[proof] != 0
        measured = proved & (ds[label] != Label.NOT_COMPUTED) & (ds[label] != Label.UNRESOLVED)
        wrong = (measured & (ds[label] != ds[predicted])).transpose(*ds[label].dims)
        counts = f"{int(proved.sum())} of {proved.size} points, {int(measured.sum())} of these measured"
        lines.append(f"{label} proved for every duration: {counts}, {int(wrong.sum())} contradictions")
        for index in np.argwhere(wrong.values)[:worst].tolist():
            where = place(ds, dict(zip(map(str, wrong.dims), index, strict=True)))
            lines.append(f"  a defect of proof or run, please report it: {where}")
    return lines


def near_boundary(stable: Flags, axes: Collection[int]) -> np.ndarray:
    """Whether stability changes in a box around each point. Along `axes` the box extends by BAND times the axis range to either side."""
    reach = [max(1, int(np.ceil(BAND * (count - 1)))) if count > 1 else 0 for count in stable.shape]
    window = [1 + 2 * n * (axis in axes) for axis, n in enumerate(reach)]
    return grid.near_change(stable, window)


def _worst_lines(ds: xr.Dataset, result: Flags, count: int) -> list[str]:
    """Return lines about the clearest disagreements. `count` is the largest number of disagreements.

    If theory predicts a steady motion, the disagreement is clearest where the drift is strongest. If theory predicts drift, the
    disagreement is clearest where the drift is weakest. Without measured rates, the first disagreements are listed.
    """
    disagree = np.flatnonzero(result > Agreement.AGREE)
    if not disagree.size or not count:
        return []
    # Whole arrays are read, because xarray 2026.9 cannot select single points of transposed lazy variables.
    values = {name: array.values.ravel()[disagree] for name, array in ds.data_vars.items()}
    theory_steady = result[disagree] == Agreement.THEORY_ONLY
    names, dims = list(Label.meanings()), ds["label"].dims
    rates = [values[name] for name in VARIATIONS if name in ds]
    unsteadiness = np.fmax.reduce([np.full(disagree.size, np.nan), *rates])
    growth = values.get("growth_rate", np.nan) * values.get("end_time", unsteadiness * np.nan)
    order = np.argsort(np.where(theory_steady, -unsteadiness, unsteadiness), kind="stable")[:count]
    lines = ["worst disagreements (unsteadiness = largest rms or std of the rates):"]
    if not rates:
        needed = f"the worst need {', '.join(VARIATIONS)} in [outputs]"
        lines = [f"disagreements in the order of the grid ({needed}):"]
    for i in order:
        index = np.unravel_index(disagree[i], ds["label"].shape)
        indices = dict(zip(map(str, dims), map(int, index), strict=True))
        line = f"  {place(ds, indices)}: theory {names[values['predicted'][i]]}"
        line += f", measured {names[values['label'][i]]}"
        numbers = {", unsteadiness {:.3g}": unsteadiness[i], ", growth_rate x time = {:.2f}": growth[i]}
        lines.append(line + "".join(text.format(n) for text, n in numbers.items() if np.isfinite(n)))
    return lines


def place(ds: xr.Dataset, indices: Mapping[str, int]) -> str:
    """Return a text for a point. An axis without numbers gives the point's index and the parameters that vary along the axis."""
    texts = []
    for dim, k in indices.items():
        names = [dim]
        if not is_numeric_axis(ds, dim):
            texts.append(f"{printable(dim)} {k}")
            names = [name for name in numeric_coordinates(ds, dim) if (ds[name] != ds[name][0]).any()]
        ends = {name: " deg" if attribute_text(ds[name].attrs, "units") == DEGREE else "" for name in names}
        texts += [f"{printable(name)} = {float(ds[name][k]):.9g}{end}" for name, end in ends.items()]
    return ", ".join(texts)
