"""Time per point to T = 50 at equal error, beside other integrators, as ratios measured in one run.

    python scripts/bench_peers.py [--rounds 3] [--duration 50] [--bodies slender] [--only heyoka ...]
                                  [--csv FILE] [--figure FILE]

Random satellites with Omega = 1, magnet and rotor; or slender ones, whose spin comes in short fast bursts,
where one step for the whole run costs most beside engines that adapt it. Every engine runs the same points,
one processor, each in its own best documented way, at a ladder of tolerances; the rungs of all engines take
turns, and what is counted is processor time. The others return the final state alone; this package runs for
that alone, too, and with all its means, spreads, extremes and first integrals. All get the equations in the
units that make a factor 1. Errors are medians over the first points, against SciPy's DOP853 at 3e-14; times are
interpolated between rungs to the errors asked for. Engines that are not installed are skipped:

    pip install heyoka CyRK diffrax jax numbalsoda
"""

from __future__ import annotations

import argparse
import importlib.metadata
import os
import platform
from collections.abc import Callable
from itertools import pairwise
from pathlib import Path
from statistics import median
from time import process_time

import numpy as np
from matplotlib.figure import Figure
from numba import cfunc, njit
from scipy.integrate import odeint, solve_ivp

from atlas.engine import blocks, jit, measure, stepsize
from atlas.engine.simplify import simplify
from atlas.engine.tableaux import METHODS
from atlas.label.pipeline import kernel
from atlas.scene.model import Settings
from atlas.systems import SYSTEMS
from atlas.validation.reference import SAFETY, reference

SYSTEM = SYSTEMS["satellite"]
EQUATIONS = SYSTEM.equations
STATES, CONSTANTS = len(EQUATIONS.STATE), len(EQUATIONS.CONSTANTS)
TARGETS = (1e-6, 1e-8, 1e-10)
COMPARED = 64  # points whose errors are looked at; slow engines run no others
# (state, constants, duration, tolerance) -> final states; arrays of shape (rows, points)
Engine = Callable[[np.ndarray, np.ndarray, float, float], np.ndarray]


def satellites(count: int) -> dict[str, np.ndarray]:
    """Random satellites with every term present."""
    rng = np.random.default_rng(0)
    points = {name: rng.normal(size=count) * 0.3 for name in SYSTEM.parameters}
    points |= {
        "A": rng.uniform(1, 1.4, count),
        "B": rng.uniform(1, 1.4, count),
        "C": rng.uniform(0.6, 1.9, count),
    }
    return points | {"Omega": np.ones(count), "theta0": rng.uniform(0.2, 2.9, count)}


def slender(count: int) -> dict[str, np.ndarray]:
    """The same with C down to 0.01: what little energy the third axis takes up makes it spin fast for a while."""
    points = satellites(count)
    C = 10.0 ** np.random.default_rng(1).uniform(-2, -1, count)
    return points | {"A": np.ones(count), "B": 1 + 0.5 * C, "C": C}


def atlas_engine(method: str, points: dict[str, np.ndarray], statistics: bool) -> Engine:
    """This package with steps by its own rule; the points must be those of the calls."""
    module, bound = kernel(SYSTEM, method), SYSTEM.frequency_bound(points)
    scales = measure.scales(
        EQUATIONS,
        SYSTEM.initial_state(points),
        SYSTEM.constants(points),
        dict(SYSTEM.integral_scales(points)),
    )

    def run(state, constants, duration, tolerance):
        size = state.shape[1]
        plan = stepsize.choose(
            METHODS[method], bound[:size], np.full(size, duration),
            tolerance=tolerance, step=None, max_steps=10**8,
        )  # fmt: skip
        final = state.copy()
        looks = (plan.stride, plan.parts) if statistics else (plan.count, None)
        schedule = blocks.pack_blocks(plan.count, *looks)
        blocks.integrate(
            module, schedule, plan.length, final, constants,
            np.ascontiguousarray(scales[:, :size]), 1e-5, threads=1,
        )  # fmt: skip
        return final

    return run


def right_hand_side() -> Callable:
    """The equations without the factors that `scaled` makes 1, as the kernels here get them."""
    space: dict = {}
    exec(simplify(jit.functions(EQUATIONS)["rhs"], (), {}, EQUATIONS.ONES), space)
    return space["rhs"]


def slope_into() -> Callable:
    """The right-hand side as a Numba function that fills d, from arrays or pointers."""
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


def compiled_rhs() -> Callable:
    """The right-hand side as a Numba function of (t, y, constants) that returns an array."""
    into = slope_into()

    @njit
    def slope(t, y, c):
        d = np.empty(9)
        into(d, y, c)
        return d

    return slope


def scipy_dop853() -> Engine:
    slope = compiled_rhs()

    def run(state, constants, duration, tolerance):
        ends = []
        for y, c in zip(state.T, np.ascontiguousarray(constants.T), strict=True):
            solved = solve_ivp(
                slope,
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
    slope = compiled_rhs()

    def run(state, constants, duration, tolerance):
        times = np.array([0.0, duration])
        ends = [
            odeint(slope, y, times, args=(c,), tfirst=True, rtol=tolerance, atol=tolerance, mxstep=10**6)[-1]
            for y, c in zip(state.T, np.ascontiguousarray(constants.T), strict=True)
        ]
        return np.transpose(ends)

    return run


def numbalsoda_dop853() -> Engine:
    from numbalsoda import dop853, lsoda_sig

    into = slope_into()

    @cfunc(lsoda_sig)
    def slope(t, y, d, c):
        into(d, y, c)

    address = slope.address

    @njit
    def every(starts, constants, times, tolerance):
        ends = np.empty_like(starts)
        for i in range(len(starts)):
            found, _ = dop853(address, starts[i], times, constants[i], rtol=tolerance, atol=tolerance)
            ends[i] = found[-1]
        return ends

    def run(state, constants, duration, tolerance):
        starts, data = np.ascontiguousarray(state.T), np.ascontiguousarray(constants.T)
        return every(starts, data, np.array([0.0, duration]), tolerance).T

    return run


def cyrk_dop853() -> Engine:
    from CyRK import nb_diffeq_addr, nbsolve2_ivp

    into = slope_into()

    def slope(d, t, y, c):
        into(d, y, c)

    address = nb_diffeq_addr(slope)

    @njit
    def every(starts, constants, duration, tolerance):
        ends = np.empty_like(starts)
        for i in range(len(starts)):
            found = nbsolve2_ivp(
                address,
                (0.0, duration),
                starts[i],
                "DOP853",
                args=constants[i],
                rtol=tolerance,
                atol=tolerance,
            )
            ends[i] = found.y[:, -1]
            found.free()
        return ends

    def run(state, constants, duration, tolerance):
        starts, data = np.ascontiguousarray(state.T), np.ascontiguousarray(constants.T)
        return every(starts, data, duration, tolerance).T

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

    def one(y, c, duration, tolerance):
        solved = diffrax.diffeqsolve(
            term, diffrax.Dopri8(), 0.0, duration, None, y, c, max_steps=None,
            stepsize_controller=diffrax.PIDController(rtol=tolerance, atol=tolerance),
            saveat=diffrax.SaveAt(t1=True), adjoint=diffrax.ForwardMode(),
        )  # fmt: skip
        return solved.ys[-1]

    every = jax.jit(jax.vmap(one, in_axes=(0, 0, None, None)))

    def run(state, constants, duration, tolerance):
        return np.asarray(every(state.T, constants.T, duration, tolerance)).T

    return run


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--duration", type=float, default=50.0)
    parser.add_argument("--bodies", choices=("random", "slender"), default="random")
    parser.add_argument(
        "--only", nargs="*", help="engines whose names contain one of these, beside this package"
    )
    parser.add_argument("--csv", metavar="FILE", help="write every rung as a table")
    parser.add_argument("--figure", metavar="FILE", help="draw median error against time per point")
    options = parser.parse_args()
    # One processor for everybody, also for libraries with threads of their own.
    if hasattr(os, "sched_setaffinity"):
        os.sched_setaffinity(0, {max(os.sched_getaffinity(0))})
    points = {"random": satellites, "slender": slender}[options.bodies](8192)
    state, constants = (
        np.ascontiguousarray(SYSTEM.initial_state(points)),
        np.ascontiguousarray(SYSTEM.constants(points)),
    )
    few = {name: values[:COMPARED] for name, values in points.items()}
    truth = reference(SYSTEM, few, np.full(COMPARED, options.duration), Settings())
    floor = truth.state_error / SAFETY  # medians need no margin

    decades = [10.0**-k for k in range(5, 14)]
    own = [10.0**-k for k in range(11)]
    table: dict[str, tuple[Callable[[], Engine], list[float], int]] = {
        **{
            f"atlas {name}" + (" with statistics" if all_ else ""): (
                lambda name=name, all_=all_: atlas_engine(name, points, all_),
                own,
                8192,
            )
            for name in METHODS
            for all_ in (False, True)
        },
        "heyoka batch": (heyoka_batch, [1e-6, 1e-8, 1e-9, 1e-10, 1e-11, 1e-12, 1e-13], 2048),
        "numbalsoda dop853": (numbalsoda_dop853, decades, 512),
        "CyRK DOP853": (cyrk_dop853, decades, 256),
        "diffrax vmap Dopri8": (diffrax_vmap, decades[::2], 256),
        "SciPy DOP853": (scipy_dop853, [1e-6, 1e-8, 1e-10, 1e-12, 1e-13], COMPARED),
        "SciPy odeint": (scipy_odeint, [1e-6, 1e-8, 1e-10, 1e-12, 1e-13], COMPARED),
    }
    engines: dict[str, Engine] = {}
    for name, (make, _, _) in table.items():
        if options.only is not None and not any(part in name for part in ["atlas", *options.only]):
            continue
        try:
            engines[name] = make()
        except ImportError as missing:
            print(f"skipped: {name} (no module {missing.name})")
    found: dict[tuple[str, float], tuple[float, list[float]]] = {}
    for _ in range(options.rounds + 1):  # the first round compiles and is not counted
        for name, run in engines.items():
            _, tolerances, size = table[name]
            start, data = state[:, :size], constants[:, :size]
            if not name.startswith("atlas"):
                start, data = map(np.array, EQUATIONS.scaled(start, data, 1.0))
            start, data = np.ascontiguousarray(start), np.ascontiguousarray(data)
            for tolerance in tolerances:
                began = process_time()
                final = run(start, data, options.duration, tolerance)
                seconds = process_time() - began
                if not name.startswith("atlas"):
                    final = np.array(EQUATIONS.unscaled(final, data[:, : final.shape[1]], 1.0))
                error = np.maximum(np.abs(final[:, :COMPARED] - truth.state).max(0), floor)
                known = found.setdefault((name, tolerance), (float(np.median(error)), []))
                known[1].append(1e6 * seconds / size)
    lines = {name: [(e, median(t[1:])) for (n, _), (e, t) in found.items() if n == name] for name in engines}
    if options.csv:
        rows = [f"{n},{tol!r},{e!r},{median(t[1:])!r}" for (n, tol), (e, t) in found.items()]
        text = "\n".join(["engine,tolerance,median_error,microseconds_per_point", *rows])
        Path(options.csv).write_text(text + "\n")

    if options.figure:
        draw(lines, Path(options.figure))
    versions = [
        f"{p} {version(p)}" for p in ("scipy", "heyoka", "numbalsoda", "CyRK", "diffrax", "jax") if version(p)
    ]
    print(f"processor {jit.cpu()}, one used; Python {platform.python_version()}, {', '.join(versions)}")
    print(f"reference: median error {np.median(floor):.1e}; median of {options.rounds} rounds")
    print(f"us of processor time per point to T = {options.duration:g} at a median error of")
    print(f"{'':26}" + "".join(f"{target:>10.0e}" for target in TARGETS))
    times = {name: [at(line, target) for target in TARGETS] for name, line in lines.items()}
    for name, row in times.items():
        print(f"{name:26}" + "".join(f"{t:10.1f}" if np.isfinite(t) else f"{'-':>10}" for t in row))
    here = np.fmin.reduce([row for name, row in times.items() if name.startswith("atlas")])
    peers = np.fmin.reduce([row for name, row in times.items() if not name.startswith("atlas")])
    print(f"{'best here':26}" + "".join(f"{t:10.1f}" for t in here))
    print(f"{'best peer':26}" + "".join(f"{t:10.1f}" for t in peers))
    print(f"{'peer / here':26}" + "".join(f"{r:10.2f}" for r in peers / here))


def draw(lines: dict[str, list[tuple[float, float]]], path: Path) -> None:
    """Work-precision figure: median error against time per point, one line per engine."""
    figure = Figure(figsize=(5.2, 3.2), dpi=160, layout="constrained")
    ax = figure.add_subplot()
    for (name, line), mark in zip(lines.items(), "osv^Dph*X<", strict=False):
        error, time = np.transpose(line)
        ours = name.startswith("atlas")
        ax.plot(time, error, mark + ("-" if ours else "--"), ms=4, lw=1.8 if ours else 1, label=name)
    ax.set(xscale="log", yscale="log", xlabel="time per point and processor (µs)", ylabel="median error")
    figure.legend(loc="outside right upper", frameon=False, fontsize=8)
    figure.savefig(path)


def version(package: str) -> str:
    """Version of an installed package, "" if there is none."""
    try:
        return importlib.metadata.version(package)
    except importlib.metadata.PackageNotFoundError:
        return ""


def at(line: list[tuple[float, float]], target: float) -> float:
    """Least time at an error, between neighbouring rungs on the log-log line; nan outside it."""
    logs = np.log(np.array(line))
    found = []
    for (e1, t1), (e2, t2) in pairwise(logs):
        if min(e1, e2) <= np.log(target) <= max(e1, e2) and e1 != e2:
            found.append(np.exp(t1 + (t2 - t1) * (np.log(target) - e1) / (e2 - e1)))
    return min(found, default=np.nan)


if __name__ == "__main__":
    main()
