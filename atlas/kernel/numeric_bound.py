"""Frequency bound of systems that give none, computed from the Jacobian at the start and along a preliminary run.

The frequency of the Jacobian at the start (`systems.jacobian`) is often too low, because a motion may begin slowly. A
preliminary run with the longest possible steps therefore samples the frequency. If the frequency grows, the run is repeated
with a larger bound. The Jacobian does not show the frequency of a forcing, because time is a state of constant rate. The derivatives
of the states along the run show this frequency. The result of a point does not depend on other points.
"""

from __future__ import annotations

from types import ModuleType

import numpy as np
from numpy.typing import NDArray

from ..systems import jacobian
from ..systems.base import Array, Mask, Points, System
from .blocks import ALL_THREADS, Threads
from .ensemble import Ensemble
from .stepsize import GOLDEN_SECTION
from .tableaux import Method

# The mean time between samples is SAMPLE_RADIANS divided by the frequency bound. With this spacing the samples show that a motion
# becomes faster (for example before the pericentre of an eccentric orbit) before the steps are too long for the motion.
SAMPLE_RADIANS, MIN_SAMPLES, MAX_SAMPLES = 0.5, 16, 2000
# Samples are earlier than equidistant samples, by up to EARLY mean distances. Equidistant samples could meet a forcing at one phase only.
EARLY = 0.5
# The bound is at least this many turns per run, because a motion whose Jacobian vanishes at the start needs samples as well.
LEAST_TURNS = 4
# The preliminary run may have this phase error and loss of amplitude. A step is at most MAX_STEP_RATIO times the stability limit.
ERROR, MAX_STEP_RATIO = 1e-2, 0.25
# If the frequency exceeds TOLERATED times the bound, the bound is raised by a factor from RAISE to RAISE_MOST. The factor is
# limited because a coarse run may be wrong.
TOLERATED, RAISE, RAISE_MOST = 1.05, 1.25, 4.0
# The bound is raised until each state x has max |x''| <= OVERTONE bound max |x'| and max |x'''| <= OVERTONE bound max |x''|. With
# 1 / bound as the unit of time, derivatives below NEGLIGIBLE times the state are rounding errors.
OVERTONE, NEGLIGIBLE = 2.0, 1e-8
MATRICES = 4096  # number of Jacobians computed at a time
FEW_STEPS = 20000  # this many steps, summed over points, take less time than starting a thread
MAX_NOT_FINITE = 4  # number of repeated attempts at a point that overflows
MAX_ATTEMPTS = 60


def before_run(system: System, points: Points, duration: Array) -> Array:
    """Return the frequency bound, rad per time unit, that is known without integrating. Estimates of costs use this bound."""
    bound = system.frequency_bound(points)
    return np.fmax(bound, _least(duration)) if system.has_numeric_bound else bound


def _least(duration: Array) -> Array:
    """Return the least bound, rad per time unit, of runs of these durations."""
    with np.errstate(all="ignore"):
        return np.asarray(2 * np.pi * LEAST_TURNS / duration)


def along_runs(
    system: System,
    kernel: ModuleType,
    method: Method,
    ensemble: Ensemble,
    duration: Array,
    max_steps: int,
    threads: Threads = ALL_THREADS,
) -> tuple[Array, Mask]:
    """Return the frequency bound of each point, rad per time unit, and whether it holds along the whole run."""
    if not system.has_numeric_bound:
        return ensemble.frequency_bound, np.ones(ensemble.size, bool)
    bound = np.fmax(ensemble.frequency_bound, _least(duration))
    bound = np.where(np.isfinite(ensemble.frequency_bound), bound, np.inf)
    finite_bound, not_finite = bound.copy(), np.zeros(bound.size, np.int64)
    settled = np.zeros(bound.size, bool)
    pending = np.arange(bound.size)
    for _ in range(MAX_ATTEMPTS):
        with np.errstate(all="ignore"):
            # `longest` is the longest step of the preliminary run times the bound, in rad.
            radians = np.maximum(bound[pending] * duration[pending], 1e-300)
            phase = (ERROR / (method.dispersion * radians)) ** (1 / method.order)
            loss = (ERROR / (method.dissipation * radians)) ** (1 / (method.dissipation_order - 1))
            longest = np.minimum(np.minimum(phase, loss), MAX_STEP_RATIO * method.stability)
            affordable = bound[pending] * duration[pending] / longest <= max_steps
        pending, longest = pending[affordable], longest[affordable]
        if not pending.size:
            break
        largest = _largest_frequency(
            system, kernel, ensemble.subset(pending), bound[pending], duration[pending], longest, threads
        )
        overflowed = ~np.isfinite(largest)
        grown = overflowed | (largest > TOLERATED * bound[pending])
        settled[pending[~grown]] = True
        not_finite[pending[overflowed]] += 1
        raised = np.clip(largest, RAISE * bound[pending], RAISE_MOST * bound[pending])
        bound[pending[grown]] = raised[grown]
        finite_bound[pending[grown & ~overflowed]] = raised[grown & ~overflowed]
        pending = pending[grown & (not_finite[pending] <= MAX_NOT_FINITE)]
    # If even short steps overflow, the motion itself overflows, and the bound before the overflow is kept.
    bound = np.where(not_finite > MAX_NOT_FINITE, finite_bound, bound)
    return bound, settled


def _distances(count: int) -> Array:
    """Return the distances of successive samples, divided by the mean distance. The first distance is from the start.

    Sample k is early by EARLY times the fractional part of g k^2, where g is the golden section. With g k in place of g k^2,
    forcings of about 5, 8, 13 ... turns between two samples would have nearly the same phase at all samples.
    """
    k = np.arange(count + 1)
    return np.diff(k - EARLY * (GOLDEN_SECTION * k**2 % 1.0))


def _largest_frequency(
    system: System,
    kernel: ModuleType,
    ensemble: Ensemble,
    bound: Array,
    duration: Array,
    longest_step: Array,
    threads: Threads,
) -> Array:
    """Return the largest frequency of each motion up to the first sample whose frequency exceeds the bound, or inf after an overflow."""
    largest, n_samples = np.zeros(ensemble.size), 0
    # If the rate of a state does not depend on the states, this state is time. Without such a state, the Jacobian shows every frequency.
    # The time derivatives of the states are then ignored, because on steady motions these derivatives are rounding errors.
    matrices = jacobian.jacobian(system.equations, ensemble.state, ensemble.constants)
    has_time = (matrices == 0).all(2).any(1)
    sizes = np.zeros((4, *ensemble.state.shape))  # largest |x|, |x'|, |x''| and |x'''| of each state x
    samples = np.clip(np.ceil(bound * duration / SAMPLE_RADIANS), MIN_SAMPLES, MAX_SAMPLES).astype(np.int64)
    steps = np.ceil(bound * duration / (samples * longest_step)).astype(np.int64)
    mean_step_size, distances = duration / (samples * steps), _distances(samples.max())
    active: NDArray[np.int64] = np.arange(ensemble.size)
    while active.size:
        part = ensemble.subset(active)
        # The number of samples doubles in each turn of this loop, because most bounds that are too low are exceeded early.
        count = int(np.clip(min(MATRICES // active.size, n_samples), 1, samples[active].max() - n_samples))
        # This thread does small work itself. The first call, which may compile, runs in another thread, so that Ctrl-C need not wait.
        direct = n_samples > 0 and steps[active].sum() <= FEW_STEPS
        in_threads = Threads(0) if direct else threads
        step_sizes = distances[n_samples : n_samples + count, None] * mean_step_size[active]
        states = part.states_at_samples(kernel, steps[active], step_sizes, in_threads)
        ensemble.state[:, active] = states[:, -1]
        with np.errstate(all="ignore"):
            constants = np.repeat(part.constants[:, None], count, axis=1)
            frequency = jacobian.frequency(system.equations, states, constants)
            rate = np.repeat(bound[None, active], count, axis=0)
            derivatives = np.abs(jacobian.derivatives(system.equations, states, constants, rate))
        frequency = np.where(np.isfinite(frequency) & np.isfinite(states).all(0), frequency, np.inf)
        sampled = n_samples + np.arange(count)[:, None] < samples[active]
        exceeds = sampled & (frequency > TOLERATED * bound[active])
        # Use the samples up to and including the first sample above the bound.
        sampled &= np.cumsum(exceeds, axis=0) - exceeds == 0
        largest[active] = np.fmax(largest[active], np.where(sampled, frequency, 0.0).max(0))
        derivatives = np.fmax.reduce(np.where(sampled, derivatives, 0.0), axis=2)
        sizes[:, :, active] = np.fmax(sizes[:, :, active], derivatives)
        n_samples += count
        active = active[~exceeds.any(0) & (n_samples < samples[active])]
    with np.errstate(all="ignore"):
        ratios = np.fmax.reduce(sizes[2:] / np.fmax(sizes[1:3], NEGLIGIBLE * sizes[0]), axis=(0, 1))
        of_slopes = np.where(has_time & ~(largest > TOLERATED * bound), bound * ratios / OVERTONE, 0.0)
    return np.fmax(largest, of_slopes)
