# Make the virtual environment .venv (if there is none) and install the package into it.
# Sourced by the other scripts from the repository root. The variable `extras` names extras of the package, such
# as "test docs": a plain POSIX shell passes no arguments to a sourced file. What is installed already is not installed
# again until pyproject.toml or the version changes.
python=${PYTHON:-python3}
"$python" -c 'import sys; sys.exit(sys.version_info < (3, 11))' || {
    echo "Precession Atlas needs Python 3.11 or newer; set PYTHON to one" >&2
    exit 1
}
if [ ! -x .venv/bin/python ]; then
    if "$python" -c 'import ensurepip' 2>/dev/null; then
        "$python" -m venv .venv
        # The pip that Python comes with takes twice as long to choose versions.
        .venv/bin/python -m pip install --quiet --no-compile --upgrade pip || true
    else  # Debian without python3-venv
        "$python" -m venv --without-pip .venv
    fi
fi

install_package() {
    package="."
    case " $missing " in *" package "*) set -- --editable ;; *) package=precession-atlas; set -- ;; esac  # extras alone
    set -- install --disable-pip-version-check --progress-bar off "$@" "$package${extras:+[$(echo "$extras" | tr ' ' ',')]}"
    # Python compiles the modules that it imports, a quarter of those that pip would compile.
    [ -n "${PYTHONDONTWRITEBYTECODE:-}" ] || set -- "$@" --no-compile
    if [ -x .venv/bin/pip ]; then
        PYTHONUNBUFFERED=1 .venv/bin/python -m pip "$@"
    else  # the pip of the system installs into .venv
        PYTHONUNBUFFERED=1 "$python" -m pip --python .venv/bin/python "$@"
    fi
}

version=$(cat pyproject.toml atlas/_version.py | cksum)
missing=""
for extra in package ${extras:-}; do
    grep -qxF -e "$extra $version" .venv/installed 2>/dev/null || missing="$missing $extra"
done
if [ -n "$missing" ]; then
    echo "Installing Precession Atlas into .venv; the first time this takes a minute or two" >&2
    # One short line for each package that pip fetches. The exit status of pip, which `sed` would hide, takes file
    # descriptor 3.
    status=$({ { install_package; echo $? >&3; } | sed -n \
        -e '/\.metadata/d' \
        -e 's/^ *Downloading \([^- ]*-[^- ]*\)-[^ ]*\.whl\(.*\)/  downloading \1\2/p' \
        -e 's/^ *Using cached \([^- ]*-[^- ]*\)-[^ ]*\.whl\(.*\)/  from the cache \1\2/p' \
        -e 's/^Installing collected packages:.*/  installing them/p' >&2; } 3>&1)
    [ "$status" = 0 ] || exit 1
    for extra in $missing; do echo "$extra $version"; done >>.venv/installed
fi
