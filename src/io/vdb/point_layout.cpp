// Layout of a point grid behind its topology, after openvdb/points/PointDataGrid.h, AttributeSet.cc, AttributeArray.h and
// StreamCompression.cc. It is written in passes over all leaves; n is the largest number of attributes of a leaf:
//
//   number of passes (2): 2 n + 4, or 0 without leaves
//   pass 0: size of the leaf's voxel offsets as they are in the file (2); 65535: 2048 bytes, not compressed
//   pass 1: the descriptor, unless a leaf before said that all share its own: flags (1; bit 0: shared, bit 1: a size (8) and
//           so many bytes to pass over follow it) and number of attributes (8), of each the value type and the codec; of each
//           its name and place (8); number of groups (8), of each its name and bit (8); metadata.
//           Then of each attribute: 6 + bytes (8), flags (1), storage flags (1), size (4), and stride (4) if it is not 1
//   pass 2 to n + 1: of the leaf's array of that place, if it is the first of a page: the page's size in the file (4), and the
//           decompressed size (4); or once the negative size, where it is not compressed
//   pass n + 2: value mask (64), the size of pass 0 (2), and the voxel offsets
//   pass n + 3 to 2 n + 2: the page, before the first of its arrays; an array that is not paged: whether it is compressed (1),
//           unless it is uniform, and its bytes
//   pass 2 n + 3: nothing
#include "io/vdb/point_layout.h"

#include "io/vdb/grid_header.h"
#include "io/vdb/tree_walk.h"

#include <algorithm>
#include <cstdlib>
#include <cstring>
#include <numeric>
#include <unordered_set>
#include <utility>

namespace vdb_nns {

namespace {

constexpr std::size_t kMaskBytes = 64, kOffsetBytes = 2048;
constexpr std::uint16_t kNotCompressed = 0xFFFF;
constexpr std::uint8_t kSharedDescriptor = 1, kBytesToSkip = 2; // of a descriptor
constexpr std::uint8_t kConstantStride = 8;                     // flag of an array
constexpr std::uint8_t kStrided = 1, kUniform = 2, kPaged = 8,
                       kFirstUnknownFlag = 16; // storage flags of an array
constexpr std::uint64_t kArrayHeaderBytes = 6;
// A run is read at once.
constexpr std::uint64_t kMostRunBytes = std::uint64_t(1) << 20;
constexpr const char* kTextPrefix = "string:";

// A count of items of at least so many bytes each: more than the file can hold are refused before they are looped over.
std::uint64_t readCount(VdbCursor& cursor, std::uint64_t leastBytes, const char* what)
{
    const auto count = cursor.number<std::uint64_t>(what);
    if (count > cursor.left() / leastBytes) {
        cursor.fail("at most " + std::to_string(cursor.left() / leastBytes) + " (" + what + "), not " +
                        std::to_string(count) + ",",
                    cursor.position() - sizeof count);
    }
    return count;
}

VdbDescriptor readDescriptor(VdbCursor& cursor, std::size_t mostAttributes)
{
    VdbDescriptor descriptor;
    const std::uint64_t count = readCount(cursor, 8, "the number of attributes");
    if (count > mostAttributes) {
        cursor.fail("at most " + std::to_string(mostAttributes) +
                        " attributes, as there are passes for, not " + std::to_string(count) + ",",
                    cursor.position() - sizeof count);
    }
    descriptor.attributes.resize(static_cast<std::size_t>(count));
    for (VdbDescriptor::Attribute& attribute : descriptor.attributes) {
        attribute.valueType = cursor.text("the type of an attribute");
        attribute.codec = cursor.text("the codec of an attribute");
        attribute.type = attributeType(attribute.valueType, attribute.codec);
    }
    std::unordered_set<std::string> names;
    for (std::size_t left = descriptor.attributes.size(); left > 0; --left) {
        const std::uint64_t at = cursor.position();
        const std::string name = cursor.text("the name of an attribute");
        const auto place = cursor.number<std::uint64_t>("the place of an attribute");
        if (place >= descriptor.attributes.size() || name.empty() ||
            !descriptor.attributes[place].name.empty() || !names.insert(name).second)
            cursor.fail("the name and the place of an attribute, each of them once,", at);
        descriptor.attributes[place].name = name;
    }
    for (auto left = readCount(cursor, 12, "the number of groups"); left > 0; --left) {
        const std::string name = cursor.text("the name of a group");
        descriptor.groups[name] = cursor.number<std::uint64_t>("the bit of a group");
    }
    for (const VdbMetadata& item : readMetadata(cursor)) {
        if (item.type != "string" || item.name.compare(0, 7, kTextPrefix) != 0) continue;
        const auto number = std::strtoul(item.name.c_str() + 7, nullptr, 10);
        descriptor.texts[static_cast<std::uint32_t>(number + 1)] = item.value;
    }
    return descriptor;
}

VdbArray readArray(VdbCursor& cursor, const VdbDescriptor::Attribute& attribute)
{
    const std::uint64_t at = cursor.position();
    // At once, for there are many of them.
    const unsigned char* const header = cursor.take(14, "the size, flags and points of an attribute");
    VdbArray array;
    std::memcpy(&array.bytes, header, sizeof array.bytes);
    std::memcpy(&array.size, header + 10, sizeof array.size);
    array.bytes -= kArrayHeaderBytes;
    array.hasConstantStride = header[8] & kConstantStride;
    const std::uint8_t storage = header[9];
    if (storage >= kFirstUnknownFlag) {
        cursor.fail("storage flags of attribute '" + attribute.name + "' below 16, not " +
                        std::to_string(storage) + ",",
                    at + 9);
    }
    array.isUniform = storage & kUniform;
    array.isPaged = storage & kPaged;
    if (storage & kStrided) array.stride = cursor.number<std::uint32_t>("the stride of an attribute");
    const std::uint64_t each = attribute.type.storedBytes;
    bool isRight = array.bytes > 0 && (array.isPaged || array.bytes <= cursor.left());
    if (isRight && attribute.type.isKnown) {
        // What a compressed array holds that is not paged is known once it is decompressed.
        isRight = array.isPaged || array.isUniform
                      ? array.bytes % each == 0 && array.bytes / each == array.values()
                      : array.values() <= kMostExpansion * (array.bytes / each + 1);
    }
    if (!isRight) {
        cursor.fail("the size of " + std::to_string(array.values()) + " values of attribute '" +
                        attribute.name + "', not " + std::to_string(array.bytes + kArrayHeaderBytes) + ",",
                    at);
    }
    return array;
}

class LayoutReader {
public:
    LayoutReader(VdbCursor& cursor, std::uint32_t compression) : mCursor(cursor)
    {
        mLayout.leaves = readTopology(cursor, {4, 4, false}, compression);
    }

    VdbPointLayout read()
    {
        const std::uint64_t at = mCursor.position();
        const auto passes = mCursor.number<std::uint16_t>("the number of passes");
        const std::size_t leaves = mLayout.leaves.size();
        if (leaves > 0 && (passes < 4 || passes % 2 != 0))
            mCursor.fail("an even number of passes, 4 or more, not " + std::to_string(passes) + ",", at);
        readVoxelSizes();
        readDescriptors((std::size_t(passes) - 4) / 2);
        // Leaves that have an array at a place: all, or in turn fewer.
        std::vector<std::uint32_t> having(leaves);
        std::iota(having.begin(), having.end(), 0);
        for (std::size_t place = 0;; ++place) {
            const auto hasNone = [&](std::uint32_t leaf) { return place >= mLayout.arrayCount(leaf); };
            having.erase(std::remove_if(having.begin(), having.end(), hasNone), having.end());
            if (having.empty()) break;
            mLayout.pieces.emplace_back();
            readPages(place, having);
        }
        placeVoxels();
        for (std::vector<VdbPiece>& pieces : mLayout.pieces) placePieces(pieces);
        mLayout.end = mCursor.position();
        return std::move(mLayout);
    }

private:
    // Sizes at first, see placeVoxels().
    void readVoxelSizes()
    {
        std::vector<std::uint64_t>& begin = mLayout.voxelsBegin;
        begin.reserve(mLayout.leaves.size() + 1);
        const std::size_t leaves = mLayout.leaves.size();
        constexpr std::size_t kAtOnce = 4096;
        for (std::size_t first = 0; first < leaves; first += kAtOnce) {
            std::uint16_t sizes[kAtOnce];
            const std::size_t count = std::min(kAtOnce, leaves - first);
            std::memcpy(sizes, mCursor.take(count * sizeof *sizes, "sizes of the leaves' voxel offsets"),
                        count * sizeof *sizes);
            for (std::size_t i = 0; i < count; ++i)
                begin.push_back(kMaskBytes + sizeof *sizes +
                                (sizes[i] == kNotCompressed ? kOffsetBytes : sizes[i]));
        }
    }

    void readDescriptors(std::size_t mostAttributes)
    {
        bool isShared = false;
        for (std::size_t leaf = 0; leaf < mLayout.leaves.size(); ++leaf) {
            if (!isShared) isShared = readOwnDescriptor(mostAttributes);
            mLayout.descriptorOf.push_back(static_cast<std::uint32_t>(mLayout.descriptors.size() - 1));
            mLayout.firstArray.push_back(mLayout.arrays.size());
            const auto& attributes = mLayout.descriptors.back().attributes;
            for (const auto& attribute : attributes) mLayout.arrays.push_back(readArray(mCursor, attribute));
        }
        mLayout.firstArray.push_back(mLayout.arrays.size());
    }

    // Returns whether the leaves that follow share it.
    bool readOwnDescriptor(std::size_t mostAttributes)
    {
        const auto flags = mCursor.number<std::uint8_t>("the flags of a descriptor");
        if (flags > (kSharedDescriptor | kBytesToSkip))
            mCursor.fail("flags of a descriptor below 4, not " + std::to_string(flags) + ",",
                         mCursor.position() - 1);
        mLayout.descriptors.push_back(readDescriptor(mCursor, mostAttributes));
        if (flags & kBytesToSkip) {
            const auto bytes = mCursor.number<std::uint64_t>("the number of bytes to pass over");
            mCursor.skip(bytes, "bytes to pass over");
        }
        return flags & kSharedDescriptor;
    }

    // The pieces of the arrays at a place, but for their positions.
    void readPages(std::size_t place, const std::vector<std::uint32_t>& leaves)
    {
        std::vector<VdbPiece>& pieces = mLayout.pieces[place];
        std::size_t page = 0, run = 0; // numbers of the last ones, plus one
        std::uint64_t pageLeft = 0;
        for (const std::size_t leaf : leaves) {
            const VdbArray& array = mLayout.array(leaf, place);
            if (!array.isPaged) {
                const std::uint64_t bytes = array.bytes + (array.isUniform ? 0 : 1);
                const bool isNew =
                    run != pieces.size() || run == 0 || pieces[run - 1].storedBytes + bytes > kMostRunBytes;
                if (isNew) pieces.push_back({0, 0, 0, false, leaf, leaf}), run = pieces.size();
                pieces[run - 1].storedBytes += bytes;
                pieces[run - 1].endLeaf = leaf + 1;
                continue;
            }
            if (pageLeft == 0) {
                pieces.push_back(readPage(leaf));
                page = pieces.size();
                pageLeft = pieces.back().pageBytes;
            }
            if (array.bytes > pageLeft) {
                mCursor.fail("a page that holds whole arrays: one of " + std::to_string(array.bytes) +
                             " bytes begins where " + std::to_string(pageLeft) + " are left");
            }
            pageLeft -= array.bytes;
            pieces[page - 1].endLeaf = leaf + 1;
        }
        if (pageLeft > 0)
            mCursor.fail("arrays for the last " + std::to_string(pageLeft) + " bytes of a page");
    }

    VdbPiece readPage(std::size_t leaf)
    {
        const std::uint64_t at = mCursor.position();
        const std::int64_t stored = mCursor.number<std::int32_t>("the size of a page");
        const std::int64_t bytes =
            stored > 0 ? mCursor.number<std::int32_t>("the decompressed size of a page") : -stored;
        if (bytes <= 0) mCursor.fail("the size of a page, not 0 or less,", at);
        return {0,
                static_cast<std::uint64_t>(stored > 0 ? stored : bytes),
                static_cast<std::uint64_t>(bytes),
                stored > 0,
                leaf,
                leaf + 1};
    }

    void placeVoxels()
    {
        std::uint64_t next = mCursor.position();
        for (std::uint64_t& begin : mLayout.voxelsBegin) next += std::exchange(begin, next);
        mCursor.skip(next - mCursor.position(), "the voxel offsets of the leaves");
        mLayout.voxelsBegin.push_back(next);
    }

    void placePieces(std::vector<VdbPiece>& pieces)
    {
        for (VdbPiece& piece : pieces) {
            piece.position = mCursor.position();
            mCursor.skip(piece.storedBytes, "the values of an attribute");
        }
    }

    VdbCursor& mCursor;
    VdbPointLayout mLayout;
};

} // namespace

std::size_t VdbDescriptor::find(const std::string& name) const
{
    const auto found = std::find_if(attributes.begin(), attributes.end(),
                                    [&](const Attribute& attribute) { return attribute.name == name; });
    return found == attributes.end() ? kNone : static_cast<std::size_t>(found - attributes.begin());
}

VdbPointLayout readPointLayout(VdbCursor& cursor, std::uint32_t compression)
{
    return LayoutReader(cursor, compression).read();
}

} // namespace vdb_nns
