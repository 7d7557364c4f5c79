"""Equations of a system from its Lagrangian."""

from ...extension import Extension

EXTENSION = Extension(
    "lagrangian",
    __name__,
    "modules of equations written from a Lagrangian",
    functions={"systems.from_lagrangian": "lagrangian:from_lagrangian"},
)
