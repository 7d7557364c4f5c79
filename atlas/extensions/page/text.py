"""Split texts with formulas into runs, which are pieces of equal style. A page shows the runs without a mathematical typesetter."""

from __future__ import annotations

import re
import unicodedata
from typing import Any

from ...analysis.latex import FUNCTIONS, GREEK

Run = dict[str, Any]

_COMMANDS = {
    "varphi": "\N{GREEK SMALL LETTER PHI}",
    "phi": "\N{GREEK PHI SYMBOL}",
    "epsilon": "\N{GREEK LUNATE EPSILON SYMBOL}",
    "varepsilon": "\N{GREEK SMALL LETTER EPSILON}",
    "ell": "\N{SCRIPT SMALL L}",
    "cdot": "\N{MIDDLE DOT}",
    "times": "\N{MULTIPLICATION SIGN}",
    "pm": "\N{PLUS-MINUS SIGN}",
    "infty": "\N{INFINITY}",
}
for _name in GREEK:
    _case = "CAPITAL" if _name[0].isupper() else "SMALL"
    _letter = _name.upper().replace("LAMBDA", "LAMDA")  # Unicode writes LAMDA
    _COMMANDS.setdefault(_name, unicodedata.lookup(f"GREEK {_case} LETTER {_letter}"))
_SPACES = {",": "\u2009", " ": " ", ";": "\u2005", ":": "\u2005", "!": "", "quad": "\u2003"}
_ACCENTS = {
    "dot": "\u0307",
    "ddot": "\u0308",
    "hat": "\u0302",
    "bar": "\u0304",
    "tilde": "\u0303",
    "vec": "\u20d7",
}
_FONTS = ("mathrm", "mathbf", "mathit", "text", "rm")
_TOKEN = re.compile(r"\\[A-Za-z]+|\\.|[{}_^]|\s+|[^\\{}_^\s]", re.DOTALL)
_SUPERSCRIPTS = str.maketrans("0123456789-\N{MINUS SIGN}+", "⁰¹²³⁴⁵⁶⁷⁸⁹⁻⁻⁺")
_SUBSCRIPTS = str.maketrans("0123456789", "₀₁₂₃₄₅₆₇₈₉")
RAISED, LOWERED = 1, -1


def text_runs(text: str) -> list[Run]:
    r"""Return the pieces of equal style (runs) in a text such as "$\theta_0$ (rad s$^{-1}$)", which is in Matplotlib's notation.

    A run has the keys "t" (letters), "i" (true if italic) and "s" (1 raised, -1 lowered). An unknown command such as \foo becomes foo.
    """
    parts = text.split("$")
    if len(parts) % 2 == 0:  # an unpaired dollar sign begins no formula
        return [{"t": text}]
    result: list[Run] = []
    for number, part in enumerate(parts):
        if number % 2:
            _Formula(_TOKEN.findall(part), result).group(0, "")
        elif part:
            _append(result, part, False, 0)
    return result


def plain(text: str) -> str:
    """Return a text with formulas as one line of Unicode, for menus and screen readers."""
    pieces = []
    for run in text_runs(text):
        table = {RAISED: _SUPERSCRIPTS, LOWERED: _SUBSCRIPTS}.get(run.get("s", 0), {})
        pieces.append(run["t"].translate(table))
    return "".join(pieces)


def _append(result: list[Run], text: str, italic: bool, shift: int) -> None:
    """Append `text` to the last run if that run has the same style. Otherwise append a new run."""
    style = ({"i": True} if italic else {}) | ({"s": shift} if shift else {})
    if result and {k: v for k, v in result[-1].items() if k != "t"} == style:
        result[-1]["t"] += text
    elif text:
        result.append({"t": text} | style)


class _Formula:
    """One formula, which is typeset from left to right."""

    def __init__(self, tokens: list[str], result: list[Run]):
        self.tokens, self.result = tokens, result

    def next(self) -> str:
        """Return the next token other than a space, or an empty text at the end."""
        while self.tokens:
            token = self.tokens.pop(0)
            if not token.isspace():
                return token
        return ""

    def group(self, shift: int, accent: str) -> None:
        """Typeset tokens up to the end of a group."""
        while token := self.next():
            if token == "}":
                return
            self.set(token, shift, accent)

    def argument(self, shift: int, accent: str) -> None:
        """Typeset the next token, or the next group in braces."""
        token = self.next()
        if token == "{":
            self.group(shift, accent)
        elif token:
            self.set(token, shift, accent)

    def set(self, token: str, shift: int, accent: str) -> None:
        if token in ("_", "^"):
            self.argument(RAISED if token == "^" else LOWERED, "")
        elif token == "{":
            self.group(shift, accent)
        elif token.startswith("\\"):
            self.command(token[1:], shift, accent)
        elif token in "=+-<>":
            sign = "\N{MINUS SIGN}" if token == "-" else token
            binary = not shift and self.result and not self.result[-1]["t"].endswith(("(", "=", " "))
            _append(self.result, f" {sign} " if binary else sign, False, shift)
        else:
            letter = "\N{PRIME}" if token == "'" else token
            _append(self.result, letter + accent, letter.isalpha(), shift)

    def command(self, name: str, shift: int, accent: str) -> None:
        """Typeset the accent, space, font, function or letter that a command means."""
        if name in _ACCENTS:
            self.argument(shift, accent + _ACCENTS[name])
        elif name in _SPACES:
            _append(self.result, _SPACES[name], False, shift)
        elif name in _FONTS:
            self.argument(shift, accent)
        elif name in FUNCTIONS:
            last = self.result[-1]["t"][-1:] if self.result else "("
            following = next((token for token in self.tokens if not token.isspace()), "}")
            before, behind = last != "(" and not last.isspace(), following not in "()^_}"
            _append(self.result, "\u2009" * before + name + accent + "\u2009" * behind, False, shift)
        else:
            letter = _COMMANDS.get(name, name)
            _append(self.result, letter + accent, name in _COMMANDS and letter.isalpha(), shift)
