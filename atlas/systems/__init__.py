"""The table of systems. A new system is one new folder and one line here."""

from __future__ import annotations

from ..errors import BadInput
from .base import System
from .fixed_point import FIXED_POINT
from .satellite import SATELLITE

SYSTEMS = {system.name: system for system in (SATELLITE, FIXED_POINT)}


def get(name: str) -> System:
    """The system of that name; BadInput if there is none."""
    if name not in SYSTEMS:
        raise BadInput(f"system = {name!r}: there is no such system; allowed: {', '.join(SYSTEMS)}")
    return SYSTEMS[name]
