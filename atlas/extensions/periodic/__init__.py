"""Families of periodic motions, from a steady motion to their end."""

from ...extension import Extension

EXTENSION = Extension(
    "periodic",
    __name__,
    "families of periodic motions that are born from a steady motion, their stability, bifurcations and ends",
    needs=("attitude",),
    functions={"periodic": "periodic:periodic"},
    questions={"periodic_diagram": "figure:periodic_diagram"},
    commands={"periodic": "commands:draw_families"},
)
