"""Errors that the command line answers with one line and exit code 2."""


class BadInput(ValueError):
    """Invalid input of the user, in one line: which key, what was found, what is allowed."""
