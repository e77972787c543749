#!/usr/bin/env bash
# Measures vdb_nns on this machine's CUDA device: that all devices agree, how fast they are, and what they are to be measured
# by. Prints one table; reports of every step, and the table as summary.json, go to a folder.
#   gpu_bench.sh [--tiny] [--only PART] [--host-memory SIZE] [FOLDER]    FOLDER: gpu_bench_results by default
# --tiny: sizes that prove nothing, for tests. --only: agreement, kernel, large, medium, scale (which needs medium's reports in FOLDER)
# or former. --host-memory: as vdb_nns has it, for machines whose memory grows as it is used, so that little is free at first. `former`
# compares with the program that has the former kernels, vdb_nns_former beside vdb_nns or $VDB_NNS_FORMER.
# The program is the one beside this script, or $VDB_NNS: VDB_NNS=build/vdb_nns tools/gpu_bench.sh results. summary.json comes
# once more as DEVICE-DATE.json, for docs/results. Takes under 8 minutes on an H200 with 16 cores. A step that fails or takes too
# long is said to have failed, and the others go on. Exit: 0; 1 if devices do not agree; 2 bad arguments or program; 5 no device.
set -uo pipefail
export LC_ALL=C

tiny=0 out=gpu_bench_results seen=0 only='' parts=(agreement kernel large medium scale former) host=()
while [ $# -gt 0 ]; do
    case $1 in
    --tiny) tiny=1 ;;
    --only) only=${2:-none} && shift ;;
    --host-memory) host=("$1" "${2:-}") && shift ;;
    -h | --help) sed -n '2,10s/^# \{0,1\}//p' "${BASH_SOURCE[0]}"; exit 0 ;;
    -*) echo "gpu_bench.sh: '$1' is not a flag; there are --tiny, --only and --host-memory" >&2; exit 2 ;;
    *) out=$1 seen=$((seen + 1)) ;;
    esac
    shift
done
if [ -n "$only" ]; then
    [[ " ${parts[*]} " == *" $only "* ]] || { echo "gpu_bench.sh: --only: '$only' is none of ${parts[*]}" >&2; exit 2; }
    parts=("$only")
fi
if [ -z "$out" ] || [ "$seen" -gt 1 ]; then
    echo "gpu_bench.sh: give one folder for the results" >&2
    exit 2
fi
here=$(cd "$(dirname "${BASH_SOURCE[0]}")" && pwd)
program=${VDB_NNS:-$here/vdb_nns} former=${VDB_NNS_FORMER:-$here/vdb_nns_former}
[[ "$program" == */* ]] || program=./$program # no program of PATH
if ! { [ -f "$program" ] && [ -x "$program" ]; }; then # a checkout has a folder of this name here
    echo "gpu_bench.sh: '$program' is no program; say where it is: VDB_NNS=build/vdb_nns tools/gpu_bench.sh results" >&2
    exit 2
fi
mkdir -p "$out" || exit 2
date=$(date -u +%Y-%m-%dT%H:%M:%SZ)

# Sizes: of scenes, of the device's memory for scenes out of core.
# What carries a bar is the median of `repeat` runs.
device=cuda:0 repeat=5 other_repeat=2 deadline=${DEADLINE:-460}
agree_count=500k coincident_count=5k agree_memory=8MiB
block_count=16M large_count=65.6M large_memory=3GiB medium=two_sources medium_count=16M medium_memory=768MiB
if [ $tiny -eq 1 ]; then
    repeat=1 other_repeat=1
    agree_count=400 coincident_count=150 agree_memory=40KB
    block_count=1k large_count=1500 large_memory=60KB
    medium=spray medium_count=1k medium_memory=40KB # has small leaves
fi

# ---- steps ------------------------------------------------------------------------------------------------------------

failed=() disagreeing=()
say() { echo "[$SECONDS s] $*" >&2; }

# step NAME LIMIT FLAG..: vdb_nns bench with these flags, its reports in the folder; at most LIMIT seconds, and never past
# the deadline of all. 0; 1 if the methods do not find the same, or not what is there; something else if nothing was measured.
step() {
    local name=$1 limit=$2 left=$((deadline - SECONDS)) code
    shift 2
    rm -f "$out/$name".{csv,json,txt}
    say "$name: bench $*"
    if [ "$left" -le 0 ]; then
        say "$name: no time is left"
        failed+=("$name")
        return 124
    fi
    timeout -k 5 "$((left < limit ? left : limit))" "$program" bench "$@" ${host[@]+"${host[@]}"} --progress never \
        --csv "$out/$name.csv" --json "$out/$name.json" --force >"$out/$name.txt" 2>&1
    code=$?
    [ $code -eq 0 ] && return 0
    say "$name: FAILED with $code: $(tail -n 1 "$out/$name.txt")"
    failed+=("$name")
    [ $code -eq 1 ] && disagreeing+=("$name")
    return $code
}

# get STEP METHOD COLUMN: a figure of the step's CSV; nothing if it is not there.
get() {
    [ -f "$out/$1.csv" ] || return 0
    awk -F, -v method="$2" -v column="$3" '
        NR == 1 { for (i = 1; i <= NF; ++i) if ($i == column) at = i }
        NR > 1 && $2 == method && at { print $at }' "$out/$1.csv"
}

# runs STEP METHOD: how many timed runs its figures are the medians of.
runs() { show 'n=%s' "$(get "$1" "$2" runs)"; }

# fact KEY: a text or number of the machine or its device, as the first step's JSON has it.
fact() {
    [ -f "$out/device.json" ] || return 0
    sed -n "s/^ *\"$1\": \"\{0,1\}\([^\"{\\\\]*[^\",{\\\\]\)\"\{0,1\},\{0,1\}\$/\1/p" "$out/device.json" | head -n 1
}

# link STEP KEY: a rate of the link, in GB/s.
link() {
    [ -f "$out/$1.json" ] || return 0
    sed -n "s/^ *\"$2\": \([0-9.e+-]*\),\{0,1\}\$/\1/p" "$out/$1.json" | head -n 1
}

# math FORMULA A B ..: of a, b, .. f; nothing if one of them is missing or the result is no number.
math() {
    local formula=$1 value names=(a b c d e f) assignments=() i=0
    shift
    for value in "$@"; do
        [ -n "$value" ] || return 0
        assignments+=(-v "${names[i++]}=$value")
    done
    awk "${assignments[@]}" "function max(x, y) { return x > y ? x : y }
        function min(x, y) { return x < y ? x : y }
        BEGIN { value = sprintf(\"%.6g\", $formula); if (value !~ /n/) printf \"%s\", value }" 2>/dev/null || true
}
# Whether A >= B, or A <= B: yes or no; no where there is nothing to compare.
at_least() { [ -n "$1" ] && awk -v a="$1" -v b="$2" 'BEGIN { print (a + 0 >= b + 0 ? "yes" : "no") }' || echo no; }
at_most() { [ -n "$1" ] && at_least "$2" "$1" || echo no; }
# show PATTERN VALUE..: as printf, or nothing if one is missing.
show() {
    local value
    for value in "${@:2}"; do [ -n "$value" ] || return 0; done
    # shellcheck disable=SC2059
    printf "$1" "${@:2}"
}

# ---- the table ----------------------------------------------------------------------------------------------------------

rows=()
print_row() { printf '| %-60s | %-28s | %-22s | %-7s | %s |\n' "$@"; }
# row KEY WHAT VALUE BAR REACHED NOTE [NUMBER]: prints it. No value: the step has failed.
row() {
    local value=$3 reached=$5 number=${7:-}
    if [ -z "$value" ]; then
        value=failed reached=no number=
    fi
    rows+=("$1"$'\t'"$2"$'\t'"$value"$'\t'"$4"$'\t'"$reached"$'\t'"${6:-}"$'\t'"$number")
    print_row "$2" "$value" "$4" "$reached" "${6:-}"
}

# "agree" is null if nothing is known to differ and not all was measured.
write_summary() {
    local agree=$agree cpu cores memory
    [ ${#disagreeing[@]} -eq 0 ] || agree=false
    cpu=$(fact cpu) cores=$(fact cores) memory=$(fact memory_bytes)
    {
        printf '{\n  "schema": 1,\n  "version": "%s",\n' "$("$program" --version | head -n 1 | tr -d \"\\\\)"
        printf '  "device": "%s",\n  "date": "%s",\n' "$device_name" "$date"
        printf '  "machine": {"cpu": "%s", "cores": %s, "memory_bytes": %s},\n' "${cpu:-unknown}" "${cores:-null}" "${memory:-null}"
        printf '  "tiny": %s,\n  "agree": %s,\n  "seconds": %d,\n' "$([ $tiny -eq 1 ] && echo true || echo false)" "$agree" \
            "$SECONDS"
        printf '  "failed_steps": ['
        local separator='' name
        for name in ${failed[@]+"${failed[@]}"}; do
            printf '%s"%s"' "$separator" "$name"
            separator=', '
        done
        printf '],\n  "rows": ['
        printf '%s\n' "${rows[@]}" | awk -F'\t' '{ printf "%s\n    {\"key\": \"%s\", \"what\": \"%s\", \"value\": \"%s\", \"number\": %s, \"bar\": \"%s\", \"reached\": \"%s\", \"note\": \"%s\"}", (NR > 1 ? "," : ""), $1, $2, $3, ($7 == "" ? "null" : $7), $4, $5, $6 }'
        printf '\n  ]\n}\n'
    } >"$out/summary${only:+_$only}.json"
    [ -n "$only" ] || cp "$out/summary.json" "$out/$kept"
}

# ---- what is measured ---------------------------------------------------------------------------------------------------

check_device() {
    local code
    step device 60 --scene block -n 300 --device $device --method in-core-mask --repeat 1 --sample 10
    code=$?
    case $code in
    2 | 5) tail -n 1 "$out/device.txt" >&2; exit 5 ;;
    126 | 127) echo "gpu_bench.sh: '$program' does not run: $(tail -n 1 "$out/device.txt")" >&2; exit 2 ;;
    esac
    device_name=$(fact device)
    device_name=${device_name:-unknown}
    # A name for docs/results.
    kept=$(printf '%s' "$device_name" | tr '[:upper:] ' '[:lower:]-' | tr -c 'a-z0-9._-' -)-${date%T*}.json
}

agree=null
measure_agreement() {
    local scene count code equal=0 scenes=(block dam_break two_sources sheet spray clusters lattice coincident outlier far seam)
    local differ=() missing=() methods=ours-mask,ours-index,in-core-mask,in-core-index,blocks-mask,both-auto-mask
    [ $tiny -eq 1 ] || methods+=,ours-count,in-core-count,mapped-mask,blocks-index,both-cpu-mask,both-cpu-index
    for scene in "${scenes[@]}"; do
        count=$agree_count
        [ "$scene" = coincident ] && count=$coincident_count
        step "agree_$scene" 40 --scene "$scene" -n "$count" --device $device --device-memory $agree_memory \
            --method "$methods" --repeat 1 --sample 50
        code=$?
        case $code in
        0) equal=$((equal + 1)) ;;
        1) differ+=("$scene") ;;
        *) missing+=("$scene") ;;
        esac
    done
    [ $equal -eq ${#scenes[@]} ] && agree=true
    row agreement "CPU = GPU = CPU + GPU, checksums" "$equal of ${#scenes[@]} scenes" equal \
        "$([ $agree = true ] && echo yes || echo no)" \
        "${differ[*]:+differ: ${differ[*]}; }${missing[*]:+not measured: ${missing[*]}; }$agree_count particles each" $equal
}

measure_kernel() {
    step kernel 90 --scene block -n $block_count --radius-factor 2 --device $device --repeat $repeat --sample 10 \
        --method in-core-mask,in-core-index,blocks-mask,blocks-index,ours-mask
    local encoding bar rate kernel link_ms tests_ms all_ms whole cut
    for encoding in mask index; do
        bar=30
        [ $encoding = index ] && bar=10
        rate=$(math a/1e9 "$(get kernel in-core-$encoding device_neighbors_per_second)")
        kernel=$(math a*1e3 "$(get kernel in-core-$encoding device_search_seconds)")
        row kernel_$encoding "kernel, in core, block $block_count, $encoding" "$(show '%.2f G neighbors/s' "$rate")" \
            "$bar G/s" "$(at_least "$rate" $bar)" "$(show 'kernel %.2f ms, %s' "$kernel" "$(runs kernel in-core-$encoding)")" "$rate"
    done
    kernel=$(math a*1e3 "$(get kernel in-core-mask device_search_seconds)")
    link_ms=$(math '1e-6 * (a / b + c / d)' "$(get kernel in-core-mask device_bytes_up)" "$(link kernel up_gbs)" \
        "$(get kernel in-core-mask device_bytes_down)" "$(link kernel down_gbs)")
    tests_ms=$(math '1e3 * a / b' "$(get kernel in-core-mask device_candidate_tests)" \
        "$(get kernel in-core-mask device_model_tests_per_second)")
    all_ms=$(math '1e3 * (a + b + c)' "$(get kernel in-core-mask device_upload_seconds)" \
        "$(get kernel in-core-mask device_search_seconds)" "$(get kernel in-core-mask device_download_seconds)")
    row kernel_floor "its floor, masks" "$(show '%.0f %% of the link' "$(math '100 * a / b' "$link_ms" "$all_ms")")" - - \
        "$(show 'bytes / link %.2f ms of upload + kernel + download %.2f ms, %s' "$link_ms" "$all_ms" \
            "$(runs kernel in-core-mask)")$(show '; a guess of the model, not measured: tests / assumed rate %.2f ms of kernel %.2f ms' \
            "$tests_ms" "$kernel")" "$(math 'a / b' "$link_ms" "$all_ms")"
    for encoding in mask index; do
        whole=$(get kernel in-core-$encoding device_makespan_seconds) cut=$(get kernel blocks-$encoding device_makespan_seconds)
        row cut_$encoding "the same at once over in blocks, $encoding" "$(show '%.2fx' "$(math a/b "$whole" "$cut")")" - - \
            "$(show 'at once %.1f ms, in %s blocks %.1f ms, copies of the host included, and %.1f ms to plan them, %s' \
                "$(math 'a * 1e3' "$whole")" "$(get kernel blocks-$encoding device_blocks)" "$(math 'a * 1e3' "$cut")" \
                "$(math '(a + b) * 1e3' "$(get kernel blocks-$encoding device_estimate_seconds)" \
                    "$(get kernel blocks-$encoding device_plan_seconds)")" \
                "$(runs kernel blocks-$encoding)")" "$(math a/b "$whole" "$cut")"
    done
    for encoding in index mask; do
        rate=$(math a/1e6 "$(get kernel in-core-$encoding device_particles_per_gib)")
        row per_gib_$encoding "particles per GiB in core, $encoding" "$(show '%.2f M' "$rate")" - - \
            "$(show 'peak %.0f MB' "$(math a/1e6 "$(get kernel in-core-$encoding device_peak_bytes)")")" "$rate"
    done
}

# The kernels before two edits, beside those of now: the same lists, in more or less time.
measure_former() {
    local encoding now before
    if [ ! -x "$former" ]; then
        say "former: SKIPPED, there is no program '$former'"
        return
    fi
    local flags=(--scene block -n "$block_count" --radius-factor 2 --device "$device" --repeat "$repeat" --sample 0
        --method in-core-mask,in-core-index,ours-mask)
    step now 60 "${flags[@]}"
    program=$former step former 60 "${flags[@]}"
    for encoding in mask index; do
        now=$(math 'a * 1e3' "$(get now in-core-$encoding device_search_seconds)")
        before=$(math 'a * 1e3' "$(get former in-core-$encoding device_search_seconds)")
        row former_$encoding "former kernels over those of now, block $block_count, $encoding" \
            "$(show '%.3fx' "$(math a/b "$before" "$now")")" 1 "$(at_least "$(math a/b "$before" "$now")" 1)" \
            "$(show 'former %.3f ms, now %.3f ms, %s' "$before" "$now" "$(runs now in-core-$encoding)")" "$(math a/b "$before" "$now")"
    done
}

# of METHOD COLUMN: of the large scene.
of() { get large "$1" "$2"; }

# link_share STEP METHOD SECONDS: per cent of the time that the link needs for the bytes, both directions at once.
link_share() {
    math '100 * max(1e-9 * a / b, 1e-9 * c / d) / e' "$(get "$1" "$2" device_bytes_up)" "$(link "$1" both_up_gbs)" \
        "$(get "$1" "$2" device_bytes_down)" "$(link "$1" both_down_gbs)" "$3"
}

# link_note STEP METHOD: where the time went.
link_note() {
    show '%.3f s in all: up %.3f, kernels %.3f, down %.3f; %.2f GB up, %.2f GB down; %s' \
        "$(get "$1" "$2" device_makespan_seconds)" "$(get "$1" "$2" device_upload_seconds)" \
        "$(get "$1" "$2" device_search_seconds)" "$(get "$1" "$2" device_download_seconds)" \
        "$(math a/1e9 "$(get "$1" "$2" device_bytes_up)")" "$(math a/1e9 "$(get "$1" "$2" device_bytes_down)")" \
        "$(runs "$1" "$2")"
}

measure_large() {
    local flags=(--scene two_sources -n "$large_count" --device "$device" --device-memory "$large_memory" --sample 10)
    local what="two_sources $large_count, $large_memory, masks" span share rate
    step large 180 "${flags[@]}" --repeat $repeat --method ours-mask,blocks-mask,both-auto-mask,mapped-mask
    step sizes 100 "${flags[@]}" --repeat $other_repeat \
        --method blocks-mask,blocks16-mask,blocks32-mask,blocks64-mask,in-core-mask
    span=$(of blocks-mask device_makespan_seconds)
    share=$(link_share large blocks-mask "$span")
    row link_share "$what: upload + search + download" "$(show '%.0f %% of the link' "$share")" '70 %' \
        "$(at_least "$share" 70)" "$(link_note large blocks-mask)" "$share"
    rate=$(math 'a / b / 1e6' "$(of blocks-mask points)" "$(of blocks-mask total_seconds)")
    row end_to_end "the same with host bucketing" "$(show '%.1f M queries/s' "$rate")" '60 M/s' "$(at_least "$rate" 60)" \
        "$(show 'grid %.3f s, plan %.3f s, search %.3f s, %s' "$(of blocks-mask grid_seconds)" \
            "$(math a+b "$(of blocks-mask device_estimate_seconds)" "$(of blocks-mask device_plan_seconds)")" \
            "$(of blocks-mask search_seconds)" "$(runs large blocks-mask)")" "$rate"
    report_mapped "$span"
    rate=$(math a/b "$(of ours-mask total_seconds)" "$(of blocks-mask total_seconds)")
    row over_all_cores "over all cores of the CPU" "$(show '%.2fx' "$rate")" - - \
        "$(show '%s threads: %.3f s; device: %.3f s, grid included, %s' "$(of ours-mask threads)" \
            "$(of ours-mask total_seconds)" "$(of blocks-mask total_seconds)" "$(runs large ours-mask)")" "$rate"
    report_block_sizes
    rate=$(of both-auto-mask device_over_lower_bound)
    row cpu_and_gpu "CPU + GPU: makespan over lower bound" "$(show '%.3f' "$rate")" 1.10 "$(at_most "$rate" 1.10)" \
        "$(show '%.3f s; CPU alone %.3f s, GPU alone %.3f s, boundary %s, %s' \
            "$(of both-auto-mask device_makespan_seconds)" "$(of ours-mask search_seconds)" "$span" \
            "$(of both-auto-mask device_boundary)" "$(runs large both-auto-mask)")" "$rate"
}

report_mapped() {
    local mapped ratio share
    mapped=$(of mapped-mask device_makespan_seconds)
    ratio=$(math a/b "$mapped" "$1")
    row over_mapped "over mapped host memory" "$(show '%.2fx' "$ratio")" - - \
        "$(show 'mapped %.3f s, blocks %.3f s; kernels %.3f s and %.3f s; %s' "$mapped" "$1" \
            "$(of mapped-mask device_search_seconds)" "$(of blocks-mask device_search_seconds)" \
            "$(runs large mapped-mask)")" "$ratio"
    # Its kernels read and write through the link at once.
    share=$(link_share large mapped-mask "$(of mapped-mask device_search_seconds)")
    # In core the same kernels do the same but for the link.
    row mapped_link "link rate of the mapped kernels" "$(show '%.0f %% of the link' "$share")" '60 %' \
        "$(at_least "$share" 60)" "$(show '%.2f GB/s up and down together, every byte counted once, %s' \
            "$(of mapped-mask device_kernel_gbs)" "$(runs large mapped-mask)")$(show '; in core the kernels take %.0f %% of the time, %s' \
            "$(math '100 * a / b' "$(get sizes in-core-mask device_search_seconds)" "$(of mapped-mask device_search_seconds)")" \
            "$(runs sizes in-core-mask)")" "$share"
}

report_block_sizes() {
    local size value='' note='' ratio
    for size in 16 32 64; do
        ratio=$(math a/b "$(get sizes blocks$size-mask device_makespan_seconds)" \
            "$(get sizes blocks-mask device_makespan_seconds)")
        [ -n "$ratio" ] || value=failed
        [ "$value" = failed ] || value+="$(show '%s^3 %.2f, ' $size "$ratio")"
        note+="$(show '%s^3 %.3f s of kernels, %s blocks; ' $size "$(get sizes blocks$size-mask device_search_seconds)" \
            "$(get sizes blocks$size-mask device_blocks)")"
    done
    [ "$value" = failed ] && value='' || value+='hierarchical 1'
    row block_sizes "time by size of blocks" "$value" - - "$note$(show 'hierarchical %.3f s, %s; %s' \
        "$(get sizes blocks-mask device_search_seconds)" "$(get sizes blocks-mask device_blocks)" \
        "$(runs sizes blocks-mask)")" "$ratio"
}

measure_medium() {
    local flags=(--scene "$medium" -n "$medium_count" --sample 10) one device_total ratio share
    local blocks=(--device "$device" --device-memory "$medium_memory" --repeat "$repeat")
    step medium 60 "${flags[@]}" "${blocks[@]}" --method blocks-mask,in-core-mask,ours-mask
    step medium_index 60 "${flags[@]}" "${blocks[@]}" --method blocks-index
    step one_core 90 "${flags[@]}" --repeat 1 -T 1 --method ours-mask
    share=$(link_share medium_index blocks-index "$(get medium_index blocks-index device_makespan_seconds)")
    row index_link_share "$medium $medium_count, $medium_memory, index: upload + search + download" \
        "$(show '%.3f s, %.0f %% of the link' "$(get medium_index blocks-index device_makespan_seconds)" "$share")" - - \
        "$(link_note medium_index blocks-index)" "$share"
    one=$(get one_core ours-mask total_seconds) device_total=$(get medium blocks-mask total_seconds)
    ratio=$(math a/b "$one" "$device_total")
    row over_one_core "over one core of the CPU" "$(show '%.1fx' "$ratio")" - - \
        "$(show '%s %s: %.3f s (%s), device %.3f s (%s), grid included; search alone %.1fx' $medium $medium_count "$one" \
            "$(runs one_core ours-mask)" "$device_total" "$(runs medium blocks-mask)" \
            "$(math a/b "$(get one_core ours-mask search_seconds)" "$(get medium blocks-mask search_seconds)")")" "$ratio"
}

# The same scene under budgets that it needs somewhat more than 1, 4 and 16 times: it is in blocks under each.
measure_scale() {
    local need times note='' value='' each first='' worst=0 span bytes blocks
    local flags=(--scene "$medium" -n "$medium_count" --sample 0 --device "$device" --method blocks-mask)
    # In core it takes what a rough estimate says, and somewhat below that what it really needs.
    need=$(get medium in-core-mask device_peak_bytes)
    if [ -n "$need" ] && step scale_need 45 "${flags[@]}" --repeat 1 --device-memory "$((need * 95 / 100))" &&
        [ "$(get scale_need blocks-mask device_in_core)" = true ]; then
        need=$(get scale_need blocks-mask device_peak_bytes)
    fi
    for times in 1 4 16; do
        span='' bytes='' blocks=''
        if [ -n "$need" ] && step "scale_$times" 45 "${flags[@]}" --repeat "$repeat" \
            --device-memory "$((need * 95 / 100 / times))"; then
            span=$(get "scale_$times" blocks-mask device_makespan_seconds)
            bytes=$(math 'a + b' "$(get "scale_$times" blocks-mask device_bytes_up)" \
                "$(get "scale_$times" blocks-mask device_bytes_down)")
            blocks=$(get "scale_$times" blocks-mask device_blocks)
        fi
        each=$(math '1e9 * a / b' "$span" "$bytes")
        [ "${blocks:-0}" -gt 1 ] || each='' # in core nothing overlaps, and it would be something else
        if [ $times -eq 1 ]; then
            first=$each
        elif [ -n "$worst" ]; then
            worst=$(math 'max(a / b, c)' "$each" "$first" "$worst")
        fi
        value+="$(show '%sx %.3f s, ' $times "$span")"
        note+="$(show '%sx %.3f GB in %s blocks, ' $times "$(math a/1e9 "$bytes")" "$blocks")"
    done
    [ -n "$worst" ] || value=''
    row scale "$medium $medium_count, 1x, 4x, 16x larger than the budget" "${value%, }" 'linear in bytes, 1.25' \
        "$(at_most "$worst" 1.25)" "${note}$(show 'most time a byte of 4x and 16x over that of 1x: %.2f, %s' "$worst" \
            "$(runs scale_16 blocks-mask)")" "$worst"
}

check_device
[ -n "$only" ] || print_row what value bar reached note
for part in "${parts[@]}"; do "measure_$part"; done
write_summary
printf 'link: up %.1f GB/s, down %.1f GB/s; both at once: up %.1f, down %.1f\n' "$(link device up_gbs)" "$(link device down_gbs)" \
    "$(link device both_up_gbs)" "$(link device both_down_gbs)"
[ ${#failed[@]} -eq 0 ] || echo "failed: ${failed[*]}"
[ ${#disagreeing[@]} -eq 0 ] || echo "methods disagree: ${disagreeing[*]}"
echo "$SECONDS s; reports in $out$([ -n "$only" ] || echo "; $out/$kept is for docs/results")"
[ ${#disagreeing[@]} -eq 0 ]
