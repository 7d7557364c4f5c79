"""Time per point at equal error, compared with other integrators by ratios measured in one run.

    python scripts/benchmarks/bench_peers.py [--rounds 3] [--only heyoka ...] [--docs .]

The points are random satellites with Omega = 1, magnet and rotor, and random tops with rotor in the Newtonian field, to T = 50
and to T = 1000, and slender satellites to T = 5, whose spin is fast for short times, so that a constant step size costs most
in comparison with adaptive integrators. Tops, and points of the longer runs, are used only if they amplify a small change by less
than 2 T, because no reference is accurate enough for the others.
Every integrator runs the same points on one processor, in the best way of its documentation, at a series of tolerances. All take
turns; times are processor times, the best of all rounds, because disturbances only slow an integrator down. The others return the
final state alone; this package is measured for the final state alone, and with all means, standard deviations, extremes and first
integrals. All get the equations without damping, in units that make a factor 1. Errors are medians over the first points against
SciPy's DOP853 at 3e-14; times are interpolated between tolerances to given errors. The kernels need many points with equal steps
to fill their lanes, so the number of points is part of the result; in the longer runs this package gets each point several times.
--docs writes the tables, the figure and the sentence of the README below a folder. Integrators that are not installed are skipped:

    pip install -e ".[peers]"      (in a clone of the repository)
"""

from __future__ import annotations

import argparse
import importlib.metadata
import os
import platform
import re
import sys
import textwrap
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cache, partial
from itertools import pairwise
from pathlib import Path
from time import process_time
from types import ModuleType

import numpy as np
from matplotlib import rc_context
from matplotlib.figure import Figure
from numba import cfunc, njit
from scipy.integrate import odeint, solve_ivp

from atlas.kernel import machine_code
from atlas.kernel.blocks import Threads
from atlas.kernel.differentiate import simplify
from atlas.kernel.ensemble import Ensemble
from atlas.kernel.specialization import Specialization, kernel
from atlas.kernel.stepsize import StepSizes
from atlas.kernel.tableaux import METHODS
from atlas.plotting.options import WIDTHS
from atlas.plotting.style import STYLE
from atlas.scene.model import Settings
from atlas.systems import SYSTEMS, arithmetic
from atlas.systems.base import System

SATELLITE, TOP = SYSTEMS["satellite"], SYSTEMS["fixed_point"]
DRAWN = 8192  # random points, of which --points takes the first, so that these do not depend on their number
WIDTH = 118  # of the lines of pages, characters
TOP_RANDOM = ("x0", "y0", "z0", "N", "l1", "l2", "l3", "theta_dot0", "n", "m")
SLOWER = ("n", "m", "theta_dot0", "k1", "k2", "k3", "h1", "h3")
# (state, constants, duration, tolerance) -> final states; arrays of shape (rows, points)
Engine = Callable[[np.ndarray, np.ndarray, float, float], np.ndarray]


def satellites(count: int, seed: int = 0) -> dict[str, np.ndarray]:
    """Random satellites with every term of the paper present."""
    rng = np.random.default_rng(seed)
    absent = ("damping", "drag1", "drag2", "drag3")  # torques that the paper does not have
    names = [name for name in SATELLITE.parameters if name not in absent]
    points = {name: rng.normal(size=count) * 0.3 for name in names} | dict.fromkeys(absent, np.zeros(count))
    points |= {
        "A": rng.uniform(1, 1.4, count),
        "B": rng.uniform(1, 1.4, count),
        "C": rng.uniform(0.6, 1.9, count),
    }
    return points | {"Omega": np.ones(count), "theta0": rng.uniform(0.2, 2.9, count)}


def slender(count: int, seed: int = 0) -> dict[str, np.ndarray]:
    """Random satellites with C down to 0.01, which spin fast about the third axis from time to time."""
    points = satellites(count, seed)
    C = 10.0 ** np.random.default_rng(seed + 1).uniform(-2, -1, count)
    return points | {"A": np.ones(count), "B": 1 + 0.5 * C, "C": C}


def tops(count: int, seed: int = 0) -> dict[str, np.ndarray]:
    """Random bodies about a fixed point with weight, field and rotor."""
    rng = np.random.default_rng(seed + 2)
    points = {name: np.full(count, p.default) for name, p in TOP.parameters.items()}
    points |= {name: rng.normal(size=count) * 0.3 for name in TOP_RANDOM}
    points |= {name: rng.uniform(1, 1.4, count) for name in ("A", "B")}
    return points | {
        "C": rng.uniform(0.6, 1.9, count), "Mg": np.ones(count), "theta0": rng.uniform(0.2, 2.9, count),
    }  # fmt: skip


def slow_satellites(count: int, seed: int = 0) -> dict[str, np.ndarray]:
    """`satellites` with rates, rotors and fields of 0.3 of the size, of which fewer are chaotic."""
    points = satellites(count, seed)
    return points | {name: 0.3 * points[name] for name in SLOWER}


def atlas_engine(study: Study, method: str, points: dict[str, np.ndarray], statistics: bool) -> Engine:
    """This package with its own step sizes; the engine must be called for the first of these points."""
    module, ensemble = (kernel(study.system, method, study.undamped), Ensemble.of(study.system, points))

    def run(state, constants, duration, tolerance):
        part = ensemble.subset(np.arange(state.shape[1]))
        settings = Settings(method=method, tolerance=tolerance).at(1e30)
        step_sizes = StepSizes.of(settings, part.frequency_bound, np.full(part.size, duration))
        if not statistics:
            step_sizes = replace(step_sizes, steps_per_sample=step_sizes.steps)
        return part.integrate(module, step_sizes, 1e-5, threads=Threads(1)).final_state

    return run


def right_hand_side(study: Study) -> Callable:
    """The equations of the kernels of this package: without damping and without factors that `scaled` makes 1."""
    space: dict = {}
    rhs = arithmetic.functions(study.equations)["rhs"]
    exec(simplify(rhs, study.undamped.zero, {}, study.equations.ONES), space)
    return space["rhs"]


@cache
def derivative_into(study: Study) -> Callable:
    """The right-hand side as a Numba function that writes its result into d, from arrays or pointers."""
    states, size = len(study.equations.STATE), len(study.equations.CONSTANTS)
    slope, state, constants = (
        ", ".join(f"{name}[{i}]" for i in range(count))
        for name, count in (("d", states), ("y", states), ("c", size))
    )
    space = {"rhs": njit(right_hand_side(study), fastmath=True, error_model="numpy")}
    exec(f"def into(d, y, c):\n    {slope} = rhs(({state}), ({constants}))", space)
    return njit(space["into"], fastmath=True, error_model="numpy")


@cache
def derivative(study: Study) -> Callable:
    """The right-hand side as a Numba function of (t, y, constants) that returns an array."""
    into, states = derivative_into(study), len(study.equations.STATE)

    @njit
    def derivative_of(t, y, c):
        d = np.empty(states)
        into(d, y, c)
        return d

    return derivative_of


def scipy_dop853(study: Study) -> Engine:
    derivative_of = derivative(study)

    def run(state, constants, duration, tolerance):
        ends = []
        for y, c in zip(state.T, np.ascontiguousarray(constants.T), strict=True):
            solved = solve_ivp(
                derivative_of,
                (0.0, duration),
                y,
                "DOP853",
                args=(c,),
                t_eval=(duration,),
                rtol=tolerance,
                atol=tolerance,
            )
            ends.append(solved.y[:, -1])
        return np.transpose(ends)

    return run


def scipy_odeint(study: Study) -> Engine:
    derivative_of = derivative(study)

    def run(state, constants, duration, tolerance):
        times = np.array([0.0, duration])
        ends = [
            odeint(
                derivative_of, y, times, args=(c,), tfirst=True, rtol=tolerance, atol=tolerance, mxstep=10**6
            )[-1]
            for y, c in zip(state.T, np.ascontiguousarray(constants.T), strict=True)
        ]
        return np.transpose(ends)

    return run


def numbalsoda_dop853(study: Study) -> Engine:
    from numbalsoda import dop853, lsoda_sig

    into = derivative_into(study)

    @cfunc(lsoda_sig)
    def derivative_of(t, y, d, c):
        into(d, y, c)

    address = derivative_of.address

    @njit
    def integrate_all(starts, constants, times, tolerance):
        ends = np.empty_like(starts)
        for i in range(len(starts)):
            states, _ = dop853(address, starts[i], times, constants[i], rtol=tolerance, atol=tolerance)
            ends[i] = states[-1]
        return ends

    def run(state, constants, duration, tolerance):
        starts, data = np.ascontiguousarray(state.T), np.ascontiguousarray(constants.T)
        return integrate_all(starts, data, np.array([0.0, duration]), tolerance).T

    return run


def cyrk_dop853(study: Study) -> Engine:
    from CyRK import nb_diffeq_addr, nbsolve2_ivp

    into = derivative_into(study)

    def derivative_of(d, t, y, c):
        into(d, y, c)

    address = nb_diffeq_addr(derivative_of)

    @njit
    def integrate_all(starts, constants, duration, tolerance):
        ends = np.empty_like(starts)
        for i in range(len(starts)):
            solution = nbsolve2_ivp(
                address,
                (0.0, duration),
                starts[i],
                "DOP853",
                args=constants[i],
                rtol=tolerance,
                atol=tolerance,
            )
            ends[i] = solution.y[:, -1]
            solution.free()
        return ends

    def run(state, constants, duration, tolerance):
        starts, data = np.ascontiguousarray(state.T), np.ascontiguousarray(constants.T)
        return integrate_all(starts, data, duration, tolerance).T

    return run


def heyoka_batch(study: Study) -> Engine:
    """Taylor's method in batches, with heyoka's fast arithmetic; one integrator for each tolerance.

    Batches have the width that heyoka recommends or twice this width, whichever is faster at the first points.
    """
    import heyoka as hy

    variables = hy.make_vars(*study.equations.STATE)
    parameters = [hy.par[i] for i in range(len(study.equations.CONSTANTS))]
    system = list(zip(variables, right_hand_side(study)(variables, parameters), strict=True))

    @cache
    def batch(width, tolerance):
        start = np.zeros((len(variables), width))
        return hy.taylor_adaptive_batch(system, start, tol=tolerance, fast_math=True)

    def integrate(width, state, constants, duration, tolerance):
        taylor, final = batch(width, tolerance), np.empty_like(state)
        for first in range(0, state.shape[1], width):
            part = slice(first, first + width)
            lanes = slice(0, final[:, part].shape[1])
            taylor.set_time(0.0)
            taylor.state[:, lanes], taylor.pars[:, lanes] = (
                state[:, part],
                constants[: len(taylor.pars), part],
            )
            taylor.propagate_until(duration)
            final[:, part] = taylor.state[:, lanes]
        return final

    fastest = []

    def run(state, constants, duration, tolerance):
        if not fastest:
            times = {}
            for width in (hy.recommended_simd_size(), 2 * hy.recommended_simd_size()):
                some = state[:, :64], constants[:, :64], duration, 1e-10
                integrate(width, *some)
                began = process_time()
                integrate(width, *some)
                times[process_time() - began] = width
            fastest.append(times[min(times)])
        return integrate(fastest[0], state, constants, duration, tolerance)

    return run


def diffrax_vmap(study: Study) -> Engine:
    import jax

    jax.config.update("jax_enable_x64", True)
    import diffrax
    import jax.numpy as jnp

    rhs = right_hand_side(study)
    term = diffrax.ODETerm(lambda t, y, c: jnp.stack(rhs(y, c)))

    def integrate(y, c, duration, tolerance):
        solved = diffrax.diffeqsolve(
            term, diffrax.Dopri8(), 0.0, duration, None, y, c, max_steps=None,
            stepsize_controller=diffrax.PIDController(rtol=tolerance, atol=tolerance),
            saveat=diffrax.SaveAt(t1=True), adjoint=diffrax.ForwardMode(),
        )  # fmt: skip
        return solved.ys[-1]

    integrate_all = jax.jit(jax.vmap(integrate, in_axes=(0, 0, None, None)))

    def run(state, constants, duration, tolerance):
        return np.asarray(integrate_all(state.T, constants.T, duration, tolerance)).T

    return run


@dataclass(frozen=True)
class Peer:
    """An integrator: how to make it, its tolerances and its part of the points."""

    make: Callable[[], Engine]
    tolerances: list[float]
    share: int  # number of all points over the number that this integrator runs


@dataclass(frozen=True)
class Study:
    """Points, the length of their runs, and the errors at which times are compared."""

    words: str  # name of the points in texts
    system: System
    points: Callable[[int], dict[str, np.ndarray]]
    duration: float
    targets: tuple[float, ...]
    peers: tuple[str, ...]  # parts of the names of the integrators
    share: int = 1  # number of points of the first study over the number of points here
    compared: int = 64  # largest number of points whose errors are measured
    copies: int = 1  # of each point for this package, so that few points fill its lanes
    regular: bool = False  # whether points that amplify a change by more than 2 T are left out

    @property
    def equations(self) -> ModuleType:
        return self.system.equations

    @property
    def undamped(self) -> Specialization:
        """Specialization without damping, which all integrators leave out."""
        return Specialization.of(self.system, {"damping"}, frozenset())


FASTEST = ("heyoka", "numbalsoda", "CyRK")
STUDIES = {
    "random": Study("satellites", SATELLITE, satellites, 50.0, (1e-6, 1e-8, 1e-10), ("",)),
    "tops": Study("tops", TOP, tops, 50.0, (1e-6, 1e-8), FASTEST, 2, regular=True),
    "long": Study("satellites", SATELLITE, slow_satellites, 1000.0, (1e-6, 1e-8), FASTEST, 16, 32, 8, True),
    "long_tops": Study("tops", TOP, tops, 1000.0, (1e-6, 1e-8), FASTEST, 16, 32, 8, True),
    "slender": Study("slender satellites", SATELLITE, slender, 5.0, (1e-8, 1e-10), ("heyoka",)),
}  # fmt: skip


def regular_points(study: Study, count: int) -> dict[str, np.ndarray]:
    """The first points of a study; if `regular`, of those that amplify a change of 1e-9 by less than 2 T."""
    points = study.points(DRAWN)
    if study.regular:
        ensemble = Ensemble.of(study.system, points)
        settings = Settings(method="rk8", tolerance=1e-8).at(1e30)
        sizes = StepSizes.of(settings, ensemble.frequency_bound, np.full(ensemble.size, study.duration))
        module = kernel(study.system, "rk8", study.undamped)
        change = 1e-9 * np.random.default_rng(0).normal(size=ensemble.state.shape) / 3
        ends = [
            each.final_states(module, sizes.steps, sizes.step_size)
            for each in (ensemble, replace(ensemble, state=ensemble.state + change))
        ]
        kept = np.abs(ends[1] - ends[0]).max(0) < 2 * study.duration * 1e-9
        points = {name: values[kept] for name, values in points.items()}
    return {name: values[:count] for name, values in points.items()}


@dataclass
class Level:
    """Error and times of one integrator at one tolerance."""

    error: float  # median over the compared points
    microseconds: list[float]  # per point, of every round; the first one compiles

    @property
    def time(self) -> float:
        return min(self.microseconds[1:])


Results = dict[str, list[Level]]


def all_peers(study: Study, points: dict[str, np.ndarray]) -> dict[str, Peer]:
    """This package and the others, by name."""
    decades = [10.0**-k for k in range(5, 14)]
    # In long runs the finer tolerances of rk4 take minutes, and are left out.
    own = {
        method: [10.0**-k for k in range(6 if method == "rk4" and study.duration > 100 else 10)]
        for method in METHODS
    }
    scipy_tolerances = [1e-8, 1e-10, 1e-12, 1e-13]
    copied = {name: np.tile(values, study.copies) for name, values in points.items()}
    atlas_peers = {
        f"atlas {method}" + (" with statistics" if statistics else ""): Peer(
            partial(atlas_engine, study, method, copied, statistics), own[method], 1
        )
        for method in METHODS
        for statistics in (False, True)
    }
    return atlas_peers | {
        "heyoka batch": Peer(partial(heyoka_batch, study), [1e-4, *decades], 1),
        "numbalsoda dop853": Peer(partial(numbalsoda_dop853, study), decades, 4),
        "CyRK DOP853": Peer(partial(cyrk_dop853, study), decades, 8),
        "diffrax vmap Dopri8": Peer(partial(diffrax_vmap, study), decades[::2], 8),
        "SciPy DOP853": Peer(partial(scipy_dop853, study), scipy_tolerances, 32),
        "SciPy odeint": Peer(partial(scipy_odeint, study), [*scipy_tolerances, 3e-14], 32),
    }


def installed(peers: dict[str, Peer], parts: Sequence[str], required: bool) -> dict[str, Engine]:
    """This package, and the installed integrators whose names contain one of `parts`.

    required: whether a missing integrator ends this script.
    """
    engines: dict[str, Engine] = {}
    for name, peer in peers.items():
        if not any(part in name for part in ["atlas", *parts]):
            continue
        try:
            engines[name] = peer.make()
        except ImportError as missing:
            text = f'{name}: no module {missing.name}; in a clone: pip install -e ".[peers]"'
            if required:
                sys.exit(text)
            print(f"skipped {text}")
    return engines


def measure_all(
    study: Study,
    engines: dict[str, Engine],
    peers: dict[str, Peer],
    points: dict[str, np.ndarray],
    rounds: int,
) -> Results:
    """Run every integrator at every tolerance, in turn, in `rounds` rounds after one that compiles."""
    system, duration = study.system, study.duration
    state = np.ascontiguousarray(system.initial_state(points))
    constants = np.ascontiguousarray(system.constants(points))
    exact, tight = scipy_dop853(study), []
    first = [np.ascontiguousarray(each[:, : study.compared]) for each in (state, constants)]
    scaled = [np.array(each) for each in system.equations.scaled(*first, 1.0)]
    for tolerance in (3e-14, 1e-13):
        ends = exact(*scaled, duration, tolerance)
        tight.append(np.array(system.equations.unscaled(ends, scaled[1], 1.0)))
    truth, floor = tight[0], np.abs(tight[0] - tight[1]).max(0)
    print(f"reference to T = {duration:g}: median error {np.median(floor):.1e}", flush=True)
    results: Results = {name: [Level(np.nan, []) for _ in peers[name].tolerances] for name in engines}
    for _ in range(rounds + 1):
        for name, run in engines.items():
            size = max(state.shape[1] // peers[name].share, 1)
            foreign = not name.startswith("atlas")
            copies = 1 if foreign else study.copies
            start, data = (np.tile(each[:, :size], copies) for each in (state, constants))
            if foreign:
                start, data = map(np.array, system.equations.scaled(start, data, 1.0))
            start, data = np.ascontiguousarray(start), np.ascontiguousarray(data)
            for tolerance, level in zip(peers[name].tolerances, results[name], strict=True):
                began = process_time()
                final = run(start, data, duration, tolerance)
                level.microseconds.append(1e6 * (process_time() - began) / (size * copies))
                if foreign:
                    final = np.array(system.equations.unscaled(final, data, 1.0))
                both = min(size, study.compared)
                error = np.abs(final[:, :both] - truth[:, :both]).max(0)
                level.error = float(np.median(np.maximum(error, floor[:both])))
    return results


def draw(results: Results, path: Path, duration: float) -> None:
    """Draw median error against time per point, one line for each integrator."""
    # One colour for each method of this package, greys for the others; markers differ, too.
    colours = {"atlas rk4": "#1b6ca8", "atlas rk8": "#d55e00"}
    others = [name for name in results if not name.startswith("atlas")]
    greys = dict(zip(others, np.linspace(0.0, 0.6, len(others)), strict=True))
    with rc_context(STYLE):
        figure = Figure(figsize=(WIDTHS["page"] / 25.4, 3.4), layout="constrained")
        ax = figure.add_subplot()
        for (name, levels), mark in zip(results.items(), "osv^Dph*X<", strict=False):
            ours = name not in greys
            ax.plot(
                [level.time for level in levels], [level.error for level in levels],
                marker=mark, markersize=4, label=name,
                color=colours[name.removesuffix(" with statistics")] if ours else str(greys[name]),
                linestyle="--" if name.endswith(" with statistics") else "-" if ours else ":",
                linewidth=1.6 if ours else 1.0, markerfacecolor=None if ours else "white",
            )  # fmt: skip
        ax.set(xscale="log", yscale="log", ylabel="median error of the final state")
        ax.set_xlabel(f"processor time per point to T = {duration:g} (µs)")
        figure.legend(loc="outside right upper", frameon=False)
        figure.savefig(path, dpi=300)


def time_at(levels: list[Level], target: float) -> float:
    """Least time at an error, interpolated between neighbouring levels in logarithms; nan outside all of them."""
    logs = np.log([(level.error, level.time) for level in levels])
    times = []
    for (e1, t1), (e2, t2) in pairwise(logs):
        if min(e1, e2) <= np.log(target) <= max(e1, e2) and e1 != e2:
            times.append(np.exp(t1 + (t2 - t1) * (np.log(target) - e1) / (e2 - e1)))
    return min(times, default=np.nan)


def table(results: Results, targets: Sequence[float]) -> tuple[str, str]:
    """Markdown table of the time of every integrator at the target errors, and a sentence about the error 1e-8."""
    times = {name: np.array([time_at(levels, e) for e in targets]) for name, levels in results.items()}
    rows = {name: [f"{t:.1f}" if t > 0 else "" for t in row] for name, row in times.items()}
    others = [name for name in times if not name.startswith("atlas")]
    words = ""
    if others:
        best_other, at = np.fmin.reduce([times[name] for name in others]), targets.index(1e-8)
        for words in ("", " with statistics"):
            here = np.fmin.reduce([times[f"atlas {method}{words}"] for method in METHODS])
            rows[f"best other / best here{words}"] = [f"{r:.2f}" for r in best_other / here]
        first = min(others, key=lambda name: np.nan_to_num(times[name][at], nan=np.inf))
        words = (
            f"{rows['atlas rk8'][at]} µs a point with `rk8` ({rows['atlas rk8 with statistics'][at]} µs with all"
            f" statistics) where the fastest other, {first}, takes {rows[first][at]} µs"
        )
    heading = ["µs per point, at a median error of", *(f"{target:.0e}" for target in targets)]
    lines = [heading, ["---"] * len(heading), *([name, *row] for name, row in rows.items())]
    return "\n".join(f"| {' | '.join(line)} |" for line in lines), words


def machine(rounds: int) -> str:
    """Rounds, processor, load and versions of the measurement, in words."""
    packages = ("numba", "scipy", "heyoka", "numbalsoda", "CyRK", "diffrax", "jax")
    versions = [f"Python {platform.python_version()}"]
    for package in packages:
        with suppress(importlib.metadata.PackageNotFoundError):
            versions.append(f"{package} {importlib.metadata.version(package)}")
    load = ", ".join(f"{value:.1f}" for value in os.getloadavg())
    return (
        f"best of {rounds} rounds on one `{machine_code.cpu()}` processor of {os.cpu_count()}, load average {load};"
        f" {', '.join(versions)}"
    )


def fill(path: Path, mark: str, text: str) -> None:
    """Write a text between <!-- mark --> and <!-- end --> of a page."""
    start = f"<!-- {mark} -->\n"
    page, count = re.subn(
        f"({start}).*?(<!-- end -->)",
        lambda match: f"{match[1]}{text}\n{match[2]}",
        path.read_text(),
        flags=re.S,
    )
    assert count == 1, f"{path}: {count} places for {mark}"
    path.write_text(page)


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--points", type=int, default=2048, help="of the fastest; others run a part of them")
    parser.add_argument("--duration", type=float, help="of the runs, in place of 5, 50 and 1000")
    parser.add_argument(
        "--only", nargs="+", help="integrators whose names contain one of these, beside this package"
    )
    parser.add_argument("--docs", metavar="FOLDER", type=Path, help="write README.md, docs/ of this folder")
    parser.add_argument("--seed", type=int, default=0, help="of the random bodies")
    options = parser.parse_args()
    # One processor for all, also for libraries with threads of their own.
    if hasattr(os, "sched_setaffinity"):
        os.sched_setaffinity(0, {max(os.sched_getaffinity(0))})
    ratios: dict[str, dict[str, str]] = {}
    for bodies, study in STUDIES.items():
        bodies_of_seed = partial(study.points, seed=options.seed)
        study = replace(study, points=bodies_of_seed, duration=options.duration or study.duration)
        points = regular_points(study, max(options.points // study.share, 1))
        peers = all_peers(study, points)
        required = options.docs is not None and options.only is None
        engines = installed(peers, options.only or study.peers, required)
        results = measure_all(study, engines, peers, points, options.rounds)
        text, words = table(results, study.targets)
        caption = f"Random bodies to T = {study.duration:g}, {machine(options.rounds)}."
        count = f"{points['A'].size}{f' x {study.copies}' if study.copies > 1 else ''}"
        print(f"{text}\n{count} {study.words}. {caption}", flush=True)
        base = results["atlas rk8"]
        for target in study.targets:
            column = f"{count} {study.words}, T = {study.duration:g}, {target:.0e}"
            ratios[column] = {
                name: f"{time_at(levels, target) / time_at(base, target):.2f}".replace("nan", "")
                for name, levels in results.items()
            }
        if options.docs and bodies == "random":
            docs = options.docs / "docs"
            fill(docs / "accuracy.md", "peers_random", f"{text}\n\n*{textwrap.fill(caption, WIDTH)}*")
            draw(results, docs / "peers.png", study.duration)
            fill(docs / "paper" / "paper.md", "peers_table", text)
            words = f"For random satellites to T = {study.duration:g}, with a median error of 1e-8, this is {words}."
            fill(options.docs / "README.md", "peers_words", textwrap.fill(words, WIDTH))
    names = {name: None for column in ratios.values() for name in column}
    rows = [
        ["time over that of atlas rk8", *names],
        *([column, *(own.get(name, "") for name in names)] for column, own in ratios.items()),
    ]
    rows.insert(1, ["---"] * len(rows[0]))
    text = "\n".join(f"| {' | '.join(row)} |" for row in rows)
    caption = f"Time per point at equal median error of the final state, {machine(options.rounds)}."
    print(text)
    if options.docs:
        fill(
            options.docs / "docs" / "accuracy.md", "peers_all", f"{text}\n\n*{textwrap.fill(caption, WIDTH)}*"
        )


if __name__ == "__main__":
    main()
