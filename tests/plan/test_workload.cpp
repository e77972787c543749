// The workload tree: reach and halo against brute force over cells, the tree's shape and sums.
#include "plan/block_halo.h"
#include "plan/workload_cases.h"
#include "vdb_nns/error.h"
#include "vdb_nns/scene.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <cstdlib>
#include <limits>
#include <map>
#include <numeric>
#include <random>
#include <set>
#include <string>
#include <vector>

namespace vdb_nns::testing {

namespace {

constexpr double kInf = std::numeric_limits<double>::infinity();

// ---- cells in reach -----------------------------------------------------------------------------------------------

struct LeafSet {
    std::uint64_t word[8] = {};

    bool has(int x, int y, int z) const { return word[x] >> (8 * y + z) & 1; }
    void add(int x, int y, int z) { word[x] |= std::uint64_t(1) << (8 * y + z); }
};

// f(x, y, z) for the 512 cells of a leaf.
template <typename F>
void forEachCellOfLeaf(const F& f)
{
    for (int cell = 0; cell < 512; ++cell) f(cell >> 6, cell >> 3 & 7, cell & 7);
}

bool isInReach(const Vec3i& a, const Vec3i& b, int reach)
{
    bool near = true;
    for (std::size_t k = 0; k < 3; ++k) near &= std::abs(a[k] - b[k]) <= reach;
    return near;
}

LeafSet slowReach(const LeafSet& from, const Vec3i& leaf, int reach)
{
    LeafSet out;
    forEachCellOfLeaf([&](int x, int y, int z) {
        if (!from.has(x, y, z)) return;
        for (int cx = x - reach; cx <= x + reach; ++cx) {
            for (int cy = y - reach; cy <= y + reach; ++cy) {
                for (int cz = z - reach; cz <= z + reach; ++cz) {
                    const int ox = cx - 8 * leaf[0], oy = cy - 8 * leaf[1], oz = cz - 8 * leaf[2];
                    if (((ox | oy | oz) & ~7) == 0) out.add(ox, oy, oz);
                }
            }
        }
    });
    return out;
}

void expectReachOf(const LeafSet& set)
{
    for (int reach = 1; reach <= 3; ++reach) {
        for (int n = 0; n < 27; ++n) {
            const Vec3i d{n / 9 - 1, n / 3 % 3 - 1, n % 3 - 1};
            LeafSet out;
            for (std::uint64_t& word : out.word)
                word = 0xfeedfacefeedfaceu; // what was there before does not matter
            cellsInReach(set.word, d[0], d[1], d[2], reach, out.word);
            const LeafSet slow = slowReach(set, d, reach);
            EXPECT_TRUE(std::equal(out.word, out.word + 8, slow.word)) << "reach " << reach << ", leaf " << n;
        }
    }
}

TEST(CellsInReach, AreThoseOfEveryCell)
{
    std::mt19937_64 random(2);
    expectReachOf({});
    LeafSet all;
    for (std::uint64_t& word : all.word) word = ~std::uint64_t(0);
    expectReachOf(all);
    forEachCellOfLeaf([](int x, int y, int z) {
        if ((x + y + z) % 3) return;
        LeafSet one;
        one.add(x, y, z);
        expectReachOf(one);
    });
    for (int k = 0; k < 40; ++k) {
        LeafSet set;
        for (std::uint64_t& word : set.word)
            word = random() & random() & (k % 2 ? random() : ~std::uint64_t(0));
        expectReachOf(set);
    }
}

// ---- halo ---------------------------------------------------------------------------------------------------------

// The occupied cells of a grid, in its order, and which are within reach of which.
struct OccupiedCells {
    explicit OccupiedCells(const SparseGrid& grid)
    {
        std::map<Vec3i, std::size_t> number;
        const std::vector<Vec3i> cells = cellsOf(grid);
        for (std::uint32_t l = 0; l < grid.leafCount(); ++l) {
            const SparseGrid::Leaf record = grid.leaf(l);
            for (std::uint64_t s = record.firstSlot; s < record.firstSlot + record.particleCount; ++s) {
                const Vec3i& cell = cells[grid.particleNumbers()[s]];
                const auto [place, isNew] = number.insert({cell, at.size()});
                if (isNew) {
                    at.push_back(cell);
                    leaf.push_back(l);
                    particles.push_back(0);
                }
                ++particles[place->second];
            }
        }
        const int reach = grid.reach();
        near.resize(at.size());
        for (std::size_t c = 0; c < at.size(); ++c) {
            const Vec3i low{at[c][0] - reach, at[c][1] - reach, at[c][2] - reach};
            const Vec3i high{at[c][0] + reach, at[c][1] + reach, at[c][2] + reach};
            for (auto other = number.lower_bound(low); other != number.end() && !(high < other->first);
                 ++other) {
                if (isInReach(at[c], other->first, reach)) near[c].push_back(other->second);
            }
        }
    }

    std::vector<Vec3i> at;
    std::vector<std::uint32_t> leaf;
    std::vector<std::uint64_t> particles;
    std::vector<std::vector<std::size_t>> near;
};

struct SlowHalo {
    std::set<Vec3i> halo, boundary;
    HaloSize size;
};

SlowHalo slowHalo(const OccupiedCells& cells, std::uint32_t firstLeaf, std::uint32_t endLeaf)
{
    const auto isInside = [&](std::size_t c) {
        return cells.leaf[c] >= firstLeaf && cells.leaf[c] < endLeaf;
    };
    SlowHalo result;
    std::set<std::uint32_t> haloLeaves, boundaryLeaves;
    for (std::size_t c = 0; c < cells.at.size(); ++c) {
        const bool inside = isInside(c);
        const bool crosses = std::any_of(cells.near[c].begin(), cells.near[c].end(),
                                         [&](std::size_t other) { return isInside(other) != inside; });
        if (!crosses) continue;
        (inside ? result.boundary : result.halo).insert(cells.at[c]);
        (inside ? boundaryLeaves : haloLeaves).insert(cells.leaf[c]);
        (inside ? result.size.boundaryQueries : result.size.particles) += cells.particles[c];
    }
    result.size.cells = result.halo.size();
    result.size.leaves = haloLeaves.size();
    result.size.boundaryLeaves = boundaryLeaves.size();
    return result;
}

// The cells of the sets; every leaf comes once, ascending, with some.
std::set<Vec3i> cellsOfSets(const SparseGrid& grid, const std::vector<CellSet>& sets)
{
    std::set<Vec3i> cells;
    for (std::size_t k = 0; k < sets.size(); ++k) {
        if (k > 0) {
            EXPECT_LT(sets[k - 1].leaf, sets[k].leaf);
        }
        const std::size_t before = cells.size();
        const Vec3i origin = grid.leaf(sets[k].leaf).origin;
        LeafSet set;
        std::copy_n(sets[k].cells, 8, set.word);
        forEachCellOfLeaf([&](int x, int y, int z) {
            if (set.has(x, y, z)) cells.insert({origin[0] + x, origin[1] + y, origin[2] + z});
        });
        EXPECT_GT(cells.size(), before);
    }
    return cells;
}

void expectSameSize(const HaloSize& a, const HaloSize& b)
{
    EXPECT_EQ(a.particles, b.particles);
    EXPECT_EQ(a.cells, b.cells);
    EXPECT_EQ(a.leaves, b.leaves);
    EXPECT_EQ(a.boundaryQueries, b.boundaryQueries);
    EXPECT_EQ(a.boundaryLeaves, b.boundaryLeaves);
}

// Of every node of the tree down to leaves: cubes of 8 to 4096 cells.
TEST(Halo, IsWhatBruteForceFinds)
{
    forEachGrid([](const PointSet&, const SparseGrid& grid) {
        const OccupiedCells cells(grid);
        for (const WorkloadNode& node : treeOf(grid, fixedEstimate(grid), 0).nodes) {
            SCOPED_TRACE("2^" + std::to_string(node.log2Cells) + " cells from leaf " +
                         std::to_string(node.firstLeaf));
            const SlowHalo slow = slowHalo(cells, node.firstLeaf, node.endLeaf);
            const BlockHalo halo = haloOf(grid.data(), node.firstLeaf, node.endLeaf, node.log2Cells);
            expectSameSize(halo.size, slow.size);
            // Nodes that are too large without a halo are divided without looking at it; what is left may be a block.
            if (node.childCount == 0) expectSameSize(node.halo, slow.size);
            EXPECT_EQ(cellsOfSets(grid, halo.halo), slow.halo);
            EXPECT_EQ(cellsOfSets(grid, halo.boundary), slow.boundary);
        }
    });
}

// ---- tree ---------------------------------------------------------------------------------------------------------

bool isIn(const Vec3i& cell, const WorkloadNode& node)
{
    if (node.log2Cells == WorkloadNode::kRoot) return true;
    bool inside = true;
    for (std::size_t k = 0; k < 3; ++k)
        inside &= cell[k] >> node.log2Cells == node.origin[k] >> node.log2Cells;
    return inside;
}

void expectWorkOfLeaves(const WorkloadNode& node, const WorkEstimate& estimate, const SparseGrid& grid)
{
    Work sum;
    std::uint64_t cells = 0;
    for (std::uint32_t l = node.firstLeaf; l < node.endLeaf; ++l) {
        sum += estimate.leaves[l];
        const SparseGrid::Leaf leaf = grid.leaf(l);
        EXPECT_TRUE(isIn(leaf.origin, node));
        for (const std::uint64_t word : leaf.occupancy)
            cells += static_cast<std::uint64_t>(__builtin_popcountll(word));
    }
    EXPECT_EQ(node.work.particles, sum.particles);
    EXPECT_EQ(node.work.candidateTests, sum.candidateTests);
    EXPECT_EQ(node.work.maskBytes, sum.maskBytes);
    EXPECT_NEAR(node.work.expectedPairs, sum.expectedPairs, 1e-12 * estimate.total.expectedPairs);
    EXPECT_EQ(node.occupiedCells, cells);
    if (node.log2Cells == WorkloadNode::kRoot) return;
    for (std::size_t k = 0; k < 3; ++k) EXPECT_EQ(node.origin[k] & ((1 << node.log2Cells) - 1), 0);
    if (node.firstLeaf > 0) {
        EXPECT_FALSE(isIn(grid.leaf(node.firstLeaf - 1).origin, node));
    }
    if (node.endLeaf < grid.leafCount()) {
        EXPECT_FALSE(isIn(grid.leaf(node.endLeaf).origin, node));
    }
}

// The children are the node's octants (the root's: its cubes of 4096 cells), in order and without a gap.
void expectChildren(const WorkloadNode& node, const WorkloadTree& tree)
{
    std::uint32_t leaf = node.firstLeaf;
    int octant = -1;
    for (std::uint32_t c = node.firstChild; c < node.firstChild + node.childCount; ++c) {
        const WorkloadNode& child = tree.nodes.at(c);
        EXPECT_EQ(child.firstLeaf, leaf);
        EXPECT_LT(child.firstLeaf, child.endLeaf);
        leaf = child.endLeaf;
        EXPECT_TRUE(isIn(child.origin, node));
        EXPECT_EQ(child.log2Cells, node.log2Cells == WorkloadNode::kRoot ? 12 : node.log2Cells - 1);
        if (node.log2Cells == WorkloadNode::kRoot) continue;
        int own = 0;
        for (std::size_t k = 0; k < 3; ++k) own = own << 1 | (child.origin[k] >> child.log2Cells & 1);
        EXPECT_LT(octant, own);
        octant = own;
    }
    EXPECT_EQ(leaf, node.endLeaf);
}

void expectSoundTree(const WorkloadTree& tree, const SparseGrid& grid, const WorkEstimate& estimate,
                     std::uint64_t nodeBytes, int blockLog2Cells)
{
    ASSERT_FALSE(tree.nodes.empty());
    EXPECT_EQ(tree.nodes[0].log2Cells, WorkloadNode::kRoot);
    EXPECT_EQ(tree.nodes[0].firstLeaf, 0u);
    EXPECT_EQ(tree.nodes[0].endLeaf, grid.leafCount());
    std::vector<int> parents(tree.nodes.size());
    for (const WorkloadNode& node : tree.nodes) {
        expectWorkOfLeaves(node, estimate, grid);
        const bool isLarge = blockBytes(node, tree.options.model).total() > nodeBytes ||
                             (blockLog2Cells && node.log2Cells > blockLog2Cells);
        const bool isDivided = isLarge && node.log2Cells > 3 && node.firstLeaf < node.endLeaf;
        EXPECT_EQ(node.childCount > 0, isDivided);
        for (std::uint32_t c = 0; c < node.childCount; ++c) ++parents.at(node.firstChild + c);
        if (isDivided) expectChildren(node, tree);
    }
    EXPECT_EQ(parents[0], 0);
    EXPECT_TRUE(std::all_of(parents.begin() + 1, parents.end(), [](int n) { return n == 1; }));
}

TEST(WorkloadTree, NodesAreCubesWithTheSumsOfTheirLeaves)
{
    forEachGrid([](const PointSet&, const SparseGrid& grid) {
        const WorkEstimate estimate = fixedEstimate(grid);
        for (const Encoding encoding : {Encoding::kMask, Encoding::kIndex, Encoding::kNone}) {
            const std::uint64_t all = blockBytes(treeOf(grid, estimate, ~0ull, encoding).nodes[0],
                                                 treeOf(grid, estimate, ~0ull, encoding).options.model)
                                          .total();
            for (const std::uint64_t nodeBytes : {all, all - 1, all / 2, all / 10, std::uint64_t(0)}) {
                for (const int blockLog2Cells : {0, 3, 5, 12}) {
                    const WorkloadTree tree = treeOf(grid, estimate, nodeBytes, encoding, blockLog2Cells);
                    expectSoundTree(tree, grid, estimate, nodeBytes, blockLog2Cells);
                    if (nodeBytes == all && blockLog2Cells == 0) {
                        EXPECT_EQ(tree.nodes.size(), 1u);
                    }
                }
            }
        }
    });
}

TEST(WorkloadTree, IsTheSameForAnyNumberOfThreads)
{
    const PointSet set = arraySets(Precision::kDouble, 6)[7]; // spray
    const SetView input(set, Form::kDoubles);
    const SparseGrid grid = gridOf(input.view(), set.radius, 2);
    const WorkEstimate estimate = estimateWork(grid);
    WorkloadTree first;
    for (const int threads : {1, 2, 4}) {
        WorkloadTree tree;
        runOnThreads(threads, [&] { tree = treeOf(grid, estimate, 0); });
        if (threads == 1) first = tree;
        ASSERT_EQ(tree.nodes.size(), first.nodes.size());
        for (std::size_t n = 0; n < tree.nodes.size(); ++n) {
            EXPECT_EQ(tree.nodes[n].origin, first.nodes[n].origin);
            EXPECT_EQ(tree.nodes[n].work.expectedPairs, first.nodes[n].work.expectedPairs);
            EXPECT_EQ(tree.nodes[n].firstChild, first.nodes[n].firstChild);
            expectSameSize(tree.nodes[n].halo, first.nodes[n].halo);
        }
    }
}

TEST(WorkloadTree, AnEstimateOfAnotherGridIsRefused)
{
    const double line[6] = {0, 0, 0, 100, 0, 0};
    const SparseGrid two = gridOf(ParticleView::fromArray(line, 2), 1, 1);
    const SparseGrid one = gridOf(ParticleView::fromArray(line, 1), 1, 1);
    EXPECT_THROW(treeOf(two, fixedEstimate(one), 0), InvalidInput);
}

class Stopped final : public Progress {
public:
    void update(const char*, double) override {}
    bool cancelled() const override { return true; }
};

TEST(WorkloadTree, IsStoppedByAProgress)
{
    const double line[6] = {0, 0, 0, 100, 0, 0};
    const SparseGrid grid = gridOf(ParticleView::fromArray(line, 2), 1, 1);
    Stopped stopped;
    WorkloadTreeOptions options;
    options.progress = &stopped;
    EXPECT_THROW(buildWorkloadTree(grid, fixedEstimate(grid), options), Cancelled);
}

TEST(BlockBytes, AreThoseOfTheHeader)
{
    WorkloadNode node;
    node.firstLeaf = 10;
    node.endLeaf = 12;
    node.occupiedCells = 7;
    node.work = {100, 1000.5, 5000, 1234};
    node.halo = {20, 5, 3, 50, 2};
    MemoryModel model;
    // The particles, cells and leaves of block and halo, a neighborhood for each own leaf; the ends; whole lines of 16.
    const std::uint64_t up = 16 * 120 + 4 * (7 + 5) + 2 * (80 + 112) + 3 * 80 + 84 + 12;
    EXPECT_EQ(blockBytes(node, model).up, up);
    // The head, counts, room for undecided pairs: 256 bytes and a quarter of one for each query.
    const std::uint64_t counts = 32u + 400 + 256 + 25;
    EXPECT_EQ(blockBytes(node, model).down, counts + 1234 + 2 * 8 + 8);
    // 4 groups of 32 queries in one tile, the end, and alignment.
    EXPECT_EQ(blockBytes(node, model).scratch, 8u * (4 + 1 + 1) + 8);
    // Without the halo: the cells to be searched of two boundary leaves.
    EXPECT_EQ(blockBytes(node, model, false).up, 16u * 100 + 4 * 7 + 2 * 192 + 2 * 64 + 84 + 0);
    model.encoding = Encoding::kNone;
    EXPECT_EQ(blockBytes(node, model).down, counts);
    EXPECT_EQ(blockBytes(node, model).scratch, 0u);
    model.encoding = Encoding::kIndex;
    model.margin = 0.5;
    model.auxNeighbors = 3;
    EXPECT_EQ(blockBytes(node, model).down, counts + 4 * 1801); // 1500.75 + 300
    EXPECT_EQ(blockBytes(node, model).total(), up + counts + 4 * 1801 + 56);
}

// More than 2^64 bytes are a great many, not a few.
TEST(BlockBytes, OfAnEstimateBeyondAllMeasureAreLarge)
{
    WorkloadNode node;
    MemoryModel model;
    model.encoding = Encoding::kIndex;
    for (const double pairs : {1e17, 1e18, 4.5e18, 1e19, 1e20, 1e300, kInf}) {
        node.work = {100, pairs, 5000, 1234};
        EXPECT_GT(blockBytes(node, model).total(), std::uint64_t(1) << 57) << pairs;
    }
}

} // namespace

} // namespace vdb_nns::testing
