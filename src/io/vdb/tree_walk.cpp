// Layout of a tree, after openvdb/tree/{Tree,RootNode,InternalNode,LeafNode}.h and openvdb/io/Compression.h:
//
//   buffer count (4), 1 since ever
//   root: background value, number of tiles (4), number of children (4)
//         each tile: origin (3 x 4), value, whether it is active (1)
//         each child: origin (3 x 4) and the node; the file's order does not matter, their buffers come in that of the origins
//   internal node: child mask, value mask (a bit a child), values of all children that are none, then the child nodes
//   leaf: value mask (64)
//   values: how they are masked (1); at most two values and a mask of those that are inactive; then values, all of them or
//           those of the value mask, as one block
//   block: as it is; or, with Zip or Blosc, its size (8) and bytes; the size is negative where they are not compressed
#include "io/vdb/tree_walk.h"
#include "util/shown_text.h"

#include "io/vdb/archive.h"
#include "vdb_nns/error.h"

#include <algorithm>
#include <array>
#include <iterator>
#include <utility>

namespace vdb_nns {

namespace {

constexpr std::size_t kLeafVoxels = 512, kLeafMaskBytes = kLeafVoxels / 8;
constexpr std::int32_t kRootChildEdge = 4096; // voxels

// How the values of a node are masked.
enum Masking : std::uint8_t {
    kNoMaskOrValues = 0, // inactive values are the background
    kNoMaskMinusBackground = 1,
    kNoMaskOneValue = 2,
    kMaskNoValues = 3,
    kMaskOneValue = 4,
    kMaskTwoValues = 5,
    kAllValues = 6
};

struct WalkedTree {
    VdbCursor& cursor;
    const VdbVoxelType& voxels;
    std::uint32_t compression;
    std::vector<Vec3i> leaves;
};

std::size_t countBits(const std::uint64_t* mask, std::size_t words)
{
    std::size_t bits = 0;
    for (std::size_t w = 0; w < words; ++w) bits += static_cast<std::size_t>(__builtin_popcountll(mask[w]));
    return bits;
}

void skipBlock(WalkedTree& tree, std::uint64_t bytes)
{
    VdbCursor& cursor = tree.cursor;
    if (!(tree.compression & (kVdbZip | kVdbBlosc))) return cursor.skip(bytes, "the values of a node");
    const std::uint64_t at = cursor.position();
    const auto stored = cursor.number<std::int64_t>("the size of the values of a node");
    if (stored > 0) return cursor.skip(static_cast<std::uint64_t>(stored), "the values of a node");
    if (std::uint64_t(0) - static_cast<std::uint64_t>(stored) != bytes)
        cursor.fail("a block of " + std::to_string(bytes) + " bytes, not of " +
                        std::to_string(std::uint64_t(0) - static_cast<std::uint64_t>(stored)) + ",",
                    at);
    cursor.skip(bytes, "the values of a node");
}

// Values of a node with so many of them, `active` of which are in its value mask.
void skipValues(WalkedTree& tree, std::size_t count, std::size_t active)
{
    VdbCursor& cursor = tree.cursor;
    const auto masking = cursor.number<std::uint8_t>("how a node is masked");
    if (masking > kAllValues)
        cursor.fail("a number from 0 to 6 (how a node is masked), not " + std::to_string(masking) + ",",
                    cursor.position() - 1);
    const bool hasOne = masking == kNoMaskOneValue || masking == kMaskOneValue;
    const std::size_t inactiveValues = hasOne ? 1 : masking == kMaskTwoValues ? 2 : 0;
    cursor.skip(inactiveValues * tree.voxels.bytes, "the inactive values of a node");
    if (masking == kMaskNoValues || masking == kMaskOneValue || masking == kMaskTwoValues)
        cursor.skip(count / 8, "the mask of a node");
    const bool isMasked = (tree.compression & kVdbActiveMask) && masking != kAllValues;
    const std::size_t stored = isMasked ? active : count;
    if (stored == 0 && tree.voxels.isHalf) return; // not even a size
    skipBlock(tree, stored * tree.voxels.storedBytes);
}

template <int kLog2Edge, int kLog2ChildEdge>
void walkNode(WalkedTree& tree, const Vec3i& origin)
{
    constexpr std::size_t kChildren = std::size_t(1) << (3 * kLog2Edge), kWords = kChildren / 64;
    constexpr int kMask = (1 << kLog2Edge) - 1;
    std::array<std::uint64_t, kWords> children, values;
    std::memcpy(children.data(), tree.cursor.take(kChildren / 8, "the child mask of a node"), kChildren / 8);
    std::memcpy(values.data(), tree.cursor.take(kChildren / 8, "the value mask of a node"), kChildren / 8);
    skipValues(tree, kChildren, countBits(values.data(), kWords));
    for (std::size_t w = 0; w < kWords; ++w) {
        for (std::uint64_t bits = children[w]; bits != 0; bits &= bits - 1) {
            const int n = static_cast<int>(w) * 64 + __builtin_ctzll(bits);
            const Vec3i child{origin[0] + ((n >> 2 * kLog2Edge) << kLog2ChildEdge),
                              origin[1] + ((n >> kLog2Edge & kMask) << kLog2ChildEdge),
                              origin[2] + ((n & kMask) << kLog2ChildEdge)};
            if constexpr (kLog2ChildEdge == 3) {
                tree.cursor.skip(kLeafMaskBytes, "the value mask of a leaf");
                tree.leaves.push_back(child);
            } else {
                walkNode<kLog2Edge - 1, 3>(tree, child);
            }
        }
    }
}

void skipVolumeLeaf(WalkedTree& tree, const std::string& valueType)
{
    VdbCursor& cursor = tree.cursor;
    std::uint64_t active[kLeafMaskBytes / 8];
    std::memcpy(active, cursor.take(kLeafMaskBytes, "the value mask of a leaf"), kLeafMaskBytes);
    if (valueType == "bool") {
        cursor.skip(3 * 4 + kLeafMaskBytes, "the origin and values of a leaf");
    } else if (valueType == "mask") {
        cursor.skip(3 * 4, "the origin of a leaf");
    } else {
        skipValues(tree, kLeafVoxels, countBits(active, kLeafMaskBytes / 8));
    }
}

struct VolumeType {
    const char* name;
    std::size_t bytes, components; // components of real values, 0 for others
};
constexpr VolumeType kVolumeTypes[] = {{"bool", 1, 0},   {"mask", 1, 0},   {"float", 4, 1},
                                       {"double", 8, 1}, {"int32", 4, 0},  {"int64", 8, 0},
                                       {"vec3s", 12, 3}, {"vec3d", 24, 3}, {"vec3i", 12, 0}};

} // namespace

std::vector<Vec3i> readTopology(VdbCursor& cursor, const VdbVoxelType& voxels, std::uint32_t compression)
{
    WalkedTree tree{cursor, voxels, compression, {}};
    if (cursor.number<std::int32_t>("the number of buffers") != 1)
        cursor.fail("1 as the number of buffers of a leaf", cursor.position() - 4);
    cursor.skip(voxels.bytes, "the background value");
    const auto tiles = cursor.number<std::uint32_t>("the number of tiles");
    const auto children = cursor.number<std::uint32_t>("the number of nodes");
    cursor.skip(tiles * (3 * 4 + std::uint64_t(voxels.bytes) + 1), "the tiles of the root");
    struct Child {
        Vec3i origin;
        std::size_t firstLeaf, endLeaf;
    };
    std::vector<Child> found;
    bool isSorted = true;
    for (std::uint32_t left = children; left > 0; --left) {
        const std::uint64_t at = cursor.position();
        Child child{};
        for (std::int32_t& x : child.origin) {
            x = cursor.number<std::int32_t>("the origin of a node");
            if (x % kRootChildEdge != 0)
                cursor.fail("the origin of a node, a multiple of 4096, not " + std::to_string(x) + ",", at);
        }
        child.firstLeaf = tree.leaves.size();
        walkNode<5, 7>(tree, child.origin);
        child.endLeaf = tree.leaves.size();
        isSorted &= found.empty() || found.back().origin < child.origin;
        found.push_back(child);
    }
    if (isSorted) return std::move(tree.leaves);
    std::sort(found.begin(), found.end(), [](const Child& a, const Child& b) { return a.origin < b.origin; });
    std::vector<Vec3i> sorted;
    sorted.reserve(tree.leaves.size());
    for (std::size_t i = 0; i < found.size(); ++i) {
        if (i > 0 && found[i].origin == found[i - 1].origin)
            cursor.fail("nodes of different origins before it, not two at one place,");
        sorted.insert(sorted.end(), tree.leaves.begin() + static_cast<std::ptrdiff_t>(found[i].firstLeaf),
                      tree.leaves.begin() + static_cast<std::ptrdiff_t>(found[i].endLeaf));
    }
    return sorted;
}

void skipVolume(VdbCursor& cursor, const std::string& gridType, bool savesHalf, std::uint32_t compression)
{
    const auto* const known =
        std::find_if(std::begin(kVolumeTypes), std::end(kVolumeTypes), [&](const VolumeType& type) {
            return gridType == std::string("Tree_") + type.name + "_5_4_3";
        });
    if (known == std::end(kVolumeTypes)) {
        throw InputError(cursor.file().name() + ": " + cursor.part() + ": has type " + escapedText(gridType) +
                         ", which is not read, and a stream does not say where it ends (it begins at byte " +
                         std::to_string(cursor.position()) +
                         "); write the file with offsets, as openvdb::io::File does");
    }
    VdbVoxelType voxels{known->bytes, known->bytes, savesHalf && known->components > 0};
    if (voxels.isHalf) voxels.storedBytes = 2 * known->components;
    WalkedTree tree{cursor, voxels, compression, {}};
    for (std::size_t left = readTopology(cursor, voxels, compression).size(); left > 0; --left)
        skipVolumeLeaf(tree, known->name);
}

} // namespace vdb_nns
