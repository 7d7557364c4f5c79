"""The command line as a user meets it: real processes, exit codes, one-line errors, no file left half written."""

import os
import re
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import matplotlib.image
import pytest
import xarray as xr
from truth import tile_path

from atlas import extension
from atlas.analysis.tracer import LINES_FOLDER
from atlas.cli import main, parser
from atlas.files import cache_folder
from atlas.systems.satellite.system import SATELLITE


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


def test_run_compare_and_the_files_they_leave(folder, monkeypatch, capsys):
    monkeypatch.chdir(folder)
    assert main(["run", "small.toml", "--verbose"]) == 0
    printed = capsys.readouterr().out
    assert "wrote small.nc" in printed
    assert "label:" in printed
    assert "points/s" in printed
    assert sorted(p.name for p in folder.iterdir()) == ["small.nc", "small.toml"]
    assert main(["compare", "small.nc"]) == 0
    assert "theory \\ measured" in capsys.readouterr().out


def test_map_writes_png_and_pdf(folder, monkeypatch, capsys):
    monkeypatch.chdir(folder)
    assert main(["run", "small.toml", "--quiet"]) == 0
    assert main(["map", "small.nc"]) == 0
    assert (folder / "small.png").read_bytes().startswith(b"\x89PNG")
    assert (folder / "small.pdf").read_bytes().startswith(b"%PDF")
    assert main(["map", "small.nc"]) == 2
    assert "--force" in capsys.readouterr().err


@pytest.mark.long
def test_map_takes_the_choices_of_a_paper(folder, monkeypatch, capsys):
    monkeypatch.chdir(folder)
    assert main(["run", "small.toml", "--quiet"]) == 0
    options = (
        "--title Survival --colors drifting=red permanent_rotation=#0000ff --labels drifting=falls --dpi 100"
    )
    assert main(["map", "small.nc", *options.split(), "--size", "100x80", "-o", "a.png"]) == 0
    capsys.readouterr()
    picture = matplotlib.image.imread(folder / "a.png")
    assert picture.shape[1] == pytest.approx(100 / 25.4 * 100, abs=1)
    colours = {tuple(colour) for colour in picture[:, :, :3].reshape(-1, 3)}
    assert {(1, 0, 0), (0, 0, 1)} <= colours


@pytest.mark.long
def test_a_tile_is_never_replaced_by_the_join(longer, monkeypatch, capsys):
    folder, run, _ = longer
    monkeypatch.chdir(folder)
    assert main(["run", "scene.toml", "-o", "run/", "--quiet"]) == 0
    before = tile_path(run.tiles, 0).read_bytes()
    assert main(["join", "run", "-o", "run/tiles/00000000.nc", "--force"]) == 2
    assert "which is read" in capsys.readouterr().err
    assert tile_path(run.tiles, 0).read_bytes() == before


# The command without its limits of time after a signal, which a loaded machine would exceed: `test_interruption` holds those.
PATIENT = """
import sys
from atlas import cli, interruption

interruption.GRACE_PERIOD = interruption.MESSAGE_PERIOD = 60.0
sys.argv = ["atlas/__main__.py", "run", "long.toml"]
cli.command()
"""


@pytest.mark.long
@pytest.mark.parametrize(("number", "code"), [(signal.SIGINT, 130), (signal.SIGTERM, 143)])
def test_a_signal_leaves_no_half_file_and_the_message_continues(
    folder, scene_text, number, code, monkeypatch
):
    monkeypatch.chdir(folder)
    large = {"axes.sigma.count": 450, "axes.theta0.count": 400, "integration.duration": 12.0}
    (folder / "long.toml").write_text(scene_text(large))
    assert main(["run", "small.toml", "--quiet"]) == 0  # the kernel is warm now
    process = subprocess.Popen(
        [sys.executable, "-c", PATIENT], cwd=folder, stderr=subprocess.PIPE, text=True, start_new_session=True,
        env=os.environ | {"ATLAS_TILE_POINTS": "2048"},
    )  # fmt: skip
    while not list(folder.glob("long.nc.run/tiles/*.tile")):
        assert process.poll() is None
        time.sleep(0.02)
    os.killpg(process.pid, number)
    _, message = process.communicate(timeout=300)
    assert process.returncode == code
    last_line = message.splitlines()[-1]
    assert re.fullmatch(
        r"atlas: interrupted; [1-9]\d* of \d+ tiles are in long.nc.run/; `python -m atlas run long.toml` continues",
        last_line,
    )
    assert "Traceback" not in message
    assert not (folder / "long.nc").exists()
    assert not list(folder.rglob("*.tmp"))


@pytest.mark.long
@pytest.mark.parametrize("suffix", [".nc", "/"])
def test_names_with_points_stay_whole(folder, monkeypatch, suffix):
    monkeypatch.chdir(folder)
    (folder / "small.toml").rename(folder / "k3_0.5.toml")
    assert main(["run", "k3_0.5.toml", "-o", f"k3_0.5{suffix}", "--quiet"]) == 0
    assert main(["map", f"k3_0.5{suffix}", "--no-boundary"]) == 0
    assert main(["trajectory", "k3_0.5.toml", "--at", "sigma=0.5", "--at", "theta0=0.7"]) == 0
    assert {"k3_0.5.png", "k3_0.5.pdf", "k3_0.5_trajectory.png"} < {p.name for p in folder.iterdir()}


def test_options_take_several_values_or_are_repeated():
    def values(*arguments):
        return vars(parser().parse_args(arguments))

    for name, option in (("trajectory", "--at"), ("map", "--select")):
        for words in (["a=1", "b=-2"], ["a=1", option, "b=-2"], [f"{option}=a=1", "b=-2"]):
            words = words if words[0].startswith("--") else [option, *words]
            before, after = values(name, "x", *words), values(name, *words, "x")
            assert before == after
            assert before[option[2:]] == ["a=1", "b=-2"]
    for words in (["-o", "a.nc", "b.csv"], ["-o", "a.nc", "--out", "b.csv"], ["--out=a.nc", "b.csv"]):
        assert values("accuracy", *words, "s.toml") == values("accuracy", "s.toml", *words)
        assert values("accuracy", *words, "s.toml")["out"] == ["a.nc", "b.csv"]
    assert values("trajectory", "--at", "a=1", "--", "b=2")["scene"] == "b=2"


@pytest.mark.long
def test_scenes_and_points_come_from_standard_input(folder, monkeypatch, capsys):
    def run_with_input(text, *arguments):
        (folder / "input").write_text(text)
        before = os.dup(0)
        try:
            with (folder / "input").open() as file:
                os.dup2(file.fileno(), 0)
            return main(arguments), capsys.readouterr()
        finally:
            os.dup2(before, 0)
            os.close(before)

    monkeypatch.chdir(folder)
    scene = (folder / "small.toml").read_text()
    assert run_with_input(scene, "check", "-") == run_with_input("", "check", "small.toml")
    assert shell("check", "-", cwd=folder, input=scene).returncode == 0
    assert run_with_input(scene, "run", "-", "--quiet")[0] == 0
    assert (folder / "scene.nc").exists()
    # No parameter is 0, as in many tests: the kernel of this point is theirs.
    values = [str(1.0 + i / 50) for i in range(len(SATELLITE.parameters))]
    table = f"{','.join(SATELLITE.parameters)}\n{','.join(values)}\n"
    code, printed = run_with_input(table, "points", "satellite", "-", "-o", "a.csv")
    assert code == 0, printed.err
    assert (folder / "a.csv").exists()
    code, printed = run_with_input("C,m\n0.8,\n", "points", "satellite", "-", "-o", "b.csv")
    assert code == 2
    assert "standard input, line 2: m is empty" in printed.err
    for command, problem in (
        ("check - <&-", "is closed"),
        ("points satellite - -o c.csv <&-", "is closed"),
        ("points satellite - -o c.csv </dev/zero", "more than 1000000 characters"),
    ):
        done = subprocess.run(
            f"{sys.executable} -m atlas {command}", shell=True, cwd=folder, capture_output=True, text=True
        )
        assert done.returncode == 2
        assert re.fullmatch(f"atlas: standard input(, line 1)?: {problem}\n", done.stderr)


def test_a_scene_comes_from_a_pipe(folder):
    """Which cannot be read a second time for the file of points that it names."""
    os.mkfifo(folder / "pipe")
    command = f"cat small.toml > pipe & exec {sys.executable} -m atlas run pipe -o a.nc --quiet"
    done = subprocess.run(command, shell=True, cwd=folder, capture_output=True, text=True, timeout=60)
    assert done.returncode == 0, done.stderr


def test_examples_are_listed_and_copied(folder, monkeypatch, capsys):
    monkeypatch.chdir(folder)
    configs = Path(__file__).parents[2] / "configs"
    assert main(["new", "--list"]) == 0
    assert re.search("stability_perp_radius .* conical permanent rotation", capsys.readouterr().out)
    assert main(["new", "grioli", "--list"]) == 0
    assert "stability_perp_radius" in capsys.readouterr().out
    assert not (folder / "grioli.toml").exists()
    assert main(["new"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert [line.split()[0] for line in lines[1:-1]] == sorted(path.stem for path in configs.glob("*.toml"))
    assert main(["new", "gravity_gradient"]) == 0
    printed = capsys.readouterr().out
    assert "run gravity_gradient.toml, then " in printed
    assert printed.endswith(" map gravity_gradient.nc\n")
    assert (folder / "gravity_gradient.toml").read_bytes() == (configs / "gravity_gradient.toml").read_bytes()
    assert main(["check", "gravity_gradient.toml"]) == 0
    (frame,) = (line for line in capsys.readouterr().out.splitlines() if line.startswith("frame: "))
    assert (
        "nadir is minus the radius; roll, pitch and yaw are about velocity, minus the normal and nadir"
        in frame
    )
    assert main(["new", "gravity_gradient.toml", "-o", "mine.toml"]) == 0


def test_the_second_name_is_the_name_in_messages(monkeypatch, capsys):
    monkeypatch.setattr(sys, "argv", ["/usr/bin/precession-atlas"])
    with pytest.raises(SystemExit):
        main(["--help"])
    assert "usage: precession-atlas" in capsys.readouterr().out
    monkeypatch.setattr(sys, "argv", ["/site-packages/atlas/__main__.py"])
    assert parser().prog == "atlas"


@pytest.mark.long
def test_a_trajectory_starts_from_the_scene_in_an_atlas(folder, monkeypatch, capsys):
    monkeypatch.chdir(folder)
    assert main(["run", "small.toml", "--quiet"]) == 0
    place = ["--at", "sigma=0.5", "theta0=0.7"]
    assert main(["trajectory", "small.toml", *place, "-o", "a.nc"]) == 0
    assert main(["trajectory", "small.nc", *place, "-o", "b.nc"]) == 0
    with xr.open_dataset("a.nc") as a, xr.open_dataset("b.nc") as b:
        xr.testing.assert_equal(a, b)
    (folder / "in.csv").write_text("C,theta0\n0.8,0.3\n1.2,0.4\n")
    assert main(["points", "satellite", "in.csv", "-o", "p.nc", "--duration", "5", "--quiet"]) == 0
    assert main(["trajectory", "p.nc", "--at", "theta0=0.4", "-o", "c.nc"]) == 0
    with xr.open_dataset("c.nc") as c:
        assert float(c.theta[0]) == pytest.approx(0.4)


@pytest.mark.long
def test_an_unfinished_folder_is_announced(longer, monkeypatch, caplog, capsys):
    folder, run, _ = longer
    monkeypatch.chdir(folder)
    assert main(["run", "scene.toml", "-o", "run/", "--shard", "1/3", "--quiet"]) == 0
    for command in (["map", "run", "--no-boundary"], ["compare", "run"]):
        caplog.clear()
        assert main(command) == 0
        assert "12 of 18 tiles are missing" in caplog.text
    assert main(["status", "run"]) == 0
    assert "no process is at work" in capsys.readouterr().out


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
        "status",
        "join",
        "cache",
        "new",
        *extension.parts("commands"),
    ]
    for name in commands:
        with pytest.raises(SystemExit) as stop:
            top.parse_args([name, "--help"])
        assert stop.value.code == 0
        assert name in capsys.readouterr().out


def test_version_and_cache(capsys, tmp_path, monkeypatch):
    monkeypatch.setenv("ATLAS_CACHE", str(tmp_path))
    assert main(["cache"]) == 0
    (tmp_path / LINES_FOLDER).mkdir()
    assert main(["cache", "--clear"]) == 0
    assert not (tmp_path / LINES_FOLDER).exists()
    assert "removed 0" in capsys.readouterr().out


@pytest.mark.long
def test_cache_warm_compiles_the_kernel_of_a_scene(folder, tmp_path, monkeypatch, capsys):
    kernels = tmp_path / "kernels"
    kernels.mkdir(mode=0o700)
    for path in cache_folder().glob("atlas_function_*"):  # what other tests have compiled
        shutil.copy2(path, kernels)
    monkeypatch.setenv("ATLAS_CACHE", str(kernels))
    warmed = shell("cache", "--warm", "small.toml", cwd=folder)
    assert re.search(r"small.toml: compiled in \d+\.\d s", warmed.stdout), warmed.stderr
    assert main(["cache"]) == 0
    assert "1 kernels" in capsys.readouterr().out


@pytest.mark.long
def test_cache_warm_skips_examples_of_missing_extensions(copied_package, folder):
    package, environment = copied_package
    examples = package.parent / "configs"
    examples.mkdir()
    scene = (folder / "small.toml").read_text()
    (examples / "first.toml").write_text(f'extensions = ["absent"]\n{scene}')
    (examples / "second.toml").write_text(scene)
    warmed = shell("cache", "--warm", cwd=package.parent, env=os.environ | environment)
    assert warmed.returncode == 0, warmed.stderr
    first, second, *_ = warmed.stdout.splitlines()
    assert first.startswith("first: skipped: the extension absent is not installed")
    assert second.startswith("second: ")


def test_trajectory_of_a_point_of_a_scene(folder, monkeypatch, capsys):
    monkeypatch.chdir(folder)
    assert main(["trajectory", "small.toml", "--at", "sigma=0.5", "theta0=0.7"]) == 0
    assert "theta from" in capsys.readouterr().out
    assert (folder / "small_trajectory.png").read_bytes().startswith(b"\x89PNG")
    assert main(["trajectory", "small.toml", "--at", "sigma=0.5", "theta0=0.7", "-o", "a.nc"]) == 0
    with xr.open_dataset(folder / "a.nc") as tr:
        assert float(tr.theta[0]) == pytest.approx(0.7001)
