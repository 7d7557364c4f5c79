"""Commands that measure errors: accuracy, stress."""

from __future__ import annotations

import argparse

from ..errors import say, text_table
from ..files import atomic_write
from .options import (
    DONE,
    FAILED,
    FIGURES,
    FILES,
    Commands,
    add_command,
    check_at_least,
    force_option,
    input_files,
    option_with_default,
    out_option,
    output_folder,
    read_scene,
    scene_option,
    threads_option,
)


def add_accuracy(commands: Commands) -> None:
    """Add the command `accuracy`."""
    command = add_command(
        commands, "accuracy", _accuracy, "measure error against run time at some points of a scene"
    )
    scene_option(command)
    kinds = ".nc for every number, .csv for the table, .png, .pdf or .svg for the figure; one or several"
    command.add_several(
        "-o",
        "--out",
        belongs=lambda word: word.lower().endswith(FILES),
        default=[],
        metavar="OUT",
        help=kinds,
    )
    option_with_default(command, "--points", "N", 64, "points to integrate")
    force_option(command, "existing files")


def _accuracy(options: argparse.Namespace) -> int:
    """Run the command `accuracy`; returns its exit code."""
    from ..io import netcdf

    inputs = input_files(options.scene)
    outs = [
        netcdf.writable(out, (".nc", ".csv", *FIGURES), force=options.force, inputs=inputs)
        for out in options.out
    ]
    check_at_least("--points", options.points, 2)
    scene = read_scene(options.scene)
    from ..plotting import style
    from ..plotting.stress import work_precision_figure
    from ..validation import work_precision

    ds = work_precision.work_precision(scene, options.points, progress=True)
    say(*work_precision.report(ds).split("\n"))
    for out in outs:
        if out.suffix.lower() == ".nc":
            netcdf.write(ds, out)
        elif out.suffix.lower() == ".csv":
            with atomic_write(out) as temporary:
                temporary.write_text(work_precision.table(ds))
        else:
            style.save(work_precision_figure(ds), out)
        say(f"wrote {out}")
    return DONE


def add_stress(commands: Commands) -> None:
    """Add the command `stress`."""
    command = add_command(
        commands, "stress", _stress, "run stiff and extreme cases and compare every label with the true one"
    )
    command.add_argument(
        "system", metavar="SYSTEM", nargs="?", help="one system (default: all that have cases of their own)"
    )
    out_option(command, "FOLDER", "write SYSTEM.nc and SYSTEM.png there")
    threads_option(command)
    force_option(command, "existing files")


def _stress(options: argparse.Namespace) -> int:
    """Run the command `stress`; returns its exit code."""
    from .. import systems

    check_at_least("--threads", options.threads, 1)
    with_cases = [name for name, system in systems.SYSTEMS.items() if system.stress_cases()]
    names = [systems.get(options.system).name] if options.system else with_cases
    files = [f"{name}{suffix}" for name in names for suffix in (".nc", ".png")]
    folder = output_folder(options.out, files, force=options.force) if options.out else None
    from ..io import netcdf
    from ..plotting.stress import stress_figure
    from ..plotting.style import save
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
    return FAILED if wrong or failed else DONE
