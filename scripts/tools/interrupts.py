"""Commands interrupted at random moments: how soon they end, and with what exit code.

python scripts/tools/interrupts.py [--count 20] [--only NAME ...] [--seed 0]      (some minutes)

Every command is started anew, gets SIGINT or SIGTERM at a random moment, and must end within the limit with exit code 130
or 143 (or 0 if it was already done), without a traceback. Each command is first run once to its end, or for a minute.
"""

from __future__ import annotations

import argparse
import random
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path

LIMIT = 2.0  # seconds from the signal to the end of the process
START = 0.3  # seconds until Python has started and imports the package
LONGEST = 60.0  # seconds after which a command that is not to be interrupted is stopped
CONFIGS = Path(__file__).parents[2] / "configs"

LONG_RUNS = """
schema = 1
title = "Few points of very many steps"
system = "satellite"
[fixed]
C = 1.2
m = 20.0
[axes.theta0]
from = 0.1
to = 1.5
count = 40
[integration]
duration = 3e4
method = "METHOD"
tolerance = 1e-12
check_half_step = "all"
"""
UNRESOLVED = LONG_RUNS.replace("m = 20.0", "m = 1e8")
MANY_POINTS = """
schema = 1
title = "Many points"
system = "satellite"
[fixed]
C = 1.2
[axes.theta0]
from = 0.1
to = 1.5
count = 1000
[axes.k3]
from = 0.0
to = 1.0
count = 1000
[integration]
duration = 20.0
"""
COMMANDS = {
    "start": ["--help"],
    "check": ["check", "many.toml"],
    "dry run": ["run", "long.toml", "--dry-run"],
    "long rk4": ["run", "long.toml", "-o", "long.nc", "--force"],
    "long rk8": ["run", "long_rk8.toml", "-o", "long_rk8.nc", "--force"],
    "unresolved": ["run", "unresolved.toml", "-o", "unresolved.nc", "--force"],
    "many": ["run", "many.toml", "-o", "many/"],
    "workers": ["run", "many.toml", "-o", "workers/", "--workers", "2"],
    "one file": ["run", "many.toml", "-o", "many.nc", "--force"],
    "theory": ["run", str(CONFIGS / "first_order_error.toml"), "-o", "theory.nc", "--force"],
    "refine": ["run", str(CONFIGS / "conical_precession_body.toml"), "-o", "refined.nc", "--force"],
    "join": ["join", "whole/", "-o", "joined.nc", "--force"],
    "map": ["map", "whole/", "-o", "map.png", "--force"],
    "compare": ["compare", "whole/"],
    "accuracy": ["accuracy", str(CONFIGS / "quickstart.toml"), "--points", "64"],
    "conditions": ["conditions"],
    "stress": ["stress", "satellite"],
    "figures": ["figures", "--only", "1", "--force"],
}


def start(folder: Path, arguments: list[str]) -> subprocess.Popen[str]:
    """Start a command; its output is kept."""
    return subprocess.Popen(
        [sys.executable, "-m", "atlas", *arguments], cwd=folder, text=True, start_new_session=True,
        stdout=subprocess.PIPE, stderr=subprocess.PIPE,
    )  # fmt: skip


def whole_time(folder: Path, arguments: list[str]) -> float:
    """Seconds that a command takes, at most LONGEST."""
    began = time.monotonic()
    process = start(folder, arguments)
    try:
        process.communicate(timeout=LONGEST)
    except subprocess.TimeoutExpired:
        process.kill()
        process.communicate()
    return time.monotonic() - began


def interrupted(folder: Path, arguments: list[str], moment: float, number: int) -> tuple[float, int, str]:
    """Seconds until a command answers a signal, its exit code and what it printed on stderr."""
    process = start(folder, arguments)
    time.sleep(moment)
    process.send_signal(number)
    began = time.monotonic()
    _, stderr = process.communicate()
    return time.monotonic() - began, process.returncode, stderr


def main() -> None:
    """Interrupt every command and print a line for each."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--count", type=int, default=20, help="signals for each command")
    parser.add_argument("--only", nargs="+", default=list(COMMANDS), choices=COMMANDS, metavar="NAME")
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    # A process started in the background ignores Ctrl-C, and so would the commands.
    signal.signal(signal.SIGINT, signal.default_int_handler)
    rng, bad = random.Random(options.seed), 0
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        (folder / "long.toml").write_text(LONG_RUNS.replace("METHOD", "rk4"))
        (folder / "long_rk8.toml").write_text(LONG_RUNS.replace("METHOD", "rk8"))
        (folder / "unresolved.toml").write_text(UNRESOLVED.replace("METHOD", "rk4"))
        (folder / "many.toml").write_text(MANY_POINTS)
        if {"join", "map", "compare"} & set(options.only):
            start(folder, ["run", "many.toml", "-o", "whole/", "--quiet"]).communicate()
        for command in options.only:
            arguments = COMMANDS[command]
            longest, answers, codes = whole_time(folder, arguments), [], []
            for _ in range(options.count):
                for output in ("many", "workers"):
                    shutil.rmtree(folder / output, ignore_errors=True)
                number = rng.choice([signal.SIGINT, signal.SIGTERM])
                moment = rng.uniform(START, max(longest, START))
                seconds, code, stderr = interrupted(folder, arguments, moment, number)
                answers.append(seconds)
                codes.append(code)
                if seconds > LIMIT or code not in (0, 128 + number) or "Traceback" in stderr:
                    bad += 1
                    print(
                        f"{command}: {number.name} after {moment:.2f} s: exit {code} in {seconds:.2f} s: {stderr[-300:]}"
                    )
            counts = ", ".join(f"{codes.count(code)} exit {code}" for code in sorted(set(codes)))
            print(f"{command}: {counts}; ended within {max(answers):.2f} s", flush=True)
    sys.exit(f"{bad} commands ended too late or wrongly" if bad else 0)


if __name__ == "__main__":
    main()
