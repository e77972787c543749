// Walks the directory of a .vdb file. All numbers are little-endian; a text is a 32-bit length and its characters:
//
//   magic (8 bytes), version, library major, library minor (4 each), has-offsets (1), UUID (36 characters)
//   metadata: see grid_header.h
//   number of grids (4)
//   each grid: unique name, type, instance parent, then grid position, block position, end position (8 each)
//     at the grid position: compression flags (4), metadata, transform, and for all but instances the tree
//     at the end position: the next grid
// A stream has zeros as positions: a grid follows its entry.
#include "io/vdb/archive.h"
#include "util/shown_text.h"

#include "io/vdb/cursor.h"
#include "io/vdb/grid_header.h"
#include "io/vdb/point_layout.h"
#include "io/vdb/tree_walk.h"
#include "vdb_nns/error.h"

#include <algorithm>

namespace vdb_nns {

namespace {

constexpr std::uint64_t kMagic = 0x56444220;
constexpr std::uint64_t kUuidBytes = 36;
constexpr char kSeparator = '\x1e';
const std::string kHalfFloatSuffix = "_HalfFloat";

void checkVersion(const std::string& path, std::uint32_t version)
{
    const std::string is = path + ": is of VDB file version " + std::to_string(version);
    if (version < kFirstVdbFileVersion) {
        throw InputError(is + ", which has no point grids: they came with version " +
                         std::to_string(kFirstVdbFileVersion) + "; give a file with a PointDataGrid");
    }
    if (version > kLastVdbFileVersion) {
        throw InputError(is + ", and versions " + std::to_string(kFirstVdbFileVersion) + " to " +
                         std::to_string(kLastVdbFileVersion) +
                         " are read; write the file again with OpenVDB 4 to 13, or take a newer vdb_nns");
    }
}

// What the directory says of a grid, and for files with offsets where it is.
VdbEntry readEntry(VdbCursor& cursor, bool hasOffsets)
{
    const std::string& path = cursor.file().name();
    VdbEntry entry;
    entry.position = cursor.position();
    entry.uniqueName = cursor.text("the name of a grid");
    entry.gridType = cursor.text("the type of a grid");
    const std::size_t suffix = entry.gridType.rfind(kHalfFloatSuffix);
    entry.savesHalf =
        suffix != std::string::npos && suffix + kHalfFloatSuffix.size() == entry.gridType.size();
    if (entry.savesHalf) entry.gridType.resize(suffix);
    entry.instanceParent = cursor.text("the instance parent of a grid");
    const auto gridPosition = cursor.number<std::uint64_t>("the position of a grid");
    const auto blockPosition = cursor.number<std::uint64_t>("the position of a grid's blocks");
    const auto endPosition = cursor.number<std::uint64_t>("the end of a grid");
    entry.gridBegin = cursor.position();
    if (!hasOffsets) return entry;
    const std::uint64_t fileBytes = cursor.file().size();
    if (endPosition > fileBytes && gridPosition >= cursor.position() && endPosition >> 63 == 0) {
        throw InputError(path + ": truncated: " + gridText(entry.uniqueName) + " ends at byte " +
                         std::to_string(endPosition) + ", but the file has only " +
                         std::to_string(fileBytes) + " bytes; copy or write it again");
    }
    const bool isBlockInside = blockPosition == 0 || blockPosition >= gridPosition; // 0 for an instance
    if (gridPosition < cursor.position() || endPosition < gridPosition || blockPosition > endPosition ||
        !isBlockInside || endPosition > fileBytes) {
        throw InputError(path + ": damaged: " + gridText(entry.uniqueName) +
                         ": expected its bytes between byte " + std::to_string(cursor.position()) +
                         " and the end of the file at byte " + std::to_string(fileBytes) +
                         ", not from byte " + std::to_string(gridPosition) + " to " +
                         std::to_string(endPosition) + "; write the file again");
    }
    entry.gridBegin = gridPosition;
    entry.gridEnd = endPosition;
    return entry;
}

// Where a grid of a stream ends.
std::uint64_t endOfGrid(const ByteSource& file, const VdbEntry& entry)
{
    VdbCursor cursor(file, entry.gridBegin, file.size());
    cursor.setPart(gridText(entry.uniqueName));
    const VdbGridHeader header = readGridHeader(cursor);
    if (!entry.instanceParent.empty()) return cursor.position();
    if (entry.gridType == kVdbPointGridType) return readPointLayout(cursor, header.compression).end;
    skipVolume(cursor, entry.gridType, entry.savesHalf, header.compression);
    return cursor.position();
}

} // namespace

std::string gridLabel(const std::string& uniqueName)
{
    const std::size_t at = uniqueName.find(kSeparator);
    if (at == std::string::npos) return uniqueName;
    return uniqueName.substr(0, at) + "[" + uniqueName.substr(at + 1) + "]";
}

std::string gridText(const std::string& uniqueName)
{
    return "grid '" + escapedText(gridLabel(uniqueName)) + "'";
}

const VdbEntry* parentOf(const ByteSource& file, const VdbDirectory& directory, const VdbEntry& instance)
{
    const std::string& parent = instance.instanceParent;
    if (parent.empty()) return nullptr;
    const auto found = std::find_if(directory.entries.begin(), directory.entries.end(),
                                    [&](const VdbEntry& entry) { return entry.uniqueName == parent; });
    const bool isThere = found != directory.entries.end();
    if (isThere && found->instanceParent.empty()) return &*found;
    throw InputError(file.name() + ": damaged: " + gridText(instance.uniqueName) + " shares the tree of " +
                     gridText(parent) +
                     (isThere ? ", which has no tree of its own" : ", which the file does not have") +
                     "; write the file again");
}

VdbDirectory readVdbDirectory(const ByteSource& file)
{
    VdbCursor cursor(file, 0, file.size());
    if (file.size() < 8 || cursor.number<std::uint64_t>("the magic number") != kMagic) {
        throw InputError(file.name() + ": is not a VDB file (" + std::to_string(file.size()) +
                         " bytes, without OpenVDB's magic number)");
    }
    VdbDirectory directory;
    directory.fileVersion = cursor.number<std::uint32_t>("the file version");
    checkVersion(file.name(), directory.fileVersion);
    cursor.skip(4 + 4, "the version of the library");
    directory.hasOffsets = cursor.number<std::uint8_t>("whether there are offsets") != 0;
    cursor.skip(kUuidBytes, "the UUID");
    readMetadata(cursor);
    const auto gridCount = cursor.number<std::int32_t>("the number of grids");
    if (gridCount < 0) cursor.fail("a number of grids that is not negative", cursor.position() - 4);
    std::uint64_t next = cursor.position();
    for (std::int32_t left = gridCount; left > 0; --left) {
        VdbCursor entryCursor(file, next, file.size());
        VdbEntry entry = readEntry(entryCursor, directory.hasOffsets);
        if (!directory.hasOffsets) entry.gridEnd = endOfGrid(file, entry);
        next = entry.gridEnd;
        VdbCursor grid(file, entry.gridBegin, entry.gridEnd);
        grid.setPart(gridText(entry.uniqueName));
        entry.compression = grid.number<std::uint32_t>("the compression");
        directory.entries.push_back(std::move(entry));
    }
    if (next != file.size()) {
        throw InputError(file.name() +
                         ": damaged: expected the end of the file behind its last grid at byte " +
                         std::to_string(next) + ", but " + std::to_string(file.size() - next) +
                         " bytes follow; write the file again");
    }
    return directory;
}

} // namespace vdb_nns
