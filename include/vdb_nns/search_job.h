// A whole search in one call, from points to lists, as `vdb_nns search` runs it: on the CPU or on devices, within a limit of host
// memory, falling back to a smaller encoding if the lists do not fit.
#pragma once

#include "vdb_nns/measure.h"
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
    bool npz = false;            ///< neighbor lists
    bool vdb = false;            ///< points with attributes
    bool newGrid = false;        ///< in a grid that is made for them
    std::uint64_t keptBytes = 0; ///< of a point, of values that the new grid gets beside measures
};

/// An .npz file that is to be written while its rows are found.
struct NpzTarget {
    std::string path;
    ListForm form;
    OutputOptions output;
    bool checksum = false; ///< of all pairs, for the report
};

struct JobOptions {
    /// `encoding`: how lists are to be held. `hostMemoryBytes`: the most that the process may have resident, points and writers
    /// included; 0: the free memory, less a reserve for threads and writers.
    SearchOptions search;
    /// `estimate.radius` is not read: it is search.radius.
    DeviceOptions device;
    WrittenKinds written;
    /// Masks may take the place of index lists that do not fit, with the same pairs.
    bool mayUseMasks = false;
    /// Nobody reads the lists but writeJobNpz() and counts. Where index lists do not fit, only counts are kept, and the rows are
    /// found again as the file is written. If particles are not numbered along space, masks are tried first (mayUseMasks).
    bool mayStream = false;
    /// Nobody reads the lists but this file and counts. On the CPU, where index lists are asked for and particles are numbered
    /// about along space, rows go there as they are found, once, and nothing holds them; the job has written the file then.
    /// Else the caller writes it with writeJobNpz().
    std::optional<NpzTarget> npz;
    /// Measures to be made of the neighbors besides, by name (measure.h): of all queries, on the CPU. Where only counts are kept
    /// of the lists, in the pass that counts; else in one of their own. `measure.search` is not read.
    std::vector<std::string> measures;
    MeasureOptions measure;
};

/// What a job did. If it throws, `notes`, `settled` and `gridSeconds` tell how far it came; the rest is unspecified.
struct JobReport {
    double gridSeconds = 0;         ///< of all grids that were made
    double searchSeconds = 0;       ///< of all tries, without grids and plans
    std::optional<Plan> plan;       ///< of the last try; empty without devices
    std::optional<ScheduleRun> run; ///< of the last try; empty without devices
    double writeSeconds = 0;        ///< of JobOptions::npz, for what had to wait until all rows were found
    std::optional<double> measureSeconds; ///< of JobOptions::measures, if they took a pass of their own
    PointValues measured;                 ///< JobOptions::measures, by particle number of the queries' view
    std::vector<Measured::Skipped> measureSkipped;
    bool streamed = false;                 ///< the lists hold counts alone; see JobOptions::mayStream, npz
    bool written = false;                  ///< JobOptions::npz is
    std::optional<std::uint64_t> checksum; ///< of the lists that were written, if JobOptions::npz asks for it
    std::uint64_t streamBufferBytes = 0;   ///< for streamNpz()
    /// The options that it ended with. The next search of points like these starts there without trying what did not fit.
    JobOptions settled;
    /// What did not fit and what was done instead, a sentence each.
    std::vector<std::string> notes;
};

/// Runs the job with a temporary engine; see SearchEngine::findNeighbors().
/// @throws as that
NeighborLists findNeighbors(const ParticleView& view, double radius, const JobOptions& options,
                            JobReport& report);

/// What a job would do first: its grid, and the plan in full, also for the CPU alone.
struct JobPlan {
    SearchSets sets;
    SparseGrid
        grid; ///< of all particles; empty where they are not both queries and candidates within one radius
    Plan plan;
    /// Host memory of JobOptions::measures beside grid and lists, as a bound on it counts them: their values, the masses and
    /// attributes that these are made of, copies of those and of the positions, and what a .vdb takes to be written
    /// (JobOptions::written).
    std::uint64_t measureBytes = 0;
    double gridSeconds = 0;
};

/// Writes the lists of a job as .npz: writeNpz(), or streamNpz() where they are counts alone.
/// @param engine that made `lists`, or another that runs no search
/// @param report of the job that made `lists`
/// @throws as those; InvalidInput for counts that the report does not say to stream
void writeJobNpz(const std::string& path, SearchEngine& engine, const NeighborLists& lists,
                 const JobReport& report, const ListForm& form, const OutputOptions& output);

} // namespace vdb_nns
