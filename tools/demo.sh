#!/usr/bin/env bash
# From a fresh machine to neighbor lists: installs what is missing, builds Release into build/, makes a sample scene of
# a million particles, and searches it. A second run builds nothing and keeps the scene.
set -euo pipefail
. "$(dirname "${BASH_SOURCE[0]}")/build/steps.sh"

say "set-up"
tools/setup.sh
say "build into build/"
configure build -DCMAKE_BUILD_TYPE=Release
cmake --build build --target vdb_nns_cli

scene=build/demo/dam_break.vdb
if [ ! -f "$scene" ] || [ build/vdb_nns -nt "$scene" ]; then
    say "sample scene: vdb_nns scene dam_break -n 1000000 -o $scene"
    mkdir -p build/demo
    build/vdb_nns scene dam_break -n 1000000 -o "$scene" --force
fi
say "the main job: vdb_nns search $scene -o build/demo/lists.npz"
build/vdb_nns search "$scene" -o build/demo/lists.npz --checksum --force
