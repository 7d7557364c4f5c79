#!/bin/sh
# Build the wheel and the source distribution, check what is in them, and run a scene from the wheel alone.
# Everything is made in a temporary folder; with the argument FOLDER the two files are left there: sh scripts/package.sh dist
set -e
cd "$(dirname "$0")/.."
python=${PYTHON:-python3}
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
"$python" -m venv "$folder/build"
"$folder/build/bin/python" -m pip install --quiet --disable-pip-version-check \
    build check-wheel-contents twine "validate-pyproject[all]"
"$folder/build/bin/validate-pyproject" pyproject.toml
"$folder/build/bin/python" -m build --outdir "$folder/dist" .
"$folder/build/bin/python" -m twine check --strict "$folder"/dist/*
"$folder/build/bin/check-wheel-contents" "$folder"/dist/*.whl
"$python" scripts/tools/check_packages.py "$folder/dist"
[ -z "$1" ] || { mkdir -p "$1" && cp "$folder"/dist/* "$1"; }
"$python" -m venv "$folder/user"
"$folder/user/bin/python" -m pip install --quiet --disable-pip-version-check "$folder"/dist/*.whl
cp configs/quickstart.toml "$folder"
cd "$folder"
user/bin/atlas run quickstart.toml -o night/
user/bin/python -c "import xarray; print(xarray.open_dataset('night/').atlas.fractions())"
