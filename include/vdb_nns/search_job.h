// A whole search in one call, from points to lists, as `vdb_nns search` runs it: on the CPU or on devices, under a bound of
// host memory, and with another way of holding lists where the first does not fit.
#pragma once

#include "vdb_nns/neighbor_lists.h"
#include "vdb_nns/output.h"
#include "vdb_nns/particle_view.h"
#include "vdb_nns/planning/devices.h"
#include "vdb_nns/planning/plan.h"
#include "vdb_nns/point_file.h"
#include "vdb_nns/search.h"

#include <cstdint>
#include <optional>
#include <string>
#include <vector>

namespace vdb_nns {

/// What will be written of the lists, for the memory that writers need.
struct WrittenKinds {
    bool npz = false; ///< neighbor lists
    bool vdb = false; ///< points with attributes
};

struct JobOptions {
    /// `encoding`: how lists are to be held. `hostMemoryBytes`: the most that the process may have resident, points and writers
    /// included; 0: no bound but what is free, less what the threads and the writers need.
    SearchOptions search;
    DeviceOptions device;
    WrittenKinds written;
    /// Masks may take the place of index lists that do not fit, with the same pairs.
    bool mayUseMasks = false;
    /// The lists are made for an .npz alone: where none fit, counts are made, and writeJobNpz() makes the rows again as it
    /// writes them.
    bool mayStream = false;
};

/// What a job did.
struct JobReport {
    double gridSeconds = 0, searchSeconds = 0; ///< without planning
    std::optional<Plan> plan;                  ///< where there are devices
    std::optional<ScheduleRun> run;            ///< where there are devices
    bool streamed = false;                     ///< the lists hold counts alone; see JobOptions::mayStream
    std::uint64_t streamBufferBytes = 0;       ///< for streamNpz()
    /// The options that it ended with. The next search of points like these starts there without trying what did not fit.
    JobOptions settled;
    /// What did not fit and what was done instead, a sentence each.
    std::vector<std::string> notes;
};

/// The job by an engine of its own, for lists that are wanted once; see SearchEngine::findNeighbors().
/// @throws as that
NeighborLists findNeighbors(const ParticleView& view, double radius, const JobOptions& options,
                            JobReport& report);

/// What a job would do: its grid, and the plan in full, also for the CPU alone.
struct JobPlan {
    SparseGrid grid;
    Plan plan;
    double gridSeconds = 0;
};

/// Writes the lists of a job as .npz: writeNpz(), or streamNpz() where they are counts alone.
/// @param engine that made `lists`, or another that runs no search
/// @param report of the job that made `lists`
/// @throws as those
void writeJobNpz(const std::string& path, SearchEngine& engine, const NeighborLists& lists,
                 const JobReport& report, ListValues values, const OutputOptions& output);

} // namespace vdb_nns
