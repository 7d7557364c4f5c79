"""Time from calling run() to the end of the first block of points, imports done and the kernel cache warm.

python scripts/benchmarks/bench_start.py [SCENE]      (default: configs/quickstart.toml)
"""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path
from statistics import median

SCENE = Path(__file__).parents[2] / "configs" / "quickstart.toml"
PROCESSES = 5  # one may have to compile the kernel, which does not alter the median
# A process that ends itself after the first block of the first tile.
CODE = """
import os, sys, time
import atlas
from atlas import jit
from atlas.engine import blocks
from atlas.runs import runner

scene = atlas.load_scene(sys.argv[1])
integrate = blocks.integrate

def first_block(kernel, schedule, *arguments, **options):
    one = type(schedule)(*(each[:1] for each in schedule))
    integrate(kernel, one, *arguments, **options)
    os.write(1, f"{time.perf_counter() - began}\\n".encode())  # two tiles may get here at once
    os._exit(0)

blocks.integrate = first_block
began = time.perf_counter()
runner.run(scene, progress=False)
"""


def main() -> None:
    scene = sys.argv[1] if len(sys.argv) > 1 else str(SCENE)
    times = []
    for _ in range(PROCESSES):
        process = subprocess.run([sys.executable, "-c", CODE, scene], stdout=subprocess.PIPE, text=True)
        if process.returncode:
            sys.exit(f"{scene}: no time measured; the reason is above")
        times.append(float(process.stdout.splitlines()[0]))
    print(
        f"run() to its first steps, {scene}: {median(times):.3f} s"
        f" (median of {PROCESSES} processes, kernel cache warm)"
    )


if __name__ == "__main__":
    main()
