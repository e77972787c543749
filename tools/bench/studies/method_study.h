// The study of methods: each timed side by side with the others on the same points, and compared with the truth.
#pragma once

#include "bench/accuracy.h"
#include "bench/bench_points.h"
#include "bench/method_names.h"
#include "bench/truth.h"

#include <cstdint>
#include <exception>
#include <optional>
#include <string>
#include <vector>

namespace vdb_nns::cli {

struct BenchResult {
    std::string scene, method;
    MethodKind kind = MethodKind::kEngine;
    int threads = 0;
    std::uint64_t points = 0, pairs = 0;
    double radius = 0;
    std::uint64_t runs = 0;
    double gridSeconds = 0, searchSeconds = 0, totalSeconds = 0; ///< medians
    double minSeconds = 0, maxSeconds = 0;                       ///< of grid and search together
    double firstSeconds = 0;                                     ///< the first run, memory untouched
    std::uint64_t peakBytes = 0;  ///< of the process in the first run, the points included
    std::uint64_t addedBytes = 0; ///< of that, what the process did not have before
    std::uint64_t structureBytes = 0, listBytes = 0;
    std::uint64_t turn = 0; ///< methods of one turn ran interleaved; several where memory does not hold all
    std::optional<std::uint64_t> checksum; ///< of all pairs of an exact method; empty without rows
    AccuracyReport accuracy;
    std::optional<DeviceMeasures> device; ///< empty for a method of the CPU
    std::string message;                  ///< of a refusal; then there are no figures
    std::exception_ptr refusal;           ///< what it threw

    bool isPromisedExact() const { return kind == MethodKind::kEngine || kind == MethodKind::kDevice; }
    bool isExact() const { return accuracy.wrong() == 0 && accuracy.asymmetric.value_or(0) == 0; }
};

struct MethodStudyOptions {
    std::vector<MethodSpec> methods;
    MethodSetup setup;
    double radius = 0;
    int threads = 1;          ///< of methods without a number of their own
    std::uint64_t repeat = 5; ///< timed runs of each; one more warms up
};

/// One cold run of each by itself; then, in turns, all interleaved, so that a change of the machine's speed meets all of them.
/// Each is compared with the truth after its last run. One that refuses is reported with what it says, and the others go on.
/// @throws InvalidInput for a method of more threads than the study has; Cancelled, DeviceError
std::vector<BenchResult> studyMethods(const BenchPoints& points, const Truth& truth,
                                      const MethodStudyOptions& options, const ProgressSpan& span);

/// An exact method that finds other pairs than the first that has what is compared: their number, and their checksum; null if
/// all agree.
const BenchResult* firstThatDiffers(const std::vector<BenchResult>& results);

} // namespace vdb_nns::cli
