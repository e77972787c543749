// What runs blocks under a budget of memory. A block takes five steps: it is staged in host memory, uploaded, searched,
// downloaded and collected; a device does the middle three, for several slots at once. Knows images of blocks, not schedules.
#pragma once

#include "execute/block_image.h"
#include "shared/membership.h"
#include "vdb_nns/error.h"
#include "vdb_nns/search_options.h"

#include <cstddef>
#include <cstdint>

namespace vdb_nns {

// A block on a device, ready to be searched.
struct BlockSearch {
    BlockImage image;
    FilterBounds bounds;
    Encoding encoding;
    std::byte* result;         // on the device, aligned to 16 bytes; see ResultHead
    std::uint64_t resultBytes; // room for it
};

// The device has not so much memory left.
class OutOfDeviceMemory : public DeviceError {
public:
    using DeviceError::DeviceError;
};

// Steps of one slot are called one after the other; different slots may be served by different threads at once. upload(),
// search() and download() may return before they are done; wait() returns when all of its slot's are.
// A step that fails throws DeviceError: the block is lost, and the device with it.
class BlockDevice {
public:
    virtual ~BlockDevice() = default;

    // Memory of the device, and host memory that transfers are fast from and to; until everything is released, or the
    // device destroyed. Throws OutOfDeviceMemory for either.
    virtual std::byte* allocate(std::uint64_t bytes) = 0;
    virtual std::byte* allocateStaging(std::uint64_t bytes) = 0;
    virtual void releaseAll() = 0;

    virtual void upload(int slot, std::byte* device, const std::byte* staging, std::uint64_t bytes) = 0;
    // A result that finds no room is counted on to its true size, in its ResultHead and its counts; its rows are unusable.
    virtual void search(int slot, const BlockSearch& block) = 0;
    virtual void download(int slot, std::byte* staging, const std::byte* device, std::uint64_t bytes) = 0;
    virtual void wait(int slot) = 0;

    virtual std::uint64_t peakBytes() const = 0;
};

} // namespace vdb_nns
