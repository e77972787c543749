// The OpenVDB tree over the occupied leaves, behind plain types so that OpenVDB's headers (40 s a file to compile) stay
// in topology.cpp and the bridge.
#pragma once

#include "shared/block_view.h"
#include "util/cancel.h"
#include "vdb_nns/types.h"

#include <cstdint>
#include <memory>

namespace vdb_nns {

// Leaf indices around a leaf: [(dx+1)*9 + (dy+1)*3 + (dz+1)], kNoLeaf where nothing is; [kOwnLeaf] is the leaf itself.
struct LeafNeighborhood {
    std::uint32_t leaf[kLeavesAround];
};

class Topology {
public:
    Topology();
    ~Topology();
    Topology(const Topology&) = delete;
    Topology& operator=(const Topology&) = delete;

    // Rebuilds the tree with a leaf at each of `origins` (cell coordinates, multiples of 8, no duplicates). Leaves of one
    // 128^3 node must stand together, and nodes of one 4096^3 node too. Masks are empty. In parallel. Throws Cancelled.
    void build(Span<const Vec3i> origins, const CancelCheck& cancel);

    // The 8 mask words of leaf i, in the order of openvdb::util::NodeMask<3>. Stay in place until the next build().
    std::uint64_t* occupancy(std::size_t i);

    // Fills out[k] with the neighborhood of the leaf at origins[k]. Fast when consecutive leaves are near each other.
    void neighborhoods(Span<const Vec3i> origins, LeafNeighborhood* out) const;
    // The same, but only of the leaves whose bits are set in wanted[k]; the others are kNoLeaf.
    void neighborhoods(Span<const Vec3i> origins, const std::uint32_t* wanted, LeafNeighborhood* out) const;

    std::uint64_t bytes() const;

    // What build() will take from the heap, with what the heap itself adds to each leaf. Cost: a pass over the leaves.
    static std::uint64_t bytesToBuild(Span<const Vec3i> origins);

    struct Tree; // wraps openvdb::MaskTree
    const Tree& tree() const { return *mTree; }

private:
    std::unique_ptr<Tree> mTree;
};

} // namespace vdb_nns
