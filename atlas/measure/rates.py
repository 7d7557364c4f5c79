"""Labels of motions about the third axis and the vertical, and errors of rates. The statistics are in `kernel.statistics`."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass
from functools import partial

import numpy as np

from ..flags import Agreement, Label, Stability, Status, reserved_families
from ..kernel.statistics import NEEDS_PSI, RATES, STATISTICS, Row, finish
from ..kernel.stepsize import INTERPOLATION_ERROR, ROUNDING, StepSettings, StepSizes
from ..kernel.tableaux import METHODS
from ..systems.base import Array, Flags, Mask, System, families_of
from ..systems.steady import polynomial_degree
from .instrument import MainInstrument, Measured, Rule, Run, RunSettings, Tolerances, Variable

# The measurements that decide a label.
LABEL_STATISTICS = (
    "theta_dot_rms", "psi_dot_mean", "psi_dot_std", "phi_dot_mean", "phi_dot_std", "normal_rate_std",
    "theta_min", "theta_max", "sine_max",
)  # fmt: skip
_ERROR_ESTIMATE = (
    "differences of rates over the bound of the fastest frequency, of angles in rad; expected from phase error, dissipation,"
    " rounding and interpolation, the growth of an unstable family, the distance of the third axis from the vertical and the"
    " change of first integrals, or measured by a second run (check_half_step; always where the bound is numeric); at least 1 where the axis passed"
    " through the cylinder"
)
STATUS = Variable("status", "int8", "1", "how far the label can be trusted", Status.meanings())
END_TIME = Variable("end_time", "float64", "s", "time at which the integration ended")
INTEGRAL_DRIFT = next(
    Variable(s.name, "float64", s.unit, s.long_name) for s in STATISTICS if s.name == "integral_drift"
)
# Constants for a third axis that starts in the cylinder about the vertical. The nodes resolve the path of the axis where sin(theta) is
# above LEAVING_SINE. If the path turns by more than MISSED_TURN (rad) between two nodes, the nodes do not show how the axis leaves.
LEAVING_SINE, MISSED_TURN = 0.03, 50.0
_NO_MEANING = "nan where the third axis counts as inside the cylinder: psi' and phi' have no meaning there"
_NUMERIC_BOUND = (
    "the bound is numeric: |J^64|^(1/64) of the Jacobian J at the start and at instants of a preliminary run, or half of"
    " what a derivative of a state by time is over the one before"
)


@dataclass(frozen=True)
class Rates(MainInstrument):
    """The main instrument of a body in a frame."""

    def every_variable(self, system: System) -> tuple[Variable, ...]:
        own, every = (
            {n: f.title for n, f in each.items()} for each in (system.families, families_of(system))
        )
        families = {"none": "no family of steady motions"} | own | reserved_families(system.name) | every
        flag = [
            Variable("label", "int8", "1", f"kind of motion in the {system.frame} frame", Label.meanings()),
            Variable("label_inertial", "int8", "1", "kind of motion in the inertial frame", Label.meanings()),
            Variable("geometry", "int8", "1", "geometry of the measured motion", {"none": "drifting or unresolved"} | {k: v.text for k, v in system.geometries.items()}),
            STATUS,
            Variable("family", "int8", "1", "family of exact steady motions the start belongs to", families),
            Variable("stable", "int8", "1", "linear stability of the steady motion, from theory", Stability.meanings()),
            Variable("predicted", "int8", "1", f"kind of motion in the {system.frame} frame, from theory alone", Label.meanings()),
            Variable("predicted_inertial", "int8", "1", "kind of motion in the inertial frame, from theory alone", Label.meanings()),
            Variable("agreement", "int8", "1", "measured label against theory", Agreement.meanings()),
        ]  # fmt: skip
        theory = [
            Variable("condition_residual", "float64", "1", "how far the start is from a steady motion, 0 on an exact one"),
            Variable(
                "growth_rate", "float64", "rad s-1",
                "largest real part of the characteristic exponents of the steady motion, from theory",
                comment="nan where theory has no steady motion or no exponent",
            ),
            END_TIME,
        ]  # fmt: skip
        numerics = [
            *step_variables(system),
            Variable(
                "error_estimate", "float64", "1", "estimated relative error of the final state and of every statistic",
                comment=_ERROR_ESTIMATE,
            ),
        ]  # fmt: skip
        measured = [
            Variable(s.name, "float64", s.unit, s.long_name, comment=_NO_MEANING if s.needs_psi else "")
            for s in STATISTICS
        ]
        return (*flag, *measured, *numerics, *theory)

    def variables(self, system: System) -> tuple[Variable, ...]:
        return () if system.observables else existing(system, self.every_variable(system))

    has_theory, quantity = True, "rates"
    unsteadiness_text = "largest rms or standard deviation of the rates"

    def statistics(self, system: System) -> tuple[str, ...]:
        return (*RATES, "theta_min", "theta_max")

    def unsteadiness(self, system: System, measured: Measured, settings: RunSettings) -> Array:
        """Return the largest rms or standard deviation of a rate, in rad per time unit."""
        rates = [measured["theta_dot_rms"], measured["psi_dot_std"], measured["phi_dot_std"]]
        in_polar_cap = np.isnan(rates[1])
        return np.where(in_polar_cap, measured["normal_rate_std"], np.fmax.reduce(rates))

    def steady_below(self, settings: RunSettings) -> Array | float:
        """Return the largest rate, in rad per time unit, that counts as zero."""
        return settings.rate_tolerance

    def largest(self, system: System, measured: Measured, errors: Measured, bound: Array) -> Array:
        """Return the largest error of a rate, divided by the frequency bound."""
        return np.asarray(np.fmax.reduce([errors[name] for name in RATES]) / bound)

    def bound(self, bound: Array, settled: Mask) -> Array:
        """Return the frequency bound, or infinity where frequencies may exceed the bound later in the run."""
        return np.where(settled, bound, np.inf)

    def shown(self, run: Run, resolved: Mask) -> Mask:
        """Whether the atlas holds the measurements. The steps must suffice for the run, but need not suffice for tangent vectors."""
        return run.step_sizes.resolved

    def may_stop_early(self, outputs: Collection[str]) -> bool:
        """Whether `outputs` contain no statistic. Statistics need the whole run."""
        return {statistic.name for statistic in STATISTICS}.isdisjoint(outputs)

    def early_stop_rate(self, bound: Array, step_sizes: StepSizes, tolerances: Tolerances) -> Array:
        """Return the rms of theta' (rad per time unit) above which a point drifts, whatever the expected error, (points,)."""
        # The divisor is at most 0.1, so that `rounding` is no smaller than the rounding error in `Run.rules`.
        rounding = bound * ROUNDING * np.sqrt(step_sizes.whole_steps) / np.minimum(tolerances.angle, 0.1)
        absolute = step_sizes.rate_error + rounding
        return np.asarray(
            (tolerances.rate + absolute) / (1.0 - np.minimum(relative_error(step_sizes, bound), 1.0))
        )

    def measurements(self, run: Run, measured: Measured) -> dict[str, Array]:
        integration = run.integration
        return finish(integration.sums[: len(Row)], integration.intervals, integration.duration)

    def rules(self, run: Run, rules: Mapping[str, Rule]) -> dict[str, Rule]:
        """Return the rules of the labels in the system's frame and, if the frame turns, in inertial space."""
        return {name: rule(run.settings.tolerances, rate) for name, rate in run.frame_rates.items()}

    def errors(self, run: Run, relative: Array) -> dict[str, Array]:
        """Return the expected error of each measurement that decides a label, (points,) each."""
        step_sizes, bound, measured = run.step_sizes, run.bound, run.measured
        share = np.minimum(relative_error(step_sizes, bound), 1.0)
        # psi' and phi' contain 1 / sin(theta), so that rounding errors grow near the vertical.
        near_vertical = step_sizes.rate_error + bound * ROUNDING * np.sqrt(
            step_sizes.whole_steps
        ) / np.maximum(_least_sine(measured), 1e-300)
        angle = (measured["theta_max"] - measured["theta_min"]) * share
        angle += measured["sine_max"] * np.where(bound > 0, step_sizes.rate_error / bound, 0.0)
        absolute = {
            "theta_dot_rms": step_sizes.rate_error,
            "normal_rate_std": step_sizes.rate_error,
            "psi_dot_std": near_vertical,
            "phi_dot_std": near_vertical,
        }
        errors = {name: size + share * measured[name] for name, size in absolute.items()}
        errors |= {"psi_dot_mean": near_vertical, "phi_dot_mean": near_vertical}
        outside = measured.get("outside", np.ones(1))
        # The number of nodes outside the cylinder may be wrong by 2, or by 1 in each oscillation if nodes and motion are in resonance.
        missed = np.fmax(2.0 / step_sizes.intervals, bound * step_sizes.sample_spacing / (2.0 * np.pi))
        share = np.where((outside > 0.0) & (outside < 1.0), missed, 0.0)
        return errors | {"theta_min": angle, "theta_max": angle, "sine_max": angle, "outside": share}

    def rounding(self, run: Run, relative: Array) -> dict[str, Array]:
        """Return rounding errors. A rate has the error `relative` times the frequency bound, divided by sin(theta) for psi' and phi'."""
        size = run.bound * relative
        of_angles = size / np.maximum(_least_sine(run.measured), run.settings.cylinder)
        names = "psi_dot_mean", "psi_dot_std", "phi_dot_mean", "phi_dot_std"
        sizes = {"theta_dot_rms": size, "normal_rate_std": size, "sine_max": relative}
        return sizes | dict.fromkeys(names, of_angles)

    def relative_error(self, run: Run) -> Array:
        """Return the relative error of an oscillation at the frequency bound. An instability amplifies the error to at most 1."""
        step_sizes, log_growth = run.step_sizes, run.log_growth
        error = np.maximum(step_sizes.dispersion_error, step_sizes.dissipation_error)
        error = error + rounding_error(step_sizes)
        with np.errstate(all="ignore"):
            amplified = np.minimum(error * np.exp(log_growth), np.maximum(error, 1.0))
            error = np.where(log_growth > 0, amplified, error)
        return _with_statistics(error, run)

    def rate_change(self, run: Run, other: Run) -> Array:
        """Return the largest difference of a rate between the runs, divided by the frequency bound."""
        return np.asarray(np.fmax.reduce(_differences(run, other, RATES)) / run.bound)

    def pair_error(self, run: Run, coarse: Run, expected: Array) -> Array:
        """Return the relative error of states and statistics from the difference between the runs.

        The error of the states follows from the difference of the final states and the order of the method. Statistics converge at no
        clear order. Their error is the difference between the runs, or 0.3 of the error that follows from the states if that is
        larger, because two runs may agree by chance. If the run `coarse` is not resolved, the result is at least `expected`.
        """
        order = METHODS[run.settings.method].order
        with np.errstate(all="ignore"):
            ratio = run.step_sizes.steps / coarse.step_sizes.steps
            final = run.integration.final_state, coarse.integration.final_state
            state = state_distance(run.system, *final, run.bound)
            state = np.fmax(state / np.abs(ratio**order - 1.0), rounding_error(run.step_sizes))
            rates = [change / run.bound for change in _differences(run, coarse, RATES)]
            angles = _differences(run, coarse, ("theta_min", "theta_max"))
            error = np.fmax.reduce([state, 0.3 * _with_statistics(state, run), *rates, *angles])
        trusted = (coarse.step_sizes.step_ratio < 0.5) & coarse.integration.finite
        return np.where(trusted, error, np.fmax(error, expected))

    def columns(self, run: Run, columns: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
        """Return the geometry, and the statistics of psi' and phi', which are nan in the cylinder."""
        tolerances, ok = run.settings.tolerances, columns["status"] == Status.OK
        cylinder = in_cylinder(run.measured, tolerances.angle)
        steady = ok & (columns["label"] != Label.DRIFTING)
        return {"geometry": geometry(run.system, run.measured, steady, cylinder, tolerances)} | {
            name: np.where(cylinder, np.nan, columns[name]) for name in NEEDS_PSI
        }


@np.errstate(invalid="ignore")
def geometry(
    system: System, measured: Measured, steady: Mask, cylinder: Mask, tolerances: Tolerances
) -> Flags:
    """Return the flag of the first geometry that holds for each motion, or 0 if none holds or the motion is not steady."""
    kinds = [
        kind.holds(measured, cylinder, tolerances.rate, tolerances.angle)
        for kind in system.geometries.values()
    ]
    return np.select([~steady, *kinds], range(1 + len(kinds)), 0).astype(np.int8)


def existing(system: System, variables: tuple[Variable, ...]) -> tuple[Variable, ...]:
    """Return `variables` without the variables that the system lacks."""
    missing = {"integral_drift"} if not system.equations.INTEGRALS else set()
    if not system.geometries:
        missing |= {"geometry"}
    has_families = bool(families_of(system) or reserved_families(system.name))
    if not has_families:
        missing |= {"family", "stable", "growth_rate"}
    if not (predicted := has_families or isinstance(polynomial_degree(system), int)):
        missing |= {"condition_residual"}
    return tuple(
        variable
        for variable in variables
        if variable.name not in missing
        and (system.frame_rate is not None or not variable.name.endswith("_inertial"))
        and (predicted or not variable.name.startswith(("predicted", "agreement")))
    )


def step_variables(system: System) -> list[Variable]:
    bound = "numeric bound" if system.has_numeric_bound else "bound"
    comment = _NUMERIC_BOUND if system.has_numeric_bound else ""
    return [
        Variable("step", "float64", "s", "integration step", comment=comment),
        Variable(
            "step_ratio", "float64", "1",
            f"step times {bound} of the fastest frequency over the stability limit of the method", comment=comment,
        ),
    ]  # fmt: skip


def label(measured: Mapping[str, Array], tolerances: Tolerances, frame_rate: Array | float = 0.0) -> Flags:
    """Return values of `flags.Label`, whatever the status. `frame_rate` (rad per time unit) is added to psi'."""
    rate = tolerances.rate
    cylinder = in_cylinder(measured, tolerances.angle)
    nutates = measured["theta_dot_rms"] > rate
    # In the cylinder psi' is missing. So a run that enters or leaves the cylinder also drifts if theta or the normal rate varies.
    entered = _least_sine(measured) < tolerances.angle
    swings = measured["theta_max"] - measured["theta_min"] > tolerances.angle
    crossing = entered & (swings | (measured["normal_rate_std"] > rate))
    unsteady = (measured["psi_dot_std"] > rate) | (measured["phi_dot_std"] > rate)
    drifting = np.where(cylinder, measured["normal_rate_std"] > rate, nutates | crossing | unsteady)
    return steady_label(
        measured["psi_dot_mean"] + frame_rate, measured["phi_dot_mean"], cylinder, rate, drifting
    )


def rule(tolerances: Tolerances, frame_rate: Array | float = 0.0) -> Rule:
    of_rates = partial(label, tolerances=tolerances, frame_rate=frame_rate)
    return Rule(of_rates, (*LABEL_STATISTICS, "outside"), {"psi_dot_mean": frame_rate, "phi_dot_mean": 0.0})


def steady_label(
    n: Array, m: Array, cylinder: Mask, tolerance: Array | float, drifting: Mask | bool = False
) -> Flags:
    """Return labels from the mean rates n = psi' and m = phi'. Rates up to `tolerance` count as zero."""
    zero_rate = (np.abs(n) <= tolerance) | (np.abs(m) <= tolerance)
    steady = np.where(cylinder | zero_rate, Label.PERMANENT_ROTATION, Label.REGULAR_PRECESSION)
    return np.where(drifting, Label.DRIFTING, steady).astype(np.int8)


def in_cylinder(measured: Measured, cylinder_tolerance: float) -> Mask:
    """Whether sin(theta) is below the tolerance at all nodes. Half of the nodes suffice if theta varies by at most the tolerance."""
    inside = np.asarray(measured["sine_max"] < cylinder_tolerance)
    at_most_nodes = ~inside & (measured.get("outside", np.ones(1)) <= 0.5)
    if at_most_nodes.any():
        swings = measured["theta_max"] - measured["theta_min"] > cylinder_tolerance
        inside = inside | (at_most_nodes & (_least_sine(measured) < cylinder_tolerance) & ~swings)
    return inside


def _least_sine(measured: Measured) -> Array:
    return np.minimum(np.sin(measured["theta_min"]), np.sin(measured["theta_max"]))


def _with_statistics(state_error: Array, run: Run) -> Array:
    """Return the relative error of states and statistics, from the error of the states.

    Interpolation between nodes adds to the error of the angles. The error of psi' and phi' is larger near the vertical, and at least 1
    if the third axis passed through the cylinder about the vertical. The error is smaller if the run starts in the cylinder, because
    nodes close to the start show how the axis leaves. If the axis is slow, its path may turn much between two nodes.
    """
    measured, bound, cylinder, integration = run.measured, run.bound, run.settings.cylinder, run.integration
    u1, u2, *_ = run.system.equations.frame_motion(run.ensemble.state, run.ensemble.constants)
    leaves = np.sin(integration.sums[Row.FIRST_THETA]) < cylinder
    with np.errstate(all="ignore"):
        angle = state_error + _interpolation_error(run.step_sizes, bound)
        least = _least_sine(measured)
        sine = np.maximum(np.where(leaves, LEAVING_SINE, least), cylinder)
        spread = np.fmax(measured["psi_dot_std"], measured["phi_dot_std"]) / bound
        rates = np.fmax(angle, angle * (1.0 + (2.0 + 6.0 * spread) / sine))
        # This is the rms of psi' / bound if the axis once passes the vertical at the distance `cylinder` with the speed `bound`.
        peak = np.sqrt(0.5 * np.pi / (cylinder * bound * integration.duration))
        undefined = np.fmax.reduce([np.ones_like(rates), spread, peak])
        turn = run.step_sizes.sample_spacing * bound**2 / np.hypot(u1, u2)
        missed = spread * np.minimum((turn / MISSED_TURN) ** 3, 1.0)
        left = np.fmax(np.fmin(rates + missed, undefined), angle)
    outside = integration.sums[Row.OUTSIDE]
    inside = (outside == 0.0) | in_cylinder(measured, cylinder)  # psi' and phi' are nan
    partly = (outside > 0.0) & (outside < integration.intervals * (1.0 - 1e-10))
    crossed = ~inside & (partly | (least < 2.0 * cylinder))
    return np.asarray(np.select([inside, crossed & leaves, crossed], [angle, left, undefined], rates))


def _differences(run: Run, other: Run, names: Collection[str]) -> list[Array]:
    with np.errstate(invalid="ignore"):
        return [np.abs(run.measured[name] - other.measured[name]) for name in names]


def rounding_error(step_sizes: StepSizes) -> Array:
    """Return the relative rounding error of the states, (points,)."""
    return np.asarray(4.0 * ROUNDING * np.sqrt(step_sizes.whole_steps))


def tolerated_error(settings: StepSettings, step_sizes: StepSizes, bound: Array) -> Array:
    """Return the expected relative error of the states. The error is at least `settings.tolerance` unless a step is given."""
    expected = relative_error(step_sizes, bound) + rounding_error(step_sizes)
    return expected if settings.step is not None else np.fmax(expected, settings.tolerance)


def state_distance(system: System, state: Array, other: Array, bound: Array) -> Array:
    """Return the largest difference of a component between two states. Angular velocities are divided by the frequency bound."""
    difference = np.abs(state - other)
    difference[[name in system.rate_states for name in system.equations.STATE]] /= bound
    return np.asarray(difference.max(0))


def relative_error(step_sizes: StepSizes, bound: Array) -> Array:
    """Return the relative error of a standard deviation, the sum of dispersion, dissipation and interpolation errors."""
    interpolation = _interpolation_error(step_sizes, bound)
    return np.asarray(step_sizes.dispersion_error + step_sizes.dissipation_error + interpolation)


def _interpolation_error(step_sizes: StepSizes, bound: Array) -> Array:
    """Return the relative error of interpolation between nodes for an oscillation at the frequency bound."""
    with np.errstate(over="ignore"):
        return np.asarray(INTERPOLATION_ERROR * (bound * step_sizes.sample_spacing) ** 8)
