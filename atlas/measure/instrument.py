"""Instruments, which define variables, sums in the kernel, formulas from sums to measurements, errors, and rules for labels.

An instrument is a frozen object of a class derived from `Instrument`. The kernel of a plan's main instrument integrates the points
(`label.plan`). Other instruments add sums to this kernel (`kernel.ensemble.Plug`) or run a kernel of their own.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..errors import BadInput, allowed_text
from ..kernel.ensemble import Ensemble, Integration
from ..kernel.statistics import Row
from ..kernel.stepsize import ROUNDING, StepSizes
from ..systems.base import Array, Flags, Mask, Points, System, subset

# Least product of frequency bound and duration in rad. It is not 0, because the bound is a divisor.
LEAST_TURN = 1e-80

# Measurements by name, (points,) each. A measurement whose name has a colon is not stored in atlases.
Measured = Mapping[str, Array]


@dataclass(frozen=True)
class Variable:
    """A variable of an atlas, with a value for each point."""

    name: str
    dtype: str  # NumPy dtype in the file
    units: str  # UDUNITS
    long_name: str
    flags: dict[str, str] | None = None  # flag name -> sentence, in the order of the values 0, 1, 2, ...
    comment: str = ""
    optional: bool = False  # only in the atlases of scenes that ask for it
    missing: int = 0  # value of an integer variable where a point is not computed
    # For positions in a list, the flag name of the value -1 (no position) and the stem of the flag names of the values 0, 1, ...
    positions: tuple[str, str] | None = None
    beside: str = ""  # name of a variable that every atlas with this variable contains

    def attributes(self) -> dict[str, object]:
        """Return the CF attributes, which are units or flags, long_name and comment."""
        attributes: dict[str, object] = {"long_name": self.long_name}
        if self.flags is None:
            attributes["units"] = self.units
        else:
            attributes["flag_values"] = np.arange(len(self.flags), dtype=self.dtype)
            attributes["flag_meanings"] = " ".join(self.flags)
        if self.comment:
            attributes["comment"] = self.comment
        return attributes

    @staticmethod
    def table(*variables: Variable) -> dict[str, dict[str, object]]:
        """Return the CF attributes of each variable by the name of the variable."""
        return {variable.name: variable.attributes() for variable in variables}


@dataclass(frozen=True)
class Tolerances:
    """Largest variations of a motion that counts as steady."""

    # Limit (rad per time unit) of the rms of theta', of the standard deviations of psi' and phi', and of mean rates that count as 0.
    rate: Array | float  # (points,), or one number for all points
    angle: float  # the third axis counts as vertical (in the cylinder) if sin(theta) is smaller

    def subset(self, where: Any) -> Tolerances:
        """Return the tolerances of the points `where`, which is a mask, an array of indices or a slice."""
        return self if isinstance(self.rate, float) else replace(self, rate=self.rate[where])


@dataclass(frozen=True)
class RunSettings:
    """Settings of runs and of measurements. See `scene.model.Settings`."""

    method: str
    tolerance: float
    step: float | None
    max_steps: int
    tolerances: Tolerances
    drift_tolerance: float
    std_tolerance: Mapping[str, float] | None
    check_half_step: str
    transient: Array | float = 0.0  # time before the runs, (points,), or one number for all points

    @property
    def rate_tolerance(self) -> Array | float:
        return self.tolerances.rate

    @property
    def cylinder(self) -> float:
        """Radius of the cylinder about the vertical, as the sine of an angle."""
        return self.tolerances.angle

    def subset(self, where: Any) -> RunSettings:
        """Return the settings of the points `where`."""
        transient = self.transient if isinstance(self.transient, float) else self.transient[where]
        return replace(self, tolerances=self.tolerances.subset(where), transient=transient)


@dataclass(frozen=True)
class Rule:
    """Rule by which a label follows from measurements."""

    label: Callable[[Measured], Flags]  # returns labels, whatever the status of the run
    statistics: tuple[str, ...]  # names of the measurements that decide the label
    # Name of a mean -> rate that is added to the mean. The label depends on the magnitude of the sum.
    means: Mapping[str, Array | float] = field(default_factory=dict)
    # Statistic -> largest value that rounding alone can cause in a steady motion, in the unit of the statistic.
    rounding: Mapping[str, Array] = field(default_factory=dict)
    # Names of two flags of the label. `drifting` is for runs that ended early, and `unresolved` for runs whose status is not ok.
    drifting: str = "drifting"
    unresolved: str = "unresolved"

    def without_rounding(self, measured: Measured) -> Measured:
        """Return `measured`, or a copy with 0 for measurements that may be mere rounding. A mean becomes minus the rate in `means`."""
        changed: dict[str, Array] = {}
        for name in self.rounding.keys() & self.statistics:
            none = -self.means.get(name, 0.0)
            is_rounding = np.abs(measured[name] - none) <= self.rounding[name]
            if (is_rounding & (measured[name] != none)).any():
                changed[name] = np.where(is_rounding, none, measured[name])
        return {**measured, **changed} if changed else measured

    def decide(self, measured: Measured) -> Flags:
        """Return the labels that follow from the measurements `without_rounding`."""
        return self.label(self.without_rounding(measured))

    def column(self, name: str, registry: Mapping[str, Variable], run: Run, resolved: Mask) -> Flags:
        """Return the label with `unresolved` where `resolved` is false, or raise BadInput if a value is no flag of the variable."""
        flags, rule = list(registry[name].flags or ()) if name in registry else [], f"the rule of {name}"
        for flag in (self.drifting, self.unresolved):
            if flag not in flags:
                raise BadInput(f"{rule}: {flag!r} is no flag of this variable; {allowed_text(flag, flags)}")
        label = np.where(run.integration.stopped_early, flags.index(self.drifting), self.decide(run.measured))
        label = np.where(resolved, label, flags.index(self.unresolved)).astype(np.int8)
        if label.size and not 0 <= label.min() <= label.max() < len(flags):
            raise BadInput(f"{rule}: flags {label.min()} to {label.max()}; allowed: 0 to {len(flags) - 1}")
        return label


def could_change(rule: Rule, measured: Measured, error: Measured) -> Mask:
    """Whether the label changes if errors are added to all measured magnitudes, or subtracted. For theta_min the sign is opposite."""
    labels = []
    for sign in (-1.0, 0.0, 1.0):
        moved = dict(measured)
        for name in error.keys() & rule.statistics:
            change = sign * error[name]
            if name in rule.means:
                mean = measured[name] + rule.means[name]
                size = np.maximum(np.abs(mean) + change, 0.0)
                moved[name] = np.copysign(size, mean) - rule.means[name]
            else:
                moved[name] = measured[name] + (-change if name == "theta_min" else change)
        labels.append(rule.decide(moved))
    lower, central, upper = labels
    return np.asarray((lower != central) | (upper != central))


@dataclass(frozen=True)
class Run:
    """Integrated points with step sizes and the measurements of instruments. Arrays have shape (points,)."""

    system: System
    settings: RunSettings
    instruments: tuple[Instrument, ...]  # the main instrument, followed by the others
    ensemble: Ensemble
    step_sizes: StepSizes
    frame_rates: Mapping[str, Array]  # label variable -> rate added to psi', rad per time unit
    # Logarithm of the factor by which a distance from the steady motion grows in the run, 0 where the factor is unknown.
    log_growth: Array
    integration: Integration
    points: Points = field(default_factory=dict)  # every parameter of the points
    measured: Measured = field(default_factory=dict)  # measurements of all instruments
    # Logarithm of the largest growth of a tangent vector in the run, (points,). It is nan where no instrument needs the growth.
    growth: Array = field(default_factory=lambda: np.empty(0))

    @property
    def main(self) -> MainInstrument:
        """The main instrument, which is the first instrument."""
        main = self.instruments[0]
        assert isinstance(main, MainInstrument)
        return main

    @property
    def bound(self) -> Array:
        """Bound of the fastest frequency in rad per time unit. The bound is positive even if nothing moves."""
        return np.fmax(self.ensemble.frequency_bound, LEAST_TURN / self.integration.duration)

    def measure(self) -> Run:
        """Return the run with the measurements of all instruments."""
        measured: dict[str, Array] = {}
        for instrument in self.instruments:
            measured |= instrument.measurements(self, measured)
            measured["integral_drift"] = np.maximum(measured["integral_drift"], self.ensemble.change)
        return replace(self, measured=measured)

    @cached_property
    def rules(self) -> dict[str, Rule]:
        """Rules of the labels by the names of the variables."""
        rules: dict[str, Rule] = {}
        rounding: dict[str, Array] = {}
        for instrument in self.instruments:
            rounding |= instrument.rounding(self, 10.0 * ROUNDING * np.sqrt(self.step_sizes.whole_steps))
            own = instrument.rules(self, rules)
            rules |= {name: replace(rule, rounding=rounding) for name, rule in own.items()}
        return rules

    def plugged(self, instrument: Instrument) -> tuple[Array, Array]:
        """Return the rows of the kernel's sums and constants that belong to `instrument`."""
        before = self.instruments[: self.instruments.index(instrument)]
        row, first = len(Row) + sum(each.sums for each in before), sum(each.given for each in before)
        sums, given = self.integration.sums[row:], self.ensemble.given[first:]
        return sums[: instrument.sums], given[: instrument.given]

    def change(self, other: Run) -> Array:
        """Return the largest relative difference of a statistic between two runs of the same points, (points,)."""
        return np.asarray(np.fmax.reduce([each.rate_change(self, other) for each in self.instruments]))

    def labels(self) -> dict[str, Flags]:
        """Return every label, whatever the status."""
        return {name: rule.decide(self.measured) for name, rule in self.rules.items()}

    @cached_property
    def rounding_decides(self) -> Mask:
        """Whether rounding alone may decide a label of a whole run."""
        differs = np.zeros(self.ensemble.size, bool)
        for rule in self.rules.values():
            decisive = rule.without_rounding(self.measured)
            if decisive is not self.measured:
                differs |= rule.label(self.measured) != rule.label(decisive)
        return differs & ~self.integration.stopped_early

    def unsure(self, error: Measured) -> Mask:
        """Whether a label could change within the errors of its measurements."""
        return np.logical_or.reduce(
            [could_change(rule, self.measured, error) for rule in self.rules.values()]
        )

    def ends_otherwise(self, other: Run) -> Mask:
        """Whether a point ends differently in another run, (points,)."""
        differences = [each.outcome_differs(self, other) for each in self.instruments]
        return np.logical_or.reduce(np.broadcast_arrays(*differences, np.zeros(self.ensemble.size, bool)))

    def errors(self) -> tuple[dict[str, Array], Array]:
        """Return the expected errors of measurements that decide labels, and the largest `relative_error` of the instruments."""
        errors: dict[str, Array] = {}
        relative = np.zeros(self.ensemble.size)
        for instrument in self.instruments:
            relative = np.fmax(relative, instrument.relative_error(self))
            errors |= instrument.errors(self, relative)
        return errors, relative

    def subset(self, where: NDArray[np.int64]) -> Run:
        return replace(
            self,
            settings=self.settings.subset(where),
            ensemble=self.ensemble.subset(where),
            step_sizes=self.step_sizes.subset(where),
            frame_rates=subset(self.frame_rates, where),
            log_growth=self.log_growth[where],
            integration=self.integration.subset(where),
            points=subset(self.points, where),
            measured=subset(self.measured, where),
        )


class Instrument:
    """Base class of instruments, which define variables of an atlas and compute their values from runs.

    A subclass must implement `variables`, or `every_variable` if all systems have the same variables. Values come from one of three
    methods, `measurements` for numbers, `rules` for labels, or `columns`. Other members contribute nothing unless overridden:

    Place of the measurement
        `wanted` selects scenes. `sums`, `given`, `add_node` and `constants` add measurements to the kernel, and `needs_whole_run`
        says that runs may not end early. `proofs_of` and `proofs` need no run, and `needs_growth` asks for tangent vectors.
    Errors
        `relative_error`, `pair_error` and `rate_change` concern numbers. `errors`, `rounding` and `outcome_differs` concern rules.
    """

    # Numbers of sums and constants in the kernel, and the function that adds a node to the sums. See `kernel.ensemble.Plug`.
    sums, given = 0, 0
    add_node: Callable[..., None] | None = None
    needs_whole_run = False  # whether no run may end before its duration is over
    # Function that returns, from run and status, a mask of the points that need `Run.growth`. None if no point ever needs it.
    needs_growth: Callable[[Run, Flags], Mask] | None = None
    # Name of a label -> name of the variable whose flag is not 0 where the label is proved for every duration.
    proofs_of: Mapping[str, str] = MappingProxyType({})

    def every_variable(self, system: System) -> tuple[Variable, ...]:
        """Return all variables of the instrument, even if the system lacks some. No parameter may have the name of one of them."""
        return ()

    def variables(self, system: System) -> tuple[Variable, ...]:
        """Return the instrument's variables for one system, or none if the instrument cannot measure the system."""
        return self.every_variable(system)

    def wanted(self, system: System, outputs: Collection[str]) -> bool:
        """Whether a scene with these outputs needs the instrument."""
        return not {variable.name for variable in self.variables(system)}.isdisjoint(outputs)

    def proofs(
        self, system: System, points: Points, tolerances: Tolerances, in_machine_code: bool = False
    ) -> dict[str, NDArray[Any]]:
        """Return variables that need no run, and proved labels (0 where nothing is proved) under the names of predicted labels."""
        return {}

    def measurements(self, run: Run, measured: Measured) -> dict[str, Array]:
        """Return measurements from the sums of a run. `measured` has the measurements of earlier instruments."""
        return {}

    def rules(self, run: Run, rules: Mapping[str, Rule]) -> dict[str, Rule]:
        """Return the rules of the instrument's labels. `rules` has the rules of earlier instruments."""
        return {}

    def errors(self, run: Run, relative: Array) -> dict[str, Array]:
        """Return expected errors of measurements that decide labels. `relative` is the largest `relative_error` up to this instrument."""
        return {}

    def rounding(self, run: Run, relative: Array) -> dict[str, Array]:
        """Return the largest values that the relative rounding error `relative` alone can give to measurements that decide labels."""
        return {}

    def relative_error(self, run: Run) -> Array:
        """Return the expected relative error of the instrument's measurements, (points,)."""
        return np.zeros(run.ensemble.size)

    def rate_change(self, run: Run, other: Run) -> Array:
        """Return the largest relative change of a rate, or of a measurement that decides a label, between two runs of the same points."""
        return np.zeros(run.ensemble.size)

    def outcome_differs(self, run: Run, other: Run) -> Mask | bool:
        """Whether two runs of the same points end differently, (points,)."""
        return False

    def pair_error(self, run: Run, coarse: Run, expected: Array) -> Array:
        """Compare two runs, and return the relative error of `run`'s measurements, (points,). `expected` is the error from `run` alone."""
        return np.zeros(run.ensemble.size)

    def columns(self, run: Run, columns: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
        """Return variables that are no plain measurements. `columns` has the status and the variables of earlier instruments."""
        return {}

    def constants(self, system: System, points: Points, start: Ensemble) -> Array:
        """Return the constants of the points. See `kernel.ensemble.Plug`."""
        return np.empty((0, start.size))


class MainInstrument(Instrument):
    """An instrument whose kernel integrates the points.

    A subclass must implement `unsteadiness` and `largest`. If it overrides `may_stop_early`, it must also implement `early_stop_rate`.
    """

    has_theory = False  # whether theory predicts the labels
    quantity = ""  # one word for all measured quantities
    unsteadiness_text = ""  # meaning of `unsteadiness`

    def may_stop_early(self, outputs: Collection[str]) -> bool:
        """Whether a run with these outputs may end once its label is certain."""
        return False

    def statistics(self, system: System) -> tuple[str, ...]:
        """Return the names of the statistics."""
        return ()

    def unsteadiness(self, system: System, measured: Measured, settings: RunSettings) -> Array:
        """Return the largest of the statistics that make a point drift, (points,). Only the tolerances of `settings` are used."""
        raise NotImplementedError

    def steady_below(self, settings: RunSettings) -> Array | float:
        """Return the unsteadiness up to which a point does not drift."""
        return 1.0

    def largest(self, system: System, measured: Measured, errors: Measured, bound: Array) -> Array:
        """Return the largest relative error of the statistics. `bound` is the bound of the fastest frequency."""
        raise NotImplementedError

    def bound(self, bound: Array, settled: Mask) -> Array:
        """Return the frequency bound that sets the steps. `settled` is true where the given bound holds for the whole run."""
        return bound

    def early_stop_rate(self, bound: Array, step_sizes: StepSizes, tolerances: Tolerances) -> Array:
        """Return the rms of theta' above which the label is drifting for any expected error. See `kernel.ensemble.Ensemble.integrate`."""
        raise NotImplementedError

    def step_sizes(
        self, settings: RunSettings, bound: Array, duration: Array, step: Array | None = None
    ) -> StepSizes:
        """Return the steps of runs with the given frequency bounds. For `step` see `StepSizes.of`."""
        return StepSizes.of(settings, bound, duration, step)

    def resolved(self, run: Run) -> Mask | bool:
        """Whether the nodes are dense enough to show the motion."""
        return True

    def shown(self, run: Run, resolved: Mask) -> Mask:
        """Whether the atlas holds the measurements. `resolved` tells whether the steps suffice for measurements and tangent vectors."""
        return resolved

    def differences(self, run: Run, other: Run, relative: Array) -> dict[str, Array]:
        """Return differences of two runs in measurements that decide labels, or estimates from the runs' relative difference `relative`."""
        return {
            name: np.abs(run.measured[name] - other.measured[name])
            for rule in run.rules.values()
            for name in rule.statistics
        }
