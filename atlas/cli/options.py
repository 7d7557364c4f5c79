"""Options and output that several commands share."""

from __future__ import annotations

import argparse
import math
import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, NoReturn, TypeAlias

from ..errors import MAX_MESSAGE, BadInput, printable, say
from ..files import check_name, without_suffix

if TYPE_CHECKING:
    from ..scene.model import Scene

SECOND_NAME = "precession-atlas"
STANDARD_INPUT = "-"
DONE, FAILED, BAD_INPUT = 0, 1, 2  # exit codes
FIGURES = (".png", ".pdf", ".svg")
FILES = (*FIGURES, ".nc", ".csv")

Handler = Callable[[argparse.Namespace], int]
Commands: TypeAlias = "argparse._SubParsersAction[Parser]"


class Parser(argparse.ArgumentParser):
    """A parser whose errors are one line, and with options that may be repeated or take several values."""

    def __init__(self, *arguments: Any, **more: Any):
        super().__init__(*arguments, **more)
        self._several: dict[str, Callable[[str], bool]] = {}

    def add_several(self, *names: str, belongs: Callable[[str], bool], **more: Any) -> None:
        """Add an option for several words that `belongs` accepts: `--at a=1 b=2`, or `--at a=1 --at b=2`.

        Other words are not taken from the positional arguments, as argparse would.
        """
        self.add_argument(*names, action="append", **more)
        self._several |= dict.fromkeys(names, belongs)

    def parse_known_args(self, args: Any = None, namespace: Any = None) -> Any:
        """Parse the words of a command line, as `argparse.ArgumentParser`."""
        return super().parse_known_args(self._repeated(sys.argv[1:] if args is None else args), namespace)

    def _repeated(self, words: Sequence[str]) -> list[str]:
        """Words of the command line with such an option repeated before each of its values."""
        repeated: list[str] = []
        option, first = None, False
        for i, word in enumerate(words):
            name, equals, _ = word.partition("=")
            if word == "--":
                return [*repeated, *words[i:]]
            if name in self._several:
                option, first = name, not equals
            elif option is not None and not first:
                if word.startswith("-") or not self._several[option](word):
                    option = None
                else:
                    repeated.append(option)
            else:
                first = False
            repeated.append(word)
        return repeated

    def error(self, message: str) -> NoReturn:
        """Print a message, which may quote any argument, in one line and exit with the code of bad input."""
        say(printable(f"{self.prog}: {message} (see {self.prog} --help)", MAX_MESSAGE), file=sys.stderr)
        self.exit(BAD_INPUT)


def add_command(commands: Commands, name: str, handler: Handler, text: str) -> Parser:
    """A new command; text: what it does, in one line."""
    command = commands.add_parser(name, help=text, description=text[0].upper() + text[1:] + ".")
    command.set_defaults(handler=handler)
    return command


def program() -> str:
    """Name under which the command was called: `atlas`, or its second name."""
    name = Path(sys.argv[0]).name
    return name if name == SECOND_NAME else "atlas"


def scene_option(command: argparse.ArgumentParser) -> None:
    """The positional argument SCENE."""
    command.add_argument("scene", metavar="SCENE", help="scene file (TOML), - for standard input")


def read_scene(name: str) -> Scene:
    """The scene of a file, or of standard input."""
    from ..scene.read import load_scene, parse_scene

    return parse_scene(read_input(), folder=Path()) if name == STANDARD_INPUT else load_scene(name)


def read_input() -> str:
    """All text of standard input; BadInput if it is not in UTF-8."""
    try:
        return sys.stdin.buffer.read().decode("utf-8-sig")
    except UnicodeDecodeError:
        raise BadInput("standard input: not text in UTF-8") from None


def default_name(scene: str) -> str:
    """Name of the outputs of a scene, without suffix: k3_0.5 of k3_0.5.toml."""
    return "scene" if scene == STANDARD_INPUT else without_suffix(scene, ".toml", ".nc", ".zarr").name


def input_files(scene: str) -> list[Path]:
    """The files that a scene is read from: its own, and its file of points."""
    from ..scene.points import file_of

    return [] if scene == STANDARD_INPUT else [Path(scene), *file_of(Path(scene))]


def atlas_option(command: argparse.ArgumentParser) -> None:
    """The positional argument ATLAS."""
    command.add_argument("atlas", metavar="ATLAS", help="atlas file (.nc) or run folder")


def assignment_option(command: Parser, name: str, metavar: str, text: str) -> None:
    """An option for NAME=VALUE, any number of times."""
    command.add_several(name, belongs=lambda word: "=" in word, default=[], metavar=metavar, help=text)


def out_option(command: argparse.ArgumentParser, metavar: str, text: str, **more: Any) -> None:
    """The option for the output."""
    command.add_argument("-o", "--out", metavar=metavar, help=text, **more)


def option_with_default(
    command: argparse._ActionsContainer, name: str, metavar: str, default: float | str, text: str
) -> None:
    """An option whose default its help shows."""
    command.add_argument(
        name, type=type(default), default=default, metavar=metavar, help=f"{text} (default: {default})"
    )


def threads_option(command: argparse.ArgumentParser) -> None:
    """The option for the number of processors."""
    command.add_argument("--threads", type=int, metavar="N", help="processors to use (default: all)")


def force_option(command: argparse.ArgumentParser, what: str) -> None:
    """The option that allows to replace files; what: their description in the help."""
    command.add_argument("--force", action="store_true", help=f"replace {what}")


def quiet_option(command: argparse.ArgumentParser) -> None:
    """The option that switches the progress off."""
    command.add_argument("--quiet", action="store_true", help="print no progress")


def output_folder(name: str, files: Sequence[str], *, force: bool) -> Path:
    """Create the folder of some files, and check each of them as `writable`."""
    folder = Path(name)
    check_name(folder)
    if folder.exists() and not folder.is_dir():
        raise BadInput(f"{folder}: not a folder")
    if folder.suffix.lower() in FILES and not folder.is_dir():
        raise BadInput(f"{folder}: must be a folder, but its name ends like that of a file")
    existing = [file for file in files if (folder / file).exists()]
    if existing and not force:
        raise BadInput(f"{folder}: these files exist; --force replaces them: {', '.join(existing)}")
    folder.mkdir(parents=True, exist_ok=True)
    from ..io import netcdf

    for file in files:
        netcdf.writable(folder / file, (Path(file).suffix,), force=True)
    return folder


def check_at_least(option: str, value: int | None, lowest: int) -> None:
    """Raise BadInput for a number that is too small."""
    if value is not None and value < lowest:
        raise BadInput(f"{option} {value}: must be at least {lowest}")


def axis_values(option: str, texts: Sequence[str]) -> dict[str, float]:
    """AXIS=VALUE options as numbers by axis."""
    values: dict[str, float] = {}
    for text in texts:
        name, _, value = text.partition("=")
        if name in values:
            raise BadInput(f"{option}: {name} is given twice")
        try:
            values[name] = float(value)
        except ValueError:
            values[name] = math.nan
        if not math.isfinite(values[name]):
            raise BadInput(f"{option} {text}: must be AXIS=VALUE with a finite number")
    return values
