"""Draw docs/page.png: the page of an atlas in a browser, with the motion of one point; needs Chromium.

python scripts/tools/draw_page.py ATLAS [PICTURE]     (docs/page.png: the atlas of configs/gravity_gradient.toml)
"""

from __future__ import annotations

import sys
import tempfile
from pathlib import Path

ROOT = Path(__file__).parents[2]
sys.path.insert(0, str(ROOT / "tests" / "extensions" / "page"))

import browser  # noqa: E402

import atlas  # noqa: E402

PLACE = 0.3, 0.4  # of the point, as shares of the axes


def main() -> None:
    with tempfile.TemporaryDirectory() as folder, browser.launched() as tab:
        path = Path(folder) / "page.html"
        with atlas.open_atlas(sys.argv[1]) as ds:
            ds.atlas.page().save(path)
        tab.open(path.as_uri(), 1280, 800)
        indices = f"atlasPage.data.shape.map((size, axis) => Math.floor(size * {list(PLACE)}[axis]))"
        tab.evaluate(f"atlasPage.choose({indices})")
        tab.wait("(document.getElementById('motion-section').dataset.done || '') !== ''")
        tab.screenshot(sys.argv[2] if len(sys.argv) > 2 else ROOT / "docs" / "page.png")


if __name__ == "__main__":
    main()
