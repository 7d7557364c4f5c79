"""Run the blocks of docs/how_to.md, my_satellite.md, my_top.md and teaching.md that draw a picture, and save it in the page's folder.

python scripts/tools/how_to.py [--out docs] [--only NAME ...]
"""

from __future__ import annotations

import argparse
import contextlib
import re
import runpy
import sys
import tempfile
from pathlib import Path

import matplotlib
from matplotlib import pyplot
from PIL import Image

DOCS = Path(__file__).parents[2] / "docs"
PAGES = ("how_to", "my_satellite", "my_top", "teaching")
BLOCK = re.compile(r"^```python\n(.*?)^```", re.M | re.S)
LARGEST = (1100, 600)  # pixels; small, because a page has many pictures
COLOURS = 128


def blocks() -> dict[str, tuple[str, str]]:
    """Page and code of each picture, by the name of the picture, in the order of the pages."""
    of_pictures = {}
    for page in PAGES:
        text = (DOCS / f"{page}.md").read_text()
        for picture in re.findall(rf"\({page}/(\w+)\.png\)", text):
            (block,) = (each for each in BLOCK.findall(text) if f'savefig("{picture}.png"' in each)
            of_pictures[picture] = page, block
    return of_pictures


def draw(name: str, page: str, block: str, out: Path) -> None:
    """Run a block in a temporary folder, with the modules of its page, and save its picture, small and with few colours."""
    texts = BLOCK.findall((DOCS / f"{page}.md").read_text())
    modules = {match[1]: text for text in texts if (match := re.match(r"# (\w+)\.py\n", text))}
    with tempfile.TemporaryDirectory() as folder, contextlib.chdir(folder):
        for module, text in (modules | {"block": block}).items():
            Path(f"{module}.py").write_text(text)
        sys.path.insert(0, folder)
        runpy.run_path("block.py", run_name="__main__")
        sys.path.remove(folder)
        for module in modules:
            sys.modules.pop(module, None)
        pyplot.close("all")
        with Image.open(f"{name}.png") as image:
            picture = image.convert("RGB")
            picture.thumbnail(LARGEST, Image.Resampling.LANCZOS)
            few = picture.quantize(COLOURS, dither=Image.Dither.NONE)
            (out / page).mkdir(parents=True, exist_ok=True)
            few.save(out / page / f"{name}.png", optimize=True)


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    questions = blocks()
    parser.add_argument("--out", type=Path, default=DOCS, help="default: %(default)s")
    parser.add_argument("--only", nargs="+", metavar="NAME", choices=questions, default=list(questions))
    options = parser.parse_args()
    matplotlib.use("agg")
    for name in options.only:
        page, block = questions[name]
        draw(name, page, block, options.out.resolve())
        print(f"{name}.png: {(options.out / page / f'{name}.png').stat().st_size // 1000} kB", flush=True)


if __name__ == "__main__":
    main()
