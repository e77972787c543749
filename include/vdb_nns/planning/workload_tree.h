// The workload tree: the nodes of a grid's VDB tree, and the octants between them, with what each asks of a device. Plain data.
#pragma once

#include "vdb_nns/planning/work_estimate.h"
#include "vdb_nns/search_options.h"

#include <cstdint>
#include <vector>

namespace vdb_nns {

/// Bytes of a block on a device.
struct BlockBytes {
    std::uint64_t up = 0; ///< particles of block and halo, cells, leaves: uploaded
    /// Counts, lists, and pairs that are left to the host to decide (256 bytes, and 16 for 64 queries): room reserved for
    /// them, and downloaded.
    std::uint64_t down = 0;
    std::uint64_t scratch = 0; ///< where rows begin, 8 bytes for 32 queries; not downloaded
    std::uint64_t total() const { return up + down + scratch; }
};

/// How bytes follow from work: s(B) = n_B S_p + S_n sum E + S_aux for index lists (Kim et al. 2014), exact for masks.
struct MemoryModel {
    static constexpr std::uint64_t kParticleBytes = 16;        ///< S_p: x, y, z, number
    static constexpr std::uint64_t kNeighborBytes = 4;         ///< S_n
    static constexpr std::uint64_t kCountBytes = 4;            ///< of each query
    static constexpr std::uint64_t kCellBytes = 4;             ///< start of an occupied cell
    static constexpr std::uint64_t kLeafBytes = 16 + 64 + 112; ///< record, occupancy, neighborhood
    static constexpr std::uint64_t kHaloLeafBytes = 16 + 64;
    static constexpr std::uint64_t kBoundaryLeafBytes =
        64; ///< which of its cells a device runs, without halo
    static constexpr std::uint64_t kBlockBytes =
        16 + 4 + 64;                                  ///< ends of leaves and cells; vectors read past the end
    static constexpr std::uint64_t kResultBytes = 32; ///< bytes of rows, pairs of the slower tests
    static constexpr std::uint64_t kMaskLeafBytes = 8;  ///< where the masks of a leaf begin
    static constexpr std::uint64_t kMaskBlockBytes = 8; ///< a row is written 64 bits at a time

    Encoding encoding = Encoding::kMask;
    double margin = 0.05;      ///< S_aux: this share of the expected bytes
    bool masksAreExact = true; ///< else the margin is for masks too
    double auxNeighbors = 0;   ///< S_aux: and room for so many neighbors a particle; the paper has 3.7
};

/// Cells around a block that its queries reach, and the block's queries that reach them.
struct HaloSize {
    std::uint64_t particles = 0, cells = 0, leaves = 0;
    std::uint64_t boundaryQueries = 0; ///< whose cells in reach hold occupied cells outside the block
    std::uint64_t boundaryLeaves = 0;  ///< leaves that hold such queries
};

/// A cube of 2^log2Cells cells, or all of the grid: a contiguous range of leaves.
struct WorkloadNode {
    static constexpr int kRoot = 31; ///< log2Cells of the node that holds everything

    Vec3i origin{}; ///< cell coordinates of its lowest cell; of the first leaf for the root
    int log2Cells = kRoot;
    std::uint32_t firstLeaf = 0, endLeaf = 0;
    std::uint64_t occupiedCells = 0;
    Work work;                                    ///< the sum of its children's
    HaloSize halo;                                ///< where the node was not divided; nothing for the root
    std::uint32_t firstChild = 0, childCount = 0; ///< in Morton order; none where it was not divided
};

struct WorkloadTreeOptions {
    MemoryModel model;
    /// Nodes of more bytes than that are divided, down to leaves.
    std::uint64_t nodeBytes = 0;
    /// Nodes above 2^blockLog2Cells cells are divided too, however small; 0 for none: the paper's fixed block size.
    int blockLog2Cells = 0;
    Progress* progress = nullptr;
};

struct WorkloadTree {
    std::vector<WorkloadNode> nodes; ///< [0] is the root; children of a node stand together
    WorkloadTreeOptions options;     ///< what it was divided by
    double seconds = 0;
};

/// Builds the tree, in parallel and only as deep as nodeBytes asks: one node where everything fits.
/// Cost: one pass over the leaves, and one over the faces of every node that is made.
/// @throws InvalidInput if the estimate is not of that grid; Cancelled
WorkloadTree buildWorkloadTree(const SparseGrid& grid, const WorkEstimate& estimate,
                               const WorkloadTreeOptions& options);

/// Bytes of a node as one block: with its halo, or without it and without the queries of its boundary region.
BlockBytes blockBytes(const WorkloadNode& node, const MemoryModel& model, bool withHalo = true);

} // namespace vdb_nns
