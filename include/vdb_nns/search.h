// The search: all steps in one call, each step by itself, and an engine that keeps its buffers.
#pragma once

#include "vdb_nns/lattice.h"
#include "vdb_nns/neighbor_lists.h"
#include "vdb_nns/particle_set.h"
#include "vdb_nns/particle_view.h"
#include "vdb_nns/search_options.h"
#include "vdb_nns/search_sets.h"
#include "vdb_nns/sparse_grid.h"

#include <functional>
#include <memory>
#include <string>
#include <vector>

namespace vdb_nns {

struct Schedule;
struct DeviceLimits;
struct RunOptions;
struct ScheduleRun;
struct JobOptions; // search_job.h
struct JobReport;
struct JobPlan;
struct MeasureOptions; // measure.h
struct Measured;

/// Called once for every query that is finite and near any candidate, with its number, its neighbors and their
/// world distances (of two views with one transform as ParticleView::distance()), in cell-visiting order. Called from several threads at once; the spans are valid
/// during the call. A visitor may run parallel work of its own, and searches with other engines: until it
/// returns, its thread is given no other query.
using NeighborVisitor = std::function<void(std::uint32_t query, Span<const std::uint32_t> neighbors,
                                           Span<const double> distances)>;

/// The same without distances, which cost more to compute than neighbors cost to find.
using RowVisitor = NeighborLists::RowVisitor;

/// What the last run did: for reports. Measures see some pairs in one order only; which ones depends on threads.
struct SearchStatistics {
    double gridSeconds = 0, searchSeconds = 0;
    std::uint64_t doublePairs = 0;       ///< ordered pairs that the float32 filter left to the double test
    std::uint64_t exactPairs = 0;        ///< of those, pairs that the double test left to exact arithmetic
    SimdLevel simd = SimdLevel::kScalar; ///< instruction set that ran
};

/// Finds neighbors, frame after frame. An engine keeps its memory between runs, and reuses it once the
/// results of an earlier run are gone. It works inside the TBB arena of its caller.
///
/// Threads: one thread at a time may call an engine, and nobody may call it while it runs, not even a visitor
/// of its own. Every function of the library may be called inside TBB tasks; while a thread waits in such a
/// call, it runs none of the caller's other tasks. So one engine for each thread, as in
/// tbb::enumerable_thread_specific<SearchEngine>, serves frames in a parallel loop. Visitors and a Progress
/// may run parallel work of their own.
///
/// Membership, in all functions here: i and j are neighbors iff i != j and their distance is <= radius in
/// real arithmetic; no rounding decides. A particle is excluded from its own list by number, so particles at
/// the same place are neighbors. Of two views, the distance is that of the exact world positions, and nobody is
/// excluded.
class SearchEngine {
public:
    SearchEngine();
    ~SearchEngine();
    SearchEngine(SearchEngine&&) noexcept;
    SearchEngine& operator=(SearchEngine&&) noexcept;

    /// Sorts the particles into a sparse grid, on the lattice that suits them and the radius (chooseLattice()).
    /// Cost: about 2 passes over the particles and 16 bytes a particle.
    /// @param radius world units, > 0 and finite.
    /// @throws InvalidInput for a bad radius or option
    /// @throws InputError if a cell coordinate would pass +-(2^31 - 4096), with the extent, the cell edge and
    ///         the smallest radius that works; or for a non-finite particle under NonFinite::kFail
    /// @throws CapacityError, Cancelled
    SparseGrid buildGrid(const ParticleView& view, double radius, const SearchOptions& options = {});

    /// Sorts the particles of a view on a lattice that is given: views that are sorted on one lattice have the
    /// same cells.
    /// Cost: as above, without what choosing cells takes.
    /// @param options `cellSize` and `wideCells` are not read.
    /// @throws InvalidInput for a lattice with a bad edge, reach or radius; for one that does not suit the view (a
    ///         reference that is no voxel of a VDB grid, or voxels as cells where the view has none of that
    ///         edge); for a bad option
    /// @throws InputError if a cell coordinate would pass +-(2^31 - 4096), or the transform is too nearly singular
    ///         for the cells, with the extent and the smallest cells that work; with voxels as cells for a
    ///         particle outside its voxel; for a non-finite particle under NonFinite::kFail
    /// @throws CapacityError, Cancelled
    SparseGrid buildGrid(const ParticleView& view, const Lattice& lattice, const SearchOptions& options = {});

    /// Sorts two sets for a radius, or for radii of particles: on the lattice that suits the candidates; on several
    /// where radii differ by more than a factor of two, a pass or two over all particles each. Arrays
    /// of the sets and the radius must stay alive and unchanged as long as what is made from them is used.
    /// Cost: of the queries as buildGrid(); of the candidates those near a query, and a look at the others.
    /// @throws InvalidInput for a bad radius, arrays of another size than their view, radii that are missing, or a
    ///         bad option; and as buildGrid(): InputError if the queries reach too far, CapacityError, Cancelled
    SearchSets sort(const ParticleSet& candidates, const ParticleSet& queries, const Radius& radius,
                    const SearchOptions& options = {});

    /// Makes the lists of all queries, in options.encoding.
    /// @param options `radius` may be smaller than that of the sets, where one serves all; `cellSize` and `nonfinite`
    ///        are not read.
    /// @throws CapacityError if the lists cannot fit, before the memory is gone
    /// @throws InvalidInput for a radius above that of the sets, or a bad option; Cancelled
    NeighborLists search(const SearchSets& sets, const SearchOptions& options = {});

    /// sort(), then search(): the neighbors of the queries among the candidates.
    /// @throws as those
    NeighborLists search(const ParticleSet& candidates, const ParticleSet& queries, const Radius& radius,
                         const SearchOptions& options = {});

    /// The same for all particles of a grid.
    /// @throws as above
    NeighborLists search(const SparseGrid& grid, const SearchOptions& options = {});

    /// Runs a schedule of makeSchedule() on `devices`, which must be those that it was made for, and on TBB
    /// workers. The lists are those of search(), byte for byte, in the encoding of the schedule, with
    /// options.search.radius, for which the estimate should have been made. A block that outgrows its estimate
    /// is split and redone; a device that refuses memory is asked for less; what fits no device is run by TBB
    /// workers. `report` counts all of that. Host memory besides the lists: staging memory as large as the
    /// devices' buffers, and as much again for simulated devices.
    /// @throws DeviceError if a device is not there, or fails under DeviceFailure::kStop
    /// @throws CapacityError if the lists cannot fit beside that memory
    /// @throws InvalidInput for a schedule of another grid, or a radius above that of the grid's lattice;
    ///         Cancelled
    NeighborLists search(const SparseGrid& grid, const Schedule& schedule,
                         const std::vector<DeviceLimits>& devices, const RunOptions& options,
                         ScheduleRun& report);

    /// Gives each query's neighbors to a visitor, without storing lists.
    /// @param options `encoding` has no meaning here; `hostMemoryBytes` is not read.
    /// @throws InvalidInput as search(), Cancelled, and whatever `visitor` throws
    void visit(const SearchSets& sets, const NeighborVisitor& visitor, const SearchOptions& options = {});

    /// The same without distances.
    /// @throws as visit() does
    void visitRows(const SearchSets& sets, const RowVisitor& visitor, const SearchOptions& options = {});

    /// Makes measures of each query's neighbors: see measure.h. All share one pass over the neighbors, but `nearest`, which takes
    /// another one, and DBSCAN, which counts neighbors first.
    /// Cost: that of counting, and for each pair a few nanoseconds. Memory: 16 bytes a particle (32 of arrays of doubles, of grids
    /// whose radius passes 250 voxels or where no bound of host memory is set, and of sets with different transforms), the
    /// results, and up to 8 bytes a number of each attribute that is averaged, with a fourth one for vectors; clusters take 8 bytes
    /// a particle, those of DBSCAN 13.
    /// @throws InvalidInput for a bad name or option, an attribute that is not among the options, a wrong number of values,
    ///         clusters where not every particle is both query and candidate or lists are cut to the nearest; CapacityError,
    ///         Cancelled
    Measured measure(const SearchSets& sets, const std::vector<std::string>& measures,
                     const MeasureOptions& options);

    /// The same, byte for byte, of lists that are there, wherever they were made, a device among them: nothing is searched but `nearest`.
    /// `radius` and `nearest` of the options are those of the lists. The counts are these lists.
    /// @throws as above, and InvalidInput for lists of counts alone and those that hold their own query
    Measured measure(const NeighborLists& lists, const std::vector<std::string>& measures,
                     const MeasureOptions& options);

    /// buildGrid(), then search().
    NeighborLists findNeighbors(const ParticleView& view, double radius, const SearchOptions& options = {});

    /// The whole job, as the program's `search` runs it: on the CPU or on devices, within a limit of host memory,
    /// falling back to a smaller encoding if the lists do not fit. The same lists, byte for byte, wherever they
    /// are found. If hostMemoryBytes is set, the engine first frees all it has kept, open devices included.
    /// A Progress is told of the steps "grid"; "estimate" and "plan" where there are devices; "count" where
    /// JobOptions::npz needs the number of pairs; "search".
    /// @param options may be those of `report`
    /// @throws CapacityError when nothing that is allowed fits, with what takes the memory; DeviceError when a
    ///         device fails under DeviceFailure::kStop; and as buildGrid() and makePlan(): InvalidInput,
    ///         InputError, Cancelled
    NeighborLists findNeighbors(const ParticleView& view, double radius, const JobOptions& options,
                                JobReport& report);

    /// The same for the neighbors of queries among candidates. On the CPU alone, unless both are all particles of one view and
    /// one radius serves all.
    /// @throws as the job, and as sort(); InvalidInput for devices that cannot search such sets
    NeighborLists findNeighbors(const ParticleSet& candidates, const ParticleSet& queries,
                                const Radius& radius, const JobOptions& options, JobReport& report);

    /// Plans a job without running it, in full, also for the CPU alone. Whether lists and measures fit the host is not looked
    /// at, so no fallback is planned.
    /// @throws as the job
    JobPlan planJob(const ParticleView& view, double radius, const JobOptions& options);

    /// The same for the neighbors of queries among candidates. Where not all particles of one view are both, or have radii
    /// of their own, or lists are cut to the nearest, the plan is for the CPU: a sample of the queries is counted,
    /// tests and the bytes of masks are exact, and there are no blocks.
    /// @throws as the job
    JobPlan planJob(const ParticleSet& candidates, const ParticleSet& queries, const Radius& radius,
                    const JobOptions& options);

    const SearchStatistics& statistics() const;

    /// Closes the devices of the last run with a schedule. Otherwise they stay open, with their memory, for
    /// the next run.
    void releaseDevices();

private:
    struct Impl;
    std::unique_ptr<Impl> mImpl;
};

/// The whole job in one call; see SearchEngine.
NeighborLists findNeighbors(const ParticleView& view, double radius, const SearchOptions& options = {});

/// Number of neighbors of every particle, by particle number. No lists are stored.
std::vector<std::uint32_t> countNeighbors(const ParticleView& view, double radius,
                                          const SearchOptions& options = {});

/// Gives each query's neighbors to a visitor, without storing lists; see SearchEngine::visit.
void visitNeighbors(const ParticleView& view, double radius, const NeighborVisitor& visitor,
                    const SearchOptions& options = {});

/// The neighbors of the queries among the candidates, with a temporary engine; see SearchEngine.
NeighborLists search(const ParticleSet& candidates, const ParticleSet& queries, const Radius& radius,
                     const SearchOptions& options = {});

/// Number of pairs of a query and a candidate in the cells within reach of its own, itself included. That is
/// what the search would test without any pruning, and the number of bits of all mask rows. Cost: one pass
/// over the occupied cells.
std::uint64_t countCandidateTests(const SearchSets& sets);

/// The widest instruction set of this processor for which the search has code.
SimdLevel bestSimdLevel();
const char* simdLevelName(SimdLevel level);

} // namespace vdb_nns
