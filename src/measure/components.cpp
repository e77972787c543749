#include "measure/components.h"

#include <tbb/blocked_range.h>
#include <tbb/parallel_for.h>

#include <new>
#include <utility>

namespace vdb_nns {

Components::Components(std::size_t count, PageArray<char>& memory)
{
    memory.resizeDiscarding(count * sizeof(Parent));
    mParents = reinterpret_cast<Parent*>(memory.data());
    tbb::parallel_for(tbb::blocked_range<std::size_t>(0, count, 16384), [&](const auto& range) {
        for (std::size_t i = range.begin(); i < range.end(); ++i)
            new (mParents + i) Parent(static_cast<std::uint32_t>(i));
    });
}

// Halves the way up: every second one on it is hung below its grandparent. A parent never has a larger number than its child, so
// what another thread does meanwhile only shortens the way.
std::uint32_t Components::find(std::uint32_t a)
{
    for (;;) {
        std::uint32_t up = parent(a).load(std::memory_order_relaxed);
        if (up == a) return a;
        const std::uint32_t above = parent(up).load(std::memory_order_relaxed);
        if (above == up) return up;
        parent(a).compare_exchange_weak(up, above, std::memory_order_relaxed);
        a = above;
    }
}

std::uint32_t Components::unite(std::uint32_t a, std::uint32_t b)
{
    for (;;) {
        a = find(a);
        b = find(b);
        if (a == b) return a;
        if (a > b) std::swap(a, b);
        std::uint32_t alone = b;
        if (parent(b).compare_exchange_strong(alone, a, std::memory_order_relaxed)) return a;
    }
}

} // namespace vdb_nns
