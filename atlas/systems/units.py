"""Units of parameters and observables: products of powers of the units that UDUNITS has, such as "kg m2 s-1"."""

from __future__ import annotations

import re

# With prefixes, and without.
_PREFIXED = (
    "m g s A K mol cd Hz N Pa J W C V F ohm S Wb T H rad sr eV bar L l lm lx Bq Gy t meter metre gram second ampere kelvin"
    " mole candela hertz newton pascal joule watt coulomb volt farad siemens weber tesla henry radian steradian liter"
    " litre"
)
_PLAIN = (
    "min minute h hr hour d day year yr deg degree arcmin arcminute arcsec arcsecond percent % au turn revolution rpm"
    " degree_C degC ppm light_year parsec lb ft inch mile knot atm mmHg"
)
PREFIXED, PLAIN = frozenset(_PREFIXED.split()), frozenset(_PLAIN.split())
PREFIXES = (
    "y", "z", "a", "f", "p", "n", "u", "m", "c", "d", "da", "h", "k", "M", "G", "T", "P", "E", "Z", "Y",
    "nano", "micro", "milli", "centi", "deci", "hecto", "kilo", "mega", "giga", "tera",
)  # fmt: skip
_FACTOR = re.compile(
    r"(?P<number>\d+\.?\d*(?:[eE][-+]?\d+)?)|(?P<name>[A-Za-z_%]+)(?:(?:\^|\*\*)?(?P<power>[-+]?\d+))?"
)
_BETWEEN = re.compile(r"\s*[*./]\s*|\s+|$")


def is_unit(text: object) -> bool:
    """Whether a text is a unit in the spelling of UDUNITS; "1" for pure numbers, never the empty text."""
    if not isinstance(text, str) or not text:
        return False
    position = 0
    while position < len(text):
        factor = _FACTOR.match(text, position)
        if factor is None or (factor["name"] is not None and not _is_name(factor["name"])):
            return False
        between = _BETWEEN.match(text, factor.end())
        if between is None or (between.end() == len(text) and between[0]):
            return False
        position = between.end()
    return True


def _is_name(name: str) -> bool:
    """Whether a name is that of a unit, with or without a prefix, in the singular or in the plural."""
    singular = name[:-1] if len(name) > 4 and name.endswith("s") else name
    for candidate in (name, singular):
        if candidate in PREFIXED or candidate in PLAIN:
            return True
        if any(candidate.startswith(prefix) and candidate[len(prefix) :] in PREFIXED for prefix in PREFIXES):
            return True
    return False
