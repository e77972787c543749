# Sourced by the scripts of tools/: goes to the project's root, and makes the steps they share.
cd "$(dirname "${BASH_SOURCE[0]}")/../.."

say() { printf '\n== %s\n' "$*"; }

# configure FOLDER [cmake option..]: quiet unless it fails or warns; says what became of CUDA.
configure() {
    local folder=$1
    shift
    mkdir -p "$folder"
    if ! cmake -S . -B "$folder" -G Ninja "$@" >"$folder/configure.log"; then
        cat "$folder/configure.log"
        return 1
    fi
    grep '^-- CUDA:' "$folder/configure.log" || true
}
