"""Tables of families of steady motions, and of papers that are compared with the equations of motion."""

from ...extension import Extension

EXTENSION = Extension(
    "catalogue",
    __name__,
    "tables of families of steady motions, and of equations and numbers that papers print",
    functions={"conditions": "tables:conditions"},
    commands={"conditions": "commands:print_conditions"},
)
