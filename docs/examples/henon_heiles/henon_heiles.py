"""The model of a star in the plane of a galaxy of Henon and Heiles, Astronomical Journal 69 (1964) 73-79."""

import numpy as np

from atlas.systems import Observable, Parameter, System


class Equations:
    """Energy (u^2 + v^2 + x^2 + y^2) / 2 + x^2 y - y^3 / 3, where u and v are the rates of x and y."""

    STATE = ("x", "y", "u", "v")
    INTEGRALS = ("hamiltonian",)

    def rhs(state, constants):
        x, y, u, v = state
        return u, v, -x - 2 * x * y, -y - x * x + y * y

    def hamiltonian(state, constants):
        x, y, u, v = state
        return 0.5 * (u * u + v * v), 0.5 * (x * x + y * y), x * x * y, -y * y * y / 3

    def radius_squared(state, constants):
        x, y, u, v = state
        return x * x + y * y


PARAMETERS = (
    Parameter("energy", "1", "energy; motions below 1/6 are bounded", default=0.125, low=0.0, high=1 / 6),
    Parameter("x0", "1", "x at the start", start=True, symbol="$x_0$"),
    Parameter("y0", "1", "y at the start", start=True, symbol="$y_0$"),
    Parameter("v0", "1", "rate of y at the start", start=True, symbol="$v_0$"),
)


class HenonHeiles(System):
    """The rate of x at the start, not negative, follows from the energy; no start has less than the potential."""

    name = "henon_heiles"
    title = "star in the plane of a galaxy (Henon and Heiles)"
    reference = "M. Henon, C. Heiles, Astronomical Journal 69 (1964) 73-79"
    doi = "10.1086/109234"
    equations = Equations
    parameters = {parameter.name: parameter for parameter in PARAMETERS}
    observables = (
        Observable("x", "1", "x", symbol="$x$"),
        Observable("y", "1", "y", symbol="$y$"),
        Observable("radius_squared", "1", "square of the distance from the centre", symbol="$r^2$"),
    )
    start_condition = "the energy must not be less than the potential at the start"

    def initial_state(self, points):
        energy, x, y, v = (points[name] for name in ("energy", "x0", "y0", "v0"))
        potential = 0.5 * (x * x + y * y) + x * x * y - y**3 / 3
        with np.errstate(invalid="ignore"):
            return np.array([x, y, np.sqrt(2 * (energy - potential) - v * v), v])
