"""The gyrostat about a fixed point in a central Newtonian field (Amer, Abo Essa, Ibrahim & Amer 2013)."""

from .system import FIXED_POINT, FixedPoint

__all__ = ["FIXED_POINT", "FixedPoint"]
