"""Kinetic energy at the start of each motion: the record of the extension, which imports nothing else."""

from atlas.extension import Extension

EXTENSION = Extension(
    "start_energy",
    __name__,
    "kinetic energy at the start",
    variables={"start_energy": "energy:variables"},
    questions={"energy_range": "energy:energy_range"},
    lines={"start_energy": "energy:lines"},
)
