"""The limit of a proof is that of the rate which deviates most, whichever this is, by the integrals of a symmetric top."""

import numpy as np
import pytest

import atlas
from atlas.extensions.certificate.proofs import PROOFS
from atlas.measure.instrument import Tolerances
from atlas.systems.fixed_point import FIXED_POINT

pytestmark = pytest.mark.usefixtures("whole_kernels")

TOP = {"A": 1.0, "B": 1.0, "Mg": 1.0}
# Start -> the rate that binds. The first one is proved if theta' counts half: of it alone psi' and phi' nearly rest.
STARTS = {
    "theta_dot": {
        "C": 0.9334118, "z0": 0.5, "theta0": 2.23060703, "m": 0.77028296, "n": -0.72528113, "theta_dot0": 0.00137173,
    },
    "theta_dot with a rotor": {"C": 0.52, "l3": 0.5, "z0": -0.72, "theta0": 1.13, "n": 0.85, "m": 1.0, "theta_dot0": 0.008},
    "psi_dot": {"C": 1.76, "z0": -0.83, "theta0": 0.48, "n": -0.71, "m": -0.39, "theta_dot0": 0.002},
    "phi_dot": {"C": 0.21, "z0": 0.05, "theta0": 2.45, "n": -0.48, "m": 1.89, "theta_dot0": 0.003},
    "normal_rate": {"C": 1.5, "z0": 0.4, "theta0": 0.1, "m": 2.0, "theta_dot0": 0.01},
}  # fmt: skip


def deviations(C, z0, theta0, m=0.0, n=0.0, theta_dot0=0.0, l3=0.0):
    """Largest theta', half the ranges of psi', phi' and the rate about the vertical, and largest sin(theta).

    With x = cos(theta), and momenta S about the axis and K about the vertical: (x')^2 is a cubic, all else a function of x.
    """
    x0, sine2 = np.cos(theta0), np.sin(theta0) ** 2
    r = m + n * x0
    S = C * r + l3
    K = n * sine2 + S * x0
    energy = 0.5 * (theta_dot0**2 + n**2 * sine2) - z0 * x0
    cubic = np.polynomial.Polynomial([2 * energy - K**2, 2 * z0 + 2 * K * S, -2 * energy - S**2, -2 * z0])
    roots = cubic.roots()
    roots = roots[abs(roots.imag) < 1e-7].real
    low, high = roots[roots <= x0].max(initial=-1.0), roots[roots >= x0].min(initial=1.0)
    x = np.linspace(low, high, 20001)[1:-1]
    psi_dot = (K - S * x) / (1 - x**2)
    ranges = psi_dot, r - x * psi_dot, psi_dot * (1 - x**2) + r * x
    theta_dot = np.sqrt(np.maximum(cubic(x), 0) / (1 - x**2)).max()
    names = "psi_dot", "phi_dot", "normal_rate"
    halves = {name: 0.5 * np.ptp(each) for name, each in zip(names, ranges, strict=True)}
    return {"theta_dot": theta_dot} | halves, np.sqrt(1 - x**2).max()


@pytest.mark.parametrize("binding", STARTS)
def test_each_rate_binds_where_it_deviates_most(binding):
    name = binding.split()[0]
    rates, largest_sine = deviations(**STARTS[binding])
    is_inside = name == "normal_rate"  # of an axis that stays near the vertical it alone counts
    if not is_inside:
        others = [value for key, value in rates.items() if key not in (name, "normal_rate")]
        assert rates[name] > 1.4 * max(others)
    angle = 2 * largest_sine if is_inside else 1e-3
    points = FIXED_POINT.with_defaults(TOP | STARTS[binding])
    points = {key: np.atleast_1d(value).astype(float) for key, value in points.items()}
    result = PROOFS.proofs(FIXED_POINT, points, Tolerances(1e-9, angle))
    assert rates[name] * (1 - 1e-6) <= result["proof_bound"][0] <= 1.04 * rates[name]
    for tolerance, is_proved in ((1.05 * rates[name], True), (0.99 * rates[name], False)):
        assert (
            PROOFS.proofs(FIXED_POINT, points, Tolerances(tolerance, angle))["label_proof"][0] > 0
        ) == is_proved


def test_a_rate_beyond_the_tolerance_at_the_start_leaves_no_proof():
    start = STARTS["theta_dot"]
    variables = ["label_proof", "proof_bound"]
    ds = atlas.label_points(
        "fixed_point", TOP | start, duration=0.01, rate_tolerance=1e-3, variables=variables, threads=1
    )
    assert ds.label_proof.item() == 0
    assert ds.proof_bound.item() > start["theta_dot0"] > 1e-3
