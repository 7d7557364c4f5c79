"""Time from the call of run() to the end of the first block of points, after all imports and with full caches.

python scripts/benchmarks/bench_start.py [SCENE]      (default: configs/quickstart.toml)
"""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path
from statistics import median

SCENE = Path(__file__).parents[2] / "configs" / "quickstart.toml"
PROCESSES = 5  # measured processes, after one that fills the caches of kernels and modules
# A process that ends itself after the first block of the first tile.
CODE = """
import os, sys, time
import atlas
from atlas.kernel import machine_code
from atlas.kernel import blocks
from atlas.runs import execution

scene = atlas.load_scene(sys.argv[1])
integrate = blocks.integrate

def first_block(kernel, schedule, *arguments, **options):
    one = type(schedule)(*(each[:1] for each in schedule))
    integrate(kernel, one, *arguments, **options)
    seconds = time.perf_counter() - began, time.process_time() - began_cpu
    os.write(1, "{} {}\\n".format(*seconds).encode())  # two tiles may get here at once
    os._exit(0)

blocks.integrate = first_block
began, began_cpu = time.perf_counter(), time.process_time()
execution.run(scene, progress=False)
"""


def main() -> None:
    scene = sys.argv[1] if len(sys.argv) > 1 else str(SCENE)
    usual = {name: value for name, value in os.environ.items() if name != "PYTHONDONTWRITEBYTECODE"}
    times = []
    for _ in range(1 + PROCESSES):
        process = subprocess.run(
            [sys.executable, "-c", CODE, scene], env=usual, stdout=subprocess.PIPE, text=True
        )
        if process.returncode:
            sys.exit(f"{scene}: no time measured; the reason is above")
        times.append([float(seconds) for seconds in process.stdout.splitlines()[0].split()])
    wall, cpu = (median(column) for column in zip(*times[1:], strict=True))
    print(
        f"run() to its first steps, {scene}: {wall:.3f} s, {cpu:.3f} s of processor time"
        f" (median of {PROCESSES} processes after one that fills the caches)"
    )


if __name__ == "__main__":
    main()
