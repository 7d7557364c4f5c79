"""Names of Greek letters and of mathematical functions in LaTeX. The function `escaped` escapes the special characters of a text."""

from __future__ import annotations

import re

GREEK = (
    "alpha", "beta", "gamma", "delta", "epsilon", "zeta", "eta", "theta", "iota", "kappa", "lambda", "mu", "nu",
    "xi", "pi", "rho", "sigma", "tau", "upsilon", "phi", "chi", "psi", "omega", "Gamma", "Delta", "Theta", "Lambda",
    "Xi", "Pi", "Sigma", "Upsilon", "Phi", "Psi", "Omega",
)  # fmt: skip
FUNCTIONS = ("sin", "cos", "tan", "log", "exp", "ln")


def escaped(text: str) -> str:
    """Return a text with the special characters of LaTeX escaped. Braces stay in pairs, because BibTeX needs pairs."""
    return re.sub(r"[\\^~<>|_&%#${}]", lambda sign: _SIGNS.get(sign[0], f"\\{sign[0]}"), text)


_SIGNS = {"\\": "textbackslash", "^": "textasciicircum", "~": "textasciitilde", "<": "textless"}
_SIGNS |= {">": "textgreater", "|": "textbar", "{": "textbraceleft", "}": "textbraceright"}
_SIGNS = {sign: rf"\{name}{{}}" for sign, name in _SIGNS.items()}
