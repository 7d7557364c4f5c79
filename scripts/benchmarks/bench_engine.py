"""Speed of the compiled kernels, and its share of the processor's limit for issuing instructions.

    python scripts/benchmarks/bench_engine.py [--points 4096] [--steps 16000] [--repeat 7] [--scene SCENE]

Every kernel integrates random points with all terms present, or with some parameters 0, with statistics and first
integrals. Speeds are in processor time on one core, the best of all rounds, because disturbances only slow a kernel
down. Ratios are medians over rounds in which both kernels take turns.

The share of the issue limit is the quotient of two times for one step of one vector of points. The first is measured for
the packed floating-point instructions of the compiled step (counted in its assembly) as independent instructions with
all operands in registers; the second is that of the kernel, statistics included. Multiplications (fused multiply-adds
included) and additions may use different units of the processor, so the first time has the step's own proportion of the
two. Shares are printed on x86 only; a share above 100 % means that the count or the limit is wrong, and makes the
script fail.
"""

from __future__ import annotations

import argparse
import re
import sys
import time
import warnings
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from statistics import median
from typing import Any

import numpy as np
from llvmlite import ir
from numba import njit, types
from numba.core import cgutils
from numba.extending import intrinsic
from numba.np.unsafe.ndarray import to_fixed_tuple

import atlas
from atlas.kernel import blocks, machine_code
from atlas.kernel.ensemble import Ensemble
from atlas.kernel.intrinsics import full_vectors
from atlas.kernel.specialization import Specialization, kernel, source, tangent_kernel
from atlas.kernel.stepsize import StepSizes
from atlas.kernel.tableaux import TANGENT_METHOD
from atlas.measure import tangent_runs
from atlas.scene.model import Settings
from atlas.systems import SYSTEMS
from atlas.variables import default_variables

ROOT = Path(__file__).parents[2]
MAGNET, ROTOR = frozenset({"mu1", "mu2", "mu3"}), frozenset({"k1", "k2", "k3"})
# System, method, parameters that are zero, and their description.
CASES = (
    ("satellite", "rk4", frozenset(), "all terms"),
    ("satellite", "rk4", MAGNET, "no magnet"),
    ("satellite", "rk4", MAGNET | ROTOR, "no magnet, no rotor"),
    ("fixed_point", "rk4", frozenset(), "all terms"),
    ("satellite", "rk8", frozenset(), "all terms"),
    ("fixed_point", "rk8", frozenset(), "all terms"),
)
RK8_SHARE = 8  # rk8 gets the steps of rk4 divided by this
PEAK_ROUNDS, PEAK_INSTRUCTIONS = 200_000, 96
LOOP = re.compile(r"^(\.LBB\w+):|^\s+j\w+\s+(\.LBB\w+)", re.M)
DIVISION = re.compile(r"^\s+v(?:div|sqrt)pd\s", re.M)
PACKED = re.compile(r"^\s+v(fn?m(?:add|sub)\d*|mul|add|sub)pd\s.*%([xyz])mm", re.M)


@dataclass(frozen=True)
class Instructions:
    """Packed floating-point instructions of one step of one vector of points."""

    products: int  # multiplications and fused multiply-adds
    sums: int  # additions and subtractions
    lanes: int  # points of one vector

    @property
    def total(self) -> int:
        return self.products + self.sums


def random_points(system: str, count: int, rng: np.random.Generator) -> dict[str, np.ndarray]:
    """Random points of a system with every term present but damping."""
    points = {}
    for name, parameter in SYSTEMS[system].parameters.items():
        optional = np.isnan(parameter.default)
        points[name] = np.full(count, np.nan) if optional else rng.normal(size=count) * 0.3
    points |= {"A": rng.uniform(1, 1.4, count), "B": rng.uniform(1, 1.4, count)}
    points |= {"C": rng.uniform(0.6, 1.9, count), "theta0": rng.uniform(0.2, 2.9, count)}
    points["damping"] = np.zeros(count)
    return points | ({"Omega": np.ones(count)} if system == "satellite" else {})


class Case:
    """One kernel with points to integrate, as in the run of an atlas."""

    def __init__(self, name: str, method: str, zero: frozenset[str], count: int, steps: int):
        system = SYSTEMS[name]
        points = random_points(name, count, np.random.default_rng(0)) | {
            parameter: np.zeros(count) for parameter in zero
        }
        self.ensemble = Ensemble.of(system, points)
        # The step size and the sampling of a typical point at the default tolerance.
        settings = Settings(method=method).at(1e30)
        typical = StepSizes.of(settings, np.full(count, 3.0), np.full(count, 60.0))
        self.step_sizes = replace(typical, steps=np.full(count, steps))
        per_sample = int(typical.steps_per_sample[0])
        self.sampling = f"a sample every {per_sample} steps" if per_sample > 1 else "a sample every step"
        absent = {parameter for parameter, values in points.items() if not np.nan_to_num(values).any()}
        kind = system, method, Specialization.of(system, absent, frozenset())
        self.kernel, self.source = kernel(*kind), source(*kind)
        self.point_steps = count * steps
        self.first_call = seconds(partial(self.run, 1))

    def run(self, threads: int) -> None:
        """Integrate all points."""
        self.ensemble.integrate(self.kernel, self.step_sizes, 1e-5, threads=blocks.Threads(threads))

    def assembly(self) -> str:
        """Assembly of the kernel, compiled again because Numba does not show that of a cached one."""
        namespace: dict[str, Any] = {}
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            exec(self.source, namespace)
            namespace["integrate"].compile(self.kernel.integrate.signatures[0])
        return str(next(iter(namespace["integrate"].inspect_asm().values())))


def step_instructions(assembly: str) -> Instructions | None:
    """Count the packed arithmetic of the step, or None if there is none.

    The step is the loop over the points of a block, which advances one vector in a pass: the innermost loop with most packed
    arithmetic and no division, because only the loops of the statistics divide.
    """
    labels: dict[str, int] = {}
    loops: list[tuple[int, int]] = []
    for match in LOOP.finditer(assembly):
        if match[1]:
            labels[match[1]] = match.start()
        elif match[2] in labels:
            loops.append((labels[match[2]], match.start()))
    best = None
    for first, last in loops:
        if any(first <= a and b < last for a, b in loops):
            continue
        packed = PACKED.findall(assembly[first:last])
        if DIVISION.search(assembly[first:last]):
            continue
        if packed and (best is None or len(packed) > best.total):
            sums = sum(name in ("add", "sub") for name, _ in packed)
            lanes = max({"x": 2, "y": 4, "z": 8}[register] for _, register in packed)
            best = Instructions(len(packed) - sums, sums, lanes)
    return best


def peak_kernel(step: Instructions) -> Callable[[int], float]:
    """A loop of independent packed instructions in registers, with the proportion of products and sums of a step.

    One round issues PEAK_INSTRUCTIONS. Each accumulator depends on itself only, and there are as many accumulators as
    registers allow, so that the latency of instructions has no effect.
    """
    chains = 24 if step.lanes == 8 else 12
    vector = ir.VectorType(ir.DoubleType(), step.lanes)
    share = step.products / step.total

    def constant(value: float) -> ir.Constant:
        return ir.Constant(vector, [value] * step.lanes)

    @intrinsic
    def loop(typing_context, rounds):
        def generate(context, builder, signature, arguments):
            entry = builder.block
            body, done = builder.append_basic_block("body"), builder.append_basic_block("done")
            fma = cgutils.get_or_insert_function(
                builder.module, ir.FunctionType(vector, [vector] * 3), f"llvm.fma.v{step.lanes}f64"
            )
            builder.branch(body)
            builder.position_at_end(body)
            index = builder.phi(arguments[0].type)
            index.add_incoming(ir.Constant(index.type, 0), entry)
            starts = [builder.phi(vector) for _ in range(chains)]
            values = list(starts)
            for k in range(PEAK_INSTRUCTIONS):
                value, is_product = values[k % chains], int((k + 1) * share) > int(k * share)
                values[k % chains] = (
                    builder.call(fma, [value, constant(0.999999), constant(1e-7)])
                    if is_product
                    else builder.fadd(value, constant(1e-7))
                )
            for k, (start, value) in enumerate(zip(starts, values, strict=True)):
                start.add_incoming(constant(1.0 + 0.01 * k), entry)
                start.add_incoming(value, body)
            following = builder.add(index, ir.Constant(index.type, 1))
            index.add_incoming(following, body)
            builder.cbranch(builder.icmp_signed("<", following, arguments[0]), body, done)
            builder.position_at_end(done)
            total = values[0]
            for value in values[1:]:
                total = builder.fadd(total, value)
            return builder.extract_element(total, ir.Constant(ir.IntType(32), 0))

        return types.float64(types.int64), generate

    @njit(nogil=True)
    def peak(rounds):
        full_vectors()
        return loop(rounds)

    peak(1)
    return peak


def scalar_kernel() -> Callable[[np.ndarray, np.ndarray, int], None]:
    """rk4 of the satellite's equations in plain Numba, one point at a time, without statistics."""
    equations = SYSTEMS["satellite"].equations
    rhs, n_constants = njit(equations.rhs), len(equations.CONSTANTS)

    @njit
    def advance(y, h, d):
        return (
            y[0] + h * d[0], y[1] + h * d[1], y[2] + h * d[2], y[3] + h * d[3], y[4] + h * d[4],
            y[5] + h * d[5], y[6] + h * d[6], y[7] + h * d[7], y[8] + h * d[8],
        )  # fmt: skip

    @njit(nogil=True)
    def scalar(states, constants, steps):
        h = 0.01
        for p in range(states.shape[0]):
            y, c = to_fixed_tuple(states[p], 9), to_fixed_tuple(constants[p], n_constants)
            for _ in range(steps):
                k1 = rhs(y, c)
                k2 = rhs(advance(y, h / 2, k1), c)
                k3 = rhs(advance(y, h / 2, k2), c)
                k4 = rhs(advance(y, h, k3), c)
                y = advance(advance(advance(advance(y, h / 6, k1), h / 3, k2), h / 3, k3), h / 6, k4)
            states[p, 0] = y[0] + y[3] + y[6]  # a use of all results, so that the compiler keeps them

    return scalar


def seconds(work: Callable[[], object], clock: Callable[[], float] = time.process_time) -> float:
    """Time of one call of work, s: processor time unless another clock is given."""
    began = clock()
    work()
    return clock() - began


@dataclass
class Timings:
    """Times of all rounds, s: processor times on one core, except `wall`."""

    kernels: list[list[float]]  # of each case
    peaks: list[list[float]]  # of the peak loop of each case; empty where its instructions are unknown
    scalar: list[float]
    wall: dict[int, list[float]]  # of the first case, by the number of threads


def measure_all(
    cases: list[Case], steps: list[Instructions | None], scalar_steps: int, repeat: int
) -> Timings:
    """Run everything in turn, `repeat` times."""
    peaks = [peak_kernel(step) if step else None for step in steps]
    scalar, base = scalar_kernel(), cases[0]
    few = max(base.ensemble.size // 16, 1)
    states = np.ascontiguousarray(base.ensemble.state.T[:few])
    constants = np.ascontiguousarray(base.ensemble.constants.T[:few])
    scalar(states.copy(), constants, 1)
    result = Timings([[] for _ in cases], [[] for _ in cases], [], {1: [], 2: []})
    for _ in range(repeat):
        for i, (case, peak) in enumerate(zip(cases, peaks, strict=True)):
            if peak is not None:
                result.peaks[i].append(seconds(partial(peak, PEAK_ROUNDS)))
            result.kernels[i].append(seconds(partial(case.run, 1)))
        for threads, times in result.wall.items():
            times.append(seconds(partial(base.run, threads), time.perf_counter))
        spent = seconds(lambda: scalar(states.copy(), constants, scalar_steps))
        result.scalar.append(spent * base.point_steps / (few * scalar_steps))
    return result


def ratio(slow: list[float], fast: list[float]) -> float:
    """Median over the rounds of slow / fast."""
    return median(a / b for a, b in zip(slow, fast, strict=True))


def print_kernels(cases: list[Case], steps: list[Instructions | None], timings: Timings) -> bool:
    """Print the table of kernels as Markdown; returns whether no share is above 100 %."""
    print("\n| kernel | ns per point and step, one core | instructions of a step | share of the issue limit |"
          " time saved | first call |")  # fmt: skip
    print("|---|---|---|---|---|---|")
    possible = True
    for i, (case, step, (system, method, zero, words)) in enumerate(zip(cases, steps, CASES, strict=True)):
        own = min(timings.kernels[i]) / case.point_steps
        count = share = ""
        if step:
            limit = min(timings.peaks[i]) / (PEAK_ROUNDS * PEAK_INSTRUCTIONS) * step.total / step.lanes
            count, share = f"{step.products} + {step.sums}", f"{100 * limit / own:.0f} %"
            possible &= limit <= own
        saved = f"{100 * (1 - 1 / ratio(timings.kernels[0], timings.kernels[i])):.0f} %" if zero else ""
        name = f"{system}, {method}, {words}, {case.sampling}"
        print(f"| {name} | {1e9 * own:.2f} | {count} | {share} | {saved} | {case.first_call:.1f} s |")
    return possible


def print_machine(steps: list[Instructions | None], points: int, rk4_steps: int, repeat: int) -> None:
    """Print the processor and its measured rates of packed instructions."""
    print(
        f"Processor {machine_code.cpu()}, {blocks.available_threads()} usable; {points} points x {rk4_steps} steps of rk4"
    )
    if steps[0] is None:
        print("No packed x86 instructions found in the kernels: no issue limit.")
        return
    lanes = steps[0].lanes
    for words, products, sums in (("fused multiply-adds", 1, 0), ("as many additions as those", 1, 1)):
        peak = peak_kernel(Instructions(products, sums, lanes))
        best = min(seconds(partial(peak, PEAK_ROUNDS)) for _ in range(repeat))
        rate = PEAK_ROUNDS * PEAK_INSTRUCTIONS / best
        flops = rate * lanes * (2 * products + sums) / (products + sums)
        print(f"{words}: {rate / 1e9:.2f} G instructions/s of {lanes} numbers, {flops / 1e9:.1f} GFLOP/s")


def engine(points: int, rk4_steps: int, repeat: int) -> bool:
    """Measure and print all kernels; returns whether no share of the limit is above 100 %."""
    cases = [
        Case(system, method, zero, points, rk4_steps if method == "rk4" else rk4_steps // RK8_SHARE)
        for system, method, zero, _ in CASES
    ]
    steps = [step_instructions(case.assembly()) for case in cases]
    print_machine(steps, points, rk4_steps, repeat)
    timings = measure_all(cases, steps, rk4_steps, repeat)
    possible = print_kernels(cases, steps, timings)
    print(f"\nOver plain scalar Numba: {ratio(timings.scalar, timings.kernels[0]):.1f} times")
    print(f"Two threads over one: {ratio(timings.wall[1], timings.wall[2]):.2f} times")
    return possible


def tangent_run(*arguments) -> None:
    """Prepare and integrate runs with tangent vectors."""
    tangent_runs.Separation(*arguments).integrate(threads=blocks.Threads(1))


def tangent_cost(count: int, steps: int, repeat: int) -> None:
    """Print the time of a step with a tangent vector over that of a step of the state alone, and of a step with statistics."""
    for name, system in SYSTEMS.items():
        case = Case(name, TANGENT_METHOD.name, frozenset(), count, steps)
        sizes = case.step_sizes
        tangent = tangent_runs.TangentSteps(sizes.steps, sizes.step_size, np.ones(count, bool))
        own = tangent_kernel(system)
        unit = np.ones(count)
        works = {
            "tangent": partial(tangent_run, system, own, case.ensemble, tangent, unit),
            "state": partial(
                case.ensemble.final_states, case.kernel, sizes.steps, sizes.step_size, blocks.Threads(1)
            ),
            "statistics": partial(case.run, 1),
        }
        first_call = seconds(works["tangent"])
        times: dict[str, list[float]] = {key: [] for key in works}
        for _ in range(repeat):
            for key, work in works.items():
                times[key].append(seconds(work))
        print(
            f"{name}, {TANGENT_METHOD.name} with a tangent vector: {1e9 * min(times['tangent']) / (count * steps):.1f} ns per"
            f" point and step, {ratio(times['tangent'], times['state']):.2f} times the state alone,"
            f" {ratio(times['tangent'], times['statistics']):.2f} times the state with statistics; first call"
            f" {first_call:.1f} s"
        )


def labels_only(path: Path) -> None:
    """Print the times of whole runs of a scene for all variables and for labels only."""
    scene = atlas.load_scene(path)
    all_variables = replace(scene, outputs=tuple(default_variables(scene.system)), map="")
    labels = replace(all_variables, outputs=("label", "status", "end_time"))
    times: tuple[list[float], list[float]] = ([], [])
    for _ in range(3):
        for scene, spent in zip((all_variables, labels), times, strict=True):
            spent.append(seconds(partial(atlas.run, scene, progress=False), time.perf_counter))
    print(f"{path.name}: {median(times[0]):.1f} s for all variables, {median(times[1]):.1f} s for labels only:"
          f" {ratio(*times):.1f} times faster")  # fmt: skip


def main() -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--points", type=int, default=4096)
    parser.add_argument("--steps", type=int, default=16000, help="steps of rk4 for each point")
    parser.add_argument("--repeat", type=int, default=7)
    parser.add_argument(
        "--scene", type=Path, default=ROOT / "configs" / "conditions_k3.toml", help="for the label-only run"
    )
    options = parser.parse_args()
    possible = engine(options.points, options.steps, options.repeat)
    tangent_cost(options.points, options.steps // RK8_SHARE, options.repeat)
    labels_only(options.scene)
    if not possible:
        print(
            "FAILED: a share above 100 %: the count of instructions or the measured limit is wrong",
            file=sys.stderr,
        )
    return int(not possible)


if __name__ == "__main__":
    sys.exit(main())
