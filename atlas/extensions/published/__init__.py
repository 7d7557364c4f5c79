"""Published numbers, compared with numbers that the package computes."""

from ...extension import Extension

EXTENSION = Extension(
    "published",
    __name__,
    "numbers of others, compared with those of the package",
    needs=("catalogue",),
    published_numbers=dict.fromkeys(("satellite", "fixed_point"), "numbers:compared"),
)
