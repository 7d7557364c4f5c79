"""Commands that read atlases: compare, map."""

from __future__ import annotations

import argparse
from pathlib import Path

from ..files import writable
from .options import (
    DONE,
    FIGURES,
    Commands,
    add_command,
    atlas_option,
    axis_values,
    force_option,
    option_with_default,
    out_option,
)


def add_compare(commands: Commands) -> None:
    command = add_command(
        commands, "compare", _compare, "print an atlas beside theory: confusion table, worst disagreements"
    )
    atlas_option(command)
    option_with_default(command, "--worst", "N", 5, "disagreements to list")


def _compare(options: argparse.Namespace) -> int:
    from ..analysis.compare import report
    from ..runs.open import open_atlas

    with open_atlas(options.atlas) as ds:
        print(report(ds, worst=options.worst))
    return DONE


def add_map(commands: Commands) -> None:
    command = add_command(commands, "map", _map, "draw a map of an atlas")
    atlas_option(command)
    out_option(command, "FIGURE", ".png, .pdf or .svg (default: ATLAS.png and ATLAS.pdf)")
    command.add_argument("--variable", metavar="NAME", help="what to map (default: label)")
    command.add_argument("--x", metavar="AXIS", help="horizontal axis (default: the first)")
    command.add_argument("--y", metavar="AXIS", help="vertical axis (default: the second)")
    command.add_argument(
        "--select", action="append", default=[], metavar="AXIS=VALUE", help="place on another axis"
    )
    command.add_argument("--width", choices=("column", "page"), default="column", help="journal width")
    command.add_argument("--caption", action="store_true", help="print a caption for the figure")
    force_option(command, "existing figures")


def _map(options: argparse.Namespace) -> int:
    from ..plotting import maps, style, text
    from ..runs.open import open_atlas

    stem = Path(options.atlas).with_suffix("")
    names = [options.out] if options.out else [stem.with_suffix(".png"), stem.with_suffix(".pdf")]
    paths = [writable(name, FIGURES, force=options.force) for name in names]
    select = axis_values("--select", options.select)
    with open_atlas(options.atlas) as ds:
        figure = maps.atlas_map(
            ds, options.variable, x=options.x, y=options.y, select=select or None, width=options.width
        )
        if options.caption:
            print(text.caption(ds))
    for path in paths:
        style.save(figure, path)
        print(f"wrote {path}")
    return DONE
