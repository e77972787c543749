// The positions that verify searches, with a certified bound of their error, and its own hash of cells over them.
// Shares no grid with the engine: cells are found by hashing triples of 64-bit integers.
#pragma once

#include "exact_pair.h"
#include "vdb_nns/particle_view.h"
#include "vdb_nns/progress.h"

#include <array>
#include <cstdint>
#include <vector>

namespace vdb_nns::cli {

// World positions about a reference, in units of a power of two near the cell edge, so that squares neither overflow nor
// vanish. Non-finite points are NaN.
struct PointCloud {
    std::vector<double> x, y, z;       // by particle number
    std::vector<std::uint32_t> finite; // numbers of the finite points, ascending
    double error = 0;                  // each coordinate is within this of the true one
    double radius = 0;                 // rounded; the true one is within 2^-52 of it relatively
    double edge = 1; // of a cell: two points within the radius lie in the same or in adjacent cells

    // Squared distances of computed positions up to `sureWithin` are neighbors, above `sureBeyond` are not.
    double sureWithin = 0, sureBeyond = 0;
};

// @throws InputError when positions are too large for double arithmetic
PointCloud makeCloud(const ParticleView& view, double radius);

// Squared distances of `count` computed positions from (x, y, z).
inline void squaredDistances(const double* px, const double* py, const double* pz, std::size_t count,
                             double x, double y, double z, double* squares)
{
    for (std::size_t k = 0; k < count; ++k) {
        const double dx = px[k] - x, dy = py[k] - y, dz = pz[k] - z;
        squares[k] = dx * dx + dy * dy + dz * dz;
    }
}

// The exact answer for pairs between the two bounds. Thread-safe.
class PairJudge {
public:
    PairJudge(const ParticleView& view, double radius) : mView(view), mRadius(radius) {}

    bool within(std::uint32_t i, std::uint32_t j) const;
    StoredPoint point(std::uint64_t i) const;
    const Matrix3& linear() const { return mView.linear(); }
    double radius() const { return mRadius; }

private:
    const ParticleView& mView;
    double mRadius;
};

using CellKey = std::array<std::int64_t, 3>;

// Occupied cells in ascending order of their keys; the points of a cell stand together, by number.
class CellHash {
public:
    explicit CellHash(const PointCloud& cloud);
    // Of some points by their coordinates, which are finite, in cells of that edge.
    CellHash(const double* x, const double* y, const double* z, const std::vector<std::uint32_t>& numbers,
             double edge);

    double edge() const { return mEdge; }
    std::size_t size() const { return mKeys.size(); }
    const CellKey& key(std::size_t cell) const { return mKeys[cell]; }
    std::size_t begin(std::size_t cell) const { return mBegin[cell]; }
    std::size_t end(std::size_t cell) const { return mBegin[cell + 1]; }

    static constexpr std::size_t kNone = ~std::size_t(0);
    std::size_t find(const CellKey& key) const; // kNone if no point is there

    // By place in cell order.
    const std::vector<std::uint32_t>& numbers() const { return mNumbers; }

private:
    void hashKeys();

    double mEdge;
    std::vector<CellKey> mKeys;
    std::vector<std::size_t> mBegin;
    std::vector<std::uint32_t> mNumbers;
    std::vector<std::uint32_t> mTable; // cell + 1, or 0; linear probing, a power of two of places
};

} // namespace vdb_nns::cli
