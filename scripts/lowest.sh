#!/bin/sh
# Runs the quick tests with the oldest versions that pyproject.toml allows, under the interpreter of the environment in $1 and with its
# C++ core. First a joint with the base install alone: some extras ask for newer versions of what it needs.
set -e
python=$(cd "$1" && pwd)/bin/python
room=build/lowest

rm -rf "$room"
mkdir -p "$room"
"$python" -m venv "$room/tools"
"$room/tools/bin/pip" install -q uv
for kind in base dev; do
    [ $kind = base ] && extra= || extra=--extra=dev
    "$room/tools/bin/uv" venv -q --python "$python" "$room/$kind"
    # shellcheck disable=SC2086  # no extra is no word
    "$room/tools/bin/uv" pip compile -q --resolution lowest-direct --python "$room/$kind/bin/python" $extra -o "$room/$kind.txt" pyproject.toml
    "$room/tools/bin/uv" pip install -q --python "$room/$kind/bin/python" -r "$room/$kind.txt"
done
export PYTHONPATH="$PWD/src"
"$room/base/bin/python" scripts/smoke.py
"$room/dev/bin/python" -m pytest -n 2 --dist worksteal -q -m "not slow" \
    --deselect tests/test_packaging.py::test_the_lock_serves_every_python_that_the_project_does # of what the lock installs
