"""Checks of columns that are not parameters. A column that is probably a mistyped parameter is refused."""

from __future__ import annotations

import re
import unicodedata
from collections.abc import Collection, Iterable
from functools import lru_cache
from itertools import pairwise
from typing import Any

import numpy as np

from ..errors import BadInput, shown

MAX_FIELDS, MAX_NAME = 10_000, 100  # largest numbers of examined fields, and of examined characters of a name
REMEDY = "rename it, or keep it as it is by keep"
# Separators between names or values of columns that were read as a single column. In _SIGN, spaces alone are no separator.
_BREAK, _SIGN = re.compile(r"[\s,;|:/&]+"), re.compile(r"\s*[,;|:/&\t]\s*")
# Products of units, such as kg m^2, rad/s, A.m2 or Nms. Possessive quantifiers avoid slow matching of texts such as mmmm.
_UNITS = (
    r"(?:1?/)?(?:(?:(?i:kg|mg|lbm?|slugs?|[cmkuµμ]m|ms|min|hr?s?|hours?|sec|days?|[mµμ]?rad|deg(?:rees?)?|arcmin|arcsec|rp[ms]|rev|turns?"
    r"|orbits?|k?hz|[mk]N|[munµμ]T|gauss)|[gmshNTAJWVG°%])(?:\*\*|\^)?[-+]?\d*[\s*·.⋅/-]*)++"
)
_DIGITS = r"[-+]?(?:\d{1,3}(?:[ '.,]\d{3})+(?:[.,]\d+)?|\d+[.,]?\d*|[.,]\d+)(?:[eEdD][-+]?\d+)?"
_NUMBER = re.compile(rf"[~<>≈]?\s*{_DIGITS}(?:\s*(?:±|\+/?-)\s*{_DIGITS}|\(\d+\))?\s*(?:{_UNITS})?[,;]?")
_UNIT_OF_NAME = re.compile(rf"(?<=\w)(?:\s*[(\[{{<].*|[\s_,;:/.-]+(?:in\s+)?{_UNITS})$")
_LETTER_OF_NAME = re.compile(r"\d+[A-Z]")  # names of satellites such as 1A and 3U
_MISSING = {"", "-", "--", "?", "na", "n/a", "n.a.", "nan", "nat", "<na>", "none", "null", "unknown"}
_QUOTES = "\"'` \t\u00b4\u00ab\u00bb\u2018\u2019\u201c\u201d\u201e"


@lru_cache(1000)
def _plain(name: str) -> str:
    """Return a name in lower case, without blanks and punctuation."""
    return re.sub(r"[^\w°]|_", "", name).lower()


def parameter_meant(name: str, parameters: Collection[str]) -> str:
    """Return the parameter that equals a name, or "" if there is none. Case, blanks, punctuation and a final unit do not count."""
    text = unicodedata.normalize("NFKC", name[:MAX_NAME])
    by_plain = {_plain(each): each for each in parameters} | {each: each for each in parameters}
    forms = (name, _plain(text), _plain(_UNIT_OF_NAME.sub("", text)))
    return next((by_plain[form] for form in forms if form in by_plain), "")


def check_name(name: str, values: Any, parameters: Collection[str]) -> None:
    """Raise BadInput if a column's name resembles a parameter or contains parameters, unless the column's values are 0, 1, 2, ..."""
    problem, meant = "", parameter_meant(name, parameters)
    if meant:
        problem = f"no parameter, but {meant} if case, blanks and units do not count; {REMEDY}"
    for separator in (_BREAK, _SIGN):
        parts = separator.split(name.strip(_QUOTES))
        held = [part for part in parts if parameter_meant(part, parameters)]
        if (
            any(a in parameters and b in parameters for a, b in pairwise(parts))
            or 1 < len(parts) == len(held)
            or (
                held
                and not meant
                and _most(any(map(_is_nearly_number, _BREAK.split(field))) for field in _fields(values))
            )
        ):
            problem = f"understood as one column, whose name holds {', '.join(held)}; separate the columns, or {REMEDY}"
    if problem and not np.array_equal(np.ravel(values), np.arange(np.size(values))):
        raise BadInput(f"{shown(name)}: {problem}")


def check_texts(name: str, values: Any, parameters: Collection[str]) -> None:
    """Raise BadInput if the name or the values of a column of texts suggest a parameter."""
    check_name(name, values, parameters)
    if _most(map(_is_numbers, fields := _fields(values))):
        example = next(field for field in fields if _is_numbers(field))
        raise BadInput(
            f"{shown(name)}: no parameter, and its texts are numbers but for decimal commas, units, quotes or separators,"
            f" such as {shown(example)}; {REMEDY}"
        )


def _fields(values: Any) -> list[str]:
    """Return the first MAX_FIELDS values as texts, without missing values."""
    texts = (str(value).strip() for value in np.ravel(values)[:MAX_FIELDS])
    return [text for text in texts if text.lower() not in _MISSING]


def _most(answers: Iterable[bool]) -> bool:
    """Whether more than half of the answers are true."""
    answers = list(answers)
    return 2 * sum(answers) > len(answers)


def _is_numbers(field: str) -> bool:
    """Whether a text is nearly a number, or has a decimal point and consists of separated parts that are nearly numbers."""
    parts = re.split(r"[\s,;|/&]+", field)  # Colons are left out, because they occur in times of day.
    return _is_nearly_number(field) or ("." in field and all(map(_is_nearly_number, parts)))


def _is_nearly_number(field: str) -> bool:
    """Whether a text is a number, possibly with a decimal comma, thousands separators, a unit or quotes."""
    text = unicodedata.normalize("NFKC", field[: MAX_NAME + 1]).replace("\u2212", "-").strip(_QUOTES)
    return len(text) <= MAX_NAME and bool(_NUMBER.fullmatch(text)) and not _LETTER_OF_NAME.fullmatch(text)
