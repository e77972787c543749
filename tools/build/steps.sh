# Sourced by the scripts of tools/: goes to the project's root, and makes the steps they share.
cd "$(dirname "${BASH_SOURCE[0]}")/../.."

say() { printf '\n== %s\n' "$*"; }

# configure FOLDER [cmake option..]: quiet unless it fails or warns; says what became of CUDA. With VDB_NNS_WERROR=1, as those
# who work on this have it, warnings are errors.
configure() {
    local folder=$1
    shift
    mkdir -p "$folder"
    if ! cmake -S . -B "$folder" -G Ninja "$@" ${VDB_NNS_WERROR:+-DVDB_NNS_WERROR=ON} >"$folder/configure.log"; then
        cat "$folder/configure.log"
        return 1
    fi
    grep '^-- CUDA:' "$folder/configure.log" || true
}
