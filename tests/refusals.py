"""Assertions about every answer to wrong input, in Python and in the shell.

Rows of inputs and sentences are in `test_refusals` for the core, and in the tests of each extension.
"""

import re
import shlex
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from atlas import BadInput
from atlas.cli import main


def matches(message: str, sentence: str) -> bool:
    """Whether a message is the sentence, in which "..." stands for any text."""
    return re.fullmatch(".*".join(map(re.escape, sentence.split("..."))), message) is not None


@contextmanager
def unchanged_folder() -> Iterator[None]:
    """Context that asserts, at its end, that the current folder has the same files and folders with the same bytes."""

    def content() -> dict[Path, bytes]:
        return {path: path.read_bytes() if path.is_file() else b"" for path in Path().rglob("*")}

    before = content()
    yield
    assert content() == before


def assert_refused(call: Callable[[], object], sentence: str) -> None:
    """Assert that a call raises BadInput with this sentence, in one line."""
    with pytest.raises(BadInput) as error:
        call()
    message = str(error.value)
    assert matches(message, sentence), message
    assert message.isprintable()


def assert_refused_in_shell(command: str, sentence: str, capsys: pytest.CaptureFixture[str]) -> None:
    """Assert that a command answers with this sentence, in one line, and exit code 2, and changes no file."""
    capsys.readouterr()
    with unchanged_folder():
        try:
            code = main(shlex.split(command))
        except SystemExit as stop:  # raised by the parser of the options
            code = stop.code
    printed = capsys.readouterr()
    assert code == 2
    assert printed.out == ""
    (line,) = printed.err.splitlines()
    assert matches(line, sentence if sentence.startswith("atlas ") else f"atlas: {sentence}"), line
    assert line.isprintable()
