"""A run to be put under faults, the atlas expected of it, and processes that die."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import tomllib
from collections.abc import Callable
from contextlib import redirect_stdout
from pathlib import Path
from typing import Any

import atlas
from atlas import BadInput, cli
from atlas.runs.folder import RunFolder
from atlas.runs.plan import ScenePlan
from atlas.scene import grid
from atlas.scene.read import scene_from

SMALL_SCENE = Path(__file__).parents[2] / "tests" / "small.toml"
TILE = 64  # points


class Trial:
    """A scene in a folder of its own, the atlas expected of it, and empty run folders for it."""

    def __init__(self, folder: Path, tiles: int):
        self.folder = folder
        table = tomllib.loads(SMALL_SCENE.read_text())
        table["axes"]["sigma"]["count"], table["axes"]["theta0"]["count"] = tiles, TILE
        table["integration"]["tolerance"] = 1e-10
        (folder / "scene.toml").write_text(scene_from(table).toml())
        self.scene = atlas.load_scene(folder / "scene.toml")
        # One thread, because a process whose compiled code has started threads cannot be forked.
        self.whole = atlas.run(self.scene, threads=1, progress=False)

    def start(self, name: str) -> RunFolder:
        """Prepare a run folder of many small tiles, which its manifest lists for every process."""
        usual, grid.MAX_POINTS_PER_TILE = grid.MAX_POINTS_PER_TILE, TILE
        try:
            return RunFolder.prepare(ScenePlan.of(self.scene), self.folder / name, [])
        finally:
            grid.MAX_POINTS_PER_TILE = usual

    def process(self, *arguments: str, **options: Any) -> subprocess.Popen[str]:
        """Start `atlas run` on the scene in a process of its own."""
        return self.command("run", "scene.toml", "--quiet", *arguments, **options)

    def command(self, *arguments: str, **options: Any) -> subprocess.Popen[str]:
        """Start an `atlas` command in a process of its own."""
        return subprocess.Popen(
            [sys.executable, "-m", "atlas", *arguments], cwd=self.folder, text=True,
            stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, **options,
        )  # fmt: skip

    def finish(self, *arguments: str) -> None:
        """Run the scene to its end, in a fork, which need not import the package again; an error ends this script."""

        def run() -> None:
            os.chdir(self.folder)
            with open(os.devnull, "w") as nothing, redirect_stdout(nothing):
                if cli.main(["run", "scene.toml", "--quiet", *arguments]):
                    raise RuntimeError("the reason is above")

        code, message = in_fork(run)
        if code:
            sys.exit(f"{' '.join(arguments)}: exit {code}: {message}")

    def compared(self, path: Path) -> int:
        """Compare all variables with those expected, byte by byte; returns the number of bytes."""
        total = 0
        with atlas.open_atlas(path) as ds:
            if set(ds.variables) != set(self.whole.variables):
                sys.exit(f"{path}: the variables differ")
            for name, array in self.whole.variables.items():
                if array.values.tobytes() != ds.variables[name].values.tobytes():
                    sys.exit(f"{path}: {name} differs")
                total += array.nbytes
        return total


def change_times(run: RunFolder) -> dict[str, int]:
    """Times of the last change of the files of finished tiles, by name."""
    names = [f"{tile:08d}.nc" for tile in run.tiles.status().done]
    return {name: (run.path / "tiles" / name).stat().st_mtime_ns for name in names}


def in_fork(action: Callable[[], object]) -> tuple[int, str]:
    """Call something in a fork of this process; its exit status (2 for BadInput, 1 for an OSError) and message."""
    reader, writer = os.pipe()
    child = os.fork()
    if child == 0:
        code = 3
        try:
            action()
            code = 0
        except (BadInput, OSError) as error:
            os.write(writer, str(error).encode())
            code = 2 if isinstance(error, BadInput) else 1
        except BaseException as error:
            os.write(writer, repr(error).encode())
        finally:
            os._exit(code)
    os.close(writer)
    with os.fdopen(reader) as message:
        text = message.read()
    return os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]), text


def dying(action: Callable[[], object], step: int | None, counts: Path) -> Callable[[], None]:
    """An action that is killed just before its change number `step` of a file or folder; it notes their number."""

    def act() -> None:
        steps = 0

        def counted(change: Callable[..., Any]) -> Callable[..., Any]:
            def change_or_die(*arguments: Any, **options: Any) -> Any:
                nonlocal steps
                steps += 1
                if steps == step:
                    os.kill(os.getpid(), signal.SIGKILL)
                return change(*arguments, **options)

            return change_or_die

        for name in ("replace", "link", "rename", "unlink", "rmdir", "mkdir", "fsync", "open"):
            setattr(os, name, counted(getattr(os, name)))
        action()
        counts.write_text(str(steps))

    return act
