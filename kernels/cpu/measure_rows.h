// What the kernels of measures take: positions of particles by number, and batches of rows of neighbors, spread out pair by pair.
// Plain data between src/measure and measure_rows-inl.h, which is compiled once for each instruction set.
//
//   row of query 0         row of query 1         ...       each begins at a multiple of kPairPad; pairs behind its last
//   [pair pair ... pad]    [pair pad pad ...]               one, up to the next row, repeat its distance, with a weight of 0
//
// Sums over a row do not depend on the order of its pairs, nor on the instruction set: they are sums of integers. The largest
// magnitude of a row's terms is below 2^e; each term is multiplied by 2^(b-e) and rounded to the nearest integer, with b = 50, or
// less so that 2^b times the number of pairs stays below 2^62. So each has an error of at most 2^(e-b-1), and the sum is rounded
// once more where it passes 2^53.
#pragma once

#include <cstddef>
#include <cstdint>

namespace vdb_nns {

constexpr std::size_t kPairPad = 8; // the most lanes that a vector of doubles has

// How positions of particles stand in memory, by number: what PairDistance takes the difference of.
enum class PositionRecord : std::uint8_t {
    kFloats,    // FloatPosition
    kDoubles,   // DoublePosition
    kVoxels,    // VoxelPosition10
    kWideVoxels // WideVoxelPosition
};
constexpr int kPositionRecords = 4;

struct FloatPosition {
    float x, y, z, zero;
};
struct DoublePosition {
    double x, y, z, zero;
};
// A voxel modulo 1024 and the offset in it. The difference of two voxels is between -512 and 511.
struct VoxelPosition10 {
    float x, y, z;
    std::uint32_t voxel; // x << 22 | y << 12 | z << 2

    static std::uint32_t pack(std::int64_t x, std::int64_t y, std::int64_t z)
    {
        return static_cast<std::uint32_t>(x & 1023) << 22 | static_cast<std::uint32_t>(y & 1023) << 12 |
               static_cast<std::uint32_t>(z & 1023) << 2;
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

// For each of `count` candidates, at least one, and for the pads behind them: candidate less query, the voxel difference, exact,
// plus the difference of the offsets in double, then the map; and the distance, sqrt((x x + y y) + z z). Vectors are not written
// where `x` is null.
using PairsFunction = void (*)(const void* query, const void* candidates, const PairMap& map,
                               const std::uint32_t* numbers, std::uint32_t count, double* x, double* y,
                               double* z, double* distance);

// Vectors of so many candidates, a multiple of kPairPad, from FloatPosition or DoublePosition.
using VectorsFunction = void (*)(const void* values, const std::uint32_t* numbers, std::size_t count,
                                 double* x, double* y, double* z);
// Numbers likewise, from float or double.
using ScalarsFunction = void (*)(const void* values, const std::uint32_t* numbers, std::size_t count,
                                 double* out);

// Weights by q = min(distance / radius, 1), 1 at 0: SmoothingKernel without its constant, and that of points::pca.
enum class PairWeight : std::uint8_t { kCubic, kWendland2, kPoly6, kTophat, kPca };

// Writes the weights of the pairs of a row, 0 to pads, and returns their sum. `inverse`: of the radius of each pair; where
// `inverseStep` is 0, of all. `greatest`: a power of two that no weight passes, for the scale of the sum; 0: the row's own.
using WeightsFunction = double (*)(PairWeight weight, std::uint32_t pairs, const double* distance,
                                   const double* inverse, std::size_t inverseStep, double greatest,
                                   double* out);

// The sum of the distances of a row, and the least.
struct RowDistances {
    double sum, least;
};
using RowDistancesFunction = RowDistances (*)(std::uint32_t pairs, const double* distance);

struct PairRows {
    const std::uint32_t* begin; // first pair
    const std::uint32_t* count; // pairs, without pads
    std::size_t rows;
};

// Sums take pads for pairs: their weight has to be 0.
//
// For each row sum(weight factor), or sum(weight) where there is no factor.
using SumsFunction = void (*)(const PairRows& rows, const double* weight, const double* factor, double* out);

// For each row the three sums of weight times x, y and z, one after the other, at one scale.
using VectorSumsFunction = void (*)(const PairRows& rows, const double* weight, const double* x,
                                    const double* y, const double* z, double* out);

// For each row sum(weight (v - c) (v - c)^T), c its `centers`, three numbers each: xx, yy, zz, xy, xz, yz.
using MomentSumsFunction = void (*)(const PairRows& rows, const double* weight, const double* x,
                                    const double* y, const double* z, const double* centers, double* out);

// Eigenvalues and eigenvectors of symmetric matrices, as six sweeps of cyclic Jacobi rotations leave them, unordered.
// `matrices`: as MomentSumsFunction writes them. `out`: for each three values, then the x of the three vectors, their y, their z.
// Arrays of a multiple of kPairPad matrices.
using EigenFunction = void (*)(const double* matrices, std::size_t count, double* out);
constexpr std::size_t kEigenNumbers = 12;

struct MeasureKernels {
    PairsFunction pairs[kPositionRecords];
    VectorsFunction vectors[2]; // of floats, of doubles
    ScalarsFunction scalars[2];
    WeightsFunction weights;
    RowDistancesFunction rowDistances;
    SumsFunction sums;
    VectorSumsFunction vectorSums;
    MomentSumsFunction momentSums;
    EigenFunction eigen;
};

} // namespace vdb_nns
