// The parts of a block are all of it, and each fits as far as anything is known.
#include "lists/neighbor_lists_data.h"
#include "out_of_core/block_split.h"
#include "plan/workload_cases.h"
#include "vdb_nns/error.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cstdint>
#include <vector>

namespace vdb_nns::testing {

namespace {

struct Whole {
    explicit Whole(Encoding encoding, const char* name = "block")
        : scene(name, 6000), own(scene.grid), tree(own.tree(encoding, ~0ull))
    {
        DeviceLimits device = deviceOf(own.need(encoding), 1);
        schedule = makeSchedule(own.grid, tree, {device});
        block = pendingBlocksOf(own.grid.data(), schedule).at(0);
        makeHalo(own.grid.data(), block);
        block.isStaged = true;
        SearchOptions options;
        options.encoding = Encoding::kNone;
        const NeighborLists lists = SearchEngine().search(own.grid, options);
        for (std::size_t slot = 0; slot < lists.size(); ++slot) counts.push_back(lists.data().rowCount[slot]);
    }

    BlockSplit split(std::uint64_t mostBytes, bool isKnown) const
    {
        KnownCounts known;
        if (isKnown) known.count = counts.data();
        return splitBlock(own.grid.data(), schedule.model, block, known, mostBytes);
    }

    SceneGrid scene;
    EstimatedGrid own;
    WorkloadTree tree;
    Schedule schedule;
    PendingBlock block;
    std::vector<std::uint32_t> counts; // by slot
};

// Every query is in one of them.
void expectAll(const BlockSplit& split, const PendingBlock& whole)
{
    std::vector<PendingBlock> all = split.parts;
    all.insert(all.end(), split.tooLarge.begin(), split.tooLarge.end());
    std::sort(all.begin(), all.end(), [](const PendingBlock& a, const PendingBlock& b) {
        return a.part.firstSlot < b.part.firstSlot;
    });
    std::uint32_t next = whole.part.firstSlot;
    std::uint64_t tests = 0;
    for (const PendingBlock& part : all) {
        EXPECT_EQ(part.part.firstSlot, next);
        EXPECT_EQ(part.block, whole.block);
        EXPECT_TRUE(part.isStaged);
        next = part.part.endSlot;
        tests += part.item.tests;
    }
    EXPECT_EQ(next, whole.part.endSlot);
    EXPECT_EQ(tests, whole.item.tests);
}

TEST(BlockParts, AreHalvesWhereNothingIsKnown)
{
    for (const Encoding encoding : {Encoding::kMask, Encoding::kIndex, Encoding::kNone}) {
        const Whole whole(encoding);
        const BlockSplit split = whole.split(1 << 30, false);
        ASSERT_EQ(split.parts.size(), 2u);
        EXPECT_TRUE(split.tooLarge.empty());
        expectAll(split, whole.block);
        EXPECT_EQ(split.parts.back().part.firstSlot, 0u) << "the last is next";
        for (const PendingBlock& part : split.parts) {
            EXPECT_EQ(part.item.isExact, encoding != Encoding::kIndex);
            EXPECT_FALSE(part.item.isTried);
            EXPECT_LT(part.item.bytes.total(), whole.block.item.bytes.total());
        }
    }
}

TEST(BlockParts, FitWhereCountsAreKnown)
{
    for (const Encoding encoding : {Encoding::kMask, Encoding::kIndex, Encoding::kNone}) {
        const Whole whole(encoding);
        std::uint64_t tooLarge = 0;
        for (const std::uint64_t divisor : {2u, 10u, 100u, 2000u, 1u << 30}) {
            const std::uint64_t most = whole.own.need(encoding) / divisor;
            const BlockSplit split = whole.split(most, true);
            expectAll(split, whole.block);
            for (const PendingBlock& part : split.parts) {
                EXPECT_TRUE(part.item.isExact);
                EXPECT_TRUE(most == 0 || part.item.bytes.total() <= most);
            }
            EXPECT_TRUE(most > 0 || split.parts.size() == 2u) << "no device is left: nothing needs to fit";
            tooLarge += split.tooLarge.size();
        }
        EXPECT_GT(tooLarge, 0u);
    }
}

TEST(BlockParts, ABlockOfAnotherGridIsRefused)
{
    const Whole whole(Encoding::kMask), other(Encoding::kMask, "spray");
    EXPECT_THROW(pendingBlocksOf(other.own.grid.data(), whole.schedule), InvalidInput);
    EXPECT_THROW(pendingBlocksOf(whole.own.grid.data(), Schedule()), InvalidInput);
}

} // namespace

} // namespace vdb_nns::testing
