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

TransferredBlock transferBlock(BlockDevice& device, const DeviceBuffer& buffer, const SparseGridData& grid,
                               const BlockPart& part, const TransferPlan& plan)
{
    const BlockImage image = writeImage(grid, part, buffer.staging, buffer.device);
    const std::uint64_t resultBytes = buffer.bytes - image.bytes,
                        room = resultRoom(resultBytes, queriesOf(part), plan.encoding);
    std::byte* const result = buffer.device + image.bytes;
    TransferredBlock transferred;
    transferred.layout = resultLayout(image.leaves, queriesOf(part), plan.encoding);
    transferred.bytesUp = image.bytes;
    device.upload(buffer.number, buffer.device, buffer.staging, image.bytes);
    device.search(buffer.number, {image, plan.bounds, plan.encoding, result, resultBytes});
    // The image is on the device; its staging memory takes the result.
    std::uint64_t there = std::min(std::max(plan.bytesDown, transferred.layout.rows), room);
    transferred.result = device.download(buffer.number, buffer.staging, result, there);
    transferred.times = device.wait(buffer.number);
    std::memcpy(&transferred.head, transferred.result, sizeof transferred.head);
    const std::uint64_t needed = transferred.layout.end(transferred.head);
    transferred.overflowed = needed > room;
    if (!transferred.overflowed && needed > there) {
        device.download(buffer.number, buffer.staging + there, result + there, needed - there);
        add(transferred.times, device.wait(buffer.number));
        there = needed;
    }
    transferred.bytesDown = there;
    return transferred;
}

} // namespace vdb_nns
