#include "io/npz_parts.h"

#include "io/output_file.h"
#include "util/cancel.h"

#include <algorithm>
#include <vector>

#include <libdeflate.h>
#include <zlib.h>

namespace vdb_nns {

namespace {

// Ones that are written at once: they stay in the second-level cache.
constexpr std::size_t kOnes = std::size_t(1) << 18;

} // namespace

std::uint32_t crcOf(std::uint32_t crc, const void* data, std::size_t bytes)
{
    return ::libdeflate_crc32(crc, data, bytes);
}

std::uint32_t crcJoined(std::uint32_t a, std::uint32_t b, std::uint64_t bytesOfB)
{
    return static_cast<std::uint32_t>(::crc32_combine(a, b, static_cast<z_off_t>(bytesOfB)));
}

std::uint32_t crcShare(std::uint32_t crcOfPiece, std::uint64_t bytesAfterPiece)
{
    // crc32_combine() moves the first CRC over the bytes of the second and XORs: joined from left to right, a piece is
    // moved over all bytes after it, whatever those are.
    return crcJoined(crcOfPiece, 0, bytesAfterPiece);
}

std::uint32_t crcOfOnes(std::uint64_t n)
{
    // By doubling.
    const unsigned char one = 1;
    std::uint32_t power = crcOf(0, &one, 1), result = 0;
    for (std::uint64_t bytes = 1; n > 0; bytes *= 2, n >>= 1) {
        if (n & 1) result = crcJoined(result, power, bytes);
        power = crcJoined(power, power, bytes);
    }
    return result;
}

NpzLayout beginNpz(const NpzShape& shape, std::uint64_t pairCount, ListValues values, bool isPart)
{
    NpzLayout layout = layoutNpz(shape, pairCount, values, isPart);
    for (std::size_t i = 0; i < layout.count; ++i) {
        NpzMember& member = layout.members[i];
        member.crc = crcOf(0, member.npyHeader.data(), member.npyHeader.size());
    }
    return layout;
}

void appendValues(OutputFile& file, NpzMember& member, std::uint64_t offset, const void* data,
                  std::size_t bytes, std::uint32_t crc)
{
    file.writeAt(member.valueOffset + offset, data, bytes);
    member.crc = crcJoined(member.crc, crc, bytes);
}

void writeOnes(OutputFile& file, NpzMember& data, const CancelCheck& cancel)
{
    const std::vector<std::int8_t> ones(
        static_cast<std::size_t>(std::min<std::uint64_t>(kOnes, data.valueBytes)), 1);
    for (std::uint64_t begin = 0; begin < data.valueBytes; begin += kOnes) {
        cancel.check();
        file.writeAt(data.valueOffset + begin, ones.data(),
                     static_cast<std::size_t>(std::min<std::uint64_t>(kOnes, data.valueBytes - begin)));
    }
    data.crc = crcJoined(data.crc, crcOfOnes(data.valueBytes), data.valueBytes);
}

namespace {

void writePart(OutputFile& file, NpzLayout& layout, const NpzPart& part)
{
    constexpr std::size_t kBlock = std::size_t(1) << 17;
    std::vector<std::int64_t> block;
    for (std::size_t begin = 0; begin < part.rows.size(); begin += block.size()) {
        const auto first = part.rows.begin() + static_cast<std::ptrdiff_t>(begin);
        const std::size_t count = std::min(kBlock, part.rows.size() - begin);
        block.assign(first, first + static_cast<std::ptrdiff_t>(count));
        appendValues(file, layout.members[NpzLayout::kRows], 8 * begin, block.data(), 8 * count,
                     crcOf(0, block.data(), 8 * count));
    }
    appendValues(file, layout.members[NpzLayout::kPart], 0, part.values, sizeof part.values,
                 crcOf(0, part.values, sizeof part.values));
}

} // namespace

void finishNpz(OutputFile& file, NpzLayout& layout, const NpzShape& npzShape, const NpzPart* part)
{
    const std::int64_t shape[2] = {static_cast<std::int64_t>(npzShape.rows),
                                   static_cast<std::int64_t>(npzShape.columns)};
    appendValues(file, layout.members[NpzLayout::kShape], 0, shape, sizeof shape,
                 crcOf(0, shape, sizeof shape));
    appendValues(file, layout.members[NpzLayout::kFormat], 0, "csr", 3, crcOf(0, "csr", 3));
    if (part) writePart(file, layout, *part);
    for (std::size_t i = 0; i < layout.count; ++i) {
        const NpzMember& member = layout.members[i];
        const std::string header = localHeader(member);
        file.writeAt(member.localOffset, header.data(), header.size());
    }
    const std::string directory = centralDirectory(layout);
    file.writeAt(layout.directoryOffset, directory.data(), directory.size());
}

void beginFile(OutputFile& file, const NpzLayout& layout)
{
    const std::uint64_t bytes = layout.directoryOffset + centralDirectory(layout).size();
    file.requireRoom(bytes);
    file.reserve(0, bytes);
}

} // namespace vdb_nns
