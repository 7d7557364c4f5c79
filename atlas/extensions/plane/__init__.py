"""Librations and rotations of a satellite in the plane of its orbit."""

from ...extension import Extension

EXTENSION = Extension(
    "plane",
    __name__,
    "librations and rotations in the plane of the orbit: families, their stability, period and multipliers",
    variables=dict.fromkeys(("plane_period", "plane_trace", "plane_second"), "variables:variables"),
    families=dict.fromkeys(("plane_libration", "plane_rotation"), "families:families"),
)
