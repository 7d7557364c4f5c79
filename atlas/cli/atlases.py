"""Commands that read atlases: compare, map, page."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path

from ..errors import BadInput, say
from ..files import without_suffix, writable
from .options import (
    DONE,
    FIGURES,
    Commands,
    add_command,
    assignment_option,
    atlas_option,
    axis_values,
    check_at_least,
    force_option,
    option_with_default,
    out_option,
)


def add_compare(commands: Commands) -> None:
    """Add the command `compare`."""
    command = add_command(
        commands, "compare", _compare, "print an atlas beside theory: confusion table, worst disagreements"
    )
    atlas_option(command)
    option_with_default(command, "--worst", "N", 5, "disagreements to list")


def _compare(options: argparse.Namespace) -> int:
    """Run the command `compare`; returns its exit code."""
    from ..analysis.compare import report
    from ..runs.backend import open_atlas

    check_at_least("--worst", options.worst, 0)
    with open_atlas(options.atlas) as ds:
        say(*report(ds, worst=options.worst).split("\n"))
    return DONE


def add_map(commands: Commands) -> None:
    """Add the command `map`."""
    command = add_command(commands, "map", _map, "draw a map of an atlas")
    atlas_option(command)
    out_option(command, "FIGURE", ".png, .pdf or .svg (default: ATLAS.png and ATLAS.pdf)")
    command.add_argument("--variable", metavar="NAME", help="what to map (default: what the scene is about)")
    command.add_argument("--x", metavar="AXIS", help="horizontal axis (default: the first)")
    command.add_argument("--y", metavar="AXIS", help="vertical axis (default: the second)")
    assignment_option(command, "--select", "AXIS=VALUE", "values of the other axes, one or several")
    command.add_argument("--width", choices=("column", "page"), default="column", help="journal width")
    command.add_argument("--size", metavar="WIDTHxHEIGHT", help="size in mm, such as 120x90")
    command.add_argument("--dpi", type=float, metavar="N", help="resolution (default: 600)")
    command.add_argument("--title", metavar="TEXT", help="title of the figure")
    command.add_argument("--cmap", metavar="NAME", help="Matplotlib's colour map for a variable of numbers")
    assignment_option(command, "--colors", "FLAG=COLOUR", "colours of flags, one or several")
    assignment_option(
        command, "--labels", "NAME=TEXT", "texts for flags, axes and the variable, one or several"
    )
    command.add_argument("--no-boundary", dest="boundary", action="store_false", help="draw no theory")
    command.add_argument("--no-legend", dest="legend", action="store_false", help="draw no legend")
    command.add_argument("--caption", action="store_true", help="print a caption for the figure")
    force_option(command, "existing figures")


def _map(options: argparse.Namespace) -> int:
    """Run the command `map`; returns its exit code."""
    from ..plotting import maps, style, text
    from ..runs.backend import open_atlas

    stem = without_suffix(options.atlas, ".nc", ".zarr")
    names = [options.out] if options.out else [f"{stem}.png", f"{stem}.pdf"]
    paths = [writable(name, FIGURES, force=options.force, inputs=[options.atlas]) for name in names]
    given = {
        name: getattr(options, name) for name in ("x", "y", "title", "cmap", "boundary", "legend", "width")
    }
    for name in ("colors", "labels"):
        given[name] = _named_texts(f"--{name}", getattr(options, name))
    select = axis_values("--select", options.select)
    size, dpi = _size(options.size), 600 if options.dpi is None else options.dpi
    with open_atlas(options.atlas) as ds:
        figure = maps.atlas_map(ds, options.variable, select=select, size=size, dpi=dpi, **given)
        if options.caption:
            say(text.caption(ds))
    for path in paths:
        style.save(figure, path, options.dpi)
        say(f"wrote {path}")
    return DONE


def add_page(commands: Commands) -> None:
    """Add the command `page`."""
    command = add_command(
        commands, "page", _page, "make one HTML file of an atlas, in which points can be integrated"
    )
    atlas_option(command)
    out_option(command, "FILE", ".html (default: ATLAS.html)")
    force_option(command, "an existing file")


def _page(options: argparse.Namespace) -> int:
    """Run the command `page`; returns its exit code."""
    from ..page.page import FORMATS, atlas_page
    from ..runs.backend import open_atlas

    name = options.out or f"{without_suffix(options.atlas, '.nc', '.zarr')}.html"
    out = writable(name, FORMATS, force=options.force, inputs=[options.atlas])
    with open_atlas(options.atlas) as ds:
        page = atlas_page(ds, file=Path(options.atlas).name)
    page.save(out, force=options.force)
    say(f"wrote {out}, {len(page.html.encode()) / 1e6:.1f} MB; open it in any browser")
    return DONE


def _named_texts(option: str, texts: Sequence[str]) -> dict[str, str]:
    """NAME=TEXT options as texts by name."""
    pairs: dict[str, str] = {}
    for text in texts:
        name, equals, value = text.partition("=")
        if not (name and equals):
            raise BadInput(f"{option} {text}: must be NAME=TEXT")
        if name in pairs:
            raise BadInput(f"{option}: {name} is given twice")
        pairs[name] = value
    return pairs


def _size(text: str | None) -> tuple[float, float] | None:
    """Width and height in mm from WIDTHxHEIGHT."""
    if text is None:
        return None
    try:
        width, height = map(float, text.lower().split("x"))
    except ValueError:
        raise BadInput(f"--size {text}: must be WIDTHxHEIGHT in mm, such as 120x90") from None
    return width, height
