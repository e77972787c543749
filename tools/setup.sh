#!/usr/bin/env bash
# Installs what is missing to build vdb_nns: Debian 12 or 13 (Ubuntu 24.04 names its packages the same), as root or with sudo.
#   tools/setup.sh              what the build needs
#   tools/setup.sh --tests      and what the test suite needs
#   tools/setup.sh --package    and what cpack needs to make a .deb
#   tools/setup.sh --roots      and what tools/fresh_machines.sh needs
# Does nothing, in a moment, when all is there. A CUDA toolkit is used where there is one and never installed.
set -euo pipefail

packages=(g++ cmake ninja-build git
          libopenvdb-dev libblosc-dev libtbb-dev libboost-dev libeigen3-dev zlib1g-dev libdeflate-dev
          libcli11-dev nlohmann-json3-dev libnanoflann-dev)
for flag in "$@"; do
    case $flag in
    --tests)
        packages+=(clang libclang-rt-dev clang-format libgtest-dev libboost-context-dev
                   python3 python3-numpy python3-scipy python3-matplotlib dpkg-dev file) ;;
    --package) packages+=(dpkg-dev file) ;;
    --roots) packages+=(debootstrap) ;;
    *) echo "usage: tools/setup.sh [--tests] [--package] [--roots]" >&2; exit 2 ;;
    esac
done

if ! command -v apt-get >/dev/null || ! command -v dpkg-query >/dev/null; then
    echo "setup: no apt-get here; if the build misses something, install what these Debian packages hold:" >&2
    echo "       ${packages[*]}" >&2
    exit 0
fi

missing=()
installed=" $(dpkg-query -W -f '${Package}/${db:Status-Status} ' "${packages[@]}" 2>/dev/null || true)"
for package in "${packages[@]}"; do
    case "$installed" in
    *" $package/installed "*) ;;
    *) missing+=("$package") ;;
    esac
done
[ ${#missing[@]} -gt 0 ] || exit 0

as_root=()
if [ "$(id -u)" -ne 0 ]; then
    command -v sudo >/dev/null || { echo "setup: needs root or sudo to install: ${missing[*]}" >&2; exit 1; }
    as_root=(sudo)
    [ -t 0 ] || as_root+=(-n) # nobody there to type a password
fi
apt() { "${as_root[@]}" env DEBIAN_FRONTEND=noninteractive apt-get -q "$@" </dev/null; }

echo "setup: installing ${missing[*]}"
apt update
apt install -y --no-install-recommends "${missing[@]}"
