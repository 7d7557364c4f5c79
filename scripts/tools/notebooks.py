"""Write notebooks to download, docs/notebooks/*.ipynb, from pages of docs: their texts and code, without outputs.

python scripts/tools/notebooks.py [--out FOLDER]
"""

from __future__ import annotations

import argparse
import json
import re
from pathlib import Path

DOCS = Path(__file__).parents[2] / "docs"
# Notebook -> page, and the sections of the page that are in it; none: all.
NOTEBOOKS: dict[str, tuple[str, tuple[str, ...]]] = {
    "first_atlas": (
        "tutorial",
        (
            "The question", "A scene", "The map", "Ask the atlas", "Look at one motion", "Compare with theory",
        ),
    ),
    "my_satellite": ("my_satellite", ()),
    "my_equations": ("new_system", ("The shortest system", "Scenes and commands")),
}  # fmt: skip
CODE = re.compile(r"^```(toml|sh|python)\n(.*?)^```\n", re.M | re.S)
PAGE = r"\[([^\]]+)\]\((?!http)[^)]+\)"  # a link to a page
HEAD = (
    "This notebook is made from a page of the documentation of Precession Atlas, which must be installed where it runs."
    " A command such as `atlas map` is `%run -m atlas map` here."
)
IMAGE = "from IPython.display import Image  # shows the figures that cells write"


def prose(text: str, modules: list[str]) -> str:
    """Text without pictures and links to other pages, and without paragraphs on files: modules are cells of a notebook."""
    text = re.sub(rf"^!\[.*\]\(.*\)\n| \({PAGE}\)", "", text, flags=re.M)
    files = [".ipynb", *(f"`{module}.py`" for module in modules)]
    paragraphs = [
        each for each in re.split(r"\n{2,}", text.strip()) if not any(file in each for file in files)
    ]
    return "\n\n".join(
        re.sub(PAGE, r"\1", each) for each in paragraphs if not re.fullmatch(rf"{PAGE}\.", each)
    )


def code(language: str, text: str, modules: list[str]) -> str:
    """A block of a page as the code of a cell, which shows the figure that it writes."""
    if language == "toml":
        return f"%%writefile first.toml\n{text}"
    written = re.findall(r"-o (\w+\.png)" if language == "sh" else r'savefig\("(\w+\.png)"', text)
    if language == "sh":
        lines = re.findall(r"^(atlas .*?) *(#.*)?$", text, re.M)
        text = "".join(f"{comment}\n" * bool(comment) + f"%run -m {command}\n" for command, comment in lines)
    else:
        for name in modules:
            text = re.sub(rf"^(# {name}\.py|import {name}\b.*|from {name} import .*)\n", "", text, flags=re.M)
            text = re.sub(rf'(?<!")\b{name}\.', "", text)
    return text + (f'\nImage("{written[-1]}")' if written and "pyplot" not in text else "")


def notebook(page: str, sections: tuple[str, ...]) -> str:
    """The text of the notebook of some sections of a page."""
    first, *parts = re.split(r"^(?=## )", (DOCS / f"{page}.md").read_text(encoding="utf-8"), flags=re.M)
    chosen = [part for part in parts if not sections or part[3:].partition("\n")[0] in sections]
    modules = re.findall(r"^```python\n# (\w+)\.py\n", "".join(chosen), re.M)
    title, _, rest = first.partition("\n")
    cells = [("markdown", f"{title}\n\n{HEAD}\n\n{prose(rest, modules)}"), ("code", IMAGE)]
    text, *blocks = CODE.split("".join(chosen))
    cells.append(("markdown", prose(text, modules)))
    for language, block, text in zip(blocks[::3], blocks[1::3], blocks[2::3], strict=True):
        cells += [("code", code(language, block, modules).strip()), ("markdown", prose(text, modules))]
    table = {
        "cells": [
            {"cell_type": kind, "id": str(number), "metadata": {}}
            | ({"execution_count": None, "outputs": []} if kind == "code" else {})
            | {"source": source.splitlines(keepends=True)}
            for number, (kind, source) in enumerate(each for each in cells if each[1])
        ],
        "metadata": {
            "kernelspec": {"display_name": "Python 3", "language": "python", "name": "python3"},
            "language_info": {"name": "python"},
        },
        "nbformat": 4,
        "nbformat_minor": 5,
    }
    return json.dumps(table, indent=1, ensure_ascii=False) + "\n"


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--out", type=Path, default=DOCS / "notebooks", help="default: %(default)s")
    options = parser.parse_args()
    options.out.mkdir(parents=True, exist_ok=True)
    for name, (page, sections) in NOTEBOOKS.items():
        (options.out / f"{name}.ipynb").write_text(notebook(page, sections), encoding="utf-8")
        print(f"wrote {name}.ipynb")


if __name__ == "__main__":
    main()
