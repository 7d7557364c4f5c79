#!/bin/sh
# Set up and run the quickstart atlas: out/quickstart.nc and its map, out/quickstart.png and .pdf.
set -e
cd "$(dirname "$0")/.."
extras=""
. scripts/setup.sh
mkdir -p out
.venv/bin/atlas run configs/quickstart.toml -o out/quickstart.nc --force
.venv/bin/atlas compare out/quickstart.nc
.venv/bin/atlas map out/quickstart.nc --force
