#include "io/npy_header.h"

#include <algorithm>
#include <cstring>
#include <limits>
#include <optional>

namespace vdb_nns {

namespace {

// Values of a shape; nothing where that is past 64 bits.
std::optional<std::uint64_t> valuesOf(const std::vector<std::uint64_t>& shape)
{
    std::uint64_t count = 1;
    if (std::find(shape.begin(), shape.end(), 0u) != shape.end()) return 0;
    for (const std::uint64_t size : shape) {
        if (count > std::numeric_limits<std::uint64_t>::max() / size) return std::nullopt;
        count *= size;
    }
    return count;
}

} // namespace

std::string npyShapeText(const std::vector<std::uint64_t>& shape)
{
    std::string text = "(";
    for (std::size_t i = 0; i < shape.size(); ++i) text += (i ? ", " : "") + std::to_string(shape[i]);
    return text + (shape.size() == 1 ? ",)" : ")");
}

NpyHeader readNpyHeader(const std::string& path, FileBytes bytes)
{
    static const unsigned char kMagic[6] = {0x93, 'N', 'U', 'M', 'P', 'Y'};
    if (bytes.size() < 10 || std::memcmp(bytes.data(), kMagic, sizeof kMagic) != 0) {
        throw InputError(path + ": is not an .npy file: it does not begin with \\x93NUMPY and a header (" +
                         std::to_string(bytes.size()) + " bytes in all); write it with numpy.save");
    }
    const unsigned major = bytes[6];
    if (major < 1 || major > 3) {
        throw InputError(path + ": .npy version " + std::to_string(major) +
                         " at byte 6 is not supported (1 to 3 are)");
    }
    const std::size_t lengthBytes = major == 1 ? 2 : 4;
    const std::size_t start = 8 + lengthBytes;
    std::uint64_t length = 0;
    for (std::size_t i = lengthBytes; i-- > 0;) {
        length = length << 8 | (8 + i < bytes.size() ? bytes[8 + i] : 0u);
    }
    if (bytes.size() < start || length > bytes.size() - start || length > kMaxNpyHeaderBytes) {
        throw InputError(path + ": the .npy header at byte 8 claims " + std::to_string(length) +
                         " bytes, but the file has " + std::to_string(bytes.size()) +
                         " and a header may have " + std::to_string(kMaxNpyHeaderBytes) +
                         "; the file is truncated or damaged");
    }
    const FileBytes text(bytes.data() + start, static_cast<std::size_t>(length));
    NpyHeader header = NpyHeaderParser(path, text, start).parse();
    header.dataOffset = start + static_cast<std::size_t>(length);
    return header;
}

void checkNpySize(const std::string& path, const NpyHeader& header, std::uint64_t available)
{
    const std::optional<std::uint64_t> count = valuesOf(header.shape);
    if (!count || *count > available / header.itemBytes) {
        throw InputError(path + ": truncated: the .npy header promises shape " + npyShapeText(header.shape) +
                         " of " + std::to_string(header.itemBytes) + " bytes each, but only " +
                         std::to_string(available) + " bytes follow from byte " +
                         std::to_string(header.dataOffset) + "; copy the file again");
    }
    const std::uint64_t needed = *count * header.itemBytes;
    if (needed != available) {
        throw InputError(path + ": " + std::to_string(available - needed) + " bytes too many behind the " +
                         std::to_string(needed) + " of the .npy header's shape, from byte " +
                         std::to_string(header.dataOffset + needed) + "; write the file again");
    }
}

} // namespace vdb_nns
