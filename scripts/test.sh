#!/bin/sh
# Set up and run the tests, one process per processor; arguments go to pytest.
set -e
cd "$(dirname "$0")/.."
extras="[test]"
. scripts/setup.sh
.venv/bin/python -m pytest --numprocesses auto "$@"
