// Connected components of pairs that come from several threads in any order: union-find without locks. The larger of two roots is
// hung below the smaller one, so that in the end the root of a component is its smallest number, whatever the order was.
#pragma once

#include "util/memory.h"

#include <atomic>
#include <cstddef>
#include <cstdint>
#include <vector>

namespace vdb_nns {

class Components {
public:
    // Each of so many numbers alone. 4 bytes a number.
    explicit Components(std::size_t count);

    // Thread-safe. `with` are joined with `a`; those already known to be with it cost a look.
    void unite(std::uint32_t a, const std::uint32_t* with, std::uint32_t count);
    // Root of a component. Thread-safe.
    std::uint32_t find(std::uint32_t a);

private:
    using Parent = std::atomic<std::uint32_t>;
    static_assert(sizeof(Parent) == sizeof(std::uint32_t), "numbers are swapped in place");

    // The root of the two components together.
    std::uint32_t unite(std::uint32_t a, std::uint32_t b);
    Parent& parent(std::uint32_t i) { return mParents[i]; }

    PageBlock mMemory;
    Parent* mParents;
};

// Labels of clusters and how many are in each.
struct ClusterLabels {
    std::vector<std::uint32_t> label; // by number; kNoCluster
    std::vector<std::uint32_t> size;  // by label
    static constexpr std::uint32_t kNoCluster = 0xffffffffu;
};

} // namespace vdb_nns
