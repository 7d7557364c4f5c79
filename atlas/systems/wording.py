"""Find families by the names that papers give them."""

from __future__ import annotations

import re
from collections.abc import Mapping

from .. import extension
from .base import Family


def unknown_family(name: str, families: Mapping[str, Family]) -> str:
    """Return the end of a message that lists families which the paper calls `name`, or else the allowed names."""
    words = re.escape(name.lower())
    matches = [f for f in families.values() if name and re.search(rf"\b{words}\b", f.paper_wording.lower())]
    if 0 < len(matches) <= 2:
        wording = matches[0].paper_wording
        return f"{' or '.join(family.name for family in matches)}, by the paper's words {wording!r}"
    return extension.available_text(name, families)
