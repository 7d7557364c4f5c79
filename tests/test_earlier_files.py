"""Files that an earlier version wrote stay readable: an atlas, labelled points, a Zarr store; an unfinished run is refused.

The archive holds what c6dab44 wrote for small scenes: 30 satellites on a family, nudged (satellite.nc); three points of a
CSV file (points.nc); 18 tops with labels about any axis and chaos (fixed_point.zarr); and three of the six tiles of the first
scene (unfinished/).
"""

import json
import shutil
import tarfile
from pathlib import Path

import numpy as np
import pytest

import atlas
from atlas.cli import main
from atlas.flags import Label, Regularity

ARCHIVE = Path(__file__).parent / "reference" / "atlases_of_c6dab44.tar.gz"


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    path = tmp_path_factory.mktemp("earlier")
    with tarfile.open(ARCHIVE) as archive:
        archive.extractall(path, filter="data")
    return path


@pytest.mark.usual("points.nc", "satellite.nc")
@pytest.mark.parametrize("name", ["satellite.nc", "points.nc", "fixed_point.zarr"])
def test_an_earlier_file_is_opened_mapped_and_compared(folder, name):
    with atlas.open_atlas(folder / name) as ds:
        ds = ds.load()
    counts = {
        "satellite.nc": [0, 0, 22, 8, 0],
        "points.nc": [0, 0, 0, 3, 0],
        "fixed_point.zarr": [0, 0, 0, 18, 0],
    }
    assert np.bincount(ds.label.values.ravel(), minlength=5).tolist() == counts[name]
    assert "drifting" in ds.atlas.compare()
    assert ds.atlas.select(label="drifting").sizes["point"] == int((ds.label == Label.DRIFTING).sum())
    assert ds.atlas.map().axes
    if name == "satellite.nc":
        motion = ds.atlas.trajectory(sigma=1.14, theta0=0.2, samples=5)
        assert motion.theta[0] == pytest.approx(0.2 + 1e-4, abs=1e-15)
    if "regularity" in ds:
        assert set(np.unique(ds.regularity)) <= {Regularity.REGULAR, Regularity.UNDECIDED}


@pytest.mark.parametrize("form", ["folder", "store"])
def test_an_unfinished_run_of_an_earlier_version_is_refused_with_its_version(folder, form, tmp_path, capsys):
    """Also the part of a Zarr store, whose run was in a group of it."""
    path = tmp_path / ("run" if form == "folder" else "run.zarr")
    shutil.copytree(folder / "unfinished", path if form == "folder" else path / "atlas")
    manifest = json.loads((folder / "unfinished" / "manifest.json").read_text())
    (tmp_path / "scene.toml").write_text(manifest["scene"])
    before = sorted(path.rglob("*"))
    for command in (
        ["status", str(path)],
        ["map", str(path)],
        ["run", f"{tmp_path}/scene.toml", "-o", f"{path}/"],
        ["run", f"{tmp_path}/scene.toml", "-o", f"{path}/", "--force"],
        ["run", f"{tmp_path}/scene.toml", "-o", str(path)],
        ["join", str(path), "-o", f"{tmp_path}/a.nc"],
    ):
        assert main(command) == 2
        (line,) = capsys.readouterr().err.splitlines()
        assert "finish it with the version that began it, " in line
        assert manifest["identity"]["atlas"] in line
    assert sorted(path.rglob("*")) == before
