"""Processor time of the commands `atlas map` and `atlas page`, imports included.

Two times: of the first round, which may compile kernels and trace lines of theory that are not in the cache, and of the best
later round.

python scripts/benchmarks/bench_drawing.py ATLAS ... [--rounds N] [--python OTHER/bin/python ...]

Other interpreters, with other versions of the package in their environments, take turns with this one.
"""

from __future__ import annotations

import argparse
import os
import sys
import tempfile
from pathlib import Path
from subprocess import DEVNULL, Popen


def processor_time(python: str, atlas: str, command: str, out: Path) -> float:
    """Seconds of user and system time of a command."""
    arguments = [python, "-m", "atlas", command, atlas, "-o", str(out), "--force"]
    process = Popen(arguments, stdout=DEVNULL)
    _, status, usage = os.wait4(process.pid, 0)
    process.returncode = os.waitstatus_to_exitcode(status)
    if process.returncode:
        sys.exit(f"{' '.join(arguments)}: exit code {process.returncode}")
    return usage.ru_utime + usage.ru_stime


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("atlases", nargs="+", metavar="ATLAS")
    parser.add_argument("--rounds", type=int, default=3, help="after the first")
    parser.add_argument("--python", action="append", default=[], help="another interpreter")
    options = parser.parse_args()
    pythons = [sys.executable, *options.python]
    print(
        "| atlas | "
        + " | ".join(f"{command}, s ({python})" for command in ("map", "page") for python in pythons)
        + " |"
    )
    print("|---" * (1 + 2 * len(pythons)) + "|")
    with tempfile.TemporaryDirectory() as folder:
        for atlas in options.atlases:
            cases = [(python, atlas, command, Path(folder) / f"out.{kind}")
                     for command, kind in (("map", "png"), ("page", "html")) for python in pythons]  # fmt: skip
            rounds = [[processor_time(*case) for case in cases] for _ in range(options.rounds + 1)]
            best = [f"{first:.2f} / {min(later):.2f}" for first, *later in zip(*rounds, strict=True)]
            print(f"| {Path(atlas).stem} | {' | '.join(best)} |", flush=True)


if __name__ == "__main__":
    main()
