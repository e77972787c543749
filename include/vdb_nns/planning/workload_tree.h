// The workload tree: the nodes of a grid's VDB tree, and the octants between them, with what each asks of a
// device. Plain data.
#pragma once

#include "vdb_nns/planning/work_estimate.h"
#include "vdb_nns/search_options.h"

#include <cstdint>
#include <vector>

namespace vdb_nns {

/// Bytes of a block on a device.
struct BlockBytes {
    std::uint64_t up = 0; ///< uploaded: particles of block and halo, cells, leaves
    /// Reserved and downloaded: counts, lists, and the pairs that the host is to decide (256 bytes, and 16
    /// for each 64 queries).
    std::uint64_t down = 0;
    std::uint64_t scratch = 0; ///< where rows begin, 8 bytes for each 32 queries; not downloaded
    std::uint64_t total() const { return up + down + scratch; }
};

/// How bytes follow from work. Index lists: s(B) = n_B S_p + S_n sum E + S_aux (Kim et al. 2014). Masks:
/// exact.
struct MemoryModel {
    static constexpr std::uint64_t kParticleBytes = 16; ///< S_p: x, y, z, number
    static constexpr std::uint64_t kNeighborBytes = 4;  ///< S_n
    static constexpr std::uint64_t kCountBytes = 4;     ///< count of a query
    static constexpr std::uint64_t kCellBytes = 4;      ///< start of an occupied cell
    /// Record, occupancy and neighborhood of a leaf.
    static constexpr std::uint64_t kLeafBytes = 16 + 64 + 112;
    static constexpr std::uint64_t kHaloLeafBytes = 16 + 64; ///< record and occupancy
    /// Without halo: which cells of a boundary leaf the device runs.
    static constexpr std::uint64_t kBoundaryLeafBytes = 64;
    /// Ends of leaves and of cells; room for vectors that read past the end.
    static constexpr std::uint64_t kBlockBytes = 16 + 4 + 64;
    /// Head of a result: bytes of the rows, and how many pairs went to the slower tests.
    static constexpr std::uint64_t kResultBytes = 32;
    static constexpr std::uint64_t kMaskLeafBytes = 8;  ///< where the masks of a leaf begin
    static constexpr std::uint64_t kMaskBlockBytes = 8; ///< a row is written 64 bits at a time

    Encoding encoding = Encoding::kMask;
    double margin = 0.05;      ///< S_aux as a share of the expected bytes
    bool masksAreExact = true; ///< if false, the margin applies to masks too
    double auxNeighbors = 0;   ///< S_aux as neighbors of each particle, added to the share; the paper has 3.7
};

/// The cells around a block that its queries reach, and the queries of the block that reach them.
struct HaloSize {
    std::uint64_t particles = 0, cells = 0, leaves = 0;
    std::uint64_t boundaryQueries = 0; ///< queries with occupied cells in reach outside the block
    std::uint64_t boundaryLeaves = 0;  ///< leaves that hold such queries
};

/// A cube of 2^log2Cells cells along an edge, or all of the grid: a contiguous range of leaves.
struct WorkloadNode {
    static constexpr int kRoot = 31; ///< log2Cells of the node that holds everything

    Vec3i origin{}; ///< cell coordinates of its lowest cell; for the root, of the first leaf
    int log2Cells = kRoot;
    std::uint32_t firstLeaf = 0, endLeaf = 0;
    std::uint64_t occupiedCells = 0;
    Work work;                                    ///< the sum of its children's
    HaloSize halo;                                ///< of nodes that were not divided; empty for the root
    std::uint32_t firstChild = 0, childCount = 0; ///< in Morton order; none if it was not divided
};

struct WorkloadTreeOptions {
    MemoryModel model;
    /// Nodes that need more bytes than this are divided, down to leaves.
    std::uint64_t nodeBytes = 0;
    /// Nodes above 2^blockLog2Cells cells along an edge are divided too, however few bytes they need: the
    /// fixed block size of the paper. 0: none.
    int blockLog2Cells = 0;
    Progress* progress = nullptr;
};

struct WorkloadTree {
    std::vector<WorkloadNode> nodes; ///< [0] is the root; the children of a node stand together
    WorkloadTreeOptions options;     ///< what it was divided by
    double seconds = 0;
};

/// Builds the tree, in parallel and only as deep as nodeBytes asks: one node if everything fits.
/// Cost: one pass over the leaves, and one over the faces of every node that is made.
/// @throws InvalidInput if the estimate is not of that grid; Cancelled
WorkloadTree buildWorkloadTree(const SparseGrid& grid, const WorkEstimate& estimate,
                               const WorkloadTreeOptions& options);

/// Bytes of a node as one block: with its halo, or without its halo and the queries of its boundary region.
BlockBytes blockBytes(const WorkloadNode& node, const MemoryModel& model, bool withHalo = true);

} // namespace vdb_nns
