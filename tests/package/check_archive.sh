#!/usr/bin/env bash
# The package of `cpack`, unpacked where there is nothing but the C library, gives what the build's own program gives.
#   check_archive.sh CPACK BUILD_DIR CONFIG PROGRAM WORK_DIR
# Exits with 77 (skipped) where the user may not chroot; as root that is a failure.
set -euo pipefail
export LC_ALL=C PATH="$PATH:/usr/sbin:/sbin" # chroot is there, off the path of many a user
cpack=$1 build=$2 config=$3 program=$4 work=$5
fail() { echo "FAILED: $*" >&2; exit 1; }

rm -rf "$work"
mkdir -p "$work"
"$cpack" -G TGZ --config "$build/CPackConfig.cmake" -C "$config" -B "$work/cpack" >"$work/cpack.log" 2>&1 ||
    { cat "$work/cpack.log"; fail "cpack"; }
grep -i -A3 warning "$work/cpack.log" || true
archives=("$work"/cpack/*.tar.gz)
archive=${archives[0]} name=$(basename "${archives[0]}" .tar.gz)
[ ${#archives[@]} -eq 1 ] && [[ "$name" =~ ^vdb_nns-[0-9.]+-linux-x86_64$ ]] || fail "archives: ${archives[*]}"
(cd "$work/cpack" && sha256sum --quiet -c "$name.tar.gz.sha256") || fail "the checksum beside the archive"
size=$(stat -c %s "$archive")
echo "$name.tar.gz: $((size / 1000)) kB"
[ "$size" -lt $((64 << 20)) ] || fail "the archive is too large"
! tar -tf "$archive" | grep -v "^$name/" || fail "files outside of the folder $name"

# The machine without libraries. Its /proc is a link that says who runs, which is what the loader makes $ORIGIN from.
root="$work/root"
mkdir -p "$root/proc/self" "$root/tmp" "$root/place one"
loader=$(readelf -lW "$program" | sed -n 's/.*interpreter: \(.*\)]/\1/p')
system=$(dirname "$(ldd "$program" | sed -n 's/.*libc\.so\.6 => \([^ ]*\).*/\1/p')")
mkdir -p "$root$(dirname "$loader")" "$root$system"
cp -L "$loader" "$root$loader"
for library in libc.so.6 libm.so.6 libpthread.so.0 libdl.so.2 librt.so.1; do
    cp -L "$system/$library" "$root$system/"
done
tar -xzf "$archive" -C "$root/place one"
package="$root/place one/$name"

find "$package" -type l -o -type f | sed "s|^$package/||" | sort >"$work/files"
for file in bin/vdb_nns bin/gpu_bench.sh bin/gpu_check.sh bin/gpu_session.sh share/vdb_nns/chart.py share/doc/vdb_nns/cli.md LICENSE README.md INSTALL.txt; do
    grep -qx "$file" "$work/files" || fail "no $file in the package"
done
! grep -vE '^(bin/vdb_nns(_former)?|bin/test_cuda_gpu|bin/gpu_(bench|check|session)\.sh|LICENSE|README\.md|INSTALL\.txt|lib/vdb_nns/lib[^/]*\.so[^/]*|share/doc/vdb_nns/.*|share/vdb_nns/(chart|charts/[a-z_]+)\.py)$' "$work/files" ||
    fail "files that nobody expected in the package"
! grep -E '/(ld-linux|lib(c|m|mvec|pthread|dl|rt|resolv)\.so)' "$work/files" || fail "parts of the C library in the package"

# One rpath, that of the program; nothing younger than the C library that INSTALL.txt names; stripped.
programs=()
for file in "$package"/bin/*; do
    [[ "$file" == *.sh ]] || programs+=("$file")
done
for binary in "${programs[@]}"; do
    rpath=$(readelf -dW "$binary" | grep -E 'RPATH|RUNPATH' || true)
    [[ "$rpath" =~ \(RPATH\)\ +'Library rpath: [$ORIGIN/../lib/vdb_nns]'$ ]] || fail "rpath of $binary: '$rpath'"
    ! readelf -SW "$binary" | grep -F .symtab || fail "$binary is not stripped"
done
for library in "$package"/lib/vdb_nns/*; do
    ! readelf -dW "$library" | grep -E 'RPATH|RUNPATH' || fail "$library has an rpath"
done
readelf -VW "${programs[@]}" "$package"/lib/vdb_nns/* >"$work/versions"
needed=$(grep -oE 'Name: GLIBC_[0-9.]+' "$work/versions" | sed 's/.*_//' | sort -V | tail -1)
named=$(sed -n 's/.*(glibc) \([0-9.]*\) or later.*/\1/p' "$package/INSTALL.txt")
echo "glibc: needs $needed, INSTALL.txt says $named"
[ "$(printf '%s\n' "$needed" "$named" | sort -V | tail -1)" = "$named" ] || fail "INSTALL.txt names too old a glibc"

# check_resolved FOLDER <loader's list: all libraries are in FOLDER but for the C library.
check_resolved() {
    local list
    list=$(cat)
    ! grep -F 'not found' <<<"$list" || fail "libraries that are not found"
    ! grep -F '=> ' <<<"$list" | grep -vF "=> $1/lib/vdb_nns/" | grep -vE '=> [^ ]*/(ld-linux-x86-64|lib(c|m|pthread|dl|rt))\.so' |
        grep . || fail "libraries from outside of $1"
    grep -qF "/lib/vdb_nns/libopenvdb" <<<"$list" || fail "OpenVDB is not among the libraries: $list"
}
# Here, where the system's own libraries are at hand, and a path of somebody's that would put them first.
ldd "$package/bin/vdb_nns" | sed "s|$package/bin/\.\.|$package|" >"$work/ldd"
check_resolved "$package" <"$work/ldd"
LD_LIBRARY_PATH=$system ldd "$package/bin/vdb_nns" | sed "s|$package/bin/\.\.|$package|" | check_resolved "$package"
echo "bundled: $(cd "$package/lib/vdb_nns" && ls | tr '\n' ' ')"

# Charts are drawn by the scripts of the package.
if /usr/bin/python3 -c 'import matplotlib' 2>/dev/null; then
    "$package/bin/vdb_nns" bench --scene block -n 2000 --method ours-index --study methods --repeat 1 --quiet \
        --chart "$work/charts.html" || fail "bench --chart of the package"
    grep -q '</html>' "$work/charts.html" || fail "charts.html is no whole page"
    [ -z "$(find "$package" -name __pycache__)" ] || fail "drawing charts wrote into the package"
else
    echo "not checked: charts of the package, as there is no Matplotlib here"
fi

if [ "$(id -u)" -eq 0 ]; then
    enter=(chroot "$root")
else
    enter=(unshare -r chroot "$root")
    why=$("${enter[@]}" "$loader" --version 2>&1 >/dev/null) ||
        { echo "SKIPPED: not root, and unshare -r chroot does not work here: $why"; exit 77; }
fi

checksum() { sed -n 's/^ *"checksum": "\([0-9a-f]\{16\}\)".*/\1/p' "$1"; }
"$program" scene block -n 20000 -o "$work/b.vdb" --quiet
"$program" search "$work/b.vdb" --checksum -o "$work/b.npz" --json "$work/expected.json" --quiet
expected=$(checksum "$work/expected.json")
[ -n "$expected" ] || fail "no checksum from $program"

# loaded COMMAND..: the libraries that it has loaded by its end, those included that others load by name while they run,
# but for the driver of a GPU, which is the machine's.
loaded() {
    LD_DEBUG=files "$@" 2>&1 >/dev/null | sed -n 's|/bin/\.\./|/|; s/.*calling init: //p' |
        grep -vE '/lib(cuda|nvidia-[^/]*)\.so' | sort -u
}
loaded "$package/bin/vdb_nns" search "$work/b.vdb" --device cpu --quiet >"$work/loaded"
sed 's/^/=> /' "$work/loaded" | check_resolved "$package"
diff <(loaded "$program" search "$work/b.vdb" --device cpu --quiet | sed 's|.*/||' | sort) <(sed 's|.*/||' "$work/loaded" | sort) ||
    fail "the package does not load the libraries that $program loads"

# try FOLDER [STARTED]: runs the program of FOLDER, as STARTED if given, inside of the other root.
try() {
    local binary="$1/bin/vdb_nns" start=${2:-$1/bin/vdb_nns}
    ln -sfn "$binary" "$root/proc/self/exe"
    inside() { env -i "PATH=$PATH" "${enter[@]}" "$@"; }
    inside "$loader" --list "$binary" | sed "s|$1/bin/\.\.|$1|" | check_resolved "$1"
    inside "$start" --version >"$work/version"
    "$program" --version | cmp - "$work/version" || fail "--version of $start differs from that of $program"
    rm -f "$root"/tmp/*
    inside "$start" scene block -n 20000 -o /tmp/b.vdb --quiet
    inside "$start" search /tmp/b.vdb --checksum -o /tmp/b.npz --json - >"$work/found.json" 2>"$work/found.err"
    [ "$(checksum "$work/found.json")" = "$expected" ] || fail "checksum of $start: $(cat "$work/found.json")"
    cmp "$root/tmp/b.npz" "$work/b.npz" || fail "the lists of $start differ from those of $program"
    if [ -e "$root/$1/bin/test_cuda_gpu" ]; then # which lists its tests where there is no GPU
        ln -sfn "$1/bin/test_cuda_gpu" "$root/proc/self/exe"
        inside "$1/bin/test_cuda_gpu" --gtest_list_tests | grep -q EveryDistribution || fail "test_cuda_gpu does not run"
    fi
    echo "works: '$start', checksum $expected"
}
try "/place one/$name"
mkdir -p "$root/opt" "$root/usr/bin"
mv "$package" "$root/opt/moved"
try /opt/moved
ln -s ../../opt/moved/bin/vdb_nns "$root/usr/bin/vdb_nns"
try /opt/moved /usr/bin/vdb_nns
rm -rf "$root" "$work/cpack/_CPack_Packages"
echo "the package works"
