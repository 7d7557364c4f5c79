"""Stability of steady motions in the full equations, by the normal form of degree 4."""

from ...extension import Extension

VARIABLES = ("nonlinear_stability", "birkhoff_c20", "birkhoff_c11", "birkhoff_c02", "birkhoff_determinant")
# The ratio of two frequencies counts as resonant if the ratio's magnitude differs from 1, 2 or 3 by less than RESONANCE_BAND.
RESONANCE_BAND = 1e-3

EXTENSION = Extension(
    "normal_form",
    __name__,
    "stability in the full equations, and the normal form of degree 4 that decides it",
    variables=dict.fromkeys(VARIABLES, "variables:normal_form"),
    lines=dict.fromkeys(VARIABLES, "lines:lines"),
    line_styles={"D = 0 of the normal form": "lines:STYLE"},
)
