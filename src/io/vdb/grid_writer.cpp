#include "io/vdb/grid_writer.h"

#include "io/output_file.h"
#include "io/vdb/seekable_archive.h"
#include "points/point_grid.h"
#include "util/memory.h"
#include "vdb_nns/error.h"

#include <openvdb/openvdb.h>

#include <algorithm>
#include <limits>
#include <memory>
#include <ostream>
#include <sstream>
#include <vector>

namespace vdb_nns {

namespace {

using openvdb::points::PointDataGrid;

// Shares of the work, for progress only.
constexpr double kGridShare = 0.4, kValuesShare = 0.6;

// The numbers as an attribute; `wide` keeps those of 64 bits.
PointAttribute numberAttribute(const NewGrid& content, const PageArray<std::uint32_t>& numbers,
                               std::vector<std::int64_t>& wide)
{
    if (content.valueCount <= static_cast<std::uint64_t>(std::numeric_limits<std::int32_t>::max()))
        return viewAttribute(content.numberAttribute, AttributeType::kInt32, numbers.data(), numbers.size());
    wide.assign(numbers.begin(), numbers.end());
    return viewAttribute(content.numberAttribute, AttributeType::kInt64, wide.data(), wide.size());
}

// What createLinearTransform() makes. That refuses edges below 1.4e-5, whose cube it takes for 0; a map that is read, as from a
// file, may have any.
openvdb::math::Transform::Ptr linearTransform(double edge)
{
    const openvdb::Vec3d scale(edge), inverse = 1.0 / scale;
    std::stringstream values;
    for (const openvdb::Vec3d& value : {scale, scale, inverse, inverse * inverse, inverse / 2.0})
        value.write(values);
    const auto map = std::make_shared<openvdb::math::UniformScaleMap>();
    map->read(values);
    return std::make_shared<openvdb::math::Transform>(map);
}

PointDataGrid::Ptr makeGrid(const NewGrid& content, const CancelCheck& cancel)
{
    PageArray<std::uint32_t> numbers;
    const PointDataGrid::Ptr grid = makePointGrid(content.positions, content.codec, cancel, numbers);
    cancel.update(kGridShare);
    grid->setName(content.name);
    if (!content.numberAttribute.empty()) {
        std::vector<std::int64_t> wide;
        const PointAttribute attribute = numberAttribute(content, numbers, wide);
        addPointValues(*grid, {{attribute}, {}}, false, nullptr, 0, cancel);
    }
    addPointValues(*grid, content.values, false, numbers.data(), content.valueCount, cancel);
    cancel.update(kValuesShare);
    grid->setTransform(linearTransform(content.voxelSize));
    if (content.suggestedRadius)
        grid->insertMeta("suggested_radius", openvdb::DoubleMetadata(*content.suggestedRadius));
    return grid;
}

} // namespace

void writeNewGrid(OutputFile& file, const NewGrid& content, const CancelCheck& cancel)
{
    openvdb::initialize();
    cancel.check();
    const PointDataGrid::Ptr grid = makeGrid(content, cancel);
    const double expectedBytes = 1 + static_cast<double>(grid->memUsage());
    OutputStreamBuffer buffer(file, [&](std::uint64_t written) {
        const double share = std::min(0.99, static_cast<double>(written) / expectedBytes);
        cancel.update(kValuesShare + (1 - kValuesShare) * share);
    });
    std::ostream stream(&buffer);
    stream.exceptions(std::ios::badbit | std::ios::failbit);
    try {
        SeekableArchive().writeTo(stream, {grid});
        stream.flush();
    } catch (const openvdb::Exception& error) {
        throw OutputError(file.path() + ": OpenVDB cannot write it: " + error.what());
    }
    cancel.update(1);
    file.commit();
}

} // namespace vdb_nns
