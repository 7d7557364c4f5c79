#!/bin/sh
# Set up and run the tests, one process per processor; arguments go to pytest.
set -e
cd "$(dirname "$0")/.."
. scripts/setup.sh "[test]"
.venv/bin/python -m pytest --numprocesses auto "$@"
