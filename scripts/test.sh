#!/bin/sh
# Set up and run the tests, one process per processor; arguments go to pytest.
# Each process takes whole files, so that both do not compile the same kernels.
set -e
cd "$(dirname "$0")/.."
extras="[test]"
. scripts/setup.sh
.venv/bin/python -m pytest --numprocesses auto --dist worksteal "$@"
