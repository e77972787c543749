#include "bench/methods/ablation_structure.h"

#include "bench/methods/ablation_kernels.h"
#include "bench/methods/candidate_frame.h"

#include <tbb/blocked_range.h>
#include <tbb/parallel_for.h>
#include <tbb/parallel_reduce.h>
#include <tbb/parallel_sort.h>

#include <algorithm>
#include <numeric>
#include <stdexcept>

namespace vdb_nns::cli {
namespace {

// How far positions are from the frame's reference, and whether all were in their leaves.
struct Extent {
    Vec3d most{0, 0, 0};
    bool inside = true;
};

template <AblationFrame kFrame>
class StructureBuilder {
public:
    StructureBuilder(const SparseGrid& grid, const CellFrame& frame, AblationStructure<kFrame>& out)
        : mGrid(grid), mFrame(frame), mOut(out)
    {
    }

    Extent build() const
    {
        return tbb::parallel_reduce(
            tbb::blocked_range<std::uint64_t>(0, mGrid.leafCount()), Extent{},
            [this](const tbb::blocked_range<std::uint64_t>& range, Extent extent) {
                std::vector<std::uint16_t> trialOf;
                for (std::uint64_t l = range.begin(); l < range.end() && extent.inside; ++l) {
                    const SparseGrid::Leaf leaf = mGrid.leaf(l);
                    trialOf.resize(leaf.particleCount);
                    readLeaf(leaf, trialOf.data(), extent);
                    sortLeaf(leaf, trialOf);
                    listCells(l, leaf, trialOf.data());
                }
                return extent;
            },
            [](Extent a, const Extent& b) {
                for (std::size_t k = 0; k < 3; ++k) a.most[k] = std::max(a.most[k], b.most[k]);
                a.inside &= b.inside;
                return a;
            });
    }

private:
    using Real = FrameReal<kFrame>;

    void readLeaf(const SparseGrid::Leaf& leaf, std::uint16_t* trialOf, Extent& extent) const
    {
        const ParticleView& view = mGrid.view();
        const CellFrame frame = mFrame;
        const std::uint32_t* const numbers = mGrid.particleNumbers().data();
        Vec3d most = extent.most;
        bool inside = true;
        for (std::uint64_t s = leaf.firstSlot; s < leaf.firstSlot + leaf.particleCount; ++s) {
            const std::uint32_t number = numbers[s];
            const StoredPosition stored = view.stored(number);
            const CellFrame::Place place = frame.placeOf(stored, leaf.origin);
            inside &= place.inside;
            for (int k = 0; k < 3; ++k) {
                double& m = most[static_cast<std::size_t>(k)];
                m = std::max(m, std::fabs(frame.fromReference(stored, k)));
            }
            *trialOf++ = static_cast<std::uint16_t>(place.cell[0] << 6 | place.cell[1] << 3 | place.cell[2]);
            Vec3d at{place.at[0] - 4, place.at[1] - 4, place.at[2] - 4};
            if constexpr (kFrame != AblationFrame::kLeafFloat) at = view.worldPosition(number);
            mOut.x[s] = static_cast<Real>(at[0]);
            mOut.y[s] = static_cast<Real>(at[1]);
            mOut.z[s] = static_cast<Real>(at[2]);
            mOut.number[s] = number;
        }
        extent.most = most;
        extent.inside &= inside;
    }

    // The grid has sorted them; only where a rounding has put a particle into another cell is anything to be done.
    void sortLeaf(const SparseGrid::Leaf& leaf, std::vector<std::uint16_t>& trialOf) const
    {
        if (std::is_sorted(trialOf.begin(), trialOf.end())) return;
        std::vector<std::uint32_t> order(trialOf.size());
        std::iota(order.begin(), order.end(), 0u);
        std::stable_sort(order.begin(), order.end(),
                         [&](std::uint32_t a, std::uint32_t b) { return trialOf[a] < trialOf[b]; });
        const auto permute = [&order](auto* values) {
            std::vector<std::decay_t<decltype(*values)>> old(values, values + order.size());
            for (std::size_t i = 0; i < order.size(); ++i) values[i] = old[order[i]];
        };
        permute(mOut.x.data() + leaf.firstSlot);
        permute(mOut.y.data() + leaf.firstSlot);
        permute(mOut.z.data() + leaf.firstSlot);
        permute(mOut.number.data() + leaf.firstSlot);
        permute(trialOf.data());
    }

    void listCells(std::uint64_t index, const SparseGrid::Leaf& leaf, const std::uint16_t* trialOf) const
    {
        AblationLeaf& out = mOut.leaves[index];
        out.firstSlot = static_cast<std::uint32_t>(leaf.firstSlot);
        out.endSlot = static_cast<std::uint32_t>(leaf.firstSlot + leaf.particleCount);
        std::fill_n(out.occupancy, 8, 0);
        // A leaf has at most as many cells as particles, and one entry more.
        std::uint32_t cell = static_cast<std::uint32_t>(out.firstSlot + index);
        int word = 0;
        out.firstCell[0] = cell;
        for (std::uint32_t s = out.firstSlot; s < out.endSlot; ++s, ++trialOf) {
            if (s > out.firstSlot && *trialOf == trialOf[-1]) continue;
            while (word < *trialOf >> 6) out.firstCell[++word] = cell;
            out.occupancy[word] |= std::uint64_t(1) << (*trialOf & 63);
            mOut.cellStart[cell++] = s;
        }
        while (word < 7) out.firstCell[++word] = cell;
        mOut.cellStart[cell] = out.endSlot;
    }

    const SparseGrid& mGrid;
    const CellFrame& mFrame;
    AblationStructure<kFrame>& mOut;
};

} // namespace

template <AblationFrame kFrame>
void AblationStructure<kFrame>::build(const SparseGrid& grid)
{
    reach = grid.reach();
    const std::size_t particles = grid.particleCount();
    for (auto* axis : {&x, &y, &z}) axis->resize(particles + kVectorSlack);
    number.resize(particles + kVectorSlack);
    leaves.resize(grid.leafCount());
    cellStart.resize(particles + grid.leafCount());
    CellFrame frame(grid);
    const StructureBuilder<kFrame> builder(grid, frame, *this);
    Extent extent = builder.build();
    if (!extent.inside) {
        frame.fit(grid);
        extent = builder.build();
        if (!extent.inside) throw std::logic_error("bench: particles outside their leaves");
    }
    coordinateError = frame.error(extent.most);
    findNeighborhoods(grid, neighborhoods);
}

template <AblationFrame kFrame>
std::uint64_t AblationStructure<kFrame>::bytes() const
{
    return 3 * x.size() * sizeof(Real) + (number.size() + cellStart.size()) * sizeof(std::uint32_t) +
           leaves.size() * (sizeof(AblationLeaf) + sizeof(AblationNeighborhood));
}

template struct AblationStructure<AblationFrame::kLeafFloat>;
template struct AblationStructure<AblationFrame::kWorldFloat>;
template struct AblationStructure<AblationFrame::kWorldDouble>;

namespace {

struct PlacedLeaf {
    std::array<std::int64_t, 3> at; // in leaves
    std::uint32_t index;

    bool operator<(const PlacedLeaf& other) const { return at < other.at; }
};

// In lexicographic order the leaves of a column follow each other, and the columns around a leaf are passed in the same
// order as the leaves: a pointer to each only moves on.
void findAround(const std::vector<PlacedLeaf>& sorted, std::size_t begin, std::size_t end,
                std::vector<AblationNeighborhood>& out)
{
    const PlacedLeaf* const last = sorted.data() + sorted.size();
    const PlacedLeaf* column[9];
    const auto below = [](const PlacedLeaf& leaf, int c) {
        return PlacedLeaf{{leaf.at[0] + c / 3 - 1, leaf.at[1] + c % 3 - 1, leaf.at[2] - 1}, 0};
    };
    for (int c = 0; c < 9; ++c) {
        column[c] = std::lower_bound(sorted.data(), last, below(sorted[begin], c));
    }
    for (std::size_t i = begin; i < end; ++i) {
        AblationNeighborhood& around = out[sorted[i].index];
        around.fill(kNoAblationLeaf);
        for (int c = 0; c < 9; ++c) {
            const PlacedLeaf wanted = below(sorted[i], c);
            while (column[c] < last && *column[c] < wanted) ++column[c];
            for (const PlacedLeaf* leaf = column[c]; leaf < last; ++leaf) {
                if (leaf->at[0] != wanted.at[0] || leaf->at[1] != wanted.at[1]) break;
                const std::int64_t dz = leaf->at[2] - wanted.at[2];
                if (dz > 2) break;
                around[static_cast<std::size_t>(3 * c + dz)] = leaf->index;
            }
        }
    }
}

} // namespace

void findNeighborhoods(const SparseGrid& grid, std::vector<AblationNeighborhood>& neighborhoods)
{
    std::vector<PlacedLeaf> sorted(grid.leafCount());
    tbb::parallel_for(tbb::blocked_range<std::size_t>(0, sorted.size(), 4096), [&](const auto& range) {
        for (std::size_t l = range.begin(); l < range.end(); ++l) {
            const Vec3i origin = grid.leaf(l).origin;
            sorted[l] = {{origin[0] >> 3, origin[1] >> 3, origin[2] >> 3}, static_cast<std::uint32_t>(l)};
        }
    });
    tbb::parallel_sort(sorted.begin(), sorted.end());
    neighborhoods.resize(sorted.size());
    tbb::parallel_for(tbb::blocked_range<std::size_t>(0, sorted.size(), 1024), [&](const auto& range) {
        findAround(sorted, range.begin(), range.end(), neighborhoods);
    });
}

} // namespace vdb_nns::cli
