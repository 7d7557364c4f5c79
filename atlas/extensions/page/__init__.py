"""One HTML file that shows the map, the values and the motions of an atlas without a server."""

from ...extension import Extension

EXTENSION = Extension(
    "page",
    __name__,
    "one HTML file of an atlas, with its motions",
    questions={"page": "page:page", "widget": "widget:widget"},
    commands={"page": "commands:make_page"},
)
