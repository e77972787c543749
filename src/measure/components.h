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

    // Joins `a` with a row of numbers that is filled up to a multiple of kRowPad with one of them. Thread-safe.
    void uniteRow(std::uint32_t a, const std::uint32_t* with, std::uint32_t count)
    {
        if (count == 0) return;
        std::uint32_t root = unite(a, with[0]);
        // Mostly all are together already: one loop without branches tells.
        std::uint32_t apart = 0;
        for (std::uint32_t k = 0; k < count; k += kRowPad) {
            for (std::uint32_t i = 0; i < kRowPad; ++i) apart |= parentOf(with[k + i]) ^ root;
        }
        for (std::uint32_t k = 0; k < count && apart != 0; ++k) {
            if (parentOf(with[k]) != root) root = unite(root, with[k]);
        }
    }
    static constexpr std::uint32_t kRowPad = 8;
    // Joins a component, by its root as far as that is known, with `b`, and returns the root of both. Thread-safe.
    std::uint32_t uniteKnown(std::uint32_t root, std::uint32_t b)
    {
        return parentOf(b) == root ? root : unite(root, b);
    }
    // Root of a component. Thread-safe.
    std::uint32_t find(std::uint32_t a);
    bool isRoot(std::uint32_t a) { return parentOf(a) == a; }

private:
    using Parent = std::atomic<std::uint32_t>;
    static_assert(sizeof(Parent) == sizeof(std::uint32_t), "numbers are swapped in place");

    // The root of the two components together.
    std::uint32_t unite(std::uint32_t a, std::uint32_t b);
    Parent& parent(std::uint32_t i) { return mParents[i]; }
    std::uint32_t parentOf(std::uint32_t i) { return parent(i).load(std::memory_order_relaxed); }

    Parent* mParents;
};

} // namespace vdb_nns
