#include "grid/nested_sets.h"

#include "grid/cell_map.h"
#include "grid/lattice.h"
#include "grid/lattice_choice.h"
#include "util/progress_share.h"

#include <tbb/blocked_range.h>
#include <tbb/parallel_for.h>
#include <tbb/parallel_reduce.h>

#include <algorithm>
#include <cmath>
#include <optional>
#include <utility>

namespace vdb_nns {

namespace {

// Of candidates whose own radius counts: on top of what filterError() says of one radius.
constexpr int kSums = 5;

using Grid = std::shared_ptr<const SparseGridData>;

// A class of radii and what is sorted for it.
struct Level {
    RadiusClass radii;
    Lattice lattice;
    Grid ofClass;               // candidates whose radius is in the class; null: none is needed
    double coordinateError = 0; // of all that is compared with candidates on the lattice
    std::unique_ptr<RadiusBounds> bounds;
    std::shared_ptr<const PageArray<float>> farOfClass;
};

// A part before its bounds are known.
struct PlannedPart {
    std::size_t level;
    Grid queries, own;
};

class NestedSorter {
public:
    NestedSorter(const ParticleSet& candidates, const ParticleSet& queries, const SearchOptions& options,
                 GridScratch& scratch, SearchSetsData& sets)
        : mCandidates(candidates),
          mQueries(queries),
          mOptions(options),
          mScratch(scratch),
          mSets(sets),
          mCancel(options.progress, "grid"),
          mHeldBytes(queries.view.size() + candidates.view.size())
    {
    }

    // Whatever their radii are.
    void countNonfiniteCandidates();
    // False where fewer than two lattices fit.
    bool chooseLattices(const std::vector<RadiusClass>& classes);
    void sortForScatter();
    void sortForSymmetric();
    void finish();

private:
    bool fits(const Lattice& lattice) const;
    Grid sorted(const GridMembers& members, const Lattice& lattice);
    // Candidates whose radius is in the class of a level; in the narrowest cells those too that reach nobody but themselves.
    void sortClass(Level& level);
    GridMembers queriesOf(Span<const std::uint8_t> chosen) const;
    // Counts the queries of a grid that has all of them, near candidates or not.
    void countQueries(const SparseGridData& grid);
    RadiusBounds& boundsAt(Level& level);

    const ParticleSet &mCandidates, &mQueries;
    const SearchOptions& mOptions;
    GridScratch& mScratch;
    SearchSetsData& mSets;
    const CancelCheck mCancel;
    std::vector<Level> mLevels; // from the widest cells down
    std::vector<PlannedPart> mParts;
    std::uint64_t mHeldBytes; // of the grids, and of a mask of each set while they are sorted
    int mSorted = 0;          // grids
};

void NestedSorter::countNonfiniteCandidates()
{
    constexpr std::size_t kBatch = 512;
    struct Counts {
        std::uint64_t nonfinite = 0, all = 0;
    };
    const ParticleSource& source = mCandidates.view.source();
    const Counts counts = tbb::parallel_reduce(
        tbb::blocked_range<std::size_t>(0, source.size(), 64 * kBatch), Counts(),
        [&](const auto& range, Counts sum) {
            mCancel.check();
            double x[kBatch], y[kBatch], z[kBatch];
            for (std::size_t begin = range.begin(); begin < range.end(); begin += kBatch) {
                const std::size_t n = std::min(kBatch, range.end() - begin);
                source.read(begin, n, source.reference(), x, y, z);
                for (std::size_t i = 0; i < n; ++i) {
                    if (!mCandidates.chosen.empty() && !mCandidates.chosen[begin + i]) continue;
                    ++sum.all;
                    sum.nonfinite += !(std::isfinite(x[i]) && std::isfinite(y[i]) && std::isfinite(z[i]));
                }
            }
            return sum;
        },
        [](const Counts& a, const Counts& b) {
            return Counts{a.nonfinite + b.nonfinite, a.all + b.all};
        });
    if (counts.nonfinite > 0 && mOptions.nonfinite == NonFinite::kFail)
        throw nonfiniteParticles(counts.nonfinite, counts.all);
    mSets.nonfiniteCandidates = counts.nonfinite;
}

bool NestedSorter::fits(const Lattice& lattice) const
{
    const ParticleSource &home = mCandidates.view.source(), &other = mQueries.view.source();
    if (!fitOf(home, lattice, mOptions.simd, mCancel).fits) return false;
    return &home == &other || fitOf(other, lattice, mOptions.simd, mCancel, &home).fits;
}

bool NestedSorter::chooseLattices(const std::vector<RadiusClass>& classes)
{
    const ParticleSource& source = mCandidates.view.source();
    Lattice widest =
        latticeOf(source, mSets.largestRadius, cellsOfSize(mOptions.cellSize == 0 ? 1 : mOptions.cellSize));
    const auto narrowed = [&](const RadiusClass& c) {
        Lattice lattice = widest;
        lattice.cellSize = std::ldexp(widest.cellSize, -c.first);
        lattice.radius = c.upTo(mSets.largestRadius);
        return lattice;
    };
    std::optional<Vec3d> middle;
    std::size_t count = classes.size();
    for (; count > 1; --count) {
        if (narrowed(classes[count - 1]).cellSize < kSmallestEdge) continue;
        widest.reference = source.reference();
        if (fits(narrowed(classes[count - 1]))) break;
        if (!source.isArray()) continue;
        if (!middle) {
            const Bounds bounds = boundsOf(source, Vec3d{});
            middle.emplace();
            for (int k = 0; k < 3; ++k) (*middle)[k] = bounds.low[k] / 2 + bounds.high[k] / 2;
        }
        widest.reference = *middle;
        if (fits(narrowed(classes[count - 1]))) break;
    }
    if (count < 2) return false;
    for (std::size_t k = 0; k < count; ++k) {
        Level level;
        level.radii = classes[k];
        if (k + 1 == count) level.radii.last = RadiusClass::kAllSmaller;
        level.lattice = narrowed(classes[k]);
        mLevels.push_back(std::move(level));
    }
    return true;
}

Grid NestedSorter::sorted(const GridMembers& members, const Lattice& lattice)
{
    SearchOptions options = mOptions;
    if (options.hostMemoryBytes) options.hostMemoryBytes -= std::min(options.hostMemoryBytes - 1, mHeldBytes);
    // Queries and candidates on each lattice, at most.
    std::optional<ProgressShare> share;
    const double sorts = 2 * static_cast<double>(mLevels.size()) + 1;
    if (mOptions.progress) {
        share.emplace(*mOptions.progress, mSorted / sorts, (mSorted + 1) / sorts);
        options.progress = &*share;
    }
    ++mSorted;
    const auto grid = std::make_shared<SparseGridData>();
    buildSparseGrid(members, lattice, options, mScratch, *grid);
    mHeldBytes += grid->bytes() + grid->particleCount() * sizeof(float); // and the far of each radius
    return grid;
}

void NestedSorter::sortClass(Level& level)
{
    const ClassMembers members = membersOf(level.radii, mSets.largestRadius, mSets.radius.ofCandidates,
                                           mCandidates.chosen, &level == &mLevels.back());
    if (members.count == 0) return;
    GridMembers ofClass(mCandidates.view);
    ofClass.chosen = {members.chosen.data(), members.chosen.size()};
    level.ofClass = sorted(ofClass, level.lattice);
}

GridMembers NestedSorter::queriesOf(Span<const std::uint8_t> chosen) const
{
    GridMembers members(mQueries.view);
    members.chosen = chosen;
    if (!mSets.areSameParticles()) members.home = &mCandidates.view.source();
    return members;
}

void NestedSorter::countQueries(const SparseGridData& grid)
{
    mSets.finiteQueries += grid.finiteCount;
    mSets.nonfiniteQueries += grid.nonfiniteCount;
}

void NestedSorter::sortForScatter()
{
    for (Level& level : mLevels) sortClass(level);
    // On the narrowest lattice that has candidates near it, each query; all are still to be sorted at first.
    std::vector<std::uint8_t> left(mQueries.chosen.begin(), mQueries.chosen.end());
    if (left.empty()) left.assign(mQueries.view.size(), 1);
    bool areCounted = false;
    for (std::size_t k = mLevels.size(); k-- > 0;) {
        const Level& level = mLevels[k];
        if (!level.ofClass) continue;
        GridMembers members = queriesOf({left.data(), left.size()});
        members.around = level.ofClass.get();
        const Grid grid = sorted(members, level.lattice);
        if (!std::exchange(areCounted, true)) countQueries(*grid);
        if (grid->particleCount() == 0) continue;
        tbb::parallel_for(tbb::blocked_range<std::size_t>(0, grid->particleCount(), 16384),
                          [&](const auto& range) {
                              for (std::size_t s = range.begin(); s < range.end(); ++s)
                                  left[grid->number[s]] = 0;
                          });
        mParts.push_back({k, grid, level.ofClass});
    }
    std::reverse(mParts.begin(), mParts.end());
}

void NestedSorter::sortForSymmetric()
{
    const Radius& radius = mSets.radius;
    // The narrowest cells have all smaller radii anyway.
    for (std::size_t k = 0; k + 1 < mLevels.size(); ++k) sortClass(mLevels[k]);
    for (std::size_t k = 0; k < mLevels.size(); ++k) {
        const Level& level = mLevels[k];
        const bool isLast = k + 1 == mLevels.size();
        const ClassMembers ofClass =
            membersOf(level.radii, mSets.largestRadius, radius.ofQueries, mQueries.chosen, isLast);
        if (ofClass.count == 0) continue;
        const Grid queries = sorted(queriesOf({ofClass.chosen.data(), ofClass.chosen.size()}), level.lattice);
        countQueries(*queries);
        const ClassMembers upTo =
            membersOf({level.radii.first, RadiusClass::kAllSmaller}, mSets.largestRadius, radius.ofCandidates,
                      mCandidates.chosen, true);
        GridMembers candidates(mCandidates.view);
        candidates.chosen = {upTo.chosen.data(), upTo.chosen.size()};
        candidates.around = queries.get();
        const Grid own = sorted(candidates, level.lattice);
        mParts.push_back({k, queries, own});
    }
}

RadiusBounds& NestedSorter::boundsAt(Level& level)
{
    if (!level.bounds) {
        level.bounds =
            std::make_unique<RadiusBounds>(level.lattice, level.lattice.radius, level.coordinateError, kSums);
    }
    return *level.bounds;
}

void NestedSorter::finish()
{
    const Radius& radius = mSets.radius;
    if (mParts.empty()) {
        // Nobody is near anybody. The lists still have a grid.
        const std::vector<std::uint8_t> none(mQueries.view.size(), 0);
        const Grid grid = sorted(queriesOf({none.data(), none.size()}), mLevels.front().lattice);
        mParts.push_back({0, grid, grid});
    }
    for (const PlannedPart& part : mParts) {
        Level& own = mLevels[part.level];
        own.coordinateError = std::max(own.coordinateError, part.own->coordinateError);
        for (std::size_t k = 0; k <= part.level; ++k) {
            const int octaves = own.radii.first - mLevels[k].radii.first;
            mLevels[k].coordinateError =
                std::max(mLevels[k].coordinateError, std::ldexp(part.queries->coordinateError, -octaves));
        }
    }
    for (Level& level : mLevels) {
        if (!level.ofClass) continue;
        level.coordinateError = std::max(level.coordinateError, level.ofClass->coordinateError);
        level.farOfClass = farOfSlots(*level.ofClass, radius.ofCandidates, boundsAt(level).error);
    }
    for (const PlannedPart& planned : mParts) {
        Level& level = mLevels[planned.level];
        const RadiusBounds& bounds = boundsAt(level);
        SearchPart part;
        part.queries = planned.queries;
        part.own = SearchLayer(planned.own, bounds);
        part.own.candidateFar = planned.own == level.ofClass
                                    ? level.farOfClass
                                    : farOfSlots(*planned.own, radius.ofCandidates, bounds.error);
        if (radius.mode == RadiusMode::kScatter) {
            part.own.farOfQueries = farOf(-1, bounds.error);
        } else {
            part.queryFar = farOfSlots(*planned.queries, radius.ofQueries, bounds.error);
        }
        for (std::size_t k = planned.level; k-- > 0;) {
            Level& wide = mLevels[k];
            if (!wide.ofClass) continue;
            SearchLayer layer(wide.ofClass, boundsAt(wide));
            layer.candidateFar = wide.farOfClass;
            layer.farOfQueries = farOf(-1, boundsAt(wide).error);
            layer.octaves = level.radii.first - wide.radii.first;
            part.wider.push_back(std::move(layer));
        }
        part.firstRow = static_cast<std::uint32_t>(mSets.rowCount());
        mSets.parts.push_back(std::move(part));
    }
    mSets.lattices = mLevels.size();
    mSets.widest = mLevels.front().lattice;
}

} // namespace

bool sortOnNestedLattices(const ParticleSet& candidates, const ParticleSet& queries,
                          const std::vector<RadiusClass>& classes, const SearchOptions& options,
                          GridScratch& scratch, SearchSetsData& sets)
{
    NestedSorter sorter(candidates, queries, options, scratch, sets);
    if (!sorter.chooseLattices(classes)) return false;
    sorter.countNonfiniteCandidates();
    if (sets.radius.mode == RadiusMode::kScatter) {
        sorter.sortForScatter();
    } else {
        sorter.sortForSymmetric();
    }
    sorter.finish();
    return true;
}

} // namespace vdb_nns
