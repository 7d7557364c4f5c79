"""The translated equations in Node against Python, bit for bit."""

import inspect
import json
import shutil
import subprocess
import textwrap

import numpy as np
import pytest
from numpy import cos, sqrt
from plain_kernel import plain_module

import atlas
from atlas.extensions.page import motion
from atlas.extensions.page.motion import CannotTranslate, translate
from atlas.kernel import blocks
from atlas.kernel.augmented import with_frame_vector
from atlas.label.trajectory import frame_vector
from atlas.systems import SYSTEMS, arithmetic

NODE = shutil.which("node")
needs_node = pytest.mark.skipif(NODE is None, reason="Node.js is not installed")


def node(script: str, call: str, data: object) -> np.ndarray:
    """Numbers that a JavaScript expression gives for some data, with all their bits."""
    program = (
        f"{script}\nconst data = JSON.parse(require('fs').readFileSync(0, 'utf8'));\n"
        f"const numbers = Float64Array.from(({call}).flat(Infinity));\n"
        "process.stdout.write(Buffer.from(numbers.buffer).toString('hex'));"
    )
    done = subprocess.run(
        [NODE, "-e", program], input=json.dumps(data), capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    return np.frombuffer(bytes.fromhex(done.stdout), "<f8")


def arguments(system, count, seed=5):
    """Random states and constants of a system, positive where a moment of inertia or a length is."""
    generator = np.random.default_rng(seed)
    equations = system.equations
    state = generator.normal(size=(count, len(equations.STATE)))
    constants = generator.uniform(0.1, 2.0, size=(count, len(equations.CONSTANTS)))
    return state, constants


@needs_node
@pytest.mark.parametrize("system", SYSTEMS.values(), ids=lambda s: s.name)
def test_every_function_of_the_equations_has_the_same_bits(system):
    """Also the first integrals, which the page does not need."""
    equations = system.equations
    sources = arithmetic.functions(equations)
    state, constants = arguments(system, 200)
    calls, expected = [], []
    for name in sources:
        more = (0.037,) if name in ("scaled", "unscaled") else ()
        result = getattr(equations, name)(state.T, constants.T, *more)
        many = [isinstance(item, tuple) or np.ndim(item) == 2 for item in result]  # state or constants
        flat = [
            part
            for item, several in zip(result, many, strict=True)
            for part in (item if several else (item,))
        ]
        expected.append(np.stack(np.broadcast_arrays(*flat), -1).ravel())
        calls.append(f"data[0].map((y, i) => {name}$(y, data[1][i]{', 0.037' if more else ''}))")
    values = node(translate(sources), f"[{', '.join(calls)}]", [state.tolist(), constants.tolist()])
    assert np.array_equal(values, np.concatenate(expected))


@pytest.mark.usual("rk4")
@needs_node
@pytest.mark.parametrize("method", ["rk4", "rk8"])
@pytest.mark.parametrize("system", SYSTEMS.values(), ids=lambda s: s.name)
def test_two_thousand_steps_have_the_bits_of_the_kernel_in_plain_python(system, method, whole_kernels):
    """And their path is that of `atlas.trajectory`."""
    equations = with_frame_vector(system.equations)
    plain = plain_module(equations, method)
    given = {"theta0": 0.4, "psi0": 2.0, "n": 0.3, "m": 0.7, "C": 0.7}
    points = {name: np.array([given.get(name, each.default)]) for name, each in system.parameters.items()}
    state, constants = system.initial_state(points), system.constants(points)
    if equations is not system.equations:
        state = np.concatenate([state, frame_vector(system, points, state, constants)])
    start, constants = state[:, 0].tolist(), constants[:, 0].tolist()
    unit, steps = 0.02, 2000
    y, c = plain.scaled(blocks.start_state(plain, state)[:, 0].tolist(), constants, unit)
    for _ in range(steps):
        y = plain.step(y, plain.rhs(y, c), c)
    expected = plain.unscaled(y, c, unit)[: len(start)]
    script = translate(motion.sources(system, method))
    call = (
        f"(() => {{ let [y, c] = scaled$(data[0], data[1], {unit});"
        f" for (let i = 0; i < {steps}; i++) y = step$(y, rhs$(y, c), c); return unscaled$(y, c, {unit}); }})()"
    )
    end = node(script, f"((y) => [y, axis_in_frame$(y, data[1])])({call})", [start, constants])
    assert np.array_equal(end[:-2], expected)
    step = unit * plain.STEP
    tr = atlas.trajectory(system.name, given, duration=steps * step, samples=41, step=step, method=method)
    assert [float(tr.axis_x[-1]), float(tr.axis_y[-1])] == pytest.approx(end[-2:], abs=1e-10)


# One of each construct.
def everything(state, constants):
    x, y, z = state
    new, (Math, t) = -x, (constants, 2.0)
    first, second = Math
    x, y = y, x
    total = (x**2 + y**3 / t) ** 0.5 - z**-2 + (x + y) ** 5 + first**second + x**0
    return (sqrt(total * total), +cos(z), new), (1e-200, 3, 1.0 / 3.0)


@needs_node
def test_constructs():
    text = textwrap.dedent(inspect.getsource(everything))
    states = [0.3, -1.7, 2.0], [4.0, 0.25, 5.0], [-1.0, 8.0, 0.5]
    expected = [everything(state, (1.0, 0.75)) for state in states]
    values = node(translate({"everything": text}), "data.map((y) => everything$(y, [1.0, 0.75]))", states)
    np.testing.assert_allclose(values, np.ravel(expected), rtol=4e-16)


@needs_node
def test_an_observable_may_have_the_name_of_a_word_of_javascript():
    script = translate({"new": "def new(state, this):\n    return state * this"})
    assert node(f"{script}\nconst equations = {{new: new$}};", "[equations.new(data, 2)]", 1.5) == 3.0


@needs_node
def test_functions_agree_to_an_ulp_or_two():
    names = ("sin", "cos", "tan", "exp", "log", "sqrt", "atan", "sinh", "cosh", "tanh")
    text = f"def f(x):\n    return {', '.join(f'{name}(x)' for name in names)}"
    x = np.random.default_rng(2).uniform(0.1, 6.0, 500)
    results = node(translate({"f": text}), "data.map(f$)", x.tolist()).reshape(500, -1)
    expected = np.stack([getattr(np, {"atan": "arctan"}.get(name, name))(x) for name in names], -1)
    np.testing.assert_array_almost_equal_nulp(results, expected, 4)


@pytest.mark.parametrize(
    ("text", "fault"),
    [
        ("def f(x):\n    for i in x:\n        pass\n    return x", "for i in x:"),
        ("def f(x):\n    return [y for y in x]", "[y for y in x]"),
        ("def f(x):\n    return eval(x)", "eval"),
        ("def f(x):\n    return x.shape", "x.shape"),
        ("def f(x):\n    return unknown * x", "unknown"),
        ("def f(x):\n    return x[0]", "x[0]"),
        ("def f(x):\n    return x if x > 0.0 else -x", "x if x > 0.0 else -x"),
        ("def f(x):\n    if x > 0.0:\n        x = -x\n    return x", "if x > 0.0:"),
        ("def f(x):\n    return abs(x)", "abs"),
        ("def f(x):\n    return 'text'", "'text'"),
        ("def f(x):\n    a, b = x, x, x\n    return a", "(x, x, x)"),
        ("def f(x=1.0):\n    return x", "parameters"),
        ("def f(x):\n    return x % 2", "x % 2"),
        ("def f(x):\n    return sin(a=x)", "sin(a=x)"),
        ("def f(x) return x", "f:"),
    ],
)
def test_what_has_no_translation_is_named(text, fault):
    with pytest.raises(CannotTranslate) as error:
        translate({"f": text})
    assert str(error.value).startswith("f: ")
    assert fault in str(error.value)
