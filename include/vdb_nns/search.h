// The search: all steps in one call, each step by itself, and an engine that keeps its buffers.
#pragma once

#include "vdb_nns/lattice.h"
#include "vdb_nns/neighbor_lists.h"
#include "vdb_nns/particle_view.h"
#include "vdb_nns/search_options.h"
#include "vdb_nns/sparse_grid.h"

#include <functional>
#include <memory>
#include <vector>

namespace vdb_nns {

struct Schedule;
struct DeviceLimits;
struct RunOptions;
struct ScheduleRun;

/// Called once for every finite particle: its number, its neighbors and their world distances
/// (ParticleView::distance), in cell-visiting order. Called from several threads at once; the spans are valid
/// during the call. It may run parallel work of its own, and searches with other engines: until it returns,
/// its thread is handed no other query.
using NeighborVisitor = std::function<void(std::uint32_t query, Span<const std::uint32_t> neighbors,
                                           Span<const double> distances)>;

/// The same without distances, which cost more to compute than neighbors to find.
using RowVisitor = NeighborLists::RowVisitor;

/// What the last run did: for reports.
struct SearchStatistics {
    double gridSeconds = 0, searchSeconds = 0;
    std::uint64_t doublePairs = 0;       ///< ordered pairs that the float32 filter left to the double test
    std::uint64_t exactPairs = 0;        ///< of those, pairs that the double test left to exact arithmetic
    SimdLevel simd = SimdLevel::kScalar; ///< instruction set that ran
};

/// Finds neighbors, frame after frame. Keeps its memory between runs, and reuses it once the results of an
/// earlier run are gone. One thread at a time may call it, and none while it runs, a visitor of its own
/// included; inside it uses the TBB arena that the caller is in.
///
/// What may be nested: every function of the library may be called inside TBB tasks. While a thread waits in
/// such a call, it runs none of the caller's other tasks. So an engine for each thread,
/// tbb::enumerable_thread_specific<SearchEngine>, is fine for frames in a parallel loop. Visitors and a
/// Progress may run parallel work of their own.
///
/// Membership (all functions here): i and j are neighbors iff i != j and their distance is <= radius in real
/// arithmetic; no rounding decides. Self is excluded by number: particles at the same place are neighbors.
class SearchEngine {
public:
    SearchEngine();
    ~SearchEngine();
    SearchEngine(SearchEngine&&) noexcept;
    SearchEngine& operator=(SearchEngine&&) noexcept;

    /// Sorts the particles into a sparse grid, on the lattice that suits them and the radius (chooseLattice()).
    /// @param radius world units, > 0 and finite.
    /// Cost: about 2 passes over the particles and 16 bytes a particle.
    /// @throws InvalidInput for a bad radius or option
    /// @throws InputError when a cell coordinate would pass +-(2^31 - 4096), with the extent, the cell edge
    ///         and the smallest radius that works; or for a non-finite particle under NonFinite::kFail
    /// @throws CapacityError, Cancelled
    SparseGrid buildGrid(const ParticleView& view, double radius, const SearchOptions& options = {});

    /// Sorts the particles of a view on a lattice that is given. Views that are sorted on one lattice have the same cells.
    /// @param options `cellSize` and `wideCells` are not read.
    /// Cost: as above, without what choosing cells takes.
    /// @throws InvalidInput for a lattice with a bad edge, reach or radius; for one that does not suit the view: a reference
    ///         that is no voxel of a VDB grid, or voxels as cells where the view has none of that edge; for a bad option
    /// @throws InputError when a cell coordinate would pass +-(2^31 - 4096), or the transform is too nearly singular for the
    ///         cells, with the extent and the smallest cells that work; with voxels as cells for a particle outside its
    ///         voxel; for a non-finite particle under NonFinite::kFail
    /// @throws CapacityError, Cancelled
    SparseGrid buildGrid(const ParticleView& view, const Lattice& lattice, const SearchOptions& options = {});

    /// Makes the lists of all particles of a grid, in options.encoding, with options.radius.
    /// @throws CapacityError before the memory is gone, when the lists cannot fit
    /// @throws InvalidInput for a radius above that of the grid's lattice, or a bad option; Cancelled
    NeighborLists search(const SparseGrid& grid, const SearchOptions& options = {});

    /// Runs a schedule of makeSchedule() on `devices`, which it was made for, and on TBB workers: the same
    /// lists, byte for byte, as search() makes, in the schedule's encoding and with options.search.radius, which the estimate
    /// should have been made for. A block that outgrows its
    /// estimate is split and redone; a device that refuses memory is asked for less, and what fits no device
    /// is run by TBB workers; `report` counts all of that.
    /// Host memory besides the lists: what the devices hold in their buffers, once for staging; for simulated
    /// devices once more.
    /// @throws DeviceError when a device fails, under DeviceFailure::kStop, or is not there
    /// @throws CapacityError when the lists cannot fit beside that
    /// @throws InvalidInput for a schedule of another grid or a radius above that of the grid's lattice; Cancelled
    NeighborLists search(const SparseGrid& grid, const Schedule& schedule,
                         const std::vector<DeviceLimits>& devices, const RunOptions& options,
                         ScheduleRun& report);

    /// Hands every query its neighbors without storing lists.
    /// @param options `encoding` has no meaning here; `hostMemoryBytes` is not read.
    /// @throws InvalidInput as search(), Cancelled, and what `visitor` throws
    void visit(const SparseGrid& grid, const NeighborVisitor& visitor, const SearchOptions& options = {});

    /// The same without distances.
    /// @throws as visit()
    void visitRows(const SparseGrid& grid, const RowVisitor& visitor, const SearchOptions& options = {});

    /// buildGrid() and search().
    NeighborLists findNeighbors(const ParticleView& view, double radius, const SearchOptions& options = {});

    const SearchStatistics& statistics() const;

    /// Closes the devices of the last run with a schedule, which are kept with their memory for the next one.
    void releaseDevices();

private:
    struct Impl;
    std::unique_ptr<Impl> mImpl;
};

/// The whole job in one call; see SearchEngine.
NeighborLists findNeighbors(const ParticleView& view, double radius, const SearchOptions& options = {});

/// Number of neighbors of every particle, by number; no lists are stored.
std::vector<std::uint32_t> countNeighbors(const ParticleView& view, double radius,
                                          const SearchOptions& options = {});

/// Hands every query its neighbors without storing lists; see SearchEngine::visit.
void visitNeighbors(const ParticleView& view, double radius, const NeighborVisitor& visitor,
                    const SearchOptions& options = {});

/// Pairs of a query and a particle of the cells within reach of its own, itself included: what the search
/// would test without any pruning, and the number of bits of all mask rows. Cost: one pass over the occupied
/// cells.
std::uint64_t countCandidateTests(const SparseGrid& grid);

/// The widest instruction set of this processor that the search has code for.
SimdLevel bestSimdLevel();
const char* simdLevelName(SimdLevel level);

} // namespace vdb_nns
