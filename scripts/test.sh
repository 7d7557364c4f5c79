#!/bin/sh
# Set up and run the tests, one process per processor; arguments go to pytest.
# Each process begins with its own part of the files, so that few kernels are compiled by both.
set -e
cd "$(dirname "$0")/.."
extras="test"
. scripts/setup.sh
echo "Running the tests, several minutes for all of them" >&2
exec .venv/bin/python -m pytest --numprocesses auto --dist worksteal "$@"
