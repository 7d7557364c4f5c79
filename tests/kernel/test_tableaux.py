"""Tableaux and what is tabulated of their errors on oscillations."""

import numpy as np
import pytest

from atlas.kernel.tableaux import METHODS, RK4, RK8, Method

# Of orders 2, 3 (Bogacki and Shampine 1989) and 5 (Dormand and Prince 1980), and Butcher's of order 6 (1964).
HEUN = ((), (1.0,)), (0.5, 0.5)
BOGACKI_SHAMPINE = ((), (1 / 2,), (0.0, 3 / 4)), (2 / 9, 1 / 3, 4 / 9)
DORMAND_PRINCE = (
    (
        (),
        (1 / 5,),
        (3 / 40, 9 / 40),
        (44 / 45, -56 / 15, 32 / 9),
        (19372 / 6561, -25360 / 2187, 64448 / 6561, -212 / 729),
        (9017 / 3168, -355 / 33, 46732 / 5247, 49 / 176, -5103 / 18656),
    ),
    (35 / 384, 0.0, 500 / 1113, 125 / 192, -2187 / 6784, 11 / 84),
)
BUTCHER = (
    (
        (),
        (1 / 3,),
        (0.0, 2 / 3),
        (1 / 12, 1 / 3, -1 / 12),
        (-1 / 16, 9 / 8, -3 / 16, -3 / 8),
        (0.0, 9 / 8, -3 / 8, -3 / 4, 1 / 2),
        (9 / 44, -9 / 11, 63 / 44, 18 / 11, 0.0, -16 / 11),
    ),
    (11 / 120, 0.0, 27 / 40, 27 / 40, -4 / 15, -4 / 15, 11 / 120),
)


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
        y = 0.1 if method.order < 8 else 0.6  # above rounding
        phase = abs(np.angle(amplification(y) * np.exp(-1j * y)))
        assert phase / y ** (method.order + 1) == pytest.approx(method.dispersion, rel=0.1)
        dissipation = 1 - abs(amplification(y))
        assert dissipation / y**method.dissipation_order == pytest.approx(method.dissipation, rel=0.1)


@pytest.mark.parametrize("method", METHODS.values(), ids=METHODS)
def test_errors_and_stability_follow_from_the_tableau(method):
    """What the rows of the table have been given is what they would have without."""
    computed = Method(method.name, method.order, method.a, method.b)
    for name in ("dispersion", "dissipation", "stability"):
        assert getattr(computed, name) == pytest.approx(getattr(method, name), rel=0.01)
    assert computed.dissipation_order == method.dissipation_order == {4: 6, 8: 10}[method.order]
    assert computed.step_cost == method.stages / 4
    assert computed.stability == pytest.approx(method.stability, rel=1e-9)


def test_what_is_given_of_a_method_stays():
    assert (RK4.dispersion, RK4.dissipation, RK4.stability, RK4.step_cost) == (1 / 120, 1 / 144, 8**0.5, 1.0)
    assert (RK8.dispersion, RK8.dissipation, RK8.stability) == (6.402e-8, 2.277e-8, 5.960359811702219)
    assert (RK8.step_cost, RK8.kernel_step, RK4.kernel_step) == (8.0, 1.0, 2.0)
    method = Method("rk5", 5, *DORMAND_PRINCE, stability=0.9)
    assert (method.stability, method.dissipation_order) == (0.9, 6)


@pytest.mark.parametrize(
    ("order", "tableau"), [(3, BOGACKI_SHAMPINE), (5, DORMAND_PRINCE)], ids=["order 3", "order 5"]
)
def test_errors_of_methods_of_odd_order(order, tableau):
    """Their leading error is a loss of amplitude, which counts as both: by steps in exact complex numbers."""
    method = Method("odd", order, *tableau)
    for y in (0.02, 0.05):
        factor = method.step(lambda state: 1j * state, 1.0 + 0j, y) * np.exp(-1j * y)
        assert abs(factor - 1) / y ** (order + 1) == pytest.approx(method.dispersion, rel=0.05)
        assert (1 - abs(factor)) / y**method.dissipation_order == pytest.approx(method.dissipation, rel=0.05)
    for share, grows in ((0.999, False), (1.001, True)):
        assert (abs(method.step(lambda state: 1j * state, 1.0 + 0j, share * method.stability)) > 1) == grows


def test_a_method_that_no_step_makes_stable_is_refused():
    message = "^mine: no step is stable, for the amplitude of oscillations grows by any$"
    for order, tableau in ((2, HEUN), (6, BUTCHER)):
        with pytest.raises(ValueError, match=message):
            Method("mine", order, *tableau)


@pytest.mark.parametrize(("order", "own"), [(3, 4), (5, 4)])
def test_a_method_of_another_order_is_refused(order, own):
    with pytest.raises(ValueError, match=f"^mine: its order on oscillations is {own}, not {order}$"):
        Method("mine", order, RK4.a, RK4.b)
