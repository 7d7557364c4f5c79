# Make the virtual environment .venv (if there is none) and install the package with the given extras.
# Sourced by the other scripts from the repository root: . scripts/setup.sh [EXTRAS]
python=${PYTHON:-python3}
"$python" -c 'import sys; sys.exit(sys.version_info < (3, 11))' || {
    echo "Precession Atlas needs Python 3.11 or newer; set PYTHON to one" >&2
    exit 1
}
[ -x .venv/bin/python ] || "$python" -m venv .venv
.venv/bin/python -m pip install --quiet --disable-pip-version-check --editable ".$1"
