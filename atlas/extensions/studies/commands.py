"""The commands `atlas accuracy` and `atlas stress`."""

from __future__ import annotations

import argparse
from collections.abc import Callable
from functools import partial
from typing import Any

from ... import systems
from ...cli.options import (
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
from ...errors import say, text_table
from ...files import FIGURES, atomic_write, writable
from ...systems.base import stress_cases_of


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
        help="how labels depend on duration, transient, rate_tolerance or tolerance instead; one or several",
    ),
)
def measure_accuracy(options: argparse.Namespace) -> None:
    """Measure error against run time, or how labels depend on settings, at some points of a scene."""
    from ...store import netcdf

    inputs = input_files(options.scene)
    outs = [
        writable(out, (".nc", ".csv", *FIGURES), force=options.force, inputs=inputs) for out in options.out
    ]
    scene = read_scene(options.scene)
    from ...plotting import style
    from .figures import work_precision_figure

    study: Any
    figure: Callable[[Any], Any]
    if options.vary:
        from ...plotting.maps import atlas_map
        from . import convergence as study

        ds = study.convergence(scene, options.vary, options.points or study.MAX_POINTS)
        figure = partial(atlas_map, variable=study.CHANGE)
    else:
        from . import work_precision as study

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
    from ...plotting.style import save
    from ...store import netcdf
    from . import stress
    from .figures import stress_figure

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
