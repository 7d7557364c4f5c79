#!/bin/sh
# Build the wheel and the source distribution, check what is in them, and run a scene from the wheel alone.
# Everything is made in a temporary folder.
set -e
cd "$(dirname "$0")/.."
python=${PYTHON:-python3}
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
"$python" -m venv "$folder/build"
"$folder/build/bin/python" -m pip install --quiet --disable-pip-version-check build twine
"$folder/build/bin/python" -m build --outdir "$folder/dist" .
"$folder/build/bin/python" -m twine check --strict "$folder"/dist/*
"$python" scripts/tools/check_packages.py "$folder/dist"
"$python" -m venv "$folder/user"
"$folder/user/bin/python" -m pip install --quiet --disable-pip-version-check "$folder"/dist/*.whl
cp configs/quickstart.toml "$folder"
cd "$folder"
user/bin/atlas run quickstart.toml -o night/
user/bin/python -c "import xarray; print(xarray.open_dataset('night/').atlas.fractions())"
