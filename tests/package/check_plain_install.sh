#!/usr/bin/env bash
# `cmake --install` bundles nothing: its program uses the libraries of the system.
#   check_plain_install.sh CMAKE BUILD_DIR CONFIG WORK_DIR
set -euo pipefail
export LC_ALL=C
cmake=$1 build=$2 config=$3 prefix="$4/prefix"
fail() { echo "FAILED: $*" >&2; exit 1; }

rm -rf "$prefix"
"$cmake" --install "$build" --config "$config" --prefix "$prefix" >/dev/null
! find "$prefix" -name '*.so*' ! -name 'libvdb_nns.so*' | grep . || fail "bundled libraries"
! find "$prefix" -path '*/lib/vdb_nns*' -o -name INSTALL.txt | grep . || fail "files of the package in the install"
! readelf -dW "$prefix/bin/vdb_nns" | grep -E 'RPATH|RUNPATH' || fail "the installed program has an rpath"
rm -rf "$prefix"
echo "nothing bundled"
