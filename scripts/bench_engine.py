"""Speed of the engine as shipped, as ratios measured in one run (machines are noisy; medians of pairs).

    python scripts/bench_engine.py [--points 4096] [--steps 16000] [--repeat 7] [--scene SCENE]

All terms present, statistics and integrals on. Operations of one step of rk4 on the satellite are counted
as 384: four right-hand sides of 69 and the sums of the method. The peak is that of independent fused
multiply-adds in registers, measured in the same run between the other measurements. Then the other
system and method, kernels that leave out what vanishes, and a scene run for its labels only.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable
from pathlib import Path
from statistics import median

import numpy as np
from numba import njit

from atlas import load_scene
from atlas.engine import blocks, jit, measure, stepsize
from atlas.engine.tableaux import METHODS, step_source
from atlas.label.pipeline import GENERIC, Specialization, kernel
from atlas.runs import runner
from atlas.systems import SYSTEMS

# Operations of a right-hand side in its readable form, and the number of states.
RHS = {"satellite": (69, 9), "fixed_point": (45, 6)}
MAGNET, ROTOR = {"mu1", "mu2", "mu3"}, {"k1", "k2", "k3"}


def operations(system: str, method: str) -> int:
    """Of one step: the right-hand sides, the sums that make the stages, and the one that makes the step."""
    (rhs, states), tableau = RHS[system], METHODS[method]
    sums = sum(2 * np.count_nonzero(row) for row in tableau.a) + 2 * np.count_nonzero(tableau.b) - 2
    return tableau.stages * rhs + states * int(sums)


def bodies(system: str, count: int) -> dict[str, np.ndarray]:
    """Random points of a system with every term present."""
    rng = np.random.default_rng(0)
    points = {}
    for name, parameter in SYSTEMS[system].parameters.items():
        optional = np.isnan(parameter.default)
        points[name] = np.full(count, np.nan) if optional else rng.normal(size=count) * 0.3
    points |= {"A": rng.uniform(1, 1.4, count), "B": rng.uniform(1, 1.4, count)}
    points |= {"C": rng.uniform(0.6, 1.9, count), "theta0": rng.uniform(0.2, 2.9, count)}
    return points | ({"Omega": np.ones(count)} if system == "satellite" else {})


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
        f"{jit.HEADER}\n@njit\n{text}\n\n@njit(nogil=True)\ndef scalar(Y, C, count):\n"
        f"    for p in range(Y.shape[1]):\n{load}\n        constants = ({', '.join(f'C[{i}, p]' for i in range(len(system.equations.CONSTANTS)))})\n"
        f"        for _ in range(count):\n{step}\n{store}\n"
    )
    space: dict = {}
    exec(compile(code, "<scalar>", "exec"), space)
    return space["scalar"]


def seconds(work: Callable[[], object]) -> float:
    began = time.perf_counter()
    work()
    return time.perf_counter() - began


class Case:
    """One kernel with points to integrate, as an atlas run would."""

    def __init__(self, system: str, method: str, special: Specialization, count: int, steps_each: int):
        kind, points = SYSTEMS[system], bodies(system, count)
        self.state = np.ascontiguousarray(kind.initial_state(points))
        self.constants = np.ascontiguousarray(kind.constants(points))
        self.scales = measure.scales(
            kind.equations, self.state, self.constants, dict(kind.integral_scales(points))
        )
        # The stride that the step rule chooses for a typical point at the default tolerance.
        chosen = stepsize.choose(
            METHODS[method], np.array([3.0]), np.array([60.0]), tolerance=1e-8, step=None, max_steps=10**8
        )
        self.stride, self.parts = int(chosen.stride[0]), int(chosen.parts[0])
        self.blocks = blocks.pack_blocks(
            np.full(count, steps_each), np.full(count, self.stride), np.full(count, self.parts)
        )
        self.length = np.full(count, float(chosen.length[0]))
        self.kernel = kernel(kind, method, special)
        self.first_call = seconds(lambda: self.run(1))

    def run(self, threads: int) -> None:
        blocks.integrate(
            self.kernel, self.blocks, self.length, self.state.copy(), self.constants, self.scales, 1e-5,
            threads=threads,
        )  # fmt: skip

    def speed(self, threads: int = 1) -> float:
        """Point-steps per second."""
        return self.blocks.point_steps / seconds(lambda: self.run(threads))


def engine(points: int, steps_each: int, repeat: int) -> None:
    """Kernels against the FMA peak, against each other, and against plain scalar Numba."""
    few = steps_each // 8
    cases = {
        ("satellite", "rk4", "full"): Case("satellite", "rk4", GENERIC, points, steps_each),
        ("satellite", "rk4", "no magnet"): Case(
            "satellite", "rk4", Specialization.of(SYSTEMS["satellite"], MAGNET, False), points, steps_each
        ),
        ("satellite", "rk4", "no magnet, no rotor"): Case(
            "satellite",
            "rk4",
            Specialization.of(SYSTEMS["satellite"], MAGNET | ROTOR, False),
            points,
            steps_each,
        ),
        ("fixed_point", "rk4", "full"): Case("fixed_point", "rk4", GENERIC, points, steps_each),
        ("satellite", "rk8", "full"): Case("satellite", "rk8", GENERIC, points, few),
        ("fixed_point", "rk8", "full"): Case("fixed_point", "rk8", GENERIC, points, few),
    }
    whole = cases["satellite", "rk4", "full"]
    peak, scalar, rounds, some = peak_kernel(), scalar_kernel(), 40_000, max(points // 16, 1)
    equations, unit = SYSTEMS["satellite"].equations, 0.01 / METHODS["rk4"].span
    one, two = map(np.array, equations.scaled(whole.state[:, :some], whole.constants[:, :some], unit))
    peak(1)
    scalar(one.copy(), two, 1)
    tops: list[float] = []
    rows: dict[tuple[str, str, str], list[float]] = {key: [] for key in cases}
    both: list[float] = []
    plain: list[float] = []
    for _ in range(repeat):
        for key, case in cases.items():
            if key[2] == "full":
                tops.append(rounds * 32 * 12 * 8 * 2 / seconds(lambda: peak(rounds)))
            rows[key].append(case.speed())
        both.append(whole.speed(2))
        plain.append(some * steps_each / seconds(lambda: scalar(one.copy(), two, steps_each)))
    base, top = rows["satellite", "rk4", "full"], median(tops)
    print(f"processor {jit.cpu()}, {blocks.available_threads()} usable; {points} points x {steps_each} steps")
    print(
        f"FMA peak, one core: {top / 1e9:.1f} GFLOP/s (from {min(tops) / 1e9:.1f} to {max(tops) / 1e9:.1f})"
    )
    print(
        f"{'kernel':48s} {'ns/point-step':>13s} {'share of peak':>14s} {'time saved':>11s} {'first call':>12s}"
    )
    for (system, method, special), speeds in rows.items():
        full = special == "full"
        share = f"{100 * median(speeds) * operations(system, method) / top:.1f} %" if full else ""
        saved = (
            "" if full else f"{100 * (1 - median(a / b for a, b in zip(base, speeds, strict=True))):.0f} %"
        )
        case = cases[system, method, special]
        every = f"{case.parts} a step" if case.parts > 1 else f"every {case.stride}"
        name = f"{system}, {method}, {special} (sampled {every})"
        print(f"{name:48s} {1e9 / median(speeds):13.2f} {share:>14s} {saved:>11s} {case.first_call:10.2f} s")
    print(f"over plain scalar Numba: {median(a / b for a, b in zip(base, plain, strict=True)):.2f} x")
    print(f"two cores over one:      {median(a / b for a, b in zip(both, base, strict=True)):.2f} x")


def labels_only(path: str) -> None:
    """A scene for all its variables against the same for its labels, whole runs."""
    text = Path(path).read_text()
    few = text + '\n[outputs]\nvariables = ["label", "status", "end_time"]\n'
    runs = {"all variables": load_scene(text), "labels only": load_scene(few)}
    times: dict[str, list[float]] = {name: [] for name in runs}
    for _ in range(3):
        for name, scene in runs.items():
            times[name].append(seconds(lambda scene=scene: runner.run(scene, progress=False)))
    ratio = median(a / b for a, b in zip(*times.values(), strict=True))
    shown = ", ".join(f"{name} {median(t):.1f} s" for name, t in times.items())
    print(f"{path}: {shown}: {ratio:.1f} times faster")


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--points", type=int, default=4096)
    parser.add_argument("--steps", type=int, default=16000)
    parser.add_argument("--repeat", type=int, default=7)
    parser.add_argument("--scene", default="configs/conditions_k3.toml", help="for the label-only run")
    options = parser.parse_args()
    engine(options.points, options.steps, options.repeat)
    labels_only(options.scene)


if __name__ == "__main__":
    main()
