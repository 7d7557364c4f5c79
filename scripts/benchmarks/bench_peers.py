"""Time per point to T = 50 at equal error, beside other integrators, as ratios measured in one run.

    python scripts/benchmarks/bench_peers.py [--rounds 3] [--duration 50] [--bodies slender]
                                             [--only heyoka ...] [--csv FILE] [--figure FILE]

The points are random satellites with Omega = 1, magnet and rotor; or slender ones, whose spin is fast for short
times, where one step size for the whole run costs most in comparison with integrators that adapt it. Every
integrator runs the same points on one processor, in the best way that its documentation gives, at a series of
tolerances; all integrators take turns, and processor time is measured. The others return the final state alone;
this package is measured for the final state alone and with all means, standard deviations, extremes and first
integrals. All get the equations in the units that make a factor 1. Errors are medians over the first points against
SciPy's DOP853 at 3e-14; times are interpolated between tolerances to the errors asked for. Integrators that are not
installed are skipped:

    pip install "precession-atlas[peers]"      (in a clone: pip install -e ".[peers]")
"""

from __future__ import annotations

import argparse
import importlib.metadata
import os
import platform
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from itertools import pairwise
from pathlib import Path
from statistics import median
from time import process_time

import numpy as np
from matplotlib import rc_context
from matplotlib.figure import Figure
from numba import cfunc, njit
from scipy.integrate import odeint, solve_ivp

from atlas.engine import assemble, jit
from atlas.engine.ensemble import Ensemble
from atlas.engine.simplify import simplify
from atlas.engine.specialization import kernel
from atlas.engine.stepsize import StepSizes
from atlas.engine.tableaux import METHODS
from atlas.plotting.style import STYLE, WIDTHS
from atlas.scene.model import Settings
from atlas.systems import SYSTEMS
from atlas.validation.reference import SAFETY, reference

SYSTEM = SYSTEMS["satellite"]
EQUATIONS = SYSTEM.equations
STATES, CONSTANTS = len(EQUATIONS.STATE), len(EQUATIONS.CONSTANTS)
TARGETS = (1e-6, 1e-8, 1e-10)
COMPARED = 64  # points whose errors are measured; slow integrators run no others
POINTS = 8192
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
    module, ensemble = kernel(SYSTEM, method), Ensemble.of(SYSTEM, points)

    def run(state, constants, duration, tolerance):
        part = ensemble.subset(np.arange(state.shape[1]))
        settings = Settings(method=method, tolerance=tolerance, rate_tolerance=1e30)
        step_sizes = StepSizes.of(settings, part.frequency_bound, np.full(part.size, duration))
        if not statistics:
            step_sizes = replace(step_sizes, steps_per_sample=step_sizes.steps)
        return part.integrate(module, step_sizes, 1e-5, threads=1).final_state

    return run


def right_hand_side() -> Callable:
    """The equations without the factors that `scaled` makes 1, as the kernels here get them."""
    space: dict = {}
    exec(simplify(assemble.functions(EQUATIONS)["rhs"], (), {}, EQUATIONS.ONES), space)
    return space["rhs"]


def derivative_into() -> Callable:
    """The right-hand side as a Numba function that writes its result into d, from arrays or pointers."""
    rhs = njit(right_hand_side())

    @njit
    def into(d, y, c):
        state = (y[0], y[1], y[2], y[3], y[4], y[5], y[6], y[7], y[8])
        constants = (
            c[0], c[1], c[2], c[3], c[4], c[5], c[6], c[7], c[8], c[9], c[10], c[11], c[12], c[13], c[14],
            c[15], c[16], c[17], c[18], c[19], c[20], c[21], c[22], c[23], c[24], c[25], c[26], c[27], c[28], c[29],
        )  # fmt: skip
        d[0], d[1], d[2], d[3], d[4], d[5], d[6], d[7], d[8] = rhs(state, constants)

    return into


def derivative() -> Callable:
    """The right-hand side as a Numba function of (t, y, constants) that returns an array."""
    into = derivative_into()

    @njit
    def derivative_of(t, y, c):
        d = np.empty(9)
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
            built[tolerance] = hy.taylor_adaptive_batch(
                system, np.zeros((STATES, width)), pars=np.zeros((CONSTANTS, width)), tol=tolerance
            )
        taylor, final = built[tolerance], np.empty_like(state)
        for first in range(0, state.shape[1], width):
            part = slice(first, first + width)
            taylor.set_time(0.0)
            taylor.state[:], taylor.pars[:] = state[:, part], constants[:, part]
            taylor.propagate_until(duration)
            final[:, part] = taylor.state
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
    points: int


@dataclass
class Level:
    """What one integrator gives at one tolerance."""

    error: float  # median over the points compared
    microseconds: list[float]  # per point, of every round; the first one compiles

    @property
    def time(self) -> float:
        return median(self.microseconds[1:])


Results = dict[tuple[str, float], Level]


def all_peers(points: dict[str, np.ndarray]) -> dict[str, Peer]:
    """This package and the others, by name."""
    decades = [10.0**-k for k in range(5, 14)]
    own = [10.0**-k for k in range(11)]
    scipy_tolerances = [1e-6, 1e-8, 1e-10, 1e-12, 1e-13]
    atlas_peers = {
        f"atlas {method}" + (" with statistics" if statistics else ""): Peer(
            partial(atlas_engine, method, points, statistics), own, POINTS
        )
        for method in METHODS
        for statistics in (False, True)
    }
    return atlas_peers | {
        "heyoka batch": Peer(heyoka_batch, [1e-6, 1e-8, 1e-9, 1e-10, 1e-11, 1e-12, 1e-13], 2048),
        "numbalsoda dop853": Peer(numbalsoda_dop853, decades, 512),
        "CyRK DOP853": Peer(cyrk_dop853, decades, 256),
        "diffrax vmap Dopri8": Peer(diffrax_vmap, decades[::2], 256),
        "SciPy DOP853": Peer(scipy_dop853, scipy_tolerances, COMPARED),
        "SciPy odeint": Peer(scipy_odeint, scipy_tolerances, COMPARED),
    }


def installed(peers: dict[str, Peer], only: list[str] | None) -> dict[str, Engine]:
    """The integrators that are installed and asked for; this package always."""
    engines: dict[str, Engine] = {}
    for name, peer in peers.items():
        if only is not None and not any(part in name for part in ["atlas", *only]):
            continue
        try:
            engines[name] = peer.make()
        except ImportError as missing:
            print(f'skipped: {name} (no module {missing.name}; pip install "precession-atlas[peers]")')
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
    truth = reference(SYSTEM, compared, np.full(COMPARED, duration), Settings())
    floor = truth.state_error / SAFETY  # medians need no margin
    print(f"reference: median error {np.median(floor):.1e}; median of {rounds} rounds")
    results: Results = {}
    for _ in range(rounds + 1):
        for name, run in engines.items():
            size, foreign = peers[name].points, not name.startswith("atlas")
            start, data = state[:, :size], constants[:, :size]
            if foreign:
                start, data = map(np.array, EQUATIONS.scaled(start, data, 1.0))
            start, data = np.ascontiguousarray(start), np.ascontiguousarray(data)
            for tolerance in peers[name].tolerances:
                began = process_time()
                final = run(start, data, duration, tolerance)
                seconds = process_time() - began
                if foreign:
                    final = np.array(EQUATIONS.unscaled(final, data[:, : final.shape[1]], 1.0))
                error = np.maximum(np.abs(final[:, :COMPARED] - truth.state).max(0), floor)
                level = results.setdefault((name, tolerance), Level(float(np.median(error)), []))
                level.microseconds.append(1e6 * seconds / size)
    return results


def write_csv(results: Results, path: Path) -> None:
    """Write every integrator at every tolerance as a table."""
    rows = [
        f"{name},{tolerance!r},{level.error!r},{level.time!r}" for (name, tolerance), level in results.items()
    ]
    path.write_text("\n".join(["engine,tolerance,median_error,microseconds_per_point", *rows]) + "\n")


def draw(results: Results, path: Path, duration: float) -> None:
    """Draw median error against time per point, one line for each integrator."""
    names = list(dict.fromkeys(name for name, _ in results))
    # One colour for each method of this package, greys for the others; markers differ, too.
    colours = {"atlas rk4": "#1b6ca8", "atlas rk8": "#d55e00"}
    others = [name for name in names if not name.startswith("atlas")]
    greys = dict(zip(others, np.linspace(0.0, 0.6, len(others)), strict=True))
    with rc_context(STYLE):
        figure = Figure(figsize=(WIDTHS["page"] / 25.4, 3.4), layout="constrained")
        ax = figure.add_subplot()
        for name, mark in zip(names, "osv^Dph*X<", strict=False):
            ours, levels = name not in greys, levels_of(results, name)
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


def levels_of(results: Results, name: str) -> list[Level]:
    """The levels of one integrator, in the order of its tolerances."""
    return [level for (owner, _), level in results.items() if owner == name]


def time_at(levels: list[Level], target: float) -> float:
    """Least time at an error, between neighbouring levels on the log-log line; nan outside it."""
    logs = np.log([(level.error, level.time) for level in levels])
    times = []
    for (e1, t1), (e2, t2) in pairwise(logs):
        if min(e1, e2) <= np.log(target) <= max(e1, e2) and e1 != e2:
            times.append(np.exp(t1 + (t2 - t1) * (np.log(target) - e1) / (e2 - e1)))
    return min(times, default=np.nan)


def version(package: str) -> str:
    """Version of an installed package, "" if there is none."""
    try:
        return importlib.metadata.version(package)
    except importlib.metadata.PackageNotFoundError:
        return ""


def report(results: Results, duration: float) -> None:
    """Print time per point at the errors asked for, and the best of this package beside the best other."""
    packages = ("scipy", "heyoka", "numbalsoda", "CyRK", "diffrax", "jax")
    versions = [f"{package} {version(package)}" for package in packages if version(package)]
    print(f"processor {jit.cpu()}, one used; Python {platform.python_version()}, {', '.join(versions)}")
    print(f"us of processor time per point to T = {duration:g} at a median error of")
    print(f"{'':26}" + "".join(f"{target:>10.0e}" for target in TARGETS))
    names = dict.fromkeys(name for name, _ in results)
    times = {name: [time_at(levels_of(results, name), target) for target in TARGETS] for name in names}
    for name, row in times.items():
        print(f"{name:26}" + "".join(f"{t:10.1f}" if np.isfinite(t) else f"{'-':>10}" for t in row))
    here = np.fmin.reduce([row for name, row in times.items() if name.startswith("atlas")])
    print(f"{'best here':26}" + "".join(f"{t:10.1f}" for t in here))
    others = [row for name, row in times.items() if not name.startswith("atlas")]
    if not others:
        print("none of the other integrators asked for is installed")
        return
    peers = np.fmin.reduce(others)
    print(f"{'best peer':26}" + "".join(f"{t:10.1f}" for t in peers))
    print(f"{'peer / here':26}" + "".join(f"{r:10.2f}" for r in peers / here))


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--duration", type=float, default=50.0)
    parser.add_argument("--bodies", choices=("random", "slender"), default="random")
    parser.add_argument(
        "--only", nargs="*", help="integrators whose names contain one of these, beside this package"
    )
    parser.add_argument("--csv", metavar="FILE", type=Path, help="write every tolerance as a table")
    parser.add_argument(
        "--figure", metavar="FILE", type=Path, help="draw median error against time per point"
    )
    options = parser.parse_args()
    # One processor for all, also for libraries with threads of their own.
    if hasattr(os, "sched_setaffinity"):
        os.sched_setaffinity(0, {max(os.sched_getaffinity(0))})
    points = {"random": satellites, "slender": slender}[options.bodies](POINTS)
    peers = all_peers(points)
    engines = installed(peers, options.only)
    results = measure_all(engines, peers, points, options.duration, options.rounds)
    if options.csv:
        write_csv(results, options.csv)
    if options.figure:
        draw(results, options.figure, options.duration)
    report(results, options.duration)


if __name__ == "__main__":
    main()
