#include "io/voxel_choice.h"

#include "util/random.h"

#include <oneapi/tbb/combinable.h>
#include <oneapi/tbb/parallel_for.h>

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <cstdio>
#include <cstdlib>
#include <limits>
#include <vector>

namespace vdb_nns {

namespace {

constexpr double kPointsOfVoxel = 8;
// Coinciding points may not let voxels be that empty; then the voxels may have a twentieth more than the smallest.
constexpr double kMoreThanLeast = 1.05;
// Points whose voxels are counted: 1 / sqrt(of their voxels) is the error, 1 % of the mean.
constexpr std::size_t kSampled = std::size_t(1) << 18;
// Ratio of two edges that are not told apart.
constexpr double kRatio = 1.005;
// A mean that near to the one wanted is as good.
constexpr double kNear = 0.01;
constexpr std::size_t kTask = 16384, kBlock = 512;
constexpr std::uint64_t kFactors[3] = {0x9e3779b97f4a7c15u, 0xc2b2ae3d27d4eb4fu, 0x165667b19e3779f9u};

// The nearest integer; the compiler makes a call of std::floor().
std::uint64_t voxelOf(double coordinate)
{
    const double up = coordinate + 0.5;
    const auto whole = static_cast<std::int64_t>(up);
    return static_cast<std::uint64_t>(whole - (static_cast<double>(whole) > up ? 1 : 0));
}

// Mean number of points of an occupied voxel with that edge. Of many points, those of a share of all voxels are counted,
// which voxels is up to a hash of their coordinates.
double pointsOfVoxel(const WorldPositions& positions, double edge, const CancelCheck& cancel)
{
    const double perEdge = 1 / edge;
    std::uint64_t shareBits = 0; // of one in a power of two of the voxels they are all 0
    while (positions.size() / (shareBits + 1) > kSampled) shareBits = 2 * shareBits + 1;
    tbb::combinable<std::vector<std::uint64_t>> parts;
    tbb::parallel_for(std::size_t(0), (positions.size() + kTask - 1) / kTask, [&](std::size_t task) {
        cancel.check();
        std::vector<std::uint64_t>& voxels = parts.local();
        double xyz[3 * kBlock];
        const std::size_t end = std::min(positions.size(), (task + 1) * kTask);
        for (std::size_t begin = task * kTask; begin < end; begin += kBlock) {
            const std::size_t count = std::min(kBlock, end - begin);
            positions.read(begin, count, xyz);
            for (std::size_t i = 0; i < count; ++i) {
                if (!isFinite(xyz + 3 * i)) continue;
                // Two voxels of one hash are too few to matter.
                const std::uint64_t hash = scenes::mix64(kFactors[0] * voxelOf(xyz[3 * i] * perEdge) +
                                                         kFactors[1] * voxelOf(xyz[3 * i + 1] * perEdge) +
                                                         kFactors[2] * voxelOf(xyz[3 * i + 2] * perEdge));
                if ((hash & shareBits) == 0) voxels.push_back(hash);
            }
        }
    });
    std::vector<std::uint64_t> voxels;
    parts.combine_each([&](const auto& part) { voxels.insert(voxels.end(), part.begin(), part.end()); });
    if (voxels.empty()) return 0;
    std::sort(voxels.begin(), voxels.end());
    const auto distinct = std::unique(voxels.begin(), voxels.end()) - voxels.begin();
    return static_cast<double>(voxels.size()) / static_cast<double>(distinct);
}

// As if the points filled their box.
double guessedEdge(std::size_t points, const PositionFacts& facts)
{
    double edge = std::cbrt(kPointsOfVoxel / static_cast<double>(points));
    for (std::size_t k = 0; k < 3; ++k) edge *= std::cbrt(facts.max[k] - facts.min[k]);
    return edge;
}

// In three decimal digits.
double shortened(double edge)
{
    char text[32];
    std::snprintf(text, sizeof text, "%.2e", edge);
    return std::strtod(text, nullptr);
}

} // namespace

double leastVoxelSize(const PositionFacts& facts)
{
    double farthest = 0;
    for (std::size_t k = 0; k < 3; ++k) {
        if (facts.min[k] > facts.max[k]) return 0;
        farthest = std::max({farthest, std::fabs(facts.min[k]), std::fabs(facts.max[k])});
    }
    return farthest / kMostVoxels;
}

double chooseVoxelSize(const WorldPositions& positions, const PositionFacts& facts, const CancelCheck& cancel)
{
    constexpr double kSmallest = 1e-290; // with which no number below is subnormal
    double extent = 0;
    for (std::size_t k = 0; k < 3; ++k) extent = std::max(extent, facts.max[k] - facts.min[k]);
    extent = std::min(extent, std::numeric_limits<double>::max() / 4);
    // A little more than the least: it is to hold after its digits are cut.
    const double least = std::max(kSmallest, 1.01 * leastVoxelSize(facts));
    if (!(extent > 0)) return shortened(std::max(1.0, least)); // no points, or all at one place
    double low = std::max(least, extent / (2 * kMostVoxels)), high = std::max(extent, 1.01 * low);
    const double target = std::max(kPointsOfVoxel, kMoreThanLeast * pointsOfVoxel(positions, low, cancel));
    double next = guessedEdge(positions.size(), facts);
    for (double step = 2; high > kRatio * low; step *= step) {
        if (next <= low || next >= high)
            next = low < high / 4 ? std::sqrt(low) * std::sqrt(high) : low + (high - low) / 2;
        const double mean = pointsOfVoxel(positions, next, cancel);
        if (std::fabs(mean - target) <= kNear * target) return shortened(std::max(least, next));
        (mean < target ? low : high) = next;
        // Away from the guess until the edge is between two, then by halves.
        next = mean < target ? next * step : next / step;
    }
    return shortened(std::max(least, high));
}

} // namespace vdb_nns
