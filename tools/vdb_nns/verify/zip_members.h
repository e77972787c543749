// The members of a stored ZIP in memory, by name, each inside the buffer and with the CRC-32 it claims. Format: PKWARE
// APPNOTE 6.3, sections 4.3 and 4.5.3 (ZIP64). Knows nothing of arrays.
#pragma once

#include <cstddef>
#include <cstdint>
#include <map>
#include <string>

namespace vdb_nns::cli {

struct ByteRange {
    const unsigned char* data = nullptr;
    std::uint64_t size = 0;
};

// @throws InputError beginning with `path` for anything that is not such a ZIP
std::map<std::string, ByteRange> zipMembers(const std::string& path, ByteRange file);

} // namespace vdb_nns::cli
