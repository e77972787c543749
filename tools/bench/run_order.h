// The order in which things that are compared take their turns.
#pragma once

#include "numbers.h"

#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <numeric>
#include <vector>

namespace vdb_nns::cli {

/// 0 to count - 1, in another order in each run: what one leaves behind in caches and memory is not always met by the same one.
inline std::vector<std::size_t> orderOfRun(std::size_t count, std::uint64_t run)
{
    std::vector<std::size_t> order(count);
    std::iota(order.begin(), order.end(), std::size_t(0));
    std::sort(order.begin(), order.end(),
              [run](std::size_t a, std::size_t b) { return mix64(mix64(run) + a) < mix64(mix64(run) + b); });
    return order;
}

} // namespace vdb_nns::cli
