"""Strongest lines in the spectra of motions."""

from ...extension import Extension

EXTENSION = Extension(
    "frequencies",
    __name__,
    "strongest lines in the spectra of motions",
    questions={"frequencies": "spectrum:frequencies"},
)
