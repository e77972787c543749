// Decompresses blocks of a .vdb file into memory whose size is known beforehand.
#pragma once

#include <cstddef>

namespace vdb_nns {

// Blosc. False unless the block is sound, ends with its last byte, and holds exactly so many bytes: of values fewer than 128
// bytes OpenVDB writes 128, and the rest is dropped.
bool decompressBlosc(const unsigned char* stored, std::size_t storedBytes, void* out, std::size_t bytes);

} // namespace vdb_nns
