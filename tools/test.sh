#!/usr/bin/env bash
# The whole suite: installs what is missing, builds everything, and runs ctest. Builds into build/ (Release, g++),
# build/asan (a selection under AddressSanitizer and UBSan) and build/clang (clang++, shared library).
# A second run builds nothing twice. The last lines are ctest's own.
#   tools/test.sh            all of it: under an hour on two cores
#   tools/test.sh --quick    every step of the engine, every format and the program once, with g++ alone: some minutes
set -euo pipefail
. "$(dirname "${BASH_SOURCE[0]}")/build/steps.sh"
started=$SECONDS
took() { echo "   ($((SECONDS - started)) s since the start)"; }

quick=0
case "${1:-} $#" in
' 0') ;;
'--quick 1') quick=1 ;;
*) echo "usage: tools/test.sh [--quick]" >&2; exit 2 ;;
esac

say "set-up"
tools/setup.sh --tests

release=(-DCMAKE_BUILD_TYPE=Release -DVDB_NNS_BUILD_TESTS=ON -DVDB_NNS_BUILD_SAMPLES=ON)
if [ $quick -eq 1 ]; then
    say "build into build/: Release, g++; the quick selection"
    configure build "${release[@]}"
    cmake --build build --target vdb_nns_quick_selection
    took
    say "the quick selection of the suite"
    ctest --test-dir build -j "$(nproc)" -L quick --output-on-failure --no-tests=error
    exit
fi

say "build into build/: Release, g++"
configure build "${release[@]}"
cmake --build build
took

say "build into build/clang: clang++, shared library and all that is not a test; the samples, and a minute of fuzzing"
configure build/clang -C tools/build/clang.cmake
cmake --build build/clang --target vdb_nns_cli samples/all vdb_nns_header_check vdb_nns_bridge_header_check \
    make_vdb_seeds libfuzzer_vdb
for label in samples libfuzzer; do
    ctest --test-dir build/clang -L "$label" --output-on-failure --no-tests=error
done
took

say "build into build/asan: AddressSanitizer and UBSan; the selection of the suite"
configure build/asan -C tools/build/asan.cmake
cmake --build build/asan --target vdb_nns_asan_selection
ASAN_OPTIONS=${ASAN_OPTIONS:-allocator_may_return_null=1} UBSAN_OPTIONS=${UBSAN_OPTIONS:-print_stacktrace=1} \
    ctest --test-dir build/asan -j "$(nproc)" -L asan --output-on-failure --no-tests=error
took

# The compiled kernels are tested by CUDA's disassembler, which a toolkit may lack.
export PATH="$PATH:/usr/local/cuda/bin:/opt/cuda/bin:$PWD/build/nvdisasm/nvidia/cu13/bin"
if command -v nvcc >/dev/null && ! command -v nvdisasm >/dev/null; then
    python3 -m pip install -q --disable-pip-version-check --root-user-action=ignore --target build/nvdisasm nvidia-cuda-nvdisasm ||
        echo "no nvdisasm: the test of the compiled kernels will be skipped"
fi

say "the suite"
VDB_NNS_REQUIRE_PEERS=1 ctest --test-dir build -j "$(nproc)" --output-on-failure --no-tests=error
