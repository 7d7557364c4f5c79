"""The sense of each precession as a label: the record of the extension, which imports nothing else."""

from atlas.extension import Extension

EXTENSION = Extension(
    "precession_sense", __name__, "sense of precessions", instruments={"precession_sense": "sense:SENSE"}
)
