"""Labels of motions that are steady about any axis. Their angular velocity in the body is constant or moves on a circle.

A body that turns at the rate m about a body-fixed axis s, while s turns at the rate n about an axis e fixed in the frame, has
the angular velocity u = n e + m s. In the body e turns about s at the rate -m, so u moves on a circle about s at constant
speed, u' = -m s x u. Conversely, each motion of u on a circle at constant speed has this form. The nutation is the angle between
s and e. Three numbers determine m, n and the nutation: the radius n sin(nutation) of the circle, the height
u . s = m + n cos(nutation) of its plane, and the speed.

Sums over the nodes give the plane nearest to the angular velocities, and the distance of the angular velocities from a circle in this
plane. Only differences from the start are summed, which avoids cancellation. They are taken along body axes x, y, z. The angular
velocity turns about z at the start, so that on a circle the differences along z are rounding errors.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass
from enum import IntEnum
from types import ModuleType

import numpy as np
from numpy.typing import NDArray

from ..flags import Agreement, Label, Status
from ..kernel.ensemble import Ensemble
from ..kernel.statistics import Node
from ..kernel.stepsize import ROUNDING
from ..systems.base import Array, Flags, Mask, Points, System
from ..systems.vectors import cross, dot
from .instrument import Instrument, Measured, Rule, Run, Tolerances, Variable
from .rates import existing, relative_error, steady_label
from .rates import label as label_of_third_axis

# Time step of the finite differences at the start, multiplied by the frequency bound. On a circle the error of the second derivative
# lies in the plane of the circle, so that the normal of this plane has no error.
DIFFERENCE_TIME = 1e-2
# Number of sweeps of Jacobi's method for the eigenvectors of a symmetric 3 x 3 matrix. The method converges quadratically.
SWEEPS = 6


class Axis(IntEnum):
    """Rows of the constants of a point in one frame. They hold the axes x, y, z in the body and the motion at the start."""

    # A rotation about the vertical at FRAME_RATE is added to the angular velocity. X1 to X3 are the components of the axis x in the body.
    FRAME_RATE, X1, X2, X3, Y1, Y2, Y3, Z1, Z2, Z3 = range(10)
    # START_X to START_Z are the angular velocity along x, y, z. SLOPE_X to SLOPE_Z are its derivative, START_SPEED_SQUARED |derivative|^2.
    START_X, START_Y, START_Z, START_SPEED_SQUARED = range(10, 14)
    SLOPE_X, SLOPE_Y, SLOPE_Z, VERTICAL_X, VERTICAL_Y, VERTICAL_Z = range(14, 20)


class Sum(IntEnum):
    """Trapezoidal sums of changes of the angular velocity u (X, Y, Z), u^2 (L) and u'^2 (S) since the start, and of products of changes."""

    X, Y, Z, XX, XY, YY, XZ, YZ, ZZ, L, LL, LX, LY, LZ, S, SS = range(16)


def add_to_circle(sums, s, axes, a, l, nodes, i, intervals, spacing, inverse_unit):
    """Add a node to the sums of lane l, see `kernel.ensemble.Plug`."""
    slot, weight = i & 3, 0.5 if i == 0 or i == intervals else 1.0
    rate = axes[a + Axis.FRAME_RATE, l]
    u1 = nodes[slot, Node.U1, l] + rate * nodes[slot, Node.G1, l]
    u2 = nodes[slot, Node.U2, l] + rate * nodes[slot, Node.G2, l]
    u3 = nodes[slot, Node.U3, l] + rate * nodes[slot, Node.G3, l]
    d1 = (nodes[slot, Node.DU1, l] + rate * nodes[slot, Node.DG1, l]) * inverse_unit
    d2 = (nodes[slot, Node.DU2, l] + rate * nodes[slot, Node.DG2, l]) * inverse_unit
    d3 = (nodes[slot, Node.DU3, l] + rate * nodes[slot, Node.DG3, l]) * inverse_unit
    x0, y0, z0 = axes[a + Axis.START_X, l], axes[a + Axis.START_Y, l], axes[a + Axis.START_Z, l]
    x = axes[a + Axis.X1, l] * u1 + axes[a + Axis.X2, l] * u2 + axes[a + Axis.X3, l] * u3 - x0
    y = axes[a + Axis.Y1, l] * u1 + axes[a + Axis.Y2, l] * u2 + axes[a + Axis.Y3, l] * u3 - y0
    z = axes[a + Axis.Z1, l] * u1 + axes[a + Axis.Z2, l] * u2 + axes[a + Axis.Z3, l] * u3 - z0
    length = x * (x + 2.0 * x0) + y * (y + 2.0 * y0) + z * (z + 2.0 * z0)
    speed = d1 * d1 + d2 * d2 + d3 * d3 - axes[a + Axis.START_SPEED_SQUARED, l]
    sums[s + Sum.X, l] += weight * x
    sums[s + Sum.Y, l] += weight * y
    sums[s + Sum.Z, l] += weight * z
    sums[s + Sum.XX, l] += weight * x * x
    sums[s + Sum.XY, l] += weight * x * y
    sums[s + Sum.YY, l] += weight * y * y
    sums[s + Sum.XZ, l] += weight * x * z
    sums[s + Sum.YZ, l] += weight * y * z
    sums[s + Sum.ZZ, l] += weight * z * z
    sums[s + Sum.L, l] += weight * length
    sums[s + Sum.LL, l] += weight * length * length
    sums[s + Sum.LX, l] += weight * length * x
    sums[s + Sum.LY, l] += weight * length * y
    sums[s + Sum.LZ, l] += weight * length * z
    sums[s + Sum.S, l] += weight * speed
    sums[s + Sum.SS, l] += weight * speed * speed


def circle_axes(
    equations: ModuleType, state: Array, constants: Array, frame_rate: Array, bound: Array
) -> Array:
    """Return the rows of `Axis`, (len(Axis), points), in a frame in which the angular velocity is larger by frame_rate * vertical."""
    with np.errstate(all="ignore"):
        h = DIFFERENCE_TIME / np.where((bound > 0) & np.isfinite(bound), bound, 1.0)
        slope = np.array(equations.rhs(state, constants))
        after, before = (np.array(equations.rhs(state + t * slope, constants)) for t in (h, -h))
        curvature = 0.5 * h * (after - before)  # h^2 times the second derivative of the state
        later, now, earlier = (
            np.array(equations.frame_motion(state + sign * h * slope + sign**2 * 0.5 * curvature, constants))
            for sign in (1.0, 0.0, -1.0)
        )
        motions = now, (later - earlier) / (2.0 * h), (later - 2.0 * now + earlier) / h**2
        u, du, ddu = (each[:3] + frame_rate * each[3:] for each in motions)
        du = np.where(np.isfinite(du), du, 0.0)  # a run that overflows is not resolved
        # On a circle about s, u' = m u x s and u'' = m u' x s. z is along u'' x u' = m |u'|^2 s, or along the third body axis if that is 0.
        direction = cross(ddu, du)
        size = np.sqrt(dot(direction, direction))
        exists = np.isfinite(size) & (size > 0)
        z = np.where(exists, direction / size, np.array([[0.0], [0.0], [1.0]]))
        x = cross(np.eye(3)[np.argmin(np.abs(z), axis=0)].T, z)
        x = x / np.sqrt(dot(x, x))
        y = cross(z, x)
        along = [np.array([dot(axis, vector) for axis in (x, y, z)]) for vector in (u, du, now[3:])]
        return np.concatenate([[frame_rate], x, y, z, along[0], [dot(du, du)], along[1], along[2]])


def circle_statistics(sums: Array, axes: Array, weight: NDArray[np.int64]) -> dict[str, Array]:
    """Return statistics of the circle that is nearest to the angular velocities u of each run in one frame, (points,) each.

    Let s be the normal of the plane that fits u best. In rad per time unit, `spread` is the standard deviation of u, and `extent` the
    smaller principal deviation of u in the plane. `height` and `height_std` are the mean and the deviation of u along s. `radius` and
    `radius_std` are the root mean square and the deviation of the distance of u from the line along s. `spin` and `spin_std` are the
    rate of the body about s and the deviation of this rate. `rate_1` to `rate_3` are the mean of u along the body axes.
    `spin_axis_1` to `spin_axis_3` are the components of s, of either sign, along the body axes. Three statistics are angles in rad
    from the vertical at the start. `tilt` is the angle of the third body axis, `rotation_inclination` is the angle of u, and
    `precession_inclination` is the angle of the axis that is fixed in the frame. The latter axis follows from s and `spin`.
    """
    with np.errstate(all="ignore"):
        mean = sums / weight
        shift = mean[[Sum.X, Sum.Y, Sum.Z]]
        products = mean[[[Sum.XX, Sum.XY, Sum.XZ], [Sum.XY, Sum.YY, Sum.YZ], [Sum.XZ, Sum.YZ, Sum.ZZ]]]
        variances, directions = principal_axes(products - shift[:, None] * shift)
        start = axes[[Axis.START_X, Axis.START_Y, Axis.START_Z]]
        along = np.array([dot(direction, start + shift) for direction in directions])
        s, height = directions[0], along[0]
        radius = np.sqrt(variances[1] + variances[2] + along[1] ** 2 + along[2] ** 2)
        with_length = mean[[Sum.LX, Sum.LY, Sum.LZ]] - mean[Sum.L] * shift
        of_length = mean[Sum.LL] - mean[Sum.L] ** 2
        of_distance = of_length - 4.0 * height * dot(s, with_length) + 4.0 * height**2 * variances[0]
        speed = np.sqrt(mean[Sum.S] + axes[Axis.START_SPEED_SQUARED])
        speed_std = np.sqrt(np.maximum(mean[Sum.SS] - mean[Sum.S] ** 2, 0.0)) / (2.0 * speed)
        slope = axes[[Axis.SLOPE_X, Axis.SLOPE_Y, Axis.SLOPE_Z]]
        spin = np.copysign(speed / radius, -dot(s, cross(start, slope)))
        vertical = axes[[Axis.VERTICAL_X, Axis.VERTICAL_Y, Axis.VERTICAL_Z]]
        result = {
            "spread": np.sqrt(np.maximum(variances.sum(0), 0.0)),
            "height_std": np.sqrt(np.maximum(variances[0], 0.0)),
            "radius": radius,
            "radius_std": np.sqrt(np.maximum(of_distance, 0.0)) / (2.0 * radius),
            "spin": spin,
            "spin_std": speed_std / radius,
            "height": height,
            "extent": np.sqrt(np.maximum(variances[1], 0.0)),
            "precession_inclination": _angle(start - spin * s, vertical),
            "rotation_inclination": _angle(start, vertical),
        }
        in_body = axes[Axis.X1 : Axis.Z3 + 1].reshape(3, 3, -1)
        result["tilt"] = _angle(in_body[:, 2], vertical)
        for name, vector in (("rate", start + shift), ("spin_axis", s)):
            components = (vector[:, None] * in_body).sum(0)
            result |= {f"{name}_{i + 1}": component for i, component in enumerate(components)}
    return result


def principal_axes(matrix: Array) -> tuple[Array, Array]:
    """Return ascending eigenvalues and unit eigenvectors, vectors[i], of symmetric matrices (3, 3, points).

    Unlike LAPACK, Jacobi's method computes small eigenvalues of nearly diagonal matrices to a small relative error. See J. Demmel and
    K. Veselic, SIAM J. Matrix Anal. Appl. 13 (1992) 1204-1245.
    """
    a = matrix.copy()
    vectors = np.broadcast_to(np.eye(3)[:, :, None], a.shape).copy()
    for _ in range(SWEEPS):
        for p, q in ((0, 1), (0, 2), (1, 2)):
            # Turn the axes p and q so that the element (p, q) vanishes.
            with np.errstate(all="ignore"):  # the element (p, q) may be 0
                r = 3 - p - q
                ratio = (a[q, q] - a[p, p]) / (2.0 * a[p, q])
                tangent = np.copysign(1.0, ratio) / (np.abs(ratio) + np.sqrt(1.0 + ratio * ratio))
                tangent = np.where(a[p, q] == 0.0, 0.0, tangent)
                cosine = 1.0 / np.sqrt(1.0 + tangent * tangent)
                sine = tangent * cosine
                a[p, p], a[q, q] = a[p, p] - tangent * a[p, q], a[q, q] + tangent * a[p, q]
                a[p, q] = a[q, p] = 0.0
                a[r, p], a[r, q] = cosine * a[r, p] - sine * a[r, q], sine * a[r, p] + cosine * a[r, q]
                a[p, r], a[q, r] = a[r, p], a[r, q]
                vectors[p], vectors[q] = (
                    cosine * vectors[p] - sine * vectors[q],
                    sine * vectors[p] + cosine * vectors[q],
                )
    values = np.array([a[0, 0], a[1, 1], a[2, 2]])
    order = np.argsort(values, axis=0, kind="stable")
    return np.take_along_axis(values, order, 0), np.take_along_axis(vectors, order[:, None], 0)


def _angle(a: Array, b: Array) -> Array:
    """Return the angles between vectors (3, points) in rad."""
    perpendicular = cross(a, b)
    return np.asarray(np.arctan2(np.sqrt(dot(perpendicular, perpendicular)), dot(a, b)))


AXIS_RATES = ("precession_rate", "spin_rate")
ANGLES = ("nutation", "precession_inclination", "spin_axis_1", "spin_axis_2", "spin_axis_3")
# Statistics of a circle that decide the label.
STATISTICS = ("spread", "height_std", "radius_std", "spin_std", "spin", "precession", "sine")
# Variables that need the sums of an instrument `Circle`, in the system's frame or in inertial space.
ANY_AXIS = (
    "label_any_axis", "label_any_axis_inertial", "precession_rate", "spin_rate", "nutation",
    "spin_axis_1", "spin_axis_2", "spin_axis_3", "precession_inclination", "agreement_any_axis",
)  # fmt: skip
# Variables that need theory. agreement_any_axis needs the measured label as well.
ANY_AXIS_THEORY = ("predicted_any_axis", "predicted_any_axis_inertial", "agreement_any_axis")
_NOT_STEADY = "nan where label_any_axis is neither regular_precession nor permanent_rotation"
_SPIN_AXIS = (
    "direction of the angular velocity of a permanent rotation; of a regular precession the last component above"
    " cylinder_tolerance is positive; nan elsewhere and for a body at rest"
)


@dataclass(frozen=True)
class Circle(Instrument):
    """Instrument of labels, axes and rates of motions about any axis of the body and any axis of a frame.

    A motion that is steady about the third axis and the vertical keeps its label. Another motion is a permanent rotation if its angular
    velocity is constant in the body, and a regular precession if its angular velocity moves on a circle at constant speed. Rates
    and angles are in the system's frame.
    """

    name: str = "label_any_axis"  # or label_any_axis_inertial

    sums, given, add_node = len(Sum), len(Axis), staticmethod(add_to_circle)

    @property
    def inertial(self) -> bool:
        """Whether the frame is inertial space instead of the system's frame."""
        return self.name == "label_any_axis_inertial"

    def every_variable(self, system: System) -> tuple[Variable, ...]:
        """Return the variables of both frames. The inertial instrument has no variables of its own."""
        if self.inertial:
            return ()
        labels, predicted = [], []
        for suffix, frame, axes in (("", system.frame, "frame"), ("_inertial", "inertial", "space")):
            labels.append(Variable(
                f"label_any_axis{suffix}", "int8", "1", f"kind of motion in the {frame} frame, about any axes of body and {axes}",
                Label.meanings(), f"the same as label{suffix} where that is steady", optional=True,
            ))  # fmt: skip
            predicted.append(Variable(
                f"predicted_any_axis{suffix}", "int8", "1", f"kind of motion in the {frame} frame about any axes, from theory alone",
                Label.meanings(), f"the same as predicted{suffix} where that is steady", optional=True,
            ))  # fmt: skip
        return (
            *labels,
            *(
                Variable(name, "float64", units, long_name, comment=comment, optional=True)
                for name, units, long_name, comment in (
                    ("precession_rate", "rad s-1", f"rate of precession about an axis at rest in the {system.frame} frame, not negative",
                     f"0 for a permanent rotation; {_NOT_STEADY}"),
                    ("spin_rate", "rad s-1", "rate of the body about the axis at rest in it",
                     f"for a permanent rotation the length of the angular velocity; {_NOT_STEADY}"),
                    ("nutation", "rad", "angle between the axes at rest in the body and in the frame",
                     f"0 for a permanent rotation; {_NOT_STEADY}, and for a body at rest"),
                    *((f"spin_axis_{i}", "1", f"component of the axis at rest in the body along the {axis} body axis", _SPIN_AXIS)
                      for i, axis in enumerate(("first", "second", "third"), 1)),
                    ("precession_inclination", "rad", f"angle between the axis at rest in the {system.frame} frame and the vertical",
                     f"for a permanent rotation of the angular velocity; {_NOT_STEADY}, and for a body at rest"),
                )
            ),
            *predicted,
            Variable(
                "agreement_any_axis", "int8", "1", "measured label about any axes against theory", Agreement.meanings(), optional=True,
            ),
        )  # fmt: skip

    def variables(self, system: System) -> tuple[Variable, ...]:
        return () if system.observables else existing(system, self.every_variable(system))

    def wanted(self, system: System, outputs: Collection[str]) -> bool:
        if self.inertial:
            return self.name in outputs and system.frame_rate is not None
        return not system.observables and not set(ANY_AXIS).isdisjoint(outputs)

    def constants(self, system: System, points: Points, start: Ensemble) -> Array:
        bound = start.frequency_bound
        rate = system.frame_rate(points) if self.inertial and system.frame_rate else np.zeros_like(bound)
        return circle_axes(system.equations, start.state, start.constants, rate, bound)

    def measurements(self, run: Run, measured: Measured) -> dict[str, Array]:
        """Return statistics of the circles by names such as "label_any_axis:radius". In the system's frame add AXIS_RATES and ANGLES."""
        circle = circle_statistics(*run.plugged(self), run.integration.intervals)
        with np.errstate(all="ignore"):
            circle["precession"] = np.hypot(circle["radius"], circle["height"] - circle["spin"])
            circle["sine"] = circle["radius"] / circle["precession"]
        own = {} if self.inertial else values(circle, measured, run.settings.tolerances)
        return own | {f"{self.name}:{key}": value for key, value in circle.items()}

    def rules(self, run: Run, rules: Mapping[str, Rule]) -> dict[str, Rule]:
        """Return the rule of the label about any axis. If the label about the third axis and the vertical is steady, that label is kept."""
        own_label = rules[self.name.replace("_any_axis", "")].decide(run.measured)

        def label_of(measured: Measured) -> Flags:
            return label(self._statistics(measured), own_label, run.settings.tolerances)

        names = tuple(f"{self.name}:{key}" for key in STATISTICS)
        return {self.name: Rule(label_of, names, {f"{self.name}:spin": 0.0})}

    def _statistics(self, measured: Measured) -> dict[str, Array]:
        return {key: measured[f"{self.name}:{key}"] for key in STATISTICS}

    def errors(self, run: Run, relative: Array) -> dict[str, Array]:
        """Return the expected error of each of STATISTICS, in the unit of the statistic, (points,)."""
        step_sizes, bound, circle = run.step_sizes, run.bound, self._statistics(run.measured)
        share = np.minimum(relative_error(step_sizes, bound), 1.0)
        rounding = bound * ROUNDING * np.sqrt(step_sizes.whole_steps)
        # The axis and the spin are uncertain if the circle is small or the arc short.
        spin = step_sizes.rate_error + rounding * self._amplification(run)
        absolute = dict.fromkeys(("spread", "height_std", "radius_std"), step_sizes.rate_error)
        errors = {key: size + share * circle[key] for key, size in (absolute | {"spin_std": spin}).items()}
        errors |= {"spin": spin, "precession": spin, "sine": spin / circle["precession"]}
        return {f"{self.name}:{key}": error for key, error in errors.items()}

    def rounding(self, run: Run, relative: Array) -> dict[str, Array]:
        """Return rounding errors of statistics for rates up to the frequency bound. Small circles about oblique axes have larger errors."""
        size, measured = run.bound * relative, run.measured
        s = np.array([measured[f"{self.name}:spin_axis_{i}"] for i in (1, 2, 3)])
        mixed = (np.abs(s) * np.sqrt(np.maximum(1.0 - s * s, 0.0))).sum(0)
        of_circle = size * (1.0 + mixed * run.bound / measured[f"{self.name}:radius"])
        sizes = dict.fromkeys(("spread", "height_std"), size)
        sizes |= dict.fromkeys(("radius_std", "spin_std", "spin", "precession"), of_circle)
        return {f"{self.name}:{key}": each for key, each in sizes.items()}

    def _amplification(self, run: Run) -> Array:
        """Return the error of the spin and precession rates divided by the error of the angular velocity, (points,)."""
        radius, height, extent = (
            run.measured[f"{self.name}:{key}"] for key in ("radius", "height", "extent")
        )
        return np.asarray((1.0 + np.abs(height) / radius) * run.bound / extent)

    def relative_error(self, run: Run) -> Array:
        """Return the relative error of AXIS_RATES and ANGLES. Drifting motions and precessions about the third axis have the error 0."""
        if self.inertial:
            return np.zeros_like(run.bound)
        measured, rate_error = run.measured, run.step_sizes.rate_error * np.exp(run.log_growth)
        with np.errstate(all="ignore"):
            own_label, kind = (run.rules[name].label(measured) for name in ("label", self.name))
            slowest = np.fmin(run.bound, measured["precession_rate"])
            conditions = [
                (kind == Label.REGULAR_PRECESSION) & ~is_steady(own_label),
                kind == Label.PERMANENT_ROTATION,
            ]
            amplified = rate_error * self._amplification(run)
            error = np.select(conditions, [amplified / slowest, rate_error / measured["spin_rate"]], 0.0)
            return np.minimum(error, 1.0)

    def rate_change(self, run: Run, other: Run) -> Array:
        """Return the largest difference of AXIS_RATES between two runs, in units of the frequency bound."""
        return self._change(run, other, AXIS_RATES) / run.bound

    def pair_error(self, run: Run, coarse: Run, expected: Array) -> Array:
        """Return the largest difference of ANGLES, and of AXIS_RATES in units of the frequency bound, between two runs."""
        return np.fmax(self._change(run, coarse, AXIS_RATES) / run.bound, self._change(run, coarse, ANGLES))

    def _change(self, run: Run, other: Run, names: Collection[str]) -> Array:
        """Return the largest difference of the named values between two runs, or 0 where all values are nan."""
        changes = [np.abs(run.measured[name] - other.measured[name]) for name in names if not self.inertial]
        return np.asarray(np.fmax.reduce([np.zeros_like(run.bound), *changes]))

    def columns(self, run: Run, columns: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
        ok = columns["status"] == Status.OK
        names = () if self.inertial else (*AXIS_RATES, *ANGLES)
        return {name: np.where(ok, columns[name], np.nan) for name in names}


# Instruments of the system's frame and of inertial space. A scene with the second instrument has the first as well.
CIRCLES = (Circle(), Circle("label_any_axis_inertial"))


def is_steady(label: Flags) -> Mask:
    return np.isin(label, (Label.REGULAR_PRECESSION, Label.PERMANENT_ROTATION))


def label(circle: Mapping[str, Array], own_label: Flags, tolerances: Tolerances) -> Flags:
    """Return labels about any axis. Where `own_label`, the label about the third axis and the vertical, is steady, that label is kept."""
    rate = tolerances.rate
    constant = circle["spread"] <= rate
    varies = (
        (circle["height_std"] > rate) | (circle["radius_std"] > rate) | (circle["spin_std"] > rate)
    ) & ~constant
    constant |= circle["sine"] < tolerances.angle
    by_circle = steady_label(circle["precession"], circle["spin"], constant, rate, varies)
    return np.where(is_steady(own_label), own_label, by_circle).astype(np.int8)


def values(
    circle: Mapping[str, Array], measured: Mapping[str, Array], tolerances: Tolerances
) -> dict[str, Array]:
    """Return AXIS_RATES and ANGLES, nan for unsteady motions. A precession about the third axis has the rates |psi'| and phi'."""
    with np.errstate(all="ignore"):
        own_label = label_of_third_axis(measured, tolerances)
        kind = label(circle, own_label, tolerances)
        tilt = circle["tilt"]
        reversed_axis = measured["psi_dot_mean"] < 0
        regular = kind == Label.REGULAR_PRECESSION
        conditions = [regular & (own_label == kind), regular, kind == Label.PERMANENT_ROTATION]
        # The last component of the spin axis whose magnitude exceeds the tolerance is made positive for a regular precession.
        s = [circle[f"spin_axis_{i}"] for i in (1, 2, 3)]
        last = np.select(
            [np.abs(s[2]) > tolerances.angle, np.abs(s[1]) > tolerances.angle], [s[2], s[1]], s[0]
        )
        sign = np.copysign(1.0, last)
        # The axis of a permanent rotation is the direction of the mean angular velocity, which vanishes for a body at rest.
        components = [circle[f"rate_{i}"] for i in (1, 2, 3)]
        size = np.sqrt(sum(component**2 for component in components))
        zero, third_axis = np.zeros_like(size), (0.0, 0.0, 1.0)
        zero_or_nan = np.where(size > tolerances.rate, 0.0, np.nan)
        lean = np.arctan2(circle["radius"], sign * (circle["height"] - circle["spin"]))
        inclination = circle["rotation_inclination"] + zero_or_nan
        # Each tuple has one value for each of `conditions`. Adding 0.0 turns -0.0 into 0.0.
        choices = {
            "precession_rate": (np.abs(measured["psi_dot_mean"]), circle["precession"], zero),
            "spin_rate": (measured["phi_dot_mean"], sign * circle["spin"], size),
            "nutation": (np.where(reversed_axis, np.pi - tilt, tilt), lean, zero_or_nan),
            "precession_inclination": (
                np.where(reversed_axis, np.pi, 0.0), circle["precession_inclination"], inclination,
            ),
        } | {
            f"spin_axis_{i + 1}": (zero + third_axis[i], sign * s[i] + 0.0, components[i] / size + zero_or_nan)
            for i in range(3)
        }  # fmt: skip
        return {name: np.select(conditions, of_kind, np.nan) for name, of_kind in choices.items()}
