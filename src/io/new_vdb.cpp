// Positions of any kind into a new .vdb: which voxel each one is in, and what is lost when its place there becomes a float.
#include "io/output_file.h"
#include "io/value_names.h"
#include "io/vdb/grid_writer.h"
#include "io/voxel_choice.h"
#include "io/world_positions.h"
#include "points/grid_positions.h"
#include "points/value_check.h"
#include "util/cancel.h"
#include "util/isolate.h"
#include "vdb_nns/error.h"
#include "vdb_nns/write_points.h"

#include <oneapi/tbb/blocked_range.h>
#include <oneapi/tbb/parallel_reduce.h>

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <cstdio>
#include <limits>
#include <string>
#include <vector>

namespace vdb_nns {

namespace {

constexpr std::size_t kTask = 16384;

// A coordinate in the file: edge * (voxel + offset), in real arithmetic.
struct VoxelCoordinate {
    double voxel, rest; // rest: of the coordinate, from the voxel's centre, in world units
    float offset;       // the same in voxels
};

VoxelCoordinate voxelCoordinate(double x, double edge)
{
    VoxelCoordinate result;
    result.voxel = std::floor(x / edge + 0.5);
    result.rest = std::fma(-result.voxel, edge, x); // one rounding, of a number below the edge
    // The quotient was rounded, which far from the origin may lead to the next voxel.
    if (std::fabs(result.rest) > edge / 2) {
        result.voxel += result.rest > 0 ? 1 : -1;
        result.rest = std::fma(-result.voxel, edge, x);
    }
    result.offset = static_cast<float>(result.rest / edge);
    return result;
}

class VoxelPositions final : public GridPositions {
public:
    VoxelPositions(const WorldPositions& positions, bool areFinite, double edge, const CancelCheck& cancel)
        : mPositions(positions), mAreFinite(areFinite), mEdge(edge)
    {
        if (areFinite) return;
        double xyz[3];
        for (std::size_t i = 0; i < positions.size(); ++i) {
            if (i % kTask == 0) cancel.check();
            positions.read(i, 1, xyz);
            if (isFinite(xyz)) mFinite.push_back(static_cast<std::uint32_t>(i));
        }
    }

    std::size_t size() const override { return mAreFinite ? mPositions.size() : mFinite.size(); }

    std::uint32_t number(std::size_t i) const override
    {
        return mAreFinite ? static_cast<std::uint32_t>(i) : mFinite[i];
    }

    VoxelPosition at(std::size_t i) const override
    {
        double xyz[3];
        mPositions.read(number(i), 1, xyz);
        VoxelPosition result;
        for (std::size_t k = 0; k < 3; ++k) {
            const VoxelCoordinate c = voxelCoordinate(xyz[k], mEdge);
            result.voxel[k] = static_cast<std::int32_t>(c.voxel);
            result.offset[k] = c.offset;
        }
        return result;
    }

    double largestRounding(const CancelCheck& cancel) const
    {
        return mEdge * std::sqrt(tbb::parallel_reduce(
                           tbb::blocked_range<std::size_t>(0, size(), kTask), 0.0,
                           [&](const tbb::blocked_range<std::size_t>& range, double largest) {
                               cancel.check();
                               for (std::size_t i = range.begin(); i < range.end(); ++i)
                                   largest = std::max(largest, squaredRounding(i));
                               return largest;
                           },
                           [](double a, double b) { return std::max(a, b); }));
    }

private:
    // Square of the rounding of a position, in voxels; above 0 where there is any.
    double squaredRounding(std::size_t i) const
    {
        double xyz[3], error[3];
        mPositions.read(number(i), 1, xyz);
        for (std::size_t k = 0; k < 3; ++k) {
            const VoxelCoordinate c = voxelCoordinate(xyz[k], mEdge);
            error[k] = std::fma(mEdge, static_cast<double>(c.offset), -c.rest);
        }
        if (error[0] == 0 && error[1] == 0 && error[2] == 0) return 0;
        double sum = std::numeric_limits<double>::min();
        for (const double e : error) sum += (e / mEdge) * (e / mEdge);
        return sum;
    }

    const WorldPositions& mPositions;
    const bool mAreFinite;
    const double mEdge;
    std::vector<std::uint32_t> mFinite; // those that are, if not all
};

std::string shortText(double value)
{
    char text[32];
    std::snprintf(text, sizeof text, "%.6g", value);
    return text;
}

void checkExtent(const std::string& path, const PositionFacts& facts, double edge)
{
    const double least = leastVoxelSize(facts);
    if (edge >= least) return;
    const auto corner = [](const Vec3d& p) {
        return "(" + shortText(p[0]) + ", " + shortText(p[1]) + ", " + shortText(p[2]) + ")";
    };
    throw InputError(path + ": the positions reach from " + corner(facts.min) + " to " + corner(facts.max) +
                     ", which with voxels of " + shortText(edge) + " passes the coordinate " +
                     std::to_string(static_cast<std::int64_t>(kMostVoxels)) +
                     " that a voxel of a .vdb can have here; give a --voxel-size of at least " +
                     shortText(least * 1.00001));
}

void checkVoxelSize(const std::string& path, double edge)
{
    if (!(edge >= 0) || !std::isfinite(edge))
        throw InvalidInput(path + ": a voxel size of " + shortText(edge) +
                           " is none; give a positive, finite number of world units, or 0 to have it chosen");
}

} // namespace

void checkNewVdb(const std::string& path, const ParticleView& view, const NewGridOptions& options,
                 Progress* progress)
{
    checkVoxelSize(path, options.voxelSize);
    if (options.voxelSize == 0) return; // what is chosen holds all of them
    isolatedIeee([&] {
        const CancelCheck cancel(progress, "read");
        checkExtent(path, WorldPositions(view).measure(cancel), options.voxelSize);
    });
}

WrittenPoints writeNewVdb(const std::string& path, const ParticleView& view, const PointValues& values,
                          const NewGridOptions& options, const OutputOptions& output, Progress* progress)
{
    return isolatedIeee([&] {
        const CancelCheck cancel(progress, "write");
        cancel.update(0);
        checkVoxelSize(path, options.voxelSize);
        checkValues(path + ": ", values, view.size());
        ValueNames(PointFormat::kVdb, options.id).addAll(path, values);
        const WorldPositions positions(view);
        const PositionFacts facts = positions.measure(cancel);
        WrittenPoints written;
        written.voxelSize =
            options.voxelSize > 0 ? options.voxelSize : chooseVoxelSize(positions, facts, cancel);
        checkExtent(path, facts, written.voxelSize);
        OutputFile file(path, output);
        const VoxelPositions points(positions, facts.nonfinite == 0, written.voxelSize, cancel);
        written.points = points.size();
        written.skipped = facts.nonfinite;
        written.largestRounding = facts.largestRounding + points.largestRounding(cancel);
        NewGrid grid{points};
        grid.name = options.name;
        grid.voxelSize = written.voxelSize;
        grid.suggestedRadius = options.suggestedRadius;
        grid.values = values;
        grid.valueCount = view.size();
        grid.numberAttribute = options.id;
        writeNewGrid(file, grid, cancel);
        return written;
    });
}

} // namespace vdb_nns
