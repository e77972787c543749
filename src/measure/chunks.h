// Passes over numbers of particles in parts that are asked whether to go on, with IEEE arithmetic whatever the host has set.
#pragma once

#include "util/cancel.h"
#include "util/ieee_mode.h"

#include <tbb/blocked_range.h>
#include <tbb/parallel_for.h>

#include <cstddef>

namespace vdb_nns {

constexpr std::size_t kMeasureChunk = 8192;

// f(begin, end) for parts of [0, count).
template <typename F>
void forEachChunk(std::size_t count, const CancelCheck& cancel, F&& f)
{
    tbb::parallel_for(tbb::blocked_range<std::size_t>(0, count, kMeasureChunk), [&](const auto& range) {
        cancel.check();
        const IeeeMode mode;
        f(range.begin(), range.end());
    });
}

} // namespace vdb_nns
