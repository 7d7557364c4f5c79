"""Tables of pandas in and out: index, categories, rows."""

import re

import numpy as np
import pandas as pd
import pytest

import atlas
from atlas import BadInput

FRAME = pd.DataFrame(
    {"C": [0.8, 1.2, 0.9], "theta0": [0.0, 0.4, 0.7], "m": [0.5, 0.6, 0.9], "name": ["a", "b", "c"]},
    index=[10, 20, 30],
)


@pytest.fixture(scope="module")
def points():
    return atlas.label_points("satellite", FRAME, duration=5.0)


def test_the_index_is_the_coordinate_of_point(points):
    assert points.point.values.tolist() == [10, 20, 30]
    joined = FRAME.join(points.atlas.to_dataframe()[["label", "theta_max"]])
    assert joined.theta_max.notna().all()
    assert points.sel(point=20).C.item() == 1.2
    assert points.atlas.trajectory(point=30).theta.values[0] == pytest.approx(0.7)
    named = atlas.label_points("satellite", FRAME.set_index("name"), duration=5.0)
    assert named.point.values.tolist() == ["a", "b", "c"]
    assert np.array_equal(named.theta_max, points.theta_max)
    assert named.atlas.map(x="C", y="m")
    assert "point" not in atlas.label_points("satellite", FRAME.reset_index(drop=True), duration=5.0).coords


def test_an_index_named_like_a_parameter_is_this_parameter(points):
    by_theta = atlas.label_points("satellite", FRAME.set_index("theta0"), duration=5.0)
    assert np.array_equal(by_theta.theta_max, points.theta_max)


def test_flags_are_categories_by_name(points):
    frame = points.atlas.to_dataframe()
    names = points.label.attrs["flag_meanings"].split()
    assert list(frame.label.cat.categories) == names
    assert frame.label.tolist() == [names[value] for value in points.label.values]
    degrees = points.atlas.to_dataframe(degrees=True)
    np.testing.assert_allclose(degrees.theta0, np.degrees(frame.theta0))
    one = points.isel(point=1).atlas.to_dataframe()
    assert one.label.tolist() == [names[int(points.label[1])]]


def test_the_table_of_an_atlas_has_its_axes_as_index(small_scene):
    ds = atlas.run(atlas.load_scene(small_scene), progress=False)
    frame = ds.atlas.to_dataframe()
    assert frame.index.names == ["sigma", "theta0"]
    assert frame.groupby("label", observed=True).size().sum() == ds.label.size
    means = ds.mean("theta0", keep_attrs=True)
    with pytest.raises(BadInput, match=r"^label: values of type float64 are no flags: they were averaged"):
        means.atlas.to_dataframe()
    flags = [name for name, array in means.items() if "flag_meanings" in array.attrs]
    assert means.drop_vars(flags).atlas.to_dataframe().theta_dot_rms.dtype == float


def test_a_row_is_a_point(points):
    for i in range(3):
        motion = atlas.trajectory("satellite", FRAME.iloc[i], duration=5.0, samples=11)
        assert motion.theta.values[0] == pytest.approx(FRAME.theta0.iloc[i])
    assert float(atlas.label_points("satellite", FRAME.iloc[1], duration=5.0).C) == 1.2


def test_wrong_tables_are_one_line(points):
    several = FRAME.set_index(["C", "name"])
    message = "points: an index of 2 levels; reset_index() makes columns of them"
    with pytest.raises(BadInput, match=f"^{re.escape(message)}$"):
        atlas.label_points("satellite", several)
    with pytest.raises(BadInput, match=r"^colour: not a parameter of the satellite"):
        atlas.trajectory("satellite", pd.Series({"C": 1.0, "colour": 3.0}))
    with pytest.raises(BadInput, match=r"^theta0 = nan: must be a finite number"):
        atlas.trajectory("satellite", pd.Series({"C": 1.0, "theta0": np.nan}))
    with pytest.raises(BadInput, match=r"^degrees = 1: must be true or false"):
        points.atlas.to_dataframe(degrees=1)
    with pytest.raises(BadInput, match=r"^label: damaged: not the flags of an atlas"):
        points.assign(label=(points.label + 90).assign_attrs(points.label.attrs)).atlas.to_dataframe()
