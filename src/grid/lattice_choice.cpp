// Which lattices are offered for a radius, and in what order.
#include "grid/lattice_choice.h"

#include "grid/cell_map.h"
#include "grid/file_leaves.h"
#include "vdb_nns/error.h"

#include <tbb/blocked_range.h>
#include <tbb/parallel_reduce.h>

#include <algorithm>
#include <cmath>
#include <optional>

namespace vdb_nns {

namespace {

using Offer = std::function<LatticeFit(const Lattice&)>;

// Offers cells of one size, counted from where they are not too many. What did not fit is told by `lattice`
// and the result.
LatticeFit offerCells(const ParticleSource& source, Lattice& lattice, const Offer& offer)
{
    LatticeFit fit = offer(lattice);
    if (fit.fits || !source.isArray()) return fit;
    const Bounds bounds = boundsOf(source, Vec3d{});
    for (int k = 0; k < 3; ++k) lattice.reference[k] = bounds.low[k] / 2 + bounds.high[k] / 2;
    return offer(lattice);
}

// What one pass over the particles tells.
struct Extent {
    bool inRange = true;
    double mostCells[3] = {0, 0, 0};
};

} // namespace

LatticeFit fitOf(const ParticleSource& source, const Lattice& lattice, SimdLevel simd,
                 const CancelCheck& cancel, const ParticleSource* home)
{
    if (lattice.usesVoxels) return {particlesAreInVoxels(source, cancel), 0};
    constexpr std::size_t kBatch = CellMap::kBatch;
    const CellMap map(source, lattice, simd, home);
    const Extent extent = tbb::parallel_reduce(
        tbb::blocked_range<std::size_t>(0, source.size(), 64 * kBatch), Extent(),
        [&](const tbb::blocked_range<std::size_t>& range, Extent sum) {
            cancel.check();
            double stored[3][kBatch];
            CellMap::Located at;
            for (std::size_t begin = range.begin(); begin < range.end(); begin += kBatch) {
                const std::size_t n = std::min(kBatch, range.end() - begin);
                source.read(begin, n, map.reference, stored[0], stored[1], stored[2]);
                const bool allInRange = map.locate(stored, n, at);
                for (std::size_t i = 0; i < n; ++i) {
                    const double x = stored[0][i], y = stored[1][i], z = stored[2][i];
                    if (!allInRange && !map.inRange(x, y, z)) {
                        if (std::isfinite(x) && std::isfinite(y) && std::isfinite(z)) sum.inRange = false;
                        continue;
                    }
                    for (int k = 0; k < 3; ++k)
                        sum.mostCells[k] = std::max(sum.mostCells[k], mostCellsOf(at.leaf[k][i]));
                }
            }
            return sum;
        },
        [](Extent a, const Extent& b) {
            a.inRange = a.inRange && b.inRange;
            for (int k = 0; k < 3; ++k) a.mostCells[k] = std::max(a.mostCells[k], b.mostCells[k]);
            return a;
        });
    if (!extent.inRange) return {};
    const double error = map.errorCells(extent.mostCells);
    return {error <= kMaxErrorCells, error};
}

void offerLattices(const ParticleSource& source, double radius, const SearchOptions& options,
                   const ParticleSource& placed, bool mayUseVoxels, const Offer& offer)
{
    double size = options.cellSize;
    if (size == 0) {
        if (const std::optional<Lattice> voxels = latticeOfVoxels(source, radius)) {
            if (mayUseVoxels && offer(*voxels).fits) return;
        }
        const bool mayBeWide = options.wideCells && options.hostMemoryBytes == 0;
        size = chooseCellSize(source, radius, options.simd, mayBeWide, CancelCheck(options.progress, "grid"));
        if (size < 1) {
            Lattice small = latticeOf(source, radius, cellsOfSize(size));
            if (offerCells(source, small, offer).fits) return;
            size = 1; // too many cells from end to end: with half as many it may do
        }
    }
    const CellChoice cells = cellsOfSize(size);
    Lattice lattice = latticeOf(source, radius, cells);
    const LatticeFit fit = offerCells(source, lattice, offer);
    if (fit.fits) return;
    throw CellMap(placed, lattice, options.simd, &source)
        .rangeError(placed, fit.coordinateError, cells.perRadius);
}

Lattice findLattice(const ParticleSource& source, double radius, const SearchOptions& options)
{
    const CancelCheck cancel(options.progress, "lattice");
    Lattice found;
    offerLattices(source, radius, options, source, true, [&](const Lattice& lattice) {
        found = lattice;
        return fitOf(source, lattice, options.simd, cancel);
    });
    return found;
}

} // namespace vdb_nns
