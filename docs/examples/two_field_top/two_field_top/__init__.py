"""A gyrostat about a fixed point in two uniform fields, the weight and a magnetic one across it."""

import numpy as np

from atlas.systems.gyrostat import Gyrostat

from . import equations
from .families import FAMILIES
from .parameters import PARAMETERS, body, initial_state, vectors


class TwoFieldTop(Gyrostat):
    name = "two_field_top"
    title = "gyrostat about a fixed point in two uniform fields"
    frame_axes = ("second field", "across", "vertical")
    equations = equations
    parameters = PARAMETERS
    rate_states = ("w1", "w2", "w3")
    families = FAMILIES
    body = staticmethod(body)
    initial_state = staticmethod(initial_state)

    def constants(self, points):
        return np.concatenate(vectors(points))
