"""Tables, dry runs and texts of commands hold the numbers of the dataset, of the run itself, or of own arithmetic."""

import re
import resource
import sys
import time

import numpy as np
import pytest
import xarray as xr

import atlas
from atlas import load_scene
from atlas.analysis.metadata import flag_names
from atlas.analysis.summary import summary
from atlas.cli import main
from atlas.plotting import style
from atlas.runs import estimate
from atlas.runs.status import status
from atlas.store.progress import clock

pytestmark = pytest.mark.usefixtures("whole_kernels")


@pytest.fixture(scope="module")
def small(small_scene):
    return atlas.run(load_scene(small_scene), progress=False).load()


@pytest.fixture
def here(tmp_path, monkeypatch, small_scene):
    """A folder with the small scene, in which commands are called."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "small.toml").write_text(small_scene)
    return tmp_path


def columns(path) -> dict[str, list[str]]:
    """Columns of a CSV file by their names."""
    names, *rows = (line.split(",") for line in path.read_text().splitlines())
    return dict(zip(names, zip(*rows, strict=True), strict=True))


def test_a_table_of_points_has_their_values(here):
    """Each column by its name: numbers with all digits, flags as words, nan where there is none."""
    (here / "in.csv").write_text("id,k1,theta0\na,0.1,0.5\nb,1e200,0.5\nc,0.3,1.2\n")
    assert main(["points", "satellite", "in.csv", "-o", "out.csv", "--duration", "5", "--quiet"]) == 0
    points = {"k1": [0.1, 1e200, 0.3], "theta0": [0.5, 0.5, 1.2]}
    expected, table = atlas.label_points("satellite", points, duration=5.0), columns(here / "out.csv")
    assert table.pop("id") == ("a", "b", "c")
    assert set(table) == {*expected.data_vars, *expected.coords} - {"point"}
    assert np.isnan(expected.theta_dot_rms[1])
    for name, texts in table.items():
        array = expected[name]
        if flags := flag_names(array):
            assert list(texts) == [flags[value] for value in array.values], name
        else:
            np.testing.assert_array_equal([float(text) for text in texts], np.broadcast_to(array, 3), name)
            assert ("nan" in texts) == bool(np.isnan(array).any())


@pytest.mark.long
def test_a_frame_has_the_values_in_rad_or_degrees(small):
    angles = {"theta_min", "theta_max", "psi0", "phi0"}
    for degrees in (False, True):
        frame = small.atlas.to_dataframe(degrees=degrees)
        for name in frame.columns:
            size = 180 / np.pi if degrees and small[name].attrs.get("units") == "rad" else 1.0
            assert (size != 1) == (degrees and name in angles), name
            expected = small[name].broadcast_like(small.label).values.ravel()
            if flags := flag_names(small[name]):
                assert frame[name].tolist() == [flags[value] for value in expected]
            else:
                np.testing.assert_allclose(frame[name], expected * size, rtol=1e-15)
        theta0 = frame.index.get_level_values("theta0")
        np.testing.assert_allclose(theta0[:7], small.theta0 * (180 / np.pi if degrees else 1))


def number(pattern: str, text: str) -> float:
    """The number in brackets of a pattern that occurs once in a text."""
    (found,) = re.findall(pattern, text)
    return float(found)


NUMBER = r"([\d.]+(?:e[+-]?\d+)?)"


@pytest.fixture
def few_steps(monkeypatch):
    """Measure a tenth of the steps that a dry run takes."""
    monkeypatch.setattr(estimate, "CALIBRATION_STEPS", estimate.CALIBRATION_STEPS / 10)
    monkeypatch.setattr(estimate, "LABEL_STEPS", estimate.LABEL_STEPS / 10)


@pytest.mark.long
@pytest.mark.usefixtures("few_steps")
def test_a_dry_run_tells_what_the_run_takes(scene_text, tmp_path):
    """Points, steps, processor time, bytes and memory, each within a factor that the load of a machine leaves."""
    scene = load_scene(
        scene_text({"axes.sigma.count": 50, "axes.theta0.count": 40, "integration.duration": 15.0})
    )
    text = estimate.dry_run(scene, "scene.nc", threads=1)
    most = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * (1 if sys.platform == "darwin" else 1024)
    folder = tmp_path / "run"
    atlas.run(scene, f"{folder}/", progress=False, threads=1).close()  # also what is done once in a process
    began = time.process_time()
    ds = atlas.run(scene, progress=False, threads=1)
    seconds = time.process_time() - began
    atlas.run(scene, tmp_path / "scene.nc", progress=False, threads=1).close()
    stored = (tmp_path / "scene.nc").stat().st_size
    numbers = 2000 * sum(
        array.dtype.itemsize for array in [*ds.data_vars.values(), ds.k3]
    )  # as tiles hold them until they are joined
    steps = float((ds.end_time / ds.step).mean())
    assert text.startswith("2000 points, about 2000 to integrate, ")
    assert number(rf"\({NUMBER} steps a point", text) == pytest.approx(steps, rel=2e-3)
    hours = number(rf"processor time: {NUMBER} h by rk4", text)
    assert 1 / 5 < 3600 * hours / seconds < 5
    nanoseconds = number(rf"{NUMBER} ns a step and processor", text)
    assert 3600 * hours == pytest.approx(2000 * steps * nanoseconds * 1e-9, rel=0.35)
    assert 1e6 * number(rf"file: about {NUMBER} MB", text) == pytest.approx(stored, rel=0.2)
    assert 1e6 * number(rf"run folder: \d+ files, about {NUMBER} MB", text) == pytest.approx(
        numbers, rel=0.05
    )
    assert 0.5 * most < 1e6 * number(rf"memory: about {NUMBER} MB", text) < 1.2 * most
    assert 1e-6 < number(rf"fastest frequency: at most {NUMBER} rad", text) <= 1e-5  # the tolerance
    other = number(rf"h by rk4, {NUMBER} h by rk8", text)
    assert other / hours == pytest.approx(number(rf"in about {NUMBER} of the time", text), rel=0.02)


@pytest.mark.long
@pytest.mark.usefixtures("few_steps")
def test_processes_share_the_time_and_add_their_memory(scene_text):
    """By rk4 the phase error of a run is as T h^4: at the same tolerance a hundred times the duration takes 100^(5/4) times the steps."""
    one = estimate.dry_run(
        load_scene(scene_text({"axes.sigma.count": 90, "axes.theta0.count": 70})), workers=1
    )
    more = {"axes.sigma.count": 900, "axes.theta0.count": 70, "integration.duration": 3000.0}
    three = estimate.dry_run(load_scene(scene_text(more)), workers=3)
    assert three.startswith("63000 points, about 63000 to integrate, ")
    few, many = (number(rf"\({NUMBER} steps a point", text) for text in (one, three))
    assert many / few == pytest.approx(100**1.25, rel=0.02)
    hours = number(rf"processor time: {NUMBER} h by rk4", three)
    nanoseconds = number(rf"{NUMBER} ns a step and processor", three)
    assert 3600 * hours == pytest.approx(63000 * many * nanoseconds * 1e-9, rel=0.35)
    parts = re.search(r"time: about ([\d:]+) on 3 processes", three)[1].split(":")
    elapsed = sum(60**k * int(part) for k, part in enumerate(reversed(parts)))
    assert elapsed == pytest.approx(3600 * hours / 3, rel=0.02, abs=1)
    memory = [number(rf"memory: about {NUMBER} MB", text) for text in (one, three)]
    assert 2 < memory[1] / memory[0] < 5


@pytest.mark.usefixtures("few_steps")
def test_a_dry_run_of_few_points_counts_what_every_file_has(scene_text, tmp_path):
    """Attributes and tables of a file are more than the values of ten points."""
    scene = load_scene(scene_text({"axes.sigma.count": 5, "axes.theta0.count": 2}))
    for name in ("small.nc", "small/"):
        text = estimate.dry_run(scene, name, threads=1)
        atlas.run(scene, f"{tmp_path}/{name}", progress=False, threads=1).close()
        place, what = tmp_path / name, "run folder: 4 files," if name == "small/" else "file:"
        files = [place] if place.is_file() else [each for each in place.rglob("*") if each.is_file()]
        bytes_written = sum(file.stat().st_size for file in files)
        assert 1e6 * number(rf"{what} about {NUMBER} MB", text) == pytest.approx(bytes_written, rel=0.25)


@pytest.mark.usefixtures("few_steps")
@pytest.mark.parametrize(("jobs", "processors"), [(7, 1), (50, 16), (1000, 4)])
def test_a_dry_run_prices_the_job_with_most_tiles(here, capsys, monkeypatch, scene_text, jobs, processors):
    """Tiles are dealt to the jobs one by one; the limits for the queue are twice the cost, and five minutes for the start."""
    monkeypatch.setenv("ATLAS_TILE_POINTS", "512")
    long = {"axes.sigma.count": 400, "axes.theta0.count": 400, "integration.duration": 20_000.0}
    (here / "s.toml").write_text(scene_text(long))
    assert main(["run", "s.toml", "--dry-run", "--threads", "1", "--jobs", f"{jobs}x{processors}"]) == 0
    text = capsys.readouterr().out
    tiles = int(number(r"to integrate, (\d+) tiles", text))
    most = len(range(0, tiles, jobs))
    line = rf"{jobs} jobs of {processors} processors: at most {most} of {tiles} tiles each, about {NUMBER} h and {NUMBER} MB a job"
    hours, memory = (float(each) for each in re.search(line, text).groups())
    total = number(rf"processor time: {NUMBER} h by rk4", text)
    assert hours == pytest.approx(total * most / tiles / processors, rel=0.02)
    alone = number(rf"memory: about {NUMBER} MB", text)
    assert (memory == alone) if processors == 1 else (memory >= alone)
    array, each, limit, most_memory = text.splitlines()[-4:]
    assert (array, each) == (f"#SBATCH --array=1-{jobs}", f"#SBATCH --cpus-per-task={processors}")
    parts = [int(part) for part in re.fullmatch(r"#SBATCH --time=(\d+):(\d\d):00", limit).groups()]
    assert 60 * parts[0] + parts[1] == pytest.approx(120 * hours + 5, rel=0.01, abs=1.01)
    assert number(r"--mem=(\d+)M", most_memory) == pytest.approx(2 * memory, abs=1)


def test_times_are_hours_minutes_and_seconds():
    assert [clock(t) for t in (0.4, 61.0, 3599.0, 3600.0, 90061.0)] == [
        "0:00",
        "1:01",
        "59:59",
        "1:00:00",
        "25:01:01",
    ]


def test_the_summary_counts_what_the_atlas_has(small):
    ds = small.copy(deep=True)
    ds["agreement"][1, 1:3] = 0
    ds["status"][0, :3] = flag_names(ds.status).index("step_sensitive")
    ds["error_estimate"][:] = np.where(ds.label == 3, 0.5, 1e-4)
    ds["error_estimate"][2, 3] = 0.0625 if ds.label[2, 3] != 3 else 0.75
    lines = summary(ds, verbose=True).splitlines()
    for name in ("label", "label_inertial", "status", "agreement"):
        names, values = flag_names(ds[name]), ds[name].values
        counts = [f"{flag} {(values == i).sum()}" for i, flag in enumerate(names) if (values == i).any()]
        assert f"{name}: {', '.join(counts)}" in lines
    (line,) = (line for line in lines if line.startswith("expected relative error"))
    assert "at steady points 1e-04 (median) to 0.062 (largest), at drifting points " in line
    assert "to 0.5 (largest)" in line
    drift = float(ds.integral_drift.max())
    assert f"largest relative change of a first integral (integral_drift): {drift:.2g}" in lines
    seconds, speed = ds.attrs["atlas_seconds"], ds.attrs["atlas_points_per_second"]
    assert f"{seconds:.1f} s, {speed:.4g} points/s" in lines
    assert speed == pytest.approx(63 / seconds, rel=1e-6)
    short = summary(ds, verbose=False).splitlines()
    compared, agree = int((ds.agreement > 0).sum()), int((ds.agreement == 1).sum())
    assert f"theory: {100 * agree / compared:.2f} % of {compared} compared points agree" in short
    assert compared == 61
    assert "in doubt: step_sensitive 3" in short


def test_a_comparison_with_theory_counts_the_pairs_of_labels(small):
    lines = small.atlas.compare(worst=3).splitlines()
    head, *rows = (line.split() for line in lines[:3])
    names = flag_names(small.label)
    for theory, *counts in rows:
        for measured, count in zip(head[3:], counts, strict=True):
            pair = (small.predicted == names.index(theory)) & (small.label == names.index(measured))
            assert int(count) == int(pair.sum())
    wrong = small.predicted != small.label
    share = 100 * (1 - float(wrong.mean()))
    assert lines[3] == f"compared: 63 of 63 points, {share:.3f} % agree"
    place = r"sigma = (\S+), theta0 = (\S+): theory (\w+), measured (\w+), unsteadiness (\S+), growth_rate x time = (\S+)"
    for line in lines[-3:]:
        sigma, theta0, theory, measured, unsteady, growth = re.search(place, line).groups()
        point = small.sel(sigma=float(sigma), theta0=float(theta0), method="nearest")
        assert (theory, measured) == tuple(names[int(point[name])] for name in ("predicted", "label"))
        rates = ("theta_dot_rms", "psi_dot_std", "phi_dot_std", "normal_rate_std")
        assert float(unsteady) == pytest.approx(max(float(point[name]) for name in rates), rel=5e-3)
        assert float(growth) == pytest.approx(float(point.growth_rate * point.end_time), abs=5e-3)


@pytest.mark.long
def test_status_counts_the_tiles_and_points_of_a_folder(here, monkeypatch, scene_text):
    (here / "s.toml").write_text(
        scene_text({"axes.sigma.count": 18, "axes.theta0.count": 48, "integration.duration": 2.0})
    )
    monkeypatch.setenv("ATLAS_TILE_POINTS", "64")
    assert main(["run", "s.toml", "-o", "r/", "--shard", "1/3", "--quiet"]) == 0
    tiles = list((here / "r" / "tiles").glob("*.tile"))
    with atlas.open_atlas("r") as ds:
        left = int((ds.label == 0).sum())
    first, counts, *_, last = status("r").splitlines()
    whole = re.fullmatch(r"small: 864 points in (\d+) tiles of at most (\d+)", first)
    assert int(whole[1]) * int(whole[2]) >= 864 > (int(whole[1]) - 1) * int(whole[2])
    assert counts == f"tiles: done {len(tiles)}, missing {int(whole[1]) - len(tiles)}"
    assert 0 < left < 864
    assert last.startswith(f"{left} points left, no process is at work; ")
    assert main(["run", "s.toml", "-o", "s.nc", "--quiet"]) == 0
    assert status("s.nc") == "small: finished atlas, sigma 18 x theta0 48"


def test_a_caption_has_the_axes_settings_and_versions_of_the_atlas(small):
    text = style.caption(small)
    for part in (
        "Axes: sigma from 0.3 to 1.7 (9 values), theta0 from 0.2 to 1.4 (7 values).",
        "Starts displaced from there: theta0 by 0.0001, psi0 by 0.0001.",
        "Duration 30 time units.",
        "Integrated by rk4, phase tolerance 1e-05 rad; rates count as constant within 0.001 rad per time unit, the third axis as"
        " vertical within 0.001 rad.",
    ):
        assert part in text
    printed = re.search(r"Parameters: (.*); the others have their defaults", text)[1]
    given = dict(part.split(" = ") for part in printed.split(", "))
    assert given == {"A": "1", "Omega": "1", "m": "0.5", "B": "A", "C": "sigma * A", "psi0": "pi / 2"}


def test_commands_say_what_they_made(here, capsys):
    assert main(["trajectory", "small.toml", "--at", "sigma=0.5", "theta0=0.7", "-o", "t.nc"]) == 0
    said = capsys.readouterr().out
    with xr.open_dataset("t.nc") as tr:
        low, high, end = float(tr.theta.min()), float(tr.theta.max()), float(tr.time[-1])
    assert said == f"theta from {low:.9g} to {high:.9g} rad in {end:.9g} time units; wrote t.nc\n"
    assert end == 30
    assert main(["check", "small.toml"]) == 0
    said = capsys.readouterr().out
    assert "system satellite: sigma 9 x theta0 7 = 63 points, duration 30\n" in said
