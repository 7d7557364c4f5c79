"""Symmetric heavy top in Euler angles, whose momenta of precession and spin are constants; fixed_point in other terms."""

import numpy as np
from numpy import cos, sin

from atlas.systems import Parameter, System


class Equations:
    STATE = ("theta", "phi", "theta_dot")  # theta from the downward vertical; phi: proper rotation
    CONSTANTS = ("A", "C", "moment", "L_vertical", "L_axis")

    def rhs(state, constants):
        theta, phi, theta_dot = state
        A, C, moment, L_vertical, L_axis = constants
        sine, cosine = sin(theta), cos(theta)
        psi_dot = (L_vertical - L_axis * cosine) / (A * sine * sine)
        slope = (psi_dot * (A * psi_dot * cosine - L_axis) - moment) * sine / A
        return theta_dot, L_axis / C - psi_dot * cosine, slope

    def frame_motion(state, constants):
        theta, phi, theta_dot = state
        A, C, moment, L_vertical, L_axis = constants
        sine, cosine = sin(theta), cos(theta)
        psi_dot_sine = (L_vertical - L_axis * cosine) / (A * sine)
        w1 = psi_dot_sine * sin(phi) + theta_dot * cos(phi)
        w2 = psi_dot_sine * cos(phi) - theta_dot * sin(phi)
        return w1, w2, L_axis / C, sine * sin(phi), sine * cos(phi), cosine


PARAMETERS = (
    Parameter("A", "kg m2", "moment of inertia across the axis", 1.0, 0.0, open_low=True),
    Parameter("C", "kg m2", "moment of inertia about the axis", 1.0, 0.0, open_low=True),
    Parameter("Mg", "N", "weight", 0.0),
    Parameter("z0", "m", "distance of the centre of mass along the axis", 0.0),
    Parameter("theta0", "rad", "angle of the axis at the start", 0.5, start=True),
    Parameter("n", "rad s-1", "rate of precession at the start", 0.0, start=True),
    Parameter("m", "rad s-1", "rate of proper rotation at the start", 0.0, start=True),
)


class HeavyTopEuler(System):
    """Not for axes on the vertical, where these angles have no meaning: such starts are not computed."""

    name = "heavy_top_euler"
    title = "symmetric heavy top in Euler angles"
    equations = Equations
    parameters = {parameter.name: parameter for parameter in PARAMETERS}

    def constants(self, points):
        A, C, cosine = points["A"], points["C"], np.cos(points["theta0"])
        L_axis = C * (points["m"] + points["n"] * cosine)
        L_vertical = A * points["n"] * np.sin(points["theta0"]) ** 2 + L_axis * cosine
        return np.array([A, C, points["Mg"] * points["z0"], L_vertical, L_axis])

    def initial_state(self, points):
        theta = np.where(np.sin(points["theta0"]) == 0, np.nan, points["theta0"])
        return np.array([theta, 0 * theta, 0 * theta])
