"""Theory of gyrostats in a uniformly turning frame with two marked directions."""

from .body import Body, Direction
from .motions import Equation, about_third_axis, angular_velocity, directions, linear, motion_of
from .system import Gyrostat

__all__ = [
    "Body",
    "Direction",
    "Equation",
    "Gyrostat",
    "about_third_axis",
    "angular_velocity",
    "directions",
    "linear",
    "motion_of",
]
