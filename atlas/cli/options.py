"""Options that several commands share, and their parser."""

from __future__ import annotations

import argparse
import inspect
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, NoReturn, TypeAlias

from ..errors import MAX_MESSAGE, BadInput, allowed_text, printable, say, shown
from ..extension import available_text
from ..files import FIGURES, check_name, without_suffix, writable
from ..scene.checks import quantity
from ..scene.text import read_text
from ..store.finished import FILE, suffixes

if TYPE_CHECKING:
    from ..scene.model import Scene

STANDARD_INPUT = "-"
DONE, FAILED, BAD_INPUT = 0, 1, 2  # exit codes
FILES = (*FIGURES, FILE, ".csv")

Text: TypeAlias = str | Callable[[], str]  # a help text, or a function if extensions add to the text
Handler = Callable[[argparse.Namespace], int | None]  # returns an exit code, or None for DONE
Commands: TypeAlias = "argparse._SubParsersAction[Parser]"


class Parser(argparse.ArgumentParser):
    """Parser that reports errors in one line, and has options that may be repeated or take several values."""

    def __init__(self, *arguments: Any, **settings: Any):
        super().__init__(*arguments, **settings)
        self._several: dict[str, Callable[[str], bool]] = {}

    def add_argument(self, *names: str, belongs: Callable[[str], bool] | None = None, **settings: Any) -> Any:
        """Add an argument as argparse does. An option with `belongs` takes the following words up to a word that does not belong."""
        if belongs is not None:
            settings["action"] = "append"
            self._several |= dict.fromkeys(names, belongs)
        return super().add_argument(*names, **settings)

    def parse_known_args(self, args: Any = None, namespace: Any = None) -> Any:
        """Parse the words of a command line, as `argparse.ArgumentParser` does."""
        return super().parse_known_args(self._repeated(sys.argv[1:] if args is None else args), namespace)

    def _repeated(self, words: Sequence[str]) -> list[str]:
        """Return `words`, but repeat the name of an option that takes several values before each of these values."""
        repeated: list[str] = []
        option, first = None, False
        for i, word in enumerate(words):
            name, equals, _ = word.partition("=")
            if word == "--":
                return [*repeated, *words[i:]]
            if name in self._several:
                option, first = name, not equals
            elif first:
                first = False
            elif option is not None and not word.startswith("-") and self._several[option](word):
                repeated.append(option)
            else:
                option = None
            repeated.append(word)
        return repeated

    def _check_value(self, action: argparse.Action, value: Any) -> None:
        if action.choices is not None and value not in action.choices:
            # Unlike other choices, a command may be missing because its extension cannot be loaded.
            is_command = isinstance(action, argparse._SubParsersAction)
            allowed = (available_text if is_command else allowed_text)(value, list(action.choices))
            raise argparse.ArgumentError(action, f"{shown(value)}: {allowed}")

    def error(self, message: str) -> NoReturn:
        """Print a message in one line and exit with the code of bad input. The message may quote any argument."""
        say(printable(f"{self.prog}: {message} (see {self.prog} --help)", MAX_MESSAGE), file=sys.stderr)
        self.exit(BAD_INPUT)


Argument: TypeAlias = tuple[tuple[str, ...], dict[str, Any]]


def argument(*names: str, **settings: Any) -> Argument:
    """Return names and settings for `Parser.add_argument`. The setting `help` is a Text, and `lowest` is the lowest allowed number."""
    return names, settings


@dataclass(frozen=True)
class Command:
    """Shell command. The docstring of the command's handler describes the command."""

    name: str
    arguments: tuple[Argument | list[Argument], ...]  # the arguments in a list exclude each other
    handler: Handler

    def add(self, commands: Commands) -> None:
        """Add the command to the command line."""
        description = inspect.getdoc(self.handler) or f"{self.name}."
        text = description[0].lower() + description[1:].removesuffix(".")
        parser = commands.add_parser(self.name, help=text, description=description)
        parser.set_defaults(handler=self.run)
        for each in self.arguments:
            group = parser.add_mutually_exclusive_group() if isinstance(each, list) else parser
            for names, settings in each if isinstance(each, list) else [each]:
                usual = {k: v for k, v in settings.items() if k not in ("lowest", "help")}
                about: Text | None = settings.get("help")
                group.add_argument(*names, help=about() if callable(about) else about, **usual)

    def run(self, options: argparse.Namespace) -> int:
        """Run the handler and return the exit code. Raise BadInput for an empty text or a number that is too small."""
        for each in self.arguments:
            for (*_, name), settings in each if isinstance(each, list) else [each]:
                value = getattr(options, settings.get("dest", name.lstrip("-").replace("-", "_")))
                if "" in (value if isinstance(value, list) else [value]):
                    raise BadInput(f"{name if name[0] == '-' else settings['metavar']}: must not be empty")
                if value is not None and value < settings.get("lowest", value):
                    raise BadInput(f"{name} {value}: must be at least {settings['lowest']}")
        return self.handler(options) or DONE


def command(name: str, *arguments: Argument | list[Argument]) -> Callable[[Handler], Command]:
    """Return a decorator that makes a function the handler of a command."""
    return partial(Command, name, arguments)


def out_options(
    metavar: str, text: Text, *, replaces: str = "an existing file", **settings: Any
) -> tuple[Argument, Argument]:
    """Return the option for the output file and the option that allows replacing a file."""
    return (
        argument("-o", "--out", metavar=metavar, help=text, **settings),
        argument("--force", action="store_true", help=f"replace {replaces}"),
    )


def option_with_default(
    name: str, metavar: str, default: float | str, text: str, **settings: Any
) -> Argument:
    """Return an option whose help shows the default."""
    text = f"{text} (default: {default})"
    return argument(name, type=type(default), default=default, metavar=metavar, help=text, **settings)


def assignment_option(name: str, metavar: str, text: str) -> Argument:
    """Return an option that takes any number of assignments NAME=VALUE."""
    return argument(name, belongs=lambda word: "=" in word, default=[], metavar=metavar, help=text)


SCENE = argument("scene", metavar="SCENE", help="scene file (TOML), - for standard input")
ATLAS = argument("atlas", metavar="ATLAS", help=f"atlas file ({FILE}) or run folder")
RUN_FOLDER = argument("folder", metavar="RUN", help="run folder")
THREADS = argument("--threads", type=int, metavar="N", lowest=1, help="processors to use (default: all)")
DEGREES = argument("--degrees", default=None, action="store_true", help="angles in degrees")
QUIET = argument("--quiet", action="store_true", help="print no progress")
VERBOSE = argument("--verbose", action="store_true", help="print errors, checks and times of the run too")


def read_scene(name: str) -> Scene:
    """Return the scene in a file or in standard input."""
    from ..scene.read import load_scene, parse_scene

    return parse_scene(read_text(None), folder=Path()) if name == STANDARD_INPUT else load_scene(name)


def default_name(scene: str) -> str:
    """Return the name, without suffix, of the outputs of a scene, such as k3_0.5 for k3_0.5.toml."""
    return "scene" if scene == STANDARD_INPUT else without_suffix(scene, ".toml", *suffixes()).name


def input_files(scene: str) -> list[Path]:
    """Return the input files of a scene, which are the scene file and its file of points."""
    from ..scene.points import file_of

    return [] if scene == STANDARD_INPUT else [Path(scene), *file_of(Path(scene))]


def output_folder(name: str, files: Sequence[str], *, force: bool) -> Path:
    """Create the folder for output files. Raise BadInput if one of the files must not be written."""
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

    for file in files:
        writable(folder / file, (Path(file).suffix,), force=True)
    return folder


def assignments(option: str, texts: Sequence[str], form: str) -> dict[str, str]:
    """Return the VALUE of each NAME from texts NAME=VALUE. An error message gives `form` as the allowed form."""
    values: dict[str, str] = {}
    for text in texts:
        name, equals, value = text.partition("=")
        if not (name and equals):
            raise BadInput(f"{option} {text}: must be {form}")
        if name in values:
            raise BadInput(f"{option}: {name} is given twice")
        values[name] = value
    return values


def axis_values(option: str, texts: Sequence[str]) -> dict[str, float]:
    """Return the number VALUE of each AXIS from texts AXIS=VALUE."""
    form, values = 'AXIS=VALUE with a finite number, or arithmetic such as "60 * deg"', {}
    for name, text in assignments(option, texts, form).items():
        try:
            values[name] = quantity(name, text)
        except BadInput:
            raise BadInput(f"{option} {name}={text}: must be {form}") from None
    return values
