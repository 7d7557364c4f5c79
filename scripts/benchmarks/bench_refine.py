"""Refinement in comparison with the full grid: share of points integrated, differing labels, times.

python scripts/benchmarks/bench_refine.py [SCENE ...] [--count 129] [--levels 3]

Default: the three stability diagrams of configs/; each takes some minutes.
"""

from __future__ import annotations

import argparse
import time
import tomllib
from pathlib import Path

import atlas
from atlas.scene.read import scene_from

CONFIGS = Path(__file__).parents[2] / "configs"


def main() -> None:
    parser = argparse.ArgumentParser(description="refinement against the full grid")
    parser.add_argument("scenes", nargs="*", type=Path, default=sorted(CONFIGS.glob("stability_*.toml")))
    parser.add_argument("--count", type=int, default=129, help="points of each axis of the coarse grid")
    parser.add_argument("--levels", type=int, default=3)
    options = parser.parse_args()
    for path in options.scenes:
        table = tomllib.loads(path.read_text()) | {"outputs": {"variables": ["label"]}}
        table["axes"] = {name: axis | {"count": options.count} for name, axis in table["axes"].items()}
        scene = scene_from(table | {"refine": {"levels": options.levels}}, path.stem)
        began = time.perf_counter()
        ds = atlas.run(scene, progress=False)
        refined_seconds = time.perf_counter() - began
        for name, count in zip(scene.axes, scene.shape, strict=True):
            table["axes"][name]["count"] = count
        began = time.perf_counter()
        full = atlas.run(scene_from(table, path.stem), progress=False)
        full_seconds = time.perf_counter() - began
        print(
            f"{path.stem}: {' x '.join(map(str, scene.shape))} points,"
            f" {100 * ds.attrs['atlas_computed_share']:.2f} % integrated in {refined_seconds:.1f} s, all in {full_seconds:.1f} s;"
            f" probe missed {ds.attrs['atlas_probe_missed']} of {ds.attrs['atlas_probe_points']};"
            f" {int((ds.label != full.label).sum())} labels differ",
            flush=True,
        )


if __name__ == "__main__":
    main()
