// What runs blocks under a budget of memory. A block takes five steps: it is staged in host memory, uploaded, searched,
// downloaded and collected; a device does the middle three, for several buffers at once. Knows images of blocks, not
// schedules. Any compiler.
#pragma once

#include "shared/block_result.h"
#include "shared/block_view.h"
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

// How long steps took, by the device's own clock.
struct StepTimes {
    double uploadSeconds = 0, searchSeconds = 0, downloadSeconds = 0;
};

// Steps of one buffer are called one after the other; different buffers may be served by different threads at once. upload(),
// search() and download() may return before they are done; wait() returns when all of its buffer's are.
// A step that fails throws DeviceError: the block is lost, and the device with it.
class BlockDevice {
public:
    virtual ~BlockDevice() = default;

    // A simulated device searches on the caller's thread, in time that its rates say. Any other one works while wait()
    // sleeps, and measures its times.
    virtual bool isSimulated() const = 0;

    // Memory of the device, and host memory that transfers are fast from and to; until everything is released, or the
    // device destroyed. Throws OutOfDeviceMemory for either. One staging area for each piece of memory, in the same order.
    virtual std::byte* allocate(std::uint64_t bytes) = 0;
    virtual std::byte* allocateStaging(std::uint64_t bytes) = 0;
    virtual void releaseAll() = 0;
    // A new run begins: all memory has been given back, and may be handed out again.
    virtual void restart() { releaseAll(); }

    virtual void upload(int buffer, std::byte* device, const std::byte* staging, std::uint64_t bytes) = 0;
    // A result that finds no room is counted on to its true size, in its ResultHead and its counts; its rows are unusable.
    virtual void search(int buffer, const BlockSearch& block) = 0;
    // Returns where the bytes are to be read and changed after wait(): in `staging`, or where they were if the host can
    // read the device's memory.
    virtual std::byte* download(int buffer, std::byte* staging, std::byte* device, std::uint64_t bytes) = 0;
    // Of the buffer's steps since it was waited for last; 0 for a simulated device.
    virtual StepTimes wait(int buffer) = 0;

    virtual std::uint64_t peakBytes() const = 0;
};

} // namespace vdb_nns
