#!/usr/bin/env bash
# Measures of vdb_nns beside those of others, with two threads: `pca` and points::pca() of OpenVDB 13, `density` and splashsurf,
# `cluster` and DBSCAN of scikit-learn. Prints one table, and how far the values are apart.
#   tools/measure_peers.sh PREFIX FRAME [FOLDER]
# PREFIX: where OpenVDB 13 is installed. What 13.0.0 installs lacks headers: copy points/*.h and points/impl/*.h of its sources to
# PREFIX/include/openvdb. FRAME: data/dam_break_frame_23_24389_particles.bgeo of
# https://github.com/InteractiveComputerGraphics/splashsurf. FOLDER: for what is made, build/measure_peers by default; pysplashsurf
# and scikit-learn are installed there, from PyPI. The program is build/vdb_nns or $VDB_NNS. Takes some ten minutes.
set -euo pipefail
[ $# -ge 2 ] && [ $# -le 3 ] || { sed -n '2,8s/^# \{0,1\}//p' "$0" >&2; exit 2; }
prefix=$(cd "$1" && pwd) frame=$(realpath -e "$2")
cd "$(dirname "${BASH_SOURCE[0]}")/.."
folder=$(realpath -m "${3:-build/measure_peers}")
program=$(realpath -e "${VDB_NNS:-build/vdb_nns}")
pca=$prefix/include/openvdb/points/PrincipalComponentAnalysis.h
[ -f "$pca" ] || { echo "measure_peers: no $pca; see the head of this script" >&2; exit 2; }

mkdir -p "$folder"
cmake -S tools/measure_peers -B "$folder/build" -G Ninja -DCMAKE_BUILD_TYPE=Release -DOpenVDB_ROOT="$prefix" >&2
cmake --build "$folder/build" >&2
python=$folder/python/bin/python
[ -x "$python" ] || /usr/bin/python3 -m venv --system-site-packages "$folder/python"
"$python" -m pip install --quiet pysplashsurf scikit-learn >&2

"$program" --version | head -1
sed -n 's/^#define OPENVDB_LIBRARY_VERSION_STRING *"\(.*\)"/OpenVDB \1/p' "$prefix/include/openvdb/version.h"
"$python" -m pip list 2>/dev/null | grep -E '^(pysplashsurf|scikit-learn) '
echo
"$python" -B tools/measure_peers/measure_peers.py "$program" "$folder/build/pca_peer" "$frame" "$folder"
