#!/bin/sh
# Set up and build the pages of docs/ as a site, out/site/index.html; any warning is an error.
set -e
cd "$(dirname "$0")/.."
extras="[docs]"
. scripts/setup.sh
.venv/bin/python -m sphinx --fail-on-warning --keep-going --quiet -d out/doctrees docs out/site
echo "Open out/site/index.html" >&2
