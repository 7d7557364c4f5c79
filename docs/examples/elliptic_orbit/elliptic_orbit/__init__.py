"""Pitch of a satellite on an elliptic orbit (V. V. Beletsky), over the true anomaly, which is the time."""

import numpy as np
from numpy import cos, sin

from atlas.systems import Observable, Parameter, System
from atlas.systems.base import DerivedVariable

from .periodic import odd_solution, stability


class Equations:
    """(1 + e cos nu) psi'' - 2 e sin nu (1 + psi') + 3 K sin psi cos psi = 0, with c = cos nu and s = sin nu."""

    STATE, CONSTANTS = ("psi", "rate", "c", "s"), ("e", "K")

    def rhs(state, constants):
        psi, rate, c, s = state
        e, K = constants
        return rate, (2 * e * s * (1 + rate) - 3 * K * sin(psi) * cos(psi)) / (1 + e * c), -s, c

    def psi_at_pericentre(state, constants):
        psi, rate, c, s = state
        return psi


PARAMETERS = (
    Parameter("e", "1", "eccentricity", 0.1, low=0.0, high=0.99),
    Parameter("K", "1", "(B - A)/C", 0.7, low=-1.0, high=1.0),
    Parameter("branch", "1", "periodic solution: from K = 0 (0) or from e = 0 (1)", 1.0, 0.0, 1.0),
    Parameter("psi0", "rad", "pitch at the pericentre at the start", start=True, symbol=r"$\psi_0$"),
    Parameter("rate0", "1", "its rate there; left out: of the periodic solution", np.nan, start=True),
)


class EllipticOrbit(System):
    name = "elliptic_orbit"
    title = "pitch of a satellite on an elliptic orbit"
    reference = "V. V. Beletsky, Motion of an Artificial Satellite about its Center of Mass (1965)"
    equations = Equations
    parameters = {parameter.name: parameter for parameter in PARAMETERS}
    observables = (
        Observable("psi", "rad", "pitch", tolerance=np.inf, symbol=r"$\psi$"),
        Observable("psi_at_pericentre", "rad", "pitch at the pericentre", every="2*pi"),
    )
    derived = {
        "floquet_trace": DerivedVariable("floquet_trace", "1", "trace of the periodic solution", lambda p, *_: odd_solution(p)[1]),
        "floquet": DerivedVariable(
            "floquet", "1", "linear stability of the periodic solution", stability,
            flags={"unknown": "no such solution", "stable": "the trace is below 2", "unstable": "it is not"},
        ),
    }  # fmt: skip

    def possible_start(self, points):
        """Everywhere: maps ask at many points. Where the branch has no solution the state is not finite."""
        return np.ones(np.shape(points["e"]), bool)

    def initial_state(self, points):
        rate = np.where(np.isnan(points["rate0"]), odd_solution(points)[0], points["rate0"])
        return np.array([points["psi0"], rate, 1 + 0 * rate, 0 * rate])
