// What the kernels of measures take: positions of particles by number, and batches of rows of neighbors, spread out pair by pair.
// Plain data between src/measure and measure_rows-inl.h, which is compiled once for each instruction set.
//
// Pairs stand in groups of eight, which no loop has to leave early: loops over single rows, whose lengths vary, would be predicted
// wrong once a row. What is of a row is looked up for each group.
//
//   row of query 0                  row of query 1                    pads behind the last pair of a row repeat its number;
//   [8 pairs] [3 pairs, 5 pads]     [8 pairs] [8 pairs] [1, 7 pads]   weights are 0 there
//
// Sums over a row do not depend on the order of its pairs, nor on the instruction set: they are sums of integers. The largest
// magnitude of a row's terms is below 2^e, or that is known of them before they are made, and a rounding may pass it; each term is
// multiplied by 2^(b-e) and rounded to the nearest integer, with b = 50, or less so that 2^b times the number of pairs stays below
// 2^62. So each has an error of at most 2^(e-b-1), and the sum is rounded once more where it passes 2^53.
#pragma once

#include <cstddef>
#include <cstdint>

namespace vdb_nns {

constexpr std::size_t kPairPad = 8; // the most lanes that a vector of doubles has

// How positions of particles stand in memory, by number: what PairDistance takes the difference of.
enum class PositionRecord : std::uint8_t {
    kFloats,    // FloatPosition
    kDoubles,   // DoublePosition
    kVoxels,    // VoxelPosition9
    kWideVoxels // WideVoxelPosition
};
constexpr int kPositionRecords = 4;

struct FloatPosition {
    float x, y, z;
    std::uint32_t slot; // in the grid; 0 where nobody wants it, and behind the vectors that are values
};
struct DoublePosition {
    double x, y, z;
    std::uint64_t slot; // likewise
};
// A voxel modulo 512 and the offset in it. The difference of two voxels is between -256 and 255. All three axes are subtracted at once:
// below x and y there is a bit that the next axis may borrow.
struct VoxelPosition9 {
    float x, y, z;
    std::uint32_t voxel; // x << 23 | y << 13 | z << 3

    static constexpr int kBits = 9, kNextAxis = 10;
    static constexpr std::uint32_t kBorrow = 1u << 22 | 1u << 12;
    static std::uint32_t pack(std::int64_t x, std::int64_t y, std::int64_t z)
    {
        return static_cast<std::uint32_t>(x & 511) << 23 | static_cast<std::uint32_t>(y & 511) << 13 |
               static_cast<std::uint32_t>(z & 511) << 3;
    }
    // Of the voxel along an axis, from a candidate's voxel with kBorrow less that of a query.
    static std::int32_t axisOf(std::uint32_t difference, int axis)
    {
        return static_cast<std::int32_t>(difference << kNextAxis * axis) >> (32 - kBits);
    }
};
struct WideVoxelPosition {
    std::int32_t voxel[4];
    float offset[4];
};

// From differences to world space: ((m0 x + m1 y) + m2 z) of each row of a matrix.
struct PairMap {
    enum class Kind : std::uint8_t { kIdentity, kDiagonal, kGeneral } kind;
    double m[3][3];
};

constexpr std::size_t kGroup = kPairPad;

struct PairGroups {
    std::size_t groups, rows;
    const std::uint32_t* numbers;    // of the candidates, kGroup for each group
    const std::uint32_t* row;        // of each group
    const std::uint32_t* pairs;      // of each group, 1 to kGroup
    const std::uint32_t* firstGroup; // of each row, and the end
    const std::uint32_t* query;      // of each row: its number
};

// Where the candidates of pairs stand in the leaf of the queries, `particles` from `firstSlot` on: for each pair a number below that, or, for
// those outside and for pads, one of the kGroup numbers behind them.
struct LeafPlaces {
    std::uint32_t firstSlot, particles;
    std::uint32_t* out; // null: not wanted
};

// For each pair candidate less query, the voxel difference, exact, plus the difference of the offsets in double, then the map; and
// the square of the distance, (x x + y y) + z z. Vectors are not written where `x` is null. Positions are by number. Places are those of
// FloatPosition and DoublePosition, and without vectors.
using PairsFunction = void (*)(const PairGroups& groups, const void* queries, const void* candidates,
                               const PairMap& map, const LeafPlaces& places, double* x, double* y, double* z,
                               double* square);

// Vectors of the candidates, from FloatPosition or DoublePosition.
using VectorsFunction = void (*)(const PairGroups& groups, const void* values, double* x, double* y,
                                 double* z);
// Numbers likewise, from float or double.
using ScalarsFunction = void (*)(const PairGroups& groups, const void* values, double* out);

// Weights by q = min(distance / radius, 1), 1 at 0: SmoothingKernel without its constant, and that of points::pca.
enum class PairWeight : std::uint8_t { kCubic, kWendland2, kPoly6, kTophat, kPca };

// Inverses of the radii: of each pair, or one for all.
struct PairRadii {
    const double* inverse;
    bool areAlike;
};

// What a row's sums are made with: powers of two. Infinite terms have no scale: `scale` is 0, and `inverse` infinite.
struct RowScale {
    double scale, inverse;
};

// Weights, and each row's sum of them at scales known before. `areSquares`, here and below: distances are given by their squares, and
// come in their place; what makes the squares leaves the roots to others, since they would wait there. `scratch`, here and below:
// kGroup numbers for each group and one group more, times the number of sums.
using WeightsFunction = void (*)(PairWeight weight, const PairGroups& groups, double* distance,
                                 bool areSquares, const PairRadii& radii, const RowScale* scales,
                                 std::uint64_t* scratch, double* out, double* sums);

// Scales of terms that are at most `greatest` in each row, or as large as the row's own: the greatest of weight times the largest
// magnitude among the factors, of which there are 0 to 3.
using ScalesFunction = void (*)(const PairGroups& groups, const double* greatest, const double* weight,
                                const double* const* factors, int factorCount, RowScale* out);

// For each row sum(weight), or sum(weight factor) of each factor, one after the other.
using SumsFunction = void (*)(const PairGroups& groups, const RowScale* scales, const double* weight,
                              const double* const* factors, int factorCount, std::uint64_t* scratch,
                              double* out);

// For each row sum(weight (v - c) (v - c)^T), c its `centers`, three numbers each: xx, yy, zz, xy, xz, yz.
using MomentsFunction = void (*)(const PairGroups& groups, const double* weight, const double* x,
                                 const double* y, const double* z, const double* centers, RowScale* scales,
                                 std::uint64_t* scratch, double* out);

// For each row, with weights of kind kPca and differences u in units of the radius: sum(weight), sum(weight u) and
// sum(weight u u^T), which is xx, yy, zz, xy, xz, yz. All terms are at most 1.
using PcaSumsFunction = void (*)(const PairGroups& groups, double* distance, bool areSquares, const double* x,
                                 const double* y, const double* z, const PairRadii& radii,
                                 const RowScale* scales, std::uint64_t* scratch, double* out);
constexpr std::size_t kPcaNumbers = 10;

// For each row the least value; infinity for one without pairs.
using LeastFunction = void (*)(const PairGroups& groups, const double* values, double* out);

// For each row the sum of its distances, whose pads become 0.
using DistanceSumsFunction = void (*)(const PairGroups& groups, double* distance, bool areSquares,
                                      const RowScale* scales, std::uint64_t* scratch, double* out);

// Of a particle of a leaf whose pairs are found once each: sums of integers as above, at one scale for all. `pairs` are those of
// rows of other particles; to each of their terms kShiftBits has been added.
struct alignas(32) ParticleSums {
    std::uint64_t weight, distance;
    double leastSquare; // of a distance
    std::uint32_t pairs;
};

// What is added up.
struct OncePairs {
    PairWeight weight;
    bool wantsWeights, wantsDistances;
    double inverseRadius;
    double weightScale, distanceScale; // below 2^50 a term
};

// Adds each pair to the particle of its row, `sums[firstPlace + row]`, and to its candidate, `sums[places[..]]`. `square`: of distances.
using AddOncePairsFunction = void (*)(const OncePairs& once, const PairGroups& groups,
                                      const std::uint32_t* places, std::uint32_t firstPlace,
                                      const double* square, ParticleSums* sums);

constexpr std::uint64_t kShiftBits = 0x4338000000000000u; // of 1.5 * 2^52

// Principal axes of symmetric matrices, by four sweeps of cyclic Jacobi rotations. `matrices`: their xx, one after the other, their
// yy, zz, xy, xz, yz. `out` likewise: the values, of which none is below 0, in descending order; then the rotation whose columns are the
// vectors, row by row: the largest components of the first two are positive. `count`: a multiple of kAxesPad.
using AxesFunction = void (*)(const double* matrices, std::size_t count, double* out);
constexpr std::size_t kAxesNumbers = 12, kAxesPad = 2 * kPairPad;

// Lengths of the axes of ellipsoids of volume 1, by values as AxesFunction writes them, raised to at least `anisotropy` of the largest; 1
// where that is 0. `out`: the first lengths, the second ones, the third ones.
using StretchesFunction = void (*)(const double* values, std::size_t count, double anisotropy, double* out);

struct MeasureKernels {
    PairsFunction pairs[kPositionRecords];
    VectorsFunction vectors[2]; // of floats, of doubles
    ScalarsFunction scalars[2];
    WeightsFunction weights;
    ScalesFunction scales;
    SumsFunction sums;
    MomentsFunction moments;
    PcaSumsFunction pcaSums;
    LeastFunction least;
    DistanceSumsFunction distanceSums;
    AddOncePairsFunction addOncePairs;
    AxesFunction axes;
    StretchesFunction stretches;
};

} // namespace vdb_nns
