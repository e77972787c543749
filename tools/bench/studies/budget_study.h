// The study of memory budgets: throughput, repeats and refusals where a device has less and less of what it would need.
#pragma once

#include "bench/bench_points.h"
#include "bench/method_names.h"

#include <cstdint>
#include <string>
#include <vector>

namespace vdb_nns::cli {

struct BudgetResult {
    std::string scene, device;
    bool isModel = false; ///< seconds of simulated devices
    Encoding encoding = Encoding::kIndex;
    double share = 1; ///< of what all particles need as one block
    std::uint64_t budgetBytes = 0, points = 0;
    std::string message; ///< of a refusal; empty where it ran
    std::uint64_t blocks = 0, overflows = 0, retries = 0, splits = 0, cpuParticles = 0;
    double seconds = 0; ///< median makespan
};

struct BudgetStudyOptions {
    MethodSetup setup; ///< with devices
    double radius = 0;
    std::uint64_t repeat = 3;
};

/// 100 % to 1 % of the need, for index lists and masks, on the first device alone.
/// @throws Cancelled, DeviceError
std::vector<BudgetResult> studyBudgets(const BenchPoints& points, const BudgetStudyOptions& options,
                                       const ProgressSpan& span);

} // namespace vdb_nns::cli
