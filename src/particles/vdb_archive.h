// The directory of a .vdb file, read from its bytes: which grids it holds, in which order, and where each of
// them ends. OpenVDB tells none of that, and a file that was cut reads "successfully" where the missing bytes
// belong to values: a short read only sets a flag of its stream. Knows nothing of grids in memory.
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
};

struct VdbDirectory {
    // Files written as a stream have no offsets: then `entries` stays empty, and only reading all of it tells
    // whether it is whole.
    bool hasOffsets = true;
    std::vector<VdbEntry> entries; // in file order
};

// The only file format version that has point grids, so far.
constexpr std::uint32_t kVdbFileVersion = 224;

// @throws InputError if the file cannot be read, is not a .vdb of that version, or ends before the last grid
// does
VdbDirectory readVdbDirectory(const std::string& path);

} // namespace vdb_nns
