// Writes a .vdb file again with attributes and groups more, by OpenVDB. That reads the file for it; whether its parts are where they
// should be has been found by readers of our own before.
#include "io/output_file.h"
#include "io/vdb/archive.h"
#include "io/vdb/seekable_archive.h"
#include "io/vdb_file.h"
#include "points/point_grid.h"
#include "util/cancel.h"
#include "vdb_nns/error.h"
#include "vdb_nns/memory.h"

#include <openvdb/io/GridDescriptor.h>
#include <openvdb/openvdb.h>

#include <algorithm>
#include <cstring>
#include <filesystem>
#include <fstream>
#include <map>
#include <optional>
#include <sstream>

namespace vdb_nns {

namespace {

namespace points = openvdb::points;
using openvdb::io::GridDescriptor;

// Whether a sound file of that size could have been read: a damaged count asks for more than any machine has.
bool hasMemoryFor(const std::string& path)
{
    constexpr std::uint64_t kProgramBytes = std::uint64_t(256) << 20, kExpansion = 16; // of compressed grids
    std::error_code ignored;
    const std::uint64_t fileBytes = std::filesystem::file_size(path, ignored);
    return !ignored && availableMemoryBytes() / kExpansion > fileBytes + kProgramBytes / kExpansion;
}

// What a caller's Progress threw, on its way out of OpenVDB. No std::exception, so that it is not taken for one of
// OpenVDB's.
struct ThrownByProgress {
    std::exception_ptr exception;
};

// Whatever OpenVDB throws on a damaged file, std::length_error and mostly std::bad_alloc included, is the file's
// fault.
template <typename F>
auto guardRead(const std::string& path, F&& read)
{
    try {
        return read();
    } catch (const ThrownByProgress& thrown) {
        std::rethrow_exception(thrown.exception);
    } catch (const Error&) {
        throw;
    } catch (const std::exception& error) {
        if (dynamic_cast<const std::bad_alloc*>(&error) && !hasMemoryFor(path)) throw;
        throw InputError(path + ": OpenVDB cannot read it: " + error.what() +
                         "; check the file with vdb_print");
    }
}

// Asks whether to stop each time that it turns to the file. What it throws leaves a stream whose exceptions() have badbit.
class CancellableFileBuffer final : public std::filebuf {
public:
    CancellableFileBuffer(const std::string& path, const CancelCheck& cancel)
        : mCancel(cancel), mBytes(std::size_t(64) << 10)
    {
        pubsetbuf(mBytes.data(), static_cast<std::streamsize>(mBytes.size()));
        if (!open(path, std::ios::in | std::ios::binary)) throw InputError(path + ": cannot be read");
    }

    ~CancellableFileBuffer() override { close(); } // while its bytes are there

protected:
    int_type underflow() override
    {
        ask();
        return std::filebuf::underflow();
    }

    std::streamsize xsgetn(char* out, std::streamsize count) override
    {
        std::streamsize done = 0;
        while (done < count) {
            const std::streamsize piece = std::min(kMostBytes, count - done);
            if (piece > egptr() - gptr()) ask();
            const std::streamsize got = std::filebuf::xsgetn(out + done, piece);
            done += got;
            if (got < piece) break;
        }
        return done;
    }

private:
    void ask() const
    {
        try {
            mCancel.check();
        } catch (...) {
            throw ThrownByProgress{std::current_exception()};
        }
    }

    static constexpr std::streamsize kMostBytes = std::streamsize(16) << 20; // of one call for a large array

    const CancelCheck& mCancel;
    std::vector<char> mBytes;
};

// Reads grids by OpenVDB. Unlike io::File it can tell where the reading of a grid stopped: OpenVDB reads damaged sizes and
// counts without a word, and stops at another byte than the writer did.
class Archive final : private openvdb::io::Archive {
public:
    // `cancel` must outlive it.
    Archive(const ByteSource& file, const CancelCheck& cancel)
        : mFile(file), mDirectory(readVdbDirectory(file)), mBuffer(file.name(), cancel)
    {
        mStream.exceptions(std::ios::badbit | std::ios::failbit | std::ios::eofbit);
        failTruncated([&] {
            openHeader();
            mMetadata.readMeta(mStream);
        });
    }

    const std::string& path() const { return mFile.name(); }
    const std::vector<VdbEntry>& entries() const { return mDirectory.entries; }
    const openvdb::MetaMap& metadata() const { return mMetadata; }

    openvdb::GridBase::Ptr read(std::size_t entry)
    {
        const openvdb::GridBase::Ptr grid = readWithoutParent(entry);
        const VdbEntry* const parent = parentOf(mFile, mDirectory, entries()[entry]);
        if (parent) grid->setTree(readEntry(*parent)->baseTreePtr());
        return grid;
    }

    // Leaves the tree of an instance to the caller, who has it.
    openvdb::GridBase::Ptr readWithoutParent(std::size_t entry) { return readEntry(entries()[entry]); }

private:
    template <typename F>
    void failTruncated(F&& read) const
    {
        try {
            read();
        } catch (const std::ios::failure&) {
            throw InputError(
                mFile.name() +
                ": truncated or damaged: the file ends before its grids do; copy or write it again");
        }
    }

    // OpenVDB warns on the terminal of every file that is newer than itself, so the version that it is shown is
    // one that it knows: 225 adds grids of a type to what 224 has.
    void openHeader()
    {
        std::string header(kVdbHeaderBytes, '\0');
        mStream.read(header.data(), static_cast<std::streamsize>(header.size()));
        const std::uint32_t version = std::min(mDirectory.fileVersion, openvdb::OPENVDB_FILE_VERSION);
        std::memcpy(header.data() + kVdbVersionPosition, &version, sizeof(version));
        std::istringstream shown(header);
        readHeader(shown);
        openvdb::io::setStreamMetadataPtr(mStream, mStreamMetadata, /*transfer=*/false);
        setFormatVersion(mStream);
        setLibraryVersion(mStream);
        setDataCompression(mStream);
    }

    openvdb::GridBase::Ptr readEntry(const VdbEntry& entry)
    {
        openvdb::GridBase::Ptr grid;
        failTruncated([&] {
            mStream.seekg(static_cast<std::streamoff>(entry.position));
            GridDescriptor descriptor;
            grid = descriptor.read(mStream);
            mStream.seekg(static_cast<std::streamoff>(entry.gridBegin));
            readGrid(grid, descriptor, mStream);
        });
        const auto position = static_cast<std::uint64_t>(mStream.tellg());
        if (position != entry.gridEnd) {
            throw InputError(mFile.name() + ": damaged: " + gridText(entry.uniqueName) +
                             " was read up to byte " + std::to_string(position) + ", and it ends at byte " +
                             std::to_string(entry.gridEnd) + "; write the file again");
        }
        return grid;
    }

    const ByteSource& mFile;
    VdbDirectory mDirectory;
    CancellableFileBuffer mBuffer;
    std::istream mStream{&mBuffer};
    openvdb::io::StreamMetadata::Ptr mStreamMetadata = std::make_shared<openvdb::io::StreamMetadata>();
    openvdb::MetaMap mMetadata;
};

// The flags that the archive was written with. A grid's own lack those that its class does not use.
std::uint32_t archiveCompression(const std::vector<VdbEntry>& entries, std::size_t chosen)
{
    constexpr std::uint32_t kExclusive = openvdb::io::COMPRESS_ZIP | openvdb::io::COMPRESS_BLOSC;
    std::uint32_t all = 0;
    for (const VdbEntry& entry : entries) all |= entry.compression;
    if ((all & kExclusive) == kExclusive)
        all = (all & ~kExclusive) | (entries[chosen].compression & kExclusive);
    return all;
}

// All grids of the file, with `own` as the chosen one.
std::vector<openvdb::GridBase::Ptr> readOtherGrids(Archive& archive, std::size_t chosen,
                                                   const points::PointDataGrid::Ptr& own,
                                                   const CancelCheck& cancel)
{
    const std::vector<VdbEntry>& entries = archive.entries();
    std::vector<openvdb::GridBase::Ptr> grids(entries.size());
    std::map<std::string, std::size_t> numbers; // of unique names
    for (std::size_t i = 0; i < entries.size(); ++i) {
        cancel.check();
        numbers[entries[i].uniqueName] = i;
        if (i == chosen) {
            grids[i] = own;
            continue;
        }
        // An instance of the chosen grid gets a tree without the new attribute.
        const auto parent = numbers.find(entries[i].instanceParent);
        const bool hasParent = !entries[i].instanceParent.empty() && parent != numbers.end() &&
                               parent->second != chosen && parent->second != i;
        guardRead(archive.path(),
                  [&] { grids[i] = hasParent ? archive.readWithoutParent(i) : archive.read(i); });
        if (hasParent) grids[i]->setTree(grids[parent->second]->baseTreePtr());
    }
    return grids;
}

// What is written: the grids of the file, one of them with values more.
struct Content {
    openvdb::GridCPtrVec grids;
    openvdb::MetaMap metadata;
    std::uint32_t compression = 0;
    bool hasStatistics = false;
};

Content readContent(const std::string& from, std::size_t chosen, const PointValues& values, bool overwrite,
                    const CancelCheck& cancel)
{
    const InputFile file(from);
    std::optional<Archive> opened;
    guardRead(from, [&] { opened.emplace(file, cancel); });
    Archive& archive = *opened;
    const std::vector<VdbEntry>& entries = archive.entries();
    if (chosen >= entries.size() || entries[chosen].gridType != kVdbPointGridType)
        throw InputError(from + ": has changed since it was read; read it again");
    points::PointDataGrid::Ptr own;
    guardRead(from, [&] { own = openvdb::gridPtrCast<points::PointDataGrid>(archive.read(chosen)); });
    addPointValues(*own, values, overwrite, nullptr, 0, cancel);
    Content content;
    for (const auto& grid : readOtherGrids(archive, chosen, own, cancel)) content.grids.push_back(grid);
    content.metadata = archive.metadata();
    content.compression = archiveCompression(entries, chosen);
    // OpenVDB's statistics describe the grid as it is in the file, so they are made anew, but only for those
    // who had them.
    content.hasStatistics = static_cast<bool>((*own)[openvdb::GridBase::META_FILE_COMPRESSION]);
    return content;
}

} // namespace

void writeVdbResult(const std::string& from, std::size_t grid, const std::string& path,
                    const PointValues& values, const OutputOptions& options, Progress* progress)
{
    openvdb::initialize();
    const CancelCheck cancel(progress, "write");
    cancel.update(0);
    const Content content = readContent(from, grid, values, options.overwrite, cancel);

    OutputFile file(path, options);
    SeekableArchive out;
    out.setCompression(content.compression);
    out.setGridStatsMetadataEnabled(content.hasStatistics);
    double expectedBytes = 1;
    for (const auto& each : content.grids) expectedBytes += static_cast<double>(each->memUsage());
    OutputStreamBuffer buffer(file, [&](std::uint64_t written) {
        cancel.update(std::min(0.99, static_cast<double>(written) / expectedBytes));
    });
    std::ostream stream(&buffer);
    stream.exceptions(std::ios::badbit | std::ios::failbit);
    try {
        out.writeTo(stream, content.grids, content.metadata);
        stream.flush();
    } catch (const openvdb::Exception& error) {
        throw OutputError(path + ": OpenVDB cannot write it: " + error.what());
    }
    cancel.update(1);
    file.commit();
}

} // namespace vdb_nns
