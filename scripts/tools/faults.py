"""Run folders and atlas files under faults; prints the counts and ends with an error at the first wrong result.

python scripts/tools/faults.py                          (all parts, about an hour on two processors)
python scripts/tools/faults.py --only "full disk" flips --scale 0.1

Every part ends with a byte-by-byte comparison of the atlas with one computed in memory by one process. Some parts
do more as root: small disks are mounted, and an ordinary user is a process without root's rights. Otherwise the
size of files is limited, and permissions are taken from the user who runs this.
"""

from __future__ import annotations

import argparse
import logging
import random
import tempfile
from collections.abc import Callable
from pathlib import Path

import dask.array  # before forks, each of which would import it
from fault_damage import damages, flips, swaps
from fault_dask import clients, clusters, schedulers, workers
from fault_disks import clock_back, full_disk, permissions, read_only
from fault_kills import (
    creation_kills,
    join_kills,
    kills,
    modes,
    shifted_shards,
    step_kills,
    two_processes,
)
from fault_trial import Trial

PARTS: dict[str, Callable[[Trial, float], str]] = {
    "modes": modes,
    "kills": kills,
    "step kills": step_kills,
    "join kills": join_kills,
    "creation kills": creation_kills,
    "damage": damages,
    "flips": flips,
    "swaps": swaps,
    "full disk": full_disk,
    "read-only disk": read_only,
    "permissions": permissions,
    "clock back": clock_back,
    "shifted shards": shifted_shards,
    "two processes": two_processes,
    "dask schedulers": schedulers,
    "dask clients": clients,
    "dask workers": workers,
    "dask clusters": clusters,
}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument(
        "--only", nargs="+", choices=PARTS, default=list(PARTS), metavar="PART", help=", ".join(PARTS)
    )
    parser.add_argument(
        "--scale", type=float, default=1.0, help="share of the usual number of faults (default: 1)"
    )
    parser.add_argument("--tiles", type=int, default=60, help="of a run (default: 60)")
    parser.add_argument("--seed", type=int, default=1, help="of the random numbers (default: 1)")
    options = parser.parse_args()
    random.seed(options.seed)
    logging.disable(logging.WARNING)  # damage is counted here
    # A process with threads cannot be forked.
    with (
        tempfile.TemporaryDirectory(prefix="atlas-faults-") as folder,
        dask.config.set(scheduler="synchronous"),
    ):
        trial = Trial(Path(folder), options.tiles)
        tiles = trial.start("cut").tiling.count
        print(f"{trial.scene.size} points in {tiles} tiles, {trial.whole.nbytes} bytes", flush=True)
        for name in options.only:
            print(f"{name}: {PARTS[name](trial, options.scale)}", flush=True)


if __name__ == "__main__":
    main()
