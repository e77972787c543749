#!/usr/bin/env bash
# `cmake --install` bundles nothing: its program uses the libraries of the system, and an OpenVDB elsewhere where it was linked.
#   check_plain_install.sh CMAKE BUILD_DIR CONFIG WORK_DIR
set -euo pipefail
export LC_ALL=C
cmake=$1 build=$2 config=$3 prefix="$4/prefix"
fail() { echo "FAILED: $*" >&2; exit 1; }

rm -rf "$prefix"
"$cmake" --install "$build" --config "$config" --prefix "$prefix" >/dev/null
! find "$prefix" -name '*.so*' ! -name 'libvdb_nns.so*' | grep . || fail "bundled libraries"
! find "$prefix" -path '*/lib/vdb_nns*' -o -name INSTALL.txt | grep . || fail "files of the package in the install"
rpath=$(readelf -dW "$prefix/bin/vdb_nns" | sed -nE 's/.*(RPATH|RUNPATH).*\[(.*)\]/\2/p')
openvdb=$(dirname "$(ldd "$build/vdb_nns" | sed -n 's/.*=> \(.*libopenvdb[^ ]*\).*/\1/p')")
case $openvdb in
/lib/* | /usr/lib/*) [ -z "$rpath" ] || fail "the installed program has the rpath $rpath" ;;
*) [ "$rpath" = "$openvdb" ] || fail "the installed program has the rpath '$rpath', and its OpenVDB is in $openvdb" ;;
esac
"$prefix/bin/vdb_nns" --version >/dev/null || fail "the installed program does not start"
rm -rf "$prefix"
echo "nothing bundled"
