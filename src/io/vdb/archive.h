// The directory of a .vdb file, read from its bytes: which grids it holds, in which order, and where each of
// them begins and ends. Knows nothing of grids in memory.
#pragma once

#include "io/byte_source.h"

#include <cstdint>
#include <string>
#include <vector>

namespace vdb_nns {

struct VdbEntry {
    std::string
        uniqueName; // the grid's name; where that is empty or there twice, followed by \x1e and a number
    std::string gridType;          // OpenVDB's name of the tree type
    bool savesHalf = false;        // real values of the tree are stored in 16 bits
    std::string instanceParent;    // unique name of the grid whose tree this one shares; mostly empty
    std::uint32_t compression = 0; // VdbCompression
    // Bytes from the start of the file: the entry itself, the grid that it describes, and the end of that grid.
    std::uint64_t position = 0, gridBegin = 0, gridEnd = 0;
};

struct VdbDirectory {
    std::uint32_t fileVersion = 0;
    // Files written as a stream have none: where a grid ends is known once it was walked through.
    bool hasOffsets = true;
    std::vector<VdbEntry> entries; // in file order
};

// Bits of VdbEntry::compression, as in openvdb/io/Compression.h.
enum VdbCompression : std::uint32_t { kVdbZip = 1, kVdbActiveMask = 2, kVdbBlosc = 4 };

// OpenVDB's name of the type of a point grid.
constexpr const char* kVdbPointGridType = "Tree_ptdataidx32_5_4_3";

// The file format versions that have point grids: OpenVDB 4 to 12, and 13.
constexpr std::uint32_t kFirstVdbFileVersion = 224, kLastVdbFileVersion = 225;

// Bytes before the metadata: magic number, versions, has-offsets, UUID; and where the file version is.
constexpr std::uint64_t kVdbHeaderBytes = 57, kVdbVersionPosition = 8;

// @throws InputError if the file is not a .vdb of these versions, or its grids are not one after the other from
// the directory to the file's last byte
VdbDirectory readVdbDirectory(const ByteSource& file);

// The grid whose tree an instance shares; null for others.
// @throws InputError if the file has no such tree
const VdbEntry* parentOf(const ByteSource& file, const VdbDirectory& directory, const VdbEntry& instance);

// "grid 'name'", or "grid 'name[2]'" where a name is there several times.
std::string gridText(const std::string& uniqueName);

// The name alone, as a user writes it: "name", "name[2]".
std::string gridLabel(const std::string& uniqueName);

} // namespace vdb_nns
