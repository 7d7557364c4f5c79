"""Quadrature errors of poles near the real time axis."""

import numpy as np
import pytest
from scipy.integrate import quad

from atlas.engine import assemble, jit, poles
from atlas.engine.poles import pole_correction, trapezoid_error_of_pole
from atlas.engine.sampling import END_WEIGHTS, quadrature_weight


@pytest.mark.parametrize("samples", [9, 30, 400])
@pytest.mark.parametrize("place", [-1.3, 0.4, 6.7, 23.9, 24.1])
@pytest.mark.parametrize("height", [0.01, 0.3, 4.0])
def test_quadrature_error_of_a_pole(samples, place, height):
    """Beside the sums over all samples and integrals by quadrature; the same from both ends."""
    weights = np.array([quadrature_weight(k, samples, END_WEIGHTS) for k in range(samples + 1)])
    k = np.arange(samples + 1.0)
    for z in (complex(place, height), complex(samples - place, height)):
        errors = trapezoid_error_of_pole(z, samples, END_WEIGHTS)
        for power, value in zip((1, 2), errors, strict=True):
            inner = [x for x in (z.real - 5 * height, z.real, z.real + 5 * height) if 0 < x < samples]
            integral, _ = quad(
                lambda t, z=z, power=power: (t - z) ** -power, 0, samples, points=inner or None,
                complex_func=True, limit=500, epsabs=1e-11, epsrel=1e-12,
            )  # fmt: skip
            true = (weights * (k - z) ** -power).sum() - integral
            assert abs(value - true) < 1e-8 * (1 + abs(true))


def compiled_pole_correction():
    """`pole_correction` as the kernels call it."""
    sources = assemble.functions(poles) | {
        "quadrature_weight": assemble.functions(assemble.sampling)["quadrature_weight"]
    }
    namespace: dict = {}
    exec(jit.HEADER + "\n".join(f"{jit.CALLED}\n{text}" for text in sources.values()), namespace)
    return namespace["pole_correction"]


@pytest.mark.parametrize("compiled", [True, False])
def test_no_correction_without_a_pole(compiled):
    """A third axis at rest on the vertical, or beside it: zeta has no zero, and nothing is divided by 0."""
    function = compiled_pole_correction() if compiled else pole_correction
    for value in (0.0, 1.0, np.nan, np.inf):
        hermite_data = np.full((3, 8), value, complex)
        with np.errstate(all="ignore"):
            assert function(hermite_data, 1, 100, 4, 400, END_WEIGHTS, 0.0, 0.0, 0.0) == (0.0,) * 5
