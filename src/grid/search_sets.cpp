#include "grid/search_sets_data.h"

#include "grid/cell_map.h"
#include "grid/lattice.h"
#include "grid/lattice_choice.h"
#include "grid/nested_sets.h"
#include "util/known_value.h"
#include "util/progress_share.h"
#include "vdb_nns/error.h"

#include <algorithm>
#include <cmath>
#include <optional>
#include <set>
#include <string>
#include <utility>

namespace vdb_nns {

namespace {

void requireSize(const char* what, std::size_t size, const ParticleView& view)
{
    if (size == 0 || size == view.size()) return;
    throw InvalidInput(std::string(what) + " are " + std::to_string(size) + " values for " +
                       std::to_string(view.size()) + " particles: give one for each");
}

void checkSets(const ParticleSet& candidates, const ParticleSet& queries, const Radius& radius)
{
    requireSize("the chosen candidates", candidates.chosen.size(), candidates.view);
    requireSize("the chosen queries", queries.chosen.size(), queries.view);
    requireSize("the radii of the candidates", radius.ofCandidates.size(), candidates.view);
    requireSize("the radii of the queries", radius.ofQueries.size(), queries.view);
    requireKnown(radius.mode, RadiusMode::kSymmetric, "mode of radii");
    if (radius.isOne()) return checkRadius(radius.value);
    const bool needsQueries = radius.mode != RadiusMode::kScatter && queries.view.size() > 0;
    const bool needsCandidates = radius.mode != RadiusMode::kGather && candidates.view.size() > 0;
    if (needsQueries && radius.ofQueries.empty())
        throw InvalidInput("the radii of the queries decide, and there are none: give one for each query");
    if (needsCandidates && radius.ofCandidates.empty())
        throw InvalidInput(
            "the radii of the candidates decide, and there are none: give one for each candidate");
}

class Sorter {
public:
    Sorter(const ParticleSet& candidates, const ParticleSet& queries, const Radius& radius,
           const SearchOptions& options, GridScratch& scratch, SearchSetsData& sets, std::size_t parts)
        : mCandidates(candidates),
          mQueries(queries),
          mRadius(radius),
          mOptions(options),
          mScratch(scratch),
          mSets(sets),
          mSorts(2 * static_cast<double>(parts))
    {
    }

    // Queries `chosen` within `largest`, or radii up to it.
    void addPart(Span<const std::uint8_t> chosen, double largest, bool isOnlyPart)
    {
        SearchPart part;
        const bool haveBoth =
            isOnlyPart && mSets.areSameParticles() && mQueries.chosen.data() == mCandidates.chosen.data();
        GridMembers queries(mQueries.view);
        queries.chosen = chosen;
        queries.mayUseVoxels = haveBoth;
        if (!mSets.areSameParticles()) queries.home = &mCandidates.view.source();
        SearchOptions options = mOptions;
        // Many passes would take longer to look at the density than cells of the radius lose.
        if (!isOnlyPart && options.cellSize == 0) options.cellSize = 1;
        part.queries = sorted(queries, largest, options, 0);
        std::shared_ptr<const SparseGridData> grid = part.queries;
        if (!haveBoth) {
            GridMembers candidates(mCandidates.view);
            candidates.chosen = mCandidates.chosen;
            candidates.around = part.queries.get();
            grid = sorted(candidates, part.queries->lattice, options, part.queries->bytes());
        }
        finish(part, std::move(grid), largest);
    }

private:
    template <typename LatticeOrRadius>
    std::shared_ptr<const SparseGridData> sorted(const GridMembers& members, const LatticeOrRadius& where,
                                                 SearchOptions options, std::uint64_t otherBytes)
    {
        const std::uint64_t held = mSets.gridBytes() + otherBytes;
        if (options.hostMemoryBytes) options.hostMemoryBytes -= std::min(options.hostMemoryBytes - 1, held);
        std::optional<ProgressShare> share;
        if (options.progress) {
            share.emplace(*options.progress, mSorted / mSorts, (mSorted + 1) / mSorts);
            options.progress = &*share;
        }
        ++mSorted;
        const auto grid = std::make_shared<SparseGridData>();
        buildSparseGrid(members, where, options, mScratch, *grid);
        return grid;
    }

    void finish(SearchPart& part, std::shared_ptr<const SparseGridData> candidates, double largest)
    {
        const bool isOne = mRadius.isOne();
        const bool ofCandidates = !isOne && mRadius.mode != RadiusMode::kGather;
        const double error = std::max(part.queries->coordinateError, candidates->coordinateError);
        const RadiusBounds radius(part.queries->lattice, largest, error, ofCandidates ? 5 : 4);
        part.own = SearchLayer(std::move(candidates), radius);
        if (!isOne) {
            if (mRadius.mode == RadiusMode::kScatter) {
                part.own.farOfQueries = farOf(-1, radius.error);
            } else {
                part.queryFar = farOfSlots(*part.queries, mRadius.ofQueries, radius.error);
            }
            if (ofCandidates)
                part.own.candidateFar = farOfSlots(*part.own.candidates, mRadius.ofCandidates, radius.error);
        }
        part.firstRow = static_cast<std::uint32_t>(mSets.rowCount());
        mSets.finiteQueries += part.queries->finiteCount;
        mSets.nonfiniteQueries += part.queries->nonfiniteCount;
        mSets.nonfiniteCandidates = std::max(mSets.nonfiniteCandidates, part.own.candidates->nonfiniteCount);
        mSets.parts.push_back(std::move(part));
        mSets.lattices = mSets.parts.size();
        mSets.widest = mSets.parts.front().queries->lattice;
    }

    const ParticleSet &mCandidates, &mQueries;
    const Radius& mRadius;
    const SearchOptions& mOptions;
    GridScratch& mScratch;
    SearchSetsData& mSets;
    const double mSorts; // grids that are made, at most
    int mSorted = 0;     // so far
};

} // namespace

std::uint64_t SearchSetsData::rowCount() const
{
    return parts.empty() ? 0 : parts.back().firstRow + parts.back().queries->particleCount();
}

std::uint64_t SearchSetsData::gridBytes() const
{
    // Parts share grids.
    std::set<const void*> counted;
    std::uint64_t bytes = 0;
    const auto addGrid = [&](const std::shared_ptr<const SparseGridData>& grid) {
        if (counted.insert(grid.get()).second) bytes += grid->bytes();
    };
    const auto addFar = [&](const std::shared_ptr<const PageArray<float>>& far) {
        if (far && counted.insert(far.get()).second) bytes += far->usedBytes();
    };
    for (const SearchPart& part : parts) {
        addGrid(part.queries);
        addFar(part.queryFar);
        addGrid(part.own.candidates);
        addFar(part.own.candidateFar);
        for (const SearchLayer& layer : part.wider) {
            addGrid(layer.candidates);
            addFar(layer.candidateFar);
        }
    }
    return bytes;
}

SearchSets setsWithin(const SearchSets& given, double radius)
{
    if (radius == 0 || radius == given.radius()) return given;
    if (!given.data().radius.isOne()) {
        throw InvalidInput("the particles have radii of their own, and the options another one: leave that "
                           "of the options out");
    }
    const auto sets = std::make_shared<SearchSetsData>(given.data());
    for (SearchPart& part : sets->parts) {
        const SparseGridData& queries = *part.queries;
        const double error = std::max(queries.coordinateError, part.own.candidates->coordinateError);
        part.own =
            SearchLayer(part.own.candidates,
                        RadiusBounds(queries.lattice, searchRadius(queries.lattice, radius), error, 4));
    }
    sets->radius.value = sets->largestRadius = radius;
    return SearchSets(sets);
}

SearchSets::SearchSets(const SparseGrid& sparseGrid, double radius)
{
    const std::shared_ptr<const SparseGridData>& grid = sparseGrid.sharedData();
    const auto sets = std::make_shared<SearchSetsData>();
    sets->queries = sets->candidates = grid->view;
    if (grid->particleCount() > 0 || radius != 0) radius = searchRadius(grid->lattice, radius);
    sets->radius = sets->largestRadius = radius;
    SearchPart part;
    part.queries = grid;
    part.own = SearchLayer(grid, RadiusBounds(grid->lattice, radius, grid->coordinateError, 4));
    sets->finiteQueries = grid->finiteCount;
    sets->nonfiniteQueries = sets->nonfiniteCandidates = grid->nonfiniteCount;
    sets->widest = grid->lattice;
    sets->parts.push_back(std::move(part));
    mData = sets;
}

std::uint64_t SearchSets::rowCount() const
{
    return mData->queries.size();
}
std::uint64_t SearchSets::columnCount() const
{
    return mData->candidates.size();
}
const ParticleView& SearchSets::queries() const
{
    return mData->queries;
}
const ParticleView& SearchSets::candidates() const
{
    return mData->candidates;
}
double SearchSets::radius() const
{
    return mData->largestRadius;
}
double SearchSets::cellSize() const
{
    return mData->widest.cellSize;
}
int SearchSets::reach() const
{
    return mData->widest.reach;
}
std::uint64_t SearchSets::latticeCount() const
{
    return mData->lattices;
}
std::uint64_t SearchSets::finiteQueries() const
{
    return mData->finiteQueries;
}
std::uint64_t SearchSets::nonfiniteQueries() const
{
    return mData->nonfiniteQueries;
}
std::uint64_t SearchSets::nonfiniteCandidates() const
{
    return mData->nonfiniteCandidates;
}
std::uint64_t SearchSets::bytes() const
{
    return mData->gridBytes();
}

std::uint64_t SearchSets::leafCount() const
{
    std::uint64_t leaves = 0;
    for (const SearchPart& part : mData->parts) leaves += part.queries->leafCount();
    return leaves;
}

std::uint64_t SearchSets::cellCount() const
{
    std::uint64_t cells = 0;
    for (const SearchPart& part : mData->parts) cells += part.queries->leaves.back().firstCell;
    return cells;
}

// Where no radius reaches anybody: one that a lattice of few particles a cell can have, whatever the units are.
static double smallRadius(const ParticleSource& source)
{
    const Bounds bounds = boundsOf(source, source.reference());
    double extent = 0;
    for (const auto& row : source.linear()) {
        double sum = 0;
        for (int c = 0; c < 3; ++c) sum += std::fabs(row[c]) * (bounds.high[c] - bounds.low[c]);
        extent = std::max(extent, sum);
    }
    const double radius = extent * 0x1p-10;
    return radius > kSmallestEdge && std::isfinite(radius) ? radius : 1;
}

SearchSetsData sortSets(const ParticleSet& candidates, const ParticleSet& queries, const Radius& radius,
                        const SearchOptions& options, GridScratch& scratch)
{
    checkSets(candidates, queries, radius);
    SearchSetsData sets;
    sets.queries = queries.view;
    sets.candidates = candidates.view;
    sets.queryChosen = queries.chosen;
    sets.candidateChosen = candidates.chosen;
    sets.radius = radius;
    if (radius.isOne()) {
        sets.largestRadius = radius.value;
        Sorter(candidates, queries, radius, options, scratch, sets, 1)
            .addPart(queries.chosen, radius.value, true);
        return sets;
    }
    const bool ofQueries = radius.mode != RadiusMode::kScatter,
               ofCandidates = radius.mode != RadiusMode::kGather;
    double largest = 0;
    if (ofQueries) largest = largestRadius(radius.ofQueries, queries.chosen);
    if (ofCandidates) largest = std::max(largest, largestRadius(radius.ofCandidates, candidates.chosen));
    sets.largestRadius = largest;
    std::vector<RadiusClass> classes;
    if (largest > 0) {
        RadiusCensus census(largest);
        if (ofQueries) census.add(radius.ofQueries, queries.chosen);
        if (ofCandidates) census.add(radius.ofCandidates, candidates.chosen);
        classes = census.classes();
    }
    if (classes.size() > 1 && ofCandidates &&
        sortOnNestedLattices(candidates, queries, classes, options, scratch, sets))
        return sets;
    if (classes.size() <= 1 || ofCandidates) {
        Sorter(candidates, queries, radius, options, scratch, sets, 1)
            .addPart(queries.chosen, largest > 0 ? largest : smallRadius(queries.view.source()), true);
        return sets;
    }
    Sorter sorter(candidates, queries, radius, options, scratch, sets, classes.size());
    for (const RadiusClass& c : classes) {
        const bool isLast = &c == &classes.back();
        const ClassMembers members = membersOf(c, largest, radius.ofQueries, queries.chosen, isLast);
        sorter.addPart({members.chosen.data(), members.chosen.size()}, members.largest, false);
    }
    return sets;
}

} // namespace vdb_nns
