"""Commands about the published equations: conditions, figures."""

from __future__ import annotations

import argparse
import csv
import json
import sys
import textwrap
from collections.abc import Mapping, Sequence
from typing import Any

from ..errors import say, text_table
from .options import DONE, FIGURES, Commands, add_command, force_option, out_option, output_folder


def add_conditions(commands: Commands) -> None:
    """Add the command `conditions`."""
    command = add_command(
        commands, "conditions", _conditions, "print the families of steady motions and their conditions"
    )
    command.add_argument(
        "system", metavar="SYSTEM", nargs="?", default="satellite", help="default: satellite"
    )
    command.add_argument("--family", metavar="NAME", help="one family in detail")
    command.add_argument("--errata", action="store_true", help="only the paper's equations that are wrong")
    form = command.add_mutually_exclusive_group()
    form.add_argument("--csv", action="store_true", help="comma-separated values, one row for each")
    form.add_argument("--json", action="store_true", help="JSON, with every printed equation")


def _conditions(options: argparse.Namespace) -> int:
    """Run the command `conditions`; returns its exit code."""
    from .. import systems
    from ..analysis import catalogue

    system = systems.get(options.system)
    families = catalogue.families(system, options.family)
    if options.json:
        content: dict[str, object] = {"system": system.name, "reference": system.reference, "doi": system.doi}
        if not options.errata:
            content["families"] = families
        content["printed"] = catalogue.published(system, options.family, options.errata)
        say(*json.dumps(content, indent=1).split("\n"))
        return DONE
    rows = catalogue.published(system, options.family, errata=True) if options.errata else families
    if options.csv:
        writer = csv.DictWriter(sys.stdout, rows[0] if rows else ["equation"], lineterminator="\n")
        writer.writeheader()
        writer.writerows(
            {key: "; ".join(value) if isinstance(value, list) else value for key, value in row.items()}
            for row in rows
        )
    elif options.errata:
        _print_errata(rows)
        say(f"{len(rows)} equations differ; {system.reference}")
    elif options.family is not None:
        _print_family(rows[0])
    elif not families:
        say(f"the system {system.name} has no families of steady motions: theory predicts nothing of it")
    else:
        _print_catalogue(families, catalogue.published(system), system.reference)
    return DONE


def _print_errata(rows: Sequence[Mapping[str, Any]]) -> None:
    """Print the equations that are wrong as printed."""
    for row in rows:
        say(f"{row['equation']}  {row['family']}".rstrip() + f": {row['verdict']}")
        say(f"  printed: {row['printed']}", f"  true:    {row['true']}")
        if row["measure"]:
            printed, true = _residual(row["residual_printed"]), _residual(row["residual_true"])
            say(f"  residual as printed {printed}, as true {true}: {row['measure']}")
        if row["effect"]:
            say(f"  {row['effect']}")


def _print_family(row: Mapping[str, Any]) -> None:
    """Print every field of one family."""
    for key, value in row.items():
        text = _residual(value) if key.startswith("residual") else value
        lines = text if isinstance(text, list) else textwrap.wrap(text, 100)
        say(key.replace("_", " "), *(f"    {line}" for line in lines or ["-"]))


def _print_catalogue(
    families: Sequence[Mapping[str, Any]], published: Sequence[Mapping[str, Any]], reference: str
) -> None:
    """Print all families and all published equations as two tables."""

    def residuals(row: Mapping[str, Any]) -> tuple[str, str]:
        return _residual(row["residual_printed"]), _residual(row["residual_true"])

    rows: list[tuple[str, ...]] = [("family", "equations", "solves for", "as printed", "as true", "motion")]
    for row in families:
        solves_for = " ".join(row["solves_for"]) or "-"
        rows.append((row["family"], row["equations"], solves_for, *residuals(row), row["motion"]))
    say(*text_table(rows).split("\n"))
    rows = [("equation", "family", "as printed", "as true", "verdict")]
    rows += [(row["equation"], row["family"] or "-", *residuals(row), row["verdict"]) for row in published]
    say("", f"{reference}:", *text_table(rows).split("\n"))
    say(
        "as printed, as true: residual of the two readings at random parameters (of a family: the largest of its"
        " equations);",
        "--errata lists what differs, --family NAME gives conditions and formulas",
    )


def _residual(value: float | None) -> str:
    """A residual to two digits; a dash where there is nothing to measure."""
    return "-" if value is None else f"{value:.1e}"


def add_figures(commands: Commands) -> None:
    """Add the command `figures`."""
    command = add_command(
        commands, "figures", _figures, "draw figures 1-20 of Amer et al., as printed and as true"
    )
    out_option(command, "FOLDER", "folder of the figures (default: figures)", default="figures")
    command.add_several(
        "--only",
        belongs=str.isdecimal,
        type=int,
        metavar="N",
        help="which figures, one or several (default: all)",
    )
    kinds = tuple(suffix.removeprefix(".") for suffix in FIGURES)
    command.add_several(
        "--format", belongs=kinds.__contains__, choices=kinds, help="one or several (default: png pdf)"
    )
    command.add_argument(
        "--table", action="store_true", help="print amplitudes, periods and the paper's claims; draw nothing"
    )
    force_option(command, "existing figures")


def _figures(options: argparse.Namespace) -> int:
    """Run the command `figures`; returns its exit code."""
    from ..plotting import amer2013
    from ..plotting.style import save

    if options.table:
        rows, claims = amer2013.amplitudes_and_claims()
        say(*"\n\n".join([text_table(rows), *claims]).split("\n"))
        return DONE
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
    return DONE
