#!/bin/sh
# Builds the C++ core into src/gainroom/native, for the virtual environment in $1. What is missing comes as wheels, without root:
# cmake, and where there is no C++ compiler, zig's.
set -e
python=$(cd "$1" && pwd)/bin/python
build=build/native

fail() {
    cat "$build/log" >&2
    echo "gainroom setup: the C++ core could not be built: $1" >&2
    exit 1
}

mkdir -p "$build"
if ! cmake --version >/dev/null 2>&1; then
    "$python" -m pip install -q "cmake>=3.20"
    PATH=$(dirname "$python"):$PATH
fi
if [ -z "$CXX" ] && ! command -v c++ >/dev/null 2>&1; then
    echo "gainroom setup: no C++ compiler here; installing one (ziglang)" >&2
    "$python" -m pip install -q ziglang
    printf '#!/bin/sh\nexec "%s" -m ziglang c++ "$@"\n' "$python" >"$build/c++"
    chmod +x "$build/c++"
    CXX=$PWD/$build/c++
    export CXX
fi
echo "gainroom setup: compiling the C++ core (about a minute, after each change of it) ..." >&2
# As part of a wheel, whose own build directory in build/ the next wheel finds compiled.
CMAKE_BUILD_PARALLEL_LEVEL=2 "$python" -c "import scikit_build_core.build as b; b.build_wheel('$build')" >"$build/log" 2>&1 ||
    fail "the compiler stops"
echo "gainroom setup: the C++ core is built" >&2
rm -f src/gainroom/native/_core*.so
"$python" -m zipfile -e "$build"/*.whl "$build/wheel"
mv "$build"/wheel/gainroom/native/_core*.so src/gainroom/native/
rm -rf "$build"/*.whl "$build/wheel"
