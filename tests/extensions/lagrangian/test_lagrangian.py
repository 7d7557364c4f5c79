"""Modules of equations written from Lagrangians, against equations that were derived in other ways."""

import importlib.util
import sys
from pathlib import Path

import numpy as np
import pytest
import sympy as sp
from refusals import assert_refused
from scipy.integrate import solve_ivp
from sympy.physics.mechanics import LagrangesMethod, dynamicsymbols

import atlas
from atlas.extensions.lagrangian.lagrangian import _is_singular, from_lagrangian
from atlas.extensions.lagrangian.sympy_text import text
from atlas.systems import arithmetic
from atlas.systems.fixed_point import equations as fixed_point

THETA, PSI, PHI, THETA_DOT, PSI_DOT, PHI_DOT = sp.symbols("theta psi phi theta_dot psi_dot phi_dot")
X, Y, U, V, M, K = sp.symbols("x y u v m k")
OSCILLATOR = M * U**2 / 2 - K * X**2 / 2


def module_of(source, folder):
    path = folder / "equations.py"
    path.write_text(source)
    spec = importlib.util.spec_from_file_location("equations", path)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def drift(module, state, constants, duration=20.0):
    """Largest relative change of each first integral along a motion."""
    run = solve_ivp(
        lambda _, y: module.rhs(y, constants), (0, duration), state, "DOP853", rtol=1e-12, atol=1e-13
    )
    changes = {}
    for name in module.INTEGRALS:
        terms = np.array(np.broadcast_arrays(*getattr(module, name)(run.y, constants)))
        total = terms.sum(0)
        changes[name] = np.abs(total - total[0]).max() / np.abs(terms).sum(0).max()
    return changes


def gyrostat():
    """Lagrangian of a gyrostat in Euler angles, and its angular velocity and vertical in body axes."""
    A, B, C, l1, l2, l3, Mx, My, Mz = parameters = sp.symbols("A B C l1 l2 l3 Mx My Mz")
    sine, cosine = sp.sin(THETA), sp.cos(THETA)
    w = (
        PSI_DOT * sine * sp.sin(PHI) + THETA_DOT * sp.cos(PHI),
        PSI_DOT * sine * sp.cos(PHI) - THETA_DOT * sp.sin(PHI),
        PSI_DOT * cosine + PHI_DOT,
    )
    g = (sine * sp.sin(PHI), sine * sp.cos(PHI), cosine)
    L = (A * w[0] ** 2 + B * w[1] ** 2 + C * w[2] ** 2) / 2 + l1 * w[0] + l2 * w[1] + l3 * w[2]
    return L + Mx * g[0] + My * g[1] + Mz * g[2], parameters, w, g


@pytest.fixture(scope="module")
def in_euler_angles(tmp_path_factory):
    L, parameters, w, g = gyrostat()
    source = from_lagrangian(
        L, [THETA, PSI, PHI], [THETA_DOT, PSI_DOT, PHI_DOT], parameters, omit=[PSI],
        functions={"frame_motion": (*w, *g), "height": g[2]},
    )  # fmt: skip
    return module_of(source, tmp_path_factory.mktemp("gyrostat"))


@pytest.mark.long
def test_gyrostat_in_euler_angles_agrees_with_the_euler_poisson_equations(in_euler_angles):
    rng = np.random.default_rng(1)
    moments = rng.uniform(0.5, 1.0, (3, 20))
    A, B, C = moments.sum(0) - moments
    rotor_and_weight = rng.uniform(-1, 1, (6, 20))
    state = rng.uniform(-1, 1, (5, 20)) + np.array([[1.5], [0], [0], [0], [0]])
    constants = np.array([A, B, C, *rotor_and_weight])
    assert in_euler_angles.STATE == ("theta", "phi", "theta_dot", "psi_dot", "phi_dot")
    slope = np.array(in_euler_angles.rhs(state, constants))
    change = 1e-30j * slope  # of the state, so that the imaginary part is the time derivative of the motion
    along = np.array(in_euler_angles.frame_motion(state + change, constants)).imag / 1e-30
    motion = np.array(in_euler_angles.frame_motion(state, constants))
    none = np.zeros(20)
    body = [A, B, C, 1 / A, 1 / B, 1 / C, *rotor_and_weight, none, none, none, none]
    np.testing.assert_allclose(along, fixed_point.rhs(motion, body), atol=1e-13)
    np.testing.assert_allclose(in_euler_angles.height(state, constants), np.cos(state[0]))


def test_gyrostat_conserves_energy_and_the_momentum_of_precession(in_euler_angles):
    assert in_euler_angles.INTEGRALS == ("energy", "momentum_psi")
    state = [1.0, 0.3, 0.2, 0.7, -0.4]
    constants = [1.0, 1.3, 1.7, 0.2, -0.1, 0.3, 0.2, 0.1, -0.5]
    changes = drift(in_euler_angles, state, constants)
    assert set(changes) == {"energy", "momentum_psi"}
    assert max(changes.values()) < 1e-10


@pytest.fixture(scope="module")
def double_pendulum():
    a1, a2, w1, w2, m1, m2, l1, l2, g = sp.symbols("a1 a2 w1 w2 m1 m2 l1 l2 g")
    x1, y1 = l1 * sp.sin(a1), -l1 * sp.cos(a1)
    x2, y2 = x1 + l2 * sp.sin(a2), y1 - l2 * sp.cos(a2)
    L = sum(
        m / 2 * sum((place.diff(a1) * w1 + place.diff(a2) * w2) ** 2 for place in (x, y)) - m * g * y
        for m, x, y in ((m1, x1, y1), (m2, x2, y2))
    )
    return from_lagrangian(L, [a1, a2], [w1, w2], [m1, m2, l1, l2, g])


@pytest.mark.long
def test_double_pendulum_agrees_with_the_textbook(double_pendulum, tmp_path):
    module = module_of(double_pendulum, tmp_path)
    rng = np.random.default_rng(2)
    state, constants = rng.uniform(-3, 3, (4, 50)), rng.uniform(0.5, 2, (5, 50))
    a1, a2, w1, w2 = state
    m1, m2, l1, l2, g = constants
    # The solved form as printed in many places, such as myphysicslab.com/pendulum/double-pendulum-en.html
    below = 2 * m1 + m2 - m2 * np.cos(2 * a1 - 2 * a2)
    first = -g * (2 * m1 + m2) * np.sin(a1) - m2 * g * np.sin(a1 - 2 * a2)
    first -= 2 * np.sin(a1 - a2) * m2 * (w2**2 * l2 + w1**2 * l1 * np.cos(a1 - a2))
    second = w1**2 * l1 * (m1 + m2) + g * (m1 + m2) * np.cos(a1) + w2**2 * l2 * m2 * np.cos(a1 - a2)
    textbook = w1, w2, first / (l1 * below), 2 * np.sin(a1 - a2) * second / (l2 * below)
    np.testing.assert_allclose(module.rhs(state, constants), textbook, rtol=1e-11, atol=1e-11)
    assert module.INTEGRALS == ("energy",)
    assert drift(module, [2.0, 1.0, 0.0, 0.5], [1.0, 0.5, 1.0, 0.7, 9.81], 5.0)["energy"] < 1e-9


@pytest.mark.long
def test_equations_agree_with_those_of_sympy(tmp_path):
    """A pendulum on a cart in a rotating plane: a coupled mass matrix and terms linear in the velocities."""
    x, angle = dynamicsymbols("x angle")
    spin, length = sp.symbols("spin length")
    along, up = x + length * sp.sin(angle), -length * sp.cos(angle)

    def lagrangian(at, t):
        a, b, c = (e.diff(t) for e in (x, along, up))
        energy = M * a**2 / 2 + (b**2 + c**2) / 2 + spin * (along * c - up * b) - 3 * up - K * x**4 / 4
        return energy.doit().subs(at, simultaneous=True) if at else energy.doit()

    t = dynamicsymbols._t
    method = LagrangesMethod(lagrangian({}, t), [x, angle])
    method.form_lagranges_equations()
    plain = {x.diff(t): U, angle.diff(t): V, x: X, angle: Y}
    forces = {X: -0.3 * U**3, Y: sp.cos(X)}
    expected = method.mass_matrix.subs(plain).solve(
        method.forcing.subs(plain) + sp.Matrix([forces[X] - 0.4 * U, forces[Y] + 0.2 * U - 0.2 * V])
    )
    source = from_lagrangian(
        lagrangian(plain, t), [X, Y], [U, V], [M, K, spin, length],
        forces={X: forces[X] - 0.2 * V, Y: forces[Y]}, dissipation=0.2 * U**2 + 0.1 * V**2 - 0.2 * U * V,
    )  # fmt: skip
    assert source.count("Q_x =") == source.count("R =") == 1
    module = module_of(source, tmp_path)
    assert module.INTEGRALS == ()
    # the force -0.2 v on x beside that of the dissipation, +0.2 v, cancels
    rng = np.random.default_rng(3)
    state, constants = rng.uniform(-1, 1, (4, 9)), rng.uniform(0.5, 2, (4, 9))
    value = sp.lambdify([X, Y, U, V, M, K, spin, length], list(expected), "numpy")
    np.testing.assert_allclose(
        module.rhs(state, constants)[2:], value(*state, *constants), rtol=1e-11, atol=1e-11
    )


def test_gyroscopic_forces_keep_the_energy_and_resistance_does_not():
    L = M * (U**2 + V**2) / 2 - K * (X**2 + Y**2) / 2
    arguments = L, [X, Y], [U, V], [M, K]
    assert 'INTEGRALS = ("energy",)' in from_lagrangian(*arguments, forces={X: K * V, Y: -K * U})
    assert "INTEGRALS = ()" in from_lagrangian(*arguments, forces={X: -K * U})
    assert "INTEGRALS = ()" in from_lagrangian(*arguments, forces={X: -K * U}, dissipation=V**2)
    assert "LOSSES" not in from_lagrangian(*arguments, forces={X: K * V, Y: -K * U})


def test_losses_by_dissipation(tmp_path):
    """The rates of energy and momentum along the equations are those that the module returns."""
    source = from_lagrangian(
        M * U**2 * (1 + Y**2) / 2 + V**2 / 2 - K * Y**4, [X, Y], [U, V], [M, K],
        forces={X: 3 * V, Y: -3 * U}, dissipation=0.3 * U**2 + K * Y**2 * V**4,
    )  # fmt: skip
    module = module_of(source, tmp_path)
    assert module.INTEGRALS == ("energy",)
    assert module.LOSSES == {"energy": "energy_loss"}
    arguments = M * U**2 / 2 + V**2 / 2 - Y**2, [X, Y], [U, V], [M]
    moving = module_of(from_lagrangian(*arguments, dissipation=M * U**2 * V**2), tmp_path)
    assert moving.INTEGRALS == ("energy", "momentum_x")
    assert moving.LOSSES == {"energy": "energy_loss", "momentum_x": "momentum_x_loss"}
    rng = np.random.default_rng(4)
    for each, names in ((module, [M, K]), (moving, [M])):
        state, constants = rng.uniform(-1, 1, (4, 9)), rng.uniform(0.5, 2, (len(names), 9))
        slopes = np.array(each.rhs(state, constants))
        for name, loss in each.LOSSES.items():
            step = 1e-6
            ahead, behind = (sum(getattr(each, name)(state + s * slopes, constants)) for s in (step, -step))
            rate = (ahead - behind) / (2 * step)
            np.testing.assert_allclose(-getattr(each, loss)(state, constants), rate, rtol=1e-7, atol=1e-8)


def test_a_free_particle_and_its_momenta(tmp_path):
    source = from_lagrangian(M * (U**2 + V**2) / 2 - 3 * Y, [X, Y], [U, V], [M], title="A falling body")
    assert source.startswith('"""A falling body.\n')
    module = module_of(source, tmp_path)
    assert module.INTEGRALS == ("energy", "momentum_x")
    state, constants = np.ones((4, 5)), np.full((1, 5), 2.0)
    slopes = np.array(module.rhs(state, constants))  # components that depend on no state have its shape, too
    np.testing.assert_array_equal(slopes[:, 0], [1.0, 1.0, 0.0, -1.5])
    np.testing.assert_array_equal(module.momentum_x(state, constants), np.full((1, 5), 2.0))


def test_a_mass_that_depends_on_the_velocity(tmp_path):
    module = module_of(from_lagrangian(-sp.sqrt(1 - U**2) - X, [X], [U], []), tmp_path)
    u = np.linspace(-0.9, 0.9, 7)
    np.testing.assert_allclose(module.rhs((0 * u, u), ())[1], -((1 - u**2) ** 1.5), rtol=1e-13)
    np.testing.assert_allclose(sum(module.energy((u, u), ())), 1 / np.sqrt(1 - u**2) + u, rtol=1e-13)


@pytest.mark.parametrize(
    "expression",
    [
        X, -X, X - Y, -X - Y, X**2 - 3 * Y, X / 3, 2 * X / 3, X / 8, -X / (Y * M), X / (Y + M), X**-1, X**-2 * Y,
        X**5, X**-5, (X + Y) ** 2, (X + Y) ** -2, sp.sqrt(X), X / sp.sqrt(Y), X ** sp.Rational(3, 2), X**0.3, X**M,
        sp.exp(-X), sp.exp(X) / 3, sp.sin(X) ** 2 * sp.cos(Y) ** 3, sp.log(X) - sp.tan(Y), sp.pi * X, sp.sqrt(2) * X, -sp.E,
        0.1 * X, 1e-20 * X, X - (Y - M), -(X + Y) * (X - Y), (X - Y) / (X + 2 * Y), 2 ** X, sp.Integer(0),
    ],
    ids=str,
)  # fmt: skip
def test_text_of_expressions_has_their_value(expression):
    values = {X: 0.7, Y: 1.3, M: 2.1}
    names = {name: getattr(np, name) for name in ("sqrt", "sin", "cos", "tan", "exp", "log")}
    names |= {str(symbol): value for symbol, value in values.items()}
    assert eval(text(expression), names) == pytest.approx(float(expression.subs(values)), rel=1e-14)


def test_written_file_is_the_text_and_is_replaced(tmp_path):
    path = tmp_path / "oscillator.py"
    path.write_text("old")
    assert from_lagrangian(OSCILLATOR, [X], [U], [M, K], path=path) == path.read_text()


@pytest.mark.parametrize(
    ("arguments", "options", "sentence"),
    [
        ((OSCILLATOR + Y, [X], [U], [M, K]), {}, "lagrangian contains y, which is neither coordinate, velocity nor parameter"),
        ((OSCILLATOR, [X, Y], [U], [M, K]), {}, "2 coordinates and 1 velocities: each coordinate needs one velocity"),
        ((OSCILLATOR, [X, Y], [U, V], [M, K]), {}, "the velocity v does not occur in the Lagrangian"),
        (((U + V) ** 2 - X * Y, [X, Y], [U, V], []), {}, "the mass matrix, ..., is singular: the equations cannot be solved for the accelerations"),
        ((OSCILLATOR - sp.Abs(X), [X], [U], [M, K]), {}, "lagrangian contains 'Abs(x)'; allowed: symbols, real numbers, ..."),
        ((OSCILLATOR - sp.I * X, [X], [U], [M, K]), {}, "lagrangian contains 'I'; allowed: symbols, real numbers, ..."),
        ((sp.Function("f")(X) + U**2, [X], [U], []), {}, "lagrangian contains 'f(x)'; allowed: ...; write coordinates and velocities as plain symbols, not as functions of the time"),
        ((OSCILLATOR, ["x"], [U], [M, K]), {}, "coordinates: 'x' is not a symbol; make one by sympy.Symbol('name')"),
        (("m*u**2", [X], [U], [M, K]), {}, "lagrangian = 'm*u**2': must be an expression of SymPy"),
        ((OSCILLATOR, [X], [U], [M, K, X]), {}, "the name x is given twice"),
        ((U**2, [X], [U], [sp.Symbol("lambda")]), {}, "'lambda' cannot be a name of the equations"),
        ((OSCILLATOR, [X], [U], [M, K]), {"forces": {Y: U}}, "forces: y is not one of the coordinates"),
        ((OSCILLATOR, [X], [U], [M, K]), {"omit": [X]}, "omit: x is not cyclic: the Lagrangian or a force depends on it"),
        ((M * U**2, [X], [U], [M]), {"omit": [X], "functions": {"height": X}}, "omit: the function height depends on x"),
        ((OSCILLATOR, [X], [U], [M, K]), {"functions": {"rhs": X}}, "'rhs' cannot be a name of the equations"),
        *(((OSCILLATOR, [X], [U], [M, K]), {"functions": {name: X}}, f"'{name}' cannot be a name of the equations")
          for name in ("STATE", "CONSTANTS", "INTEGRALS", "LOSSES", "ONES")),
        ((U**2 + sp.Function("sin")(X), [X], [U], []), {}, "lagrangian contains 'sin(x)'; allowed: ...; write coordinates and velocities as plain symbols, not as functions of the time"),
        ((U**2 + sp.Function("sin")(X, U), [X], [U], []), {}, "lagrangian contains 'sin(x, u)'; allowed: ...; write coordinates and velocities as plain symbols, not as functions of the time"),
        ((U**2, X, [U], []), {}, "coordinates = x: must be a sequence of symbols"),
        ((U**2, [X], [U], []), {"omit": X}, "omit = x: must be a sequence of symbols"),
        ((U**2, [X], [U], []), {"forces": [X]}, "forces = [x]: must be a mapping"),
        ((0.3 * (U + 0.1 * V) ** 2 - X * Y, [X, Y], [U, V], []), {}, "the mass matrix, ..., is singular: the equations cannot be solved for the accelerations"),
        ((U * V + U * THETA_DOT + X * V * THETA_DOT - Y, [X, Y, THETA], [U, V, THETA_DOT], []), {}, "the mass matrix has a principal minor that is 0: it must be positive definite where it couples more than two velocities"),
        (((U + V) ** 2 + U * THETA_DOT - X * Y, [X, Y, THETA], [U, V, THETA_DOT], []), {}, "the mass matrix has a principal minor that is 0: it must be positive definite where it couples more than two velocities"),
    ],
)  # fmt: skip
def test_bad_input_is_one_line(arguments, options, sentence):
    assert_refused(lambda: from_lagrangian(*arguments, **options), f"from_lagrangian: {sentence}")


def test_regular_mass_matrices_are_not_called_singular():
    """Some have no value at small numbers, or a determinant of 1e-10; the others vanish for all values."""
    W, R, C = sp.symbols("w r c")
    velocities = (U, V, W)
    regular = (
        sp.sqrt(1 - (U**2 + V**2 + W**2) / C**2),
        sp.sqrt((1 - 2 * M / R) - U**2 / (1 - 2 * M / R) - R**2 * V**2) + W**2,
        sp.sqrt(X - 1) * (U**2 + V**2 + W**2),
        (U + V) ** 2 / 2 + 1e-10 * V**2 / 2 + W**2,
        (U + V) ** 2 / 2 + sp.Rational(1, 10**20) * V**2 / 2 + W**2,
    )
    singular = (
        sp.sqrt(U**2 + V**2 + W**2),
        (U * sp.cos(X) + V * sp.sin(Y) + W) ** 2 + M * (U - V) ** 2,
        0.3 * (U + 0.1 * V) ** 2 + W**2,
    )
    for lagrangians, expected in ((regular, False), (singular, True)):
        for lagrangian in lagrangians:
            assert _is_singular(sp.hessian(lagrangian, velocities).tolist()) == expected


def test_functions_without_a_value_give_no_warning(tmp_path):
    source = from_lagrangian(U**2 / 2 + sp.sqrt(1 - 3 * X**2), [X], [U], [])
    equations = arithmetic.completed(module_of(source, tmp_path), [])
    assert np.isnan(sum(equations.energy((1.0, 1.0), (1.0,))))


def test_sympy_is_needed(monkeypatch):
    monkeypatch.setitem(sys.modules, "sympy", None)
    with pytest.raises(atlas.BadInput, match=r"pip install sympy"):
        from_lagrangian(OSCILLATOR, [X], [U], [M, K])


def test_equations_of_the_example_of_a_double_pendulum_are_those_of_its_lagrangian():
    """The text is what another process, with other hashes of texts, has written."""
    folder = Path(__file__).parents[3] / "docs" / "examples" / "double_pendulum"
    spec = importlib.util.spec_from_file_location("write_equations", folder / "write_equations.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    assert module.equations() == (folder / "double_pendulum" / "equations.py").read_text()
