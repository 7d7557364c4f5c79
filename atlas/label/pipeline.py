"""Computation of labels from parameters: runs are prepared, integrated, checked at other steps and compared with theory."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from ..flags import Status
from ..kernel import blocks, numeric_bound
from ..kernel.blocks import ALL_THREADS, Threads
from ..kernel.ensemble import Ensemble
from ..kernel.generated import WIDTH
from ..kernel.statistics import Row
from ..kernel.stepsize import ROUNDING, StepSizes
from ..kernel.tableaux import METHODS
from ..measure.circle import ANY_AXIS_THEORY
from ..measure.instrument import Run, RunSettings
from ..measure.observables import whole_periods
from ..scene.grid import Grid, status_of
from ..systems.base import Array, Flags, Mask, Points, SharedValues, derived_values
from ..variables import variables
from .plan import Plan
from .theory import Theory, agreement, departure_changes, forget_drifting

if TYPE_CHECKING:
    from ..measure.tangent_runs import TangentRuns

# The error of one point in POINTS_PER_HALF_STEP is measured if check_half_step = "sample".
POINTS_PER_HALF_STEP = 64
# Accepted relative change of a statistic between runs with two step sizes. An error common to both runs may be ten times this change.
LARGEST_CHANGE = 0.01


def evaluate(
    plan: Plan, tile: Grid, *, halved: Mask | bool = False, threads: Threads = ALL_THREADS
) -> dict[str, np.ndarray]:
    """Integrate, measure, label and compare points, and return arrays (points,) by the names of variables.

    Points with a reason not to exist are not computed. Numbers are nan there, and flags other than the status have the value for a
    missing point. A run may end once its label is certain. Statistics that the plan does not want may therefore be missing or cover
    only a part of the run. Points whose labels are proved have no statistics. Points where `halved` is true run at half the step of
    the settings. The progress of `threads` is a number of points.
    """

    def of_part(plan: Plan, where: Mask) -> dict[str, np.ndarray]:
        """Compute the variables at the points `where`. Other points have missing values."""
        columns, registry = {}, variables(plan.system)
        if where.any():
            part, half = tile.subset(where), np.broadcast_to(halved, where.shape)[where]
            some = evaluate(plan, part, halved=half, threads=threads)
        else:
            some = {name: np.empty(0, variable.dtype) for name, variable in registry.items()}
        for name, values in some.items():
            empty = np.nan if values.dtype.kind == "f" else registry[name].missing
            columns[name] = np.full(where.shape, empty, values.dtype)
            columns[name][where] = values
        return columns

    if not tile.exists.all():
        columns = of_part(plan, tile.exists)
        return columns | {"status": np.where(tile.exists, columns["status"], status_of(tile.reason))}
    if plan.settings.prove:
        from .proved import by_proof

        proved, known = by_proof(plan, tile, threads.progress)
        columns = of_part(plan.without_prove(), ~proved)
        for name, values in known.items():
            columns[name][proved] = values
        return columns
    runs = _prepare(plan, tile, halved, threads)
    run = runs.integrate()
    columns = _assemble(runs, run, *_recheck(runs, run))
    for name, values in plan.proofs(tile).items():
        columns[name] = np.where(values != 0, values, columns[name]) if name in columns else values
    added = dict[str, np.ndarray]()
    if runs.tangent is not None:
        tangent = replace(runs.tangent, ensemble=run.ensemble)
        added |= tangent.variables(columns, runs.theory.unstable, threads)
    if not frozenset(plan.names).isdisjoint(ANY_AXIS_THEORY):
        from .any_axis import predict_any_axis

        columns |= predict_any_axis(plan, tile, runs.theory.prediction)
    start, may_settle = run.ensemble, runs.theory.prediction.may_settle
    forget_drifting(plan.system, columns, may_settle, start.constants, start.origin, start.state)
    if "predicted" in columns:
        added["agreement"] = agreement(columns["label"], columns["predicted"])
    if "agreement_any_axis" in plan.names:
        added["agreement_any_axis"] = agreement(columns["label_any_axis"], columns["predicted_any_axis"])
    return columns | added | derived_values(plan.system, plan.names, tile.base, tile.duration, runs.check)


def label_status(
    finite: Mask,
    integral_drift: Array,
    drift_tolerance: float,
    resolved: Mask,
    rounding_growth: Array,
    rounding_limit: Array | float,
    step_sensitive: Mask | bool = False,
    rounding_decides: Mask | bool = False,
) -> Flags:
    """Return the first problem of each computed point in the order of `flags.Status`, or OK if the point has no problem.

    `rounding_growth` is the logarithm of the growth of rounding errors. `step_sensitive` is true where the step size decides a
    label or a statistic (see `_recheck` and `_step_decides`). For `rounding_decides` see `Run`.
    """
    conditions = {
        Status.NOT_FINITE: ~finite,
        Status.DRIFT_EXCEEDED: integral_drift > drift_tolerance,
        Status.UNDER_RESOLVED: ~resolved,
        Status.STEP_SENSITIVE: step_sensitive,
        Status.ROUNDOFF_DECIDED: rounding_decides
        | ((rounding_growth > 0) & (rounding_growth > rounding_limit)),
    }
    return np.select(list(conditions.values()), list(conditions), Status.OK).astype(np.int8)


@dataclass(frozen=True)
class _Runs:
    """Points that are ready to be integrated, with predictions of theory. Arrays have shape (points,)."""

    plan: Plan
    tile: Grid
    settings: RunSettings
    ensemble: Ensemble
    step_sizes: StepSizes
    settled: Mask  # whether the frequency bound holds for the whole run
    theory: Theory
    tangent: TangentRuns | None  # tangent runs after the transient, for the indicators of chaos
    growth: TangentRuns | None  # tangent runs from the start, for the growth of errors
    threads: Threads  # threads whose progress is a number of points

    def check(self) -> None:
        """Report a progress of 0 points, so that an interrupted run ends here."""
        self.threads.progress(0.0)

    def integrate(self) -> Run:
        """Integrate the points. Unresolved runs end after a few steps. If the plan allows it, a run also ends once it surely drifts."""
        step_sizes, settings = self.step_sizes.without_unresolved(), self.settings
        total = max(int(step_sizes.whole_steps.sum()), 1)
        further = self.tangent or self.growth
        points = self.ensemble.size * (1.0 - (further.share if further else 0.0))
        threads = self.threads.scaled(points / total)
        ensemble = after_transient(self.plan, self.tile.points, self.ensemble, step_sizes, threads)
        stop_rate = None
        if self.plan.may_stop_early:
            with np.errstate(all="ignore"):
                bound, main = self.ensemble.frequency_bound, self.plan.main
                stop_rate = main.early_stop_rate(bound, step_sizes, settings.tolerances)
                stop_rate = np.where(self.theory.error_amplified(step_sizes, settings), np.inf, stop_rate)
        integration = ensemble.integrate(
            self.plan.kernel, step_sizes, settings.cylinder, early_stop_rate=stop_rate, threads=threads
        )
        rates, growth = self.theory.frame_rates, self.theory.prediction.log_growth
        return Run(
            self.plan.system, settings, self.plan.instruments, ensemble, self.step_sizes, rates, growth,
            integration, self.tile.points,
        ).measure()  # fmt: skip

    def by_steps(self, run: Run, step_sizes: StepSizes) -> Run:
        """Integrate the points of `run` again with other step sizes."""
        threads = self.threads.scaled(0.0)
        ensemble = after_transient(self.plan, run.points, run.ensemble, step_sizes, threads)
        integration = ensemble.integrate(self.plan.kernel, step_sizes, run.settings.cylinder, threads=threads)
        return replace(run, ensemble=ensemble, step_sizes=step_sizes, integration=integration).measure()

    def resolved(self, run: Run) -> Mask:
        """Whether the frequency bound holds and the steps are short enough for the motion and the tangent vectors."""
        with np.errstate(all="ignore"):
            resolved = self.step_sizes.resolved & self.settled & run.main.resolved(run)
            if self.tangent is not None:
                resolved = resolved & self.tangent.steps.resolved
            return resolved

    def with_growth(self, run: Run, status: Flags) -> Run:
        """Return the run with the growth of tangent vectors at the points where an instrument needs the growth."""
        needed = [each.needs_growth(run, status) for each in run.instruments if each.needs_growth]
        if self.growth is None or not needed:
            return run
        # Progress counts these runs unless there are tangent runs for chaos, which are counted instead.
        threads = self.threads.scaled(0.0) if self.tangent else self.threads
        return replace(run, growth=self.growth.growth(np.logical_or.reduce(needed), threads))

    def status(self, run: Run, step_sensitive: Mask | bool) -> Flags:
        with np.errstate(all="ignore"):
            return label_status(
                run.integration.finite, run.measured["integral_drift"], run.settings.drift_tolerance,
                self.resolved(run), *self.theory.rounding(run), step_sensitive, run.rounding_decides,
            )  # fmt: skip


def _prepare(plan: Plan, tile: Grid, halved: Mask | bool, threads: Threads) -> _Runs:
    """Prepare runs with an ensemble, step sizes and theory. Points whose parameters overflow are unresolved."""
    system, settings, main = plan.system, plan.settings.at(tile.rate_tolerance), plan.main
    points = SharedValues(tile.points)
    ensemble, method = Ensemble.of(system, points, plan.plugs), METHODS[settings.method]
    periods, duration = whole_periods(system, ensemble.constants, tile.duration)
    _, transient = whole_periods(system, ensemble.constants, np.broadcast_to(tile.transient, duration.shape))
    tile = replace(tile, duration=duration, transient=transient)
    bound, settled = numeric_bound.along_runs(
        system, plan.kernel, method, ensemble, tile.until, settings.max_steps, threads
    )
    ensemble = replace(ensemble, frequency_bound=main.bound(bound, settled))
    with np.errstate(all="ignore"):
        step_sizes = main.step_sizes(settings, ensemble.frequency_bound, tile.until, tile.step)
        step_sizes = step_sizes.after(transient, duration).in_periods(periods, method)
        if np.any(halved):
            step_sizes = step_sizes.halved(method, halved)
        starts = replace(tile, points=points)  # local, so that the shared values are freed at the end
        theory = Theory.of(plan, starts, ensemble, step_sizes)
        tangent = growth = None
        if plan.has_tangent:
            from ..measure.tangent_runs import TangentRuns

            of = partial(TangentRuns.of, system, plan.tangent_kernel, ensemble, tile.points)
            if plan.has_chaos:
                tangent = of(duration, settings, step_sizes, has_chaos=True)
            if plan.needs_growth:
                growth = of(tile.until, settings, step_sizes, has_chaos=False)
    return _Runs(plan, tile, settings, ensemble, step_sizes, settled, theory, tangent, growth, threads)  # fmt: skip


@np.errstate(all="ignore")
def after_transient(plan: Plan, points: Points, ensemble: Ensemble, step_sizes: StepSizes, threads: Threads = ALL_THREADS) -> Ensemble:  # fmt: skip
    """Return the ensemble at the end of the transients, which start at `ensemble.origin`. Progress counts the steps of all points."""
    where, start = np.flatnonzero(step_sizes.transient_steps), replace(ensemble, state=ensemble.origin)
    if not where.size:
        return start
    steps, state, change = step_sizes.transient_steps[where], start.state.copy(), np.zeros(start.size)
    # A transient has nodes only so that a long run can be interrupted.
    intervals = -(-steps * WIDTH // blocks.CHUNK)
    strides = -(-steps // intervals)
    step_size = step_sizes.transient[where] / (strides * intervals)
    arrays = start.subset(where).arrays(plan.kernel, step_size)
    blocks.integrate(plan.kernel, blocks.pack_blocks(strides * intervals, strides), arrays, threads=threads)
    state[:, where] = arrays.state[: len(state)]
    change[where] = arrays.sums[0 if plan.kernel.OBSERVABLES else Row.DRIFT]
    return replace(start, state=state, change=change).with_given(plan.system, points, plan.plugs)


def _recheck(runs: _Runs, run: Run) -> tuple[Array, Mask]:
    """Return the relative error of each run, and whether the step size decides a label. Some points are run again with other steps."""
    method, theory = METHODS[run.settings.method], runs.theory
    with np.errstate(all="ignore"):
        usable = (runs.status(run, False) == Status.OK) & ~run.integration.stopped_early
        # A start that is on an unstable motion to within rounding departs from the motion by integration errors alone.
        departed = usable & theory.departed(run)
        step_sensitive = departed & (
            theory.prediction.start_residual <= ROUNDING * np.sqrt(run.step_sizes.whole_steps)
        )
        errors, error = run.errors()
        unsure = run.unsure(errors)
        # With a numeric bound all errors are measured, because expected errors ignore frequencies that the bound misses. Measured
        # errors decide the status only if every point is measured, so that the status does not depend on the sample.
        is_numeric = run.system.has_numeric_bound
        every = is_numeric or run.settings.check_half_step == "all"
        sample = np.flatnonzero(usable & (every or _sample(run)))
        if sample.size:
            # The second run has fewer steps. If the second run overflows, the label is unsure.
            part, expected = run.subset(sample), error[sample]
            sizes = part.step_sizes
            coarser = sizes.incommensurate(method) if is_numeric else sizes.coarsened(method)
            coarse = runs.by_steps(part, coarser)
            error[sample] = np.fmax.reduce(
                [each.pair_error(part, coarse, expected) for each in run.instruments]
            )
            if every:
                could_differ = part.unsure(run.main.differences(part, coarse, error[sample]))
                unsure[sample] = could_differ | ~coarse.integration.finite | part.ends_otherwise(coarse)
                step_sensitive[sample] |= _step_decides(runs, part, coarse)
        where = np.flatnonzero(usable & ~step_sensitive & (unsure | departed))
        if where.size:
            part = run.subset(where)
            fine = runs.by_steps(part, part.step_sizes.halved(method))
            change = part.change(fine)
            changes = fine.unsure(run.main.differences(fine, part, change))
            before, after = part.labels(), fine.labels()
            changes |= np.any([before[name] != after[name] for name in before], axis=0)
            changes |= departed[where] & departure_changes(part, fine) | part.ends_otherwise(fine)
            step_sensitive[where] = changes
            error[where] = np.fmax(error[where], change)
        return np.fmax(error, run.measured["integral_drift"]), step_sensitive


def _sample(run: Run) -> Mask:
    """Select one point in POINTS_PER_HALF_STEP by a hash of the point, or no point unless the settings ask for a sample."""
    if run.settings.check_half_step != "sample":
        return np.zeros(run.ensemble.size, bool)
    mixed = np.zeros(run.ensemble.size, np.uint64)
    equations, rows = run.system.equations, np.concatenate([run.ensemble.state, run.ensemble.constants])
    optional = getattr(equations, "OPTIONAL", ())
    for name, row in zip((*equations.STATE, *equations.CONSTANTS), rows, strict=True):
        before, mixed = mixed, (mixed ^ row.view(np.uint64)) * np.uint64(0x9E3779B97F4A7C15)
        mixed ^= mixed >> np.uint64(29)
        if name in optional:
            mixed = np.where(row == 0, before, mixed)
    return np.asarray(mixed % np.uint64(POINTS_PER_HALF_STEP) == 0)


def _step_decides(runs: _Runs, run: Run, coarse: Run) -> Mask:
    """Return whether another step size changes a statistic by a fraction above LARGEST_CHANGE.

    Changes that the growth of errors explains do not count, because in chaos errors grow so fast that no step size would suffice.
    The growth is measured by the distance between runs with neighbouring starts.
    """
    change = run.change(coarse)
    decides = change > LARGEST_CHANGE
    if (where := np.flatnonzero(decides)).size:
        part = run.subset(where)
        (_, error), (_, of_coarse) = part.errors(), coarse.subset(where).errors()
        state = part.ensemble.origin
        slope = np.array(np.broadcast_arrays(*run.system.equations.rhs(state, part.ensemble.constants)))
        size = (np.abs(state) + np.abs(slope) / part.bound) * np.cos(np.arange(len(state)))[:, np.newaxis]
        beside = replace(part, ensemble=replace(part.ensemble, origin=state + error * size))
        grown = part.change(runs.by_steps(beside, part.step_sizes)) * of_coarse / error
        decides[where] = grown < change[where]
    return decides


def _assemble(runs: _Runs, run: Run, error: Array, step_sensitive: Mask) -> dict[str, np.ndarray]:
    """Collect the variables that measurements and predictions give. `evaluate` adds the other variables."""
    integration, main = run.integration, run.main
    resolved = main.shown(run, runs.resolved(run))
    columns: dict[str, np.ndarray] = {
        name: values if name == "integral_drift" else np.where(resolved, values, np.nan)
        for name, values in run.measured.items()
        if ":" not in name
    }
    columns["status"] = status = runs.status(run, step_sensitive)
    run = runs.with_growth(run, status)
    registry = variables(run.system)
    with np.errstate(invalid="ignore"):
        for name, rule in run.rules.items():
            columns[name] = rule.column(name, registry, run, status == Status.OK)
    for instrument in run.instruments:
        columns |= instrument.columns(run, columns)
    ended = integration.stopped_early | ~run.step_sizes.resolved
    transient = np.where(run.step_sizes.resolved, run.step_sizes.transient, 0.0)
    columns |= runs.theory.prediction.variables
    columns |= {
        "step": run.step_sizes.step_size,
        "step_ratio": run.step_sizes.step_ratio,
        "error_estimate": np.where(resolved, error, np.inf),
        "condition_residual": runs.theory.prediction.test.residual,
        "end_time": np.where(ended, integration.duration, runs.tile.duration) + transient,
    }
    return columns
