// What a caller may choose about a search. Plain data.
#pragma once

#include "vdb_nns/progress.h"

#include <cstdint>

namespace vdb_nns {

/// How neighbor lists are held in memory.
enum class Encoding {
    /// 4 bytes for each neighbor: its number. Fast to read.
    kIndex,
    /// One bit for each candidate of the cells in reach, decoded when read: in fluids 0.5 to 1 byte a
    /// neighbor.
    kMask,
    /// Counts only.
    kNone
};

/// What to do with particles whose position is NaN or infinite.
enum class NonFinite {
    kSkip, ///< they have no neighbors and are nobody's neighbor; they are counted
    kFail  ///< throw InputError
};

/// Instruction sets of the search. All give the same answer.
enum class SimdLevel { kScalar, kSse4, kAvx2, kAvx512, kBest };

struct SearchOptions {
    /// How results are held.
    Encoding encoding = Encoding::kIndex;

    /// Radius of a search, in world units, at most that of the grid's lattice; 0: the lattice's. The lists hold the same
    /// neighbors as those of a grid that was built for this radius; masks take as many bits as with the lattice's. Not read
    /// by what builds a grid. Where a call takes a radius of its own (findNeighbors()), that is the lattice's.
    double radius = 0;

    static constexpr double kSmallestCell = 0.33, kLargestCell = 4;

    /// Cell edge in radii, kSmallestCell to kLargestCell, padded by 1/65536. The radius spans the next whole
    /// number of cells, 1 to 3 (SparseGrid::reach()). 0.5 makes masks smaller.
    /// 0: chosen to suit the input. The voxels of a VDB grid are taken if they can serve as cells, which
    /// saves the sort: the transform must only scale, the radius lie between half a voxel's edge and one, and
    /// every offset P be within 1/2. Otherwise the density of the particles decides: 0.5, 1, 1.5, 2 or 3.
    double cellSize = 0;

    /// Whether a chosen size may be above 1. Such cells are faster if few of them hold many particles, but
    /// they make masks larger: three times on sprays, up to four times if there are few neighbors. Taken as
    /// false if hostMemoryBytes is set.
    bool wideCells = true;

    /// Of each list only so many neighbors are kept, the nearest; those of equal distance by the smaller number. Decided in
    /// real arithmetic. 0: all. Not with Encoding::kMask. Lists stay in cell-visiting order.
    std::uint32_t nearest = 0;

    /// Puts a finite query that is a candidate too into its own list. It counts as a pair, not as a neighbor, and not among
    /// the nearest. Only where both sets are the same particles.
    bool includeSelf = false;

    NonFinite nonfinite = NonFinite::kSkip;

    /// kBest takes the widest that the processor has. A level that it does not have is InvalidInput.
    SimdLevel simd = SimdLevel::kBest;

    /// Bytes that the grid, its sort and the lists may use together. 0: what the machine (or its control
    /// group) has free, less a reserve (availableMemoryBytes()).
    std::uint64_t hostMemoryBytes = 0;

    /// Receives progress and may cancel; may be null.
    Progress* progress = nullptr;
};

} // namespace vdb_nns
