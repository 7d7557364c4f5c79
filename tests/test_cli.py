"""The command line as a user meets it: real processes, exit codes, one line of complaint, nothing lost."""

import os
import signal
import subprocess
import sys
import time

import pytest
import xarray as xr

from atlas.cli import main, parser


def shell(*arguments, cwd, **more):
    return subprocess.run(
        [sys.executable, "-m", "atlas", *map(str, arguments)], cwd=cwd, capture_output=True, text=True, check=False, **more
    )  # fmt: skip


@pytest.fixture
def folder(tmp_path, small_scene):
    (tmp_path / "small.toml").write_text(small_scene)
    return tmp_path


def test_run_compare_and_the_files_they_leave(folder):
    done = shell("run", "small.toml", cwd=folder)
    assert done.returncode == 0, done.stderr
    assert "wrote small.nc" in done.stdout
    assert "label:" in done.stdout
    assert "points/s" in done.stdout
    assert sorted(p.name for p in folder.iterdir()) == ["small.nc", "small.toml"]
    done = shell("compare", "small.nc", cwd=folder)
    assert done.returncode == 0
    assert "theory \\ measured" in done.stdout


def test_map_writes_png_and_pdf(folder):
    assert shell("run", "small.toml", cwd=folder).returncode == 0
    done = shell("map", "small.nc", cwd=folder)
    assert done.returncode == 0, done.stderr
    assert (folder / "small.png").read_bytes().startswith(b"\x89PNG")
    assert (folder / "small.pdf").read_bytes().startswith(b"%PDF")
    done = shell("map", "small.nc", cwd=folder)
    assert done.returncode == 2
    assert "--force" in done.stderr


@pytest.mark.parametrize(
    ("arguments", "named"),
    [
        (["run", "none.toml"], "none.toml"),
        (["run", "small.toml", "-o", "no/folder/a.nc"], "no/folder"),
        (["run", "small.toml", "-o", "a.txt"], ".nc"),
        (["run", "small.toml", "--threads", "0"], "--threads"),
        (["run", "small.toml", "-o", "r/", "--shard", "0/4"], "--shard 0/4"),
        (["run", "small.toml", "-o", "r/", "--shard", "5/4"], "--shard 5/4"),
        (["run", "small.toml", "-o", "a.nc", "--shard", "1/4"], "run folder"),
        (["run", "small.toml", "-o", "r/", "--scheduler", "tcp://127.0.0.1:9"], "no scheduler answers"),
        (["run", "small.toml", "-o", "r/", "--scheduler", "banana"], "no scheduler answers"),
        (["run", "small.toml", "-o", "r/", "--workers", "0"], "--workers"),
        (["status", "."], "not a run folder"),
        (["join", "none", "-o", "a.nc"], "not a run folder"),
        (["run", "small.toml", "--colour", "red"], "--colour"),
        (["run"], "SCENE"),
        (["check", "bad.toml"], "count"),
        (["compare", "small.toml"], "not a NetCDF file"),
        (["map", "none.nc"], "none.nc"),
        (["conditions", "sputnik"], "sputnik"),
        (["conditions", "satellite", "--family", "banana"], "banana"),
        (["fly"], "fly"),
        ([], "COMMAND"),
    ],
)
def test_bad_input_is_one_line_and_exit_2(folder, monkeypatch, capsys, arguments, named):
    monkeypatch.chdir(folder)
    (folder / "bad.toml").write_text((folder / "small.toml").read_text().replace("count = 9", "count = -9"))
    before = sorted(p.name for p in folder.iterdir())
    try:
        code = main(arguments)
    except SystemExit as left:
        code = left.code
    complaint = capsys.readouterr().err
    assert code == 2
    assert len(complaint.strip().splitlines()) == 1
    assert named in complaint
    assert sorted(p.name for p in folder.iterdir()) == before


def test_ctrl_c_leaves_no_half_file_and_exits_130(folder, small_scene):
    long = small_scene.replace("count = 9", "count = 900").replace("count = 7", "count = 700")
    (folder / "long.toml").write_text(long.replace("tolerance = 1e-5", "tolerance = 1e-9"))
    assert shell("run", "small.toml", cwd=folder).returncode == 0  # the kernel is warm now
    process = subprocess.Popen(
        [sys.executable, "-m", "atlas", "run", "long.toml"], cwd=folder, stderr=subprocess.PIPE, text=True,
        start_new_session=True,
    )  # fmt: skip
    time.sleep(4)
    assert process.poll() is None
    os.killpg(process.pid, signal.SIGINT)
    _, complaint = process.communicate(timeout=30)
    assert process.returncode == 130
    assert "interrupted" in complaint
    assert "Traceback" not in complaint
    assert not (folder / "long.nc").exists()
    assert not list(folder.rglob("*.tmp"))


def test_help_of_every_command_is_real(capsys):
    top = parser()
    for name in (
        "run",
        "check",
        "compare",
        "map",
        "trajectory",
        "accuracy",
        "stress",
        "points",
        "figures",
        "status",
        "join",
        "conditions",
        "cache",
    ):
        with pytest.raises(SystemExit) as left:
            top.parse_args([name, "--help"])
        assert left.value.code == 0
        assert name in capsys.readouterr().out


def test_conditions_and_version_and_cache(capsys, tmp_path, monkeypatch):
    assert main(["conditions", "satellite"]) == 0
    assert "perp_velocity" in capsys.readouterr().out
    assert main(["conditions", "satellite", "--family", "cylindrical"]) == 0
    assert "A = B" in capsys.readouterr().out
    monkeypatch.setenv("ATLAS_CACHE", str(tmp_path))
    assert main(["cache"]) == 0
    assert main(["cache", "--clear"]) == 0
    assert "removed 0" in capsys.readouterr().out


def test_trajectory_of_a_point_of_a_scene(folder, monkeypatch, capsys):
    monkeypatch.chdir(folder)
    assert main(["trajectory", "small.toml", "--at", "sigma=0.5", "theta0=0.7"]) == 0
    assert "theta from" in capsys.readouterr().out
    assert (folder / "small_trajectory.png").read_bytes().startswith(b"\x89PNG")
    assert main(["trajectory", "small.toml", "--at", "sigma=0.5", "theta0=0.7", "-o", "a.nc"]) == 0
    with xr.open_dataset(folder / "a.nc") as tr:
        assert float(tr.theta[0]) == pytest.approx(0.7001)
    for bad in (["sigma=0.5"], ["sigma=0.5", "theta0=0.7", "k3=1"], ["sigma=half", "theta0=0.7"]):
        assert main(["trajectory", "small.toml", "--at", *bad, "-o", "b.nc"]) == 2
        assert len(capsys.readouterr().err.splitlines()) == 1
    assert not (folder / "b.nc").exists()
