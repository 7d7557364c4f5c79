"""Tableaux and what is tabulated of their errors on oscillations."""

import numpy as np
import pytest

from atlas.kernel.tableaux import METHODS, RK4, Method


def test_a_wrong_tableau_is_refused():
    with pytest.raises(ValueError, match="sum b"):
        Method("wrong", 4, RK4.a, (1 / 6, 1 / 3, 1 / 3, 1 / 3), 1.0, 1.0, 6, 1.0)
    with pytest.raises(ValueError, match="row i"):
        Method("wrong", 4, RK4.a[1:], RK4.b, 1.0, 1.0, 6, 1.0)


def test_stability_limit_on_the_imaginary_axis():
    """|R(iy)| <= 1 up to the limit in the table and > 1 beyond; dispersion and dissipation constants as y -> 0."""
    for method in METHODS.values():
        a = np.zeros((method.stages, method.stages))
        for i, row in enumerate(method.a):
            a[i, : len(row)] = row

        def amplification(y, a=a, method=method):
            b = np.array(method.b)
            return 1 + 1j * y * b @ np.linalg.solve(np.eye(len(b)) - 1j * y * a, np.ones(len(b)))

        inside = np.linspace(0.05, method.stability * (1 - 1e-6), 400)
        assert max(abs(amplification(y)) for y in inside) <= 1 + 1e-12
        assert abs(amplification(method.stability * 1.001)) > 1
        y = 0.1 if method.order == 4 else 0.6
        phase = abs(np.angle(amplification(y) * np.exp(-1j * y)))
        assert phase / y ** (method.order + 1) == pytest.approx(method.dispersion, rel=0.1)
        dissipation = 1 - abs(amplification(y))
        assert dissipation / y**method.dissipation_order == pytest.approx(method.dissipation, rel=0.1)
