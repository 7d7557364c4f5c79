"""Motions of the fixed-point system about any axes: proofs, completeness, closed forms, stability, predictions."""

import numpy as np
import pytest
import sympy as sp
from family_starts import DRAWS, VECTORS, grioli_points, other_axes
from strategies import default_points, fixed_points_on_family, predictions, random_fixed_points, select
from truth import fixed_point_cases, jacobian_matrices, monodromy_matrix

from atlas.flags import Agreement, Label, Stability, Status
from atlas.label.points import label_points
from atlas.systems.base import on_family
from atlas.systems.fixed_point import FIXED_POINT, any_axis, equations, families, initial

pytestmark = pytest.mark.usefixtures("whole_kernels")

FAMILIES = any_axis.FAMILIES
MOMENTS = [
    (1.0, 1.4, 1.9),
    (1.9, 1.0, 1.4),
    (1.4, 1.9, 1.0),
    (1.9, 1.4, 1.0),
    (1.0, 1.9, 1.4),
    (1.4, 1.0, 1.9),
]


# Proofs.


@pytest.mark.long
def test_grioli_s_motion_satisfies_the_equations_in_axes_of_its_own():
    """I = [[a, 0, d], [0, a, 0], [d, 0, b]], r_c and rotor along the third axis, by computer algebra."""
    a, b, d, n, rotor, weight, angle = sp.symbols("a b d n lambda w angle", positive=True)
    inertia = sp.Matrix([[a, 0, d], [0, a, 0], [d, 0, b]])
    nu, s = sp.Matrix([sp.sin(angle), sp.cos(angle), 0]), sp.Matrix([0, 0, 1])
    w = n * (nu + s)
    inclined = sp.Matrix([sp.cos(angle) ** 2, -sp.sin(angle) * sp.cos(angle), sp.sin(angle)])
    gamma = (-(b * n**2 + rotor * n) * nu + n**2 * d * inclined) / weight

    def rate(vector):
        return n * vector.diff(angle)

    residual = inertia * rate(w) - (inertia * w + rotor * s).cross(w) - weight * s.cross(gamma)
    assert sp.simplify(residual) == sp.zeros(3, 1)
    assert sp.simplify(rate(gamma) - gamma.cross(w)) == sp.zeros(3, 1)
    assert sp.simplify(rate(nu) - nu.cross(w)) == sp.zeros(3, 1)
    length = sp.simplify(weight**2 * gamma.dot(gamma))
    assert sp.expand(length - (b * n**2 + rotor * n) ** 2 - d**2 * n**4) == 0
    # The formula of the module, in vectors.
    momentum = inertia * s
    vector = -(momentum[2] * n**2 + rotor * n) * nu
    vector += n**2 * (nu.dot(s.cross(momentum)) * nu.cross(s) + nu.dot(momentum) * s)
    assert sp.simplify(weight * gamma - vector) == sp.zeros(3, 1)


def test_balanced_motion_satisfies_the_equations_in_axes_of_its_own():
    a, b, d, n, m, l3, sine, cosine, angle = sp.symbols("a b d n m l3 sine cosine angle")
    inertia, s = sp.Matrix([[a, 0, d], [0, a, 0], [d, 0, b]]), sp.Matrix([0, 0, 1])
    gamma = sp.Matrix([sine * sp.sin(angle), sine * sp.cos(angle), cosine])
    rotor = sp.Matrix([-(m + 2 * n * cosine) * d, 0, l3])
    weight = -n * (rotor + m * b * s)
    w = n * gamma + m * s
    torque = (inertia * w + rotor).cross(w) + weight.cross(gamma) + n**2 * gamma.cross(inertia * gamma)
    residual = (inertia * m * w.diff(angle) - torque).subs(sine**2, 1 - cosine**2)
    assert sp.simplify(residual) == sp.zeros(3, 1)


def body_matrix(n, m, theta, kappa, N, phi, psi):
    """Equations of motion at some angles m t and n t, linear in the body: (3 angles, 12), columns I, l, Mg r_c.

    The third axis is the spin axis, the vertical is inclined by kappa to the axis at rest in space.
    """
    sine, cosine, zero = np.sin(theta), np.cos(theta), np.zeros_like(phi)
    nu = np.stack([sine * np.sin(phi), sine * np.cos(phi), cosine + zero], -1)
    node = np.stack([np.cos(phi), -np.sin(phi), zero], -1)
    across = node * np.cos(psi)[:, None] - np.cross(nu, node) * np.sin(psi)[:, None]
    gamma = np.cos(kappa) * nu + np.sin(kappa) * across
    e3 = np.array([0.0, 0.0, 1.0])
    w, w_dot = n * nu + m * e3, n * m * np.cross(nu, e3)
    columns = []
    for i, j in ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2)):
        inertia = np.zeros((3, 3))
        inertia[i, j] = inertia[j, i] = 1.0
        torque = np.cross(w @ inertia, w) + N * np.cross(gamma, gamma @ inertia)
        columns.append(w_dot @ inertia - torque)
    columns += [-np.cross(unit, w) for unit in np.eye(3)]
    columns += [-np.cross(unit, gamma) for unit in np.eye(3)]
    return np.array(columns).reshape(12, -1).T / np.sqrt(phi.size)


def nullity(*args):
    values = np.linalg.svd(body_matrix(*args), compute_uv=False)
    return int((values < 1e-9).sum()), values


# Every ratio n : m at which harmonics 2 n + a m, n + b m and c m with |a|, |b|, |c| <= 2 can coincide.
RATIOS = sorted({s * j / k for s in (-1, 1) for k in (1, 2, 3, 4) for j in range(1, 5) if j / k <= 4})


@pytest.mark.long
def test_no_other_regular_precession_exists():
    """The bodies that can make a motion are a linear space: its dimension shows which families exist.

    A spherical body and its rotor along s, -a m, and for N = 0 a symmetric one whose axis is s, are always in it.
    """
    rng = np.random.default_rng(5)
    phi, psi = rng.uniform(0, 2 * np.pi, (2, 40))
    time = rng.uniform(0, 24 * np.pi, 40)
    grid = [
        (theta, kappa, offset)
        for theta in (0.4, 1.0, 1.5, 2.2, 2.8)
        for kappa in (0.5, np.pi / 2, 2.4)
        for offset in (0.0, 1.0)
    ]
    for theta, kappa, offset in grid:
        for ratio in RATIOS:
            angles = time, ratio * time + offset
            assert nullity(ratio, 1.0, theta, kappa, 0.0, *angles)[0] == 2
            assert nullity(ratio, 1.0, theta, kappa, 0.7, *angles)[0] == 1
        assert nullity(0.618, 1.0, theta, kappa, 0.0, phi, psi)[0] == 2
        assert nullity(0.618, 1.0, theta, kappa, 0.7, phi, psi)[0] == 1
    # Grioli: n = +-m and orthogonal axes without a field, one dimension more.
    for sign in (1.0, -1.0):
        for kappa in (0.5, 1.4, 2.4):
            angles = time, sign * time + 0.3
            assert nullity(sign, 1.0, np.pi / 2, kappa, 0.0, *angles)[0] == 3
            assert nullity(sign, 1.0, np.pi / 2, kappa, 0.7, *angles)[0] == 1
            gaps = [nullity(sign, 1.0, np.pi / 2 + x, kappa, 0.0, *angles)[1][-3] for x in (0.01, 0.02)]
            assert gaps[1] > 1.5 * gaps[0] > 1e-4
    # About the vertical: Lagrange's case, and two dimensions more where n^2 = N.
    for n in (0.5, -1.3):
        assert nullity(n, 1.0, 0.8, 0.0, 0.0, phi, psi)[0] == 3
        assert nullity(n, 1.0, 0.8, 0.0, n**2 + 0.2, phi, psi)[0] == 3
        assert nullity(n, 1.0, 0.8, 0.0, n**2, phi, psi)[0] == 5


# Conditions and closed forms.


@pytest.mark.parametrize("moments", MOMENTS)
def test_every_formula_of_grioli_s_family_puts_a_point_on_it(moments):
    rng = np.random.default_rng(8)
    points = grioli_points(rng, 20, **dict(zip("ABC", moments, strict=True)))
    family = FAMILIES["grioli"]
    middle = "xyz"[int(np.argsort(moments)[1])]
    assert (points[f"{middle}0"] == 0).all()
    for name in family.solve:
        changed = points | {name: points[name] + (0.0 if name in VECTORS else 0.1 * np.sign(points[name]))}
        solved = changed | {name: family.solve[name](changed)}
        on = on_family(family, solved) < 1e-11
        # Components of the start are those of the largest root.
        assert on.mean() > 0.9, name
    turned = points | {"p0": -points["p0"], "q0": -points["q0"], "r0": -points["r0"]}
    rotor = {name: -points[name] for name in ("l1", "l2", "l3")}
    assert (on_family(family, turned | rotor) < 1e-12).all()  # reversed in time
    assert (on_family(family, points | {"N": np.full(20, 1e-3)}) > 1e-5).all()


def test_random_starts_are_on_no_family():
    points = random_fixed_points(np.random.default_rng(9), 500)
    flags, residual = FIXED_POINT.identify_family(points)
    assert (flags == 0).all()
    assert (residual > 1e-9).all()


def test_starts_of_the_families_about_the_third_axis_keep_their_flags():
    points = fixed_point_cases()
    third_axis, _ = families.identify_family(points)
    all_families, _ = FIXED_POINT.identify_family(points)
    np.testing.assert_array_equal(all_families[third_axis > 0], third_axis[third_axis > 0])
    points = random_fixed_points(np.random.default_rng(10), 9, theta_dot0=0.0, m=0.0)
    staude = fixed_points_on_family("staude", points, "l1", "l2")
    assert (FIXED_POINT.identify_family(staude)[0] == families.FAMILIES["staude"].flag).all()


# Stability.


def reference_growth(name, point):
    """Growth rate from the monodromy matrix by DOP853, and its two multipliers that are not 1."""
    axes = FAMILIES[name].axes(point)
    period = 2 * np.pi / abs(axes.spin_rate[0])
    start, values = initial.initial_state(point)[:, 0], initial.constants(point)[:, 0]
    monodromy = monodromy_matrix(lambda y, c: np.array(equations.rhs(y, c)), start, values, period)
    total = np.trace(monodromy) - 4
    return np.arccosh(max(abs(total) / 2, 1.0)) / period, np.linalg.eigvals(monodromy)


@pytest.mark.long
@pytest.mark.parametrize("name", ["grioli", "balanced_field"])
def test_floquet_multipliers_against_the_monodromy_matrix(name):
    points = DRAWS[name](np.random.default_rng(11), 120)
    stable, growth = FAMILIES[name].stability(points)
    assert (stable == Stability.STABLE).sum() > 10
    unstable = np.flatnonzero(stable == Stability.UNSTABLE)
    assert unstable.size > 2
    for i in (*unstable[:3], *np.flatnonzero(stable == Stability.STABLE)[:2]):
        expected, multipliers = reference_growth(name, select(points, i))
        assert growth[i] == pytest.approx(expected, rel=1e-5, abs=1e-6)
        if stable[i] == Stability.STABLE:
            assert np.abs(multipliers).max() < 1 + 1e-4
        else:
            period = 2 * np.pi / abs(FAMILIES[name].axes(select(points, i)).spin_rate[0])
            assert np.log(np.abs(multipliers).max()) / period == pytest.approx(growth[i], rel=1e-4)


@pytest.mark.long
def test_all_multipliers_of_free_precessions_are_on_the_unit_circle():
    """w moves on a circle at the rate |w''| / |w'|; gamma turns under it, so that the matrix of both is block triangular.

    The defective multiplier 1 has the third root of the error of the matrix.
    """
    points = DRAWS["free_precession"](np.random.default_rng(8), 4)
    family, _ = FIXED_POINT.identify_family(points)
    stable, growth = FIXED_POINT.linear_stability(points, family)
    assert (stable == Stability.STABLE).all()
    assert (growth == 0).all()
    states, constants = initial.initial_state(points), initial.constants(points)
    for state, values in zip(states.T, constants.T, strict=True):
        change = np.array(equations.rhs(state, values))
        (jacobian,) = jacobian_matrices(equations.rhs, state[:, None], values[:, None])
        period = 2 * np.pi * np.linalg.norm(change[:3]) / np.linalg.norm((jacobian @ change)[:3])
        matrix = monodromy_matrix(lambda y, c: np.array(equations.rhs(y, c)), state, values, period)
        np.testing.assert_allclose(np.abs(np.linalg.eigvals(matrix)), 1.0, atol=1e-3)


def test_stability_of_free_and_of_relabelled_motions():
    """A free body is unstable about its middle axis; Lagrange's case does not depend on the name of its axis."""
    spins = np.eye(3)
    gamma = np.array([0.6, 0.0, 0.8])
    start = dict(zip(VECTORS, (*spins, *np.broadcast_to(gamma[:, None], (3, 3))), strict=True))
    body = default_points("fixed_point", 3, A=1.0, B=1.5, C=2.2, **start)
    stable, growth = FIXED_POINT.stability(body)
    np.testing.assert_array_equal(stable, [Stability.STABLE, Stability.UNSTABLE, Stability.STABLE])
    assert growth[1] == pytest.approx(np.sqrt((1.5 - 1.0) * (2.2 - 1.5) / (1.0 * 2.2)))
    points = other_axes(np.random.default_rng(12), 40)
    stable, growth = FIXED_POINT.stability(points)
    for i in np.flatnonzero(stable == Stability.UNSTABLE)[:3]:
        expected, _ = reference_growth("other_axis", select(points, i))
        assert growth[i] == pytest.approx(expected, rel=1e-5)


# Predictions.


def test_predictions_about_any_axes():
    points = grioli_points(np.random.default_rng(13), 40)
    prediction, exact = predictions(FIXED_POINT, points)
    result = prediction.variables
    assert (result["predicted"] == Label.DRIFTING).all()
    assert (exact["predicted_any_axis"] == Label.REGULAR_PRECESSION).all()
    nudged = points | {"p0": points["p0"] + 1e-4}
    _, moved = predictions(FIXED_POINT, points, nudged, tolerances=(1e-3, 1e-3))
    stable = result["stable"] == Stability.STABLE
    assert 0 < stable.sum() < stable.size
    expected = np.where(stable, Label.REGULAR_PRECESSION, Label.DRIFTING)
    np.testing.assert_array_equal(moved["predicted_any_axis"], expected)


def test_predictions_agree_about_any_axes_where_the_motion_is_about_the_third():
    points = fixed_point_cases()
    prediction, about_any = predictions(FIXED_POINT, points)
    result = prediction.variables
    steady = result["predicted"] != Label.DRIFTING
    np.testing.assert_array_equal(about_any["predicted_any_axis"][steady], result["predicted"][steady])


@pytest.mark.usual("balanced_field", "free_precession")
@pytest.mark.parametrize("name", FAMILIES)
def test_measured_labels_about_any_axes_agree(name):
    points = DRAWS[name](np.random.default_rng(14), 16)
    flags = np.full(points["A"].size, FAMILIES[name].flag)
    stable = FIXED_POINT.linear_stability(points, flags)[0] == Stability.STABLE
    given = {key: value for key, value in select(points, stable).items() if not np.isnan(value).all()}
    names = ["label", "label_any_axis", "predicted_any_axis", "agreement", "agreement_any_axis", "status"]
    ds = label_points("fixed_point", given, duration=40.0, variables=names, method="rk8")
    assert (ds["status"] == 1).all()
    assert (ds["agreement"] == Agreement.AGREE).all()
    assert (ds["agreement_any_axis"] == Agreement.AGREE).all()


def test_rounding_errors_decide_long_runs_of_unstable_motions():
    """An unstable motion that is started exactly: about any axes its label means nothing after a long time."""
    points = grioli_points(np.random.default_rng(13), 40)
    stable, growth = FAMILIES["grioli"].stability(points)
    unstable = (stable == Stability.UNSTABLE) & (growth > 0.03)
    assert unstable.sum() >= 1
    given = {key: value for key, value in select(points, unstable).items() if not np.isnan(value).all()}
    for log_growth, status in ((8.0, Status.OK), (60.0, Status.ROUNDOFF_DECIDED)):
        duration = log_growth / growth[unstable]
        wanted = {"method": "rk8", "tolerance": 1e-10, "duration": duration}
        any_axis_too = label_points(
            "fixed_point", given, variables=["label", "label_any_axis", "status"], **wanted
        )
        assert (any_axis_too["status"] == status).all()
        expected = Label.REGULAR_PRECESSION if status == Status.OK else Label.UNRESOLVED
        assert (any_axis_too["label_any_axis"] == expected).all()
        # About the third axis and the vertical they drift in any case.
        alone = label_points("fixed_point", given, variables=["label", "status"], **wanted)
        assert (alone["label"] == Label.DRIFTING).all()
