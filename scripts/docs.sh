#!/bin/sh
# Set up and build the pages of docs/ as a site, out/site/index.html; any warning is an error.
set -e
cd "$(dirname "$0")/.."
extras="docs"
. scripts/setup.sh
mkdir -p out/pages
[ -f out/quickstart.nc ] || .venv/bin/atlas run configs/quickstart.toml -o out/quickstart.nc
.venv/bin/atlas page out/quickstart.nc -o out/pages/quickstart_page.html --force
cp docs/gallery/*_page.html out/pages/
for atlas in out/gallery/*.nc; do  # those that scripts/tools/gallery.py has computed
    page="out/pages/$(basename "$atlas" .nc)_page.html"
    [ ! -f "$atlas" ] || [ "$page" -nt "$atlas" ] || .venv/bin/atlas page "$atlas" -o "$page" --force
done
.venv/bin/python -m sphinx --fail-on-warning --keep-going --quiet -d out/doctrees docs out/site
echo "Open out/site/index.html" >&2
