"""Balances of integrals that dissipation changes: the kernels that measure them, and errors that they must show."""

from __future__ import annotations

import importlib
from types import SimpleNamespace

import numpy as np
import pytest
from plain_kernel import plain_module
from plugins import PENDULUM
from scipy.integrate import quad_vec, solve_ivp
from strategies import default_points, random_satellites, select

import atlas
from atlas.errors import BadInput
from atlas.flags import Status
from atlas.kernel import assemble, augmented, blocks, tangent
from atlas.kernel.ensemble import Ensemble
from atlas.kernel.specialization import kernel
from atlas.kernel.statistics import Row
from atlas.kernel.tableaux import METHODS
from atlas.measure.circle import CIRCLES
from atlas.systems import arithmetic
from atlas.systems.satellite import SATELLITE, equations

LOSS_FUNCTIONS = ("jacobi_loss", "axial_momentum_loss")
# For trajectories of a sphere without an orbit, about its third axis along the normal: w3' = -damping w3 / C.
SLOWING_DOWN = {"A": 1.0, "B": 1.0, "C": 1.0, "Omega": 0.0, "m": 2.0}


def damped_satellites(count, seed=0, **given):
    rng = np.random.default_rng(seed)
    return random_satellites(rng, count, **{"damping": rng.uniform(0.1, 1.0, count)} | given)


def integrated(points, steps, duration, method="rk8", *, module=None, change=None, integral=None):
    """State with the sums of losses, and integral_drift; change: of the constants; integral: the only one that counts."""
    ensemble = Ensemble.of(SATELLITE, points)
    module = module or kernel(SATELLITE, method)
    values, scales = ensemble.constants.copy(), ensemble.scales
    for name, factor in (change or {}).items():
        values[equations.CONSTANTS.index(name)] *= factor
    if integral is not None:
        scales = np.zeros_like(scales)
        scales[list(equations.INTEGRALS).index(integral)] = ensemble.scales[
            list(equations.INTEGRALS).index(integral)
        ]
    schedule = blocks.pack_blocks(np.full(ensemble.size, steps), np.ones(ensemble.size, np.int64))
    arrays = ensemble.arrays(module, np.full(ensemble.size, duration / steps), 1e-5)
    arrays = arrays._replace(constants=values, scales=scales)
    blocks.integrate(module, schedule, arrays, threads=blocks.Threads(1))
    return arrays.state, arrays.sums[Row.DRIFT]


def without_losses():
    """The equations as they would be without LOSSES and its functions."""
    names = {name: value for name, value in vars(equations).items() if name.isupper() and name != "LOSSES"}
    sources = arithmetic.functions(equations)
    return arithmetic.module_of(
        equations, names, {n: t for n, t in sources.items() if n not in LOSS_FUNCTIONS}
    )


@pytest.mark.long
@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("more", [set(), {"k1", "k2", "k3", "mu1", "mu2", "mu3"}])
def test_the_text_of_kernels_without_damping_has_nothing_of_losses(method, more):
    zero, equal = SATELLITE.specialization({"damping"} | more, {("A", "B")})
    for frames in (0, 2):
        text = assemble.source(equations, method, zero, dict(equal), plugs=CIRCLES[:frames])
        assert "lost" not in text
        assert "loss" not in text.lower()
        assert text == assemble.source(without_losses(), method, zero, dict(equal), plugs=CIRCLES[:frames])
    damped = assemble.source(equations, method)
    assert damped != assemble.source(without_losses(), method)
    assert "LOSSES = ('jacobi', 'axial_momentum')" in damped


def test_kernels_with_tangent_vectors_have_no_losses():
    text = assemble.source(equations, "rk8", of=tangent)
    assert text == assemble.source(without_losses(), "rk8", of=tangent)


def test_losses_that_vanish():
    assert augmented.losses_of(equations, ("damping_A", "damping_B", "damping_C"), {}) == {}
    assert augmented.losses_of(equations, ("N",), {}) == equations.LOSSES
    assert augmented.losses_of(without_losses(), (), {}) == {}


@pytest.mark.usual("rk4")
@pytest.mark.parametrize("method", METHODS)
def test_the_compiled_kernel_is_the_python_one(method):
    points = damped_satellites(4)
    plain = integrated(points, 24, 1.0, method, module=plain_module(equations, method))
    compiled = integrated(points, 24, 1.0, method)
    np.testing.assert_allclose(compiled[0], plain[0], rtol=1e-12, atol=1e-13)
    np.testing.assert_allclose(compiled[1], plain[1], rtol=1e-3, atol=1e-14)


def test_the_sums_are_the_integrals_of_the_losses():
    """In the caller's units, against SciPy."""
    points, duration = damped_satellites(4, seed=1), 3.0
    state, drift = integrated(points, 200, duration)
    assert drift.max() < 1e-10
    values = SATELLITE.constants(points)
    for i in range(4):
        run = solve_ivp(lambda t, y, c=values[:, i]: equations.rhs(y, c), (0, duration), SATELLITE.initial_state(points)[:, i],
                        "DOP853", rtol=1e-12, atol=1e-13, dense_output=True)  # fmt: skip

        def rates(t, i=i, run=run):
            y = run.sol(t)
            u = y[:3] - points["Omega"][i] * y[6:]
            return points["damping"][i] * np.array([u @ u, u[2]])

        expected, _ = quad_vec(rates, 0, duration, epsabs=1e-11)
        np.testing.assert_allclose(state[9:, i], expected, rtol=1e-9, atol=1e-10)
        np.testing.assert_allclose(state[:9, i], run.y[:, -1], rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize("method", METHODS)
def test_the_change_is_that_of_the_method(method):
    """A decay with steps that are too long: the method written out, for w' = -z w and the sum of its loss."""
    step, count, damping = 0.25, 40, 2.4
    point = default_points("satellite", **SLOWING_DOWN, damping=damping)
    state, drift = integrated(point, count, step * count, method, integral="jacobi")
    tableau, w, lost, changes = METHODS[method], 2.0, 0.0, []
    for _ in range(count):
        rates = []
        for row in tableau.a:
            rates.append(w + step * sum(a * -damping * rate for a, rate in zip(row, rates, strict=False)))
        lost += step * sum(b * damping * rate * rate for b, rate in zip(tableau.b, rates, strict=True))
        w += step * sum(b * -damping * rate for b, rate in zip(tableau.b, rates, strict=True))
        changes.append(abs(0.5 * w * w + lost - 2.0) / 2.0)
    np.testing.assert_allclose(state[[2, 9], 0], [w, lost], rtol=1e-12)
    np.testing.assert_allclose(drift, max(changes), rtol=1e-6)
    assert max(changes) > (1e-4 if method == "rk4" else 1e-9)


@pytest.mark.parametrize("name", ["damping_A", "damping_B", "damping_C"])
def test_damping_that_is_wrong_by_a_millionth_is_noticed(name):
    """Of one axis alone, while the loss is that of another one."""
    points = damped_satellites(6, seed=2)
    assert integrated(points, 300, 3.0)[1].max() < 1e-12
    assert integrated(points, 300, 3.0, change={name: 1 + 1e-6})[1].min() > 1e-9


def test_a_wrong_loss_of_the_axial_momentum_is_noticed():
    given = {"A": 1.1, "B": 1.1} | dict.fromkeys(("k1", "k2", "mu1", "mu2", "drag1", "drag2"), 0.0)
    points = damped_satellites(6, seed=3, **given)
    assert integrated(points, 300, 3.0, integral="axial_momentum")[1].max() < 1e-13
    change = {"damping_C": 1 + 1e-6}
    assert integrated(points, 300, 3.0, integral="axial_momentum", change=change)[1].min() > 1e-9


def test_the_change_falls_with_the_order_of_the_method():
    points = damped_satellites(6, seed=4)
    for method, steps in (("rk4", 60), ("rk8", 16)):
        coarse, fine = (integrated(points, steps * k, 4.0, method)[1] for k in (1, 2))
        order = np.median(np.log2(coarse / fine))
        assert abs(order - METHODS[method].order) < 1.0


def test_the_scale_is_that_of_the_start_however_much_is_lost():
    """The energy of a free sphere falls to a thousandth; the change stays relative to its start, as the state's error."""
    point = default_points("satellite", **SLOWING_DOWN, damping=1.0)
    duration = 0.5 * np.log(1000.0)
    state, drift = integrated(point, 30, duration, "rk4", integral="jacobi")
    longer, later = integrated(point, 300, 10 * duration, "rk4", integral="jacobi")
    assert 0.5 * state[2, 0] ** 2 == pytest.approx(2e-3, rel=1e-3)
    assert longer[2, 0] ** 2 < 1e-25
    assert later[0] == pytest.approx(drift[0], rel=2e-3)


def test_a_point_has_the_same_bits_in_any_company():
    points = damped_satellites(40, seed=6)
    state, drift = integrated(points, 40, 2.0)
    for i in (0, 17, 39):
        alone = integrated(select(points, slice(i, i + 1)), 40, 2.0)
        np.testing.assert_array_equal(alone[0][:, 0], state[:, i])
        np.testing.assert_array_equal(alone[1][0], drift[i])


@pytest.mark.usefixtures("whole_kernels")
def test_a_decay_with_steps_that_are_too_long_has_its_status():
    """The directions hardly turn, so that their lengths are kept: only the energy shows the error."""
    point = SLOWING_DOWN | {"m": 1e-3, "damping": 10.0}
    settings = {"duration": 2.0, "method": "rk4", "progress": False}
    ds = atlas.label_points("satellite", point, step=0.07, **settings)
    assert ds.status == Status.DRIFT_EXCEEDED
    assert 1e-4 < ds.integral_drift < 1e-2
    assert atlas.label_points("satellite", point, step=0.01, **settings).status == Status.OK
    motion = atlas.trajectory("satellite", point, duration=2.0, step=0.07, method="rk4", samples=30)
    assert motion.integral_drift[-1] > 1e-4
    assert atlas.trajectory("satellite", point, duration=2.0, samples=30).integral_drift.max() < 1e-8


def test_names_of_sums_are_new():
    """An author may have a constant of that name."""
    with_constant = SimpleNamespace(
        STATE=("v",), CONSTANTS=("energy_lost", "unit"), INTEGRALS={"energy": 0}, LOSSES={"energy": "power"}, ONES=(),
        SOURCES={
            "rhs": "def rhs(state, constants):\n    v, = state\n    energy_lost, unit = constants\n    return -energy_lost * v,",
            "energy": "def energy(state, constants):\n    v, = state\n    return 0.5 * v * v,",
            "power": "def power(state, constants):\n    v, = state\n    energy_lost, unit = constants\n    return energy_lost * v * v",
            "scaled": "def scaled(state, constants, h):\n    return state, constants",
            "unscaled": "def unscaled(state, constants, h):\n    return state",
        },
    )  # fmt: skip
    extended = augmented.with_losses(with_constant, with_constant.LOSSES)
    assert extended.STATE == ("v", "energy_lost_")
    assert extended.rhs((2.0, 7.0), (0.5, 1.0)) == (-1.0, 2.0)
    assert extended.energy((2.0, 7.0), (0.5, 1.0)) == (2.0, 7.0)


# Systems with observables.

FRICTION = (
    PENDULUM.replace('("omega", "cubic")', '("omega", "cubic", "friction")')
    .replace("omega, cubic = constants", "omega, cubic, friction = constants")
    .replace("- cubic * x * x * x\n", "- cubic * x * x * x - friction * v\n")
    .replace('INTEGRALS = ("energy",)', 'INTEGRALS = ("energy",)\n        LOSSES = {"energy": "power"}')
    .replace(
        "        def height",
        "        def power(state, constants):\n            x, v = state\n"
        "            omega, cubic, friction = constants\n            return friction * v * v\n\n        def height",
    )
    .replace(
        'Parameter("x0"', 'Parameter("friction", "s-1", "friction", 0.0, 0.0),\n            Parameter("x0"'
    )
)


def register(text, folder, monkeypatch):
    """Register the pendulum of this text; the folder has the name of the test."""
    (folder / f"{folder.name}.py").write_text(text)
    monkeypatch.syspath_prepend(folder)
    atlas.register(importlib.import_module(folder.name).Pendulum)


@pytest.mark.long
@pytest.mark.parametrize(("factor", "least", "most"), [("", 0.0, 1e-9), ("1.000001 * ", 1e-7, 1e-5)])
def test_friction_of_a_pendulum(tmp_path, monkeypatch, own_systems, factor, least, most):
    text = FRICTION.replace("return friction", f"return {factor}friction")
    register(text, tmp_path, monkeypatch)
    points = {"friction": [0.05, 0.2, 1.0], "x0": 2.0, "cubic": 0.1}
    ds = atlas.label_points("pendulum", points, duration=30.0, tolerance=1e-9, progress=False)
    assert (ds.integral_drift >= least).all()
    assert (ds.integral_drift <= most).all()
    motion = atlas.trajectory("pendulum", {"friction": 0.2, "x0": 2.0}, duration=30.0, tolerance=1e-9)
    assert least <= motion.integral_drift[-1] <= most
    assert abs(motion.v[-1]) < 0.1


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (("def power", "def powers"), "the function power(state, constants) is missing"),
        (('{"energy": "power"}', "3"), "LOSSES = 3; allowed: a mapping of first integrals to functions"),
        (('{"energy": "power"}', '{"energie": "power"}'), "LOSSES: 'energie' is no first integral; did you mean"),
        (("return friction * v * v", "return friction * v * v,"), "power: it returns a tuple of 1; allowed: one number"),
        (
            ("    observables = (", '    observables = (\n        Observable("power", "s-2", "power"),'),
            "LOSSES: 'power' is an observable; choose another function",
        ),
        (('"power"', '"integrate"'), "the function integrate(state, constants) is missing"),
    ],
)  # fmt: skip
def test_mistakes_of_authors(tmp_path, monkeypatch, own_systems, change, message):
    with pytest.raises(BadInput) as error:
        register(FRICTION.replace(*change), tmp_path, monkeypatch)
    assert message in str(error.value)
    assert "\n" not in str(error.value)
