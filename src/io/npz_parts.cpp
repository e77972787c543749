#include "io/npz_parts.h"

#include "io/output_file.h"

#include <algorithm>

#include <zlib.h>

namespace vdb_nns {

namespace {

// Up to this length insertion beats std::sort.
constexpr std::ptrdiff_t kInsertionLimit = 24;

} // namespace

std::uint32_t crcOf(std::uint32_t crc, const void* data, std::size_t bytes)
{
    return static_cast<std::uint32_t>(::crc32_z(crc, static_cast<const Bytef*>(data), bytes));
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

void sortRow(std::uint32_t* first, std::uint32_t* last)
{
    if (last - first > kInsertionLimit) {
        std::sort(first, last);
        return;
    }
    for (std::uint32_t* next = first + (first != last); next < last; ++next) {
        const std::uint32_t value = *next;
        std::uint32_t* hole = next;
        for (; hole != first && hole[-1] > value; --hole) *hole = hole[-1];
        *hole = value;
    }
}

NpzLayout beginNpz(std::uint64_t rowCount, std::uint64_t pairCount, ListValues values)
{
    NpzLayout layout = layoutNpz(rowCount, pairCount, values);
    for (NpzMember& member : layout.members) {
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

void finishNpz(OutputFile& file, NpzLayout& layout, std::uint64_t rowCount)
{
    const std::int64_t shape[2] = {static_cast<std::int64_t>(rowCount), static_cast<std::int64_t>(rowCount)};
    appendValues(file, layout.members[NpzLayout::kShape], 0, shape, sizeof shape,
                 crcOf(0, shape, sizeof shape));
    appendValues(file, layout.members[NpzLayout::kFormat], 0, "csr", 3, crcOf(0, "csr", 3));
    for (const NpzMember& member : layout.members) {
        const std::string header = localHeader(member);
        file.writeAt(member.localOffset, header.data(), header.size());
    }
    const std::string directory = centralDirectory(layout);
    file.writeAt(layout.directoryOffset, directory.data(), directory.size());
}

void requireRoom(const OutputFile& file, const NpzLayout& layout)
{
    file.requireRoom(layout.directoryOffset + centralDirectory(layout).size());
}

} // namespace vdb_nns
