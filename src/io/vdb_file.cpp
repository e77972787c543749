// Reads the point grid of a .vdb file, and writes the file again with one attribute more.
#include "io/vdb_file.h"

#include "io/array_readers.h"
#include "io/output_file.h"
#include "io/vdb_archive.h"
#include "points/particle_source.h"
#include "points/point_attribute.h"
#include "util/cancel.h"
#include "util/isolate.h"
#include "vdb_nns/error.h"
#include "vdb_nns/memory.h"

#include <openvdb/io/Archive.h>
#include <openvdb/io/GridDescriptor.h>

#include <oneapi/tbb/blocked_range.h>
#include <oneapi/tbb/parallel_for.h>

#include <algorithm>
#include <atomic>
#include <cstring>
#include <filesystem>
#include <fstream>
#include <map>
#include <optional>
#include <sstream>

namespace vdb_nns {

namespace {

namespace points = openvdb::points;
using Leaf = points::PointDataTree::LeafNodeType;
using openvdb::io::GridDescriptor;

constexpr const char* kRadiusMetadata = "suggested_radius";

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

std::string quoted(const std::string& uniqueName)
{
    return "'" + GridDescriptor::nameAsString(uniqueName) + "'";
}

// Number of the entry that a caller means, by "name", or "name[n]" where a name is there several times.
std::size_t chooseEntry(const std::string& path, const std::vector<VdbEntry>& entries,
                        const std::string& wanted)
{
    std::vector<std::size_t> pointGrids, matching;
    std::string list;
    for (std::size_t i = 0; i < entries.size(); ++i) {
        if (entries[i].gridType != points::PointDataGrid::gridType()) continue;
        const std::string& name = entries[i].uniqueName;
        list += (pointGrids.empty() ? "" : ", ") + quoted(name);
        pointGrids.push_back(i);
        if (wanted == GridDescriptor::nameAsString(name)) return i;
        if (wanted == GridDescriptor::stripSuffix(name)) matching.push_back(i);
    }
    if (pointGrids.empty()) {
        throw InputError(path + ": has no point grid among its " + std::to_string(entries.size()) +
                         " grids; give a file with a PointDataGrid");
    }
    if (wanted.empty() && pointGrids.size() == 1) return pointGrids[0];
    if (!wanted.empty() && matching.size() == 1) return matching[0];
    if (wanted.empty() || matching.size() > 1) {
        throw InvalidInput(path + ": has several point grids: " + list + "; name one of them (--grid)");
    }
    throw InvalidInput(path + ": has no point grid '" + wanted + "'; its point grids are " + list);
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

// Reads grids from a stream of its own. Unlike io::File it can tell where the reading of a grid stopped: OpenVDB
// reads damaged sizes and counts without a word, and stops at another byte than the writer did.
class Archive final : private openvdb::io::Archive {
public:
    // `cancel` must outlive it. A file without offsets is read at once; where it has more than `allowedBytes`,
    // CapacityError.
    Archive(const std::string& path, std::uint64_t allowedBytes, const CancelCheck& cancel)
        : mPath(path), mDirectory(readVdbDirectory(path)), mBuffer(path, cancel)
    {
        mStream.exceptions(std::ios::badbit | std::ios::failbit | std::ios::eofbit);
        failTruncated([&] {
            openHeader();
            mMetadata.readMeta(mStream);
            if (mDirectory.hasOffsets) return;
            checkPointsFit(path, mDirectory.fileBytes, allowedBytes);
            readStream();
        });
    }

    const std::vector<VdbEntry>& entries() const { return mDirectory.entries; }
    const openvdb::MetaMap& metadata() const { return mMetadata; }

    // Of the file, that read() goes through.
    std::uint64_t bytesOf(std::size_t entry) const
    {
        const VdbEntry& own = entries()[entry];
        std::uint64_t bytes = own.gridEnd - own.gridBegin;
        if (const VdbEntry* const parent = parentOf(own)) bytes += parent->gridEnd - parent->gridBegin;
        return bytes;
    }

    openvdb::GridBase::Ptr read(std::size_t entry)
    {
        const openvdb::GridBase::Ptr grid = readWithoutParent(entry);
        if (!mDirectory.hasOffsets) return grid;
        const VdbEntry* const parent = parentOf(entries()[entry]);
        if (parent) grid->setTree(readEntry(*parent)->baseTreePtr());
        return grid;
    }

    // Leaves the tree of an instance to the caller, who has it.
    openvdb::GridBase::Ptr readWithoutParent(std::size_t entry)
    {
        return mDirectory.hasOffsets ? readEntry(entries()[entry]) : mStreamGrids[entry];
    }

private:
    template <typename F>
    void failTruncated(F&& read) const
    {
        try {
            read();
        } catch (const std::ios::failure&) {
            throw InputError(
                mPath + ": truncated or damaged: the file ends before its grids do; copy or write it again");
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

    std::uint64_t position() { return static_cast<std::uint64_t>(mStream.tellg()); }

    // The grid whose tree an instance shares; null for others.
    const VdbEntry* parentOf(const VdbEntry& instance) const
    {
        const std::string& parent = instance.instanceParent;
        if (parent.empty()) return nullptr;
        const auto found = std::find_if(entries().begin(), entries().end(),
                                        [&](const VdbEntry& entry) { return entry.uniqueName == parent; });
        if (found != entries().end() && found->instanceParent.empty()) return &*found;
        throw InputError(
            mPath + ": damaged: grid " + quoted(instance.uniqueName) + " shares the tree of " +
            quoted(parent) +
            (found == entries().end() ? ", which the file does not have" : ", which has no tree of its own") +
            "; write the file again");
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
        if (position() != entry.gridEnd) {
            throw InputError(mPath + ": damaged: grid " + quoted(entry.uniqueName) + " was read up to byte " +
                             std::to_string(position()) + ", and the directory says that it ends at byte " +
                             std::to_string(entry.gridEnd) + "; write the file again");
        }
        return grid;
    }

    // Such a file tells nowhere where a grid ends; the last one ends with the file.
    void readStream()
    {
        std::vector<GridDescriptor> descriptors;
        NamedGridMap named;
        for (std::int32_t left = readGridCount(mStream); left > 0; --left) {
            GridDescriptor descriptor;
            const openvdb::GridBase::Ptr grid = descriptor.read(mStream);
            readGrid(grid, descriptor, mStream);
            VdbEntry entry;
            entry.uniqueName = descriptor.uniqueName();
            entry.gridType = grid->type();
            entry.instanceParent = descriptor.instanceParentName();
            entry.compression = openvdb::io::getDataCompression(mStream);
            mDirectory.entries.push_back(entry);
            mStreamGrids.push_back(grid);
            named[descriptor.uniqueName()] = grid;
            descriptors.push_back(descriptor);
        }
        for (const VdbEntry& entry : entries()) parentOf(entry); // throws where there is no such tree
        for (const GridDescriptor& descriptor : descriptors) connectInstance(descriptor, named);
        if (position() == mDirectory.fileBytes) return;
        throw InputError(mPath + ": damaged: its grids were read up to byte " + std::to_string(position()) +
                         " of " + std::to_string(mDirectory.fileBytes) + "; write the file again");
    }

    std::string mPath;
    VdbDirectory mDirectory;
    CancellableFileBuffer mBuffer;
    std::istream mStream{&mBuffer};
    openvdb::io::StreamMetadata::Ptr mStreamMetadata = std::make_shared<openvdb::io::StreamMetadata>();
    openvdb::MetaMap mMetadata;
    openvdb::GridPtrVec mStreamGrids;
};

// Lends the leaves of a grid attribute sets of their own, which share the arrays, so that an attribute may be
// added and taken away again; the lent-out ones return at the end.
class AttributeLoan {
public:
    // `isLent`: of the grid, true already; no more at the end.
    // Delegates first, so that the destructor takes everything back where this throws.
    AttributeLoan(points::PointDataGrid& grid, std::atomic<bool>& isLent, const CancelCheck& cancel)
        : AttributeLoan(isLent)
    {
        grid.tree().getNodes(mLeaves);
        mSets.resize(mLeaves.size());
        forLeaves([&](const auto& range) {
            cancel.check();
            for (std::size_t i = range.begin(); i < range.end(); ++i) {
                auto copy = std::make_unique<points::AttributeSet>(mLeaves[i]->attributeSet());
                mSets[i] = mLeaves[i]->stealAttributeSet();
                mLeaves[i]->replaceAttributeSet(copy.release(), /*allowMismatchingDescriptors=*/true);
            }
        });
    }

    ~AttributeLoan()
    {
        const auto takeBack = [&](const Range& range) {
            for (std::size_t i = range.begin(); i < range.end(); ++i) {
                if (!mSets[i]) continue;
                mLeaves[i]->replaceAttributeSet(mSets[i].release(), /*allowMismatchingDescriptors=*/true);
            }
        };
        try {
            forLeaves(takeBack);
        } catch (...) { // no memory for tasks
            takeBack(Range(0, mSets.size()));
        }
        mIsLent = false;
    }

    AttributeLoan(const AttributeLoan&) = delete;
    AttributeLoan& operator=(const AttributeLoan&) = delete;

private:
    using Range = tbb::blocked_range<std::size_t>;

    explicit AttributeLoan(std::atomic<bool>& isLent) : mIsLent(isLent) {}

    // A tree has many small blocks of memory: one thread would free them for longer than a user who cancels may wait.
    template <typename F>
    void forLeaves(F&& f) const
    {
        constexpr std::size_t kLeaves = 1024; // between two questions whether to stop
        isolated([&] { tbb::parallel_for(Range(0, mSets.size(), kLeaves), f, tbb::simple_partitioner()); });
    }

    std::atomic<bool>& mIsLent;
    std::vector<Leaf*> mLeaves;
    std::vector<points::AttributeSet::UniquePtr> mSets;
};

// io::File's own writer does not notice a full disk; this one writes to a stream that throws.
class SeekableArchive final : public openvdb::io::Archive {
public:
    void writeTo(std::ostream& out, const openvdb::GridCPtrVec& grids, const openvdb::MetaMap& metadata) const
    {
        write(out, grids, /*seekable=*/true, metadata);
    }

private:
    using openvdb::io::Archive::write;
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

class LoadedVdb final : public VdbFile {
public:
    LoadedVdb(const std::string& path, const std::string& wanted, std::uint64_t allowedBytes,
              Progress* progress)
        : mPath(path)
    {
        const CancelCheck cancel(progress, "read");
        cancel.update(0);
        guardRead(path, [&] {
            Archive archive(path, allowedBytes, cancel);
            mChosen = chooseEntry(path, archive.entries(), wanted);
            checkPointsFit(path, archive.bytesOf(mChosen), allowedBytes);
            mGrid = readChosen(archive);
        });
        cancel.update(0.8);
        guardRead(path, [&] {
            try {
                mView = viewOf(mGrid);
            } catch (const InputError& error) {
                throw InputError(path + ": " + error.what());
            } catch (const InvalidInput& error) { // too many points: here the file's fault
                throw InputError(path + ": " + error.what());
            }
        });
        cancel.update(1);
    }

    const ParticleView& view() const override { return mView; }
    void describe(PointFileInfo& info) const override;
    void write(const std::string& path, Span<const std::uint32_t> counts, const std::string& attribute,
               const OutputOptions& options, Progress* progress) const override;

private:
    points::PointDataGrid::Ptr readChosen(Archive& archive) const;
    std::vector<openvdb::GridBase::Ptr> readOtherGrids(Archive& archive,
                                                       const points::PointDataGrid::Ptr& chosen,
                                                       const CancelCheck& cancel) const;

    std::string mPath;
    std::size_t mChosen = 0; // entry of the file
    ParticleView mView;      // freed after the grid's other handle: it knows how to
    points::PointDataGrid::Ptr mGrid;
    mutable std::atomic<bool> mIsLent{false};
};

points::PointDataGrid::Ptr LoadedVdb::readChosen(Archive& archive) const
{
    auto grid = openvdb::gridPtrCast<points::PointDataGrid>(archive.read(mChosen));
    if (!grid) throw InputError(mPath + ": its point grid is not one; the file is damaged");
    return grid;
}

void LoadedVdb::describe(PointFileInfo& info) const
{
    info.grid = mGrid->getName();
    const openvdb::Vec3d voxelSize = mGrid->voxelSize();
    info.voxelSize = Vec3d{voxelSize.x(), voxelSize.y(), voxelSize.z()};
    if (const auto radius = mGrid->getMetadata<openvdb::DoubleMetadata>(kRadiusMetadata)) {
        info.suggestedRadius = radius->value();
    } else if (const auto single = mGrid->getMetadata<openvdb::FloatMetadata>(kRadiusMetadata)) {
        info.suggestedRadius = single->value();
    }
    auto leaf = mGrid->tree().cbeginLeaf();
    while (leaf && leaf->attributeSet().size() == 0) ++leaf; // made, but never given points
    if (!leaf) return;
    const points::AttributeSet::Descriptor& descriptor = leaf->attributeSet().descriptor();
    info.attributes.resize(descriptor.size());
    for (const auto& [name, position] : descriptor.map()) {
        info.attributes[position] = {name, descriptor.valueType(position), descriptor.type(position).second};
        if (name == "P") info.codec = info.attributes[position].codec;
    }
}

std::vector<openvdb::GridBase::Ptr> LoadedVdb::readOtherGrids(Archive& archive,
                                                              const points::PointDataGrid::Ptr& chosen,
                                                              const CancelCheck& cancel) const
{
    const std::vector<VdbEntry>& entries = archive.entries();
    std::vector<openvdb::GridBase::Ptr> grids(entries.size());
    std::map<std::string, std::size_t> numbers; // of unique names
    for (std::size_t i = 0; i < entries.size(); ++i) {
        cancel.check();
        numbers[entries[i].uniqueName] = i;
        if (i == mChosen) {
            grids[i] = chosen;
            continue;
        }
        // An instance of the chosen grid gets a tree without the new attribute.
        const auto parent = numbers.find(entries[i].instanceParent);
        const bool hasParent = !entries[i].instanceParent.empty() && parent != numbers.end() &&
                               parent->second != mChosen && parent->second != i;
        guardRead(mPath, [&] { grids[i] = hasParent ? archive.readWithoutParent(i) : archive.read(i); });
        if (hasParent) grids[i]->setTree(grids[parent->second]->baseTreePtr());
    }
    return grids;
}

void LoadedVdb::write(const std::string& path, Span<const std::uint32_t> counts, const std::string& attribute,
                      const OutputOptions& options, Progress* progress) const
{
    const CancelCheck cancel(progress, "write");
    cancel.update(0);
    std::optional<Archive> archive;
    guardRead(mPath, [&] { archive.emplace(mPath, kAnyBytes, cancel); });
    const std::vector<VdbEntry>& entries = archive->entries();
    if (mChosen >= entries.size() || entries[mChosen].gridType != points::PointDataGrid::gridType()) {
        throw InputError(mPath + ": has changed since it was read; read it again");
    }
    // Who comes while the grid is lent out reads one from the file: a task must not wait for another.
    std::optional<AttributeLoan> loan;
    points::PointDataGrid::Ptr own = mGrid;
    if (!mIsLent.exchange(true)) {
        loan.emplace(*mGrid, mIsLent, cancel);
    } else {
        guardRead(mPath, [&] { own = readChosen(*archive); });
    }
    setPointAttribute(*own, attribute, counts, options.overwrite, cancel);

    OutputFile file(path, options);
    SeekableArchive out;
    openvdb::GridCPtrVec grids;
    for (const openvdb::GridBase::Ptr& grid : readOtherGrids(*archive, own, cancel)) grids.push_back(grid);
    const openvdb::MetaMap metadata = archive->metadata();
    out.setCompression(archiveCompression(entries, mChosen));
    archive.reset();
    // OpenVDB's statistics describe the grid as it is in the file, so they are made anew, but only for those
    // who had them.
    out.setGridStatsMetadataEnabled(static_cast<bool>((*mGrid)[openvdb::GridBase::META_FILE_COMPRESSION]));

    double expectedBytes = 1;
    for (const auto& grid : grids) expectedBytes += static_cast<double>(grid->memUsage());
    OutputStreamBuffer buffer(file, [&](std::uint64_t written) {
        cancel.update(std::min(0.99, static_cast<double>(written) / expectedBytes));
    });
    std::ostream stream(&buffer);
    stream.exceptions(std::ios::badbit | std::ios::failbit);
    try {
        out.writeTo(stream, grids, metadata);
        stream.flush();
    } catch (const openvdb::Exception& error) {
        throw OutputError(path + ": OpenVDB cannot write it: " + error.what());
    }
    cancel.update(1);
    file.commit();
}

} // namespace

std::unique_ptr<VdbFile> VdbFile::read(const std::string& path, const std::string& grid,
                                       std::uint64_t allowedBytes, Progress* progress)
{
    openvdb::initialize();
    return std::make_unique<LoadedVdb>(path, grid, allowedBytes, progress);
}

} // namespace vdb_nns
