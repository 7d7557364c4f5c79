"""Size of pages, and the times to make a page, to open it and to integrate a motion in it; needs Chromium.

python scripts/benchmarks/bench_page.py ATLAS ...
"""

from __future__ import annotations

import sys
import tempfile
import time
from pathlib import Path
from statistics import median

ROOT = Path(__file__).parents[2]
sys.path.insert(0, str(ROOT / "tests" / "extensions" / "page"))

import browser  # noqa: E402

import atlas  # noqa: E402
from atlas.extensions.page.page import atlas_page  # noqa: E402

OPENINGS = 3
# Times in ms from the request to the first paint and to the map, and of the motion of the middle point; steps of this motion.
TIMES = """
(async () => {
  const paint = performance.getEntriesByName("first-contentful-paint")[0].startTime;
  const map = performance.getEntriesByName("map drawn")[0].startTime;
  const begun = performance.now();
  const motion = await atlasPage.motionOf(atlasPage.data.shape.map((size) => size >> 1));
  return [paint, map, performance.now() - begun, motion.start.steps * (atlasPage.data.motion.samples - 1)];
})()
"""


def main() -> None:
    print(
        "| atlas | points | variables | page, MB | made in, s | first paint, ms | map, ms | a motion, ms | its steps |"
    )
    print("|---|---|---|---|---|---|---|---|---|")
    with browser.launched() as tab, tempfile.TemporaryDirectory() as folder:
        for name in sys.argv[1:]:
            with atlas.open_atlas(name) as ds:
                begun = time.perf_counter()
                page = atlas_page(ds)
                seconds = time.perf_counter() - begun
            path = Path(folder) / "page.html"
            page.save(path, force=True)
            rows = []
            for _ in range(OPENINGS):
                tab.open(path.as_uri())
                tab.wait("performance.getEntriesByName('first-contentful-paint').length > 0")
                rows.append(tab.evaluate(TIMES))
            paint, drawn, motion, steps = (median(column) for column in zip(*rows, strict=True))
            shape = tab.evaluate("atlasPage.data.shape")
            count = tab.evaluate("atlasPage.data.variables.length")
            points = " x ".join(map(str, shape))
            print(
                f"| {Path(name).stem} | {points} | {count} | {len(page.html.encode()) / 1e6:.1f} | {seconds:.1f} |"
                f" {paint:.0f} | {drawn:.0f} | {motion:.0f} | {steps:.0f} |"
            )


if __name__ == "__main__":
    main()
