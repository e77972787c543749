// Reads points of a point grid of a .vdb file, by all threads of the caller's arena: the places of the points, P, and any
// attribute, of any range of leaves.
#pragma once

#include "io/byte_source.h"
#include "io/vdb/point_layout.h"
#include "points/grid_points.h"
#include "util/cancel.h"

#include <cstddef>
#include <cstdint>
#include <string>

namespace vdb_nns {

// Leaves [begin, end) of a layout.
struct VdbLeafRange {
    std::size_t begin, end;
};

// An attribute of points, decoded as OpenVDB does.
struct VdbValues {
    VdbAttributeType type;
    PageBlock bytes; // type.bytes() a value
    std::uint64_t count = 0;
};

// Of one grid of a file. `part` names it in messages.
class VdbPointReader {
public:
    VdbPointReader(const ByteSource& file, const VdbPointLayout& layout, std::string part)
        : mFile(file), mLayout(layout), mPart(std::move(part))
    {
    }

    // Bytes that the points of those leaves take, as the sizes of their arrays say.
    std::uint64_t pointBytes(VdbLeafRange leaves) const;

    // Fills leaves, starts, voxels and positions of `points`; leaves without points are left out.
    // Memory: what it returns, and 2 MB a thread or the largest leaf.
    // @throws InputError for damage, for points without P, and for a P that is not vec3s with codec null, trnc, fxpt16 or fxpt8
    // @throws CapacityError, Cancelled
    void readPoints(VdbLeafRange leaves, const CancelCheck& cancel, GridPoints& points) const;

    // Values of an attribute in the order of the points, whose leaves and starts `points` has. Where a leaf has no such
    // attribute its values are 0.
    // @throws InputError for damage, and where the type is not known, has several values a point, or is not the same in all
    //         leaves
    VdbValues readAttribute(VdbLeafRange leaves, const std::string& name, const GridPoints& points,
                            const CancelCheck& cancel) const;

private:
    class Decoder;

    // `before`: the type in the leaves before.
    void checkAttribute(std::size_t leaf, std::size_t place, const VdbAttributeType& before) const;

    const ByteSource& mFile;
    const VdbPointLayout& mLayout;
    std::string mPart;
};

} // namespace vdb_nns
