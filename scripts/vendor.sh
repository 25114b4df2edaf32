#!/bin/sh
# Makes the pages' vendored scripts anew: uPlot as it is, of three.js what robot.js uses, of plotly the curves, bars and heat maps. Needs npm
# and the network; nothing else does.
set -e
package=$(cd "$(dirname "$0")/../src/gainroom" && pwd)
to=$package/app/static/vendor
work=$(mktemp -d); trap 'rm -rf "$work"' EXIT
cd "$work"
npm init -y >/dev/null
npm install --silent uplot@1.6.32 three@0.187.0 esbuild@0.28.2 plotly.js-cartesian-dist-min@4.1.1
cat > three.js <<'END'
export { Scene, PerspectiveCamera, WebGLRenderer, Group, Mesh, MeshStandardMaterial, MeshBasicMaterial, BoxGeometry, SphereGeometry, CylinderGeometry, CapsuleGeometry, BufferGeometry, BufferAttribute, Float32BufferAttribute, AmbientLight, DirectionalLight, HemisphereLight, Color, Vector3, Matrix4, Quaternion, AxesHelper, GridHelper, LineSegments, LineBasicMaterial, Box3, Sphere } from "three";
export { OrbitControls } from "three/addons/controls/OrbitControls.js";
END
made() { # NAME VERSION SOURCE
  { echo "// @ts-nocheck"; echo "// $1 $2, MIT: see $1.LICENSE; made by scripts/vendor.sh"
    npx esbuild "$3" --bundle --format=esm --minify --legal-comments=inline; } > "$to/$1.js"
  cp "node_modules/$1/LICENSE" "$to/$1.LICENSE"
}
made uplot 1.6.32 node_modules/uplot/dist/uPlot.esm.js
made three 0.187.0 three.js
cp node_modules/uplot/dist/uPlot.min.css "$to/uplot.css"
plotly=node_modules/plotly.js-cartesian-dist-min
{ echo "// @ts-nocheck"; echo "// plotly 4.1.1, MIT: see plotly.LICENSE; made by scripts/vendor.sh"
  cat "$plotly/plotly-cartesian.min.js"; } > "$package/report/vendor/plotly.js"
cp "$plotly/LICENSE" "$package/report/vendor/plotly.LICENSE"
