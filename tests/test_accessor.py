"""ds.atlas: results equal those of brute force, on files, in memory, and chunk by chunk."""

import re
import subprocess
import sys
import tracemalloc
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import xarray as xr
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import array_shapes, arrays
from scenes import labelled
from scipy import stats

import atlas
from atlas import BadInput, extension, load_scene
from atlas.accessor import Atlas
from atlas.analysis import exact_curves, metadata, plane
from atlas.analysis.metadata import map_variable
from atlas.flags import Agreement, Label
from atlas.systems.base import families_of

pytestmark = pytest.mark.usefixtures("whole_kernels")


@pytest.fixture(scope="module")
def files(tmp_path_factory, small_scene):
    path = tmp_path_factory.mktemp("atlas") / "small.nc"
    return path, atlas.run(load_scene(small_scene), path, progress=False)


@pytest.fixture(params=["memory", "file", "dask", "chunks"])
def small(files, request, monkeypatch):
    path, ds = files
    if request.param == "chunks":
        monkeypatch.setattr(metadata, "MAX_POINTS", 10)
    if request.param in ("memory", "chunks"):
        yield ds
        return
    with atlas.open_atlas(path) as read:
        yield read.chunk({"sigma": 4, "theta0": 3}) if request.param == "dask" else read


# Selection and fractions.


@pytest.mark.usual("file")
def test_select_gives_the_points_of_the_flags(small, files):
    _, ds = files
    flat = ds.stack(index=("sigma", "theta0"))
    drifting, agreed = flat.label.values == Label.DRIFTING, flat.agreement.values == Agreement.AGREE
    for chosen, expected in (
        (small.atlas.select(label="drifting"), drifting),
        (small.atlas.select(label="drifting", agreement=["agree"]), drifting & agreed),
        (
            small.atlas.select(label=["drifting", "permanent_rotation"]),
            flat.label.isin([Label.PERMANENT_ROTATION, Label.DRIFTING]).values,
        ),
        (small.atlas.select(status="not_finite"), np.zeros(63, bool)),
    ):
        assert chosen.sizes == {"point": expected.sum()}
        assert set(chosen.coords) == set(ds.coords)
        assert str(chosen.attrs) == str(small.attrs)
        for name in ds.data_vars:
            np.testing.assert_array_equal(chosen[name], flat[name].values[expected])
            assert chosen[name].dtype == ds[name].dtype
            assert chosen[name].attrs.keys() == ds[name].attrs.keys()
        for name in ("sigma", "theta0", "k3"):
            np.testing.assert_array_equal(chosen[name], flat[name].values[expected])
        np.testing.assert_array_equal(chosen["C"], flat["sigma"].values[expected])
        assert chosen["Omega"].ndim == 0


def test_a_selection_can_be_selected_from_again(files):
    _, ds = files
    drifting = ds.atlas.select(label="drifting")
    assert float(drifting.atlas.fractions().sel(label="drifting")) == 1.0
    agreed = drifting.atlas.select(agreement="agree")
    assert agreed.identical(ds.atlas.select(label="drifting", agreement="agree"))
    point = drifting.isel(point=5)
    assert drifting.atlas.nearest(sigma=float(point.sigma), theta0=float(point.theta0)).identical(point)
    empty = drifting.atlas.select(label="unresolved")
    assert empty.sizes == {"point": 0}
    assert empty.atlas.select(label="drifting").sizes == {"point": 0}


def test_fractions_are_counts(small, files):
    _, ds = files
    whole = small.atlas.fractions()
    assert list(whole.label.values) == ds.label.attrs["flag_meanings"].split()
    np.testing.assert_allclose(
        whole, np.bincount(ds.label.values.ravel(), minlength=len(Label)) / ds.label.size
    )
    for along, axis in (("sigma", 1), ("theta0", 0)):
        rows = small.atlas.fractions("agreement", along=along)
        assert rows.dims == (along, "agreement")
        np.testing.assert_array_equal(rows[along], ds[along])
        for value in Agreement:
            np.testing.assert_allclose(rows[:, value], (ds.agreement.values == value).mean(axis))


def test_probabilities_are_shares_with_the_interval_of_scipy(small, files):
    _, ds = files
    shares = small.atlas.probability("agreement", over="theta0")
    assert shares.probability.dims == ("sigma", "agreement")
    counts = np.array([(ds.agreement.values == value).sum(1) for value in Agreement]).T
    np.testing.assert_array_equal(shares.probability, counts / ds.sizes["theta0"])
    for k, low, high in zip(
        counts.ravel(), shares.lower.values.ravel(), shares.upper.values.ravel(), strict=True
    ):
        interval = stats.binomtest(k, ds.sizes["theta0"]).proportion_ci(method="wilson")
        np.testing.assert_allclose((low, high), interval, atol=1e-15)
    assert "k3" not in shares.coords
    np.testing.assert_array_equal(shares.C, ds.C)
    both = small.atlas.probability(over=["sigma", "theta0"])
    np.testing.assert_array_equal(both.probability, small.atlas.fractions())
    figure = shares.sel(agreement="agree").atlas.map()
    assert figure.axes[0].get_ylabel().startswith("probability")


@settings(max_examples=20)
@given(
    arrays(np.int8, array_shapes(min_dims=1, max_dims=3, max_side=7), elements=st.integers(0, 4)),
    st.integers(1, 30),
)
def test_chunks_cover_every_point_once(label, max_points):
    ds = labelled(label)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(metadata, "MAX_POINTS", max_points)
        visits = np.zeros(label.shape, int)
        for box in metadata.chunks(ds.sizes, list(ds.dims)):
            slices = tuple(box.values())
            visits[slices] += 1
            assert visits[slices].size <= max_points
        assert (visits == 1).all()
        selected = ds.atlas.select(label="drifting")
    for i, dim in enumerate(ds.dims):
        np.testing.assert_array_equal(
            selected[dim], ds[dim].values[np.argwhere(label == Label.DRIFTING)[:, i]]
        )


@pytest.mark.long
def test_an_atlas_larger_than_a_chunk_is_never_loaded_whole(tmp_path, monkeypatch):
    monkeypatch.setattr(metadata, "MAX_POINTS", 250_000)
    size = 4000  # 16 MB of labels
    label = np.full((size, size), Label.PERMANENT_ROTATION, np.int8)
    label[1501:, 77] = Label.DRIFTING
    labelled(label).to_netcdf(
        tmp_path / "large.nc", encoding={"label": {"zlib": True, "chunksizes": (100, 1000)}}
    )
    del label
    with xr.open_dataset(tmp_path / "large.nc") as ds:
        tracemalloc.start()
        try:
            selected = ds.atlas.select(label="drifting")
            fractions = ds.atlas.fractions(along="x0")
            trust = ds.atlas.trust()
            _, peak = tracemalloc.get_traced_memory()
        finally:
            tracemalloc.stop()
    assert peak < 6e6
    assert selected.sizes["point"] == size - 1501
    assert float(fractions.isel(x0=1501).sel(label="drifting")) == pytest.approx(1 / size)
    assert float(trust.uncertain[0]) > 0


# Planes and points.


def test_the_boundary_of_a_disc_is_its_circle():
    x, y = np.linspace(-1, 1, 81), np.linspace(-2, 2, 101)
    ds = labelled(
        np.where(x[:, None] ** 2 + y**2 / 4 < 0.5, Label.DRIFTING, Label.PERMANENT_ROTATION)
    ).assign_coords(x0=x, x1=y)
    ds.attrs["atlas_system"] = "satellite"
    line = ds.atlas.boundary("drifting")
    assert set(line.line.values) == {0}
    assert set(line.kind.values) == {"label = drifting"}
    assert (float(line.x0[0]), float(line.x1[0])) == (float(line.x0[-1]), float(line.x1[-1]))
    radius = np.hypot(line.x0, line.x1 / 2)
    assert float(np.abs(radius - np.sqrt(0.5)).max()) < 2 / 80
    turned = ds.atlas.boundary("drifting", x="x1", y="x0")
    np.testing.assert_allclose(np.hypot(turned.x0, turned.x1 / 2).max(), radius.max())
    assert ds.atlas.boundary("unresolved").sizes == {"vertex": 0}
    with pytest.raises(BadInput, match="come from no scene"):
        ds.atlas.boundary()
    with pytest.raises(BadInput, match="needs two axes"):
        ds.atlas.boundary("drifting", select={"x0": 0.0})


@pytest.mark.long
@given(st.floats(0.25, 1.75), st.floats(0.15, 1.45))
def test_nearest_is_the_nearest(files, sigma, theta0):
    _, ds = files
    point = ds.atlas.nearest(sigma=sigma, theta0=theta0)
    assert point.sizes == {}
    assert abs(float(point.sigma) - sigma) == np.abs(ds.sigma - sigma).min()
    assert abs(float(point.theta0) - theta0) == np.abs(ds.theta0 - theta0).min()
    assert ds.atlas.nearest(sigma=sigma).sizes == {"theta0": 7}


def test_cells_of_logarithmic_axes_are_those_of_maps(scene_text):
    ds = atlas.run(
        load_scene(scene_text({"axes.sigma.spacing": "log", "axes.sigma.count": 5})), progress=False
    )
    inner = np.sqrt(ds.sigma.values[1:] * ds.sigma.values[:-1])
    vertices = np.unique(ds.atlas.boundary("drifting").sigma)
    between = [v for v in vertices if np.abs(ds.sigma - v).min() > 1e-9]
    assert len(between) > 0
    np.testing.assert_allclose([np.abs(inner / v - 1).min() for v in between], 0, atol=1e-12)
    for edge, low, high in zip(inner, ds.sigma.values, ds.sigma.values[1:], strict=False):
        assert float(ds.atlas.nearest(sigma=edge * (1 - 1e-9)).sigma) == low
        assert float(ds.atlas.nearest(sigma=edge * (1 + 1e-9)).sigma) == high
    first, last = ds.atlas.map(boundary=False).axes[0].get_xlim()
    assert float(ds.atlas.nearest(sigma=first * (1 + 1e-9)).sigma) == ds.sigma[0]
    for value in (first * (1 - 1e-9), last * (1 + 1e-9), -1.0):
        with pytest.raises(BadInput, match="outside the atlas"):
            ds.atlas.nearest(sigma=value)


# Flags.


def test_booleans_are_flags_and_differences_of_flags_are_none(files):
    _, small = files
    drifts = small.label == Label.DRIFTING
    share = float(drifts.mean())
    ds = small.assign(
        drifts=drifts,
        number=drifts.astype("int8"),
        difference=small.label - small.label_inertial,
        same=small.label - small.label,
        mean=small.label.mean("sigma"),
        copy=small.label.assign_attrs(long_name="another label"),
    )
    assert ds.atlas.fractions("drifts").to_series().to_dict() == pytest.approx(
        {"false": 1 - share, "true": share}
    )
    assert ds.atlas.select(drifts="true").sizes["point"] == round(share * small.label.size)
    lines = ds.atlas.boundary("true", "drifts"), ds.atlas.boundary("drifting")
    np.testing.assert_array_equal(lines[0].sigma, lines[1].sigma)
    xr.testing.assert_equal(
        ds.atlas.fractions("copy").drop_vars("copy").rename(copy="label"),
        ds.atlas.fractions().drop_vars("label"),
    )
    for name in ("number", "difference", "same"):
        with pytest.raises(BadInput, match=f"{name}: not a flag variable"):
            ds.atlas.fractions(name)
        assert not ds.atlas.map(name, boundary=False).legends
    figure = ds.atlas.map("drifts", boundary=False)
    assert [text.get_text() for text in figure.legends[0].get_texts()] == ["false", "true"]
    with pytest.raises(BadInput, match="label: values of type float"):
        ds.assign(label=ds["mean"]).atlas.map("label")


def test_a_map_shows_what_the_scene_is_about(files):
    _, small = files
    assert map_variable(small) == "label"
    uniform = small.assign(label=small.label.where(False, Label.DRIFTING))
    assert map_variable(uniform) == "label"
    without = uniform.drop_vars("label")
    assert map_variable(without) == "label_inertial"
    assert map_variable(without.drop_vars(["label_inertial", "geometry"])) == "stable"
    nothing = uniform[["theta_dot_rms"]]
    assert map_variable(nothing) == "theta_dot_rms"
    assert map_variable(nothing.assign(drifts=small.label == Label.DRIFTING)) == "drifts"
    scene = load_scene(small.attrs["atlas_scene"])
    text = replace(scene, map="growth_rate").toml()
    assert load_scene(text).toml() == text
    named = small.assign_attrs(atlas_scene=text)
    assert map_variable(named) == "growth_rate"
    assert map_variable(named.drop_vars("growth_rate")) == "label"
    assert named.atlas.map(boundary=False).axes[1].get_ylabel() == "growth rate (theory, rad s$^{-1}$)"


@pytest.mark.usual("memory")
def test_a_trajectory_is_that_of_the_atlas(small, files):
    _, ds = files
    coords = {"sigma": 1.35, "theta0": 1.2}
    point, tr = ds.atlas.nearest(**coords), small.atlas.trajectory(samples=501, **coords)
    assert float(tr.time[-1]) == float(point.end_time) == 30.0
    assert float(tr.theta[0]) == pytest.approx(float(point.theta0) + 1e-4)
    assert float(tr.psi[0]) == pytest.approx(np.pi / 2 + 1e-4)
    assert float(tr.theta.max()) == pytest.approx(float(point.theta_max), abs=1e-3)
    assert float(tr.theta.min()) == pytest.approx(float(point.theta_min), abs=1e-3)
    from_point = ds.atlas.select(label="drifting").atlas.trajectory(samples=501, **coords)
    for ds in (from_point, tr):
        del ds.attrs["history"], ds.attrs["date_created"]  # the time of the computation
    assert from_point.identical(tr)


def test_trajectories_of_points_without_a_scene():
    ds = atlas.label_points("satellite", {"theta0": [0.4, 0.9], "m": 0.3}, duration=[5.0, 8.0], step=0.05)
    tr = ds.atlas.trajectory(theta0=0.95)
    assert float(tr.theta[0]) == pytest.approx(0.9)
    assert float(tr.time[-1]) == 8.0
    direct = atlas.trajectory("satellite", {"theta0": 0.9, "m": 0.3}, duration=8.0, step=0.05)
    np.testing.assert_array_equal(tr.theta, direct.theta)


@pytest.mark.long
def test_families_and_maps_are_those_of_analysis_and_plotting(scene_text):
    changes = {"family": None, "nudge": None, "labels": None, "integration": {"duration": 1.0}}
    scene = load_scene(scene_text(changes | {"axes.n.values": [0.0, 0.1]}))
    ds = atlas.run(scene, progress=False)
    curves = ds.atlas.families(select={"n": 0.0})
    view = plane.Plane.of(scene, ds.sel(n=0.0), ["sigma", "theta0"])
    np.testing.assert_array_equal(
        curves["perp_velocity"][0], exact_curves.family_curves(view)["perp_velocity"][0]
    )
    assert "perp_velocity" not in ds.atlas.families(select={"n": 0.1})
    assert ds.atlas.map("theta_dot_rms", select={"n": 0.0}).axes
    with pytest.raises(BadInput, match="n has 2 values here"):
        ds.atlas.families()


@pytest.mark.long
def test_numbers_do_not_import_matplotlib(files):
    code = (
        "import sys, atlas\n"
        "with atlas.open_atlas(sys.argv[1]) as ds:\n"
        "    ds.atlas.nearest(sigma=1.0), ds.atlas.select(label='drifting'), ds.atlas.fractions()\n"
        "    ds.atlas.boundary('drifting'), ds.atlas.families(), ds.atlas.trust()\n"
        "    ds.atlas.trajectory(samples=11, sigma=1.0, theta0=0.5), ds.atlas.compare(), ds.atlas.cite()\n"
        "sys.exit('matplotlib' in sys.modules)"
    )
    done = subprocess.run([sys.executable, "-c", code, files[0]], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr


@pytest.mark.usual("memory")
def test_compare_and_cite(small):
    assert "permanent_rotation" in small.atlas.compare()
    text = small.atlas.cite()
    for words in (
        atlas.__version__,
        small.attrs["atlas_kernel_hash"],
        "10.22055/JACM.2021.37913.3113",
        "numba",
    ):
        assert words in text


def entries_of(text):
    """Fields of BibTeX entries by their keys, read by counting braces."""
    entries = {}
    for head, body in re.findall(r"^@\w+\{(\w+),\n(.*?)^\}$", text, re.M | re.S):
        fields = entries[head] = {}
        while body.strip():
            name, _, body = body.partition(" = {")
            depth, i = 1, 0
            while depth:
                depth, i = depth + {"{": 1, "}": -1}.get(body[i], 0), i + 1
            fields[name.strip()] = body[: i - 1]
            assert body[i] == ","
            body = body[i + 1 :]
    return entries


@pytest.mark.usual("memory")
def test_bibtex_of_program_paper_and_atlas(small, tmp_path):
    """With the hash of the result of a run, of points with that of their kernel; the papers are those of the bibliography."""
    finished = atlas.run(small.attrs["atlas_scene"], tmp_path / "a.nc", progress=False)
    points = atlas.label_points("fixed_point", {"theta0": [0.4]}, duration=1.0)
    bibliography = (Path(__file__).parents[1] / "docs" / "paper" / "paper.bib").read_text()
    for ds, paper, named in (
        (finished, "yehia2021", finished.attrs["atlas_result"]),
        (small, "yehia2021", small.attrs.get("atlas_result", small.attrs["atlas_kernel_hash"])),
        (points, "amer2013", points.attrs["atlas_kernel_hash"]),
    ):
        text = ds.atlas.cite(bibtex=True)
        program, own, last = entries_of(text).items()
        assert program[0] == "precession_atlas"
        assert f"version {atlas.__version__}" in program[1]["title"]
        assert own[0] == paper
        assert f"\n@article{{{paper}," in text
        assert text.split("\n\n")[1] in bibliography
        assert named in last[1]["note"].replace("\\_", "_")
        assert last[1]["year"].strip("{}") == ds.attrs["date_created"][:4]
    hostile = small.assign_attrs(title=r"50 % of {A_1 \ & $B#", creator_name="A {B")
    _, _, (_, fields) = entries_of(hostile.atlas.cite(bibtex=True)).items()
    title = r"50 \% of \textbraceleft{}A\_1 \textbackslash{} \& \$B\#"
    assert fields["title"] == f"{{{title}}}"
    citation = (Path(__file__).parents[1] / "CITATION.cff").read_text()
    assert program[1]["author"].strip("{}") in citation


def test_the_accessor_lists_its_questions(small):
    lines = repr(small.atlas).splitlines()
    public = [*(name for name in vars(Atlas) if not name.startswith("_")), *extension.parts("questions")]
    assert set(public) <= set(dir(small.atlas))
    assert [line.split()[0] for line in lines] == [f"ds.atlas.{name}()" for name in public]


def test_systems_are_described():
    assert [line.split()[0] for line in atlas.systems.describe().splitlines()][:2] == [
        "satellite",
        "fixed_point",
    ]
    text = atlas.systems.describe("satellite")
    system = atlas.systems.get("satellite")
    assert "mu is minus the dipole moment as SI counts it (the potential is + mu.H, as in the paper)" in text
    assert "roll, pitch and yaw" in text.splitlines()[0]
    first = [line.split()[0] for line in text.splitlines()[1:]]
    assert first == [*system.parameters, *families_of(system)]
