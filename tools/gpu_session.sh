#!/usr/bin/env bash
# The first fifteen minutes on a GPU, in two calls: whether the kernels are right and how they run; then the table of gpu_bench.sh.
#   gpu_session.sh [--tiny] [--host-memory SIZE] 1|2 [FOLDER]    FOLDER: gpu_session by default; the flags are those of gpu_bench.sh
# 1, within 240 s: the machine; the tests of the device, and some of them under memcheck; the kernels beside the former ones, and 16 M
#    particles at once beside blocks; Nsight Compute on measuring, masks, counting and numbers; racecheck and synccheck.
# 2, within 480 s: agreement of all devices, masks and numbers in core, over the link, mapped, sizes of blocks, CPU + GPU, larger than the
#    budget.
# Needs what stands beside it in the archive of cpack, and says what it had to skip: nvidia-smi, nvcc, ncu and compute-sanitizer are the
# machine's. Each result is printed when it is there, and kept in two files of FOLDER, callN.txt and callN.tar.gz, after every step. A step
# that fails or takes too long does not stop the next. DEADLINE=SECONDS is for the call. Exit: 0; 1 if a step failed; 2 bad arguments.
set -uo pipefail
export LC_ALL=C

tiny=() host=() words=()
while [ $# -gt 0 ]; do
    case $1 in
    --tiny) tiny=(--tiny) ;;
    --host-memory) host=("$1" "${2:-}") && shift ;;
    -h | --help) sed -n '2,12s/^# \{0,1\}//p' "${BASH_SOURCE[0]}"; exit 0 ;;
    -*) echo "gpu_session.sh: '$1' is not a flag; there are --tiny and --host-memory" >&2; exit 2 ;;
    *) words+=("$1") ;;
    esac
    shift
done
call=${words[0]:-} out=${words[1]-gpu_session}
if [[ "$call" != [12] ]] || [ ${#words[@]} -gt 2 ] || [ -z "$out" ]; then
    echo "gpu_session.sh: say which call, 1 or 2, and one folder for the results" >&2
    exit 2
fi
here=$(cd "$(dirname "${BASH_SOURCE[0]}")" && pwd)
program=${VDB_NNS:-$here/vdb_nns} tests=${TEST_CUDA_GPU:-$here/test_cuda_gpu}
limits=(0 240 480)
deadline=${DEADLINE:-${limits[call]}} bad=0
mkdir -p "$out" || exit 2
said=$out/call$call.txt
: >"$said" || exit 2
logs=$(mktemp -d) || exit 2
trap 'rm -rf "$logs"' EXIT

say() { printf '[%3d s] %s\n' "$SECONDS" "$*" | tee -a "$said"; }
keep() { tar -czf "$logs.tar.gz" -C "$logs" . && mv "$logs.tar.gz" "$out/call$call.tar.gz"; }

# tool_path TOOL: its path, on PATH or where CUDA's toolkit stands; nothing if it is not there.
tool_path() {
    command -v "$1" && return
    [ ! -x "/usr/local/cuda/bin/$1" ] || echo "/usr/local/cuda/bin/$1"
}

# step NAME LIMIT COMMAND..: what it prints is a result; what else it says goes to a log. At most LIMIT seconds, and never past the
# deadline of all.
step() {
    local name=$1 limit=$2 left=$((deadline - SECONDS)) code
    shift 2
    if [ "$left" -lt 1 ]; then
        say "$name: SKIPPED, no time is left"
        bad=1
        return 1
    fi
    [ "$left" -gt "$limit" ] || limit=$left
    say "$name: at most $limit s"
    DEADLINE=$limit LIMIT=$limit timeout -k 5 "$((limit + 2))" "$@" 2>"$logs/$name.log" | tee -a "$said"
    code=${PIPESTATUS[0]}
    keep
    [ "$code" -eq 0 ] && return 0
    bad=1
    case $code in
    124 | 137) say "$name: FAILED, no end within $limit s" ;;
    *) say "$name: FAILED with $code$(tail -n 1 "$logs/$name.log" | sed 's/^/: /')" ;;
    esac
    return 1
}

# ---- the machine ----------------------------------------------------------------------------------------------------------

# A shell of its own, as one of these tools may hang.
machine='
    nvidia-smi --query-gpu=name,driver_version,compute_cap,memory.total,memory.free,clocks.max.sm,pcie.link.gen.max,pcie.link.width.max \
        --format=csv || echo "nvidia-smi: SKIPPED, it does not run"
    echo "$(nproc) cores, $(grep -m1 "model name" /proc/cpuinfo | sed "s/.*: //")"
    grep -E "MemTotal|MemAvailable" /proc/meminfo
    for tool in "$@"; do echo "$tool: $("$tool" --version 2>&1 | grep -iE "release|version|commit" | head -n 1)"; done'

# ---- Nsight Compute -------------------------------------------------------------------------------------------------------

# print_counters FILE: of each kernel in a raw table of ncu, what says how it runs.
print_counters() {
    awk '
        function split_row(line) { sub(/^"/, "", line); sub(/"\r?$/, "", line); return split(line, cell, "\",\"") }
        !/^"/ { next }
        !count {
            count = split_row($0)
            for (i = 1; i <= count; ++i) name[i] = cell[i]
            next
        }
        {
            split_row($0)
            kernel = ""
            for (i = 1; i <= count; ++i) if (name[i] == "Kernel Name") kernel = cell[i]
            if (kernel == "") next # units
            for (i = 1; i <= count; ++i) {
                if (name[i] ~ wanted && cell[i] != "") printf "%s: %s %s\n", kernel, name[i], cell[i]
            }
        }' wanted='^(gpu__time_duration.sum|sm(sp)?__inst_executed.sum|smsp__issue_active.avg.*|sm__warps_active.avg.pct.*|sm(sp)?__inst_executed_pipe_[a-z0-9_]+\\.(sum|avg\\.pct.*)|(gpu__)?dram_?_throughput.avg.pct.*)$' "$1"
}

profile() {
    local ncu count=2M
    ncu=$(tool_path ncu)
    if [ -z "$ncu" ]; then
        say "profile: SKIPPED, there is no ncu"
        return
    fi
    [ ${#tiny[@]} -eq 0 ] || count=1k
    local bench=("$program" bench --scene block -n "$count" --radius-factor 2 --device cuda:0 --repeat 1 --sample 0 --progress never
        --quiet ${host[@]+"${host[@]}"})
    local encoding
    for encoding in mask index; do
        # The warm-up's kernels, which are the same: measuring and masks, or counting and numbers.
        step "ncu_$encoding" 30 "$ncu" --clock-control none --kernel-name regex:searchGroupsKernel --launch-count 2 \
            --section SpeedOfLight --section InstructionStats --section SchedulerStats --section ComputeWorkloadAnalysis \
            --section Occupancy --csv --page raw --log-file "$logs/ncu_$encoding.csv" "${bench[@]}" --method "in-core-$encoding" || continue
        print_counters "$logs/ncu_$encoding.csv" | tee -a "$said"
    done
}

# ---- the two calls --------------------------------------------------------------------------------------------------------

bench() { step "$1" "$2" "$here/gpu_bench.sh" ${tiny[@]+"${tiny[@]}"} ${host[@]+"${host[@]}"} --only "$1" "$logs"; }

check() {
    if [ ! -x "$tests" ]; then
        say "$1: SKIPPED, there is no program '$tests'"
        return
    fi
    RUNS=$1 step "$1" "$2" "$here/gpu_check.sh" "$tests" "$logs"
}

call1() {
    local tools=("$program") tool path
    for tool in nvcc ncu compute-sanitizer; do
        path=$(tool_path $tool)
        if [ -n "$path" ]; then tools+=("$path"); else say "$tool: SKIPPED, it is not here"; fi
    done
    step machine 20 bash -c "$machine" machine "${tools[@]}"
    local scale=20
    [ ${#tiny[@]} -eq 0 ] || scale=1
    VDB_NNS_GPU_SCALE=$scale check tests 40
    export VDB_NNS_GPU_SCALE=1 SELECTION=${SELECTION:-*EveryDistribution*:*RowsThatFindNoRoom*}
    check memcheck 40
    bench former 50
    bench kernel 50
    profile
    check racecheck 40
    check synccheck 40
}

call2() {
    bench agreement 120
    bench kernel 60
    bench large 180
    bench medium 90
    bench scale 60
}

"call$call"
keep
say "done; ${said%.txt}.txt and .tar.gz are what to keep"
exit $bad
