"""Errors that the command line answers with one line and exit code 2, and text that is safe to print."""

from __future__ import annotations

import reprlib

MAX_MESSAGE = 1000  # characters of a message
MAX_TEXT = 200  # characters of a value in a message


class BadInput(ValueError):
    """Invalid input of the user, in one line: which key, what was found, what is allowed.

    Keys and values may come from a stranger's file: the message is made `printable` and at most MAX_MESSAGE
    characters long.
    """

    def __init__(self, message: object = "") -> None:
        super().__init__(printable(str(message), MAX_MESSAGE))


def printable(text: str, limit: int | None = None) -> str:
    """Text in one line without control characters.

    Parameters
    ----------
    text : str
        Any text, also of a file that is not trusted.
    limit : int, optional
        Largest length of the result: a longer text loses its middle.

    Returns
    -------
    str
        Line breaks, escape sequences, marks that change the direction of writing and all else that
        is not printable are replaced by their escapes, such as ``\\n`` and ``\\x1b``.
    """
    if limit is not None:
        text = _shortened(text, limit)
    if not text.isprintable():
        text = "".join(c if c.isprintable() else ascii(c)[1:-1] for c in text)
    return text if limit is None else _shortened(text, limit)


def _shortened(text: str, limit: int) -> str:
    """The beginning and the end of a text that is too long."""
    if len(text) <= limit:
        return text
    tail = (limit - 5) // 3
    return f"{text[: limit - 5 - tail]} ... {text[len(text) - tail :]}"


def shown(value: object) -> str:
    """A value as a message shows it: its repr, shortened.

    Parameters
    ----------
    value : object
        Any value of a scene file or an argument, however long or deeply nested.

    Returns
    -------
    str
        One printable line of at most MAX_TEXT characters.
    """
    text = _SHORT.repr(value)
    return printable(" ".join(text.split()) if "\n" in text else text, MAX_TEXT)


class _Short(reprlib.Repr):
    """Short reprs that need little time for long and deeply nested values."""

    def repr_int(self, x: int, level: int) -> str:
        """Digits of an integer; only their approximate number where Python refuses to print them."""
        return (
            repr(x)
            if x.bit_length() < 600
            else f"an integer of {x.bit_length() * 30103 // 100000 + 1} digits"
        )


_SHORT = _Short()
_SHORT.maxstring = _SHORT.maxother = 120
_SHORT.maxlevel = 3
