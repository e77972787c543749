// Grids and workload trees for the tests of steps 3 to 5.
#pragma once

#include "agreement/point_views.h"
#include "vdb_nns/planning/schedule.h"
#include "vdb_nns/planning/workload_tree.h"
#include "vdb_nns/scene.h"

#include <gtest/gtest.h>

#include <cstdint>
#include <string>
#include <utility>
#include <vector>

namespace vdb_nns::testing {

inline SparseGrid gridOf(const ParticleView& view, double radius, int reach)
{
    SearchOptions options;
    options.cellSize = reach > 0 ? 1.0 / reach : 0;
    return SearchEngine().buildGrid(view, radius, options);
}

// Expected pairs are counts that a double holds exactly, so that sums can be compared.
inline WorkEstimate fixedEstimate(const SparseGrid& grid, double neighbors = 32)
{
    EstimateOptions options;
    options.estimator = Estimator::kFixed;
    options.fixedNeighbors = neighbors;
    return estimateWork(grid, options);
}

inline WorkloadTree treeOf(const SparseGrid& grid, const WorkEstimate& estimate, std::uint64_t nodeBytes,
                           Encoding encoding = Encoding::kMask, int blockLog2Cells = 0)
{
    WorkloadTreeOptions options;
    options.model.encoding = encoding;
    options.nodeBytes = nodeBytes;
    options.blockLog2Cells = blockLog2Cells;
    return buildWorkloadTree(grid, estimate, options);
}

// The particles of a scene in a grid of reach 1.
struct SceneGrid {
    SceneGrid(const char* name, std::uint64_t count)
    {
        SceneOptions options;
        options.name = name;
        options.count = count;
        scene = makeScene(options);
        grid = gridOf(ParticleView::fromArray(scene.positions.data(), count), scene.suggestedRadius, 1);
    }

    Scene scene;
    SparseGrid grid;
};

inline DeviceLimits deviceOf(std::uint64_t memoryBytes, int buffers = 3)
{
    DeviceLimits device;
    device.name = "test";
    device.memoryBytes = memoryBytes;
    device.buffers = buffers;
    return device;
}

// A grid with its estimate, to be planned.
struct EstimatedGrid {
    explicit EstimatedGrid(SparseGrid g) : grid(std::move(g)), estimate(estimateWork(grid)) {}

    WorkloadTree tree(Encoding encoding, std::uint64_t nodeBytes, int blockLog2Cells = 0) const
    {
        return treeOf(grid, estimate, nodeBytes, encoding, blockLog2Cells);
    }

    // Bytes of everything as one block.
    std::uint64_t need(Encoding encoding) const
    {
        const WorkloadTree one = tree(encoding, ~0ull);
        return blockBytes(one.nodes[0], one.options.model).total();
    }

    SparseGrid grid;
    WorkEstimate estimate;
};

// Every list in its order, and the counts.
inline void expectSameLists(const NeighborLists& actual, const NeighborLists& expected)
{
    ASSERT_EQ(actual.size(), expected.size());
    ASSERT_EQ(actual.encoding(), expected.encoding());
    EXPECT_EQ(actual.counts(), expected.counts());
    EXPECT_EQ(actual.pairCount(), expected.pairCount());
    EXPECT_EQ(actual.statistics().isolated, expected.statistics().isolated);
    EXPECT_EQ(actual.statistics().max, expected.statistics().max);
    if (actual.encoding() == Encoding::kNone) return;
    EXPECT_EQ(actual.checksum(), expected.checksum());
    std::vector<std::uint32_t> a, b;
    for (std::size_t i = 0; i < actual.size(); ++i) {
        actual.neighbors(i, a);
        expected.neighbors(i, b);
        ASSERT_EQ(a, b) << "particle " << i;
    }
}

// check(set, grid) for every distribution and reach.
template <typename Check>
void forEachGrid(const Check& check)
{
    for (const PointSet& set : arraySets(Precision::kDouble, 6)) {
        const SetView input(set, Form::kDoubles);
        for (int reach = 1; reach <= 3; ++reach) {
            SCOPED_TRACE(set.name + ", reach " + std::to_string(reach));
            check(set, gridOf(input.view(), set.radius, reach));
        }
    }
}

} // namespace vdb_nns::testing
