"""Two point masses on massless rods, one below the other, in a vertical plane."""

import numpy as np

from atlas.systems import Observable, Parameter, System

from . import equations

PARAMETERS = (
    Parameter("m1", "kg", "upper mass", 1.0, low=0.0, open_low=True, symbol="$m_1$"),
    Parameter("m2", "kg", "lower mass", 1.0, low=0.0, open_low=True, symbol="$m_2$"),
    Parameter("l1", "m", "length of the upper rod", 1.0, low=0.0, open_low=True, symbol=r"$\ell_1$"),
    Parameter("l2", "m", "length of the lower rod", 1.0, low=0.0, open_low=True, symbol=r"$\ell_2$"),
    Parameter("g", "m s-2", "acceleration of gravity", 9.81, symbol="$g$"),
    Parameter("start1", "rad", "angle of the upper rod at the start", start=True, symbol=r"$\alpha_1$"),
    Parameter("start2", "rad", "angle of the lower rod at the start", start=True, symbol=r"$\alpha_2$"),
    Parameter("start_rate1", "rad s-1", "rate of the upper rod at the start", start=True),
    Parameter("start_rate2", "rad s-1", "rate of the lower rod at the start", start=True),
)


class DoublePendulum(System):
    """The upper rod is fixed at one end; angles are counted from the downward vertical and not reduced."""

    name = "double_pendulum"
    title = "double pendulum"
    equations = equations
    parameters = {parameter.name: parameter for parameter in PARAMETERS}
    observables = (
        Observable("angle1", "rad", "angle of the upper rod", symbol=r"$\varphi_1$"),
        Observable("angle2", "rad", "angle of the lower rod", symbol=r"$\varphi_2$"),
        Observable("height", "m", "height of the lower mass above the point of suspension"),
    )

    def initial_state(self, points):
        return np.array([points[name] for name in ("start1", "start2", "start_rate1", "start_rate2")])
