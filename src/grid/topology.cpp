// The OpenVDB tree of a sparse grid. One of the few files that include OpenVDB.
#include "grid/topology.h"

#include "grid/sparse_grid_data.h"
#include "vdb_nns/openvdb_bridge.h"

#include <openvdb/tree/ValueAccessor.h>

#include <tbb/parallel_for.h>

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
    std::vector<Leaf*> leaves; // owned by the tree
};

Topology::Topology() : mTree(std::make_unique<Tree>()) {}
Topology::~Topology() = default;

void Topology::build(Span<const Vec3i> origins)
{
    mTree->tree.clear();
    mTree->leaves.resize(origins.size());
    const std::vector<std::size_t> runs = nodeRuns(origins, 7);
    std::vector<Lower*> lowers(runs.size() - 1);
    tbb::parallel_for(std::size_t(0), lowers.size(), [&](std::size_t n) {
        lowers[n] = new Lower(originOf(origins[runs[n]], 7), false);
        for (std::size_t i = runs[n]; i < runs[n + 1]; ++i) {
            Leaf* leaf = new Leaf(coordOf(origins[i]), false);
            leaf->setTransientData(static_cast<openvdb::Index32>(i));
            mTree->leaves[i] = leaf;
            lowers[n]->addChild(leaf);
        }
    });
    Upper* upper = nullptr;
    for (std::size_t n = 0; n < lowers.size(); ++n) {
        const openvdb::Coord origin = originOf(origins[runs[n]], 12);
        if (!upper || upper->origin() != origin) {
            upper = new Upper(origin, false);
            mTree->tree.root().addChild(upper);
        }
        upper->addChild(lowers[n]);
    }
}

std::uint64_t* Topology::occupancy(std::size_t i)
{
    static_assert(sizeof(Leaf::Buffer::WordType) == sizeof(std::uint64_t),
                  "one word is one x slab of 64 cells");
    return reinterpret_cast<std::uint64_t*>(mTree->leaves[i]->buffer().data());
}

void Topology::neighborhoods(Span<const Vec3i> origins, LeafNeighborhood* out) const
{
    // Not registered with the tree: the topology cannot change while a grid is searched.
    openvdb::tree::ValueAccessor<const openvdb::MaskTree, false> accessor(mTree->tree);
    for (std::size_t i = 0; i < origins.size(); ++i) {
        const openvdb::Coord origin = coordOf(origins[i]);
        std::uint32_t* leaf = out[i].leaf;
        // Two leaves in three have all their neighbors in their own 128^3 node: those are read from its table.
        const auto* const lower = accessor.template probeConstNode<Lower>(origin);
        const int x0 = origin.x() >> 3 & 15, y0 = origin.y() >> 3 & 15, z0 = origin.z() >> 3 & 15;
        for (int x = -1; x <= 1; ++x) {
            for (int y = -1; y <= 1; ++y) {
                for (int z = -1; z <= 1; ++z) {
                    const int nx = x0 + x, ny = y0 + y, nz = z0 + z;
                    const Leaf* found;
                    if (lower && !((nx | ny | nz) & ~15)) {
                        const openvdb::Index n = nx << 8 | ny << 4 | nz;
                        found = lower->isChildMaskOn(n) ? lower->getTable()[n].getChild() : nullptr;
                    } else {
                        found = accessor.probeConstLeaf(origin.offsetBy(8 * x, 8 * y, 8 * z));
                    }
                    *leaf++ = found ? found->transientData() : kNoLeaf;
                }
            }
        }
    }
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
