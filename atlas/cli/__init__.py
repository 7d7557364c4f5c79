"""The `atlas` command, which parses options, calls the package and prints. This package contains no physics."""

from __future__ import annotations

import argparse
import os
import sys
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path
from typing import NoReturn

from .. import extension
from .._version import __version__
from ..errors import MAX_MESSAGE, BadInput, failure_text, messages_for_shell, printable, say
from ..interruption import (
    STOPPED,
    Stopped,
    exit_process,
    explain_kept,
    outcome,
    signals_as_interrupt,
    start_deadline,
)
from ..kernel.compiling import announced
from . import atlases, scenes
from .options import BAD_INPUT, DONE, FAILED, Parser

SECOND_NAME = "precession-atlas"

__all__ = ["BAD_INPUT", "DONE", "FAILED", "command", "main", "parser"]


def main(arguments: Sequence[str] | None = None) -> int:
    """Run a command. Exit codes are 0 done, 1 failed, 2 bad input, 75 out of time, 129 hung up, 130 interrupted, 143 terminated."""
    explain_kept(None)
    try:
        with messages_for_shell(), signals_as_interrupt():
            options = parser().parse_args(arguments)
            with announced(not getattr(options, "quiet", False)):
                return int(options.handler(options))
    except BadInput as error:
        say(f"atlas: {error}", file=sys.stderr)
        return BAD_INPUT
    except ValueError as error:
        if not str(error).startswith("Key backend:"):  # Matplotlib raises this on import
            raise
        say(f"atlas: MPLBACKEND: {printable(str(error), MAX_MESSAGE)}", file=sys.stderr)
        return BAD_INPUT
    except Stopped as stopped:
        say(f"atlas: {stopped}; the same command continues", file=sys.stderr)
        return STOPPED
    except KeyboardInterrupt:
        code, message = outcome()
        with suppress(OSError):  # the terminal may have hung up
            say(message, file=sys.stderr)
        return code
    except BrokenPipeError:
        sys.stderr.close()
        return FAILED
    except (OSError, MemoryError) as error:
        message = printable(failure_text(error), MAX_MESSAGE)
        say(f"atlas: failed: {message}", file=sys.stderr)
        return FAILED


def command() -> NoReturn:
    """Run the command of this process. If the shell asks for completions of a command line, write the completions instead."""
    if "_ARGCOMPLETE" in os.environ:
        import argcomplete  # without argcomplete the shell asks for no completions

        argcomplete.autocomplete(parser())
    start_deadline()
    try:
        code = main()
    except SystemExit as end:  # raised by the parser of the options
        code = int(end.code or DONE)
    exit_process(code)


def parser() -> argparse.ArgumentParser:
    """Return the parser of the command line. Building the parser imports no compiler."""
    name = Path(sys.argv[0]).name
    top = Parser(
        prog=name if name == SECOND_NAME else "atlas",
        description="Where in parameter space a gyrostat precesses regularly, rotates permanently or drifts.",
    )
    top.add_argument("--version", action="version", version=f"atlas {__version__}")
    commands = top.add_subparsers(title="commands", metavar="COMMAND", required=True, parser_class=Parser)
    for each in (
        scenes.run_scene,
        scenes.extend_atlases,
        scenes.print_status,
        scenes.join_folder,
        scenes.check_scene,
        scenes.print_schema,
        atlases.label_points_of_file,
        atlases.print_comparison,
        atlases.draw_map,
        atlases.draw_trajectory,
        scenes.copy_example,
        scenes.list_kernels,
        *extension.every("commands"),
    ):
        each.add(commands)
    top.epilog = (
        "Exit codes: 0 done, 1 failed, 2 bad input, 75 out of time (--stop-after, SIGUSR1, SIGUSR2, SIGXCPU), 129 hung up,"
        f" 130 interrupted, 143 terminated (SIGTERM){printable(extension.not_loaded(), MAX_MESSAGE)}."
    )
    return top
