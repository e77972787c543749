#!/usr/bin/env bash
# The tests of the CUDA device on the GPU of this machine: all of them, and a selection under each tool of compute-sanitizer.
#   gpu_check.sh TEST_CUDA_GPU [FOLDER]   TEST_CUDA_GPU: the program of the `gpu` tests; FOLDER: for logs, gpu_check_results
# RUNS="tests memcheck racecheck initcheck synccheck" are the runs, all by default; SELECTION=FILTER takes other tests for
# compute-sanitizer, as --gtest_filter has it; LIMIT=SECONDS is for each run (900).
# One line for each run. Exit: 0; 1 if a test failed or none ran, or if a tool found something or is missing; 2 bad arguments.
set -uo pipefail
export LC_ALL=C VDB_NNS_REQUIRE_GPU=1

usage() { sed -n '2,6s/^# \{0,1\}//p' "${BASH_SOURCE[0]}"; }
case ${1:-} in
-h | --help) usage; exit 0 ;;
esac
if [ $# -lt 1 ] || [ $# -gt 2 ] || [ -z "$1" ]; then
    usage >&2
    exit 2
fi
program=$1 out=${2:-gpu_check_results} limit=${LIMIT:-900} bad=0
read -ra runs <<<"${RUNS:-tests memcheck racecheck initcheck synccheck}"
for run in "${runs[@]}"; do
    case $run in
    tests | memcheck | racecheck | initcheck | synccheck) ;;
    *) echo "gpu_check.sh: '$run' in RUNS is no run; there are tests, memcheck, racecheck, initcheck, synccheck" >&2; exit 2 ;;
    esac
done
# All encodings, reaches and boundaries on every distribution of points, rows that find no room, and undecided pairs.
selection=${SELECTION:-*EveryDistribution*:*RowsThatFindNoRoom*:*ALattice*}
if ! { [ -f "$program" ] && [ -x "$program" ]; }; then
    echo "gpu_check.sh: there is no program '$program'" >&2
    exit 2
fi
mkdir -p "$out" || exit 2

# judge NAME CODE: a line for a run by its log; a run without a passed test, or with a skipped one, is none.
judge() {
    local log=$out/$1.txt code=$2 passed verdict=ok found
    passed=$(sed -n 's/^\[  PASSED  \] \([0-9]*\) test.*/\1/p' "$log" | tail -n 1)
    found=$(grep -aoE '(ERROR|RACECHECK) SUMMARY: .*' "$log" | tail -n 1)
    if [ "$code" -eq 124 ] || [ "$code" -eq 137 ]; then
        verdict="FAILED: no end within $limit s"
    elif [ "$code" -ne 0 ] || [ "${passed:-0}" -eq 0 ] || grep -qa '^\[  SKIPPED \]' "$log"; then
        verdict="FAILED with $code"
    elif [ "$1" != tests ] && [[ "$found" != *"SUMMARY: 0 "* ]]; then
        verdict="FAILED: it found something, or did not say"
    fi
    printf '%-10s %s; %s tests passed%s; %s\n' "$1" "$verdict" "${passed:-0}" "${found:+; $found}" "$log"
    [ "$verdict" = ok ] || bad=1
}

sanitizer=$(command -v compute-sanitizer || true)
if [ -z "$sanitizer" ] && [ -x /usr/local/cuda/bin/compute-sanitizer ]; then
    sanitizer=/usr/local/cuda/bin/compute-sanitizer
fi
for tool in "${runs[@]}"; do
    if [ "$tool" = tests ]; then
        timeout -k 10 "$limit" "$program" >"$out/tests.txt" 2>&1
        judge tests $?
        continue
    fi
    if [ -z "$sanitizer" ]; then
        echo "$tool     FAILED: compute-sanitizer is missing, neither on PATH nor in /usr/local/cuda/bin"
        bad=1
        continue
    fi
    flags=(--tool "$tool" --error-exitcode 86)
    [ "$tool" = memcheck ] && flags+=(--leak-check full)
    # Of copies it would tell that the room for undecided pairs comes back with what was never written, and is never read.
    [ "$tool" = initcheck ] && flags+=(--check-api-memory-access no)
    timeout -k 10 "$limit" "$sanitizer" "${flags[@]}" "$program" "--gtest_filter=$selection" >"$out/$tool.txt" 2>&1
    judge "$tool" $?
done
exit $bad
