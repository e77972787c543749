// The study of the model itself: what estimate, tree and schedule take of a run, and what leaving out what is not needed saves.
#pragma once

#include "bench/bench_points.h"
#include "bench/method_names.h"

#include <cstdint>
#include <string>
#include <vector>

namespace vdb_nns::cli {

/// One search, its steps and its memory. In core there is no model.
struct ModelShare {
    std::string scene;
    Encoding encoding = Encoding::kIndex;
    bool inCore = true;
    std::uint64_t points = 0, blocks = 0;
    double gridSeconds = 0, estimateSeconds = 0, treeSeconds = 0, scheduleSeconds = 0,
           searchSeconds = 0; ///< medians
    std::uint64_t structureBytes = 0, estimateBytes = 0, treeBytes = 0, scheduleBytes = 0, listBytes = 0;

    double modelSeconds() const { return estimateSeconds + treeSeconds + scheduleSeconds; }
};

/// A part that is left out where it is not needed: what the same result costs with it and without it.
struct Saving {
    std::string scene, part;
    std::string unit; ///< seconds or bytes
    double with = 0, without = 0;
};

struct ModelStudyOptions {
    MethodSetup setup; ///< with devices
    double radius = 0;
    std::uint64_t repeat = 5;
};

struct ModelStudy {
    std::vector<ModelShare> shares;
    std::vector<Saving> savings;
};

/// Out of core is with a tenth of the memory that all particles need as one block, on the first device; its search is wall time,
/// also on simulated devices, where a core stands for the device.
/// @throws Cancelled, CapacityError, DeviceError
ModelStudy studyModel(const BenchPoints& points, const ModelStudyOptions& options, const ProgressSpan& span);

} // namespace vdb_nns::cli
