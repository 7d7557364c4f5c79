"""Run the blocks of docs/how_to.md and draw their pictures, docs/how_to/*.png.

python scripts/tools/how_to.py [--out docs/how_to] [--only NAME ...]
"""

from __future__ import annotations

import argparse
import contextlib
import os
import re
import runpy
import tempfile
from pathlib import Path

import matplotlib
from matplotlib import pyplot
from PIL import Image

DOCS = Path(__file__).parents[2] / "docs"
SECTION = re.compile(r"^## .*\n(?:(?!^## ).*\n)*", re.M)
LARGEST = (1100, 600)  # pixels of a picture: the page has many
COLOURS = 48


def blocks() -> dict[str, str]:
    """The block of each question that has a picture, by the name of the picture, in the order of the page."""
    of_pictures = {}
    for section in SECTION.findall((DOCS / "how_to.md").read_text()):
        for picture in re.findall(r"\(how_to/(\w+)\.png\)", section):
            of_pictures[picture] = re.findall(r"^```python\n(.*?)^```", section, re.M | re.S)[0]
    return of_pictures


def draw(name: str, block: str, out: Path) -> None:
    """Run a block in a folder of its own, and keep its picture, small and with few colours."""
    with tempfile.TemporaryDirectory() as folder, contextlib.chdir(folder):
        Path("block.py").write_text(block)
        runpy.run_path("block.py", run_name="__main__")
        pyplot.close("all")
        with Image.open(f"{name}.png") as image:
            picture = image.convert("RGB")
            picture.thumbnail(LARGEST, Image.Resampling.LANCZOS)
            few = picture.quantize(COLOURS, dither=Image.Dither.NONE)
            few.save(out / f"{name}.png", optimize=True)


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    questions = blocks()
    parser.add_argument("--out", type=Path, default=DOCS / "how_to", help="default: %(default)s")
    parser.add_argument("--only", nargs="+", metavar="NAME", choices=questions, default=list(questions))
    options = parser.parse_args()
    matplotlib.use("agg")
    options.out.mkdir(parents=True, exist_ok=True)
    for name in options.only:
        draw(name, questions[name], options.out.resolve())
        print(f"{name}.png: {os.path.getsize(options.out / f'{name}.png') // 1000} kB", flush=True)


if __name__ == "__main__":
    main()
