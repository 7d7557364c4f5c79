"""Speed of the engine as shipped, as ratios measured in one run (machines are noisy; medians of pairs).

    python scripts/bench_engine.py [--points 4096] [--steps 2000] [--repeat 7]

Full satellite (magnet and rotor), statistics and integrals on. Operations of one step of rk4 are counted
as 384: four right-hand sides of 69 and the sums of the method. The peak is that of independent fused
multiply-adds in registers, measured in the same run between the other measurements.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable
from statistics import median

import numpy as np
from numba import njit

from atlas.engine import jit, lanes, measure, steps
from atlas.engine.runge_kutta import METHODS, step_source
from atlas.evaluate import kernel
from atlas.systems import SYSTEMS

OPERATIONS = 4 * 69 + 3 * 9 * 2 + 9 * 6


def satellites(count: int) -> dict[str, np.ndarray]:
    """Random satellites with every term present."""
    rng = np.random.default_rng(0)
    system = SYSTEMS["satellite"]
    points = {name: rng.normal(size=count) * 0.3 for name in system.parameters}
    points |= {
        "A": rng.uniform(1, 1.4, count),
        "B": rng.uniform(1, 1.4, count),
        "C": rng.uniform(0.6, 1.9, count),
    }
    return points | {"Omega": np.ones(count), "theta0": rng.uniform(0.2, 2.9, count)}


def peak_kernel() -> Callable[[int], float]:
    """Twelve independent chains of fused multiply-adds over 32 lanes; returns 2 operations each."""
    names = [f"x{i}" for i in range(12)]
    lines = [
        "def peak(rounds):",
        "    X = np.ones((12, 32))",
        "    for _ in range(rounds):",
        "        for l in range(32):",
    ]
    lines += [f"            {x} = X[{i}, l]" for i, x in enumerate(names)]
    lines += ["            for r in range(8):"] + [
        f"                {x} = {x} * 0.999999 + 1e-7" for x in names
    ]
    lines += [f"            X[{i}, l] = {x}" for i, x in enumerate(names)] + ["    return X.sum()"]
    space: dict = {"np": np}
    exec("\n".join(lines), space)
    return njit(nogil=True, **jit.OPTIONS)(space["peak"])


def scalar_kernel() -> Callable[..., None]:
    """The same right-hand side and method as plain scalar Numba, one point at a time, no statistics."""
    system = SYSTEMS["satellite"]
    text = jit.functions(system.equations)["rhs"]
    load = "\n".join(f"        y{i} = Y[{i}, p]" for i in range(9))
    step = "\n".join("            " + line for line in step_source(METHODS["rk4"], 9).splitlines())
    store = "\n".join(f"        Y[{i}, p] = y{i}" for i in range(9))
    code = (
        f"{jit.HEADER}\n@njit\n{text}\n\n@njit(nogil=True)\ndef scalar(Y, C, h, count):\n"
        f"    for p in range(Y.shape[1]):\n{load}\n        constants = ({', '.join(f'C[{i}, p]' for i in range(16))})\n"
        f"        for _ in range(count):\n{step}\n{store}\n"
    )
    space: dict = {}
    exec(compile(code, "<scalar>", "exec"), space)
    return space["scalar"]


def seconds(work: Callable[[], object]) -> float:
    began = time.perf_counter()
    work()
    return time.perf_counter() - began


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--points", type=int, default=4096)
    parser.add_argument("--steps", type=int, default=2000)
    parser.add_argument("--repeat", type=int, default=7)
    options = parser.parse_args()
    system = SYSTEMS["satellite"]
    points = satellites(options.points)
    state, constants = system.start(points), np.ascontiguousarray(system.constants(points))
    scales = measure.scales(system.equations, state, constants, dict(system.conserved(points)))
    # The stride that the step rule chooses for a typical point at the default tolerance.
    chosen = steps.choose(
        METHODS["rk4"], np.array([3.0]), np.array([60.0]), tolerance=1e-8, step=None, max_steps=10**8
    )
    counts = np.full(options.points, options.steps)
    blocks = lanes.plan(counts, np.full(options.points, int(chosen.stride[0])))
    length = np.full(options.points, float(chosen.length[0]))
    module = kernel(system, "rk4")

    def engine(threads: int) -> None:
        lanes.integrate(module, blocks, length, state.copy(), constants, scales, 1e-5, threads=threads)

    peak, scalar, rounds, few = peak_kernel(), scalar_kernel(), 40_000, max(options.points // 16, 1)
    one, two = np.ascontiguousarray(state[:, :few]), np.ascontiguousarray(constants[:, :few])
    compile_seconds = seconds(lambda: engine(1))
    peak(1)
    scalar(one.copy(), two, 0.01, 1)
    rows: dict[str, list[float]] = {"peak": [], "one": [], "two": [], "scalar": []}
    for _ in range(options.repeat):
        rows["peak"].append(rounds * 32 * 12 * 8 * 2 / seconds(lambda: peak(rounds)))
        rows["one"].append(blocks.point_steps / seconds(lambda: engine(1)))
        rows["two"].append(blocks.point_steps / seconds(lambda: engine(2)))
        rows["scalar"].append(
            few * options.steps / seconds(lambda: scalar(one.copy(), two, 0.01, options.steps))
        )
    shares = [a * OPERATIONS / b for a, b in zip(rows["one"], rows["peak"], strict=True)]
    speedups = [a / b for a, b in zip(rows["one"], rows["scalar"], strict=True)]
    cores = [a / b for a, b in zip(rows["two"], rows["one"], strict=True)]
    print(
        f"processor {jit.cpu()}, {lanes.available_threads()} usable; {options.points} points x {options.steps} steps"
    )
    print(
        f"first call (load or compile): {compile_seconds:.2f} s; samples every {int(chosen.stride[0])} steps"
    )
    print(f"FMA peak, one core:      {median(rows['peak']) / 1e9:8.1f} GFLOP/s")
    print(
        f"engine, one core:        {median(rows['one']) / 1e6:8.1f} million point-steps/s ({1e9 / median(rows['one']):.2f} ns)"
    )
    print(
        f"share of FMA peak:       {100 * median(shares):8.1f} %  (min {100 * min(shares):.1f}, max {100 * max(shares):.1f})"
    )
    print(f"over plain scalar Numba: {median(speedups):8.2f} x")
    print(f"two cores over one:      {median(cores):8.2f} x  (min {min(cores):.2f}, max {max(cores):.2f})")


if __name__ == "__main__":
    main()
