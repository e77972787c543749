#include "io/vdb/point_reader.h"
#include "util/shown_text.h"

#include "io/vdb/decompress.h"
#include "points/occupied_voxels.h"
#include "vdb_nns/error.h"

#include <oneapi/tbb/enumerable_thread_specific.h>
#include <oneapi/tbb/parallel_for.h>

#include <algorithm>
#include <cstring>
#include <limits>
#include <utility>

namespace vdb_nns {

namespace {

constexpr std::size_t kVoxels = 512, kMaskBytes = 64, kOffsetBytes = kVoxels * sizeof(std::uint32_t);
constexpr std::uint16_t kNotCompressed = 0xFFFF;
// Bytes of voxel offsets that a task reads at once.
constexpr std::uint64_t kChunkBytes = std::uint64_t(512) << 10;
constexpr const char* kPosition = "P";

std::string coordText(const Vec3i& c)
{
    return "(" + std::to_string(c[0]) + ", " + std::to_string(c[1]) + ", " + std::to_string(c[2]) + ")";
}

// Leaves whose voxel offsets are read at once.
struct Chunk {
    std::size_t firstLeaf, endLeaf;
    std::vector<std::uint16_t> voxels; // of their points
};

std::vector<Chunk> chunksOf(const VdbPointLayout& layout, VdbLeafRange leaves)
{
    std::vector<Chunk> chunks;
    for (std::size_t leaf = leaves.begin; leaf < leaves.end; ++leaf) {
        if (chunks.empty() ||
            layout.voxelsBegin[leaf + 1] - layout.voxelsBegin[chunks.back().firstLeaf] > kChunkBytes)
            chunks.push_back({leaf, leaf, {}});
        chunks.back().endLeaf = leaf + 1;
    }
    return chunks;
}

// Appends the voxel of each point of a leaf.
void appendVoxels(const std::uint32_t* ends, const std::uint64_t* occupied,
                  std::vector<std::uint16_t>& voxels)
{
    const std::size_t before = voxels.size();
    voxels.resize(before + ends[kVoxels - 1]);
    std::uint16_t* out = voxels.data() + before;
    std::uint32_t point = 0;
    for (unsigned x = 0; x < 8; ++x) {
        for (std::uint64_t bits = occupied[x]; bits != 0; bits &= bits - 1) {
            const auto voxel =
                static_cast<std::uint16_t>(x * 64 + static_cast<unsigned>(__builtin_ctzll(bits)));
            for (const std::uint32_t end = ends[voxel]; point < end; ++point) *out++ = voxel;
        }
    }
}

// Memory of a thread, reused.
struct Scratch {
    std::vector<unsigned char> stored, values;
};
using ThreadScratch = tbb::enumerable_thread_specific<Scratch>;

const unsigned char* readBytes(const ByteSource& file, std::uint64_t position, std::uint64_t bytes,
                               std::vector<unsigned char>& out)
{
    if (out.size() < bytes) out.resize(static_cast<std::size_t>(bytes));
    file.readAt(position, out.data(), static_cast<std::size_t>(bytes));
    return out.data();
}

// The points of some leaves in their order.
struct PointCounts {
    VdbLeafRange leaves;
    std::vector<std::uint64_t> begins; // number of the first point of each leaf, and one more

    std::uint64_t begin(std::size_t leaf) const { return begins[leaf - leaves.begin]; }
    std::uint64_t count(std::size_t leaf) const { return begin(leaf + 1) - begin(leaf); }
};

} // namespace

// Decodes the arrays of one attribute into one value a point.
class VdbPointReader::Decoder {
public:
    // placeOf: of the attribute in each descriptor, kNone where it has none. valueBytes: of a decoded value.
    Decoder(const VdbPointReader& reader, const PointCounts& points, std::vector<std::size_t> placeOf,
            std::size_t valueBytes, std::string name, void* out)
        : mReader(reader),
          mLayout(reader.mLayout),
          mPoints(points),
          mPlaceOf(std::move(placeOf)),
          mValueBytes(valueBytes),
          mName(std::move(name)),
          mOut(static_cast<unsigned char*>(out))
    {
    }

    void decode(const CancelCheck& cancel) const
    {
        struct Task {
            std::size_t place;
            const VdbPiece* piece;
        };
        std::vector<Task> tasks;
        std::vector<bool> isPlace(mLayout.pieces.size()); // of the attribute, in some leaf
        for (const std::size_t place : mPlaceOf) {
            if (place < isPlace.size()) isPlace[place] = true;
        }
        for (std::size_t place = 0; place < isPlace.size(); ++place) {
            if (!isPlace[place]) continue;
            for (const VdbPiece& piece : mLayout.pieces[place]) {
                if (piece.firstLeaf < mPoints.leaves.end && piece.endLeaf > mPoints.leaves.begin)
                    tasks.push_back({place, &piece});
            }
        }
        ThreadScratch scratch;
        tbb::parallel_for(std::size_t(0), tasks.size(), [&](std::size_t i) {
            cancel.check();
            const Task& task = tasks[i];
            if (task.piece->isPage()) {
                decodePage(task.place, *task.piece, scratch.local());
            } else {
                decodeRun(task.place, *task.piece, scratch.local());
            }
        });
    }

private:
    bool isWanted(std::size_t leaf, std::size_t place) const
    {
        return leaf >= mPoints.leaves.begin && leaf < mPoints.leaves.end &&
               mPlaceOf[mLayout.descriptorOf[leaf]] == place && mPoints.count(leaf) > 0;
    }

    const VdbAttributeType& typeOf(std::size_t leaf, std::size_t place) const
    {
        return mLayout.descriptor(leaf).attributes[place].type;
    }

    // f(leaf, array) for the arrays of a piece.
    template <typename F>
    void forEachArray(std::size_t place, const VdbPiece& piece, F&& f) const
    {
        for (std::size_t leaf = piece.firstLeaf; leaf < piece.endLeaf; ++leaf) {
            if (place >= mLayout.arrayCount(leaf)) continue;
            const VdbArray& array = mLayout.array(leaf, place);
            if (array.isPaged == piece.isPage()) f(leaf, array);
        }
    }

    // Whether the decompressed page is what the points' values are: all of them, and no point between them is of a leaf that
    // has the attribute elsewhere or not at all.
    bool isPlain(std::size_t place, const VdbPiece& page) const
    {
        bool result = true;
        forEachArray(place, page, [&](std::size_t leaf, const VdbArray& array) {
            result = result && !array.isUniform && isWanted(leaf, place) &&
                     typeOf(leaf, place).codec == VdbCodec::kPlain;
        });
        return result && // the first and the last leaf have arrays in it, and so are among the points
               (mPoints.begin(page.endLeaf) - mPoints.begin(page.firstLeaf)) * mValueBytes == page.pageBytes;
    }

    void decodePage(std::size_t place, const VdbPiece& page, Scratch& scratch) const
    {
        if (page.pageBytes > kMostExpansion * page.storedBytes)
            fail("a page that decompresses to less than " + std::to_string(page.pageBytes) + " bytes", page);
        unsigned char* const direct =
            isPlain(place, page) ? mOut + mPoints.begin(page.firstLeaf) * mValueBytes : nullptr;
        if (direct && !page.isCompressed)
            return mReader.mFile.readAt(page.position, direct, static_cast<std::size_t>(page.storedBytes));
        const unsigned char* values =
            readBytes(mReader.mFile, page.position, page.storedBytes, scratch.stored);
        if (page.isCompressed) {
            if (!direct && scratch.values.size() < page.pageBytes)
                scratch.values.resize(static_cast<std::size_t>(page.pageBytes));
            unsigned char* const out = direct ? direct : scratch.values.data();
            if (!decompressBlosc(values, static_cast<std::size_t>(page.storedBytes), out,
                                 static_cast<std::size_t>(page.pageBytes)))
                fail("a page of " + std::to_string(page.pageBytes) + " bytes compressed by Blosc", page);
            if (direct) return;
            values = out;
        }
        forEachArray(place, page, [&](std::size_t leaf, const VdbArray& array) {
            if (isWanted(leaf, place)) decodeArray(leaf, typeOf(leaf, place), array, values);
            values += array.bytes;
        });
    }

    void decodeRun(std::size_t place, const VdbPiece& run, Scratch& scratch) const
    {
        const unsigned char* next = readBytes(mReader.mFile, run.position, run.storedBytes, scratch.stored);
        forEachArray(place, run, [&](std::size_t leaf, const VdbArray& array) {
            const bool isCompressed = !array.isUniform && *next++ == 1;
            const unsigned char* values = next;
            next += array.bytes;
            if (!isWanted(leaf, place)) return;
            const VdbAttributeType& type = typeOf(leaf, place);
            const std::uint64_t bytes = array.values() * type.storedBytes;
            if (isCompressed) {
                if (bytes > kMostExpansion * array.bytes)
                    fail("values that decompress to less than " + std::to_string(bytes) + " bytes", run);
                if (scratch.values.size() < bytes) scratch.values.resize(static_cast<std::size_t>(bytes));
                if (!decompressBlosc(values, static_cast<std::size_t>(array.bytes), scratch.values.data(),
                                     static_cast<std::size_t>(bytes)))
                    fail("values of " + std::to_string(bytes) + " bytes compressed by Blosc", run);
                values = scratch.values.data();
            } else if (array.bytes != bytes) {
                fail(std::to_string(bytes) + " bytes of values of the leaf at " +
                         coordText(mLayout.leaves[leaf]) + ", not " + std::to_string(array.bytes) + ",",
                     run);
            }
            decodeArray(leaf, type, array, values);
        });
    }

    void decodeArray(std::size_t leaf, const VdbAttributeType& type, const VdbArray& array,
                     const unsigned char* values) const
    {
        unsigned char* const out = mOut + mPoints.begin(leaf) * mValueBytes;
        const auto count = static_cast<std::size_t>(mPoints.count(leaf));
        decodeValues(type, values, array.isUniform ? 1 : count, out);
        if (!array.isUniform) return;
        for (std::size_t i = 1; i < count; ++i) std::memcpy(out + i * mValueBytes, out, mValueBytes);
    }

    [[noreturn]] void fail(const std::string& expected, const VdbPiece& piece) const
    {
        failDamaged(mReader.mFile.name(), mReader.mPart, expected + " for attribute '" + mName + "'",
                    piece.position);
    }

    const VdbPointReader& mReader;
    const VdbPointLayout& mLayout;
    const PointCounts& mPoints;
    std::vector<std::size_t> mPlaceOf;
    std::size_t mValueBytes;
    std::string mName;
    unsigned char* mOut;
};

namespace {

// Reads where the points of leaves are.
class VoxelReader {
public:
    VoxelReader(const ByteSource& file, const VdbPointLayout& layout, const std::string& part,
                std::vector<std::size_t> positionPlaces)
        : mFile(file), mLayout(layout), mPart(part), mPositionPlaces(std::move(positionPlaces))
    {
    }

    PointCounts read(VdbLeafRange leaves, const CancelCheck& cancel, PageArray<std::uint16_t>& voxels) const
    {
        PointCounts points{leaves, {}};
        points.begins.assign(leaves.end - leaves.begin + 1, 0);
        std::vector<Chunk> chunks = chunksOf(mLayout, leaves);
        ThreadScratch scratch;
        tbb::parallel_for(std::size_t(0), chunks.size(), [&](std::size_t c) {
            cancel.check();
            readChunk(chunks[c], points, scratch.local());
        });
        std::uint64_t sum = 0;
        for (std::uint64_t& begin : points.begins) sum += std::exchange(begin, sum);
        if (sum > std::numeric_limits<std::uint32_t>::max()) {
            throw InputError(mFile.name() + ": " + mPart + ": " + std::to_string(sum) +
                             " points are more than one view holds (4294967295): split the grid");
        }
        voxels.resizeDiscarding(static_cast<std::size_t>(sum));
        tbb::parallel_for(std::size_t(0), chunks.size(), [&](std::size_t c) {
            std::vector<std::uint16_t> own = std::move(chunks[c].voxels);
            std::copy(own.begin(), own.end(), voxels.data() + points.begin(chunks[c].firstLeaf));
        });
        return points;
    }

private:
    // Notes the number of points of each leaf.
    void readChunk(Chunk& chunk, PointCounts& points, Scratch& scratch) const
    {
        const std::uint64_t begin = mLayout.voxelsBegin[chunk.firstLeaf];
        const unsigned char* const bytes =
            readBytes(mFile, begin, mLayout.voxelsBegin[chunk.endLeaf] - begin, scratch.stored);
        std::uint64_t most = 0; // points, as the arrays say, which need not be right
        for (std::size_t leaf = chunk.firstLeaf; leaf < chunk.endLeaf; ++leaf)
            most += mLayout.arrayCount(leaf) > 0 ? mLayout.array(leaf, 0).size : 0;
        chunk.voxels.reserve(static_cast<std::size_t>(most));
        alignas(16) std::uint32_t ends[kVoxels];
        std::uint64_t occupied[kVoxels / 64];
        for (std::size_t leaf = chunk.firstLeaf; leaf < chunk.endLeaf; ++leaf) {
            const std::uint64_t at = mLayout.voxelsBegin[leaf];
            readEnds(leaf, bytes + (at - begin), ends);
            if (!findOccupied(ends, occupied)) {
                failDamaged(mFile.name(), mPart,
                            "voxel offsets that do not decrease, in the leaf at " +
                                coordText(mLayout.leaves[leaf]) + ",",
                            at);
            }
            points.begins[leaf - points.leaves.begin] = ends[kVoxels - 1];
            checkCounts(leaf, ends[kVoxels - 1]);
            appendVoxels(ends, occupied, chunk.voxels);
        }
    }

    void readEnds(std::size_t leaf, const unsigned char* bytes, std::uint32_t* ends) const
    {
        const std::uint64_t at = mLayout.voxelsBegin[leaf];
        const std::size_t left =
            static_cast<std::size_t>(mLayout.voxelsBegin[leaf + 1] - at) - kMaskBytes - 2;
        std::uint16_t stored;
        std::memcpy(&stored, bytes + kMaskBytes, sizeof stored);
        const bool isPlain = stored == kNotCompressed;
        if ((isPlain ? kOffsetBytes : stored) != left) {
            failDamaged(mFile.name(), mPart,
                        "the size of the voxel offsets of the leaf at " + coordText(mLayout.leaves[leaf]) +
                            " once more, not " + std::to_string(stored) + ",",
                        at + kMaskBytes);
        }
        const unsigned char* const first = bytes + kMaskBytes + sizeof stored;
        if (isPlain) {
            std::memcpy(ends, first, kOffsetBytes);
        } else if (!decompressBlosc(first, stored, ends, kOffsetBytes)) {
            failDamaged(mFile.name(), mPart,
                        "512 voxel offsets of the leaf at " + coordText(mLayout.leaves[leaf]) +
                            ", compressed by Blosc,",
                        at + kMaskBytes + sizeof stored);
        }
    }

    // The arrays of a leaf and its offsets agree, and it has positions.
    void checkCounts(std::size_t leaf, std::uint32_t count) const
    {
        for (std::size_t place = 0; place < mLayout.arrayCount(leaf); ++place) {
            const std::uint32_t size = mLayout.array(leaf, place).size;
            // OpenVDB holds no array shorter than one.
            if (size == count || (count == 0 && size <= 1)) continue;
            failDamaged(mFile.name(), mPart,
                        "voxel offsets of " + std::to_string(size) + " points in the leaf at " +
                            coordText(mLayout.leaves[leaf]) + ", as many as attribute '" +
                            mLayout.descriptor(leaf).attributes[place].name + "' has, not of " +
                            std::to_string(count) + ",",
                        mLayout.voxelsBegin[leaf]);
        }
        if (count == 0) return;
        const std::size_t place = mPositionPlaces[mLayout.descriptorOf[leaf]];
        if (place == VdbDescriptor::kNone)
            fail("the leaf at " + coordText(mLayout.leaves[leaf]) + " has no attribute P");
        const VdbDescriptor::Attribute& attribute = mLayout.descriptor(leaf).attributes[place];
        if (!isPosition(attribute.type)) {
            fail("P has type " + escapedText(attribute.valueType) + " with codec " +
                 escapedText(attribute.codec) +
                 ", which is not supported; convert it to vec3s with codec null, trnc, fxpt16 or fxpt8");
        }
        const VdbArray& array = mLayout.array(leaf, place);
        if (!array.hasConstantStride || array.stride != 1) {
            fail("P has " + std::to_string(array.hasConstantStride ? array.stride : 0) +
                 " values a point instead of one");
        }
    }

    static bool isPosition(const VdbAttributeType& type)
    {
        return type.isKnown && type.scalar == VdbScalar::kFloat && type.components == 3 &&
               (type.codec == VdbCodec::kPlain || type.codec == VdbCodec::kHalf ||
                type.codec == VdbCodec::kPosition8 || type.codec == VdbCodec::kPosition16);
    }

    [[noreturn]] void fail(const std::string& what) const
    {
        throw InputError(mFile.name() + ": " + mPart + ": " + what);
    }

    const ByteSource& mFile;
    const VdbPointLayout& mLayout;
    const std::string& mPart;
    const std::vector<std::size_t> mPositionPlaces; // of each descriptor
};

std::vector<std::size_t> placesOf(const VdbPointLayout& layout, const std::string& name)
{
    std::vector<std::size_t> places;
    for (const VdbDescriptor& descriptor : layout.descriptors) places.push_back(descriptor.find(name));
    return places;
}

} // namespace

std::uint64_t VdbPointReader::pointBytes(VdbLeafRange leaves) const
{
    constexpr std::uint64_t kPointBytes = 3 * sizeof(float) + sizeof(std::uint16_t);
    std::uint64_t bytes = 0;
    for (std::size_t leaf = leaves.begin; leaf < leaves.end; ++leaf) {
        if (mLayout.arrayCount(leaf) > 0) bytes += kPointBytes * mLayout.array(leaf, 0).size;
    }
    return bytes + (leaves.end - leaves.begin) * (sizeof(Vec3i) + sizeof(std::uint64_t));
}

void VdbPointReader::readPoints(VdbLeafRange leaves, const CancelCheck& cancel, GridPoints& points) const
{
    const std::vector<std::size_t> places = placesOf(mLayout, kPosition);
    const PointCounts counts = VoxelReader(mFile, mLayout, mPart, places).read(leaves, cancel, points.voxels);
    points.leaves.clear();
    points.starts.assign(1, 0);
    for (std::size_t leaf = leaves.begin; leaf < leaves.end; ++leaf) {
        if (counts.count(leaf) == 0) continue;
        points.leaves.push_back(mLayout.leaves[leaf]);
        points.starts.push_back(counts.begin(leaf + 1));
    }
    cancel.update(0.5);
    points.positions.resizeDiscarding(3 * static_cast<std::size_t>(points.size()));
    Decoder(*this, counts, places, 3 * sizeof(float), kPosition, points.positions.data()).decode(cancel);
}

VdbValues VdbPointReader::readAttribute(VdbLeafRange leaves, const std::string& name,
                                        const GridPoints& points, const CancelCheck& cancel) const
{
    PointCounts counts{leaves, {0}};
    std::size_t next = 0; // leaf of `points`
    for (std::size_t leaf = leaves.begin; leaf < leaves.end; ++leaf) {
        const bool hasPoints = next < points.leaves.size() && points.leaves[next] == mLayout.leaves[leaf];
        counts.begins.push_back(hasPoints ? points.starts[++next] : points.starts[next]);
    }
    std::vector<std::size_t> places = placesOf(mLayout, name);
    VdbValues result;
    for (std::size_t leaf = leaves.begin; leaf < leaves.end; ++leaf) {
        const std::size_t place = places[mLayout.descriptorOf[leaf]];
        if (place == VdbDescriptor::kNone || counts.count(leaf) == 0) continue;
        checkAttribute(leaf, place, result.type);
        result.type = mLayout.descriptor(leaf).attributes[place].type;
    }
    result.count = points.size();
    result.bytes = PageBlock(static_cast<std::size_t>(result.count) * result.type.bytes());
    Decoder(*this, counts, std::move(places), result.type.bytes(), name, result.bytes.data()).decode(cancel);
    return result;
}

void VdbPointReader::checkAttribute(std::size_t leaf, std::size_t place, const VdbAttributeType& before) const
{
    const VdbDescriptor::Attribute& attribute = mLayout.descriptor(leaf).attributes[place];
    const VdbAttributeType& type = attribute.type;
    const auto fail = [&](const std::string& what) {
        throw InputError(mFile.name() + ": " + mPart + ": attribute '" + escapedText(attribute.name) + "' " +
                         what);
    };
    if (!type.isKnown || type.codec == VdbCodec::kUnitVector) {
        fail("has type " + escapedText(attribute.valueType) + " with codec " + escapedText(attribute.codec) +
             ", which is not supported; convert it to a type without codec");
    }
    if (before.isKnown && (before.scalar != type.scalar || before.components != type.components))
        fail("has not the same type in all leaves; write the file again");
    const VdbArray& array = mLayout.array(leaf, place);
    if (!array.hasConstantStride || array.stride != 1)
        fail("has several values a point, which is not supported");
}

} // namespace vdb_nns
