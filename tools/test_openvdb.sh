#!/usr/bin/env bash
# Builds against an OpenVDB of your own, and runs the whole suite (Release, g++) with it.
#   tools/test_openvdb.sh PREFIX [BUILD_FOLDER]
# PREFIX: where that OpenVDB is installed. The folder is build/openvdb by default.
set -euo pipefail
[ $# -ge 1 ] && [ $# -le 2 ] || { sed -n '2,4s/^# \{0,1\}//p' "$0" >&2; exit 2; }
prefix=$(cd "$1" && pwd)
[ -f "$prefix/include/openvdb/version.h" ] || { echo "test_openvdb: no $prefix/include/openvdb/version.h" >&2; exit 2; }
. "$(dirname "${BASH_SOURCE[0]}")/build/steps.sh"
folder=${2:-build/openvdb}

say "set-up"
tools/setup.sh --tests
say "build into $folder, with the OpenVDB of $prefix"
export OpenVDB_ROOT=$prefix # for the tests, too, which build consumers
configure "$folder" -DCMAKE_BUILD_TYPE=Release -DVDB_NNS_BUILD_TESTS=ON -DVDB_NNS_BUILD_SAMPLES=ON
header=$(sed -n 's/^OpenVDB_INCLUDE_DIR:PATH=//p' "$folder/CMakeCache.txt")
[ -z "$header" ] || [ "$header" = "$prefix/include" ] || { echo "test_openvdb: configured with $header instead" >&2; exit 1; }
cmake --build "$folder"
say "the suite"
ctest --test-dir "$folder" --output-on-failure --no-tests=error
