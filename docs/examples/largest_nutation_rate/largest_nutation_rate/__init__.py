"""The largest |theta'| of each motion as a statistic: the record of the extension, which imports nothing else."""

from atlas.extension import Extension

EXTENSION = Extension(
    "largest_nutation_rate", __name__, "largest rate of nutation", instruments={"theta_dot_max": "rate:RATE"}
)
