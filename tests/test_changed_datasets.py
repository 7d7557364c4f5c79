"""Atlases that plain xarray has reordered, cut, joined or changed: the same answers, or one line that refuses."""

from functools import cache

import numpy as np
import pytest
import xarray as xr

import atlas
from atlas import BadInput, load_scene
from atlas.analysis.metadata import axes_of, scene_of, scene_problem
from atlas.cli import main

pytestmark = pytest.mark.usefixtures("whole_kernels", "coarse_lines")

HEAD = """schema = 1
system = "satellite"
integration = {duration = 4.0, tolerance = 1e-4}
labels.rate_tolerance = 2e-3
"""
SCENES = {
    "cylindrical": """fixed = {A = 1.1, Omega = 1.0, h3 = 0.1}
axes.sigma = {from = 0.35, to = 1.6, count = 9}
axes.m = {from = -1.8, to = 2.0, count = 8}
ties = {B = "A", C = "sigma * A"}
family.name = "cylindrical"
nudge = {theta0 = 1e-3, psi0 = 1e-3}
""",
    "solved": """fixed = {A = 1.0, Omega = 1.0, m = 0.3}
axes.sigma = {from = 0.25, to = 1.75, count = 7}
axes.theta0 = {from = 0.1, to = 1.4, count = 6}
ties = {B = "A", C = "sigma * A", psi0 = "pi / 2"}
family = {name = "perp_velocity", solve = ["k3"]}
nudge = {theta0 = 1e-4}
""",
    "offset": """fixed = {A = 1.0, C = 1.3, Omega = 1.0, m = 0.4}
axes.theta0 = {from = 0.1, to = 1.4, count = 6}
axes.k3 = {from = -0.5, to = 0.5, count = 5, offset_from_family = true}
ties = {B = "A", psi0 = "pi / 2"}
family = {name = "perp_velocity", solve = ["k3"]}
""",
    "plain": """fixed = {A = 1.0, B = 1.2, C = 0.8, psi0 = 0.4, mu1 = 0.2}
axes.theta0 = {from = 0.2, to = 1.3, count = 6}
axes.k3 = {values = [0.3, -0.2, 0.1, 0.5, -0.6]}
axes.m = {from = 0.1, to = 10.0, count = 3, spacing = "log"}
""",
    "sample": """fixed.m = 0.3
[points]
sample = "sobol"
count = 16
seed = 3
ranges = {theta0 = {from = 0.2, to = 1.2}, k3 = {from = -0.4, to = 0.4}}
""",
    "draws": """seed = 5
axes.draw = {from = 0, to = 7, count = 8}
axes.theta0 = {from = 0.3, to = 1.2, count = 6}
ties = {k3 = "0.1 * normal(draw)", C = "1.2 + 0.1 * theta0"}
""",
}
# How xarray joins today unless it is told otherwise; later versions keep the coordinates of the first alone.
DIFFERENT = {"coords": "different", "data_vars": "all", "compat": "equals", "join": "outer"}
REORDERED = {
    "shuffled": lambda ds, rng: ds.isel({dim: rng.permutation(n) for dim, n in ds.sizes.items()}),
    "reversed": lambda ds, rng: ds.isel({str(rng.choice(list(ds.dims))): slice(None, None, -1)}),
    "transposed": lambda ds, rng: ds.transpose(*rng.permutation(list(ds.dims)).tolist()),
    "chunked": lambda ds, rng: ds.chunk(dict.fromkeys(ds.dims, 3)),
    "stacked": lambda ds, rng: (
        ds.stack(z=rng.permutation(list(ds.dims)).tolist()) if len(ds.dims) > 1 else ds
    ),
}
KEPT = REORDERED | {
    "cut": lambda ds, rng: ds.isel({dim: np.sort(rng.choice(n, n - 1, False)) for dim, n in ds.sizes.items()}),
    "where": lambda ds, rng: ds.where(ds.theta0 > ds.theta0.median(), drop=True) if "theta0" in ds.dims else ds,
    "masked": lambda ds, rng: ds.where(ds.label == 3, 0),
    "without parameters": lambda ds, rng: ds.drop_vars(["h1", "damping"], errors="ignore"),
    "of fewer digits": lambda ds, rng: ds if "z" in ds.dims else ds.assign_coords(
        {name: ds[name].astype(np.float32) for name in ds.coords if name != "point"}
    ),
}  # fmt: skip


@cache
def changed_atlas(name: str, *changes: tuple[str, str]) -> xr.Dataset:
    """The atlas of a scene, after changes of its text."""
    text = HEAD + SCENES[name]
    for old, new in changes:
        assert old in text
        text = text.replace(old, new)
    return atlas.run(load_scene(text), progress=False)


def motion(ds: xr.Dataset, **place: float) -> np.ndarray | str:
    """Angles of a motion, or why there is none."""
    try:
        return ds.atlas.trajectory(samples=3, **place).theta.values
    except BadInput as error:
        return str(error)


def recomputed(ds: xr.Dataset) -> dict[str, object]:
    """What is computed again by the scene: motions, lines and curves; a text where it is refused."""
    some = ds.isel({dim: n // 3 for dim, n in ds.sizes.items()})
    answers: dict[str, object] = {"trajectory": motion(some)}
    for name in ("families", "boundary"):
        try:
            answers[name] = getattr(ds.atlas, name)()
        except BadInput as error:
            answers[name] = str(error)
    return answers


def check_kept(whole: xr.Dataset, ds: xr.Dataset, rng: np.random.Generator) -> None:
    """Every motion of a changed atlas is that of the atlas."""
    assert scene_problem(ds) == ""
    point = ds.isel({dim: int(rng.integers(n)) for dim, n in ds.sizes.items()})
    places = {dim: float(point[dim]) for dim in axes_of(scene_of(whole))}
    expected = motion(whole.sel(places)) if "point" in places else motion(whole, **places)
    np.testing.assert_array_equal(motion(point), expected)


def check_refused(ds: xr.Dataset, words: str) -> None:
    """What the scene would compute is refused in a line with these words, and what needs the data alone is not."""
    answers = recomputed(ds)
    assert words in answers["trajectory"]
    if len(ds.dims) == 2:
        assert answers["families"] == answers["boundary"]
        assert words in answers["families"]
        ds.atlas.boundary("drifting")
    assert words in ds.atlas.compare().splitlines()[-1]
    ds.atlas.fractions()
    ds.atlas.select(label="drifting")
    assert "\n" not in answers["trajectory"]


@pytest.mark.usual("0", "3", "8")
@pytest.mark.parametrize("seed", range(12))
def test_points_keep_their_motions(seed):
    rng = np.random.default_rng([1, seed])
    whole = ds = changed_atlas(list(SCENES)[seed % len(SCENES)])
    for change in rng.choice(list(KEPT), rng.integers(1, 4), replace=False):
        ds = KEPT[change](ds, rng)
    check_kept(whole, ds, rng)


FACTORS = (1 + 1e-12, 1 + 1e-7, 1.001, 2.0, 180 / np.pi, -1.0)


def changed_coordinates(whole: xr.Dataset, rng: np.random.Generator) -> tuple[str, float, xr.Dataset]:
    """An atlas with one coordinate, which is not 0 everywhere, multiplied."""
    system, axes = scene_of(whole).system, axes_of(scene_of(whole))
    names = [
        n for n in whole.coords if n in (*axes, *system.parameters) and n != "point" and (whole[n] != 0).any()
    ]
    name, factor = str(rng.choice(names)), float(rng.choice(FACTORS))
    return name, factor, whole.assign_coords({name: factor * whole[name].assign_attrs(whole[name].attrs)})


@pytest.mark.parametrize("seed", range(12))
def test_changed_coordinates_are_refused(seed):
    rng = np.random.default_rng([2, seed])
    whole = changed_atlas(list(SCENES)[seed % len(SCENES)])
    name, factor, ds = changed_coordinates(whole, rng)
    if factor == 1 + 1e-12:
        check_kept(whole, ds, rng)
    elif factor == -1 and {*(-whole[name]).values.flat} == {*whole[name].values.flat}:
        assert name in axes_of(scene_of(whole))  # an axis in the opposite order
    else:
        assert scene_problem(ds).startswith(f"{name} = ")
        check_refused(ds, " here, ")


# Scene -> changes of its text of which the coordinates tell, and the coordinate.
CHANGES = {
    "cylindrical": {"A": ("A = 1.1", "A = 1.2"), "h3": ("h3 = 0.1", "h3 = -0.1"), "C": ('"sigma * A"', '"1.1 * sigma * A"')},
    "solved": {"m": ("m = 0.3", "m = 0.35"), "Omega": ("Omega = 1.0", "Omega = 0.9"), "psi0": ('"pi / 2"', '"-pi / 2"')},
    "offset": {"k3": ("m = 0.4", "m = 0.41"), "C": ("C = 1.3", "C = 1.2"), "k3_offset": ("to = 0.5", "to = 0.6")},
    "plain": {"psi0": ("psi0 = 0.4", "psi0 = 0.5"), "mu1": ("mu1 = 0.2", "mu1 = 0.0"), "B": ("B = 1.2", "B = 1.1")},
    "sample": {"m": ("m = 0.3", "m = 0.2"), "theta0": ("seed = 3", "seed = 4")},
    "draws": {"k3": ("seed = 5", "seed = 6"), "C": ("1.2 +", "1.3 +")},
}  # fmt: skip


@pytest.mark.usual("3", "10")
@pytest.mark.parametrize("seed", range(12))
def test_two_scenes_joined_along_a_new_dimension(seed):
    rng = np.random.default_rng([3, seed])
    name = list(SCENES)[seed % len(SCENES)]
    of = str(rng.choice(list(CHANGES[name])))
    a, b = changed_atlas(name), changed_atlas(name, CHANGES[name][of])
    if of == "k3_offset":
        b = b.assign_coords(k3_offset=a.k3_offset)
    both = xr.concat([a, b], "kind", **DIFFERENT)
    check_kept(a, both.isel(kind=0), rng)
    assert scene_problem(both)
    check_refused(both.isel(kind=1), " by the scene of this dataset")


def halves(name: str, axis: str, *changes: tuple[str, str]) -> tuple[xr.Dataset, xr.Dataset, xr.Dataset]:
    """The atlases of both halves of an axis, the second after changes, and that of the whole axis."""
    whole = changed_atlas(name)
    values, n = whole[axis].values, whole.sizes[axis] // 2
    text = next(line for line in SCENES[name].splitlines() if line.startswith(f"axes.{axis} = "))
    parts = [(text, f"axes.{axis} = {{values = {part.tolist()}}}") for part in (values[:n], values[n:])]
    return changed_atlas(name, parts[0]), changed_atlas(name, parts[1], *changes), whole


@pytest.mark.long
@pytest.mark.parametrize(
    ("name", "axis"), [("cylindrical", "sigma"), ("solved", "theta0"), ("plain", "theta0"), ("draws", "draw")]
)
def test_halves_of_an_axis_joined_are_the_whole(name, axis):
    rng = np.random.default_rng(4)
    first, second, whole = halves(name, axis)
    joined = xr.concat([first, second], axis, **DIFFERENT)
    for ds in (joined, joined.isel({axis: slice(None, None, -1)})):
        for _ in range(5):
            place = {d: float(rng.choice(ds[d])) for d in ds.dims}
            np.testing.assert_array_equal(motion(ds, **place), motion(whole, **place))
    if len(whole.dims) == 2:
        expected, result = recomputed(whole), recomputed(joined)
        assert isinstance(result["families"], dict) == isinstance(expected["families"], dict)
        if isinstance(expected["boundary"], xr.Dataset):
            xr.testing.assert_allclose(result["boundary"], expected["boundary"])
    *_, (of, change) = CHANGES[name].items()
    first, second, _ = halves(name, axis, change)
    joined = xr.concat([first, second], axis, **DIFFERENT).isel({axis: slice(None, None, -1)})
    assert scene_problem(joined).startswith(f"{of} = ")
    check_refused(joined, " here, ")


def report(ds: xr.Dataset) -> list[str]:
    """The comparison of an atlas with theory, its worst points in any order."""
    lines = ds.atlas.compare(worst=50).splitlines()
    return [line for line in lines if "unsteadiness" not in line] + sorted(
        line for line in lines if "unsteadiness" in line
    )


@pytest.mark.usual("2", "4")
@pytest.mark.parametrize("seed", range(5))
def test_neighbours_do_not_depend_on_the_order_of_the_points(seed):
    rng = np.random.default_rng([5, seed])
    whole = changed_atlas(("cylindrical", "plain", "solved", "offset", "draws")[seed % 5])
    ds = whole = whole.assign(theta_max=whole.theta_max + 0.1 * whole.theta0)
    for change in rng.choice(
        [name for name in REORDERED if name != "stacked"], rng.integers(1, 4), replace=False
    ):
        ds = REORDERED[change](ds, rng)
    assert report(ds) == report(whole)
    rough = ds.atlas.roughness()
    np.testing.assert_array_equal(
        rough.transpose(*whole.theta_max.dims).sortby(list(whole.dims)),
        whole.sortby(list(whole.dims)).atlas.roughness(),
    )
    xr.testing.assert_identical(ds.atlas.trust(), whole.atlas.trust())
    xr.testing.assert_allclose(ds.atlas.fractions(), whole.atlas.fractions())


def test_neighbours_of_lists_are_none():
    whole = changed_atlas("cylindrical")
    band = "outside a band"
    assert band in whole.atlas.compare()
    for ds in (
        changed_atlas("sample"),
        whole.stack(z=("sigma", "m")).reset_index("z"),
        whole.stack(z=("sigma", "m")),
    ):
        assert band not in ds.atlas.compare()
        for question in (lambda a: a.trust(), lambda a: a.roughness()):
            with pytest.raises(BadInput, match="axis"):
                question(ds.atlas)


def test_the_nearest_of_two_values_is_the_smaller():
    whole = changed_atlas("cylindrical")
    middle = {"sigma": float(whole.sigma[2:4].mean())}
    assert (
        whole.isel(sigma=slice(None, None, -1)).atlas.nearest(**middle).sigma
        == whole.atlas.nearest(**middle).sigma
    )


def test_figures_show_the_same_values_of_a_reordered_axis(monkeypatch):
    from atlas.analysis import select

    whole = changed_atlas("cylindrical")
    monkeypatch.setattr(select, "MAX_CELLS", 5)
    shuffled = REORDERED["shuffled"](whole, np.random.default_rng(6))
    expected, result = (select.plane_of(ds, None, None, {})[0] for ds in (whole, shuffled))
    xr.testing.assert_identical(result, expected)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda ds: ds.assign_coords(theta0=("theta0", ds.theta0.values, {"units": "degrees"})), "theta0: units degrees here, rad by"),
        (lambda ds: ds.assign_coords(psi0=ds.psi0.assign_attrs(units="deg")), "psi0: units deg here, rad by"),
        (lambda ds: ds.rename(sigma="ratio"), "sigma: this axis of the scene is not in the dataset"),
        (lambda ds: ds.rename(sigma="theta0", theta0="sigma"), " here, no value of this axis of its scene"),
        (lambda ds: ds.assign_attrs(atlas_scene=changed_atlas("plain").attrs["atlas_scene"]), " here, no value of this axis of its scene"),
        (lambda ds: ds.assign_attrs(atlas_system="fixed_point"), "atlas_system = 'fixed_point' here, satellite by its scene"),
        (lambda ds: ds.assign_coords(k3=ds.k3.where(ds.sigma < 1.5, 0.1)), " by the scene of this dataset"),
    ],
)  # fmt: skip
def test_other_scenes_and_units(change, words):
    assert words in scene_problem(change(changed_atlas("solved")))


def test_a_lost_scene():
    ds = changed_atlas("solved").copy()
    del ds.attrs["atlas_scene"]
    with pytest.raises(BadInput, match="the attribute atlas_scene with the scene is missing"):
        ds.atlas.trajectory(sigma=1.0, theta0=0.4)
    assert ds.atlas.map().axes


def test_maps_of_changed_coordinates_have_no_theory(caplog, tmp_path, capsys):
    whole = changed_atlas("solved")
    ds = whole.assign_coords(theta0=np.rad2deg(whole.theta0).assign_attrs(whole.theta0.attrs))
    assert len(whole.atlas.map().axes[0].lines) > len(ds.atlas.map().axes[0].lines) == 0
    assert "no theory on this map: theta0 = 5.7" in caplog.text
    caplog.clear()
    ds.atlas.map(boundary=False)
    assert not caplog.text
    ds.to_netcdf(tmp_path / "degrees.nc")
    assert main(["trajectory", str(tmp_path / "degrees.nc"), "--at", "sigma=1.0", "theta0=5.7"]) == 2
    assert "no value of this axis of its scene" in capsys.readouterr().err


@pytest.mark.long
def test_little_of_a_lazy_run_folder_is_read(tmp_path, monkeypatch):
    """The trajectory of a point reads one tile, lines of theory and a trajectory of the shell a few."""
    from atlas.store.tile import Tiles

    monkeypatch.setenv("ATLAS_TILE_POINTS", "4")
    text = (HEAD + SCENES["solved"]).replace("count = 7", "count = 40").replace("count = 6", "count = 20")
    text = 'outputs.variables = ["label", "predicted"]\n' + text  # little is written, either
    atlas.run(load_scene(text), tmp_path / "run", progress=False)
    ds, read = atlas.open_atlas(tmp_path / "run"), Tiles.read
    tiles = set[int]()
    monkeypatch.setattr(
        Tiles, "read", lambda self, tile, *rest: (tiles.add(tile), read(self, tile, *rest))[1]
    )
    ds.atlas.trajectory(sigma=1.0, theta0=0.5, samples=3)
    assert len(tiles) == 1
    assert scene_problem(ds) == ""
    ds.atlas.boundary()
    arguments = [
        "trajectory",
        str(tmp_path / "run"),
        "-o",
        str(tmp_path / "motion.nc"),
        "--at",
        "sigma=1.0",
        "theta0=0.5",
    ]
    assert main(arguments) == 0
    assert len(tiles) <= 10


@pytest.mark.usual("netcdf4", "scipy")
@pytest.mark.parametrize("engine", ["netcdf4", "scipy", "zarr"])
def test_files_of_plain_xarray_keep_their_scenes(engine, tmp_path):
    path, whole = tmp_path / "plain", changed_atlas("solved")
    if engine == "zarr":
        whole.to_zarr(path, consolidated=False)
    else:
        whole.astype(np.float64).to_netcdf(path, engine=engine)
    options = {"consolidated": False} if engine == "zarr" else {}
    with xr.open_dataset(path, engine=engine, **options) as ds:
        check_kept(whole, ds, np.random.default_rng(7))


def test_points_without_a_scene_have_units_alone_to_be_compared():
    ds = atlas.label_points("satellite", {"theta0": [0.4, 0.9], "m": 0.3}, duration=2.0, step=0.05)
    assert scene_problem(ds) == ""
    assert isinstance(motion(ds.isel(point=1)), np.ndarray)
    degrees = ds.assign_coords(theta0=("point", np.rad2deg(ds.theta0.values), {"units": "degree"}))
    assert motion(degrees.isel(point=1)).startswith("theta0: units degree here, rad by the scene or system")
