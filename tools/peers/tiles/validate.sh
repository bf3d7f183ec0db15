#!/bin/sh
# usage: validate.sh DIR|tileset.json [validate.mjs options]; non-zero exit when there are errors; last line = one JSON object with counts.
# A `3d-tiles-validator` that is already installed (node_modules/.bin or PATH) is run as well.
here=$(cd "$(dirname "$0")" && pwd); [ -n "$1" ] || { echo "usage: validate.sh DIR|tileset.json" >&2; exit 2; }
[ -d "$here/node_modules" ] || (cd "$here" && npm install --ignore-scripts --no-audit --no-fund >&2) || exit 2
t=$1; [ -d "$t" ] && t="$t/tileset.json"; rc=0
v="$here/node_modules/.bin/3d-tiles-validator"; [ -x "$v" ] || v=$(command -v 3d-tiles-validator || true)
if [ -n "$v" ]; then "$v" --tilesetFile "$t" | tee /dev/stderr | grep -q '"numErrors": 0' || rc=1; fi
node "$here/validate.mjs" "$@" || rc=1
exit $rc
