"""Options and output that several commands share."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, NoReturn, TypeAlias

from ..errors import BadInput
from ..files import writable

DONE, FAILED, BAD_INPUT = 0, 1, 2  # exit codes
FIGURES = (".png", ".pdf", ".svg")

Handler = Callable[[argparse.Namespace], int]
Commands: TypeAlias = "argparse._SubParsersAction[Parser]"


class Parser(argparse.ArgumentParser):
    """A parser whose errors are one line."""

    def error(self, message: str) -> NoReturn:
        self.exit(BAD_INPUT, f"{self.prog}: {message} (see {self.prog} --help)\n")


def add_command(commands: Commands, name: str, handler: Handler, text: str) -> argparse.ArgumentParser:
    """A new command; text: what it does, in one line."""
    command = commands.add_parser(name, help=text, description=text[0].upper() + text[1:] + ".")
    command.set_defaults(handler=handler)
    return command


def scene_option(command: argparse.ArgumentParser) -> None:
    command.add_argument("scene", metavar="SCENE", help="scene file (TOML)")


def atlas_option(command: argparse.ArgumentParser) -> None:
    command.add_argument("atlas", metavar="ATLAS", help="atlas file (.nc) or run folder")


def out_option(command: argparse.ArgumentParser, metavar: str, text: str, **more: Any) -> None:
    command.add_argument("-o", "--out", metavar=metavar, help=text, **more)


def option_with_default(
    command: argparse._ActionsContainer, name: str, metavar: str, default: float | str, text: str
) -> None:
    """An option whose default its help shows."""
    command.add_argument(
        name, type=type(default), default=default, metavar=metavar, help=f"{text} (default: {default})"
    )


def threads_option(command: argparse.ArgumentParser) -> None:
    command.add_argument("--threads", type=int, metavar="N", help="processors to use (default: all)")


def force_option(command: argparse.ArgumentParser, what: str) -> None:
    command.add_argument("--force", action="store_true", help=f"replace {what}")


def quiet_option(command: argparse.ArgumentParser) -> None:
    command.add_argument("--quiet", action="store_true", help="print no progress")


def output_folder(name: str, files: Sequence[str], *, force: bool) -> Path:
    """Create the folder of some files, and check each of them as `writable`."""
    folder = Path(name)
    if folder.exists() and not folder.is_dir():
        raise BadInput(f"{folder}: not a folder")
    folder.mkdir(parents=True, exist_ok=True)
    for file in files:
        writable(folder / file, (Path(file).suffix,), force=force)
    return folder


def check_positive(option: str, value: int | None) -> None:
    """Raise BadInput for a number of threads or processes below 1."""
    if value is not None and value < 1:
        raise BadInput(f"{option} {value}: must be at least 1")


def axis_values(option: str, texts: Sequence[str]) -> dict[str, float]:
    """AXIS=VALUE options as numbers by axis."""
    values = {}
    for text in texts:
        name, _, value = text.partition("=")
        try:
            values[name] = float(value)
        except ValueError:
            raise BadInput(f"{option} {text}: must be AXIS=VALUE with a number") from None
    return values


def table(rows: Sequence[Sequence[str]]) -> str:
    """Rows of text, the first one the heading, as columns of equal width."""
    widths = [max(len(row[i]) for row in rows) for i in range(len(rows[0]))]
    lines = [
        "  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)).rstrip() for row in rows
    ]
    return "\n".join(lines)
