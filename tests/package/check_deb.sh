#!/usr/bin/env bash
# The .deb of `cpack` says what it is and needs, and holds what `cmake --install` installs, no more. That it can be installed
# and used is tried by tools/fresh_machines.sh, where there is nothing that it could spoil.
#   check_deb.sh CPACK CMAKE BUILD_DIR CONFIG WORK_DIR
# Exits with 77 (skipped) where nothing makes a .deb, or OpenVDB is of no package that it could depend on.
set -euo pipefail
export LC_ALL=C
cpack=$1 cmake=$2 build=$3 config=$4 work=$5
fail() { echo "FAILED: $*" >&2; exit 1; }

command -v dpkg-shlibdeps >/dev/null && command -v file >/dev/null ||
    { echo "SKIPPED: no dpkg-dev or no file here (tools/setup.sh --package)"; exit 77; }
openvdb=$(ldd "$build/vdb_nns" | sed -n 's/.*=> \(.*libopenvdb[^ ]*\).*/\1/p')
dpkg -S "$(readlink -f "$openvdb")" >/dev/null 2>&1 || { echo "SKIPPED: $openvdb is of no package"; exit 77; }
rm -rf "$work"
mkdir -p "$work"
"$cpack" -G DEB --config "$build/CPackConfig.cmake" -C "$config" -B "$work/cpack" >"$work/cpack.log" 2>&1 ||
    { cat "$work/cpack.log"; fail "cpack -G DEB"; }
debs=("$work"/cpack/*.deb)
deb=${debs[0]}
[ ${#debs[@]} -eq 1 ] && [[ "$(basename "$deb")" =~ ^vdb-nns_[0-9.]+_amd64\.deb$ ]] || fail "packages: ${debs[*]}"
echo "$(basename "$deb"): $(($(stat -c %s "$deb") / 1000)) kB"

dpkg-deb --field "$deb"
for package in libopenvdb-dev libblosc-dev libtbb-dev zlib1g-dev libdeflate-dev libboost-dev 'libopenvdb[0-9.]+(t64)?' 'libtbb[0-9]+(t64)?' 'libstdc\+\+6' libc6; do
    dpkg-deb --field "$deb" Depends | grep -qE "(^|, )$package( |,|$)" || fail "it does not depend on $package"
done

"$cmake" --install "$build" --config "$config" --prefix "$work/plain" >/dev/null
(cd "$work/plain" && find . -type f | sed 's|^\.|./usr|' | sort) >"$work/expected"
dpkg-deb --fsys-tarfile "$deb" | tar -t | grep -v '/$' | grep -v '^./usr/share/doc/vdb-nns/copyright$' | sort >"$work/found"
diff "$work/expected" "$work/found" || fail "the package differs from the plain install"
dpkg-deb --fsys-tarfile "$deb" | tar -t ./usr/share/doc/vdb-nns/copyright >/dev/null || fail "no licence where Debian looks"
rm -rf "$work"
echo "the package is whole"
