"""Figures 1-20 of Amer, Abo Essa, Ibrahim & Amer 2013 drawn anew, and verdicts on the claims about them."""

from atlas.extension import Extension

EXTENSION = Extension(
    "amer2013_figures",
    __name__,
    "figures and claims of Amer et al. as printed, corrected and exact",
    commands={"amer2013_figures": "commands:draw_figures"},
)
