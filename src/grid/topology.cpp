// The OpenVDB tree of a sparse grid. One of the few files that include OpenVDB.
#include "grid/topology.h"

#include "grid/sparse_grid_data.h"
#include "util/isolate.h"
#include "vdb_nns/openvdb_bridge.h"

#include <openvdb/tree/ValueAccessor.h>

#include <tbb/parallel_for.h>

#include <algorithm>
#include <memory>
#include <vector>

namespace vdb_nns {

namespace {

using Tree = openvdb::MaskTree;
using Upper = Tree::RootNodeType::ChildNodeType; // 4096^3 cells
using Lower = Upper::ChildNodeType;              // 128^3 cells
using Leaf = Tree::LeafNodeType;                 // 8^3 cells

openvdb::Coord coordOf(const Vec3i& v)
{
    return {v[0], v[1], v[2]};
}

openvdb::Coord originOf(const Vec3i& v, int log2Dim)
{
    const std::int32_t mask = ~((1 << log2Dim) - 1);
    return {v[0] & mask, v[1] & mask, v[2] & mask};
}

// Index of the first element of each run of leaves in one node of 2^log2Dim cells, and the end.
std::vector<std::size_t> nodeRuns(Span<const Vec3i> origins, int log2Dim)
{
    std::vector<std::size_t> runs;
    for (std::size_t i = 0; i < origins.size(); ++i) {
        if (i == 0 || originOf(origins[i], log2Dim) != originOf(origins[i - 1], log2Dim)) runs.push_back(i);
    }
    runs.push_back(origins.size());
    return runs;
}

} // namespace

struct Topology::Tree {
    openvdb::MaskTree tree;
    std::vector<Leaf*> leaves;           // owned by the tree
    std::vector<Lower*> lowers;          // owned by the tree
    std::vector<std::size_t> lowerBegin; // index of each lower node's first leaf, and the end
    std::vector<std::unique_ptr<Leaf>> spare;

    // Takes the tree apart but for its leaves: making and freeing those, one by one, costs as much as all else of a build.
    void reclaimLeaves()
    {
        spare.resize(std::max(spare.size(), leaves.size()));
        tbb::parallel_for(std::size_t(0), lowers.size(), [&](std::size_t n) {
            for (std::size_t i = lowerBegin[n]; i < lowerBegin[n + 1]; ++i) {
                spare[i].reset(lowers[n]->stealNode<Leaf>(leaves[i]->origin(), false, false));
            }
        });
        leaves.clear();
        lowers.clear();
        tree.clear();
    }
};

Topology::Topology() : mTree(std::make_unique<Tree>()) {}
Topology::~Topology()
{
    isolated([this] { mTree.reset(); }); // OpenVDB frees its nodes in parallel
}

void Topology::build(Span<const Vec3i> origins, const CancelCheck& cancel)
{
    mTree->reclaimLeaves();
    std::vector<std::unique_ptr<Leaf>>& spare = mTree->spare;
    spare.resize(origins.size());
    mTree->lowerBegin = nodeRuns(origins, 7);
    const std::vector<std::size_t>& runs = mTree->lowerBegin;
    std::vector<std::unique_ptr<Lower>> lowers(runs.size() - 1);
    std::vector<Leaf*> leaves(origins.size());
    tbb::parallel_for(std::size_t(0), lowers.size(), [&](std::size_t n) {
        cancel.check();
        lowers[n] = std::make_unique<Lower>(originOf(origins[runs[n]], 7), false);
        for (std::size_t i = runs[n]; i < runs[n + 1]; ++i) {
            if (!spare[i]) spare[i] = std::make_unique<Leaf>(coordOf(origins[i]), false);
            Leaf* const leaf = spare[i].release();
            leaves[i] = leaf;
            leaf->setOrigin(coordOf(origins[i]));
            leaf->setValuesOff();
            leaf->setTransientData(static_cast<openvdb::Index32>(i));
            lowers[n]->addChild(leaf);
        }
    });
    std::vector<Lower*> inTree;
    inTree.reserve(lowers.size());
    Upper* upper = nullptr;
    for (std::size_t n = 0; n < lowers.size(); ++n) {
        const openvdb::Coord origin = originOf(origins[runs[n]], 12);
        if (!upper || upper->origin() != origin) {
            upper = new Upper(origin, false);
            mTree->tree.root().addChild(upper);
        }
        inTree.push_back(lowers[n].release());
        upper->addChild(inTree.back());
    }
    mTree->leaves = std::move(leaves);
    mTree->lowers = std::move(inTree);
}

std::uint64_t* Topology::occupancy(std::size_t i)
{
    static_assert(sizeof(Leaf::Buffer::WordType) == sizeof(std::uint64_t),
                  "one word is one x slab of 64 cells");
    return reinterpret_cast<std::uint64_t*>(mTree->leaves[i]->buffer().data());
}

void Topology::neighborhoods(Span<const Vec3i> origins, LeafNeighborhood* out) const
{
    neighborhoods(origins, nullptr, out);
}

void Topology::neighborhoods(Span<const Vec3i> origins, const std::uint32_t* wanted,
                             LeafNeighborhood* out) const
{
    // Not registered with the tree: the topology cannot change while a grid is searched.
    openvdb::tree::ValueAccessor<const openvdb::MaskTree, false> accessor(mTree->tree);
    for (std::size_t i = 0; i < origins.size(); ++i) {
        const openvdb::Coord origin = coordOf(origins[i]);
        std::uint32_t* leaf = out[i].leaf;
        std::uint32_t left = wanted ? wanted[i] : ~0u; // three bits for each column
        // Most leaves have most of their neighbors in their own 128^3 node: those are read from its table, and three of a
        // column at a time from its mask, for on sparse scenes most are empty.
        const auto* const lower = accessor.template probeConstNode<Lower>(origin);
        const int x0 = origin.x() >> 3 & 15, y0 = origin.y() >> 3 & 15, z0 = origin.z() >> 3 & 15;
        const bool zInside = z0 > 0 && z0 < 15;
        for (int x = -1; x <= 1; ++x) {
            for (int y = -1; y <= 1; ++y, leaf += 3, left >>= 3) {
                leaf[0] = leaf[1] = leaf[2] = kNoLeaf;
                if (!(left & 7)) continue;
                const int nx = x0 + x, ny = y0 + y;
                if (lower && zInside && !((nx | ny) & ~15)) {
                    const openvdb::Index n = nx << 8 | ny << 4 | (z0 - 1);
                    const std::uint64_t word =
                        lower->getChildMask().template getWord<openvdb::Index64>(n >> 6);
                    for (auto bits = static_cast<unsigned>(word >> (n & 63)) & left & 7; bits;
                         bits &= bits - 1) {
                        const int z = __builtin_ctz(bits);
                        leaf[z] = lower->getTable()[n + static_cast<unsigned>(z)].getChild()->transientData();
                    }
                    continue;
                }
                for (int z = 0; z < 3; ++z) {
                    if (!(left >> z & 1)) continue;
                    const Leaf* const found =
                        accessor.probeConstLeaf(origin.offsetBy(8 * x, 8 * y, 8 * (z - 1)));
                    if (found) leaf[z] = found->transientData();
                }
            }
        }
    }
}

std::uint64_t Topology::bytesToBuild(Span<const Vec3i> origins)
{
    constexpr std::uint64_t kHeapBytes = 16; // before each block, and its rounding
    constexpr std::uint64_t kLeafBytes = sizeof(Leaf) + kHeapBytes + 2 * sizeof(Leaf*); // in use and spare
    const auto nodes = [&](int log2Dim) -> std::uint64_t { return nodeRuns(origins, log2Dim).size() - 1; };
    return origins.size() * kLeafBytes + nodes(7) * (sizeof(Lower) + kHeapBytes) +
           nodes(12) * (sizeof(Upper) + kHeapBytes);
}

std::uint64_t Topology::bytes() const
{
    return mTree->tree.memUsage() + mTree->leaves.size() * sizeof(Leaf*);
}

const openvdb::MaskTree& topologyOf(const SparseGrid& grid)
{
    return grid.data().topology.tree().tree;
}

} // namespace vdb_nns
