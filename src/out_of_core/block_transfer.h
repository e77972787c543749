// One block on a device, from its image to its result in host memory. Knows the grid and devices; nothing of schedules.
#pragma once

#include "out_of_core/block_image.h"
#include "shared/block_device.h"

#include <cstddef>
#include <cstdint>

namespace vdb_nns {

// Where a device holds a block, and where the host does: as much memory each.
struct DeviceSlot {
    int number;
    std::byte *device, *staging;
    std::uint64_t bytes;
};

struct FlightPlan {
    FilterBounds bounds;
    Encoding encoding;
    std::uint64_t bytesDown; // of the result; 0 where that is not known before
};

struct FlownBlock {
    ResultLayout layout{};
    std::byte* result = nullptr; // in host memory; without its rows after an overflow
    ResultHead head{};
    bool overflowed = false;
    std::uint64_t bytesUp = 0, bytesDown = 0;
    StepTimes times;
};

// Bytes that a part takes on a device at the least, with a result of no rows.
std::uint64_t leastBytes(const SparseGridData& grid, const BlockPart& part, Encoding encoding);

// The part has room in the slot for leastBytes(). Throws DeviceError.
FlownBlock flyBlock(BlockDevice& device, const DeviceSlot& slot, const SparseGridData& grid,
                    const BlockPart& part, const FlightPlan& plan);

} // namespace vdb_nns
