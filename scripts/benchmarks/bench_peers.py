"""Time per point at equal error, beside other integrators, as ratios measured in one run.

    python scripts/benchmarks/bench_peers.py [--rounds 3] [--only heyoka ...] [--docs .]

The points are random satellites with Omega = 1, magnet and rotor, to T = 50, and slender ones to T = 5, whose spin is
fast for short times, where one step size for the whole run costs most in comparison with integrators that adapt it.
Every integrator runs the same points on one processor, in the best way that its documentation gives, at a series of
tolerances. All take turns; times are processor time, the best of all rounds, because disturbances only ever slow an
integrator down. The others return the final state alone; this package is measured for the final state alone and with
all means, standard deviations, extremes and first integrals. All get the equations without damping, in the units that
make a factor 1. Errors are medians over the first points against SciPy's DOP853 at 3e-14; times are interpolated between
tolerances to the errors asked for. --docs writes the tables, the figure and the sentence of the README below a folder.
Integrators that are not installed are skipped:

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

import numpy as np
from matplotlib import rc_context
from matplotlib.figure import Figure
from numba import cfunc, njit
from scipy.integrate import odeint, solve_ivp

from atlas.kernel import machine_code
from atlas.kernel.differentiate import simplify
from atlas.kernel.ensemble import Ensemble
from atlas.kernel.specialization import Specialization, kernel
from atlas.kernel.stepsize import StepSizes
from atlas.kernel.tableaux import METHODS
from atlas.plotting.options import WIDTHS
from atlas.plotting.style import STYLE
from atlas.scene.model import Settings
from atlas.systems import SYSTEMS, arithmetic
from atlas.validation.reference import SAFETY, reference

SYSTEM = SYSTEMS["satellite"]
EQUATIONS = SYSTEM.equations
STATES, CONSTANTS = len(EQUATIONS.STATE), len(EQUATIONS.CONSTANTS)
# Terms without damping, which all integrators leave out.
UNDAMPED = Specialization.of(SYSTEM, {"damping"}, frozenset())
DRAWN = 8192  # points, of which --points takes the first: the same ones for any number
WIDTH = 118  # of the lines of pages
COMPARED = 64  # points at most whose errors are measured
# (state, constants, duration, tolerance) -> final states; arrays of shape (rows, points)
Engine = Callable[[np.ndarray, np.ndarray, float, float], np.ndarray]


def satellites(count: int) -> dict[str, np.ndarray]:
    """Random satellites with every term of the paper present."""
    rng = np.random.default_rng(0)
    names = [name for name in SYSTEM.parameters if name != "damping"]
    points = {name: rng.normal(size=count) * 0.3 for name in names} | {"damping": np.zeros(count)}
    points |= {
        "A": rng.uniform(1, 1.4, count),
        "B": rng.uniform(1, 1.4, count),
        "C": rng.uniform(0.6, 1.9, count),
    }
    return points | {"Omega": np.ones(count), "theta0": rng.uniform(0.2, 2.9, count)}


def slender(count: int) -> dict[str, np.ndarray]:
    """The same with C down to 0.01: a little energy on the third axis makes it spin fast for a while."""
    points = satellites(count)
    C = 10.0 ** np.random.default_rng(1).uniform(-2, -1, count)
    return points | {"A": np.ones(count), "B": 1 + 0.5 * C, "C": C}


def atlas_engine(method: str, points: dict[str, np.ndarray], statistics: bool) -> Engine:
    """This package with its own step sizes; the points must be those of the calls."""
    module, ensemble = kernel(SYSTEM, method, UNDAMPED), Ensemble.of(SYSTEM, points)

    def run(state, constants, duration, tolerance):
        part = ensemble.subset(np.arange(state.shape[1]))
        settings = Settings(method=method, tolerance=tolerance, rate_tolerance=1e30)
        step_sizes = StepSizes.of(settings, part.frequency_bound, np.full(part.size, duration))
        if not statistics:
            step_sizes = replace(step_sizes, steps_per_sample=step_sizes.steps)
        return part.integrate(module, step_sizes, 1e-5, threads=1).final_state

    return run


def right_hand_side() -> Callable:
    """The equations as the kernels here get them: without damping and the factors that `scaled` makes 1."""
    space: dict = {}
    exec(simplify(arithmetic.functions(EQUATIONS)["rhs"], UNDAMPED.zero, {}, EQUATIONS.ONES), space)
    return space["rhs"]


@cache
def derivative_into() -> Callable:
    """The right-hand side as a Numba function that writes its result into d, from arrays or pointers."""
    slope, state, constants = (
        ", ".join(f"{name}[{i}]" for i in range(size))
        for name, size in (("d", STATES), ("y", STATES), ("c", CONSTANTS))
    )
    space = {"rhs": njit(right_hand_side())}
    exec(f"def into(d, y, c):\n    {slope} = rhs(({state}), ({constants}))", space)
    return njit(space["into"])


@cache
def derivative() -> Callable:
    """The right-hand side as a Numba function of (t, y, constants) that returns an array."""
    into = derivative_into()

    @njit
    def derivative_of(t, y, c):
        d = np.empty(STATES)
        into(d, y, c)
        return d

    return derivative_of


def scipy_dop853() -> Engine:
    derivative_of = derivative()

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


def scipy_odeint() -> Engine:
    derivative_of = derivative()

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


def numbalsoda_dop853() -> Engine:
    from numbalsoda import dop853, lsoda_sig

    into = derivative_into()

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


def cyrk_dop853() -> Engine:
    from CyRK import nb_diffeq_addr, nbsolve2_ivp

    into = derivative_into()

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


def heyoka_batch() -> Engine:
    """Taylor's method in batches as wide as the processor's registers; one integrator for each tolerance."""
    import heyoka as hy

    width = hy.recommended_simd_size()
    variables = hy.make_vars(*EQUATIONS.STATE)
    parameters = [hy.par[i] for i in range(CONSTANTS)]
    system = list(zip(variables, right_hand_side()(variables, parameters), strict=True))
    built = {}

    def run(state, constants, duration, tolerance):
        if tolerance not in built:
            built[tolerance] = hy.taylor_adaptive_batch(system, np.zeros((STATES, width)), tol=tolerance)
        taylor, final = built[tolerance], np.empty_like(state)
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

    return run


def diffrax_vmap() -> Engine:
    import jax

    jax.config.update("jax_enable_x64", True)
    import diffrax
    import jax.numpy as jnp

    rhs = right_hand_side()
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
    """An integrator, how to make it, and what it runs."""

    make: Callable[[], Engine]
    tolerances: list[float]
    share: int  # of the points: all of them over this


@dataclass(frozen=True)
class Study:
    """Points, the length of their runs, and the errors at which times are compared."""

    points: Callable[[int], dict[str, np.ndarray]]
    duration: float
    targets: tuple[float, ...]
    peers: tuple[str, ...]  # parts of the names of the integrators


STUDIES = {
    "random": Study(satellites, 50.0, (1e-6, 1e-8, 1e-10), ("",)),
    "slender": Study(slender, 5.0, (1e-8, 1e-10), ("heyoka",)),
}


@dataclass
class Level:
    """What one integrator gives at one tolerance."""

    error: float  # median over the points compared
    microseconds: list[float]  # per point, of every round; the first one compiles

    @property
    def time(self) -> float:
        return min(self.microseconds[1:])


Results = dict[str, list[Level]]


def all_peers(points: dict[str, np.ndarray]) -> dict[str, Peer]:
    """This package and the others, by name."""
    decades = [10.0**-k for k in range(5, 14)]
    own = [10.0**-k for k in range(10)]
    scipy_tolerances = [1e-8, 1e-10, 1e-12, 1e-13]
    atlas_peers = {
        f"atlas {method}" + (" with statistics" if statistics else ""): Peer(
            partial(atlas_engine, method, points, statistics), own, 1
        )
        for method in METHODS
        for statistics in (False, True)
    }
    return atlas_peers | {
        "heyoka batch": Peer(heyoka_batch, [1e-6, *decades[3:]], 1),
        "numbalsoda dop853": Peer(numbalsoda_dop853, decades, 4),
        "CyRK DOP853": Peer(cyrk_dop853, decades, 8),
        "diffrax vmap Dopri8": Peer(diffrax_vmap, decades[::2], 8),
        "SciPy DOP853": Peer(scipy_dop853, scipy_tolerances, 32),
        "SciPy odeint": Peer(scipy_odeint, [*scipy_tolerances, 3e-14], 32),
    }


def installed(peers: dict[str, Peer], parts: Sequence[str], required: bool) -> dict[str, Engine]:
    """The integrators that are installed and whose names contain one of some parts; this package always.

    required: whether one that is missing ends this script.
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
    engines: dict[str, Engine],
    peers: dict[str, Peer],
    points: dict[str, np.ndarray],
    duration: float,
    rounds: int,
) -> Results:
    """Run every integrator at every tolerance, in turn; one round more than asked for, which compiles."""
    state = np.ascontiguousarray(SYSTEM.initial_state(points))
    constants = np.ascontiguousarray(SYSTEM.constants(points))
    compared = {name: values[:COMPARED] for name, values in points.items()}
    truth = reference(SYSTEM, compared, np.full(compared["A"].size, duration), Settings())
    floor = truth.state_error / SAFETY  # medians need no margin
    print(f"reference to T = {duration:g}: median error {np.median(floor):.1e}", flush=True)
    results: Results = {name: [Level(np.nan, []) for _ in peers[name].tolerances] for name in engines}
    for _ in range(rounds + 1):
        for name, run in engines.items():
            size = max(state.shape[1] // peers[name].share, 1)
            start, data = state[:, :size], constants[:, :size]
            foreign = not name.startswith("atlas")
            if foreign:
                start, data = map(np.array, EQUATIONS.scaled(start, data, 1.0))
            start, data = np.ascontiguousarray(start), np.ascontiguousarray(data)
            for tolerance, level in zip(peers[name].tolerances, results[name], strict=True):
                began = process_time()
                final = run(start, data, duration, tolerance)
                level.microseconds.append(1e6 * (process_time() - began) / size)
                if foreign:
                    final = np.array(EQUATIONS.unscaled(final, data, 1.0))
                both = min(size, COMPARED)
                error = np.abs(final[:, :both] - truth.state[:, :both]).max(0)
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
    """Least time at an error, between neighbouring levels on the log-log line; nan outside it."""
    logs = np.log([(level.error, level.time) for level in levels])
    times = []
    for (e1, t1), (e2, t2) in pairwise(logs):
        if min(e1, e2) <= np.log(target) <= max(e1, e2) and e1 != e2:
            times.append(np.exp(t1 + (t2 - t1) * (np.log(target) - e1) / (e2 - e1)))
    return min(times, default=np.nan)


def table(results: Results, targets: Sequence[float]) -> tuple[str, str]:
    """Markdown table of the time of every integrator at the errors asked for; the same in words at the error 1e-8."""
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
    """What was measured with, in words."""
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
    parser.add_argument("--duration", type=float, help="default: that of the points, 50 and 5")
    parser.add_argument(
        "--only", nargs="+", help="integrators whose names contain one of these, beside this package"
    )
    parser.add_argument("--docs", metavar="FOLDER", type=Path, help="write README.md, docs/ of this folder")
    options = parser.parse_args()
    # One processor for all, also for libraries with threads of their own.
    if hasattr(os, "sched_setaffinity"):
        os.sched_setaffinity(0, {max(os.sched_getaffinity(0))})
    for bodies, study in STUDIES.items():
        points = {name: values[: options.points] for name, values in study.points(DRAWN).items()}
        duration = options.duration or study.duration
        peers = all_peers(points)
        required = options.docs is not None and options.only is None
        engines = installed(peers, options.only or study.peers, required)
        results = measure_all(engines, peers, points, duration, options.rounds)
        text, words = table(results, study.targets)
        caption = f"{bodies.capitalize()} bodies to T = {duration:g}, {machine(options.rounds)}."
        print(f"{text}\n{caption}", flush=True)
        if options.docs:
            docs = options.docs / "docs"
            fill(docs / "accuracy.md", f"peers_{bodies}", f"{text}\n\n*{textwrap.fill(caption, WIDTH)}*")
            if bodies == "random":
                draw(results, docs / "peers.png", duration)
                fill(docs / "paper" / "paper.md", "peers_table", text)
                words = f"For random satellites to T = {duration:g}, with a median error of 1e-8, this is {words}."
                fill(options.docs / "README.md", "peers_words", textwrap.fill(words, WIDTH))


if __name__ == "__main__":
    main()
