"""The command line as a user meets it: real processes, exit codes, one-line errors, no file left half written."""

import os
import re
import signal
import subprocess
import sys
import time

import matplotlib.image
import pytest
import xarray as xr

from atlas.cli import main, parser


def shell(*arguments, cwd, **more):
    """Run the command in a process of its own."""
    return subprocess.run(
        [sys.executable, "-m", "atlas", *map(str, arguments)], cwd=cwd, capture_output=True, text=True, check=False, **more
    )  # fmt: skip


@pytest.fixture
def folder(tmp_path, small_scene):
    """A folder with the small scene in small.toml."""
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


def test_map_takes_the_choices_of_a_paper(folder):
    assert shell("run", "small.toml", cwd=folder).returncode == 0
    options = (
        "--title Survival --colors drifting=red permanent_rotation=#0000ff --labels drifting=falls --dpi 100"
    )
    done = shell("map", "small.nc", *options.split(), "--size", "100x80", "-o", "a.png", cwd=folder)
    assert done.returncode == 0, done.stderr
    picture = matplotlib.image.imread(folder / "a.png")
    assert picture.shape[1] == pytest.approx(100 / 25.4 * 100, abs=1)
    colours = {tuple(colour) for colour in picture[:, :, :3].reshape(-1, 3)}
    assert {(1, 0, 0), (0, 0, 1)} <= colours
    for wrong, named in (
        (["--colors", "drifting"], "--colors drifting: must be NAME=TEXT"),
        (["--colors", "drifting=red", "--colors", "drifting=blue"], "drifting is given twice"),
        (["--size", "100"], "--size 100: must be WIDTHxHEIGHT in mm"),
        (["--dpi", "0"], "dpi = 0"),
        (["--cmap", "magma"], "cmap: label has flags"),
    ):
        done = shell("map", "small.nc", "-o", "b.png", *wrong, cwd=folder)
        assert done.returncode == 2
        assert named in done.stderr
        assert len(done.stderr.strip().splitlines()) == 1


@pytest.mark.parametrize(
    ("arguments", "named"),
    [
        (["run", "none.toml"], "none.toml"),
        (["run", "small.toml", "-o", "no/folder/a.nc"], "no/folder"),
        (["run", "small.toml", "-o", "a.txt"], ".nc"),
        (["points", "satellite", "small.toml", "-o", "a.txt"], "must end in .csv or .nc"),
        (
            ["points", "satellite", "small.toml", "-o", "a.nc", "--threads", "0"],
            "--threads 0: must be at least 1",
        ),
        (["trajectory", "small.toml", "-o", "a.txt"], "must end in .nc, .png, .pdf or .svg"),
        (["trajectory", "small.toml", "-o", "no/a.nc"], "no folder no"),
        (["accuracy", "small.toml", "-o", "a.txt"], "must end in .nc, .csv, .png, .pdf or .svg"),
        (["map", "none.nc", "-o", "a.txt"], "must end in .png, .pdf or .svg"),
        (["join", ".", "-o", "a.nc"], "not a run folder"),
        (["stress", "--threads", "0"], "--threads 0: must be at least 1"),
        (["stress", "satellite", "-o", "small.toml"], "small.toml: not a folder"),
        (["figures", "-o", "small.toml"], "small.toml: not a folder"),
        (["figures", "--only", "21"], "figures 1 to 20"),
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
    except SystemExit as stop:
        code = stop.code
    message = capsys.readouterr().err
    assert code == 2
    assert len(message.strip().splitlines()) == 1
    assert named in message
    assert sorted(p.name for p in folder.iterdir()) == before


@pytest.mark.parametrize(
    "arguments",
    [
        ["run", "small.toml", "-o", "old.nc"],
        ["points", "satellite", "small.toml", "-o", "old.nc"],
        ["trajectory", "small.toml", "-o", "old.nc"],
        ["accuracy", "small.toml", "-o", "old.nc"],
        ["map", "none.nc", "-o", "old.png"],
        ["figures", "-o", ".", "--only", "1", "--format", "png"],
        ["stress", "satellite", "-o", "."],
    ],
    ids=lambda arguments: arguments[0],
)
def test_existing_files_are_kept_without_force(folder, monkeypatch, capsys, arguments):
    monkeypatch.chdir(folder)
    for name in ("old.nc", "old.png", "figure_01.png", "satellite.png"):
        (folder / name).write_text("kept")
    assert main(arguments) == 2
    assert re.search(r"this file exists; --force.* replaces it", capsys.readouterr().err)
    assert all(path.read_text() == "kept" for path in folder.iterdir() if path.name != "small.toml")


def test_ctrl_c_leaves_no_half_file_and_exits_130(folder, scene_text):
    large = {"axes.sigma.count": 900, "axes.theta0.count": 700, "integration.tolerance": 1e-9}
    (folder / "long.toml").write_text(scene_text(large))
    assert shell("run", "small.toml", cwd=folder).returncode == 0  # the kernel is warm now
    process = subprocess.Popen(
        [sys.executable, "-m", "atlas", "run", "long.toml"], cwd=folder, stderr=subprocess.PIPE, text=True,
        start_new_session=True,
    )  # fmt: skip
    deadline = time.monotonic() + 60
    while not list(folder.glob("long.nc.run/*.json")) and time.monotonic() < deadline:
        time.sleep(0.1)
    assert process.poll() is None
    os.killpg(process.pid, signal.SIGINT)
    _, message = process.communicate(timeout=60)
    assert process.returncode == 130
    assert "interrupted" in message
    assert "Traceback" not in message
    assert not (folder / "long.nc").exists()
    # A loaded machine may end the process while it writes; every later command removes what that leaves.
    assert shell("status", "long.nc.run", cwd=folder).returncode == 0
    assert not list(folder.rglob("*.tmp"))


def test_help_of_every_command_is_real(capsys):
    top = parser()
    commands = [
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
    ]
    for name in commands:
        with pytest.raises(SystemExit) as stop:
            top.parse_args([name, "--help"])
        assert stop.value.code == 0
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
