"""Yehia & El-kenani 2021: the magnetised satellite-gyrostat on a circular orbit."""

from ...extension import Extension

EXTENSION = Extension(
    "yehia2021",
    __name__,
    "equations of Yehia & El-kenani as printed and as true",
    needs=("catalogue",),
    published={"satellite": "published:PUBLISHED"},
)
