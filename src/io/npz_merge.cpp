// Parts of lists as one .npz file. A part is read strictly: but for its values, every byte is what the writer would have put there,
// and the values have the checksums that the writer put beside them.
#include "io/byte_source.h"
#include "io/npz_parts.h"
#include "io/npz_writer.h"
#include "lists/row_checksum.h"
#include "util/cancel.h"
#include "util/isolate.h"
#include "vdb_nns/error.h"
#include "vdb_nns/tiles.h"

#include <oneapi/tbb/enumerable_thread_specific.h>
#include <oneapi/tbb/parallel_for.h>

#include <algorithm>
#include <atomic>
#include <cstring>
#include <limits>
#include <memory>
#include <string>
#include <utility>
#include <vector>

namespace vdb_nns {
namespace {

constexpr std::size_t kPieceBytes = std::size_t(4) << 20; // read at once
constexpr std::uint32_t kNobody = std::numeric_limits<std::uint32_t>::max();

template <typename Number>
Number numberAt(const std::string& bytes, std::size_t place)
{
    Number value = 0;
    if (place + sizeof value <= bytes.size()) std::memcpy(&value, bytes.data() + place, sizeof value);
    return value;
}

class PartFile {
public:
    explicit PartFile(const std::string& path) : mFile(path)
    {
        readLayout();
        const std::string values = bytesAt(member(NpzLayout::kPart).valueOffset, 8 * NpzPart::kValues);
        const auto value = [&](std::size_t k) { return numberAt<std::uint64_t>(values, 8 * k); };
        if (value(0) == 0 || value(0) > value(1) || value(1) > kNobody) fail("the number of its tile");
        mOrigin.tile = static_cast<std::uint32_t>(value(0));
        mOrigin.tiles = static_cast<std::uint32_t>(value(1));
        mOrigin.input = value(2);
        mOrigin.options = value(3);
        mOrigin.rows = value(4);
    }

    const std::string& name() const { return mFile.name(); }
    const PartOrigin& origin() const { return mOrigin; }
    std::uint64_t rows() const { return mShape.rows; }
    std::uint64_t columns() const { return mShape.columns; }
    std::uint64_t pairs() const { return mPairs; }
    ListValues values() const { return mValues; }
    std::size_t indexBytes() const { return mLayout.indexBytes; }
    std::uint64_t bytes() const { return mFile.size(); }

    [[noreturn]] void fail(const std::string& what) const
    {
        throw InputError(mFile.name() + ": is no part of a search that can be read, for " + what +
                         " is not what `search --tile` writes; make it again");
    }

    // Values [begin, begin + count) of a member, of `valueBytes` each.
    void read(int which, std::uint64_t begin, std::size_t count, std::size_t valueBytes, void* out) const
    {
        mFile.readAt(member(which).valueOffset + begin * valueBytes, out, count * valueBytes);
    }

    // Of every member against its values.
    template <typename F>
    void checkSums(const F& tellBytes) const
    {
        std::vector<unsigned char> piece;
        for (std::size_t i = 0; i < mLayout.count; ++i) {
            const NpzMember& each = mLayout.members[i];
            std::uint32_t crc = crcOf(0, each.npyHeader.data(), each.npyHeader.size());
            for (std::uint64_t begin = 0; begin < each.valueBytes; begin += kPieceBytes) {
                piece.resize(
                    static_cast<std::size_t>(std::min<std::uint64_t>(kPieceBytes, each.valueBytes - begin)));
                mFile.readAt(each.valueOffset + begin, piece.data(), piece.size());
                crc = crcOf(crc, piece.data(), piece.size());
                tellBytes(piece.size());
            }
            if (crc != each.crc) fail("the checksum of its array '" + each.name + "'");
        }
    }

private:
    const NpzMember& member(int which) const { return mLayout.members[which]; }

    std::string bytesAt(std::uint64_t place, std::uint64_t count) const
    {
        if (place > mFile.size() || count > mFile.size() - place) fail("its length");
        std::string bytes(static_cast<std::size_t>(count), '\0');
        mFile.readAt(place, bytes.data(), bytes.size());
        return bytes;
    }

    // What the directory says of a member.
    struct Entry {
        std::uint64_t bytes = 0, localOffset = 0;
        std::uint32_t crc = 0;
    };

    static Entry entryAt(const std::string& directory, std::size_t& place)
    {
        constexpr std::uint32_t kElsewhere = 0xFFFFFFFFu; // in a ZIP64 field
        Entry entry;
        entry.crc = numberAt<std::uint32_t>(directory, place + 16);
        entry.bytes = numberAt<std::uint32_t>(directory, place + 24);
        entry.localOffset = numberAt<std::uint32_t>(directory, place + 42);
        const std::size_t nameBytes = numberAt<std::uint16_t>(directory, place + 28),
                          extraBytes = numberAt<std::uint16_t>(directory, place + 30);
        std::size_t wide = place + 46 + nameBytes + 4;
        const bool isLarge = entry.bytes == kElsewhere;
        if (isLarge) entry.bytes = numberAt<std::uint64_t>(directory, wide);
        if (isLarge) wide += 16;
        if (entry.localOffset == kElsewhere) entry.localOffset = numberAt<std::uint64_t>(directory, wide);
        place += 46 + nameBytes + extraBytes;
        return entry;
    }

    // Numbers are taken from the file without a look at what stands around them; then the file is held against the layout of
    // those numbers, byte for byte.
    void readLayout()
    {
        constexpr std::uint64_t kEndBytes = 22, kLocatorBytes = 20, kEnd64Bytes = 56,
                                kMostDirectoryBytes = 4096;
        if (mFile.size() < kEndBytes) fail("its length");
        std::uint64_t directoryOffset =
            numberAt<std::uint32_t>(bytesAt(mFile.size() - kEndBytes, kEndBytes), 16);
        if (directoryOffset == 0xFFFFFFFFu) {
            const std::uint64_t more = kEndBytes + kLocatorBytes + kEnd64Bytes;
            if (mFile.size() < more) fail("its length");
            directoryOffset = numberAt<std::uint64_t>(bytesAt(mFile.size() - more, kEnd64Bytes), 48);
        }
        if (directoryOffset > mFile.size() || mFile.size() - directoryOffset > kMostDirectoryBytes)
            fail("its directory");
        const std::string directory = bytesAt(directoryOffset, mFile.size() - directoryOffset);
        Entry entries[NpzLayout::kMostMembers];
        std::size_t place = 0;
        for (Entry& entry : entries) entry = entryAt(directory, place);

        std::string dataHeader;
        const std::uint64_t rowBytes = valuesOf(entries[NpzLayout::kRows]).second;
        const auto [shapeOffset, shapeBytes] = valuesOf(entries[NpzLayout::kShape]);
        const std::uint64_t indexBytesAll = valuesOf(entries[NpzLayout::kIndices]).second;
        valuesOf(entries[NpzLayout::kData], &dataHeader);
        if (shapeBytes != 16) fail("its shape");
        const std::string shape = bytesAt(shapeOffset, 16);
        mShape = {numberAt<std::uint64_t>(shape, 0), numberAt<std::uint64_t>(shape, 8)};
        if (rowBytes / 8 != mShape.rows) fail("the number of its rows");
        mValues =
            dataHeader.find("'<f4'") != std::string::npos ? ListValues::kDistance : ListValues::kConnectivity;
        const std::size_t indexBytes = layoutNpz(mShape, 0, mValues, true).indexBytes;
        mPairs = indexBytesAll / indexBytes;
        mLayout = layoutNpz(mShape, mPairs, mValues, true);
        for (std::size_t i = 0; i < mLayout.count; ++i) mLayout.members[i].crc = entries[i].crc;
        if (mLayout.directoryOffset != directoryOffset || centralDirectory(mLayout) != directory)
            fail("its directory");
        for (std::size_t i = 0; i < mLayout.count; ++i) {
            const std::string header = localHeader(mLayout.members[i]);
            if (bytesAt(mLayout.members[i].localOffset, header.size()) != header)
                fail("what stands before its array '" + mLayout.members[i].name + "'");
        }
    }

    // Place and bytes of the values of a member.
    std::pair<std::uint64_t, std::uint64_t> valuesOf(const Entry& entry,
                                                     std::string* npyHeader = nullptr) const
    {
        constexpr std::uint64_t kLocalBytes = 30, kNpyBytes = 10;
        const std::string local = bytesAt(entry.localOffset, kLocalBytes);
        const std::uint64_t begin = entry.localOffset + kLocalBytes + numberAt<std::uint16_t>(local, 26) +
                                    numberAt<std::uint16_t>(local, 28);
        const std::uint64_t headerBytes = kNpyBytes + numberAt<std::uint16_t>(bytesAt(begin, kNpyBytes), 8);
        if (headerBytes > entry.bytes) fail("the size of an array");
        if (npyHeader) *npyHeader = bytesAt(begin, headerBytes);
        return {begin + headerBytes, entry.bytes - headerBytes};
    }

    InputFile mFile;
    NpzLayout mLayout;
    NpzShape mShape{0, 0};
    std::uint64_t mPairs = 0;
    ListValues mValues = ListValues::kConnectivity;
    PartOrigin mOrigin;
};

using Parts = std::vector<std::unique_ptr<PartFile>>;

// All tiles of one search, each once.
void checkTogether(const Parts& parts)
{
    const PartFile& first = *parts.front();
    std::vector<const PartFile*> byTile(std::min<std::size_t>(first.origin().tiles, parts.size()));
    for (const auto& part : parts) {
        const PartOrigin &a = first.origin(), &b = part->origin();
        const char* const what =
            a.tiles != b.tiles       ? "a cut into another number of tiles"
            : a.input != b.input     ? "other points"
            : a.options != b.options ? "another radius or other flags"
            : a.rows != b.rows || first.columns() != part->columns() || first.values() != part->values()
                ? "another shape"
                : nullptr;
        if (what)
            throw InputError(part->name() + ": is a part of another search than " + first.name() + ", of " +
                             what + "; merge the parts of one search");
        if (b.tile > byTile.size()) continue; // so that one is missing
        const PartFile*& place = byTile[b.tile - 1];
        if (place && place->name() == part->name())
            throw InputError(part->name() + ": is given twice; give each part once");
        if (place)
            throw InputError(part->name() + ": is tile " + std::to_string(b.tile) + " of " +
                             std::to_string(b.tiles) + ", and so is " + place->name() +
                             "; give each part once");
        place = part.get();
    }
    std::uint64_t rows = 0;
    for (const auto& part : parts) rows += part->rows();
    const auto missing = std::find(byTile.begin(), byTile.end(), nullptr);
    if (missing == byTile.end() && byTile.size() == first.origin().tiles) {
        if (rows != first.origin().rows) first.fail("the number of rows of all parts");
        return;
    }
    throw InputError(first.name() + ": tile " + std::to_string(missing - byTile.begin() + 1) + " of " +
                     std::to_string(first.origin().tiles) +
                     " of its search is missing; give the parts of all tiles");
}

class MergedRows final : public NpzRows {
public:
    MergedRows(const Parts& parts, const CancelCheck& cancel)
        : mParts(parts),
          mCounts(static_cast<std::size_t>(parts.front()->origin().rows)),
          mPlaces(mCounts.size()),
          mPartOf(mCounts.size(), kNobody),
          mReaders([this] { return Reader(mParts.size()); })
    {
        for (std::size_t p = 0; p < parts.size(); ++p) {
            cancel.check();
            takeRows(static_cast<std::uint32_t>(p));
            mPairs += parts[p]->pairs();
        }
        const auto nobody = std::find(mPartOf.begin(), mPartOf.end(), kNobody);
        if (nobody != mPartOf.end())
            throw InputError(parts.front()->name() + ": row " + std::to_string(nobody - mPartOf.begin()) +
                             " of its search is in no part; make the parts again");
    }

    std::size_t size() const override { return mCounts.size(); }
    std::size_t columnCount() const override { return static_cast<std::size_t>(mParts.front()->columns()); }
    std::uint64_t pairCount() const override { return mPairs; }
    std::uint32_t count(std::size_t row) const override { return mCounts[row]; }

    void copyRow(std::size_t row, std::uint32_t* out) const override
    {
        Reader& reader = mReaders.local();
        reader.load(*this, row);
        std::copy(reader.numbers.begin(), reader.numbers.end(), out);
    }

    // As it is in its part.
    void order(std::size_t row, std::uint32_t* numbers, std::size_t) const override
    {
        Reader& reader = mReaders.local();
        reader.load(*this, row);
        std::copy(reader.numbers.begin(), reader.numbers.end(), numbers);
    }

    // Asked for in the order of the part.
    double distance(std::size_t row, std::size_t neighbor) const override
    {
        Reader& reader = mReaders.local();
        reader.load(*this, row);
        if (reader.next == reader.numbers.size() || reader.numbers[reader.next] != neighbor) {
            const auto place = std::find(reader.numbers.begin(), reader.numbers.end(), neighbor);
            reader.next = static_cast<std::size_t>(place - reader.numbers.begin());
        }
        return static_cast<double>(reader.distances[reader.next++]);
    }

private:
    // Values of one array of a part, those of many rows at once.
    struct Window {
        std::uint64_t begin = 0, end = 0;
        std::vector<unsigned char> bytes;

        const unsigned char* at(const PartFile& part, int member, std::uint64_t place, std::size_t count,
                                std::size_t valueBytes, std::size_t windowBytes)
        {
            if (place < begin || place + count > end) {
                begin = place;
                end = std::min(part.pairs(), place + std::max(count, windowBytes / valueBytes));
                const auto values = static_cast<std::size_t>(end - begin);
                bytes.resize(std::max(bytes.size(), values * valueBytes));
                part.read(member, begin, values, valueBytes, bytes.data());
            }
            return bytes.data() + (place - begin) * valueBytes;
        }
    };

    // Of a thread: the row at hand.
    struct Reader {
        explicit Reader(std::size_t parts) : indices(parts), data(parts) {}

        void load(const MergedRows& rows, std::size_t wanted)
        {
            if (row == wanted) return;
            // All windows of a thread together.
            constexpr std::size_t kWindows = std::size_t(64) << 20, kLeast = 4096,
                                  kMost = std::size_t(512) << 10;
            const std::size_t windowBytes = std::clamp(kWindows / (2 * indices.size()), kLeast, kMost);
            row = std::numeric_limits<std::size_t>::max();
            const std::size_t p = rows.mPartOf[wanted], count = rows.mCounts[wanted];
            const PartFile& part = *rows.mParts[p];
            const std::size_t indexBytes = part.indexBytes();
            const unsigned char* values = indices[p].at(part, NpzLayout::kIndices, rows.mPlaces[wanted],
                                                        count, indexBytes, windowBytes);
            numbers.resize(count);
            for (std::size_t k = 0; k < count; ++k, values += indexBytes) {
                std::uint64_t number = 0;
                std::memcpy(&number, values, indexBytes);
                if (number >= part.columns()) part.fail("a number in its array 'indices'");
                numbers[k] = static_cast<std::uint32_t>(number);
            }
            if (part.values() == ListValues::kDistance) {
                values = data[p].at(part, NpzLayout::kData, rows.mPlaces[wanted], count, sizeof(float),
                                    windowBytes);
                distances.resize(count);
                if (count > 0) std::memcpy(distances.data(), values, count * sizeof(float));
            }
            next = 0;
            row = wanted;
        }

        std::vector<Window> indices, data; // of each part
        std::size_t row = std::numeric_limits<std::size_t>::max(), next = 0;
        std::vector<std::uint32_t> numbers;
        std::vector<float> distances;
    };

    void takeRows(std::uint32_t p)
    {
        constexpr std::size_t kBlock = kPieceBytes / 8;
        const PartFile& part = *mParts[p];
        std::vector<std::uint64_t> rows, ends;
        std::uint64_t before = 0;
        for (std::uint64_t begin = 0; begin <= part.rows(); begin += kBlock) {
            const auto count = static_cast<std::size_t>(std::min<std::uint64_t>(kBlock, part.rows() - begin));
            rows.resize(count);
            ends.resize(count + 1);
            if (count > 0) part.read(NpzLayout::kRows, begin, count, 8, rows.data());
            part.read(NpzLayout::kIndptr, begin, count + 1, 8, ends.data());
            if (ends.front() != before) part.fail("its array 'indptr'");
            for (std::size_t k = 0; k < count; ++k) {
                if (ends[k + 1] < ends[k] || ends[k + 1] > part.pairs() || ends[k + 1] - ends[k] > kNobody)
                    part.fail("its array 'indptr'");
                const auto row = static_cast<std::size_t>(rows[k]);
                if (rows[k] >= mCounts.size() || mPartOf[row] != kNobody) part.fail("a number of its rows");
                mPartOf[row] = p;
                mPlaces[row] = ends[k];
                mCounts[row] = static_cast<std::uint32_t>(ends[k + 1] - ends[k]);
            }
            before = ends.back();
        }
        if (before != part.pairs()) part.fail("its array 'indptr'");
    }

    const Parts& mParts;
    std::vector<std::uint32_t> mCounts;
    std::vector<std::uint64_t> mPlaces; // of a row's first value in its part
    std::vector<std::uint32_t> mPartOf;
    std::uint64_t mPairs = 0;
    mutable tbb::enumerable_thread_specific<Reader> mReaders;
};

} // namespace

MergedParts mergeNpzParts(const std::vector<std::string>& paths, const std::string& path,
                          const OutputOptions& options, Progress* progress)
{
    if (paths.empty()) throw InvalidInput("no parts are given to merge");
    const CancelCheck cancel(progress, "read");
    MergedParts result;
    isolatedIeee([&] {
        Parts parts;
        for (const std::string& each : paths) {
            cancel.check();
            parts.push_back(std::make_unique<PartFile>(each));
        }
        checkTogether(parts);
        std::uint64_t all = 1;
        for (const auto& part : parts) all += part->bytes();
        std::atomic<std::uint64_t> done{0};
        tbb::parallel_for(std::size_t(0), parts.size(), [&](std::size_t p) {
            parts[p]->checkSums([&](std::size_t bytes) {
                cancel.update(static_cast<double>(done += bytes) / static_cast<double>(all));
            });
        });
        const MergedRows rows(parts, cancel);
        result = {rows.size(), rows.columnCount(), rows.pairCount()};
        writeNpzRows(path, rows, {parts.front()->values(), RowOrder::kDistance}, options, progress);
    });
    return result;
}

std::uint64_t hashFile(const std::string& path, Progress* progress)
{
    constexpr std::uint64_t kPrime = 0x9E3779B97F4A7C15u;
    const CancelCheck cancel(progress, "read");
    const InputFile file(path);
    const auto pieces = static_cast<std::size_t>((file.size() + kPieceBytes - 1) / kPieceBytes);
    std::vector<std::uint64_t> hashes(pieces);
    isolatedIeee([&] {
        tbb::enumerable_thread_specific<std::vector<std::uint64_t>> memory;
        tbb::parallel_for(std::size_t(0), pieces, [&](std::size_t i) {
            cancel.check();
            const std::uint64_t begin = std::uint64_t(i) * kPieceBytes;
            const auto bytes =
                static_cast<std::size_t>(std::min<std::uint64_t>(kPieceBytes, file.size() - begin));
            std::vector<std::uint64_t>& words = memory.local();
            words.assign((bytes + 7) / 8, 0);
            file.readAt(begin, words.data(), bytes);
            std::uint64_t hash = kPrime;
            for (const std::uint64_t word : words) hash = (hash ^ mix64(word)) * kPrime;
            hashes[i] = hash;
        });
    });
    std::uint64_t hash = mix64(file.size());
    for (const std::uint64_t piece : hashes) hash = mix64(hash ^ piece);
    return hash;
}

} // namespace vdb_nns
