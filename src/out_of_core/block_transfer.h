// One block on a device, from its image to its result in host memory. Knows the grid and devices; nothing of schedules.
#pragma once

#include "out_of_core/block_image.h"
#include "shared/block_device.h"

#include <cstddef>
#include <cstdint>

namespace vdb_nns {

// Where a device holds a block, and where the host does: as much memory each.
struct DeviceBuffer {
    int number;
    std::byte *device, *staging;
    std::uint64_t bytes;
};

struct TransferPlan {
    FilterBounds bounds;
    Encoding encoding;
    std::uint64_t bytesDown; // of the result; 0 where that is not known before
};

struct TransferredBlock {
    ResultLayout layout{};
    std::byte* result = nullptr; // in host memory; without its rows after an overflow
    ResultHead head{};
    bool overflowed = false;
    std::uint64_t bytesUp = 0, bytesDown = 0;
    StepTimes times;
};

// Bytes that a part takes on a device at the least, with a result of no rows.
std::uint64_t leastBytes(const SparseGridData& grid, const BlockPart& part, Encoding encoding);

// The part has room in the buffer for leastBytes(). Throws DeviceError.
TransferredBlock transferBlock(BlockDevice& device, const DeviceBuffer& buffer, const SparseGridData& grid,
                               const BlockPart& part, const TransferPlan& plan);

} // namespace vdb_nns
