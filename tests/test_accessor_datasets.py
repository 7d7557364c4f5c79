"""ds.atlas on datasets that xarray has changed: each question is answered, or refused in one line."""

import numpy as np
import pytest
import xarray as xr
from refusals import assert_refused

import atlas
from atlas import BadInput, load_scene
from atlas.extension import extensions
from atlas.flags import Label

pytestmark = pytest.mark.usefixtures("whole_kernels", "coarse_lines")

SHAPE = (4, 5)
MEANINGS = {"flag_values": np.arange(5, dtype=np.int8), "flag_meanings": " ".join(Label.meanings())}


@pytest.fixture(scope="module")
def ds(small_scene):
    return atlas.run(load_scene(small_scene), progress=False)


@pytest.fixture(scope="module")
def three_axes(scene_text):
    return atlas.run(
        load_scene(scene_text({"fixed.m": None, "axes.m.values": [0.4, 0.5, 0.6], "axes.theta0.count": 5})),
        progress=False,
    )


def foreign() -> xr.Dataset:
    """A dataset that has nothing to do with atlases."""
    return xr.Dataset({"t": (("x", "y"), np.ones(SHAPE))}, {"x": np.arange(4.0), "y": np.arange(5.0)})


def reloaded(ds: xr.Dataset, tmp_path, **options) -> xr.Dataset:
    """The dataset as plain xarray reads it from a file."""
    ds.to_netcdf(tmp_path / "plain.nc")
    return xr.open_dataset(tmp_path / "plain.nc", **options)


# Name -> function of an atlas of two axes, one of three, and a folder.
DATASETS = {
    "whole": lambda ds, cube, path: ds,
    "three axes": lambda ds, cube, path: cube,
    "empty dataset": lambda ds, cube, path: xr.Dataset(),
    "foreign": lambda ds, cube, path: foreign(),
    "foreign, dimensions without values": lambda ds, cube, path: foreign().drop_vars(["x", "y"]),
    "foreign, axis of texts": lambda ds, cube, path: foreign().assign_coords(x=list("abcd")),
    "foreign label": lambda ds, cube, path: foreign().assign(label=(("x", "y"), np.zeros(SHAPE, np.int8))),
    "foreign flags": lambda ds, cube, path: foreign().assign(
        label=(("x", "y"), np.ones(SHAPE, np.int8), {"flag_values": [1, 4], "flag_meanings": "a b"})
    ),
    "label alone": lambda ds, cube, path: ds[["label"]],
    "without label": lambda ds, cube, path: ds.drop_vars("label"),
    "without attributes": lambda ds, cube, path: ds.drop_attrs(),
    "without some attributes": lambda ds, cube, path: ds.assign_attrs(history=1).drop_attrs(deep=False)
    .assign_attrs(atlas_system="satellite"),
    "axis renamed": lambda ds, cube, path: ds.rename(sigma="s"),
    "variable renamed": lambda ds, cube, path: ds.rename(label="kind"),
    "averaged": lambda ds, cube, path: ds.mean("theta0", keep_attrs=True),
    "averaged over one of three axes": lambda ds, cube, path: cube.mean("m", keep_attrs=True),
    "averaged without attributes": lambda ds, cube, path: ds.mean("theta0", keep_attrs=False),
    "coarsened": lambda ds, cube, path: ds.coarsen(sigma=2, boundary="trim").mean(keep_attrs=True),
    "interpolated": lambda ds, cube, path: ds.interp(sigma=[0.5, 1.0, 1.5]),
    "masked with nan": lambda ds, cube, path: ds.where(ds.label == Label.DRIFTING),
    "masked with zero": lambda ds, cube, path: ds.where(ds.label == Label.DRIFTING, 0),
    "cut by where": lambda ds, cube, path: ds.where(ds.sigma > 1, drop=True),
    "reindexed": lambda ds, cube, path: ds.reindex(sigma=[0.3, 0.5]),
    "transposed": lambda ds, cube, path: ds.transpose(),
    "three axes transposed": lambda ds, cube, path: cube.transpose(),
    "reversed": lambda ds, cube, path: ds.isel(sigma=slice(None, None, -1)),
    "part": lambda ds, cube, path: ds.isel(sigma=slice(2, 5)),
    "one value of an axis": lambda ds, cube, path: ds.isel(sigma=[2]),
    "row": lambda ds, cube, path: ds.isel(sigma=2),
    "scalar": lambda ds, cube, path: ds.isel(sigma=8, theta0=3),
    "no values of an axis": lambda ds, cube, path: ds.isel(sigma=slice(0, 0)),
    "stacked": lambda ds, cube, path: ds.stack(point=("sigma", "theta0")),
    "two copies": lambda ds, cube, path: xr.concat([ds, ds], "copy", data_vars="all"),
    "without parameters": lambda ds, cube, path: ds.reset_coords(drop=True),
    "without an axis": lambda ds, cube, path: ds.drop_vars("sigma"),
    "dask": lambda ds, cube, path: ds.chunk({"sigma": 4}),
    "reloaded": lambda ds, cube, path: reloaded(ds, path),
    "reloaded by dask": lambda ds, cube, path: reloaded(cube, path, chunks={}),
    "reloaded without decoding": lambda ds, cube, path: reloaded(ds, path, decode_cf=False),
    "points": lambda ds, cube, path: points(),
    "points reloaded": lambda ds, cube, path: reloaded(points(), path),
    "points without parameters": lambda ds, cube, path: points().reset_coords(drop=True),
    "one point without parameters": lambda ds, cube, path: points().isel(point=0).reset_coords(drop=True),
    "selection": lambda ds, cube, path: ds.atlas.select(label="drifting"),
    "empty selection": lambda ds, cube, path: ds.atlas.select(label="unresolved"),
    "empty selection reloaded": lambda ds, cube, path: reloaded(ds.atlas.select(label="unresolved"), path),
}  # fmt: skip
QUESTIONS = {
    "select": lambda a: a.select(label="drifting"),
    "select number": lambda a: a.select(label=Label.DRIFTING),
    "select two": lambda a: a.select(label=3, agreement=["agree", 0]),
    "nearest sigma": lambda a: a.nearest(sigma=1.2),
    "nearest x": lambda a: a.nearest(x=1),
    "nearest theta0": lambda a: a.nearest(theta0=0.5),
    "nearest": lambda a: a.nearest(),
    "fractions": lambda a: a.fractions(),
    "fractions along": lambda a: a.fractions(along="sigma"),
    "probability": lambda a: a.probability(over="sigma"),
    "boundary": lambda a: a.boundary("drifting"),
    "trajectory": lambda a: a.trajectory(samples=3, sigma=1.2, theta0=0.5),
    "trajectory theta0": lambda a: a.trajectory(samples=3, theta0=0.5),
    "trajectory here": lambda a: a.trajectory(samples=3),
    "compare": lambda a: a.compare(),
    "families": lambda a: a.families(),
    "trust": lambda a: a.trust(),
    "cite": lambda a: a.cite(),
    "map": lambda a: a.map(),
    "map of numbers": lambda a: a.map("theta_dot_rms"),
}
if "margins" in extensions():
    QUESTIONS |= {"border error": lambda a: str(a.border_error()), "margin": lambda a: a.margin("sigma")}


def points() -> xr.Dataset:
    return atlas.label_points(
        "satellite", {"theta0": [0.4, 0.9, 1.2], "m": [0.3, 0.2, 0.3]}, duration=5.0, step=0.05
    )


# Those that must be answered, of some datasets.
ANSWERED = {
    **dict.fromkeys(
        ["whole", "transposed", "reversed", "without parameters", "dask", "reloaded", "reloaded without decoding"],
        set(QUESTIONS) - {"nearest x", "trajectory theta0", "trajectory here"},
    ),
    "label alone": set(QUESTIONS)
    - {"select two", "nearest x", "trajectory theta0", "trajectory here", "compare", "map of numbers"},
    "row": {"select", "select number", "select two", "nearest theta0", "nearest", "fractions", "trajectory theta0",
            "compare", "families", "trust", "border error", "cite", "map", "map of numbers"},
    "scalar": {"select", "select number", "select two", "nearest", "fractions", "trajectory here", "compare", "cite"},
    "selection": {"select", "select number", "select two", "nearest sigma", "nearest theta0", "nearest", "fractions",
                  "trajectory", "trajectory theta0", "compare", "cite"},
    "empty selection": {"select", "select number", "select two", "fractions", "cite"},
    "averaged": {"nearest sigma", "nearest", "cite", "map of numbers"},
    "masked with nan": {"nearest sigma", "nearest theta0", "nearest", "trajectory", "families", "cite", "map of numbers"},
    "foreign": {"nearest x", "nearest"},
    "empty dataset": {"nearest"},
}  # fmt: skip
assert ANSWERED.keys() <= DATASETS.keys()


@pytest.mark.usual(
    "empty dataset",
    "foreign",
    "without label",
    "averaged",
    "row",
    "scalar",
    "stacked",
    "points",
    "empty selection",
    "coarsened",
)
@pytest.mark.parametrize("dataset", DATASETS)
def test_every_question_to_every_dataset_is_answered_or_refused_in_one_line(
    ds, three_axes, tmp_path, dataset
):
    answered = set()
    with DATASETS[dataset](ds, three_axes, tmp_path) as changed:
        for name, question in QUESTIONS.items():
            try:
                question(changed.atlas)
                answered.add(name)
            except BadInput as error:
                message = str(error)
                assert "\n" not in message
                assert len(message) > 20, name
    if "selection" in dataset:
        answered -= {"map", "map of numbers"}  # of single points, too, there may be maps
    if dataset in ANSWERED:
        assert answered == ANSWERED[dataset] & QUESTIONS.keys()


@pytest.mark.parametrize("dataset", ["transposed", "reversed", "dask", "reloaded", "stacked", "two copies"])
def test_answers_do_not_depend_on_the_form_of_the_dataset(ds, three_axes, tmp_path, dataset):
    with DATASETS[dataset](ds, three_axes, tmp_path) as changed:
        np.testing.assert_allclose(changed.atlas.fractions(), ds.atlas.fractions())
        selected, expected = changed.atlas.select(label=3), ds.atlas.select(label="drifting")
    places = {
        (float(sigma), float(theta0)) for sigma, theta0 in zip(selected.sigma, selected.theta0, strict=True)
    }
    assert places == {
        (float(sigma), float(theta0)) for sigma, theta0 in zip(expected.sigma, expected.theta0, strict=True)
    }
    assert selected.sizes["point"] == len(places) * (2 if dataset == "two copies" else 1)


def test_flags_are_selected_by_names_and_numbers(ds):
    by_name = ds.atlas.select(label="drifting")
    for flag in (3, Label.DRIFTING, np.int8(3), np.array(3), [3], np.array([3]), ("drifting", 3), {3}):
        assert ds.atlas.select(label=flag).identical(by_name)
    assert ds.atlas.select(label=by_name.label[0]).identical(by_name)
    for flag in (5, -1, 3.0, True, None, "3", [3, "drift"]):
        with pytest.raises(BadInput, match=r"allowed: not_computed, .*, or their numbers 0 to 4"):
            ds.atlas.select(label=flag)


def changed_label(ds: xr.Dataset, **attributes: object) -> xr.Dataset:
    return ds.assign(label=ds.label.assign_attrs(attributes))


AVERAGED = "they were averaged, interpolated or masked with nan; choose points by select, sel or isel, or "
OF_FLOATS = f"label: values of type float... are no flags: {AVERAGED}mask with where(condition, 0)"
OF_CELLS = f"label: values with cell_methods = '...' are no flags: {AVERAGED}remove this attribute from data that were only joined"
# Name -> a dataset with three axes changed, and the sentence about its labels.
NO_FLAGS = {
    "averaged": (lambda ds: ds.mean("theta0", keep_attrs=True), OF_FLOATS),
    "without attributes": (lambda ds: ds.isel(m=0).assign(label=(ds.label.mean("m") / 2).drop_attrs()), OF_FLOATS),
    "masked": (lambda ds: ds.isel(m=0).assign(label=ds.label.isel(m=0).where(ds.label.isel(m=0) > 2)), OF_FLOATS),
    # ncwa writes means of bytes as bytes, and ncra leaves a dimension of one value.
    "of NCO": (lambda ds: changed_label(ds.isel(m=0), cell_methods="m: mean"), OF_CELLS),
    "of NCO, axis kept": (
        lambda ds: changed_label(ds.isel(m=[0]), cell_methods="area: point m, sigma: sum (of bytes)"), OF_CELLS,
    ),
    "whole": (
        lambda ds: ds.isel(m=0).assign(label=ds.label.isel(m=0).astype("float32")),
        "label: values of type float32 are no flags: they were averaged, or written as floats; as all are whole numbers"
        ' here, .astype("int8") makes flags of them',
    ),
}  # fmt: skip


@pytest.mark.parametrize("change", NO_FLAGS)
def test_averages_of_flags_are_no_flags(three_axes, change):
    averaged, sentence = NO_FLAGS[change][0](three_axes), NO_FLAGS[change][1]
    for question in (
        lambda a: a.map("label"),
        lambda a: a.fractions(),
        lambda a: a.probability(over="sigma"),
        lambda a: a.select(label=3),
        lambda a: a.trust(),
        lambda a: a.boundary("drifting"),
        lambda a: a.to_dataframe(),
        lambda a: a.compare(averaged),
        lambda a: a.differences(averaged),
    ):
        assert_refused(lambda question=question: question(averaged.atlas), sentence)
    assert_refused(
        averaged.atlas.compare, "label: damaged, averaged or masked: not the flags of an atlas, 0 to 4"
    )


def test_flags_that_NCO_joined_are_flags(three_axes):
    """ncrcat writes the method of a mean on data of which it only joined parts."""
    joined = changed_label(three_axes, cell_methods="m: mean")
    xr.testing.assert_identical(joined.atlas.fractions(), three_axes.atlas.fractions())
    assert joined.atlas.compare() == three_axes.atlas.compare()
    selected = joined.atlas.select(label="drifting")
    assert selected.atlas.fractions().sel(label="drifting") == 1
    place = {"m": float(joined.m[1])}
    assert joined.atlas.map("label", select=place).axes
    near = joined.atlas.nearest(**place)
    xr.testing.assert_identical(near.atlas.fractions(), three_axes.atlas.nearest(**place).atlas.fractions())
    assert joined.label.attrs["cell_methods"] == "m: mean"


def test_whole_numbers_of_another_type_are_flags_again(three_axes):
    floats = three_axes.assign(label=three_axes.label.astype("float32"))
    again = floats.assign(label=floats.label.astype("int8"))
    xr.testing.assert_identical(again.atlas.fractions(), three_axes.atlas.fractions())


@pytest.mark.parametrize("has_coordinate", [True, False])
def test_points_under_another_name_are_drawn_as_points(has_coordinate):
    """Where the coordinate of their dimension is no number, or there is none."""
    points = {"theta0": [0.2, 0.4, 0.6], "m": [0.1, 0.5, 0.2]}
    ds = atlas.label_points("satellite", points, duration=1.0).rename(point="body")
    ds = ds.assign_coords(body=["a", "b", "c"]) if has_coordinate else ds.drop_vars("body", errors="ignore")
    ax = ds.atlas.map("theta_max", x="m", y="theta0").axes[0]
    assert sum(len(each.get_offsets()) for each in ax.collections) == 3


def test_the_nearest_of_points_without_some_parameters():
    start = xr.Dataset(coords={"a": ("point", [np.nan, 1.0, 2.0]), "b": ("point", [0.0, np.nan, 5.0])})
    assert float(start.atlas.nearest(a=1.1).a) == 1.0
    assert float(start.atlas.nearest(a=1.1, b=0.0).b) == 5.0  # the only one with both
    with pytest.raises(BadInput, match="no point has values of all of them"):
        start.isel(point=[0, 1]).atlas.nearest(a=1.0, b=0.0)
    with pytest.raises(BadInput, match="a: is not given at any"):
        start.isel(point=[0]).atlas.nearest(a=1.0)
    with pytest.raises(BadInput, match="a = 'x': must be a finite number"):
        start.atlas.nearest(a="x")


def test_disagreements_among_points_are_named_by_what_varies():
    ds = xr.Dataset(
        {
            "label": ("point", np.array([2, 3, 3], np.int8), MEANINGS),
            "predicted": ("point", np.array([2, 2, 3], np.int8), MEANINGS),
        },
        coords={"theta0": ("point", [0.1, 0.2, 0.3]), "m": ("point", [0.5, 0.5, 0.5])},
    )
    assert (
        ds.atlas.compare().splitlines()[-1].startswith("  point 1, theta0 = 0.2: theory permanent_rotation")
    )
    with pytest.raises(BadInput, match="worst = -1: must be a whole number, at least 0"):
        ds.atlas.compare(worst=-1)
