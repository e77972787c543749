// The members of a stored ZIP, by name, each inside the file and with the CRC-32 it claims. Format: PKWARE APPNOTE 6.3, sections 4.3 and 4.5.3 (ZIP64). Knows nothing of arrays.
#pragma once

#include "file_pieces.h"
#include "vdb_nns/progress.h"

#include <cstdint>
#include <map>
#include <string>

namespace vdb_nns::cli {

struct ByteRange {
    std::uint64_t begin = 0, size = 0;
};

// @throws InputError that names the file, for anything that is not such a ZIP; Cancelled
std::map<std::string, ByteRange> zipMembers(const FilePieces& file, const Progress* progress = nullptr);

} // namespace vdb_nns::cli
