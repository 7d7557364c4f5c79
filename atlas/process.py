"""Names of processes, from which it can be decided whether the writer of a file still runs.

A name is machine-boot-pid-start. On the same machine it decides exactly, because a number that is used again
belongs to a process with another start, and a machine that was started again has no process of before. A
container counts as a machine of its own, because it cannot see the processes of another one. Of another
machine nothing is known.
"""

from __future__ import annotations

import hashlib
import os
import re
import socket
from contextlib import suppress
from pathlib import Path

NAME = re.compile(r"([0-9a-f]{8})-([0-9a-f]{8})-(\d+)-(\d+)")


def name() -> str:
    """Name of this process, made of hexadecimal digits and hyphens."""
    pid = os.getpid()
    return f"{_machine()}-{_boot()}-{pid}-{_start(pid) or 0}"


def is_running(process: str) -> bool | None:
    """Whether a process runs, by its `name`; None for one of another machine, where this cannot be known."""
    match = NAME.fullmatch(process)
    if match is None or match[1] != _machine():
        return None
    boot, pid, start = match[2], int(match[3]), int(match[4])
    if boot != _boot():
        return False
    try:
        os.kill(pid, 0)
    except (ProcessLookupError, OverflowError):
        return False
    except PermissionError:
        pass  # it exists and belongs to another user
    start_now = _start(pid)
    return start_now is None or start == 0 or start_now == start


def _machine() -> str:
    """Hash of the host's name, its identifier, and the container whose processes can be seen."""
    parts = [socket.gethostname()]
    with suppress(OSError):
        parts.append(Path("/etc/machine-id").read_text(encoding="ascii"))
    with suppress(OSError):
        parts.append(os.readlink("/proc/self/ns/pid"))
    return _short_hash("\n".join(parts))


def _boot() -> str:
    """Hash of what Linux draws at random at each start; of nothing elsewhere."""
    with suppress(OSError):
        return _short_hash(Path("/proc/sys/kernel/random/boot_id").read_text(encoding="ascii"))
    return _short_hash("")


def _start(pid: int) -> int | None:
    """Start of a process, in ticks since the machine's; -1 for a zombie, None if it cannot be read."""
    try:
        stat = Path(f"/proc/{pid}/stat").read_text(encoding="ascii", errors="replace")
        fields = stat.rpartition(")")[2].split()  # the name of the program, in brackets, may contain blanks
        return -1 if fields[0] in "ZX" else int(fields[19])
    except (OSError, ValueError, IndexError):
        return None


def _short_hash(text: str) -> str:
    """Eight hexadecimal digits of a hash."""
    return hashlib.sha256(text.encode()).hexdigest()[:8]
