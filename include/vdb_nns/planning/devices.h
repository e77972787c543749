// Which devices a search may use, and how its work is planned for them. Plain data, and the choice by name.
#pragma once

#include "vdb_nns/planning/executor.h"
#include "vdb_nns/planning/schedule.h"
#include "vdb_nns/planning/work_estimate.h"

#include <optional>
#include <string>
#include <vector>

namespace vdb_nns {

/// Devices, and how work is estimated, cut into blocks and handed out to them.
struct DeviceOptions {
    std::vector<DeviceLimits> devices; ///< none: the CPU alone, and nothing below is read
    EstimateOptions estimate;
    ScheduleOptions schedule;
    DeviceFailure onFailure = DeviceFailure::kStop;
    double auxNeighbors = 0;      ///< MemoryModel::auxNeighbors
    std::optional<double> margin; ///< MemoryModel::margin; none: from the error that the estimate measures
};

/// Sets the estimator and the reserve that suits it: the paper's 3.7 neighbors a particle with the
/// paper's estimate, none where the count is exact or fixed, else what the estimate's own error asks for.
void useEstimator(DeviceOptions& options, Estimator estimator);

/// Devices by name: "cpu" (none), "cuda" (all CUDA devices), "cuda:N" (one), "auto" (all CUDA devices, or none where there is
/// none or no driver; one that fails later is replaced by the CPU), "sim" or "sim:N" (one or N of simulatedDevice()).
/// Cost: opens every CUDA device that may be used, some tenths of a second each.
/// @param threads of the CPU beside them, for the schedule; 0: those of the TBB arena that the caller is in
/// @param leftOut why CUDA devices cannot be used; may be null
/// @throws InvalidInput for another name, DeviceError for a device that is not there or cannot be used
DeviceOptions chooseDevices(const std::string& name, int threads = 0,
                            std::vector<std::string>* leftOut = nullptr);

/// A simulated device: host memory under a budget that holds to the byte, and rates that say when it would be done.
/// @param model "" for 3 GiB and the default Rates; "gtx780" (the paper's) or "h200": published memory and link; tests at a
///        tenth of the published single precision peak at 8 operations a test, which is a model and not a measurement
/// @throws InvalidInput for another model
DeviceLimits simulatedDevice(const std::string& model = {});

} // namespace vdb_nns
