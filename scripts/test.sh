#!/bin/sh
# Set up and run the tests, in one process more than there are processors, because many wait for a process of their own;
# arguments go to pytest.
# Each process begins with its own part of the files, so that few kernels are compiled by both.
set -e
cd "$(dirname "$0")/.."
extras="[test]"
. scripts/setup.sh
echo "Running the tests, several minutes for all of them" >&2
processes=$(.venv/bin/python -c 'import os; print(len(getattr(os, "sched_getaffinity", lambda _: range(os.cpu_count()))(0)) + 1)')
.venv/bin/python -m pytest --numprocesses "$processes" --dist worksteal "$@"
