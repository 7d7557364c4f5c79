"""Scenes pay only for what they need: specialised kernels and label-only runs give the same answers."""

import ast
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from installed import example_scenes
from strategies import DRAG, BySystem, evaluate, specialization_of

import atlas
from atlas.flags import Label, Status
from atlas.kernel.differentiate import simplify
from atlas.kernel.specialization import GENERIC
from atlas.label.plan import Plan
from atlas.scene.model import Settings
from atlas.scene.read import load_scene
from atlas.systems import SYSTEMS


def random_points(system, count, rng, zero=(), symmetric=False):
    points = {}
    for name, p in system.parameters.items():
        points[name] = np.full(count, p.default) if np.isnan(p.default) else rng.normal(size=count) * 0.5
    points |= {name: rng.uniform(1.0, 1.4, count) for name in ("A", "B")} | {
        "C": rng.uniform(0.5, 1.9, count)
    }
    if "Omega" in points:
        points["Omega"] = rng.uniform(0.5, 1.5, count)
    if "damping" in points:
        points["damping"] = np.abs(points["damping"])
    points["theta0"] = rng.uniform(0.3, 2.8, count)
    points |= {name: np.zeros(count) for name in zero}
    return points | ({"B": points["A"]} if symmetric else {})


AXIAL = ("k1", "k2", "drag1", "drag2")
CASES = BySystem({
    "satellite": [
        (("mu1", "mu2", "mu3"), False), (("h1", "h3"), False), (("h1", "h3", "k1", "k2"), False),
        ((*AXIAL, "mu1", "mu2"), True), ((*AXIAL, "h1", "h3"), True), (DRAG, False), ((*DRAG, "damping"), False),
        ((*DRAG, "mu1", "mu2", "k1", "k2"), True),
        (("mu1", "mu2", "mu3", "k1", "k2", "k3"), False), ((*AXIAL, "h1", "h3", "k3"), True),
        (("Omega",), False), ((*AXIAL, "Omega", "mu1", "mu2"), True),
        (("damping",), False), ((*AXIAL, "damping", "mu1", "mu2"), True),
        ((*AXIAL, "damping", "mu1", "mu2", "mu3", "h1", "h3"), True),
    ],
    "fixed_point": [(("damping",), False)],
})  # fmt: skip


@pytest.mark.parametrize(
    ("system_name", "zero", "symmetric"), [(s, *case) for s, cases in CASES.items() for case in cases]
)
def test_a_kernel_that_leaves_terms_out_gives_the_same_to_roundoff(system_name, zero, symmetric):
    """The simplified right-hand side, as Python, against the whole one at random states; no kernel is compiled."""
    system = SYSTEMS[system_name]
    points = random_points(system, 20, np.random.default_rng(1), zero, symmetric)
    specialization = specialization_of(system, points)
    assert specialization != GENERIC
    state, constants = system.initial_state(points), system.constants(points)
    source = ast.unparse(next(n for n in ast.parse(Path(system.equations.__file__).read_text()).body
                              if isinstance(n, ast.FunctionDef) and n.name == "rhs"))  # fmt: skip
    simplified = simplify(source, specialization.zero, dict(specialization.equal))
    assert sum(isinstance(n, ast.BinOp) for n in ast.walk(ast.parse(simplified))) < sum(
        isinstance(n, ast.BinOp) for n in ast.walk(ast.parse(source))
    )
    namespace: dict = {}
    exec(simplified, namespace)
    whole = np.array(system.equations.rhs(state, constants))
    part = np.array([np.broadcast_to(x, 20) for x in namespace["rhs"](state, constants)])
    np.testing.assert_allclose(part, whole, rtol=1e-13, atol=1e-14)


@pytest.mark.parametrize(
    ("text", "simplified"),
    [
        ("N * x * y - x * z", "x * (y - z)"), ("x * y * z - x * N", "x * y * z - x"), ("x * N - N", "x - 1.0"),
        ("z * x - y * x", "z * x - y * x"), ("o * N + x * y - x * z", "x * (y - z)"), ("x - o * N", "x"),
        ("(x + z) * y - (x + z) * x", "(x + z) * y - (x + z) * x"), ("x / N * y - x / N * z", "x / 1.0 * y - x / 1.0 * z"),
    ],
)  # fmt: skip
def test_folding(text, simplified):
    names = "def f(x, y, z, o, N):\n    return "
    result = simplify(names + text, {"o"}, {}, {"N", "o"})
    assert result == names + simplified
    namespaces: list[dict] = [{}, {}]
    for namespace, code in zip(namespaces, (names + text, result), strict=True):
        exec(code, namespace)
    assert namespaces[1]["f"](3.0, 5.0, 7.0, 0.0, 1.0) == namespaces[0]["f"](3.0, 5.0, 7.0, 0.0, 1.0)


@pytest.mark.parametrize("h", [1e-3, 0.7, 40.0])
@pytest.mark.parametrize("system_name", SYSTEMS)
def test_the_units_of_the_kernels_change_no_motion(system_name, h):
    """Slopes, integrals, frame and axis in the kernels' units are those of the caller times powers of h."""
    system = SYSTEMS[system_name]
    equations, points = system.equations, random_points(system, 20, np.random.default_rng(3))
    if "Omega" in points:
        points["Omega"][:4] = [0.0, 1e-120, 1e-90, -0.8]
    state, constants = system.initial_state(points), system.constants(points)
    inner, fixed = map(np.array, equations.scaled(state, constants, h))
    slopes = equations.scaled(np.array(equations.rhs(state, constants)), constants, h)[0]
    close = {"rtol": 1e-12, "atol": 1e-14 * h * h}
    np.testing.assert_allclose(equations.rhs(inner, fixed), h * np.array(slopes), **close)
    np.testing.assert_allclose(equations.unscaled(inner, fixed, h), state, rtol=4e-16, atol=0)
    for name, power in equations.INTEGRALS.items():
        outer, kernel_units = (
            sum(getattr(equations, name)(*given)) for given in ((state, constants), (inner, fixed))
        )
        np.testing.assert_allclose(
            kernel_units, outer * h**power, rtol=1e-12, atol=1e-13 * h**power, err_msg=name
        )
    motions = [np.array(equations.frame_motion(*given)) for given in ((state, constants), (inner, fixed))]
    turned = np.array(equations.frame_motion(2 * state[:, ::-1] - state, constants[:, :1]))
    parts = [np.array(equations.frame_motion(part, constants[:, :1])) for part in (state[:, ::-1], state)]
    np.testing.assert_allclose(turned, 2 * parts[0] - parts[1], atol=1e-14)
    motions[0][:3] *= h
    np.testing.assert_allclose(motions[1], motions[0], rtol=1e-12, atol=1e-15 * h)
    for name in equations.ONES:
        value = fixed[equations.CONSTANTS.index(name)]
        np.testing.assert_allclose(value[points["Omega"] ** 2 > 1e-150], 1.0, rtol=1e-14)
    if hasattr(equations, "axis_in_frame"):
        outer, kernel_units = (
            equations.axis_in_frame(*given) for given in ((state, constants), (inner, fixed))
        )
        np.testing.assert_allclose(kernel_units, outer, atol=1e-14)


@pytest.mark.usual("fixed_point")
@pytest.mark.parametrize("system_name", SYSTEMS)
def test_specialised_and_whole_kernels_agree_on_labels_and_rates(system_name):
    """With the kernels of the small scene, which other tests compile as well, and of the quickstart."""
    system = SYSTEMS[system_name]
    zero, symmetric = CASES[system_name][-1]
    points = random_points(system, 64, np.random.default_rng(2), zero, symmetric)
    duration = np.full(64, 6.0)
    options = Settings(tolerance=1e-6)
    generic, specialized = (
        evaluate(system, points, points, duration, options, specialization=specialization)
        for specialization in (GENERIC, specialization_of(system, points))
    )
    np.testing.assert_array_equal(generic["label"], specialized["label"])
    np.testing.assert_allclose(
        generic["normal_rate_mean"], specialized["normal_rate_mean"], rtol=1e-8, atol=1e-9
    )


def test_nothing_is_left_out_that_an_axis_a_tie_or_a_solution_can_move(small_scene):
    scene = load_scene(small_scene)
    zero, symmetric = scene.zero_and_equal_parameters()
    assert {"k1", "k2", "mu1", "mu2", "mu3", "h1", "h3", "n"} <= zero
    assert not zero & {"k3", "m", "theta0", "C"}
    assert ("A", "B") in symmetric
    moved = load_scene(
        small_scene.replace('B = "A"', 'B = "1.01 * A"\nmu1 = "0 * A"').replace(
            "[family]", "[axes.h1]\nvalues = [0.0]\n[family]"
        )
    )
    zero, symmetric = moved.zero_and_equal_parameters()
    assert not zero & {"mu1", "h1"}
    assert ("A", "B") not in symmetric


def test_the_example_scenes_share_fourteen_kernels():
    """Two of them are that of drag and its tangents."""
    scenes = [load_scene(path) for path in example_scenes()]
    assert len(scenes) >= 35
    plans = [Plan.of(scene) for scene in scenes]
    kernels = {(plan.system.name, plan.settings.method, plan.specialization, plan.plugs) for plan in plans}
    tangents = {(plan.system.name, plan.specialization) for plan in plans if plan.has_chaos}
    assert len(kernels) + len(tangents) <= 14


@settings(max_examples=12)
@given(st.integers(0, 10**6), st.sampled_from(sorted(SYSTEMS)), st.sampled_from([1e-5, 1e-3, 0.05]),
       st.sampled_from(["rk4", "rk8"]))  # fmt: skip
def test_label_only_runs_give_the_same_labels(seed, system_name, tolerance, method):
    """Random points, some exactly steady, some on the vertical, several step counts and strides."""
    system, rng = SYSTEMS[system_name], np.random.default_rng(seed)
    points = random_points(system, 90, rng)
    for name in points:
        if name not in ("A", "B", "C", "Omega", "theta0"):
            points[name][rng.random(90) < 0.6] *= 0.0
    points["B"] = np.where(rng.random(90) < 0.7, points["A"], points["B"])
    points["theta0"] = np.where(
        rng.random(90) < 0.3, rng.choice([0.0, np.pi, 1e-6, 1e-4], 90), points["theta0"]
    )
    duration = rng.choice([3.0, 8.0, 20.0], 90)
    options = Settings(tolerance=1e-5, rate_tolerance=tolerance, method=method)
    whole = evaluate(system, points, points, duration, options)
    label_only = evaluate(system, points, points, duration, options, outputs=("label",))
    early = label_only["end_time"] < duration
    # Guards are evaluated up to the stop: a point that fails them only later was already certain to drift.
    later = early & (whole["status"] != Status.OK) & (label_only["status"] == Status.OK)
    assert (label_only["label"][later] == Label.DRIFTING).all()
    assert later.mean() < 0.1
    for name in ("label", "geometry", "status", "predicted", "agreement"):
        np.testing.assert_array_equal(label_only[name][~later], whole[name][~later], err_msg=name)
    assert (label_only["end_time"] <= duration * (1 + 1e-12)).all()
    assert (whole["label"][early & ~later] == Label.DRIFTING).all()
    assert (whole["end_time"] == duration).all()
    if (whole["label"] == Label.DRIFTING).mean() > 0.5:
        assert early.any()


def test_early_verdicts_do_not_depend_on_threads_or_neighbours():
    system = SYSTEMS["satellite"]
    points = random_points(system, 200, np.random.default_rng(4))
    duration = np.full(200, 15.0)
    whole = evaluate(
        system, points, points, duration, Settings(tolerance=1e-5), outputs=("label",), threads=1
    )
    order = np.random.default_rng(0).permutation(200)[:70]
    part = evaluate(
        system, *({k: v[order] for k, v in points.items()} for _ in range(2)), duration[order],
        Settings(tolerance=1e-5), outputs=("label",), threads=2,
    )  # fmt: skip
    for name in ("label", "end_time", "status"):
        np.testing.assert_array_equal(part[name], whole[name][order])


def test_a_scene_of_labels_only_is_a_label_only_run(small_scene):
    whole = atlas.run(load_scene(small_scene), progress=False)
    label_only = atlas.run(
        load_scene(small_scene + '[outputs]\nvariables = ["label", "end_time"]\n'), progress=False
    )
    np.testing.assert_array_equal(whole.label, label_only.label)
    assert float(label_only.end_time.min()) < 30.0 == float(whole.end_time.min())
