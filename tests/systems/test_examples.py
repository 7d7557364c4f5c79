"""The systems in docs/examples, each an installed package as far as Python can tell, and no part of this one."""

import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from plugins import EXAMPLES, install_example, registry
from scipy.integrate import solve_ivp

import atlas
from atlas import cli, systems
from atlas.flags import Agreement, EnergyStability, Label, Regularity, Stability, Status, Steadiness
from atlas.systems.jacobian import jacobian
from atlas.variables import data_variables, default_variables

pytestmark = pytest.mark.usefixtures("whole_kernels", "short_timings")

ROOT = Path(__file__).parents[2]
NAMES = sorted(path.parent.name for path in EXAMPLES.glob("*/*.toml") if path.stem == path.parent.name)


@pytest.fixture(scope="module", autouse=True)
def path(tmp_path_factory):
    """The examples are installed; the value is the search path of other processes."""
    site = tmp_path_factory.mktemp("site")
    folders = [site, *(install_example(name, site) for name in NAMES)]
    with registry(), pytest.MonkeyPatch.context() as patch:
        for folder in folders:
            patch.syspath_prepend(folder)
        yield ":".join(map(str, [ROOT, *folders]))
        for name in NAMES:
            sys.modules.pop(name, None)


def scene_of(name, **counts):
    """The scene of an example with fewer points."""
    text = (EXAMPLES / name / f"{name}.toml").read_text()
    for axis, count in counts.items():
        text, changed = re.subn(rf"(\[axes\.{axis}\][^\[]*count = )\d+", rf"\g<1>{count}", text)
        assert changed == 1
    return text


def test_the_folder_of_examples_is_not_empty():
    assert NAMES == ["double_pendulum", "elliptic_orbit", "heavy_top_euler", "henon_heiles", "two_field_top"]


@pytest.mark.long
def test_a_system_of_pure_numbers_has_no_seconds():
    for name, units in (("henon_heiles", {"1"}), ("double_pendulum", {"s", "s-1"})):
        found = data_variables(systems.get(name))
        assert {found[each].units for each in ("lyapunov", "step", "end_time")} == units
    motion = atlas.trajectory("henon_heiles", {}, duration=1.0, samples=5)
    assert {motion[each].attrs["units"] for each in ("time", "step")} == {"1"}


@pytest.mark.long
def test_the_command_finds_the_systems_of_installed_packages(path, tmp_path, monkeypatch):
    """Of their scenes, which are read whole in this process, few points are checked in one without its modules."""
    monkeypatch.setenv("PYTHONPATH", path)
    scenes = [EXAMPLES / name / f"{name}.toml" for name in NAMES]
    assert [atlas.load_scene(scene).system.name for scene in scenes] == NAMES
    for scene in scenes:
        (tmp_path / scene.name).write_text(re.sub(r"(count = )\d+", r"\g<1>4", scene.read_text()))
    code = "import sys; from atlas import cli; sys.exit(any(cli.main(['check', s]) for s in sys.argv[1:]))"
    run = subprocess.run(
        [sys.executable, "-c", code, *(scene.name for scene in scenes)], cwd=tmp_path,
        capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert run.returncode == 0, run.stderr
    assert re.findall(r"system (\w+): ", run.stdout) == NAMES


@pytest.mark.parametrize("name", NAMES)
def test_an_example_is_short(name):
    module = next(
        path
        for path in (EXAMPLES / name / f"{name}.py", EXAMPLES / name / name / "__init__.py")
        if path.exists()
    )
    assert len(module.read_text().splitlines()) <= 60


def test_the_package_names_no_example():
    for path in (ROOT / "atlas").rglob("*.py"):
        text = path.read_text().lower()
        assert not [name for name in NAMES if name in text or name.replace("_", " ") in text], path


@pytest.mark.long
def test_commands_with_the_scene_of_henon_and_heiles(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    text = scene_of("henon_heiles", y0=6, v0=5).replace("1000.0", "100.0")
    Path("scene.toml").write_text(text)
    Path("refined.toml").write_text(text.replace("[outputs]", "[refine]\nlevels = 1\n\n[outputs]"))
    for line in (
        "run scene.toml -o out.nc --quiet", "map out.nc -o map.png", "map out.nc --variable lyapunov -o l.png",
        "run refined.toml -o refined.nc --quiet", "run scene.toml -o folder/ --quiet", "join folder -o joined.nc",
        "trajectory scene.toml --at y0=0.1 v0=0.1 -o motion.png", "conditions henon_heiles",
    ):  # fmt: skip
        assert cli.main(line.split()) == cli.DONE, (line, capsys.readouterr())
    ds, joined = atlas.open_atlas("out.nc").load(), atlas.open_atlas("joined.nc").load()
    assert joined.drop_attrs().equals(ds.drop_attrs())
    impossible = ds["label"].values == 0
    assert 5 < impossible.sum() < 25
    assert np.isnan(ds["radius_squared_mean"].values[impossible]).all()


def chaotic_starts(energy, count=24):
    rng, starts = np.random.default_rng(3), []
    while len(starts) < count:
        y, v = rng.uniform(-0.5, 0.9), rng.uniform(-0.55, 0.55)
        if 2 * energy - v * v - y * y + 2 * y**3 / 3 > 0.01:
            starts.append((y, v))
    return {"energy": energy, "y0": np.array(starts)[:, 0], "v0": np.array(starts)[:, 1]}


def indicators(points, duration):
    names = ["label", "status", "lyapunov", "regularity"]
    return atlas.label_points(
        "henon_heiles", points, duration=duration, method="rk8", variables=names, progress=False
    )


@pytest.mark.long
def test_lyapunov_exponents_are_those_of_dop853():
    def slope(_, state):
        x, y, u, v, a, b, c, d = state
        change = -a - 2 * (y * a + x * b), -b - 2 * x * a + 2 * y * b
        return [u, v, -x - 2 * x * y, -y - x * x + y * y, c, d, *change]

    duration, points = 50.0, chaotic_starts(1 / 6, 6)
    measured = indicators(points, duration)["lyapunov"].values
    start = systems.get("henon_heiles").initial_state(
        {"x0": np.zeros(6), "y0": points["y0"], "v0": points["v0"], "energy": np.full(6, 1 / 6)}
    )
    for i in range(6):
        tangent = np.array([5.0, -4.0, 6.0, 3.0])
        first = np.concatenate([start[:, i], tangent])
        final = solve_ivp(slope, (0, duration), first, "DOP853", rtol=1e-12, atol=1e-14).y[4:, -1]
        growth = np.log(np.linalg.norm(final) / np.linalg.norm(tangent)) / duration
        assert measured[i] == pytest.approx(growth, abs=1e-5)


@pytest.mark.long
@pytest.mark.parametrize(
    ("energy", "exponent", "tolerance"),
    # Of another program (rk4 with a step of 0.05): means over 20 and 31 chaotic motions of 10^5 time units, 0.0454 +- 0.0011
    # and 0.1255 +- 0.0012. The spectrum (0.052, 0, 0, -0.051) that is given in places belongs to the energy 1/8, not 1/6.
    [(1 / 8, 0.0454, 0.1), (1 / 6, 0.1255, 0.05)],
)
def test_lyapunov_exponent_of_the_chaotic_sea(energy, exponent, tolerance):
    ds = indicators(chaotic_starts(energy, 64), 1e4)
    chaotic = ds["regularity"].values == Regularity.CHAOTIC
    assert chaotic.sum() > 20
    assert ds["lyapunov"].values[chaotic].mean() == pytest.approx(exponent, rel=tolerance)


@pytest.mark.long
def test_motions_of_little_energy_are_regular():
    ds = indicators(chaotic_starts(1 / 24), 2e3)
    assert (ds["status"] == Status.OK).all()
    assert (ds["regularity"] == Regularity.REGULAR).all()


@pytest.mark.long
@pytest.mark.extension("studies")
def test_accuracy_of_an_example():
    from atlas.extensions.studies.work_precision import work_precision

    text = scene_of("henon_heiles", y0=3, v0=3).replace("1000.0", "20.0").replace("0.125", "0.16")
    ds = work_precision(atlas.load_scene(text.replace("from = -0.5", "from = -0.1")), 4)
    own = ds.isel(level=ds.attrs["own_level"])
    assert (own["error_state"] < 1e-5).all()
    assert (own["error_rates"] < 1e-5).all()
    assert own["label_compared"].sum() > 0
    assert not ds["label_wrong"].any()


@pytest.mark.long
@pytest.mark.extension("studies")
def test_generic_stress_cases_give_no_wrong_label():
    from atlas.extensions.studies import stress

    ds = stress.stress("henon_heiles")
    assert not stress.mislabelled(ds).any()
    assert not stress.unresolved(ds).any()
    assert {"energy", "x0", "y0", "v0", "defaults"} <= set(ds["case"].values)
    assert set(ds["known_from"].values) == {"reference", "overflow"}
    assert "determined by" in stress.report(ds)


@pytest.mark.long
def test_double_pendulum_swings_in_its_normal_modes():
    sign, amplitude, g = np.array([1.0, -1.0]), 1e-3, 9.81
    points = {"start1": amplitude, "start2": sign * np.sqrt(2) * amplitude, "g": g}
    frequency = np.sqrt(g * (2 - sign * np.sqrt(2)))
    duration = 10 * 2 * np.pi / frequency[0]
    ds = atlas.label_points("double_pendulum", points, duration=duration, tolerance=1e-8, progress=False)
    assert (ds["status"] == Status.OK).all()
    np.testing.assert_allclose(ds["angle1_max"], amplitude, rtol=1e-5)
    np.testing.assert_allclose(ds["angle2_max"], np.sqrt(2) * amplitude, rtol=1e-5)
    np.testing.assert_allclose(ds["angle1_std"][0], amplitude / np.sqrt(2), rtol=1e-5)
    assert ds["integral_drift"].max() < 1e-8


@pytest.mark.long
def test_labels_of_the_heavy_top_are_those_of_the_package():
    rng, size = np.random.default_rng(0), 64
    points = {
        "A": rng.uniform(0.6, 1.5, size), "C": rng.uniform(0.3, 1, size), "Mg": 1.0, "z0": rng.uniform(-1, 1, size),
        "theta0": rng.uniform(0.3, 2.8, size), "n": rng.uniform(0.1, 1, size), "m": rng.uniform(-3, 3, size),
    }  # fmt: skip
    cosine = np.cos(points["theta0"])  # half of the starts are regular precessions
    momentum = points["A"] * points["n"] * cosine - points["Mg"] * points["z0"] / points["n"]
    steady = momentum / points["C"] - points["n"] * cosine
    points["m"] = np.where(np.arange(size) % 2 == 0, steady, points["m"])
    compared = ("theta_dot_rms", "psi_dot_mean", "psi_dot_std", "phi_dot_mean", "phi_dot_std")
    # Motions about any axis as well: both kernels are those of `tests/label/test_any_axis.py`.
    names = ["label", "status", "label_any_axis", *compared]
    options = {"duration": 20.0, "tolerance": 1e-8, "variables": names, "progress": False}
    euler = atlas.label_points("heavy_top_euler", points, **options)
    own = atlas.label_points("fixed_point", {**points, "B": points["A"]}, **options)
    assert set(own["label"].values) == {1, 3}
    # Near the vertical Euler angles change fast: such a motion may stay unresolved, but has no other label.
    resolved = euler["status"].values == Status.OK
    assert resolved.sum() >= size - 3
    euler, own = euler.isel(point=resolved), own.isel(point=resolved)
    for name in ("label", "label_any_axis"):
        np.testing.assert_array_equal(euler[name], own[name])
    for name in compared:
        np.testing.assert_allclose(euler[name], own[name], atol=1e-6)


def two_field_tops(count):
    """Random tops without any symmetry, by parameters of the example."""
    rng, top = np.random.default_rng(1), systems.get("two_field_top")
    points = {name: rng.normal(size=count) for name in top.parameters}
    points |= {name: rng.uniform(0.8, 1.5, count) for name in "ABC"}
    return top, points


@pytest.mark.extension("equilibria")
def test_two_field_top_has_the_theory_of_the_gyrostat():
    """Frequencies, growth, energy and bound against the Jacobian of its equations at the equilibria of random bodies."""
    top, points = two_field_tops(6)
    seen = set()
    for i in range(6):
        body = {name: values[i] for name, values in points.items()}
        rest = atlas.equilibria("two_field_top", body)
        columns = {name: np.full(rest.sizes["equilibrium"], value) for name, value in body.items()}
        columns |= {name: rest[name].values for name in ("theta0", "psi0", "phi0")}
        columns |= {name: np.zeros(rest.sizes["equilibrium"]) for name in ("n", "m", "theta_dot0")}
        assert (top.identify_family(columns)[0] == 1).all()
        jacobians = jacobian(top.equations, top.initial_state(columns), top.constants(columns))
        exponents = np.linalg.eigvals(jacobians)
        np.testing.assert_allclose(rest["growth_rate"], exponents.real.max(1), atol=1e-6)
        assert (np.abs(exponents).max(1) <= top.frequency_bound(columns)).all()
        largest = np.where(np.abs(exponents.real) < 1e-6, exponents.imag, 0).max(1)
        np.testing.assert_allclose(
            np.nan_to_num(rest["frequency_1"]), np.where(largest > 1e-6, largest, 0), rtol=1e-9
        )
        energy = top.energy_stability(columns, np.ones(len(exponents), np.int8))
        np.testing.assert_array_equal(energy == EnergyStability.YES, rest["index"] == 0)
        seen |= set(rest["stable"].values)
    assert seen == {Stability.STABLE, Stability.UNSTABLE}


@pytest.mark.long
@pytest.mark.extension("equilibria")
def test_two_field_top_has_predictions_without_families():
    """Rest of any body, rotation on the line of both fields' resultant, and random starts, which drift."""
    top, points = two_field_tops(12)

    class TwoFieldsAlone(type(top)):
        name, families = "two_fields_alone", {}

    alone = systems.register(TwoFieldsAlone())
    names = [*default_variables(alone), "label_any_axis"]  # the kernel of other tests
    still = atlas.equilibria("two_field_top", {name: values[0] for name, values in points.items()})
    rest = {name: np.full(still.sizes["equilibrium"], values[0]) for name, values in points.items()}
    rest |= {name: still[name].values for name in ("theta0", "psi0", "phi0")}
    rest |= {name: np.zeros_like(rest["A"]) for name in ("n", "m", "theta_dot0")}
    given = {"psi0": np.pi / 2, "C": 0.6, "x3": 1.0, "l3": 0.2, "mu3": -0.5, "m": 5.0}
    axial = {name: np.full(12, given.get(name, p.default)) for name, p in top.parameters.items()}
    axial["theta0"] = np.linspace(0.3, 2.5, 12)
    axial["Mg"] = top.families["axial"].solve["Mg"](axial)
    for starts, predicted in (
        (rest, Label.PERMANENT_ROTATION),
        (axial, Label.PERMANENT_ROTATION),
        (points, Label.DRIFTING),
    ):
        ds = atlas.label_points("two_fields_alone", starts, duration=3.0, tolerance=1e-10, variables=names)
        assert "family" not in ds
        assert (ds.predicted == predicted).all()
        assert (ds.agreement.where(ds.status == Status.OK, Agreement.AGREE) == Agreement.AGREE).all()


@pytest.mark.long
def test_two_field_top_is_stable_where_it_spins_fast():
    """As a top against the resultant F of the fields: stable for (C m + l3)^2 > 4 A F; nudged, the labels agree."""
    m = np.linspace(0.2, 6.0, 12)
    points = {"theta0": 0.9, "psi0": np.pi / 2, "C": 0.6, "x3": 1.0, "l3": 0.2, "mu3": -0.5, "m": m}
    top = systems.get("two_field_top")
    columns = {
        k: np.broadcast_to(points.get(k, p.default), 12).astype(float) for k, p in top.parameters.items()
    }
    columns["Mg"] = top.families["axial"].solve["Mg"](columns)
    flags, _ = top.identify_family(columns)
    stable, growth = top.linear_stability(columns, flags)
    discriminant = (0.6 * m + 0.2) ** 2 - 4 * 0.5 / np.sin(0.9)
    assert (flags == 2).all()
    np.testing.assert_array_equal(stable == Stability.STABLE, discriminant > 0)
    np.testing.assert_allclose(growth, np.sqrt(np.maximum(-discriminant, 0)) / 2, atol=1e-12)
    # The last one for the kernel that measures motions about the resultant as well.
    names = ["label", "predicted", "agreement", "status", "label_any_axis"]
    nudged = columns | {"theta0": columns["theta0"] + 1e-4}
    ds = atlas.label_points(
        "two_field_top", nudged, duration=30.0, rate_tolerance=1e-2, variables=names, progress=False
    )
    # slower growth does not show in the run
    ok = (ds["status"].values == Status.OK) & ((stable == Stability.STABLE) | (growth * 30.0 > 12))
    assert ok.sum() > 8
    np.testing.assert_array_equal(ds["label"].values[ok] == Label.DRIFTING, (discriminant < 0)[ok])


@pytest.mark.extension("catalogue")
def test_catalogue_of_the_two_field_top():
    from atlas.extensions.catalogue import tables as catalogue

    rows = catalogue.families(systems.get("two_field_top"))
    assert [row["family"] for row in rows] == ["rest", "axial", "precession"]
    assert rows[0]["conditions"] == ["n = theta_dot0 = 0", "m = 0", "Mg r x g + mu x a = 0"]
    assert rows[1]["solves_for"] == ["Mg", "x3", "mu3"]


# Odd solutions of the period of the orbit: e, (B - A)/C, psi'(0) by heyoka's Taylor series and by DOP853, which agree to 1e-13,
# and the branch of the example; nan: on neither.
BELETSKY = np.array([
    (0.1, 0.1, -0.260115886395, 0), (0.1, 0.5, -1.052388658749, 0), (0.1, 0.7, -1.330501004653, 0),
    (0.1, 0.7, 0.162515563928, 1), (0.1, 0.7, 1.037640245380, np.nan), (0.1, 1.0, 0.074068885575, 1),
    (0.1, 1.0, 1.444111677631, np.nan), (0.3, 1.0, 0.153419856999, 1), (0.3, 1.0, 1.000703396655, np.nan),
]).T  # fmt: skip


def pitch(nu, state, e, K):
    """Beletsky's equation with a change of the state, written anew: d/dnu of w^2 (1 + psi') is the torque over w^-1."""
    psi, rate, a, b = state
    w, slope = 1 + e * np.cos(nu), -e * np.sin(nu)
    force = -3 * K * np.sin(psi) * np.cos(psi) * w
    return (
        rate,
        (force - 2 * w * slope * (1 + rate)) / w**2,
        b,
        (-3 * K * np.cos(2 * psi) * w * a - 2 * w * slope * b) / w**2,
    )


@pytest.mark.long
def test_periodic_pitch_on_an_elliptic_orbit():
    """The references are periodic by Radau, an implicit method, too; those of the branches come out of the example, with their traces."""
    from elliptic_orbit import periodic

    e, K, rate, branch = BELETSKY
    orbit = systems.get("elliptic_orbit")
    points = {
        "e": e,
        "K": K,
        "branch": np.nan_to_num(branch),
        "psi0": 0 * e,
        "rate0": np.where(np.isnan(branch), rate, np.nan),
    }
    np.testing.assert_allclose(orbit.initial_state(points)[1], rate, atol=2e-12)
    psi, _ = periodic.half_turn(e, K, rate, 1e-13)
    np.testing.assert_allclose(psi, 0, atol=3e-11)
    trace = periodic.odd_solution(points)[1]
    for i in (1, 3):
        columns = []
        for change in ((1.0, 0.0), (0.0, 1.0)):
            solution = solve_ivp(
                pitch,
                (0, 2 * np.pi),
                (0.0, rate[i], *change),
                "Radau",
                rtol=1e-9,
                atol=1e-10,
                args=(e[i], K[i]),
            )
            columns.append(solution.y[:, -1])
        assert columns[0][:2] == pytest.approx((0, rate[i]), abs=1e-6)
        assert columns[0][2] + columns[1][3] == pytest.approx(trace[i], abs=1e-6)


@pytest.mark.long
def test_pitch_is_steady_once_an_orbit_where_floquet_says_so():
    e, K = (grid.ravel() for grid in np.meshgrid(np.linspace(0.04, 0.4, 5), np.linspace(0.05, 0.95, 8)))
    points = {"e": np.r_[e, e], "K": np.r_[K, K], "branch": np.repeat([0.0, 1.0], e.size), "psi0": 1e-4}
    names = ["label", "status", "floquet", "floquet_trace", "psi_std", "psi_at_pericentre_std"]
    tolerances = {"rate_tolerance": 1e-3, "std_tolerance": {"psi_at_pericentre": 0.01}}
    ds = atlas.label_points(
        "elliptic_orbit", points, duration=314.2, method="rk8", tolerance=1e-4, variables=names, **tolerances
    )
    stable, label = ds["floquet"].values, ds["label"].values
    assert (label[stable == Stability.STABLE] == Steadiness.STEADY).all()
    grown = 50 * np.arccosh(np.maximum(np.abs(ds["floquet_trace"].values) / 2, 1)) > 12
    unstable = (stable == Stability.UNSTABLE) & grown
    assert np.isin(label[unstable], [Steadiness.DRIFTING, Label.UNRESOLVED]).all()
    assert (label[unstable] == Steadiness.DRIFTING).sum() > 12
    assert (ds["status"].values[stable == Stability.UNKNOWN] == Status.NOT_FINITE).all()
    assert set(stable) == {Stability.UNKNOWN, Stability.STABLE, Stability.UNSTABLE}
    assert ds["psi_std"].values[label == Steadiness.STEADY].max() > 0.5  # large, and steady once an orbit


def test_satellite_on_an_elliptic_orbit_obeys_euler_and_poisson():
    """Its Lagrange equations over the true anomaly against equations in time, by components along the axes of the body."""
    from elliptic_orbit import satellite_equations as equations

    inertia, e, end = np.array([0.9, 1.2, 1.5]), 0.3, 9.0

    def axes(state):
        (sp, sr, sy), (cp, cr, cy) = np.sin(state[:3]), np.cos(state[:3])
        normal = np.array([-sy * cr, sr, cy * cr])
        radius = np.array([cp * cy - sp * sr * sy, -sp * cr, cp * sy + sp * sr * cy])
        relative = state[4] * normal + state[5] * np.array([cy, 0, sy]) + state[6] * np.array([0, 1, 0])
        return radius, normal, relative

    def slope(t, y):
        nu, w, radius, normal = y[0], y[1:4], y[4:7], y[7:10]
        rate = (1 + e * np.cos(nu)) ** 2
        torque = 3 * rate**1.5 * np.cross(radius, inertia * radius) - np.cross(w, inertia * w)
        relative = w - rate * normal
        return np.r_[rate, torque / inertia, np.cross(radius, relative), np.cross(normal, relative)]

    start = np.array([0.4, 0.3, -0.5, 0.0, 0.2, -0.1, 0.15, 1.0])
    options = {"method": "DOP853", "rtol": 1e-11, "atol": 1e-12}
    final = solve_ivp(lambda nu, y: equations.rhs(y, (*inertia, e)), (0, end), start, **options).y[:, -1]
    radius, normal, relative = axes(start)

    def arrived(t, y):
        return y[0] - end

    arrived.terminal = True
    first = np.r_[0.0, (1 + e) ** 2 * (relative + normal), radius, normal]
    y = solve_ivp(slope, (0, 100), first, events=arrived, **options).y[:, -1]
    radius, normal, relative = axes(final)
    np.testing.assert_allclose(y[1:4] / (1 + e * np.cos(end)) ** 2, relative + normal, atol=1e-9)
    np.testing.assert_allclose(np.r_[y[4:7], y[7:10]], np.r_[radius, normal], atol=1e-9)
    scene = EXAMPLES / "elliptic_orbit" / "elliptic_satellite.toml"
    assert atlas.load_scene(scene).system.name == "elliptic_satellite"


def test_satellite_in_the_plane_of_its_orbit_is_the_pitch():
    from elliptic_orbit import Equations, satellite_equations

    e, (A, B, C) = 0.3, (0.7, 1.0, 1.2)
    for psi, rate, nu in np.random.default_rng(2).uniform(-1, 2, (5, 3)):
        planar = Equations.rhs((psi, rate, np.cos(nu), np.sin(nu)), (e, (B - A) / C))
        whole = satellite_equations.rhs((psi, 0, 0, nu, rate, 0, 0, 1), (A, B, C, e))
        np.testing.assert_allclose(whole, (rate, 0, 0, 1, planar[1], 0, 0, 0), atol=1e-13)


@pytest.mark.long
def test_a_damped_satellite_is_captured_by_resonances():
    """Rotations are those of DOP853, and in turns per orbit multiples of 1/4."""
    from elliptic_orbit.rotation import Equations

    psi, rate = (each.ravel() for each in np.meshgrid([0.4, 1.6], [0.1, 0.5, 1.1]))
    begin, length, values = 2 * np.pi * 600, 2 * np.pi * 40, (0.2, 0.02, 0.002)
    points = dict(zip(("e", "K", "damping"), values, strict=True)) | {"psi0": psi, "rate0": rate}
    ds = atlas.label_points(
        "damped_rotation", points, transient=begin, duration=length, method="rk8", tolerance=1e-4
    )

    def slope(nu, y):
        state = *y.reshape(2, -1), np.cos(nu), np.sin(nu)
        return np.concatenate(Equations.rhs(state, values)[:2])

    run = solve_ivp(
        slope, (0, begin + length), np.r_[psi, rate], "DOP853", [begin, begin + length], rtol=1e-9, atol=1e-10
    )
    turns = 1 + np.diff(run.y[:6])[:, 0] / length
    ok = ds["status"].values == Status.OK
    assert ok.sum() >= 4
    assert np.abs(ds["rotation_mean"].values - turns)[ok].max() < 1e-3
    assert np.abs(4 * turns - np.round(4 * turns))[ok].max() < 0.04
    assert ds.atlas.ends("rotation_mean", 0.01)["which"].size >= 2


@pytest.mark.long
def test_two_field_top_precesses_about_the_resultant():
    """The conditions give motions that DOP853 confirms, measured as regular about two axes, and small nutations as derived:
    A theta'' = f(theta) of the axis to the resultant has -f'/A = N^2 sin^2 + (b/A - 2 N cos)^2, b = C w3 + l3.
    """
    rng, top, size = np.random.default_rng(8), systems.get("two_field_top"), 8
    columns = {name: np.full(size, p.default) for name, p in top.parameters.items()}
    for name in ("C", "x3", "Mg", "mu3", "theta0", "psi0", "n", "m"):
        columns[name] = rng.uniform(0.5, 1.4, size)
    # w = N f + m e3: the part of N f along the node is the rate of theta0.
    weight, magnet = columns["Mg"] * columns["x3"], columns["mu3"]
    cotangent = 1 / np.tan(columns["theta0"])
    along = columns["n"] / (weight - magnet * np.sin(columns["psi0"]) * cotangent)  # N / |F|
    columns["theta_dot0"] = along * magnet * np.cos(columns["psi0"])
    columns["l3"] = top.families["precession"].solve["l3"](columns)
    assert (top.identify_family(columns)[0] == 3).all()
    axes = top.families["precession"].axes(columns)
    np.testing.assert_allclose(axes.precession_rate, along * np.hypot(weight, magnet))
    state, constants = top.initial_state(columns), top.constants(columns)
    times = np.linspace(0, 5, 4)
    exact = top.families["precession"].motion(columns, times)
    for i in range(size):
        path = solve_ivp(
            lambda t, y, c=constants[:, i]: top.equations.rhs(y, c),
            (0, 5),
            state[:, i],
            "DOP853",
            times,
            rtol=1e-10,
            atol=1e-11,
        )
        np.testing.assert_allclose(exact[..., i], path.y, atol=1e-7)
    # A small push of the axis to or from the resultant: it oscillates by sin(w t) / w times the push.
    b, cosine, N = columns["C"] * state[2] + columns["l3"], axes.fixed_axis[2], axes.precession_rate
    nutation = np.sqrt(N**2 * (1 - cosine**2) + (b - 2 * N * cosine) ** 2)
    weights = weight[:, None], magnet[:, None], np.hypot(weight, magnet)[:, None]
    for i in range(3):
        node, push = np.array([axes.fixed_axis[1, i], -axes.fixed_axis[0, i], 0]), 1e-5
        start = state[:, i] + push * np.r_[node / np.linalg.norm(node), np.zeros(6)]
        y = solve_ivp(
            lambda t, y, c=constants[:, i]: top.equations.rhs(y, c),
            (0, 5),
            start,
            "DOP853",
            times,
            rtol=1e-11,
            atol=1e-13,
        ).y
        tilt = np.arccos((weights[0][i] * y[8] + weights[1][i] * y[5]) / weights[2][i])
        expected = push * np.sin(nutation[i] * times) / nutation[i]
        np.testing.assert_allclose(np.abs(tilt - tilt[0]), np.abs(expected), atol=1e-2 * push)
    assert (top.linear_stability(columns, np.full(size, 3, np.int8))[0] == Stability.STABLE).all()
    names = [
        "label",
        "label_any_axis",
        "precession_rate",
        "predicted",
        "predicted_any_axis",
        "agreement_any_axis",
        "status",
    ]
    ds = atlas.label_points("two_field_top", columns, duration=60.0, variables=names, progress=False)
    assert (ds["label_any_axis"] == Label.REGULAR_PRECESSION).all()
    assert (ds["agreement_any_axis"] == 1).all()
    assert (ds["label"] == Label.DRIFTING).all()
    np.testing.assert_allclose(np.abs(ds["precession_rate"]), np.abs(N), rtol=1e-6)
