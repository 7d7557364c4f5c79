"""One theory of the gyrostat in a frame that turns uniformly, with two directions at rest in it."""

from .body import Body, Direction
from .system import Gyrostat

__all__ = ["Body", "Direction", "Gyrostat"]
