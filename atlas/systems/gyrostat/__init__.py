"""One theory of the gyrostat in a frame that turns uniformly, with two directions at rest in it."""

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
