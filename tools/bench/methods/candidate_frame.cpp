#include "bench/methods/candidate_frame.h"

#include <tbb/blocked_range.h>
#include <tbb/parallel_reduce.h>

#include <algorithm>
#include <limits>
#include <stdexcept>

namespace vdb_nns::cli {
namespace {

// Voxels that are cells have the cells' size but for roundings.
bool voxelsFit(const SparseGrid& grid)
{
    const Matrix3& m = grid.view().linear();
    for (int k = 0; k < 3; ++k) {
        for (int c = 0; c < 3; ++c) {
            const double edge = k == c ? grid.cellSize() : 0;
            if (!(std::fabs(std::fabs(m[k][c]) - edge) <= 1e-11 * edge)) return false;
        }
    }
    return true;
}

// Where cell 0 may begin on each axis.
struct OriginRange {
    double low[3], high[3];
};

} // namespace

CellFrame::CellFrame(const SparseGrid& grid)
{
    const double cellsPerUnit = 1 / grid.cellSize();
    for (int k = 0; k < 3; ++k) {
        for (int c = 0; c < 3; ++c) mMatrix[k][c] = grid.view().linear()[k][c] * cellsPerUnit;
    }
    if (grid.empty() || !voxelsFit(grid)) return;
    mVoxelsAreCells = true;
    mVoxelsAreCells = placeOf(grid.view().stored(grid.particleNumbers()[0]), grid.leaf(0).origin).inside;
}

void CellFrame::fit(const SparseGrid& grid)
{
    mVoxelsAreCells = false;
    const ParticleView& view = grid.view();
    const Span<const std::uint32_t> numbers = grid.particleNumbers();
    const StoredPosition first = view.stored(numbers[0]);
    std::copy(first.voxel, first.voxel + 3, mReference);
    constexpr double kInfinity = std::numeric_limits<double>::infinity();
    OriginRange all;
    std::fill_n(all.low, 3, -kInfinity);
    std::fill_n(all.high, 3, kInfinity);
    all = tbb::parallel_reduce(
        tbb::blocked_range<std::uint64_t>(0, grid.leafCount()), all,
        [&](const tbb::blocked_range<std::uint64_t>& range, OriginRange found) {
            for (std::uint64_t l = range.begin(); l < range.end(); ++l) {
                const SparseGrid::Leaf leaf = grid.leaf(l);
                for (std::uint64_t s = leaf.firstSlot; s < leaf.firstSlot + leaf.particleCount; ++s) {
                    const StoredPosition stored = view.stored(numbers[s]);
                    for (int k = 0; k < 3; ++k) {
                        const double at = coordinate(stored, k) - leaf.origin[k];
                        found.low[k] = std::max(found.low[k], at - 8);
                        found.high[k] = std::min(found.high[k], at);
                    }
                }
            }
            return found;
        },
        [](OriginRange a, const OriginRange& b) {
            for (int k = 0; k < 3; ++k) {
                a.low[k] = std::max(a.low[k], b.low[k]);
                a.high[k] = std::min(a.high[k], b.high[k]);
            }
            return a;
        });
    for (int k = 0; k < 3; ++k) {
        if (!(all.low[k] <= all.high[k] + kSlack)) {
            throw std::logic_error("bench: the cells of the grid cannot be found from its leaves");
        }
        mShift[k] = all.low[k] + (all.high[k] - all.low[k]) / 2;
    }
}

// Each coordinate is the sum of three products of a rounded factor, less two numbers: fewer than 8 roundings of
// u = 2^-53 of the terms' magnitudes. Voxels that are cells may be longer on one axis than on another by 1e-11 of at
// most 16 cells, where cells in reach are.
double CellFrame::error(const Vec3d& most) const
{
    if (mVoxelsAreCells) return 2e-10;
    double largest = 0;
    for (int k = 0; k < 3; ++k) {
        double terms = std::fabs(mShift[k]);
        for (int c = 0; c < 3; ++c) terms += std::fabs(mMatrix[k][c]) * most[static_cast<std::size_t>(c)];
        largest = std::max(largest, terms);
    }
    return 0x1p-50 * largest;
}

} // namespace vdb_nns::cli
