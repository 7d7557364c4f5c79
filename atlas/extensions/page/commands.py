"""The command `atlas page`."""

from __future__ import annotations

import argparse
from pathlib import Path

import atlas

from ...cli.options import ATLAS, DEGREES, command, out_options
from ...errors import say
from ...files import without_suffix, writable
from ...store.finished import suffixes


@command("page", ATLAS, *out_options("FILE", ".html (default: ATLAS.html)"), DEGREES)
def make_page(options: argparse.Namespace) -> None:
    """Make one HTML file of an atlas, in which points can be integrated."""
    from .page import FORMATS, atlas_page

    name = options.out or f"{without_suffix(options.atlas, *suffixes())}.html"
    out = writable(name, FORMATS, force=options.force, inputs=[options.atlas])
    with atlas.open_atlas(options.atlas) as ds:
        page = atlas_page(ds, file=Path(options.atlas).name, degrees=options.degrees)
    page.save(out, force=options.force)
    say(f"wrote {out}, {len(page.html.encode()) / 1e6:.1f} MB; open it in any browser")
