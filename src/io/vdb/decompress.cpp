#include "io/vdb/decompress.h"

#include <cstring>

#include <blosc.h>

namespace vdb_nns {

namespace {

// Of a block that is padded so that it compresses better (openvdb/points/StreamCompression.h).
constexpr std::size_t kPaddedBytes = 128;

} // namespace

bool decompressBlosc(const unsigned char* stored, std::size_t storedBytes, void* out, std::size_t bytes)
{
    std::size_t held = 0;
    if (blosc_cbuffer_validate(stored, storedBytes, &held) != 0) return false;
    if (held == bytes) return blosc_decompress_ctx(stored, out, bytes, 1) == static_cast<int>(bytes);
    if (held != kPaddedBytes || bytes > kPaddedBytes) return false;
    unsigned char padded[kPaddedBytes];
    if (blosc_decompress_ctx(stored, padded, sizeof padded, 1) != static_cast<int>(kPaddedBytes))
        return false;
    std::memcpy(out, padded, bytes);
    return true;
}

} // namespace vdb_nns
