"""Try odd and hostile scenes and points, and list every outcome that is neither a result nor BadInput.

python scripts/tools/fuzz_scenes.py [--count 20000] [--runs 500] [--points 500] [--seed 0]

The exit code is 1 if the list has an entry. Entry S:I is case I of seed S, and the same seed gives it again.
"""

from __future__ import annotations

import argparse
import logging
import sys
import time
import traceback
from collections import Counter
from pathlib import Path
from random import Random

ROOT = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT / "tests"))

import odd_scenes  # noqa: E402
import pytest  # noqa: E402

SLOW = 5.0  # seconds


def main() -> int:
    """Try all cases; returns 1 if any had an outcome other than a result or BadInput."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--count", type=int, default=20_000, help="scenes to read and check")
    parser.add_argument("--runs", type=int, default=500, help="scenes to run")
    parser.add_argument("--points", type=int, default=500, help="calls of label_points")
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    logging.disable()
    outcomes: Counter[str] = Counter()
    failures: set[str] = set()
    kinds = {
        "check": (options.count, lambda rng: odd_scenes.try_scene(odd_scenes.scene_text(rng))),
        "run": (options.runs, lambda rng: odd_scenes.try_run(odd_scenes.scene_text(rng))),
        "points": (options.points, odd_scenes.try_points),
        "table": (options.count, odd_scenes.try_csv),
        "tie": (options.count, odd_scenes.try_tie),
    }
    with pytest.MonkeyPatch.context() as patched:
        odd_scenes.use_interpreted_kernels(patched)
        for kind, (count, attempt) in kinds.items():
            for case in range(count):
                started = time.perf_counter()
                try:
                    outcome = "ok" if attempt(Random(f"{kind} {options.seed} {case}")) == "ok" else "BadInput"
                except Exception as error:
                    place = traceback.extract_tb(error.__traceback__)[-1]
                    where = f"{Path(place.filename).name}:{place.lineno}"
                    outcome = f"{type(error).__name__} at {where}: {str(error)[:80]!r}"
                    if outcome not in failures:
                        failures.add(outcome)
                        text = "".join(traceback.format_exception(error)[-4:])
                        print(f"{kind} {options.seed}:{case}: {outcome}\n{text}", flush=True)
                if (seconds := time.perf_counter() - started) > SLOW:
                    print(f"{kind} {options.seed}:{case} took {seconds:.1f} s", flush=True)
                outcomes[f"{kind}: {outcome}"] += 1
    for outcome, count in sorted(outcomes.items()):
        print(f"{count:8d}  {outcome}")
    return int(bool(failures))


if __name__ == "__main__":
    sys.exit(main())
