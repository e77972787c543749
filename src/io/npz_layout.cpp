// The bytes around the arrays of an .npz file. Formats: PKWARE's APPNOTE.TXT 6.3 (4.3.7 local header, 4.3.12
// directory, 4.3.14 to 4.3.16 its end, 4.5.3 ZIP64) and numpy.lib.format (the .npy header).
#include "io/npz_writer.h"

#include <algorithm>

namespace vdb_nns {

namespace {

constexpr std::uint64_t kAlignment =
    64; // of every array: a cache line, and all that np.memmap and SIMD ask for
// The largest values of the old fields; that value itself says "look into the ZIP64 field".
constexpr std::uint64_t kMax32 = 0xFFFFFFFFu;
constexpr std::uint16_t kVersionStored = 20, kVersionZip64 = 45; // "version needed to extract"
constexpr std::uint16_t kDosTime = 0;                            // 00:00:00
constexpr std::uint16_t kDosDate = (1 << 5) | 1;                 // 1980-01-01, the earliest there is
constexpr std::uint16_t kUtf8Flag = 0x0800;
constexpr std::uint16_t kZip64Field = 0x0001;
constexpr std::uint16_t kAlignmentField = 0xD935; // the alignment field that Android's zipalign writes
constexpr std::uint64_t kLocalHeaderBytes = 30, kFieldHeaderBytes = 4;

void put(std::string& out, std::uint64_t value, int bytes)
{
    for (int i = 0; i < bytes; ++i) out += static_cast<char>(value >> (8 * i));
}

bool isAscii(const std::string& text)
{
    return std::all_of(text.begin(), text.end(), [](char c) { return static_cast<unsigned char>(c) < 128; });
}

} // namespace

std::string npyHeader(const std::string& descr, const std::string& shape)
{
    const std::string text = "{'descr': '" + descr + "', 'fortran_order': False, 'shape': (" + shape + "), }";
    const std::size_t unpadded = 10 + text.size() + 1;
    const std::size_t bytes = (unpadded + kAlignment - 1) / kAlignment * kAlignment;
    std::string header("\x93NUMPY\x01\x00", 8);
    put(header, bytes - 10, 2);
    return header + text + std::string(bytes - unpadded, ' ') + '\n';
}

NpzMember npzMember(const std::string& name, const std::string& descr, const std::string& shape,
                    std::uint64_t valueBytes)
{
    NpzMember result;
    result.name = name + ".npy";
    result.npyHeader = npyHeader(descr, shape);
    result.valueBytes = valueBytes;
    return result;
}

namespace {

bool isLarge(const NpzMember& member)
{
    return member.bytes() >= kMax32;
}

// Extra fields of a local header: sizes past 4 GiB, and the padding that aligns the values.
std::uint64_t localZip64Bytes(const NpzMember& member)
{
    return isLarge(member) ? kFieldHeaderBytes + 16 : 0;
}

// Fields that local header and directory have in common, from "version needed" to "name length".
void putCommon(std::string& out, const NpzMember& member, bool needsZip64)
{
    const std::uint64_t size = isLarge(member) ? kMax32 : member.bytes();
    put(out, needsZip64 ? kVersionZip64 : kVersionStored, 2);
    put(out, isAscii(member.name) ? 0 : kUtf8Flag, 2);
    put(out, 0, 2); // method: stored
    put(out, kDosTime, 2);
    put(out, kDosDate, 2);
    put(out, member.crc, 4);
    put(out, size, 4); // compressed
    put(out, size, 4); // uncompressed
    put(out, member.name.size(), 2);
}

void putDirectoryEntry(std::string& out, const NpzMember& member)
{
    const bool isFar = member.localOffset >= kMax32;
    std::string zip64; // only the values that do not fit their old field, in this order
    if (isLarge(member)) {
        put(zip64, member.bytes(), 8);
        put(zip64, member.bytes(), 8);
    }
    if (isFar) put(zip64, member.localOffset, 8);

    put(out, 0x02014b50, 4);
    put(out, 3 << 8 | kVersionZip64, 2); // made by: Unix, so that the attributes below are permissions
    putCommon(out, member, !zip64.empty());
    put(out, zip64.empty() ? 0 : kFieldHeaderBytes + zip64.size(), 2);
    put(out, 0, 2);                            // comment
    put(out, 0, 2);                            // disk
    put(out, 0, 2);                            // internal attributes
    put(out, std::uint64_t(0100644) << 16, 4); // external attributes: a regular file, rw-r--r--
    put(out, isFar ? kMax32 : member.localOffset, 4);
    out += member.name;
    if (!zip64.empty()) {
        put(out, kZip64Field, 2);
        put(out, zip64.size(), 2);
        out += zip64;
    }
}

} // namespace

NpzLayout layoutNpz(const NpzShape& shape, std::uint64_t pairCount, ListValues values, bool isPart)
{
    const std::uint64_t rowCount = shape.rows;
    NpzLayout layout;
    layout.indexBytes = shape.columns > 0x7FFFFFFFu ? 8 : 4;
    const bool hasDistances = values == ListValues::kDistance;
    const std::string pairShape = std::to_string(pairCount) + ",";
    NpzMember* const m = layout.members;
    m[NpzLayout::kIndptr] =
        npzMember("indptr", "<i8", std::to_string(rowCount + 1) + ",", 8 * (rowCount + 1));
    m[NpzLayout::kIndices] = npzMember("indices", layout.indexBytes == 8 ? "<i8" : "<i4", pairShape,
                                       layout.indexBytes * pairCount);
    m[NpzLayout::kData] =
        npzMember("data", hasDistances ? "<f4" : "|i1", pairShape, (hasDistances ? 4 : 1) * pairCount);
    m[NpzLayout::kShape] = npzMember("shape", "<i8", "2,", 16);
    m[NpzLayout::kFormat] = npzMember("format", "|S3", "", 3);
    if (isPart) {
        m[NpzLayout::kRows] = npzMember("rows", "<i8", std::to_string(rowCount) + ",", 8 * rowCount);
        m[NpzLayout::kPart] =
            npzMember("part", "<u8", std::to_string(NpzPart::kValues) + ",", 8 * NpzPart::kValues);
        layout.count = NpzLayout::kMostMembers;
    }
    layout.directoryOffset = placeMembers(layout.members, layout.count);
    return layout;
}

std::uint64_t placeMembers(NpzMember* members, std::size_t count)
{
    std::uint64_t end = 0;
    for (std::size_t i = 0; i < count; ++i) {
        NpzMember& next = members[i];
        next.localOffset = end;
        // The padding is an extra field, whose own header must fit as well.
        const std::uint64_t least =
            end + kLocalHeaderBytes + next.name.size() + localZip64Bytes(next) + kFieldHeaderBytes + 2;
        next.valueOffset = (least + kAlignment - 1) / kAlignment * kAlignment + next.npyHeader.size();
        end = next.valueOffset + next.valueBytes;
    }
    return end;
}

std::string localHeader(const NpzMember& member)
{
    const std::uint64_t start = member.valueOffset - member.npyHeader.size();
    const std::uint64_t extraBytes = start - member.localOffset - kLocalHeaderBytes - member.name.size();
    std::string out;
    put(out, 0x04034b50, 4);
    putCommon(out, member, isLarge(member));
    put(out, extraBytes, 2);
    out += member.name;
    if (isLarge(member)) {
        put(out, kZip64Field, 2);
        put(out, 16, 2);
        put(out, member.bytes(), 8);
        put(out, member.bytes(), 8);
    }
    const std::uint64_t paddingBytes = extraBytes - localZip64Bytes(member) - kFieldHeaderBytes;
    put(out, kAlignmentField, 2);
    put(out, paddingBytes, 2);
    put(out, kAlignment, 2);
    out.append(static_cast<std::size_t>(paddingBytes - 2), '\0');
    return out + member.npyHeader;
}

std::string centralDirectory(const NpzLayout& layout)
{
    return centralDirectory(layout.members, layout.count, layout.directoryOffset);
}

std::string centralDirectory(const NpzMember* members, std::size_t count, std::uint64_t offset)
{
    std::string out;
    for (std::size_t i = 0; i < count; ++i) putDirectoryEntry(out, members[i]);
    const std::uint64_t bytes = out.size();
    const std::uint64_t end = offset + bytes;
    if (offset >= kMax32) {
        put(out, 0x06064b50, 4); // ZIP64 end of central directory
        put(out, 44, 8);         // bytes that follow
        put(out, 3 << 8 | kVersionZip64, 2);
        put(out, kVersionZip64, 2);
        put(out, 0, 4); // this disk
        put(out, 0, 4); // disk of the directory
        put(out, count, 8);
        put(out, count, 8);
        put(out, bytes, 8);
        put(out, offset, 8);
        put(out, 0x07064b50, 4); // its locator
        put(out, 0, 4);
        put(out, end, 8);
        put(out, 1, 4); // disks
    }
    put(out, 0x06054b50, 4);
    put(out, 0, 2);
    put(out, 0, 2);
    put(out, count, 2);
    put(out, count, 2);
    put(out, bytes, 4);
    put(out, offset >= kMax32 ? kMax32 : offset, 4);
    put(out, 0, 2); // comment
    return out;
}

} // namespace vdb_nns
