"""Files that an earlier version wrote stay readable: an atlas, labelled points, a Zarr store, a run folder.

The archive holds what c6dab44 wrote for small scenes: 30 satellites on a family, nudged (satellite.nc); three points of a
CSV file (points.nc); 18 tops with labels about any axis and chaos (fixed_point.zarr); and three of the six tiles of the first
scene (unfinished/).
"""

import tarfile
from pathlib import Path

import numpy as np
import pytest

import atlas
from atlas import BadInput, load_scene
from atlas.cli import main
from atlas.flags import Label, Regularity

ARCHIVE = Path(__file__).parent / "reference" / "atlases_of_c6dab44.tar.gz"


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    path = tmp_path_factory.mktemp("earlier")
    with tarfile.open(ARCHIVE) as archive:
        archive.extractall(path, filter="data")
    return path


@pytest.mark.parametrize("name", ["satellite.nc", "points.nc", "fixed_point.zarr", "unfinished"])
def test_an_earlier_file_is_opened_mapped_and_compared(folder, name):
    with atlas.open_atlas(folder / name) as ds:
        ds = ds.load()
    counts = {
        "satellite.nc": [0, 0, 22, 8, 0],
        "points.nc": [0, 0, 0, 3, 0],
        "fixed_point.zarr": [0, 0, 0, 18, 0],
    }
    counts["unfinished"] = [15, 0, 13, 2, 0]
    assert np.bincount(ds.label.values.ravel(), minlength=5).tolist() == counts[name]
    assert "drifting" in ds.atlas.compare()
    assert ds.atlas.select(label="drifting").sizes["point"] == int((ds.label == Label.DRIFTING).sum())
    assert ds.atlas.map().axes
    if name == "satellite.nc":
        motion = ds.atlas.trajectory(sigma=1.14, theta0=0.2, samples=5)
        assert motion.theta[0] == pytest.approx(0.2 + 1e-4, abs=1e-15)
    if "regularity" in ds:
        assert set(np.unique(ds.regularity)) <= {Regularity.REGULAR, Regularity.UNDECIDED}


def test_an_unfinished_run_of_an_earlier_version_is_not_continued(folder, capsys):
    scene = load_scene(atlas.open_atlas(folder / "unfinished").attrs["atlas_scene"])
    before = sorted(path.name for path in (folder / "unfinished").rglob("*"))
    with pytest.raises(
        BadInput, match="holds another run; choose another name, or force=True replaces it"
    ) as error:
        atlas.run(scene, folder / "unfinished", progress=False)
    assert "\n" not in str(error.value)
    assert sorted(path.name for path in (folder / "unfinished").rglob("*")) == before
    assert main(["status", str(folder / "unfinished")]) == 0
    assert "done 3, damaged 0, missing 3" in capsys.readouterr().out
