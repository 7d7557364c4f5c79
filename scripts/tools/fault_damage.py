"""Files of run folders and atlases with damaged content."""

from __future__ import annotations

import json
import random
import sys
from collections.abc import Callable
from pathlib import Path

from fault_trial import Trial

import atlas
from atlas import BadInput
from atlas.runs.folder import RunFolder

DAMAGES = ("truncated", "zeroed", "one flipped bit", "empty", "foreign key", "not NetCDF")


def damage(kind: str, file: Path, record: Path) -> None:
    """Damage the file of a tile, or the JSON record beside it, in one of the ways of DAMAGES."""
    content = file.read_bytes()
    position = random.randrange(1, len(content))
    if kind == "foreign key":
        record.write_text(json.dumps(json.loads(record.read_text()) | {"key": "0" * 64}))
    else:
        flipped = bytes([content[position] ^ 16])
        damaged = {
            "truncated": content[:position],
            "zeroed": bytes(len(content)),
            "one flipped bit": content[:position] + flipped + content[position + 1 :],
            "empty": b"",
            "not NetCDF": b"not NetCDF",
        }
        file.write_bytes(damaged[kind])


def damages(trial: Trial, scale: float) -> str:
    """Damage every tile of a finished run; each must be detected and computed again with the same bytes."""
    run = trial.start("damages")
    trial.finish("-o", "damages/")
    tiles = run.path / "tiles"
    whole = {path: path.read_bytes() for path in tiles.glob("*.nc")}
    for tile in range(run.tiling.count):
        kind = DAMAGES[tile % len(DAMAGES)]
        damage(kind, tiles / f"{tile:08d}.nc", tiles / f"{tile:08d}.json")
        if run.tiles.is_done(tile):
            sys.exit(f"tile {tile}, {kind}: not detected")
    trial.finish("-o", "damages/")
    if {path: path.read_bytes() for path in whole} != whole:
        sys.exit("a tile computed again differs from the first one")
    return (
        f"{run.tiling.count} tiles damaged ({', '.join(DAMAGES)}), each detected and computed again,"
        f" {trial.compared(run.path)} bytes equal"
    )


def flipped(file: Path) -> None:
    """Flip one random bit of a file."""
    content = bytearray(file.read_bytes())
    content[random.randrange(len(content))] ^= 1 << random.randrange(8)
    file.write_bytes(content)


def flips(trial: Trial, scale: float) -> str:
    """Flip single bits of each kind of file; each flip must be found, or the data must be the same."""
    run = trial.start("flips")
    trial.finish("-o", "flips/")
    run.join(trial.folder / "flips.nc")
    attributes = repr(RunFolder.open(run.path).dataset().attrs)
    with atlas.open_atlas(trial.folder / "flips.nc") as ds:
        joined_attributes = repr(ds.attrs)

    def of_tile(suffix: str) -> Path:
        return run.tiles.path(random.randrange(run.tiling.count), suffix)

    def read_tiles(file: Path) -> bool:
        if not run.tiles.is_done(int(file.stem)):
            raise BadInput("found")
        return repr(run.dataset().attrs) == attributes

    def read_folder(file: Path) -> bool:
        return repr(RunFolder.open(run.path).dataset().attrs) == attributes

    def read_file(file: Path) -> bool:
        with atlas.open_atlas(file) as ds:
            return repr(ds.attrs) == joined_attributes and all(
                ds.variables[name].values.tobytes() == array.values.tobytes()
                and ds.variables[name].dims == array.dims
                and repr(ds.variables[name].attrs) == repr(array.attrs)
                for name, array in trial.whole.variables.items()
            )

    kinds: dict[str, tuple[int, Callable[[], Path], Callable[[Path], bool]]] = {
        "tiles": (200, lambda: of_tile(".nc"), read_tiles),
        "sidecars": (200, lambda: of_tile(".json"), read_tiles),
        "manifest": (400, lambda: run.path / "manifest.json", read_folder),
        "notes": (200, lambda: run.path / "notes.json", read_folder),
        "joined file": (400, lambda: trial.folder / "flips.nc", read_file),
    }
    report = []
    for kind, (number, choose, read) in kinds.items():
        refused = same = other = 0
        for _ in range(max(round(number * scale), 1)):
            file = choose()
            whole = file.read_bytes()
            flipped(file)
            try:
                if read(file):
                    same += 1
                else:
                    other += 1
            except BadInput as error:
                refused += 1
                if len(str(error).splitlines()) != 1:
                    sys.exit(f"{kind}: not one line: {error}")
            file.write_bytes(whole)
        report.append(f"{kind}: {refused} found, {same} same data, {other} other data")
        if other:
            sys.exit("; ".join(report))
    return "; ".join(report) + f"; {trial.compared(run.path)} bytes equal"


def swaps(trial: Trial, scale: float) -> str:
    """Swap tiles with their sidecars; each must be found and computed again."""
    run = trial.start("swaps")
    trial.finish("-o", "swaps/")
    order = random.sample(range(run.tiling.count), 2 * max(round(15 * scale), 1))
    for suffix in (".nc", ".json"):
        for one, two in zip(order[::2], order[1::2], strict=True):
            first, second = run.tiles.path(one, suffix), run.tiles.path(two, suffix)
            between = first.with_suffix(".swap")
            first.rename(between)
            second.rename(first)
            between.rename(second)
    damaged = len(run.tiles.status().damaged)
    if damaged != len(order):
        sys.exit(f"{damaged} of {len(order)} swapped tiles found")
    trial.finish("-o", "swaps/")
    return f"{len(order) // 2} pairs of tiles swapped, all found, {trial.compared(run.path)} bytes equal"
