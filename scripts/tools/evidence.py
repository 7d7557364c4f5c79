"""Run comparisons with independent computations and save their counts, from which make_docs.py writes the table of docs/evidence.md.

python scripts/tools/evidence.py [--out docs/evidence.json] [--only NAME ...]

Each comparison is a command, which the page prints; its counts are read from the command's output or files. All comparisons take
about half an hour of one processor; --only keeps the counts of the others in the file.
"""

from __future__ import annotations

import argparse
import csv
import json
import os
import re
import shlex
import subprocess
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import atlas

ROOT = Path(__file__).parents[2]
FILE = ROOT / "docs" / "evidence.json"
LAST = -300  # last characters of the output of a failed command, which are shown

Counts = tuple[int, int]  # numbers of compared items and of those that differ


class Check(NamedTuple):
    """A comparison."""

    what: str
    against: str
    command: str  # run in a folder with links to the files of ROOT
    counts: Callable[[str, Path], Counts]  # a function of its output and its folder


def sums(compared: str, wrong: str) -> Callable[[str, Path], Counts]:
    """A function for `Check.counts`: sums of the numbers that two patterns find in the output."""

    def counts(text: str, folder: Path) -> Counts:
        found = [[int(number) for number in re.findall(pattern, text)] for pattern in (compared, wrong)]
        return sum(found[0]), sum(found[1])

    return counts


def passed(text: str, folder: Path) -> Counts:
    """Numbers of tests that ran and that failed."""
    good, bad = sums(r"(\d+) passed", r"(\d+) failed")(text, folder)
    return good + bad, bad


def accuracy(text: str, folder: Path) -> Counts:
    """Numbers of compared and of wrong labels at the scene's own setting."""
    with (folder / "accuracy.csv").open(newline="") as file:
        (row,) = (row for row in csv.DictReader(file) if row["own_setting"] == "True")
    return int(row["labels_compared"]), int(row["labels_wrong"])


def published(text: str, folder: Path) -> Counts:
    """Counts of published numbers and of those that differ."""
    ((agreeing, count),) = re.findall(r"(\d+) of (\d+) numbers of others", text)
    return int(count), int(count) - int(agreeing)


STRESS = sums(r"\b(?:right|wrong) (\d+)", r"\bwrong (\d+)")
PYTEST = "python -m pytest -q -p no:cacheprovider"
CHECKS = {
    "accuracy_top": Check(
        "labels of a map of tops",
        "SciPy's DOP853 at 3e-14",
        "atlas accuracy configs/quickstart.toml --points 300 -o accuracy.csv",
        accuracy,
    ),
    "accuracy_satellite": Check(
        "labels of a map of satellites",
        "SciPy's DOP853 at 3e-14",
        "atlas accuracy configs/stability_perp_velocity.toml --points 300 -o accuracy.csv",
        accuracy,
    ),
    "no_orbit": Check(
        "labels of random satellites",
        "runs that end early; the same bodies about a fixed point",
        "python scripts/benchmarks/bench_label_checks.py --points 5000",
        sums(r"(?:permanent_rotation|regular_precession|drifting) (\d+)", r"differ at (\d+)"),
    ),
    "proofs": Check(
        "labels of random bodies",
        "proofs for every duration",
        "python scripts/benchmarks/bench_proofs.py --points 500 --duration 1e3",
        sums(r"(\d+) proved and measured", r"(\d+) contradictions"),
    ),
    "stress_satellite": Check(
        "labels of stiff and extreme satellites, by two methods at twelve levels",
        "theory, references and exact motions",
        "atlas stress satellite",
        STRESS,
    ),
    "stress_fixed_point": Check(
        "labels of stiff and extreme bodies about a fixed point, by two methods at twelve levels",
        "theory, references and exact motions",
        "atlas stress fixed_point",
        STRESS,
    ),
    "equilibria": Check(
        "all equilibria of random satellites",
        "the roots of a resultant",
        f"{PYTEST} tests/extensions/equilibria/test_one_satellite.py -k all_equilibria",
        passed,
    ),
    "drag": Check(
        "all equilibria of random satellites with drag",
        "Newton's method from 500 random starts",
        f"{PYTEST} -vv -m long tests/extensions/equilibria -k newtons_method_finds",
        sums(r"\[(\d+)\] PASSED", r"\[(\d+)\] FAILED"),
    ),
    "folds": Check(
        "folds and borders of equilibria",
        "values and curves of other methods",
        f"{PYTEST} -m 'long or not long' tests/extensions/branches -k verified",
        passed,
    ),
    "periodic": Check(
        "families of periodic motions, to their ends",
        "another code",
        f"{PYTEST} -m 'long or not long' tests/extensions/periodic -k another_code",
        passed,
    ),
    "satellite": Check(
        "numbers of others on satellites",
        "what they printed",
        "atlas conditions satellite --published",
        published,
    ),
    "fixed_point": Check(
        "numbers of others on bodies about a fixed point",
        "what they printed",
        "atlas conditions fixed_point --published",
        published,
    ),
}


def row(check: Check) -> dict[str, str | int]:
    """Run a comparison in a temporary folder; returns its row of the file."""
    words = shlex.split(check.command)
    command = [sys.executable, *(["-m", "atlas", *words[1:]] if words[0] == "atlas" else words[1:])]
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        for each in ("configs", "scripts", "tests", "docs", "pyproject.toml"):
            (folder / each).symlink_to(ROOT / each)
        path = os.pathsep.join([str(ROOT), str(ROOT / "tests")])
        done = subprocess.run(
            command,
            cwd=folder,
            capture_output=True,
            text=True,
            check=False,
            env=os.environ | {"PYTHONPATH": path},
        )
        try:
            compared, wrong = check.counts(done.stdout, folder)
        except (OSError, ValueError):
            compared = 0
        if not compared:
            raise SystemExit(f"{check.command}: {(done.stdout + done.stderr)[LAST:]}")
    counts = {"compared": compared, "differ": wrong, "version": atlas.__version__}
    return {"what": check.what, "against": check.against, "command": check.command} | counts


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument(
        "--out", type=Path, default=FILE, help="file of the counts (default: docs/evidence.json)"
    )
    parser.add_argument("--only", nargs="+", choices=CHECKS, default=list(CHECKS), help="some comparisons")
    options = parser.parse_args()
    kept = json.loads(options.out.read_text()) if options.out.exists() else {}
    for name in options.only:
        kept[name] = row(CHECKS[name])
        print(f"{name}: {kept[name]['differ']} of {kept[name]['compared']} differ", flush=True)
        rows = {each: kept[each] for each in CHECKS if each in kept}
        options.out.write_text(json.dumps(rows, indent=1) + "\n")


if __name__ == "__main__":
    main()
