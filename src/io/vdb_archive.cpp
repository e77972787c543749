// Walks the directory of a .vdb file. All numbers are little-endian; a string is a 32-bit length and its
// bytes:
//
//   magic (8 bytes), version, library major, library minor (4 each), has-offsets (1), UUID (36 characters)
//   metadata: count (4), then name, type name, size (4) and value of each
//   number of grids (4)
//   each grid: unique name, type, instance parent, then grid position, block position, end position (8 each)
//     at the grid position: compression flags (4), metadata, transform, tree
//     at the end position: the next grid
#include "io/vdb_archive.h"

#include "vdb_nns/error.h"

#include <fstream>

namespace vdb_nns {

namespace {

constexpr std::uint64_t kMagic = 0x56444220;
constexpr std::uint64_t kUuidBytes = 36;
constexpr const char* kHalfFloatSuffix = "_HalfFloat";

class ArchiveReader {
public:
    explicit ArchiveReader(const std::string& path) : mPath(path), mStream(path, std::ios::binary)
    {
        mStream.seekg(0, std::ios::end);
        const std::streamoff end = mStream.tellg();
        mStream.seekg(0);
        if (!mStream || end < 0) throw InputError(path + ": cannot be read");
        mFileBytes = static_cast<std::uint64_t>(end);
    }

    VdbDirectory read()
    {
        VdbDirectory directory;
        if (mFileBytes < 8 || number(8) != kMagic) {
            throw InputError(mPath + ": is not a VDB file (" + std::to_string(mFileBytes) +
                             " bytes, without OpenVDB's magic number)");
        }
        directory.fileBytes = mFileBytes;
        directory.fileVersion = static_cast<std::uint32_t>(number(4));
        checkVersion(directory.fileVersion);
        skip(4 + 4); // library version
        directory.hasOffsets = number(1) != 0;
        skip(kUuidBytes);
        for (std::uint64_t left = number(4); left > 0; --left) { // metadata
            skip(number(4));
            skip(number(4));
            skip(number(4));
        }
        const std::uint64_t gridCount = number(4);
        if (!directory.hasOffsets) return directory;
        for (std::uint64_t left = gridCount; left > 0; --left) directory.entries.push_back(readEntry());
        if (mPosition != mFileBytes) {
            throw InputError(mPath + ": damaged: " + std::to_string(mFileBytes - mPosition) +
                             " bytes follow the last of its " + std::to_string(gridCount) +
                             " grids; write the file again");
        }
        return directory;
    }

private:
    void checkVersion(std::uint32_t version) const
    {
        const std::string is = mPath + ": is of VDB file version " + std::to_string(version);
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

    VdbEntry readEntry()
    {
        VdbEntry entry;
        entry.position = mPosition;
        entry.uniqueName = string();
        entry.gridType = string();
        const std::size_t suffix = entry.gridType.rfind(kHalfFloatSuffix);
        if (suffix != std::string::npos) entry.gridType.resize(suffix);
        entry.instanceParent = string();
        const std::uint64_t gridPosition = number(8);
        const std::uint64_t blockPosition = number(8); // 0 for an instance
        const std::uint64_t endPosition = number(8);
        if (endPosition > mFileBytes && gridPosition >= mPosition && endPosition >> 63 == 0) {
            failTruncated("grid '" + entry.uniqueName + "' ends at byte " + std::to_string(endPosition));
        }
        const bool isBlockInside = blockPosition == 0 || blockPosition >= gridPosition;
        if (gridPosition < mPosition || endPosition < gridPosition || blockPosition > endPosition ||
            !isBlockInside || endPosition > mFileBytes) {
            throw InputError(mPath + ": damaged: grid '" + entry.uniqueName + "' claims bytes " +
                             std::to_string(gridPosition) + " to " + std::to_string(endPosition) +
                             " of a file of " + std::to_string(mFileBytes) + " whose byte " +
                             std::to_string(mPosition) + " is next; write the file again");
        }
        seek(gridPosition);
        entry.compression = static_cast<std::uint32_t>(number(4));
        seek(endPosition);
        entry.gridBegin = gridPosition;
        entry.gridEnd = endPosition;
        return entry;
    }

    [[noreturn]] void failTruncated(const std::string& what) const
    {
        throw InputError(mPath + ": truncated: " + what + ", but the file has only " +
                         std::to_string(mFileBytes) + " bytes; copy or write it again");
    }

    void need(std::uint64_t bytes) const
    {
        if (bytes > mFileBytes - mPosition) {
            failTruncated("its directory needs " + std::to_string(bytes) + " bytes at byte " +
                          std::to_string(mPosition));
        }
    }

    void seek(std::uint64_t position)
    {
        mPosition = position;
        mStream.seekg(static_cast<std::streamoff>(position));
    }

    void skip(std::uint64_t bytes)
    {
        need(bytes);
        seek(mPosition + bytes);
    }

    void readBytes(char* out, std::uint64_t bytes)
    {
        need(bytes);
        mStream.read(out, static_cast<std::streamsize>(bytes));
        if (!mStream) throw InputError(mPath + ": cannot be read at byte " + std::to_string(mPosition));
        mPosition += bytes;
    }

    std::uint64_t number(int bytes)
    {
        unsigned char raw[8] = {};
        readBytes(reinterpret_cast<char*>(raw), static_cast<std::uint64_t>(bytes));
        std::uint64_t value = 0;
        for (int i = bytes; i-- > 0;) value = value << 8 | raw[i];
        return value;
    }

    std::string string()
    {
        const std::uint64_t bytes = number(4);
        need(bytes);
        std::string text(static_cast<std::size_t>(bytes), '\0');
        readBytes(text.data(), bytes);
        return text;
    }

    const std::string& mPath;
    std::ifstream mStream;
    std::uint64_t mFileBytes = 0, mPosition = 0;
};

} // namespace

VdbDirectory readVdbDirectory(const std::string& path)
{
    return ArchiveReader(path).read();
}

} // namespace vdb_nns
