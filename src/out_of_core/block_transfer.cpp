// See block_flight.h.
#include "out_of_core/block_transfer.h"

#include <algorithm>
#include <cstring>

namespace vdb_nns {

namespace {

std::uint64_t queriesOf(const BlockPart& part)
{
    return part.endSlot - part.firstSlot;
}

void add(StepTimes& sum, const StepTimes& times)
{
    sum.uploadSeconds += times.uploadSeconds;
    sum.searchSeconds += times.searchSeconds;
    sum.downloadSeconds += times.downloadSeconds;
}

} // namespace

std::uint64_t leastBytes(const SparseGridData& grid, const BlockPart& part, Encoding encoding)
{
    constexpr std::uint64_t kAlignment = 8; // of the scratch
    return imageBytes(grid, part) +
           resultLayout(part.endLeaf - part.firstLeaf, queriesOf(part), encoding).rows +
           scratchBytes(queriesOf(part), encoding) + kAlignment;
}

FlownBlock flyBlock(BlockDevice& device, const DeviceSlot& slot, const SparseGridData& grid,
                    const BlockPart& part, const FlightPlan& plan)
{
    const BlockImage image = writeImage(grid, part, slot.staging, slot.device);
    const std::uint64_t resultBytes = slot.bytes - image.bytes,
                        room = resultRoom(resultBytes, queriesOf(part), plan.encoding);
    std::byte* const result = slot.device + image.bytes;
    FlownBlock flown;
    flown.layout = resultLayout(image.leaves, queriesOf(part), plan.encoding);
    flown.bytesUp = image.bytes;
    device.upload(slot.number, slot.device, slot.staging, image.bytes);
    device.search(slot.number, {image, plan.bounds, plan.encoding, result, resultBytes});
    // The image is on the device; its staging memory takes the result.
    std::uint64_t there = std::min(std::max(plan.bytesDown, flown.layout.rows), room);
    flown.result = device.download(slot.number, slot.staging, result, there);
    flown.times = device.wait(slot.number);
    std::memcpy(&flown.head, flown.result, sizeof flown.head);
    const std::uint64_t needed = flown.layout.end(flown.head);
    flown.overflowed = needed > room;
    if (!flown.overflowed && needed > there) {
        device.download(slot.number, slot.staging + there, result + there, needed - there);
        add(flown.times, device.wait(slot.number));
        there = needed;
    }
    flown.bytesDown = there;
    return flown;
}

} // namespace vdb_nns
