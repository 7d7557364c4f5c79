"""Texts of users, from files or standard input."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TextIO

from ..errors import BadInput

MAX_CHARACTERS = 6_000_000  # of a scene


@contextmanager
def open_text(path: Path | None) -> Iterator[TextIO]:
    """Open a file in UTF-8, or standard input, for reading; BadInput if it cannot be read, also while it is."""
    name = path or "standard input"
    if path is None and sys.__stdin__ is None:  # its number may be that of another file now
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
    """Text in UTF-8, cut where it is longer than a scene may be, as of a device; BadInput if it cannot be read."""
    with open_text(path) as file:
        return file.read(MAX_CHARACTERS + 1)
