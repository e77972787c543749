// The members of a ZIP, each inside the file and with the CRC-32 it claims. Format: PKWARE APPNOTE 6.3,
// sections 4.3 and 4.5.3 (ZIP64). Knows nothing of arrays.
#pragma once

#include "file_pieces.h"
#include "vdb_nns/progress.h"

#include <cstdint>
#include <map>
#include <string>
#include <vector>

namespace vdb_nns::cli {

struct ByteRange {
    std::uint64_t begin = 0, size = 0;
};

// All members of a ZIP that compresses none, by name: lists are read in place.
// @throws InputError that names the file, for anything that is not such a ZIP; Cancelled
std::map<std::string, ByteRange> zipMembers(const FilePieces& file, const Progress* progress = nullptr);

// Names of the members, stored or compressed, in the order of the directory.
// @throws InputError as above
std::vector<std::string> zipNames(const FilePieces& file);

// What a member holds, which may be stored or deflated.
// @throws InputError as above; Cancelled
std::string zipContent(const FilePieces& file, const std::string& name, const Progress* progress = nullptr);

} // namespace vdb_nns::cli
