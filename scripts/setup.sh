#!/bin/sh
# Makes the virtual environment in $1 with the interpreter $2 and installs what requirements-dev.lock pins.
# Debian ships Python without ensurepip unless python3-venv is installed: then virtualenv or the system's pip will do.
set -e
venv=$1
python=$2

fail() {
    echo "gainroom setup: $1" >&2
    exit 1
}

"$python" -c 'import sys; sys.exit(sys.version_info < (3, 11))' 2>/dev/null ||
    fail "$python is missing or older than 3.11; name another one with: make PYTHON=python3.12"

echo "gainroom setup: installing into $venv (a minute or two, once) ..." >&2
rm -rf "$venv"
if "$python" -c 'import ensurepip, venv' 2>/dev/null; then
    "$python" -m venv "$venv"
elif "$python" -m virtualenv --version >/dev/null 2>&1; then
    "$python" -m virtualenv -q "$venv"
elif "$python" -m pip --version >/dev/null 2>&1 && "$python" -c 'import venv' 2>/dev/null; then
    "$python" -m venv --without-pip "$venv"
    "$python" -m pip --python "$venv/bin/python" install -q pip
else
    fail "this Python cannot make virtual environments; install python3-venv, or virtualenv for $python"
fi

"$venv/bin/python" -m pip install -q -r requirements-dev.lock
# Without the C++ core, which scripts/native.sh builds beside its sources.
"$venv/bin/python" -m pip install -q --no-deps --no-build-isolation --editable . \
    -C wheel.cmake=false -C wheel.py-api=py3 -C editable.mode=inplace
# Its import hook goes before PYTHONPATH, and another clone's sources would not be found: the path behind it in the file does as well.
for file in "$venv"/lib/python3*/site-packages/_editable_skbc_gainroom.pth; do
    grep -v '^import ' "$file" >"$file.tmp" && mv "$file.tmp" "$file"
done
