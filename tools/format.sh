#!/usr/bin/env bash
# Lays out the source by .clang-format. The result depends on the version, so one version judges: 14, that of Debian 12.
#   tools/format.sh           rewrites the files
#   tools/format.sh --check   says what is not laid out, and fails; with another version says so and checks nothing
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/.."

mode=(-i)
[ "${1:-}" != --check ] || mode=(--dry-run --Werror)

formatter=$(command -v clang-format-14 || command -v clang-format || true)
if [ -z "$formatter" ] || ! "$formatter" --version | grep -q 'version 14\.'; then
    echo "format: nothing done, it takes clang-format 14"
    exit 0
fi
find include src kernels tools tests samples -type f \
    \( -name '*.h' -o -name '*.cpp' -o -name '*.cu' -o -name '*.cuh' \) -print0 |
    xargs -0 "$formatter" "${mode[@]}"
