"""Line of a key in the text of a scene, for error messages that name file and line."""

from __future__ import annotations

import re
from dataclasses import dataclass

from ..errors import BadInput

MAX_KEY = 300  # characters of a line in which a key is looked for
_KEY = re.compile(r"[A-Za-z_][\w-]*(?:\.[\w-]+)*")
_HEADER = re.compile(r"\s*\[\[?\s*([^\[\]]+?)\s*\]\]?\s*(?:#.*)?$")
_ASSIGNMENT = re.compile(r"""\s*([\w."' -]+?)\s*=""")
_TOML_POSITION = re.compile(r" \(at (?:line (\d+), column \d+|end of document)\)")


@dataclass(frozen=True)
class Source:
    """The file that a scene was read from."""

    path: str  # as the user named it
    text: str

    def located(self, error: BadInput) -> BadInput:
        """The error with file and line before the key with which its message begins."""
        message = str(error)
        if message.startswith(self.path):
            return error
        key = _KEY.match(message)
        line = None if key is None else line_of(self.text, key[0])
        return self.at_line(line, message)

    def of_toml(self, message: str) -> BadInput:
        """The error for a message of the TOML parser, whose position comes before it."""
        position = _TOML_POSITION.search(message)
        line = int(position[1]) if position and position[1] else None
        message = f"not valid TOML: {_TOML_POSITION.sub('', message)}"
        if line is not None and line <= len(self.text.splitlines()):
            content = self.text.splitlines()[line - 1].partition("#")[0]
            if not content.isascii() and '"' not in content:
                message += "; names are ASCII letters, digits and _"
        return self.at_line(line, message)

    def at_line(self, line: int | None, message: str) -> BadInput:
        """An error with file and line; None: the line is not known."""
        return BadInput(f"{self.path}, line {line}: {message}" if line else f"{self.path}: {message}")


def line_of(text: str, key: str) -> int | None:
    """Line of a dotted key in a TOML text, counted from 1.

    text: the text, valid TOML; key: such as "axes.k3.count". Returns line of the key; if it is missing, that
    of the innermost table that contains it; None without any.
    """
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
    """A dotted key of a TOML text without quotes and blanks."""
    return ".".join(part.strip().strip("\"'") for part in key.split("."))
