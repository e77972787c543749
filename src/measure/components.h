// Connected components of pairs that come from several threads in any order: union-find without locks. The larger of two roots is
// hung below the smaller one, so that in the end the root of a component is its smallest number, whatever the order was.
#pragma once

#include "util/memory.h"

#include <atomic>
#include <cstddef>
#include <cstdint>

namespace vdb_nns {

class Components {
public:
    // Each of so many numbers alone. Takes 4 bytes a number of `memory`, which outlives it.
    Components(std::size_t count, PageArray<char>& memory);

    // Joins `a` with those numbers that are `wanted`; ones already known to be with it cost a look. Thread-safe.
    template <typename Wanted>
    void unite(std::uint32_t a, const std::uint32_t* with, std::uint32_t count, Wanted&& wanted)
    {
        std::uint32_t k = 0;
        while (k < count && !wanted(with[k])) ++k;
        if (k == count) return;
        std::uint32_t root = unite(a, with[k]);
        // Mostly all are together already: one loop without branches tells.
        const auto isApart = [&](std::uint32_t b) {
            return unsigned(wanted(b)) & unsigned(parent(b).load(std::memory_order_relaxed) != root);
        };
        unsigned areApart = 0;
        for (std::uint32_t i = ++k; i < count; ++i) areApart |= isApart(with[i]);
        if (areApart == 0) return;
        for (; k < count; ++k) {
            if (isApart(with[k])) root = unite(root, with[k]);
        }
    }
    // Root of a component. Thread-safe.
    std::uint32_t find(std::uint32_t a);
    bool isRoot(std::uint32_t a) { return parent(a).load(std::memory_order_relaxed) == a; }

private:
    using Parent = std::atomic<std::uint32_t>;
    static_assert(sizeof(Parent) == sizeof(std::uint32_t), "numbers are swapped in place");

    // The root of the two components together.
    std::uint32_t unite(std::uint32_t a, std::uint32_t b);
    Parent& parent(std::uint32_t i) { return mParents[i]; }

    Parent* mParents;
};

} // namespace vdb_nns
