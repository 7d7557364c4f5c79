"""LaTeX for tables, and for plain text with formulas, such as "k1 = 0, or C m = k3 cos(theta0)"."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from itertools import groupby
from typing import Any

from ...analysis.latex import FUNCTIONS, GREEK, escaped

NAMES = {name: rf"\{name}" for name in GREEK} | {
    "w": r"\omega",
    "eps": r"\epsilon",
    "mt": "m t",
    "nt": "n t",
    "Mg": "Mg",
}
SIGNS = {
    "+-": r"\pm",
    "-+": r"\mp",
    ">=": r"\ge",
    "<=": r"\le",
    "!=": r"\ne",
    "->": r"\to",
    "x": r"\times",
    "*": r"\,",
}
SIGNS |= {".": r"\cdot", "..": r"\ldots", "...": r"\ldots", "{": r"\{", "}": r"\}"}
NAME = re.compile(r"([A-Za-z]+?)(_dot)?(\d+(?:,\d)?)?(_[a-z0*])?('*)")
TOKEN = re.compile(
    r"[a-z]+-[a-z]{2,}|[A-Za-z]{2,}'s\b|√\w+|[A-Za-z]+(?:_dot)?\d*(?:,\d)?(?:_[a-z0*])?'*|\^-?\w+|\d+(?:\.\d+)?|\.{2,}|\+-|-\+|->|[<>!]=|\S"
)


def in_latex(text: str) -> str:
    """Return a text with formulas as LaTeX between dollars. Single letters, Greek letters and functions belong to formulas."""
    text = re.sub(r"sqrt\((\w+)\)", r"√\1", re.sub(r"\b([A-Za-z]+)(\d)-dot", r"\1_dot\2", text))
    text = re.sub(r"sqrt\(([^()]+)\)", r"(\1)^½", text)
    pieces: list[tuple[bool, str]] = []  # whether the text is part of a formula, and the text
    bars = 0
    tokens = TOKEN.findall(text)

    def is_word(token: str) -> bool:
        """Whether a token is an English word."""
        name = NAME.fullmatch(token)
        return bool(re.search("[a-z][-'][a-z]", token)) or (
            name is not None and name[1] not in (*NAMES, *FUNCTIONS) and len(name[1]) > 1
        )

    for token, following in zip(tokens, [*tokens[1:], ""], strict=True):
        name = NAME.fullmatch(token)
        article = token in ("a", "(") and is_word(following) and following[-1].isalpha()
        closing = token == ")" and bool(pieces) and not pieces[-1][0]
        if (is_word(token) and token not in SIGNS) or article or closing or token in ",:;":
            pieces.append((False, token))
        elif token in SIGNS:
            pieces.append((True, SIGNS[token]))
        elif token == "|":
            bars += 1
            pieces.append((True, r"\lvert" if bars % 2 else r"\rvert"))
        elif token[0] in "^√":
            inner = token[1:].replace("½", "1/2")
            pieces.append((True, rf"^{{{inner}}}" if token[0] == "^" else rf"\sqrt{{{inner}}}"))
        elif name is None:
            pieces.append((True, token))
        elif name[1] in FUNCTIONS:
            pieces.append((True, rf"\{name[1]}"))
        else:
            letter = NAMES.get(name[1], name[1])
            letter = rf"\dot{{{letter}}}" if name[2] else letter
            index = (name[3] or "") + (name[4] or "")[1:]
            pieces.append((True, letter + (f"_{{{index}}}" if index else "") + name[5]))
    runs: list[str] = []
    for is_formula, group in groupby(pieces, key=lambda piece: piece[0]):
        joined = re.sub(r" (?=[\^)\]/])|(?<=[(\[/]) ", "", " ".join(piece for _, piece in group))
        # TeX accepts primes and a power only in a common superscript.
        joined = re.sub(r"('+)\^\{", lambda match: "^{" + r"\prime " * len(match[1]), joined)
        runs.append(f"${joined}$" if is_formula else joined)
    return re.sub(r" (?=[,:;)])|(?<=\() ", "", " ".join(runs))


# Columns whose texts contain formulas.
FORMULAS = ("conditions", "printed", "true", "ours")


def latex_table(rows: Sequence[Mapping[str, Any]], columns: Mapping[str, str]) -> str:
    """Return rows as a LaTeX longtable. `columns` gives the headings of the columns shown. A list in a cell becomes several lines."""
    width = rf"p{{\dimexpr{1 / len(columns):.3f}\linewidth-2\tabcolsep\relax}}"
    heads = " & ".join(columns.values())
    lines = [r"% needs \usepackage{amsmath, longtable}", rf"\begin{{longtable}}{{{width * len(columns)}}}"]
    lines += [r"\hline", rf"{heads} \\", r"\hline", r"\endhead"]
    for row in rows:
        cells = [
            r" \newline ".join(
                _in_table(text) if name in FORMULAS else escaped(text)
                for text in ([row[name]] if isinstance(row[name], str) else row[name])
            )
            for name in columns
        ]
        lines.append(" & ".join(cells) + r" \\")
    return "\n".join([*lines, r"\hline", r"\end{longtable}", ""])


def _in_table(text: str) -> str:
    """Return a text as LaTeX, with formulas converted and the words between formulas escaped."""
    parts = re.split(r"(\$[^$]*\$)", in_latex(text))
    return "".join(part if part[:1] == "$" else escaped(part) for part in parts)
