"""Time from calling run() to the first integration steps done, imports done and the kernel cache warm.

python scripts/bench_start.py [SCENE]      (default: configs/quickstart.toml)
"""

from __future__ import annotations

import subprocess
import sys
from statistics import median

CODE = """
import os, sys, time
import atlas
from atlas import runner
from atlas.engine import lanes
scene = atlas.load_scene(sys.argv[1])
integrate = lanes.integrate
def probe(kernel, blocks, length, state, constants, scales, cylinder, **more):
    few = lanes.Plan(blocks.points[:1], blocks.strides[:1] * 16, blocks.strides[:1], blocks.parts[:1])
    integrate(kernel, few, length, state, constants, scales, cylinder)
    os.write(1, f"{time.perf_counter() - began}\\n".encode())  # two tiles may get here at once
    os._exit(0)
lanes.integrate = probe
began = time.perf_counter()
runner.run(scene, progress=False)
"""


def main() -> None:
    scene = sys.argv[1] if len(sys.argv) > 1 else "configs/quickstart.toml"
    times = []
    for _ in range(6):
        done = subprocess.run([sys.executable, "-c", CODE, scene], capture_output=True, text=True, check=True)
        times.append(float(done.stdout.splitlines()[0]))
    print(f"run() to its first steps, {scene}: {median(times[1:]):.3f} s (median of 5 processes, cache warm)")


if __name__ == "__main__":
    main()
