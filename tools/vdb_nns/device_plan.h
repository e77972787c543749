// From what flags ask for to a plan, and to a search that follows it.
#pragma once

#include "device_options.h"
#include "progress_printer.h"
#include "report.h"
#include "vdb_nns/search.h"

namespace vdb_nns::cli {

enum class PlanDetail {
    kFull,    ///< the estimate that was asked for, whatever it is needed for
    kAsNeeded ///< a rough one where everything fits at once anyway
};

/// Estimate, tree and schedule.
/// @throws Cancelled, and as estimateWork(), buildWorkloadTree() and makeSchedule()
PlanReport makePlan(const SparseGrid& grid, DeviceRequest request, Encoding encoding, PlanDetail detail,
                    const ProgressSpan& span, SecondsReport& seconds);

/// A plan, and the search by it. Fills the report's plan and run.
/// @throws as makePlan() and SearchEngine::search() with a schedule
NeighborLists searchOnDevices(SearchEngine& engine, const SparseGrid& grid, const DeviceRequest& request,
                              const SearchOptions& options, const ProgressSpan& span, SearchReport& report);

} // namespace vdb_nns::cli
