"""The command `atlas amer2013_figures`."""

from __future__ import annotations

import argparse

from atlas.cli.options import argument, command, out_options, output_folder
from atlas.errors import say, text_table
from atlas.files import FIGURES

FORMATS = tuple(suffix.removeprefix(".") for suffix in FIGURES)


@command(
    "amer2013_figures",
    *out_options(
        "FOLDER", "folder of the figures (default: figures)", default="figures", replaces="existing figures"
    ),
    argument(
        "--only",
        belongs=str.isdecimal,
        type=int,
        metavar="N",
        help="which figures, one or several (default: all)",
    ),
    argument(
        "--format", belongs=FORMATS.__contains__, choices=FORMATS, help="one or several (default: png pdf)"
    ),
    argument(
        "--table",
        action="store_true",
        help="print amplitudes, periods, stability and the paper's claims; draw nothing",
    ),
)
def draw_figures(options: argparse.Namespace) -> None:
    """Draw figures 1-20 of Amer et al., as printed, corrected and exact."""
    from atlas.plotting.style import save

    from . import claims
    from . import figures as amer2013

    if options.table:
        rows = claims.figure_table()
        texts = [f"{claim.verdict}: {claim.text}\n  {claim.measured}" for claim in claims.claims(rows)]
        tables = (amer2013.amplitude_table(rows), amer2013.periodic_solutions(claims.periodic_table()))
        say(*"\n\n".join([*map(text_table, tables), *texts]).split("\n"))
        return
    figures = [amer2013.paper_figure(number) for number in options.only or amer2013.NUMBERS]
    kinds = options.format or ["png", "pdf"]
    files = [f"figure_{figure.number:02d}.{kind}" for figure in figures for kind in kinds]
    folder = output_folder(options.out, files, force=options.force)
    for figure in figures:
        fig = amer2013.draw(figure.number)
        paths = [folder / f"figure_{figure.number:02d}.{kind}" for kind in kinds]
        for path in paths:
            save(fig, path)
        say(f"wrote {' and '.join(map(str, paths))}: {figure.caption}")
