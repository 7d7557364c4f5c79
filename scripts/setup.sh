# Make the virtual environment .venv (if there is none) and install the package into it.
# Sourced by the other scripts from the repository root. The variable `extras` names extras of the package, such
# as [test]: a plain POSIX shell passes no arguments to a sourced file.
python=${PYTHON:-python3}
"$python" -c 'import sys; sys.exit(sys.version_info < (3, 11))' || {
    echo "Precession Atlas needs Python 3.11 or newer; set PYTHON to one" >&2
    exit 1
}
[ -x .venv/bin/python ] || "$python" -m venv .venv
echo "Installing Precession Atlas into .venv" >&2
.venv/bin/python -m pip install --quiet --disable-pip-version-check --editable ".${extras:-}"
