"""Rotation of a damped satellite in the plane of an elliptic orbit, over the true anomaly, which is the time."""

import numpy as np
from numpy import sin

from atlas.systems import Observable, Parameter, System

from . import PARAMETERS


class Equations:
    """Those of the pitch, and a torque of -damping times the rate of psi in time, in units of C and of the rate at nu = pi/2."""

    STATE, CONSTANTS = ("psi", "rate", "c", "s"), ("e", "K", "damping")

    def rhs(state, constants):
        psi, rate, c, s = state
        e, K, damping = constants
        r = 1 + e * c
        return rate, (2 * e * s * (1 + rate) - 1.5 * K * sin(2 * psi) - damping * rate / r) / r, -s, c

    def rotation(state, constants):
        psi, rate, c, s = state
        return 1 + rate


class DampedRotation(System):
    name = "damped_rotation"
    title = "rotation of a damped satellite on an elliptic orbit"
    equations = Equations
    parameters = {parameter.name: parameter for parameter in PARAMETERS[:2]} | {
        "damping": Parameter("damping", "1", "damping", 0.002, low=0.0),
        "psi0": PARAMETERS[3],
        "rate0": Parameter("rate0", "1", "its rate there", start=True, symbol=r"$\psi'_0$"),
    }
    observables = (Observable("rotation", "1", "turns in space per orbit"),)

    def initial_state(self, points):
        one = np.ones_like(points["psi0"])
        return np.array([points["psi0"], points["rate0"], one, 0 * one])
