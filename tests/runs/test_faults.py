"""Real processes that are killed, interrupted, out of disk or without rights, as often as --fault-rounds says.

sh scripts/test.sh -m faults --fault-rounds 20      (about an hour; small disks and other users need root)
"""

import os
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from truth import assert_same_bytes, state, tile_path

import atlas
from atlas import BadInput
from atlas.runs.run import RunFolder

pytestmark = pytest.mark.faults
CONFIGS = Path(__file__).parents[2] / "configs"


def start(folder, *arguments, program=("-m", "atlas"), **options):
    """Start an `atlas` command."""
    return subprocess.Popen(
        [sys.executable, *program, *map(str, arguments)], cwd=folder, text=True, start_new_session=True,
        stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, **options,
    )  # fmt: skip


def finish(folder, *arguments, **options):
    """Run an `atlas` command to its end; its exit code and what it printed on stderr."""
    process = start(folder, *arguments, **options)
    _, errors = process.communicate()
    return process.returncode, errors


@pytest.fixture
def finished(longer):
    """Folder of a scene, its finished run folder, and its result computed in memory."""
    path, run, whole = longer
    atlas.run(run.scene, f"{run.path}/", progress=False)
    return path, run, whole


def test_a_killed_join_leaves_a_whole_file_or_none(finished, fault_rounds):
    path, run, whole = finished
    place, rng = path / "place", np.random.default_rng(1)
    place.mkdir()
    command = ("join", run.path, "-o", "a.nc", "--force")
    started = time.monotonic()
    assert finish(place, *command) == (0, "")
    longest = time.monotonic() - started
    for _ in range(fault_rounds):
        (place / "a.nc").unlink()
        process = start(place, *command)
        time.sleep(rng.uniform(0.3, 1) * longest)
        process.kill()
        process.communicate()
        if (place / "a.nc").exists():
            with atlas.open_atlas(place / "a.nc") as ds:
                assert_same_bytes(whole, ds)
        assert finish(place, *command) == (0, "")
        assert [file.name for file in place.iterdir()] == ["a.nc"]


def test_a_flipped_bit_of_a_run_folder_never_gives_other_data(finished, fault_rounds):
    """Of a tile and of the notes; tests of the manifest and of joined files flip their bits."""
    _, run, whole = finished
    attributes, rng = repr(atlas.open_atlas(run.path).attrs), np.random.default_rng(2)
    for file in [tile_path(run.tiles, 5), run.path / "notes.json"]:
        content = file.read_bytes()
        for _ in range(50 * fault_rounds):
            flipped = bytearray(content)
            flipped[rng.integers(len(flipped))] ^= 1 << int(rng.integers(8))
            file.write_bytes(flipped)
            try:
                if not state(run.tiles).damaged:
                    ds = RunFolder.open(run.path).dataset()
                    assert repr(ds.attrs) == attributes
                    assert_same_bytes(whole, ds)
            except BadInput as error:
                assert len(str(error).splitlines()) == 1  # noqa: PT017
        file.write_bytes(content)


@pytest.fixture
def small_disk(longer):
    """Function that mounts a disk of so many kilobytes on the folder `disk` or changes its size or rights."""
    path = longer[0] / "disk"
    path.mkdir()

    def mount(*options):
        return subprocess.run(["mount", *options, str(path)], capture_output=True, check=False).returncode

    if mount("-t", "tmpfs", "-o", "size=4k", "tmpfs"):
        pytest.skip("only root can mount a disk")

    def change(options):
        assert mount("-o", f"remount,{options}") == 0, options

    yield change
    subprocess.run(["umount", str(path)], check=True)


UNAWARE_OF_FREE_SPACE = """
import sys
from atlas import cli
from atlas.runs import estimate

estimate.check_disk = lambda *arguments, **options: None
sys.exit(cli.main(sys.argv[1:]))
"""


def test_a_full_or_read_only_disk_stops_a_run_in_one_line_that_goes_on_later(
    longer, small_disk, fault_rounds
):
    path, run, whole = longer
    disk, full, refused = path / "disk", 0, 0

    def completed(*command):
        """Whether a command ends well that knows nothing of the free space, as if others filled the disk meanwhile."""
        code, errors = finish(path, *command, program=("-c", UNAWARE_OF_FREE_SPACE))
        assert code == 0 or (code == 1 and "No space left" in errors and len(errors.splitlines()) == 1), (
            errors
        )
        assert not list(disk.rglob(".atlas-*"))
        return code == 0

    assert not completed("run", "scene.toml", "-o", "disk/new/", "--quiet")
    small_disk("size=64k")
    shutil.copytree(run.path, disk / "run")
    sizes = iter(range(64, 4000, max(180 // fault_rounds, 8)))
    while True:
        small_disk(f"size={next(sizes)}k")
        if completed("run", "scene.toml", "-o", "disk/run/", "--quiet"):
            break
        full += 1
        code, errors = finish(path, "run", "scene.toml", "-o", "disk/run/", "--quiet")
        assert code == 0 or (
            code == 2 and "are free on this disk" in errors and len(errors.splitlines()) == 1
        )
        refused += code == 2
        assert not state(RunFolder.open(disk / "run").tiles).damaged
    assert full
    assert refused
    used = sum(file.stat().st_blocks // 2 for file in disk.rglob("*"))
    RunFolder.open(disk / "run").join(path / "size.nc")
    needed = (path / "size.nc").stat().st_size // 1024
    for share in np.linspace(0.05, 0.95, fault_rounds):
        small_disk(f"size={used + round(share * needed)}k")
        assert not completed("join", "disk/run", "-o", "disk/a.nc")
        assert not (disk / "a.nc").exists()
    small_disk("size=20m")
    assert completed("join", "disk/run", "-o", "disk/a.nc")
    with atlas.open_atlas(disk / "a.nc") as ds:
        assert_same_bytes(whole, ds)
    (disk / "run" / "tiles" / "00000005.tile").unlink()
    small_disk("ro")
    code, errors = finish(path, "run", "scene.toml", "-o", "disk/run/", "--quiet")
    assert code == 2, errors
    assert "cannot be written" in errors.splitlines()[-1]


# As an ordinary user: actions on what belongs to somebody else, and how each ends.
ORDINARY_USER = """
import os, sys
import atlas
from atlas import files
from atlas.runs.run import RunFolder
from atlas.scene import grid

scene = atlas.load_scene("scene.toml")
atlas.run(scene, threads=1, progress=False)
os.setgroups([]), os.setgid(65534), os.setuid(65534)

def join(out):
    RunFolder.open("run").join(files.writable(out, (".nc",), force=False))

for action in (
    lambda: atlas.run(scene, "new/", progress=False),
    lambda: atlas.run(scene, "new.nc", progress=False),
    lambda: atlas.run(scene, "a.nc", progress=False, force=True),
    lambda: atlas.run(scene, "run/", progress=False),
    lambda: atlas.run(scene, "closed/new/", progress=False),
    lambda: join("b.nc"),
):
    try:
        action()
        print("done")
    except (atlas.BadInput, OSError) as error:
        print(type(error).__name__, len(str(error).splitlines()))
"""


@pytest.mark.skipif(os.getuid() != 0, reason="only root can become another user")
def test_an_ordinary_user_changes_nothing_of_somebody_else(finished):
    path, run, whole = finished
    run.join(path / "a.nc")
    tile_path(run.tiles, 5).unlink()
    (path / "closed").mkdir()
    modes = {each: each.stat().st_mode for each in [path, *path.parents]}
    closed = {each: mode for each, mode in modes.items() if mode & 0o011 != 0o011}
    for each, mode in closed.items():
        each.chmod(mode | 0o011)
    path.chmod(modes[path] | 0o055)
    (path / "closed").chmod(0)
    tile_path(run.tiles, 6).chmod(0)
    before = {file: file.read_bytes() for file in path.rglob("*") if file.is_file()}
    try:
        done = subprocess.run(
            [sys.executable, "-c", ORDINARY_USER], cwd=path, text=True, capture_output=True, check=False
        )
    finally:
        for each, mode in closed.items():
            each.chmod(mode)
    assert done.returncode == 0, done.stderr
    answers = done.stdout.splitlines()
    assert len(answers) == 6
    assert set(answers) <= {"BadInput 1", "OSError 1", "PermissionError 1"}
    assert {file: file.read_bytes() for file in path.rglob("*") if file.is_file()} == before
    assert_same_bytes(whole, atlas.run(run.scene, f"{run.path}/", progress=False))


LONG = {"integration.duration": 3e4, "integration.tolerance": 1e-12, "integration.check_half_step": "all"}
COMMANDS = {
    "start": ["--help"],
    "check": ["check", "long.toml"],
    "dry run": ["run", "long.toml", "--dry-run"],
    "rk4": ["run", "long.toml", "-o", "rk4.nc", "--force"],
    "rk8": ["run", "rk8.toml", "-o", "rk8.nc", "--force"],
    "unresolved": ["run", "unresolved.toml", "-o", "unresolved.nc", "--force"],
    "many points": ["run", "many.toml", "-o", "many.nc", "--force"],
    "workers": ["run", "many.toml", "-o", "workers.nc", "--force", "--workers", "2"],
    "theory": ["run", CONFIGS / "first_order_error.toml", "-o", "theory.nc", "--force"],
    "refine": ["run", CONFIGS / "conical_precession_body.toml", "-o", "refined.nc", "--force"],
    "folder": ["run", "many.toml", "-o", "folder/"],
    "join": ["join", "whole/", "-o", "joined.nc", "--force"],
    "map": ["map", "whole/", "-o", "map.png", "--force"],
    "compare": ["compare", "whole/"],
    "accuracy": ["accuracy", CONFIGS / "quickstart.toml", "--points", "64"],
    "conditions": ["conditions"],
    "stress": ["stress", "satellite"],
    "figures": ["amer2013_figures", "--only", "1", "--force"],
}


@pytest.fixture(scope="module")
def whole_folder(tmp_path_factory, scene_text):
    """A finished run folder of a million points."""
    path = tmp_path_factory.mktemp("whole") / "run"
    scene = {"axes.sigma.count": 1000, "axes.theta0.count": 1000, "integration.duration": 2.0}
    atlas.run(atlas.load_scene(scene_text(scene)), f"{path}/", progress=False).close()
    return path


@pytest.mark.parametrize("name", COMMANDS)
def test_an_interrupted_command_ends_within_two_seconds_without_a_traceback(
    tmp_path, whole_folder, scene_text, fault_rounds, install_example, name
):
    path = tmp_path
    install_example("amer2013_figures")
    (path / "whole").symlink_to(whole_folder)
    (path / "long.toml").write_text(scene_text(LONG))
    (path / "rk8.toml").write_text(scene_text(LONG | {"integration.method": "rk8"}))
    (path / "unresolved.toml").write_text(scene_text(LONG | {"fixed.m": 1e8}))
    (path / "many.toml").write_text(scene_text({"axes.sigma.count": 1000, "axes.theta0.count": 1000}))
    process, started = start(path, *COMMANDS[name]), time.monotonic()
    try:
        process.communicate(timeout=30)
    except subprocess.TimeoutExpired:
        process.kill()
        process.communicate()
    longest = max(time.monotonic() - started, 0.3)
    rng = np.random.default_rng(3)
    for _ in range(fault_rounds):
        number = signal.SIGINT if rng.random() < 0.5 else signal.SIGTERM
        shutil.rmtree(path / "folder", ignore_errors=True)
        process = start(
            path, *COMMANDS[name], preexec_fn=lambda: signal.signal(signal.SIGINT, signal.default_int_handler)
        )
        time.sleep(rng.uniform(0.3, longest))  # the first 0.3 s start Python, before the package is imported
        process.send_signal(number)
        started = time.monotonic()
        _, errors = process.communicate()
        assert time.monotonic() - started < 2, (number, errors)
        assert process.returncode in (0, 128 + number), errors
        assert "Traceback" not in errors
