#!/bin/sh
# Checks dist/, which `make wheels` built with the interpreter $1: what the index would refuse, what the source distribution leaves out,
# the wheel in an empty environment, and its headers in a C++ program. Then whether the builders elsewhere read their files.
set -e
room=build/release
bin=$PWD/$room/tools/bin

rm -rf "$room"
mkdir -p "$room"
"$1" -m venv "$room/tools"
"$bin/pip" install -q abi3audit check-manifest cibuildwheel py-rattler-build twine "cmake>=3.20"
"$bin/twine" check --strict dist/*
"$bin/check-manifest"
for wheel in dist/*-abi3-*.whl; do
    [ ! -f "$wheel" ] || "$bin/abi3audit" --strict "$wheel"
done

"$1" -m venv "$room/empty"
for wheel in dist/*.whl; do
    "$room/empty/bin/pip" install -q "${wheel}[robot]"
done
"$room/empty/bin/pip" check
"$room/empty/bin/python" scripts/smoke.py examples/robot.xml

headers=$("$room/empty/bin/python" -c 'import gainroom.native; print(gainroom.native.include_dir())')
PATH=$bin:$PATH
cmake -S examples -B "$room/loop" -Dgainroom_DIR="$headers/../cmake" >"$room/cmake.log"
cmake --build "$room/loop" >>"$room/cmake.log"
"$room/loop/control_loop" | tail -1

for system in linux macos windows; do
    builds=$("$bin/cibuildwheel" --print-build-identifiers --platform $system .)
    echo "$system: $(echo "$builds" | tr '\n' ' ')"
done
"$bin/python" - <<'END'
from rattler_build import Stage0Recipe, VariantConfig

variants = VariantConfig({"python": ["3.13.*"], "c_stdlib": ["sysroot"], "c_stdlib_version": ["2.17"]})
(built,) = Stage0Recipe.from_file("recipe/recipe.yaml").render(variants)
print("recipe:", built.recipe.package.name, built.recipe.package.version)
END
echo "release: all checks passed; published is nothing"
