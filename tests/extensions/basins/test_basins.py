"""Basins as data: fractions, trust tools, maps, refinement, run folders and shards of an atlas of ends."""

from __future__ import annotations

import signal
import subprocess
import sys

import numpy as np
import pytest
import xarray as xr
from matplotlib.colors import to_hex

import atlas
from atlas.analysis.metadata import positions_as_flags
from atlas.analysis.trust import BOX
from atlas.cli import main
from atlas.extensions.basins.attitude import texts
from atlas.flags import SettledBy
from atlas.plotting import style
from atlas.runs.run import RunFolder

pytestmark = pytest.mark.usefixtures("whole_kernels")

SCENE = """
schema = 1
title = "Ends"
system = "satellite"
[fixed]
A = 1.0
B = 1.3
C = 1.6
k1 = 0.05
k2 = 0.1
k3 = 0.3
damping = 0.4
theta0 = 1.0
psi0 = 0.4
phi0 = 0.6
[axes.n]
from = -2.0
to = 2.0
count = 17
[axes.m]
from = -2.0
to = 2.0
count = 9
[ties]  # so that no kernel leaves these terms out, in any process
mu1 = "0 * A"
mu2 = "0 * A"
mu3 = "0 * A"
h1 = "0 * A"
h3 = "0 * A"
drag1 = "0 * A"
drag2 = "0 * A"
drag3 = "0 * A"
[integration]
duration = 60.0
tolerance = 1e-6
method = "rk8"
[outputs]
variables = ["label", "status", "end_equilibrium", "end_theta0", "end_psi0", "end_phi0", "end_index", "settled_by", "settling_time"]
map = "end_equilibrium"
"""

NUMBERS = ["end_theta0", "end_psi0", "end_phi0", "end_index", "settled_by", "settling_time"]
REFINED = SCENE.replace("count = 9", "count = 17") + "[refine]\nlevels = 1\nprobe = 0.2\n"
# Runs the scene into the folder of its arguments, and dies in the second tile.
KILLED = """
import os, signal, sys
import atlas
from atlas.runs import memory
evaluate = memory.evaluate
def killed(*arguments, **options):
    memory.evaluate = lambda *_, **__: os.kill(os.getpid(), signal.SIGKILL)
    return evaluate(*arguments, **options)
memory.evaluate = killed
atlas.run(*sys.argv[1:], threads=1, progress=False)
"""


@pytest.fixture(scope="module")
def scene(tmp_path_factory):
    path = tmp_path_factory.mktemp("basins") / "ends.toml"
    path.write_text(SCENE)
    return path


@pytest.fixture(scope="module")
def ds(scene):
    return atlas.run(scene, progress=False)


@pytest.mark.long
def test_fractions_over_starts(ds):
    """With the interval of Wilson, over all axes or some; the coordinate is the position, -1 of those that are not settled."""
    whole = ds.atlas.basin_fractions()
    np.testing.assert_array_equal(whole["end_equilibrium"], [-1, 0, 1])
    counts = [(ds["end_equilibrium"] == i).sum().item() for i in (-1, 0, 1)]
    np.testing.assert_allclose(whole["fraction"], np.array(counts) / 153)
    assert counts[0] == 0
    p, n, z = counts[1] / 153, 153, 1.959963984540054
    half = z * np.sqrt(p * (1 - p) / n + z**2 / (4 * n**2)) / (1 + z**2 / n)
    middle = (p + z**2 / (2 * n)) / (1 + z**2 / n)
    limits = whole.sel(end_equilibrium=0)
    np.testing.assert_allclose([limits["lower"], limits["upper"]], [middle - half, middle + half])
    along = ds.atlas.basin_fractions("n")
    assert dict(along.sizes) == {"m": 9, "end_equilibrium": 3}
    np.testing.assert_allclose(along["fraction"].sum("end_equilibrium"), 1.0)
    np.testing.assert_allclose(along["fraction"].mean("m"), whole["fraction"])


@pytest.mark.long
def test_undecided_starts_are_counted(ds):
    """Of which the atlas of any end holds the flag, asked for or not."""
    own = ds["settled_by"]
    undecided = own.where(ds["n"] <= 1.5, SettledBy.UNDECIDED).astype(np.int8).assign_attrs(own.attrs)
    some = ds.assign(settled_by=undecided, end_equilibrium=ds["end_equilibrium"].where(undecided != 3, -1))
    np.testing.assert_allclose(some.atlas.basin_fractions("n")["undecided"], 2 / 17)
    assert some.atlas.basin_fractions()["undecided"].item() == pytest.approx(2 / 17)
    assert texts(some)["not_settled"] == "not settled (12 % undecided)"
    assert "not_settled" not in texts(ds)
    (legend,) = some.atlas.map().legends
    assert legend.get_texts()[0].get_text() == texts(some)["not_settled"]
    old = ds["settled_by"].assign_attrs(
        flag_values=np.arange(3, dtype=np.int8), flag_meanings="not proved measured"
    )
    assert np.isnan(ds.assign(settled_by=old).atlas.basin_fractions()["undecided"])
    with pytest.raises(atlas.BadInput, match=r"^settled_by: not in this atlas[^\n]*$"):
        ds.drop_vars("settled_by").atlas.basin_fractions()
    alone = atlas.label_points("satellite", {"damping": 0.4}, duration=1.0, variables=["end_theta0"])
    assert [*alone.data_vars] == ["end_theta0", "settled_by"]
    assert alone["settled_by"].attrs["flag_meanings"] == "not proved measured undecided"


def test_tools_of_flags_take_positions(ds):
    end = ds["end_equilibrium"].values
    chosen = ds.atlas.select(end_equilibrium=[1])
    assert chosen.sizes["point"] == (end == 1).sum()
    assert ds.atlas.select(end_equilibrium="equilibrium_0").sizes["point"] == (end == 0).sum()
    with pytest.raises(atlas.BadInput, match="their numbers -1 to 1"):
        ds.atlas.select(end_equilibrium=2)
    assert ds.atlas.boundary(0, "end_equilibrium").sizes["vertex"] > 4
    trust = ds.atlas.trust("end_equilibrium")
    order = ds["end_equilibrium"].transpose("n", "m").values
    cells = [order[i : i + 2, j : j + 2] for i in range(16) for j in range(8)]
    np.testing.assert_allclose(trust["uncertain"][0], np.mean([np.unique(cell).size > 1 for cell in cells]))
    boxes = [order[i : i + BOX, j : j + BOX] for i in range(0, 16, BOX) for j in range(0, 8, BOX)]
    shares = np.array([np.mean(box == 0) for box in boxes])
    inside = shares[(shares > 0) & (shares < 1)]
    entropy = -(inside * np.log(inside) + (1 - inside) * np.log(1 - inside))
    np.testing.assert_allclose(trust["entropy"], entropy.sum() / 8)
    np.testing.assert_allclose(trust["border_entropy"], entropy.mean())


@pytest.mark.long
def test_a_map_names_the_attitudes(ds):
    equilibria = atlas.equilibria(
        "satellite", {name: float(ds[name]) for name in ("A", "B", "C", "k1", "k2", "k3")}
    )
    (legend,) = ds.atlas.map().legends
    shown = [text.get_text() for text in legend.get_texts()]
    assert shown == list(texts(ds).values())
    assert list(texts(ds)) == ["equilibrium_0", "equilibrium_1"]
    for i, text in enumerate(shown):
        alpha, gamma = (equilibria[name][i].values for name in ("alpha", "gamma"))
        beta, senses = np.cross(gamma, alpha), []
        for axis in (2, 0):  # nearest to one of the directions of the frame
            components = np.array([alpha[axis], beta[axis], gamma[axis]])
            nearest = np.abs(components).argmax()
            degrees = round(np.degrees(np.arccos(abs(components[nearest]))))
            sense = "+" if components[nearest] > 0 else "\N{MINUS SIGN}"
            senses.append((f"{sense}{['radius', 'velocity', 'normal'][nearest]}", degrees))
        (third, degrees), (first, _) = senses
        assert degrees > 0
        assert text == f"{i}: axis 3 {third}, {degrees} deg, 1 {first}"
    colours = style.flag_colours(["not_settled", "equilibrium_0", "equilibrium_1"])
    assert [to_hex(each.get_facecolor()) for each in legend.legend_handles] == list(colours.values())[1:]
    assert positions_as_flags(ds, "label") is ds


def test_the_first_axis_tells_attitudes_apart_that_the_third_does_not(ds):
    angles = {"theta0": [0.0, 0.0, np.pi], "psi0": [0.0, np.pi, 0.0], "phi0": [0.0] * 3}
    ends = xr.Dataset({"end_equilibrium": ("point", [0, 1, 2])}, attrs=ds.attrs)
    ends = ends.assign({f"end_{name}": ("point", values) for name, values in angles.items()})
    assert list(texts(ends).values()) == [
        "0: axis 3 +normal, 1 +radius",
        "1: axis 3 +normal, 1 \N{MINUS SIGN}radius",
        "2: axis 3 \N{MINUS SIGN}normal",
    ]
    assert texts(ends.assign(end_equilibrium=("point", [0, 0, 2]))).keys() == {"equilibrium_2"}


@pytest.mark.long
def test_run_folders_shards_and_refinement_give_the_same_ends(ds, scene, tmp_path, monkeypatch):
    """In memory, in tiles that two shards share, and in a refined run that was killed and goes on with workers of dask."""
    monkeypatch.setenv("ATLAS_TILE_POINTS", "40")
    for shard in ("1/2", "2/2"):
        assert main(["run", str(scene), "-o", f"{tmp_path}/run/", "--shard", shard]) == 0
    with atlas.open_atlas(tmp_path / "run") as joined:
        xr.testing.assert_equal(joined[[*ds.data_vars]].load(), ds[[*ds.data_vars]])
    assert RunFolder.open(tmp_path / "run").tiling.count > 2
    monkeypatch.undo()
    refined = tmp_path / "refined.toml"
    refined.write_text(REFINED)
    fine = atlas.run(refined, progress=False)
    assert fine["end_equilibrium"].dtype == np.int16
    computed = fine["computed"] == 1
    assert not computed.all()
    coarse = fine.sel(m=ds["m"].values, n=ds["n"].values, method="nearest")
    assert (coarse["end_equilibrium"].values == ds["end_equilibrium"].values).mean() > 0.97
    undecided = fine["settled_by"] == SettledBy.UNDECIDED  # next to a border
    assert (undecided | (fine["settled_by"] == SettledBy.PROVED)).all()
    assert 0 < undecided.mean() < 0.02, float(undecided.mean())
    assert (fine["end_index"] == xr.where(undecided, -1, 0)).all()
    out = f"{tmp_path}/fine/"
    process = subprocess.run([sys.executable, "-c", KILLED, refined, out], check=False)
    assert process.returncode == -signal.SIGKILL
    written = [len(level.tiles.written()) for level in RunFolder.open(tmp_path / "fine").levels()]
    assert written == [1, 0]
    assert main(["run", str(refined), "-o", out, "--workers", "1", "--quiet"]) == 0
    with atlas.open_atlas(out) as resumed:
        xr.testing.assert_equal(resumed[[*fine.data_vars]].load(), fine[[*fine.data_vars]])


def test_lazy_points_give_the_same_ends():
    rng = np.random.default_rng(2)
    rest = dict.fromkeys(("theta0", "phi0", "theta_dot0"), 0.0)
    points = {"A": 1.0, "B": 1.3, "C": 1.6, "k1": 0.05, "k2": 0.1, "k3": 0.3, "damping": 0.4} | rest
    points |= {name: xr.DataArray(rng.uniform(-2, 2, size), dims=name) for name, size in (("n", 6), ("m", 4))}
    points["psi0"] = xr.DataArray([0.4, 2.0, -1.0], dims="psi0")
    options = {"duration": 60.0, "method": "rk8", "variables": ["status", "end_equilibrium", *NUMBERS]}
    eager = atlas.label_points("satellite", points, **options)
    lazy = atlas.label_points("satellite", points | {"n": points["n"].chunk(n=2)}, **options)
    assert lazy["end_equilibrium"].chunks is not None
    xr.testing.assert_equal(lazy.compute(scheduler="threads"), eager)
    assert np.isfinite(eager["settling_time"]).any()


def test_points_without_a_body_have_no_end():
    points = {
        "A": [1.0, 1.0],
        "B": 1.3,
        "C": [1.6, 9.0],
        "k1": 0.05,
        "k2": 0.1,
        "k3": 0.3,
        "damping": 0.4,
        "n": 0.5,
    }
    names = ["status", "end_equilibrium", "end_theta0", "end_index", "settled_by", "settling_time"]
    ds = atlas.label_points("satellite", points, duration=60.0, method="rk8", variables=names)
    np.testing.assert_array_equal(ds["end_equilibrium"], [ds["end_equilibrium"][0], -1])
    np.testing.assert_array_equal(ds["end_index"], [0, -1])
    np.testing.assert_array_equal(np.isnan(ds["end_theta0"]), [False, True])


@pytest.mark.long
def test_without_the_extension_its_names_are_refused_and_other_numbers_are_equal(
    without_extension, scene_text, ds
):
    scene = scene_text({})
    whole = atlas.run(atlas.load_scene(scene), progress=False)
    without_extension("basins")
    assert "basin_fractions" not in dir(ds.atlas)
    with pytest.raises(AttributeError, match="no attribute 'basin_fractions'"):
        ds.atlas.basin_fractions()
    with pytest.raises(atlas.BadInput, match="end_equilibrium: not a flag variable"):
        ds.atlas.fractions("end_equilibrium")
    for name in ("end_equilibrium", "settling_time"):
        with pytest.raises(atlas.BadInput, match=f"^outputs.variables: '{name}' is unknown; [^\n]*$"):
            atlas.load_scene(scene_text({"outputs.variables": ["label", name]}))
    alone = atlas.run(atlas.load_scene(scene), progress=False)
    xr.testing.assert_equal(alone[[*whole.data_vars]], whole[[*whole.data_vars]])
