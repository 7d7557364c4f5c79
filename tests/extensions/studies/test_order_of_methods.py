"""Observed order of every method on motions known in closed form."""

import numpy as np
import pytest
from scipy.special import ellipj, ellipk
from strategies import BySystem, default_points, select
from truth import fixed_point_cases, satellite_cases

from atlas.kernel.ensemble import Ensemble
from atlas.kernel.specialization import kernel
from atlas.kernel.tableaux import METHODS
from atlas.systems import SYSTEMS
from atlas.systems.base import families_of, unsteady

# Steps of the coarser of two runs, by the order of the method: fewer of a higher order, so that the error is no rounding.
COARSE_STEPS_GYROSTAT = {4: 240, 5: 160, 6: 120, 7: 60, 8: 30}
COARSE_STEPS_FAMILY = {4: 96, 5: 48, 6: 32, 7: 16, 8: 8}


def final_states(system, points, steps, duration, method):
    """States after so many steps to `duration`, (state, points)."""
    ensemble = Ensemble.of(system, points)
    counts = np.full(ensemble.size, steps)
    return ensemble.final_states(kernel(system, method), counts, np.full(ensemble.size, duration / steps))


def spin_of_free_gyrostat(A, B, C, rotor, p0, r0, t):
    """r(t) of a torque-free gyrostat with its rotor on the third axis, started with q = 0.

    Energy and |momentum|^2 give p^2 and q^2 as quadratics in r, so C r' = (A - B) p q has the quartic
    -kappa (r - a)(r - b)(r - c)(r - d); between a > b its solution is Byrd and Friedman's 256.00.
    """
    energy, momentum = A * p0**2 + C * r0**2, (A * p0) ** 2 + (C * r0 + rotor) ** 2
    square = np.polynomial.Polynomial([rotor, C]) ** 2
    left, up = np.polynomial.Polynomial([energy, 0, -C]), momentum - square
    p2, q2 = (B * left - up) / (A * (B - A)), (up - A * left) / (B * (B - A))
    quartic = p2 * q2 * ((A - B) / C) ** 2
    d, c, b, a = np.sort(quartic.roots().real)
    assert np.abs(quartic.roots().imag).max() < 1e-9
    kappa = -quartic.coef[4]
    assert kappa > 0
    assert min(abs(r0 - a), abs(r0 - b)) < 1e-12
    modulus = (a - b) * (c - d) / ((a - c) * (b - d))
    u = 0.5 * t * np.sqrt(kappa * (a - c) * (b - d)) + (ellipk(modulus) if abs(r0 - a) < 1e-12 else 0.0)
    sn2 = ellipj(u, modulus)[0] ** 2
    return (b * (a - c) - c * (a - b) * sn2) / ((a - c) - (a - b) * sn2)


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("rotor", [0.0, 0.25])  # 0: Euler's top
@pytest.mark.parametrize("system", SYSTEMS)
def test_order_on_the_free_gyrostat(system, rotor, method):
    A, B, C, p0, r0, duration = 1.0, 1.2, 1.6, 1.5, 0.9, 20.0
    body = BySystem(satellite={"Omega": 0.0, "k3": rotor}, fixed_point={"l3": rotor})[system]
    # w = n gamma + m e3 with the vertical at 90 degrees on the first axis
    start = {"theta0": np.pi / 2, "phi0": np.pi / 2, "n": p0, "m": r0}
    points = default_points(system, A=A, B=B, C=C, **start, **body)
    exact = spin_of_free_gyrostat(A, B, C, rotor, p0, r0, duration)
    order = METHODS[method].order
    coarse = COARSE_STEPS_GYROSTAT[order]
    errors = [
        abs(final_states(SYSTEMS[system], points, steps, duration, method)[2, 0] - exact)
        for steps in (coarse, 2 * coarse)
    ]
    assert errors[0] < 1e-5
    assert np.log2(errors[0] / errors[1]) == pytest.approx(order, abs=0.7)


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("name", SYSTEMS)
def test_order_on_every_steady_family(name, method):
    system = SYSTEMS[name]
    points = BySystem(satellite=satellite_cases, fixed_point=fixed_point_cases)[name]()
    flags, _ = system.identify_family(points)
    steady = (flags > 0) & ~unsteady(system, flags)
    points, flags = select(points, steady), flags[steady]
    duration = 20.0 / system.frequency_bound(points)
    exact = np.empty((len(system.equations.STATE), flags.size))
    for family in families_of(system).values():
        for i in np.flatnonzero(flags == family.flag):
            exact[:, i] = family.motion(select(points, i), duration[i])[:, 0]
    order = METHODS[method].order
    coarse = COARSE_STEPS_FAMILY[order]
    errors = [
        np.abs(final_states(system, points, steps, duration, method) - exact).max(0)
        for steps in (coarse, 2 * coarse)
    ]
    assert errors[1].max() < 1e-4
    above_rounding = errors[1] > 1e-13  # a body at rest has no error, and rounding hides the order
    assert above_rounding.sum() > 5
    orders = np.log2(errors[0][above_rounding] / errors[1][above_rounding])
    assert np.median(orders) == pytest.approx(order, abs=0.4)
