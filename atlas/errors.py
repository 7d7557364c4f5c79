"""Errors that the command line answers with one line and exit code 2, and text that is safe to print."""

from __future__ import annotations

import difflib
import logging
import reprlib
import sys
import warnings
from collections.abc import Collection, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TextIO

MAX_MESSAGE = 1000  # largest number of characters of a message
MAX_TEXT = 200  # largest number of characters of a value in a message


class BadInput(ValueError):
    """Invalid input. The message is one printable line with the key, its value and the allowed values."""

    def __init__(self, message: object = "") -> None:
        super().__init__(printable(str(message), MAX_MESSAGE))


def printable(text: str, limit: int | None = None) -> str:
    r"""Return text in one line of at most `limit` characters. Escapes such as `\x1b` stand for characters that are not printable."""
    if limit is not None:
        text = _shorten(text, limit)
    if not text.isprintable():
        text = "".join(c if c.isprintable() else ascii(c)[1:-1] for c in text)
    return text if limit is None else _shorten(text, limit)


def _shorten(text: str, limit: int) -> str:
    """Return the beginning and the end of a text that is too long."""
    if len(text) <= limit:
        return text
    tail = (limit - 5) // 3
    return f"{text[: limit - 5 - tail]} ... {text[len(text) - tail :]}"


def say(*lines: str, file: TextIO | None = None) -> None:
    """Print each argument as one line; commands print by this function alone."""
    # Flush at once, because a process that exits ignores signals and could then wait for a reader for ever.
    stream = file or sys.stdout
    text = "\n".join(map(printable, lines))
    encoding = getattr(stream, "encoding", None) or "utf-8"
    print(text.encode(encoding, "backslashreplace").decode(encoding), file=stream, flush=True)


def attribute_text(
    attributes: Mapping[str, object], name: str, default: str = "", limit: int = MAX_TEXT
) -> str:
    """Return an attribute of a dataset or a variable as one `printable` line. Texts of attributes are read in no other way."""
    value = attributes.get(name, default)
    return printable(value, limit) if isinstance(value, str) else shown(value)


class _Printable(logging.Filter):
    """Filter that turns log messages into printable lines, because messages quote names of files and texts of libraries."""

    def filter(self, record: logging.LogRecord) -> bool:
        """Make the message of a record printable. No record is left out."""
        record.msg, record.args = printable(record.getMessage(), MAX_MESSAGE), ()
        return True


logging.getLogger("atlas").addFilter(_Printable())


def shown(value: object) -> str:
    """Return the repr of any value, however long or nested, in at most MAX_TEXT characters, for messages."""
    text = _SHORT.repr(value)
    return printable(" ".join(text.split()) if "\n" in text else text, MAX_TEXT)


def allowed_text(value: object, names: Collection[str]) -> str:
    """Return the end of a message, such as "did you mean 'tolerance'? allowed: tolerance, step". The question needs a similar name."""
    return f"{similar_text(value, names)}allowed: {', '.join(names) or 'none'}"


def similar_text(value: object, names: Collection[str]) -> str:
    """Return a question such as "did you mean 'tolerance'? ", which ends with a blank, or an empty text if no name is similar."""
    if isinstance(value, str) and len(value) <= MAX_TEXT:
        by_lower_case = {name.lower(): name for name in names}
        for similar in difflib.get_close_matches(value.lower(), by_lower_case, 1):
            return f"did you mean {by_lower_case[similar]!r}? "
    return ""


def failure_text(error: Exception) -> str:
    """Return the text of a system error. If the folder of a file is missing, the text names the folder."""
    folder = Path(str(getattr(error, "filename", None) or ".")).parent
    if isinstance(error, FileNotFoundError) and not folder.is_dir():
        return f"{folder}: this folder is not there any more: it was removed, renamed or unmounted"
    return str(error) or type(error).__name__


_in_shell = False


@contextmanager
def messages_for_shell() -> Iterator[None]:
    """While this context is open, `option` names options as the command line spells them."""
    global _in_shell
    before, _in_shell = _in_shell, True
    try:
        yield
    finally:
        _in_shell = before


def option(name: str, value: object) -> str:
    """Return an option as the user writes it, "select={'k3': 0.2}" in Python and "--select k3=0.2" in the shell."""
    if not _in_shell:
        if isinstance(value, Mapping):
            value = "{" + ", ".join(f"{key!r}: {each}" for key, each in value.items()) + "}"
        return f"{name}={value}"
    words = ["--" + name.replace("_", "-")]
    if isinstance(value, Mapping):
        words += [f"{key}={each}" for key, each in value.items()]
    elif value is not True:
        words.append(str(value))
    return " ".join(words)


def deprecated(what: str, instead: str, version: str) -> None:
    """Warn that `version` removes `what`, and name what to use instead. In Python the warning points to the line that called atlas."""
    message = f"{what} is deprecated, and version {version} removes it: use {instead}"
    if _in_shell:
        logging.getLogger("atlas").warning(message)
        return
    frame, level = sys._getframe(1), 2
    while frame.f_back and frame.f_globals.get("__name__", "").partition(".")[0] == "atlas":
        frame, level = frame.f_back, level + 1
    warnings.warn(message, FutureWarning, stacklevel=level)


class _Short(reprlib.Repr):
    """Short reprs that need little time for long and deeply nested values."""

    def repr_instance(self, x: object, level: int) -> str:
        """Show a NumPy scalar as a plain number."""
        if getattr(x, "shape", None) == () and hasattr(x, "item"):
            return repr(x.item())
        return super().repr_instance(x, level)

    def repr_int(self, x: int, level: int) -> str:
        """Show an integer by its digits. Python may refuse to print a long integer, which is shown by the number of its digits."""
        if x.bit_length() < 600:
            return repr(x)
        return f"an integer of {x.bit_length() * 30103 // 100000 + 1} digits"


_SHORT = _Short()
_SHORT.maxstring = _SHORT.maxother = 120
_SHORT.maxlevel = 3


def one_line(error: Exception) -> str:
    """Return the message of an error in one line of at most 200 characters."""
    return " ".join(str(error).split())[:200]


def text_table(rows: Sequence[Sequence[str]], *, right: bool = False) -> str:
    """Return rows of cells as lines with aligned columns. If `right` is true, all columns but the first are aligned on the right."""
    signs = ["<", *(">" if right else "<" for _ in rows[0][1:])]
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    form = "  ".join(f"{{:{sign}{width}}}" for sign, width in zip(signs, widths, strict=True))
    return "\n".join(form.format(*row).rstrip() for row in rows)
