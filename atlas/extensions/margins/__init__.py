"""Errors of the borders of maps, and distances of points from the borders."""

from ...extension import Extension

EXTENSION = Extension(
    "margins",
    __name__,
    "errors of the borders of maps, and distances of points from the place where a flag changes",
    questions={"border_error": "border_error:border_error", "margin": "margin:margin"},
)
