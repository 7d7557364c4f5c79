"""Names of processes, and tests of whether a process runs."""

from __future__ import annotations

import hashlib
import os
import re
import socket
from contextlib import suppress
from pathlib import Path

# A process is named machine-boot-pid-start. On the same machine the name tells whether the process runs. A later process with the
# same number has another start, and after a new boot no earlier process runs. A container counts as a machine of its own, because
# processes outside are not visible there. Nothing is known about processes of other machines.
PROCESS_NAME = re.compile(r"([0-9a-f]{8})-([0-9a-f]{8})-(\d+)-(\d+)")


def process_name() -> str:
    """Return the name of this process, which consists of hexadecimal digits and hyphens."""
    pid = os.getpid()
    machine, boot = _machine_and_boot()
    return f"{machine}-{boot}-{pid}-{_start(pid) or 0}"


def is_running(process: str) -> bool | None:
    """Return whether the process with a name from `process_name` runs, or None if the process is on another machine."""
    match = PROCESS_NAME.fullmatch(process)
    machine, boot = _machine_and_boot()
    if match is None or match[1] != machine:
        return None
    if match[2] != boot:
        return False
    pid, start = int(match[3]), int(match[4])
    try:
        os.kill(pid, 0)
    except (ProcessLookupError, OverflowError):
        return False
    except PermissionError:
        pass  # the process exists and belongs to another user
    start_now = _start(pid)
    return start_now is None or start == 0 or start_now == start


def _machine_and_boot() -> tuple[str, str]:
    """Return short hashes of the host (including the container) and of the last boot, if Linux shows the boot."""
    machine, boot = [socket.gethostname()], ""
    with suppress(OSError):
        machine.append(Path("/etc/machine-id").read_text(encoding="ascii"))
    with suppress(OSError):
        machine.append(os.readlink("/proc/self/ns/pid"))
    with suppress(OSError):
        boot = Path("/proc/sys/kernel/random/boot_id").read_text(encoding="ascii")
    first, second = (hashlib.sha256(text.encode()).hexdigest()[:8] for text in ("\n".join(machine), boot))
    return first, second


def _start(pid: int) -> int | None:
    """Return the start of a process in ticks after the boot, -1 for a zombie, or None if the start cannot be read."""
    try:
        text = Path(f"/proc/{pid}/stat").read_text(encoding="ascii", errors="replace")
        fields = text.rpartition(")")[2].split()  # the name of the program, in brackets, may contain blanks
        return -1 if fields[0] in "ZX" else int(fields[19])
    except (OSError, ValueError, IndexError):
        return None
