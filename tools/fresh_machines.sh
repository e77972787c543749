#!/usr/bin/env bash
# Proves what a stranger needs: tries this commit on a bare Debian 12 and a bare Debian 13, root file systems that debootstrap
# makes, with git and nothing else. Needs root (chroot, mount), and says so where it is not. In each of them:
#   demo.sh, the README's first command: on Debian 12 as root, on Debian 13 as a user with sudo; no compiler may warn
#   on Debian 13 test.sh, its second command: the quick selection, or all of it with --full
#   the .deb of cpack, in a second bare root: installed with what it depends on alone, the program run, the samples built
#
#   tools/fresh_machines.sh [--full] [--keep FOLDER] [RELEASE..]
# RELEASE: bookworm (Debian 12), trixie (Debian 13); both by default. --keep leaves the roots in FOLDER, and takes over a bare
# root that is there already. The commit is tried, not the working tree. Exit: 0; 1 if something failed or cannot be tried.
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/.."
export LC_ALL=C PATH="$PATH:/usr/sbin:/sbin"

full=0 folder='' releases=()
while [ $# -gt 0 ]; do
    case $1 in
    --full) full=1 ;;
    --keep) folder=${2:?--keep takes a folder}; shift ;;
    bookworm | trixie) releases+=("$1") ;;
    *) sed -n '/^#   tools/,/^set/s/^# \{0,1\}//p' "${BASH_SOURCE[0]}" >&2; exit 2 ;;
    esac
    shift
done
[ ${#releases[@]} -gt 0 ] || releases=(bookworm trixie)
mirror=${DEBIAN_MIRROR:-http://deb.debian.org/debian}

cannot() { echo "fresh_machines: NOT TRIED: $*" >&2; exit 1; }
say() { printf '\n== %s (%s s)\n' "$*" "$SECONDS"; }

[ "$(id -u)" -eq 0 ] || cannot "it takes root, for debootstrap and chroot"
# A mount namespace of its own: whatever happens, no mount is left behind.
if [ -z "${VDB_NNS_OWN_MOUNTS:-}" ]; then
    why=$(unshare --mount true 2>&1) || cannot "no mount namespace can be made here: $why"
    again=("$0" ${folder:+--keep "$folder"} "${releases[@]}")
    [ $full -eq 0 ] || again+=(--full)
    VDB_NNS_OWN_MOUNTS=1 exec unshare --mount --propagation private bash "${again[@]}"
fi
tools/setup.sh --roots
if [ -z "$folder" ]; then
    folder=$(mktemp -d)
    trap 'umount -R "$folder"/*/proc 2>/dev/null || true; rm -rf --one-file-system "$folder"' EXIT
fi
mkdir -p "$folder"

# bare RELEASE: the root file system of a machine with git and sudo alone, in $folder/RELEASE-bare.
bare() {
    local root="$folder/$1-bare"
    [ ! -e "$root/made" ] || return 0
    rm -rf --one-file-system "$root"
    debootstrap --variant=minbase --include=ca-certificates,git,sudo "$1" "$root" "$mirror" >"$folder/$1-debootstrap.log" 2>&1 ||
        { tail -n 20 "$folder/$1-debootstrap.log" >&2; cannot "debootstrap of $1 failed"; }
    chroot "$root" useradd --create-home --shell /bin/bash user
    echo 'user ALL=(ALL) NOPASSWD: ALL' >"$root/etc/sudoers.d/user"
    touch "$root/made"
}

# copy_of RELEASE NAME: a copy of the bare root, with /proc; prints where it is.
copy_of() {
    local root="$folder/$1-$2"
    rm -rf --one-file-system "$root"
    cp -a --reflink=auto "$folder/$1-bare" "$root"
    mount -t proc proc "$root/proc"
    echo "$root"
}

# within ROOT USER COMMAND: a login there, which knows nothing of the machine around it.
within() {
    chroot "$1" env -i HOME="$(chroot "$1" sh -c "echo ~$2")" USER="$2" TERM=dumb PATH=/usr/sbin:/usr/bin:/sbin:/bin \
        setpriv --reuid "$2" --regid "$2" --init-groups bash -euc "cd; $3" </dev/null
}

# without_warnings ROOT USER COMMAND: the same; fails where a compiler warns.
without_warnings() {
    local log="$1.log"
    within "$@" 2>&1 | tee "$log"
    ! grep -EA5 '^[^ ]+:[0-9]+:[0-9]+: warning:' "$log" >&2 || { echo "fresh_machines: a compiler warns" >&2; return 1; }
}

for release in "${releases[@]}"; do
    user=root
    [ "$release" = bookworm ] || user=user
    say "$release: a bare root file system"
    bare "$release"
    root=$(copy_of "$release" built)
    home=$(chroot "$root" sh -c "echo ~$user")
    git clone -q --no-hardlinks . "$root$home/vdb_nns"
    chroot "$root" chown -R $user: "$home/vdb_nns"

    say "$release, as $user: ./tools/demo.sh"
    without_warnings "$root" $user "cd vdb_nns; ./tools/demo.sh"
    if [ "$release" = trixie ]; then
        flag=--quick
        [ $full -eq 0 ] || flag=
        say "$release, as $user: ./tools/test.sh $flag"
        without_warnings "$root" $user "cd vdb_nns; ./tools/test.sh $flag"
    fi

    say "$release: the .deb"
    within "$root" $user "cd vdb_nns; tools/setup.sh --package; cmake build >/dev/null; cmake --build build --target vdb_nns_cli
        cpack -G DEB --config build/CPackConfig.cmake -B build/packages"
    machine=$(copy_of "$release" installed)
    cp "$root$home"/vdb_nns/build/packages/*.deb "$machine/tmp/"
    cp -a samples "$machine/tmp/samples"
    within "$machine" root "apt-get -q update; apt-get -q install -y --no-install-recommends /tmp/*.deb"
    within "$machine" user "vdb_nns scene dam_break -n 20000 -o dam.vdb; vdb_nns search dam.vdb -o dam.npz --checksum"
    say "$release: a consumer of the .deb"
    within "$machine" root "apt-get -q install -y --no-install-recommends g++ cmake make"
    within "$machine" user "cmake -S /tmp/samples -B consumer; cmake --build consumer --parallel; ctest --test-dir consumer --output-on-failure --no-tests=error"
    umount "$root/proc" "$machine/proc"
done
say "fresh machines: ${releases[*]}: passed"
