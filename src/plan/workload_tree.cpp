// Leaves in Morton order make every octant of every node a contiguous range of leaves, so that a node is
// a range, its work a difference of running sums, and its children are found by halving.
#include "vdb_nns/planning/workload_tree.h"

#include "grid/sparse_grid_data.h"
#include "plan/block_halo.h"
#include "shared/block_result.h"
#include "util/cancel.h"
#include "util/isolate.h"
#include "util/known_value.h"
#include "vdb_nns/error.h"

#include <tbb/parallel_for.h>

#include <algorithm>
#include <chrono>
#include <cmath>
#include <string>

namespace vdb_nns {

namespace {

constexpr int kLeafLog2Cells = 3, kTopLog2Cells = 12; // of a leaf, and of the nodes below the root

double now()
{
    return std::chrono::duration<double>(std::chrono::steady_clock::now().time_since_epoch()).count();
}

class Builder {
public:
    Builder(const SparseGridData& grid, const WorkEstimate& estimate) : mGrid(grid)
    {
        mSums.resize(estimate.leaves.size() + 1);
        for (std::size_t l = 0; l < estimate.leaves.size(); ++l) {
            mSums[l + 1] = mSums[l];
            mSums[l + 1] += estimate.leaves[l];
        }
    }

    WorkloadNode node(int log2Cells, std::uint32_t firstLeaf, std::uint32_t endLeaf) const
    {
        WorkloadNode node;
        node.log2Cells = log2Cells;
        node.firstLeaf = firstLeaf;
        node.endLeaf = endLeaf;
        if (firstLeaf == endLeaf) return node;
        for (int k = 0; k < 3; ++k) {
            const std::int32_t origin = mGrid.leafOrigins[firstLeaf][k];
            node.origin[k] =
                log2Cells == WorkloadNode::kRoot ? origin : origin & -(std::int32_t(1) << log2Cells);
        }
        node.occupiedCells = mGrid.leaves[endLeaf].firstCell - mGrid.leaves[firstLeaf].firstCell;
        const Work &before = mSums[firstLeaf], &after = mSums[endLeaf];
        node.work = {after.particles - before.particles, after.expectedPairs - before.expectedPairs,
                     after.candidateTests - before.candidateTests, after.maskBytes - before.maskBytes};
        return node;
    }

    // Whether a node is to be divided. If not it may be a block, and its halo is made.
    bool isLarge(WorkloadNode& node, const WorkloadTreeOptions& options) const
    {
        if (options.blockLog2Cells && node.log2Cells > options.blockLog2Cells) return true;
        const bool isLeaf = node.log2Cells == kLeafLog2Cells; // may be cut, with its halo
        if (!isLeaf && blockBytes(node, options.model).total() > options.nodeBytes) return true;
        node.halo = haloOf(mGrid, node.firstLeaf, node.endLeaf, node.log2Cells).size;
        return blockBytes(node, options.model).total() > options.nodeBytes;
    }

    // The occupied parts of a node, one level down.
    std::vector<WorkloadNode> children(const WorkloadNode& parent) const
    {
        const int log2Cells = parent.log2Cells == WorkloadNode::kRoot ? kTopLog2Cells : parent.log2Cells - 1;
        const auto cubeOf = [&](std::uint32_t leaf) {
            const Vec3i& o = mGrid.leafOrigins[leaf];
            return Vec3i{o[0] >> log2Cells, o[1] >> log2Cells, o[2] >> log2Cells};
        };
        std::vector<WorkloadNode> result;
        for (std::uint32_t begin = parent.firstLeaf; begin < parent.endLeaf;) {
            // Leaves of one cube stand together, so doubling steps and then halving find the end.
            const Vec3i cube = cubeOf(begin);
            std::uint32_t in = begin, step = 1;
            while (in + step < parent.endLeaf && cubeOf(in + step) == cube) in += step, step *= 2;
            for (; step > 0; step /= 2) {
                if (in + step < parent.endLeaf && cubeOf(in + step) == cube) in += step;
            }
            result.push_back(node(log2Cells, begin, in + 1));
            begin = in + 1;
        }
        return result;
    }

private:
    const SparseGridData& mGrid;
    std::vector<Work> mSums; // of the leaves before
};

} // namespace

BlockBytes blockBytes(const WorkloadNode& node, const MemoryModel& model, bool withHalo)
{
    using M = MemoryModel;
    const std::uint64_t leaves = node.endLeaf - node.firstLeaf, particles = node.work.particles;
    BlockBytes bytes;
    bytes.up = particles * M::kParticleBytes + node.occupiedCells * M::kCellBytes + leaves * M::kLeafBytes +
               M::kBlockBytes;
    bytes.up += withHalo ? node.halo.particles * M::kParticleBytes + node.halo.cells * M::kCellBytes +
                               node.halo.leaves * M::kHaloLeafBytes
                         : node.halo.boundaryLeaves * M::kBoundaryLeafBytes;
    bytes.up = (bytes.up + 15) / 16 * 16;
    bytes.down = M::kResultBytes + particles * M::kCountBytes + undecidedRoom(particles);
    bytes.scratch = scratchBytes(particles, model.encoding);
    if (model.encoding == Encoding::kMask) {
        const double rough = static_cast<double>(node.work.maskBytes) * (1 + model.margin);
        bytes.down += model.masksAreExact ? node.work.maskBytes : static_cast<std::uint64_t>(rough);
        bytes.down += leaves * M::kMaskLeafBytes + M::kMaskBlockBytes;
    }
    if (model.encoding == Encoding::kIndex) {
        const double neighbors = node.work.expectedPairs * (1 + model.margin) +
                                 static_cast<double>(particles) * model.auxNeighbors;
        // Whatever an estimator says, bytes can be added up.
        bytes.down += static_cast<std::uint64_t>(std::ceil(neighbors < 0x1p58 ? neighbors : 0x1p58)) *
                      M::kNeighborBytes;
    }
    return bytes;
}

WorkloadTree buildWorkloadTree(const SparseGrid& sparseGrid, const WorkEstimate& estimate,
                               const WorkloadTreeOptions& options)
{
    const double start = now();
    const SparseGridData& grid = sparseGrid.data();
    requireKnown(options.model.encoding, Encoding::kNone, "encoding");
    if (estimate.leaves.size() != grid.leafCount()) {
        throw InvalidInput("an estimate of " + std::to_string(estimate.leaves.size()) +
                           " leaves is not of a grid with " + std::to_string(grid.leafCount()) + " leaves");
    }
    const CancelCheck cancel(options.progress, "workload tree");
    const Builder builder(grid, estimate);
    WorkloadTree tree;
    tree.options = options;
    tree.options.progress = nullptr;
    tree.nodes.push_back(builder.node(WorkloadNode::kRoot, 0, static_cast<std::uint32_t>(grid.leafCount())));
    // Level by level: the nodes of a level are divided in parallel.
    for (std::size_t begin = 0; begin < tree.nodes.size();) {
        const std::size_t end = tree.nodes.size();
        std::vector<std::vector<WorkloadNode>> children(end - begin);
        isolatedIeee([&] {
            tbb::parallel_for(begin, end, [&](std::size_t i) {
                cancel.check();
                WorkloadNode& node = tree.nodes[i];
                if (builder.isLarge(node, options) && node.log2Cells > kLeafLog2Cells) {
                    children[i - begin] = builder.children(node);
                }
            });
        });
        for (std::size_t i = begin; i < end; ++i) {
            std::vector<WorkloadNode>& own = children[i - begin];
            tree.nodes[i].firstChild = static_cast<std::uint32_t>(tree.nodes.size());
            tree.nodes[i].childCount = static_cast<std::uint32_t>(own.size());
            tree.nodes.insert(tree.nodes.end(), own.begin(), own.end());
        }
        begin = end;
    }
    tree.seconds = now() - start;
    return tree;
}

} // namespace vdb_nns
