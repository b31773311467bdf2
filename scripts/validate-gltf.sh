#!/bin/sh
# Validates .glb and .gltf files: by Khronos' validator, then by loading them in three.js in headless Chromium, where every
# morph target is rendered and has to change the picture.
#
#   scripts/validate-gltf.sh FILE...
#
# Needs Node 20 and npm. CHROMIUM names a browser; without it, one comes from npm (@sparticuz/chromium, Linux x86-64).
# TOOLS is where the packages go [default: target/gltf-tools].
# PICTURES names a folder for what is drawn: NAME.glb.png.
set -eu
[ $# -gt 0 ] || { sed -n '2,9s/^# \{0,1\}//p' "$0" >&2; exit 1; }
here=$(CDPATH= cd -- "$(dirname -- "$0")" && pwd)
tools=${TOOLS:-$here/../target/gltf-tools}
mkdir -p "$tools"
[ -d "$tools/node_modules" ] || npm install --silent --no-audit --no-fund --prefix "$tools" \
    gltf-validator@2.0.0-dev.3.10 three@0.187.0 playwright-core@1.65.1 @sparticuz/chromium@147.0.0
cp "$here/validate-gltf.mjs" "$tools/validate-gltf.mjs"
exec node "$tools/validate-gltf.mjs" "$@"
