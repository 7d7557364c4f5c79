"""Text read from files or standard input, and error messages that name the line of a scene."""

from __future__ import annotations

import re
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TextIO

from ..errors import BadInput

MAX_CHARACTERS = 6_000_000  # largest number of characters of a scene
MAX_KEY = 300  # largest number of characters of a line that are searched for a key
_KEY = re.compile(r"[A-Za-z_][\w-]*(?:\.[\w-]+)*")
_HEADER = re.compile(r"\s*\[\[?\s*([^\[\]]+?)\s*\]\]?\s*(?:#.*)?$")
_ASSIGNMENT = re.compile(r"""\s*([\w."' -]+?)\s*=""")
# Hints for lines that the TOML parser cannot read, by a pattern of the line.
_TOML_HINTS = {
    r"^[^\"]*[^\x00-\x7f][^\"]*$": "names are ASCII letters, digits and _",
    r"=\s*(True|False)\b": "true and false have small letters",
    r"=\s*[-+]?\d+,\d": "the decimal sign is a point",
    r"\{[^{}]*,\s*\}": "no comma follows the last key of a table in braces",
    r"\{[^{}]*$": "a table in braces stands in one line",
    r"=\s*[^\s\"'=\[{]*\s*[A-Za-z*/(^]": 'texts and arithmetic are quoted, such as "sigma * A"',
}
_TOML_POSITION = re.compile(r" \(at (?:line (\d+), column \d+|end of document)\)")


@contextmanager
def open_text(path: Path | None) -> Iterator[TextIO]:
    """Open a file in UTF-8, or standard input if `path` is None. Raise BadInput if the file cannot be opened or read."""
    name = path or "standard input"
    if path is None and sys.__stdin__ is None:  # Standard input is closed. Descriptor 0 may be another file.
        raise BadInput(f"{name}: is closed")
    try:
        with open(path or 0, encoding="utf-8-sig", closefd=path is not None) as file:
            yield file
    except FileNotFoundError:
        raise BadInput(f"{name}: there is no such file") from None
    except IsADirectoryError:
        raise BadInput(f"{name}: this is a folder") from None
    except UnicodeDecodeError:
        raise BadInput(f"{name}: not text in UTF-8") from None
    except OSError as error:
        raise BadInput(f"{name}: cannot be read: {error.strerror}") from None


def read_text(path: Path | None) -> str:
    """Return at most MAX_CHARACTERS + 1 characters of a text in UTF-8, because a file such as /dev/zero has no end."""
    with open_text(path) as file:
        return file.read(MAX_CHARACTERS + 1)


@dataclass(frozen=True)
class Source:
    """The file that a scene was read from."""

    path: str  # the path as given by the user
    text: str

    def located(self, error: BadInput) -> BadInput:
        """Return the error with the file in front. If the message begins with a key, the line of the key stands in front as well."""
        message = str(error)
        if message.startswith(self.path):
            return error
        key = _KEY.match(message)
        line = None if key is None else line_of(self.text, key[0])
        return self.at_line(line, message)

    def of_toml(self, message: str) -> BadInput:
        """Return a BadInput for a message of the TOML parser, with file and line in front and a hint at the end."""
        position = _TOML_POSITION.search(message)
        line = int(position[1]) if position and position[1] else None
        message = f"not valid TOML: {_TOML_POSITION.sub('', message)}"
        if line is not None and line <= len(self.text.splitlines()):
            content = self.text.splitlines()[line - 1].partition("#")[0]
            hints = [hint for pattern, hint in _TOML_HINTS.items() if re.search(pattern, content[:MAX_KEY])]
            message = "; ".join([message, *hints[:1]])
        return self.at_line(line, message)

    def at_line(self, line: int | None, message: str) -> BadInput:
        """Return a BadInput with the file, and the line if known, in front of the message."""
        return BadInput(f"{self.path}, line {line}: {message}" if line else f"{self.path}: {message}")


def line_of(text: str, key: str) -> int | None:
    """Return the line, counted from 1, of a dotted key in a TOML text, or of the innermost table around the key, or None."""
    lines: dict[str, int] = {}
    table = ""
    for number, whole_line in enumerate(text.splitlines(), 1):
        line = whole_line[:MAX_KEY]
        if header := _HEADER.match(line):
            table = _plain(header[1])
            lines.setdefault(table, number)
        elif assignment := _ASSIGNMENT.match(line):
            name = _plain(assignment[1])
            lines.setdefault(f"{table}.{name}" if table else name, number)
    while key:
        if key in lines:
            return lines[key]
        within = [number for name, number in lines.items() if name.startswith(f"{key}.")]
        if within:
            return min(within)
        key = key.rpartition(".")[0]
    return None


def _plain(key: str) -> str:
    """Return a dotted key of a TOML text without quotes and blanks."""
    return ".".join(part.strip().strip("\"'") for part in key.split("."))
