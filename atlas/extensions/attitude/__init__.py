"""Inertia tensors, attitudes and angular velocities as start values, and attitudes along motions."""

from ...extension import Extension

EXTENSION = Extension(
    "attitude",
    __name__,
    "inertia tensors, attitudes and angular velocities as start values, and attitudes along motions",
    functions={"principal": "attitude:principal", "start": "attitude:start"},
    questions={"attitude": "attitude:attitude"},
)
