"""Differentials by the syntax tree against complex steps."""

import numpy as np
import pytest
from strategies import RANDOM

from atlas.kernel.differentiate import differential
from atlas.systems import SYSTEMS, arithmetic

STEP = 1e-30


def compiled(text: str, name: str, **names):
    namespace = {"np": np, **names}
    exec(text, namespace)
    return namespace[name]


def by_complex_step(function, state, constants, change):
    shifted = [x + 1j * STEP * dx for x, dx in zip(state, change, strict=True)]
    return np.array(np.broadcast_arrays(*function(shifted, constants))).imag / STEP


@pytest.mark.parametrize("name", RANDOM)
@pytest.mark.parametrize("function", ["rhs", "frame_motion", "first integrals"])
def test_equations_of_both_systems(name, function):
    system, rng = SYSTEMS[name], np.random.default_rng(1)
    points = RANDOM[name](rng, 20)
    state, constants = system.initial_state(points), system.constants(points)
    change = rng.normal(size=state.shape)
    for each in system.equations.INTEGRALS if function == "first integrals" else [function]:
        original = getattr(system.equations, each)
        derived = compiled(
            differential(arithmetic.functions(system.equations)[each], "change_of"), "change_of"
        )
        actual = np.array(np.broadcast_arrays(*derived(state, constants, change)))
        expected = by_complex_step(original, state, constants, change)
        np.testing.assert_allclose(actual, expected, rtol=1e-12, atol=1e-12 * np.abs(expected).max())


@pytest.mark.parametrize(
    "lines",
    [
        "return (x / y, c / x, x / c)",
        "return (x ** 3, y ** c, (x * y) ** 0.5, x ** -2)",
        "return (-x * y * c * x, +x, c - x, c)",
        "return (sqrt(x * y), sin(x) * cos(y), exp(c * x), log(x + y), tan(0.1 * x))",
        "return (np.sin(c * x * y), np.sqrt(c), np.cos(x))",
        "u, v = x * y, c * c; v, u = u + v, v; return (u * v, v)",
        "u = x; u = c; return (u * y, u)",
        "u = x * y; u = u * u + x; return (u, u * y)",
        "x, y = x * y, x / y; y = y * x; return (x, y)",
    ],
)
def test_rules(lines):
    text = "def f(state, constants):\n    x, y = state\n    c, = constants\n    " + lines
    rules = {name: getattr(np, name) for name in ("sqrt", "sin", "cos", "exp", "log", "tan")}
    original, derived = compiled(text, "f", **rules), compiled(differential(text, "df"), "df", **rules)
    state, constants, change = (0.7, 1.9), (1.3,), (0.4, -0.8)
    expected = by_complex_step(original, state, constants, change)
    np.testing.assert_allclose(derived(state, constants, change), expected, rtol=1e-13, atol=1e-15)


@pytest.mark.parametrize(
    ("lines", "part"),
    [
        ("return (x ** y,)", "x ** y"),
        ("return (abs(x),)", "abs(x)"),
        ("if x > 0:\n        x = y\n    return (x,)", "if x > 0"),
        ("return (x if y > 0 else y,)", "x if y > 0 else y"),
        ("return x", "return x"),
    ],
)
def test_what_cannot_be_differentiated_is_named(lines, part):
    text = "def f(state, constants):\n    x, y = state\n    " + lines
    with pytest.raises(ValueError, match="cannot be differentiated") as error:
        differential(text, "df")
    assert part in str(error.value)
