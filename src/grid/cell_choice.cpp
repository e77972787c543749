// How wide cells should be. Wide cells are fewer and give a query more candidates: dense fluids want cells of the radius, or
// half of it; where few cells hold more than a handful of particles, finding and gathering cells and leaves costs more than the
// tests that wider cells add.
//
//   1. A sample of a thousand particles, or at every thousandth: how many leaves they are in. Where those are few for all
//      particles, the scene is dense, and nothing more is looked at.
//   2. Else a sample of cubes: one pass over all particles, which keeps those of some cubes of 6 radii, drawn by a hash of their
//      coordinates, and counts in these what each size would cost.
#include "cpu/kernels.h"
#include "cpu/round_down-inl.h"
#include "grid/cell_map.h"
#include "grid/lattice_choice.h"
#include "grid/leaf_table.h"
#include "points/particle_source.h"

#include <tbb/parallel_for.h>
#include <tbb/task_arena.h>

#include <algorithm>
#include <atomic>
#include <cmath>
#include <cstring>
#include <vector>

namespace vdb_nns {

namespace {

constexpr std::size_t kBatch = CellMap::kBatch;
constexpr std::size_t kOccupancyStride =
    1024; // particles for one of the sample; but so many at least, or one of 256
// Particles that the sample of cubes is to keep at least: so many; or those of so many leaves, where they are full, but not more than a
// share or so many. With so many times as many it has drawn a crowd, whose tests are all that counts.
constexpr double kSampleLeast = 2048, kSampleLeaves = 8, kSampleShare = 1.0 / 32, kSampleMost = 65536;
constexpr double kCrowdDrawn = 16;
constexpr double kLeafCells = 512;

constexpr double kCrowded = 64; // particles a cell: half the radius is no slower and makes masks smaller
constexpr double kDense = 4;    // particles a cell if all cells were full: no look at the cells

// What a search costs: its candidate tests, and for each cell and each leaf the time of so many. Fitted to the times of structure
// and search of 25 scenes in sizes 1, 1.5, 2 and 3, for lists, masks and counts, whose own fits are 1500 to 3500 and 16000 to
// 33000; what is chosen hangs little on them: from 3000 to 4000 and from 10000 to 40000 the same.
constexpr double kCellTests = 3500, kLeafTests = 30000;
constexpr double kSameCost = 1.02;

// A cube of 6 radii, cut into whole cells of every size that may be chosen.
constexpr int kCubeRadii = 6;
constexpr int kUnits = 12; // a cube's edge; every cell's is a whole number of units
struct Size {
    double cellSize; // radii
    int units;
    int side; // cells along the edge of a cube
};
constexpr Size kSizes[] = {{1, 2, 6}, {1.5, 3, 4}, {2, 4, 3}, {3, 6, 2}};
constexpr int kSizeCount = 4;

std::uint64_t hashOf(std::int64_t x, std::int64_t y, std::int64_t z)
{
    // Odd multipliers from the golden ratio and its powers, and the finaliser of SplitMix64 without its first step.
    std::uint64_t h = static_cast<std::uint64_t>(x) * 0x9E3779B97F4A7C15u +
                      static_cast<std::uint64_t>(y) * 0xC2B2AE3D27D4EB4Fu +
                      static_cast<std::uint64_t>(z) * 0x165667B19E3779F9u;
    h = (h ^ (h >> 32)) * 0x94d049bb133111ebu;
    return h ^ (h >> 31);
}

struct OccupancySample {
    double perLeaf = 0; // particles a leaf, at most: of all over the leaves met. 0 where none is in range
    double crowd = 0; // particles in the leaf of the mean particle, by how often two of the sample share one
};

OccupancySample sampleOccupancy(const ParticleSource& source, const CellMap& map)
{
    const std::size_t size = source.size();
    const std::size_t least = std::min(kOccupancyStride, size / 256 + 1);
    const std::size_t sampled = std::min(size, std::max(least, size / kOccupancyStride));
    std::vector<std::uint64_t> leaves; // of each particle met, by hash
    leaves.reserve(sampled);
    double stored[3][kBatch];
    CellMap::Located at;
    for (std::size_t begin = 0; begin < sampled; begin += kBatch) {
        const std::size_t n = std::min(kBatch, sampled - begin);
        for (std::size_t k = 0; k < n; ++k) {
            // One of each of as many equal shares, anywhere in it: no lattice falls in step with that.
            const std::size_t low = size * (begin + k) / sampled, high = size * (begin + k + 1) / sampled;
            const std::size_t i = low + hashOf(static_cast<std::int64_t>(begin + k), 0, 0) % (high - low);
            source.read(i, 1, map.reference, &stored[0][k], &stored[1][k], &stored[2][k]);
        }
        map.locate(stored, n, at);
        for (std::size_t k = 0; k < n; ++k) {
            if (map.inRange(stored[0][k], stored[1][k], stored[2][k]))
                leaves.push_back(hashOf(at.leaf[0][k], at.leaf[1][k], at.leaf[2][k]));
        }
    }
    if (leaves.empty()) return {};
    std::sort(leaves.begin(), leaves.end());
    double different = 0, shared = 0;
    for (std::size_t begin = 0, end; begin < leaves.size(); begin = end, ++different) {
        for (end = begin; end < leaves.size() && leaves[end] == leaves[begin];) ++end;
        shared += static_cast<double>(end - begin) * static_cast<double>(end - begin - 1);
    }
    const double all = static_cast<double>(size), met = static_cast<double>(leaves.size());
    return {all / different, 1 + all * shared / (met * met)};
}

// From positions, less the reference, to cubes: cube n reaches from n to n + 1.
struct CubeMap {
    Vec3d reference;
    double rows[3][3];

    CubeMap(const ParticleSource& source, double radius) : reference(source.reference())
    {
        for (int k = 0; k < 3; ++k) {
            for (int c = 0; c < 3; ++c) rows[k][c] = source.linear()[k][c] / (kCubeRadii * radius);
        }
    }
};

// A particle in a sampled cube.
struct Kept {
    Vec3i cube;
    std::uint16_t place; // in its cube, in units: x << 8 | y << 4 | z
};

// Keeps a particle, unless its cube is out of range.
void keep(const CubeMap& map, double x, double y, double z, std::vector<Kept>& kept)
{
    Kept particle{};
    unsigned place = 0;
    for (int k = 0; k < 3; ++k) {
        const double t = map.rows[k][0] * x + map.rows[k][1] * y + map.rows[k][2] * z;
        if (!(std::fabs(t) < kCellLimit)) return;
        const double cube = roundDown(t); // as in sampleCubes(): at a face both mean the same cube
        const int unit = static_cast<int>((t - cube) * kUnits);
        particle.cube[k] = static_cast<std::int32_t>(cube);
        place = place << 4 | static_cast<unsigned>(std::clamp(unit, 0, kUnits - 1));
    }
    particle.place = static_cast<std::uint16_t>(place);
    kept.push_back(particle);
}

// Which cubes are drawn: one in 2^log2Shares. And when it is enough.
struct Draw {
    int log2Shares = 0;
    std::size_t most = 0; // particles
    std::atomic<std::size_t> drawn{0};

    // For so many particles; `crowd` is what the occupancy sample saw.
    Draw(double size, double crowd)
    {
        const double least =
            std::max(kSampleLeast, std::min({kSampleLeaves * crowd, kSampleShare * size, kSampleMost}));
        while (std::ldexp(size, -log2Shares) > 2 * least) ++log2Shares;
        most = static_cast<std::size_t>(kCrowdDrawn * least);
    }

    bool isCrowd() const { return drawn > most; }
};

// Keeps the particles of cubes that are drawn.
void keepSome(const ParticleSource& source, const CubeMap& map, SampleCubesFunction sampleCubes,
              std::size_t begin, std::size_t end, Draw& draw, std::vector<Kept>& kept,
              const CancelCheck& cancel)
{
    double stored[3][kBatch];
    std::uint8_t drawn[kBatch];
    for (; begin < end && !draw.isCrowd(); begin += kBatch) {
        if (begin / kBatch % 64 == 0) cancel.check();
        const std::size_t n = std::min(kBatch, end - begin), before = kept.size();
        source.read(begin, n, map.reference, stored[0], stored[1], stored[2]);
        sampleCubes(stored[0], stored[1], stored[2], n, map.rows, 0xFFFFFFFFu >> draw.log2Shares, drawn);
        std::fill(drawn + n, drawn + kBatch, 0);
        for (std::size_t i = 0; i < n; i += 8) {
            std::uint64_t any;
            std::memcpy(&any, drawn + i, sizeof any);
            for (; any; any &= any - 1) {
                const std::size_t at = i + static_cast<std::size_t>(__builtin_ctzll(any)) / 8;
                keep(map, stored[0][at], stored[1][at], stored[2][at], kept);
            }
        }
        if (kept.size() > before) draw.drawn += kept.size() - before;
    }
}

// The particles of the sampled cubes, by cube. In the order of the input, for any number of threads.
struct Sample {
    std::vector<std::uint32_t> cubeStart; // of each cube in `places`, and the end
    std::vector<std::uint16_t> places;

    std::size_t cubeCount() const { return cubeStart.size() - 1; } // where there are places
};

Sample groupByCube(const std::vector<std::vector<Kept>>& kept)
{
    LeafTable cubes;
    std::vector<std::uint32_t> cubeOf;
    for (const std::vector<Kept>& part : kept) {
        for (const Kept& particle : part) {
            if (cubeOf.empty() || cubes.leaf(cubeOf.back()) != particle.cube)
                cubeOf.push_back(cubes.numberOf(particle.cube[0], particle.cube[1], particle.cube[2]));
            else
                cubeOf.push_back(cubeOf.back());
            cubes.add(cubeOf.back(), 1);
        }
    }
    Sample sample;
    sample.cubeStart.push_back(0);
    for (std::uint32_t c = 0; c < cubes.size(); ++c)
        sample.cubeStart.push_back(sample.cubeStart.back() + cubes.count(c));
    std::vector<std::uint32_t> next(sample.cubeStart.begin(), sample.cubeStart.end() - 1);
    sample.places.resize(cubeOf.size());
    const std::uint32_t* cube = cubeOf.data();
    for (const std::vector<Kept>& part : kept) {
        for (const Kept& particle : part) sample.places[next[*cube++]++] = particle.place;
    }
    return sample;
}

// None where a crowd is drawn.
Sample sampleCubesOf(const ParticleSource& source, const CubeMap& map, SampleCubesFunction sampleCubes,
                     double crowd, const CancelCheck& cancel)
{
    Draw draw(static_cast<double>(source.size()), crowd);
    const auto parts = 4 * static_cast<std::size_t>(tbb::this_task_arena::max_concurrency());
    std::vector<std::vector<Kept>> kept(parts);
    tbb::parallel_for(std::size_t(0), parts, [&](std::size_t p) {
        keepSome(source, map, sampleCubes, source.size() * p / parts, source.size() * (p + 1) / parts, draw,
                 kept[p], cancel);
    });
    return draw.isCrowd() ? Sample() : groupByCube(kept);
}

// Counts what cells of one size would cost the particles of a sample.
class SizeTrial {
public:
    explicit SizeTrial(const Size& size) : mSize(size), mPadded(size.side + 2)
    {
        int step = mPadded * mPadded;
        for (auto& offsets : mOffset) { // along x, y and z
            for (int u = 0; u < kUnits; ++u) offsets[u] = (u / size.units + 1) * step;
            step /= mPadded;
        }
    }

    // Adds the occupied cells of one cube and the tests of its particles. Along an axis, of the `side` cells of a cube
    // side - 1 have the next cell in the same cube: such pairs of cells count for all.
    void addCube(const std::uint16_t* begin, const std::uint16_t* end)
    {
        constexpr int kMost = 6 + 2;          // with empty cells around
        float sums[4][kMost * kMost * kMost]; // of a cell; with those next to it along z; and along y; and x
        const int count = mPadded * mPadded * mPadded;
        std::fill_n(sums[0], count, 0.0f);
        for (const std::uint16_t* place = begin; place < end; ++place) {
            float& particles = sums[0][cellOf(*place)];
            mCells += particles == 0;
            ++particles;
        }
        const float weight = static_cast<float>(mSize.side) / static_cast<float>(mSize.side - 1);
        for (int k = 0, step = 1; k < 3; ++k, step *= mPadded) {
            const float* const from = sums[k];
            float* const to = sums[k + 1];
            std::fill_n(to, step, 0.0f);
            std::fill_n(to + count - step, step, 0.0f);
            for (int i = step; i < count - step; ++i)
                to[i] = from[i] + weight * (from[i - step] + from[i + step]);
        }
        for (const std::uint16_t* place = begin; place < end; ++place) mTests += sums[3][cellOf(*place)];
    }

    double cells() const { return mCells; }
    double tests() const { return mTests; }

private:
    int cellOf(std::uint16_t place) const
    {
        return mOffset[0][place >> 8] + mOffset[1][place >> 4 & 15] + mOffset[2][place & 15];
    }

    Size mSize;
    int mPadded;
    int mOffset[3][kUnits];
    double mCells = 0, mTests = 0;
};

double cheapestSize(const Sample& sample)
{
    const double cubes = static_cast<double>(sample.cubeCount());
    double cost[kSizeCount], cells[kSizeCount];
    tbb::parallel_for(0, kSizeCount, [&](int s) {
        SizeTrial trial(kSizes[s]);
        const std::uint16_t* const places = sample.places.data();
        for (std::size_t c = 0; c < sample.cubeCount(); ++c)
            trial.addCube(places + sample.cubeStart[c], places + sample.cubeStart[c + 1]);
        cells[s] = trial.cells();
        cost[s] = trial.tests() + kCellTests * cells[s];
    });
    // Leaves are larger than the cubes. They become fewer with their edge as cubes do against cells of 3, half their edge.
    const double power = std::log2(cells[kSizeCount - 1] / cubes);
    for (int s = 0; s < kSizeCount; ++s)
        cost[s] += kLeafTests * cubes * std::pow(8 * kSizes[s].cellSize / kCubeRadii, -power);
    // Where sizes cost the same the widest: leaves become fewer still farther out, as with lone particles far from each other.
    const double enough = kSameCost * *std::min_element(cost, cost + kSizeCount);
    int chosen = kSizeCount - 1;
    while (cost[chosen] > enough) --chosen;
    return kSizes[chosen].cellSize;
}

} // namespace

double chooseCellSize(const ParticleSource& source, double radius, SimdLevel simd, bool mayBeWide,
                      const CancelCheck& cancel)
{
    const OccupancySample occupancy =
        sampleOccupancy(source, CellMap(source, latticeOf(source, radius, {}), simd));
    if (occupancy.perLeaf >= kCrowded * kLeafCells) return 0.5;
    if (!mayBeWide || occupancy.perLeaf == 0 || occupancy.perLeaf >= kDense * kLeafCells) return 1;
    const Sample sample =
        sampleCubesOf(source, CubeMap(source, radius), kernelsFor(simd).sampleCubes, occupancy.crowd, cancel);
    return sample.places.empty() ? 1 : cheapestSize(sample);
}

} // namespace vdb_nns
