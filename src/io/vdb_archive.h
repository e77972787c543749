// The directory of a .vdb file, read from its bytes: which grids it holds, in which order, and where each of
// them begins and ends. OpenVDB compares none of that with what it reads. Knows nothing of grids in memory.
#pragma once

#include <cstdint>
#include <string>
#include <vector>

namespace vdb_nns {

struct VdbEntry {
    std::string
        uniqueName; // the grid's name; where that is empty or there twice, followed by \x1e and a number
    std::string gridType;          // OpenVDB's name of the tree type
    std::string instanceParent;    // unique name of the grid whose tree this one shares; mostly empty
    std::uint32_t compression = 0; // flags of openvdb/io/Compression.h
    // Bytes from the start of the file: the entry itself, the grid that it describes, and the end of that grid.
    std::uint64_t position = 0, gridBegin = 0, gridEnd = 0;
};

struct VdbDirectory {
    std::uint32_t fileVersion = 0;
    std::uint64_t fileBytes = 0;
    // Files written as a stream have no offsets: then `entries` stays empty, and only reading all of it tells
    // whether it is whole.
    bool hasOffsets = true;
    std::vector<VdbEntry> entries; // in file order
};

// The file format versions that have point grids: OpenVDB 4 to 12, and 13.
constexpr std::uint32_t kFirstVdbFileVersion = 224, kLastVdbFileVersion = 225;

// Bytes before the metadata: magic number, versions, has-offsets, UUID; and where the file version is.
constexpr std::uint64_t kVdbHeaderBytes = 57, kVdbVersionPosition = 8;

// @throws InputError if the file cannot be read, is not a .vdb of these versions, or its grids are not one after
// the other from the directory to the file's last byte
VdbDirectory readVdbDirectory(const std::string& path);

} // namespace vdb_nns
