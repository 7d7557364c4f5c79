"""Commands about the published equations and about errors: conditions, figures, accuracy, stress."""

from __future__ import annotations

import argparse
import csv
import json
import sys
import textwrap
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from itertools import groupby
from typing import Any

from .. import systems
from ..errors import BadInput, say, text_table
from ..files import FIGURES, atomic_write
from ..systems.base import stress_cases_of
from .options import (
    FAILED,
    FILES,
    SCENE,
    THREADS,
    argument,
    command,
    input_files,
    out_options,
    output_folder,
    read_scene,
)

RESIDUALS = {"residual_printed": "as printed", "residual_true": "as true"}  # column -> its head


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
    ],
)
def print_conditions(options: argparse.Namespace) -> None:
    """Print the families of steady motions and their conditions."""
    from ..analysis import catalogue
    from ..analysis.published import published_numbers

    if options.published and options.family is not None:
        raise BadInput("--published: numbers of others belong to no family; leave out --family")
    if options.errata in systems.names():  # conditions --errata SYSTEM
        options.system, options.errata = options.errata, True
    system, number = systems.get(options.system), None
    if isinstance(options.errata, str):
        number, options.errata = options.errata, True
    families = [] if options.published else catalogue.families(system, options.family)
    only_wrong = bool(options.errata) and number is None
    published = partial(catalogue.published, system, options.family, only_wrong, number)
    if options.json:
        content: dict[str, object] = {"system": system.name, "reference": system.reference, "doi": system.doi}
        if options.published:
            content["numbers"] = published_numbers(system)
        else:
            content |= ({} if options.errata else {"families": families}) | {"printed": published()}
        say(*json.dumps(content, indent=1).split("\n"))
        return
    rows = published_numbers(system) if options.published else published() if options.errata else families
    if options.csv:
        writer = csv.DictWriter(sys.stdout, rows[0] if rows else ["equation"], lineterminator="\n")
        writer.writeheader()
        writer.writerows(
            {key: "; ".join(value) if isinstance(value, list) else value for key, value in row.items()}
            for row in rows
        )
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
        _print_table(catalogue.published(system), of_equations | {"verdict": "verdict"})
        say(
            "as printed, as true: residual of the two readings at random parameters (of a family: the largest of its"
            " equations);",
            "--errata lists what differs, --family NAME gives conditions and formulas",
        )


def _with_residuals(row: Mapping[str, Any]) -> dict[str, Any]:
    """A row with residuals of two digits, or a dash where there is nothing to measure."""
    texts = {name: "-" if row[name] is None else f"{row[name]:.1e}" for name in RESIDUALS if name in row}
    return {**row, **texts}


def _print_table(rows: Sequence[Mapping[str, Any]], columns: Mapping[str, str]) -> None:
    """Print some columns of rows under their heads."""
    cells = [[row[name] or "-" for name in columns] for row in map(_with_residuals, rows)]
    lines = [[" ".join(each) if isinstance(each, list) else each for each in row] for row in cells]
    say(*text_table([[*columns.values()], *lines]).split("\n"))


@command(
    "accuracy",
    SCENE,
    *out_options(
        "OUT",
        ".nc for every number, .csv for the table, .png, .pdf or .svg for the figure; one or several",
        replaces="existing files",
        belongs=lambda word: word.lower().endswith(FILES),
        default=[],
    ),
    argument(
        "--points",
        type=int,
        metavar="N",
        lowest=2,
        help="points to integrate (default: 64; with --vary 10000)",
    ),
    argument(
        "--vary",
        belongs=str.isidentifier,
        metavar="SETTING",
        help="how labels depend on duration, rate_tolerance or tolerance instead; one or several",
    ),
)
def measure_accuracy(options: argparse.Namespace) -> None:
    """Measure error against run time, or how labels depend on settings, at some points of a scene."""
    from ..store import netcdf

    inputs = input_files(options.scene)
    outs = [
        netcdf.writable(out, (".nc", ".csv", *FIGURES), force=options.force, inputs=inputs)
        for out in options.out
    ]
    scene = read_scene(options.scene)
    from ..plotting import style
    from ..plotting.stress import work_precision_figure

    study: Any
    figure: Callable[[Any], Any]
    if options.vary:
        from ..analysis import convergence as study
        from ..plotting.maps import atlas_map

        ds = study.convergence(scene, options.vary, options.points or study.MAX_POINTS)
        figure = partial(atlas_map, variable=study.CHANGE)
    else:
        from ..validation import work_precision as study

        ds, figure = study.work_precision(scene, options.points or 64, progress=True), work_precision_figure
    say(*study.report(ds).split("\n"))
    for out in outs:
        if out.suffix.lower() == ".nc":
            netcdf.write(ds, out)
        elif out.suffix.lower() == ".csv":
            with atomic_write(out) as temporary:
                temporary.write_text(study.table(ds))
        else:
            style.save(figure(ds), out)
        say(f"wrote {out}")


@command(
    "stress",
    argument(
        "system", metavar="SYSTEM", nargs="?", help="one system (default: all that have cases of their own)"
    ),
    *out_options("FOLDER", "write SYSTEM.nc and SYSTEM.png there", replaces="existing files"),
    THREADS,
)
def run_stress_cases(options: argparse.Namespace) -> int | None:
    """Run stiff and extreme cases and compare every label with the true one."""
    with_cases = [name for name, system in systems.SYSTEMS.items() if stress_cases_of(system)]
    names = [systems.get(options.system).name] if options.system else with_cases
    files = [f"{name}{suffix}" for name in names for suffix in (".nc", ".png")]
    folder = output_folder(options.out, files, force=options.force) if options.out else None
    from ..plotting.stress import stress_figure
    from ..plotting.style import save
    from ..store import netcdf
    from ..validation import stress

    wrong, failed = 0, False
    for name in names:
        ds = stress.stress(name, threads=options.threads)
        say(name, *stress.report(ds).split("\n"), "")
        wrong += int(stress.mislabelled(ds).sum())
        failed |= stress.estimate_fails(ds)
        if folder is not None:
            netcdf.write(ds, folder / f"{name}.nc")
            save(stress_figure(ds), folder / f"{name}.png")
            say(f"wrote {folder / name}.nc and .png", "")
    if set(names) & set(with_cases):
        say(*text_table(stress.limits()).split("\n"))
    say(f"labels that are not true: {wrong}")
    return FAILED if wrong or failed else None
