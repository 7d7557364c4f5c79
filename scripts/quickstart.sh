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
cat <<END

Next, in $PWD:
  out/quickstart.png                  is the map to look at
  .venv/bin/atlas new                 lists the example scenes; .venv/bin/atlas new NAME copies one to change
  .venv/bin/atlas run SCENE           runs a scene, such as configs/stability_cylindrical.toml
  .venv/bin/atlas --help              lists the commands; docs/ and README.md explain them
  . .venv/bin/activate                makes "atlas" alone work in this shell
END
