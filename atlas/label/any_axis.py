"""Labels, axes and rates of motions about any axis of the body and any axis of the frame.

A point keeps its `label` where that is steady. Elsewhere its angular velocity in the body decides, see `engine.circle`:
constant, it belongs to a permanent rotation, on a circle at constant speed to a regular precession.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping

import numpy as np

from ..engine.ensemble import Integration
from ..engine.stepsize import ROUNDING, StepSizes
from ..flags import Label
from ..scene.model import Tolerances
from ..systems.base import Array, Flags, Mask, System
from ..variables import ANY_AXIS
from . import labels

# Label about any axis -> label about the third axis and the vertical, in the order of the frames of the kernel.
LABELS = {"label_any_axis": "label", "label_any_axis_inertial": "label_inertial"}
RATES = ("precession_rate", "spin_rate")
ANGLES = ("nutation", "precession_inclination", "spin_axis_1", "spin_axis_2", "spin_axis_3")
# The measurements of a circle from which a label is decided.
STATISTICS = ("spread", "height_std", "radius_std", "spin_std", "spin", "precession", "sine")


def frames(system: System, outputs: Collection[str]) -> int:
    """Frames in which the kernel measures circles, for these variables: none, the system's, or inertial space as well."""
    if "label_any_axis_inertial" in outputs and system.frame_rate is not None:
        return 2
    return int(bool(set(ANY_AXIS) & set(outputs)))


def measurements(
    integration: Integration, measured: Mapping[str, Array], tolerances: Tolerances
) -> dict[str, Array]:
    """Statistics of the circles of runs by name, "label:statistic" for each label, and the rates and angles of `values`.

    measured: the other statistics of the runs. The result is empty where no circles were measured.
    """
    result: dict[str, Array] = {}
    for i, (name, circle) in enumerate(zip(LABELS, integration.circles(), strict=False)):
        with np.errstate(all="ignore"):
            circle["precession"] = np.hypot(circle["radius"], circle["height"] - circle["spin"])
            circle["sine"] = circle["radius"] / circle["precession"]
        if i == 0:
            result |= values(circle, measured, tolerances)
        result |= {f"{name}:{key}": value for key, value in circle.items()}
    return result


def statistics_of(measured: Mapping[str, Array], name: str) -> dict[str, Array]:
    """STATISTICS of a label in the result of `measurements`."""
    return {key: measured[f"{name}:{key}"] for key in STATISTICS}


def labels_in(measured: Mapping[str, Array]) -> Iterator[str]:
    """The labels about any axis that `measurements` has circles of."""
    return (name for name in LABELS if f"{name}:spread" in measured)


def names_in(measured: Mapping[str, Array]) -> list[str]:
    """Names of the statistics of all labels in the result of `measurements`."""
    return [f"{name}:{key}" for name in labels_in(measured) for key in STATISTICS]


def is_steady(label: Flags) -> Mask:
    """Whether a label names a steady motion."""
    return np.isin(label, (Label.REGULAR_PRECESSION, Label.PERMANENT_ROTATION))


def label(circle: Mapping[str, Array], own_label: Flags, tolerances: Tolerances) -> Flags:
    """Label of each point about any axis, whatever its status.

    circle: STATISTICS, as `measurements` returns them. own_label: label about the third axis and the
    vertical, values of `flags.Label`. A steady one stays. Returns values of `flags.Label`.
    """
    rate = tolerances.rate
    constant = circle["spread"] <= rate
    varies = (
        (circle["height_std"] > rate) | (circle["radius_std"] > rate) | (circle["spin_std"] > rate)
    ) & ~constant
    constant |= circle["sine"] < tolerances.angle
    by_circle = labels.steady_label(circle["precession"], circle["spin"], constant, rate, varies)
    return np.where(is_steady(own_label), own_label, by_circle).astype(np.int8)


def unsure(
    circle: Mapping[str, Array], error: Mapping[str, Array], own_label: Flags, tolerances: Tolerances
) -> Mask:
    """Whether the label could be another one, were every statistic off by as much as its error.

    circle, own_label, tolerances: as for `label`; error: errors of STATISTICS.
    """
    moved_labels = []
    for sign in (-1.0, 0.0, 1.0):
        moved = {name: circle[name] + sign * error[name] for name in STATISTICS}
        moved["spin"] = np.maximum(np.abs(circle["spin"]) + sign * error["spin"], 0.0)
        moved_labels.append(label(moved, own_label, tolerances))
    lower, central, upper = moved_labels
    return np.asarray((lower != central) | (upper != central))


def measurement_errors(
    step_sizes: StepSizes, bound: Array, relative_error: Array, measured: Mapping[str, Array], name: str
) -> dict[str, Array]:
    """Expected errors of STATISTICS of a label, in their units, (points,) each.

    bound: frequency bound, rad per time unit; relative_error: of a standard deviation; measured: result of
    `measurements`; name: a key of LABELS.
    """
    circle = statistics_of(measured, name)
    rounding = bound * ROUNDING * np.sqrt(step_sizes.steps)
    # The smaller the circle, or the part of it that is run through, the less sure are its axis and its spin.
    spin = step_sizes.rate_error + rounding * _amplification(measured, name, bound)
    absolute = {
        "spread": step_sizes.rate_error, "height_std": step_sizes.rate_error, "radius_std": step_sizes.rate_error,
        "spin_std": spin,
    }  # fmt: skip
    errors = {key: size + relative_error * circle[key] for key, size in absolute.items()}
    return errors | {"spin": spin, "precession": spin, "sine": spin / circle["precession"]}


def _amplification(measured: Mapping[str, Array], name: str, bound: Array) -> Array:
    """Errors of the rates about the axes of a circle over those of the angular velocity, (points,)."""
    radius, height = measured[f"{name}:radius"], measured[f"{name}:height"]
    return np.asarray((1.0 + np.abs(height) / radius) * bound / measured[f"{name}:extent"])


def values(
    circle: Mapping[str, Array], measured: Mapping[str, Array], tolerances: Tolerances
) -> dict[str, Array]:
    """RATES and ANGLES of each point; nan where the label about any axis in the system's frame is not steady.

    Of a point whose own label is regular_precession they are those of its third axis and the vertical.

    circle: see `measurements`; measured: as for `labels.label`.
    """
    with np.errstate(all="ignore"):
        own_label = labels.label(measured, tolerances)
        kind = label(circle, own_label, tolerances)
        tilt = circle["tilt"]
        reversed_axis = measured["psi_dot_mean"] < 0
        zero, one = np.zeros_like(tilt), np.ones_like(tilt)
        about_third_axis = {
            "precession_rate": np.abs(measured["psi_dot_mean"]),
            "spin_rate": measured["phi_dot_mean"],
            "nutation": np.where(reversed_axis, np.pi - tilt, tilt),
            "precession_inclination": np.where(reversed_axis, np.pi, 0.0),
            "spin_axis_1": zero, "spin_axis_2": zero, "spin_axis_3": one,
        }  # fmt: skip
        regular = kind == Label.REGULAR_PRECESSION
        conditions = [regular & (own_label == kind), regular, kind == Label.PERMANENT_ROTATION]
        choices = (
            about_third_axis,
            _of_circle(circle, tolerances.angle),
            _of_rotation(circle, tolerances.rate),
        )
        return {
            name: np.select(conditions, [choice[name] for choice in choices], np.nan)
            for name in (*RATES, *ANGLES)
        }


def _of_circle(circle: Mapping[str, Array], angle: float) -> dict[str, Array]:
    """Rates and angles of regular precessions: the last component of the spin axis above `angle` is positive."""
    s = [circle[f"spin_axis_{i}"] for i in (1, 2, 3)]
    last = np.select([np.abs(s[2]) > angle, np.abs(s[1]) > angle], [s[2], s[1]], s[0])
    sign = np.copysign(1.0, last)
    return {
        "precession_rate": circle["precession"],
        "spin_rate": sign * circle["spin"],
        "nutation": np.arctan2(circle["radius"], sign * (circle["height"] - circle["spin"])),
        "precession_inclination": circle["precession_inclination"],
    } | {f"spin_axis_{i + 1}": sign * component + 0.0 for i, component in enumerate(s)}  # no -0.0


def _of_rotation(circle: Mapping[str, Array], rate: float) -> dict[str, Array]:
    """Rates and angles of permanent rotations: about the mean angular velocity, which a body at rest has not."""
    components = [circle[f"rate_{i}"] for i in (1, 2, 3)]
    size = np.sqrt(sum(component**2 for component in components))
    rotates = size > rate
    zero_or_nan = np.where(rotates, 0.0, np.nan)
    return {
        "precession_rate": np.zeros_like(size),
        "spin_rate": size,
        "nutation": zero_or_nan,
        "precession_inclination": circle["rotation_inclination"] + zero_or_nan,
    } | {f"spin_axis_{i + 1}": component / size + zero_or_nan for i, component in enumerate(components)}


def error_of_values(
    rate_error: Array, bound: Array, measured: Mapping[str, Array], tolerances: Tolerances
) -> Array:
    """Relative error to expect of RATES and ANGLES, (points,), at most 1; 0 where they are not measured on a circle.

    rate_error: error of a steady angular velocity, rad per time unit; bound: frequency bound, rad per time
    unit, the unit of errors of rates; measured: result of `measurements`, and of `statistics.finish`.
    """
    if "label_any_axis:spread" not in measured:
        return np.zeros_like(bound)
    with np.errstate(all="ignore"):
        own_label = labels.label(measured, tolerances)
        kind = label(statistics_of(measured, "label_any_axis"), own_label, tolerances)
        amplified = rate_error * _amplification(measured, "label_any_axis", bound)
        slowest = np.fmin(bound, measured["precession_rate"])
        conditions = [
            (kind == Label.REGULAR_PRECESSION) & ~is_steady(own_label),
            kind == Label.PERMANENT_ROTATION,
        ]
        error = np.select(conditions, [amplified / slowest, rate_error / measured["spin_rate"]], 0.0)
        return np.minimum(error, 1.0)


def change(fine: Mapping[str, Array], coarse: Mapping[str, Array], bound: Array) -> Array:
    """Largest difference of an angle or of a rate over the bound between two runs, (points,); 0 where there is none."""
    size = np.zeros_like(bound)
    for names, unit in ((RATES, bound), (ANGLES, 1.0)):
        for name in names:
            if name in fine:
                size = np.fmax(size, np.abs(fine[name] - coarse[name]) / unit)
    return size
