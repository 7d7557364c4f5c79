"""Poincaré sections, which are the points where motions cross a surface in one direction."""

from ...extension import Extension

EXTENSION = Extension(
    "sections",
    __name__,
    "Poincaré sections of motions, and figures of them",
    functions={"section": "section:section"},
    questions={"section_map": "figure:section_map"},
    commands={"section": "commands:draw_section"},
)
