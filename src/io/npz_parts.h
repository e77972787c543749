// What both writers of .npz files share: CRCs and how they join, and the parts around the large arrays.
#pragma once

#include "io/npz_writer.h"

#include <cstddef>
#include <cstdint>

namespace vdb_nns {

class CancelCheck;
class OutputFile;

std::uint32_t crcOf(std::uint32_t crc, const void* data, std::size_t bytes);

// CRC of a followed by b.
std::uint32_t crcJoined(std::uint32_t a, std::uint32_t b, std::uint64_t bytesOfB);

// What a piece adds to the CRC of the array it lies in: the XOR over pieces that tile the array, in any order, is its CRC.
std::uint32_t crcShare(std::uint32_t crcOfPiece, std::uint64_t bytesAfterPiece);

// CRC of n bytes of value 1.
std::uint32_t crcOfOnes(std::uint64_t n);

// Every member's CRC starts with that of its header.
NpzLayout beginNpz(const NpzShape& shape, std::uint64_t pairCount, ListValues values, bool isPart = false);

// Writes values that follow those already in the member's CRC; `crc` is theirs.
void appendValues(OutputFile& file, NpzMember& member, std::uint64_t offset, const void* data,
                  std::size_t bytes, std::uint32_t crc);

// The values of `data` for connectivity, and their CRC.
void writeOnes(OutputFile& file, NpzMember& data, const CancelCheck& cancel);

// Once the large arrays are written and in their CRCs: the small members, the headers, the directory.
void finishNpz(OutputFile& file, NpzLayout& layout, const NpzShape& shape, const NpzPart* part = nullptr);

// Throws OutputError unless the disk has room for the file; takes it.
void beginFile(OutputFile& file, const NpzLayout& layout);

} // namespace vdb_nns
