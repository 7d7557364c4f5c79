"""The systems by name."""

from __future__ import annotations

from ..errors import BadInput, allowed_text, shown
from .base import System
from .fixed_point import FIXED_POINT
from .satellite import SATELLITE

SYSTEMS: dict[str, System] = {}


def register(system: System) -> None:
    """Make a system available to scenes and functions under its name; one of the same name is replaced."""
    SYSTEMS[system.name] = system


def get(name: object) -> System:
    """The system of that name; BadInput if there is none."""
    if not isinstance(name, str) or name not in SYSTEMS:
        raise BadInput(f"system = {shown(name)}: there is no such system; {allowed_text(name, SYSTEMS)}")
    return SYSTEMS[name]


for _system in (SATELLITE, FIXED_POINT):
    register(_system)
