"""The command `conditions`, which prints families of steady motions and published equations."""

from __future__ import annotations

import argparse
import csv
import json
import sys
import textwrap
from collections.abc import Mapping, Sequence
from functools import partial
from itertools import groupby
from typing import Any, TextIO

from ... import systems
from ...cli.options import argument, command, out_options
from ...errors import BadInput, say, text_table
from ...files import atomic_write, writable

OUT, FORCE = out_options("FILE", "the table as .csv, or as .tex for a paper")
# First column of the rows -> columns of the table for a paper, each with its heading.
PAPER = {
    "family": {"family": "family", "motion": "motion", "conditions": "conditions", "errata": "errata"},
    "equation": {"equation": "equation", "family": "family", "printed": "as printed", "true": "as true"},
    "source": {"source": "source", "quantity": "number", "printed": "printed", "ours": "ours"},
}
RESIDUALS = {"residual_printed": "as printed", "residual_true": "as true"}  # column -> heading of a residual


@command(
    "conditions",
    argument("system", metavar="SYSTEM", nargs="?", default="satellite", help="default: satellite"),
    argument("--family", metavar="NAME", help="one family in detail"),
    [
        argument(
            "--errata",
            nargs="?",
            const=True,
            metavar="N",
            help="only the paper's equations that are wrong; with a number this equation, right or wrong",
        ),
        argument("--published", action="store_true", help="numbers that others have printed, beside ours"),
    ],
    [
        argument("--csv", action="store_true", help="comma-separated values, one row for each"),
        argument("--json", action="store_true", help="JSON, with every printed equation"),
        OUT,
    ],
    FORCE,
)
def print_conditions(options: argparse.Namespace) -> None:
    """Print the families of steady motions and their conditions."""
    from . import tables
    from .papers import published_numbers

    if options.published and options.family is not None:
        raise BadInput("--published: numbers of others belong to no family; leave out --family")
    if options.errata in systems.names():  # `conditions --errata SYSTEM` gives SYSTEM to --errata
        options.system, options.errata = options.errata, True
    out = options.out and writable(options.out, (".csv", ".tex"), force=options.force)
    system, number = systems.get(options.system), None
    if isinstance(options.errata, str):
        number, options.errata = options.errata, True
    families = [] if options.published else tables.families(system, options.family)
    only_wrong = bool(options.errata) and number is None
    published = partial(tables.published, system, options.family, only_wrong, number)
    if options.json:
        content: dict[str, object] = {"system": system.name, "reference": system.reference, "doi": system.doi}
        if options.published:
            content["numbers"] = published_numbers(system)
        else:
            content |= ({} if options.errata else {"families": families}) | {"printed": published()}
        say(*json.dumps(content, indent=1).split("\n"))
        return
    rows = published_numbers(system) if options.published else published() if options.errata else families
    if out:
        from .latex import latex_table

        columns = PAPER[next(iter(rows[0]))] if rows else {"family": "family"}
        with atomic_write(out) as temporary, temporary.open("w", encoding="utf-8", newline="") as file:
            if out.suffix.lower() == ".tex":
                file.write(latex_table(rows, columns))
            else:
                _write_csv(rows, file)
        say(f"wrote {out}")
    elif options.csv:
        _write_csv(rows, sys.stdout)
    elif options.published:
        for source, numbers in groupby(rows, lambda row: f"{row['source']}: {row['place']}"):
            say(source)
            for row in numbers:
                remark = f" ({row['remark']})" if row["remark"] else ""
                say(f"  {row['quantity']}: {row['printed']}, ours {row['ours']}: {row['verdict']}{remark}")
        agreeing = sum(row["verdict"] == "agrees" for row in rows)
        say(f"{agreeing} of {len(rows)} numbers of others on the system {system.name} agree with ours")
    elif options.errata:
        for row in map(_with_residuals, rows):
            say(f"{row['equation']}  {row['family']}".rstrip() + f": {row['verdict']}")
            say(f"  printed: {row['printed']}", f"  true:    {row['true']}")
            if row["measure"]:
                printed, true = row["residual_printed"], row["residual_true"]
                say(f"  residual as printed {printed}, as true {true}: {row['measure']}")
            if row["effect"]:
                say(f"  {row['effect']}")
        wrong = sum(row["verdict"] != "true" for row in rows)
        say(f"{wrong} equations differ; {system.reference}" if number is None else system.reference)
    elif options.family is not None:
        for key, value in _with_residuals(rows[0]).items():
            lines = value if isinstance(value, list) else textwrap.wrap(value, 100)
            say(key.replace("_", " "), *(f"    {line}" for line in lines or ["-"]))
    elif not families:
        say(f"the system {system.name} has no families of steady motions: theory predicts nothing of it")
    else:
        of_families = {"family": "family", "equations": "equations", "solves_for": "solves for"} | RESIDUALS
        _print_table(families, of_families | {"motion": "motion", "paper_wording": "words of the paper"})
        say("", f"{system.reference}:")
        of_equations = {"equation": "equation", "family": "family"} | RESIDUALS
        _print_table(tables.published(system), of_equations | {"verdict": "verdict"})
        say(
            "as printed, as true: residual of the two readings at random parameters (of a family: the largest of its"
            " equations);",
            "--errata lists what differs, --family NAME gives conditions and formulas",
        )


def _write_csv(rows: Sequence[Mapping[str, Any]], file: TextIO) -> None:
    """Write `rows` to `file` as comma-separated values."""
    writer = csv.DictWriter(file, rows[0] if rows else ["equation"], lineterminator="\n")
    writer.writeheader()
    writer.writerows(
        {key: "; ".join(value) if isinstance(value, list) else value for key, value in row.items()}
        for row in rows
    )


def _with_residuals(row: Mapping[str, Any]) -> dict[str, Any]:
    """Return a row with residuals as texts of two digits, or as a dash if no residual is measured."""
    texts = {name: "-" if row[name] is None else f"{row[name]:.1e}" for name in RESIDUALS if name in row}
    return {**row, **texts}


def _print_table(rows: Sequence[Mapping[str, Any]], columns: Mapping[str, str]) -> None:
    """Print the `columns` (name -> heading) of `rows`."""
    cells = [[row[name] or "-" for name in columns] for row in map(_with_residuals, rows)]
    lines = [[" ".join(each) if isinstance(each, list) else each for each in row] for row in cells]
    say(*text_table([[*columns.values()], *lines]).split("\n"))
