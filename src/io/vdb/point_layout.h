// Where the parts of a point grid lie in a .vdb file: found by a walk over its topology, sizes and descriptors, before any
// point is read. After it, any range of leaves and any attribute can be read by itself.
#pragma once

#include "io/vdb/attribute_type.h"
#include "io/vdb/cursor.h"
#include "vdb_nns/types.h"

#include <cstddef>
#include <cstdint>
#include <map>
#include <string>
#include <vector>

namespace vdb_nns {

// The attributes of a leaf, in the order of their arrays.
struct VdbDescriptor {
    struct Attribute {
        std::string name, valueType, codec;
        VdbAttributeType type;
    };
    std::vector<Attribute> attributes;
    std::map<std::string, std::uint64_t> groups; // bit 8 k + b: bit b of the k-th attribute with codec grp
    std::map<std::uint32_t, std::string>
        texts; // of string attributes, by the numbers that they hold; 0 is the empty text

    static constexpr std::size_t kNone = ~std::size_t(0);
    std::size_t find(const std::string& name) const; // kNone where there is none
};

// One attribute of one leaf.
struct VdbArray {
    std::uint64_t bytes = 0;  // decompressed, of a page; else as they are in the file
    std::uint32_t size = 0;   // points
    std::uint32_t stride = 1; // values a point; of arrays with a varying stride, all values
    bool isUniform = false;   // one value for all
    bool isPaged = false;     // in a page together with those of other leaves
    bool hasConstantStride = true;

    std::uint64_t values() const
    {
        return isUniform ? 1 : hasConstantStride ? std::uint64_t(size) * stride : stride;
    }
};

// Arrays at one place of an attribute that are stored together: a page, or a run of arrays that are not paged.
struct VdbPiece {
    std::uint64_t position = 0;    // in the file
    std::uint64_t storedBytes = 0; // there
    std::uint64_t pageBytes = 0;   // of a page, decompressed; 0: a run
    bool isCompressed = false;
    std::size_t firstLeaf = 0,
                endLeaf = 0; // a page has the paged arrays among them, a run those that are not

    bool isPage() const { return pageBytes > 0; }
};

struct VdbPointLayout {
    std::vector<Vec3i> leaves; // origins, in the order of cbeginLeaf()
    // Of each leaf, and one more at the end: where its voxel offsets begin.
    std::vector<std::uint64_t> voxelsBegin;
    std::vector<VdbDescriptor> descriptors;
    std::vector<std::uint32_t> descriptorOf;   // of each leaf
    std::vector<VdbArray> arrays;              // of all leaves
    std::vector<std::uint64_t> firstArray;     // of each leaf, and one more at the end
    std::vector<std::vector<VdbPiece>> pieces; // of the arrays that are first, second, ... of their leaf
    std::uint64_t end = 0;                     // byte behind the grid

    const VdbDescriptor& descriptor(std::size_t leaf) const { return descriptors[descriptorOf[leaf]]; }
    const VdbArray& array(std::size_t leaf, std::size_t place) const
    {
        return arrays[firstArray[leaf] + place];
    }
    std::size_t arrayCount(std::size_t leaf) const
    {
        return static_cast<std::size_t>(firstArray[leaf + 1] - firstArray[leaf]);
    }
};

// LZ4, which OpenVDB has Blosc use, makes at most 255 bytes of one: what claims more is damaged, and is not allocated.
constexpr std::uint64_t kMostExpansion = 256;

// Reads the layout of a grid, from its tree on.
// Cost: one read of topology and sizes. Memory: 36 bytes a leaf and 24 an array, whose headers take 14 bytes of the file
// and a leaf 64.
// @throws InputError
VdbPointLayout readPointLayout(VdbCursor& cursor, std::uint32_t compression);

} // namespace vdb_nns
