#include "grid/search_sets_data.h"

#include "grid/cell_map.h"
#include "grid/lattice.h"
#include "grid/lattice_choice.h"
#include "util/known_value.h"
#include "vdb_nns/error.h"

#include <tbb/blocked_range.h>
#include <tbb/parallel_for.h>
#include <tbb/parallel_reduce.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <string>

namespace vdb_nns {

namespace {

constexpr std::size_t kGrain = 16384;
// The smallest radii are one part, however much they differ.
constexpr std::size_t kMostClasses = 40;
// A part costs a pass over all candidates: where fewer queries than this, or than this share, have smaller radii than those of a
// part, they are searched with them.
constexpr double kSmallestPart = 256, kSmallestShare = 1.0 / 1024;

bool reaches(double radius)
{
    return radius > 0 && std::isfinite(radius);
}

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

// Of some particles, by halvings of the largest radius of all.
struct RadiusCensus {
    double largest = 0;
    std::array<std::uint64_t, 2100> octaves{}; // by exponent of the radius, from -1074 up

    static std::size_t octaveOf(double radius) { return static_cast<std::size_t>(std::ilogb(radius) + 1074); }

    void add(const RadiusCensus& other)
    {
        largest = std::max(largest, other.largest);
        for (std::size_t k = 0; k < octaves.size(); ++k) octaves[k] += other.octaves[k];
    }
};

RadiusCensus censusOf(Span<const double> radii, Span<const std::uint8_t> chosen)
{
    return tbb::parallel_reduce(
        tbb::blocked_range<std::size_t>(0, radii.size(), kGrain), RadiusCensus(),
        [&](const auto& range, RadiusCensus sum) {
            for (std::size_t i = range.begin(); i < range.end(); ++i) {
                if (!reaches(radii[i]) || (!chosen.empty() && !chosen[i])) continue;
                sum.largest = std::max(sum.largest, radii[i]);
                ++sum.octaves[RadiusCensus::octaveOf(radii[i])];
            }
            return sum;
        },
        [](RadiusCensus a, const RadiusCensus& b) {
            a.add(b);
            return a;
        });
}

// Radii above `above` up to `upTo` are searched together.
struct RadiusClass {
    double above, upTo;
};

// From the largest down, a factor of two each.
std::vector<RadiusClass> classesOf(const RadiusCensus& census)
{
    std::uint64_t all = 0;
    for (const std::uint64_t count : census.octaves) all += count;
    const double least = std::max(kSmallestPart, kSmallestShare * static_cast<double>(all));
    std::vector<RadiusClass> classes;
    double upTo = census.largest;
    for (std::uint64_t left = all; left > 0;) {
        const int octave = std::ilogb(upTo);
        const std::uint64_t count = census.octaves[RadiusCensus::octaveOf(upTo)];
        left -= count;
        const double above = std::nextafter(std::ldexp(1.0, octave), 0.0);
        if (static_cast<double>(left) < least || classes.size() == kMostClasses) {
            if (count == 0 && left > 0 && !classes.empty()) {
                classes.back().above = 0;
            } else {
                classes.push_back({0, upTo});
            }
            break;
        }
        if (count > 0) classes.push_back({above, upTo});
        upTo = above;
    }
    return classes;
}

// 1 for the chosen particles whose radius is in the class.
std::vector<std::uint8_t> membersOf(const RadiusClass& c, Span<const double> radii,
                                    Span<const std::uint8_t> chosen, bool alsoUnreaching, double& largest)
{
    std::vector<std::uint8_t> members(radii.size());
    largest = tbb::parallel_reduce(
        tbb::blocked_range<std::size_t>(0, radii.size(), kGrain), 0.0,
        [&](const auto& range, double most) {
            for (std::size_t i = range.begin(); i < range.end(); ++i) {
                const double r = radii[i];
                const bool isIn = reaches(r) ? r > c.above && r <= c.upTo : alsoUnreaching;
                members[i] = isIn && (chosen.empty() || chosen[i]);
                if (members[i] && reaches(r)) most = std::max(most, r);
            }
            return most;
        },
        [](double a, double b) { return std::max(a, b); });
    return members;
}

std::shared_ptr<const PageArray<float>> farOfSlots(const SparseGridData& grid, Span<const double> radii,
                                                   const FilterError& error)
{
    const auto result = std::make_shared<PageArray<float>>();
    PageArray<float>& far = *result;
    far.resizeDiscarding(grid.particleCount());
    tbb::parallel_for(tbb::blocked_range<std::size_t>(0, grid.particleCount(), kGrain),
                      [&](const auto& range) {
                          for (std::size_t slot = range.begin(); slot < range.end(); ++slot) {
                              const double r = radii[grid.number[slot]];
                              far[slot] = farOf(reaches(r) ? radiusInCells(grid.lattice, r) : -1, error);
                          }
                      });
    return result;
}

// `sums`: as filterError() takes them.
FilterError setBounds(SearchPart& part, double largestRadius, int sums)
{
    const Lattice& lattice = part.queries->lattice;
    const double error = std::max(part.queries->coordinateError, part.candidates->coordinateError);
    const double radiusCells = radiusInCells(lattice, largestRadius);
    const FilterError filter = filterError(radiusCells, lattice.reach, error, sums);
    part.bounds = makeFilterBounds(radiusCells, lattice.reach, error, sums);
    // Twice the error, and what rounding adds to the difference of two scores of at most the square of the radius.
    part.nearestDoubt = static_cast<float>(2.1 * filter.beta + 0x1p-22 * (radiusCells * radiusCells + 1));
    return filter;
}

class Sorter {
public:
    Sorter(const ParticleSet& candidates, const ParticleSet& queries, const Radius& radius,
           const SearchOptions& options, GridScratch& scratch, SearchSetsData& sets)
        : mCandidates(candidates),
          mQueries(queries),
          mRadius(radius),
          mOptions(options),
          mScratch(scratch),
          mSets(sets)
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
        part.candidates = part.queries;
        if (!haveBoth) {
            GridMembers candidates(mCandidates.view);
            candidates.chosen = mCandidates.chosen;
            candidates.around = part.queries.get();
            part.candidates = sorted(candidates, part.queries->lattice, options, part.queries->bytes());
        }
        finish(part, largest);
    }

private:
    template <typename LatticeOrRadius>
    std::shared_ptr<const SparseGridData> sorted(const GridMembers& members, const LatticeOrRadius& where,
                                                 SearchOptions options, std::uint64_t otherBytes)
    {
        const std::uint64_t held = mSets.gridBytes() + otherBytes;
        if (options.hostMemoryBytes) options.hostMemoryBytes -= std::min(options.hostMemoryBytes - 1, held);
        const auto grid = std::make_shared<SparseGridData>();
        buildSparseGrid(members, where, options, mScratch, *grid);
        return grid;
    }

    void finish(SearchPart& part, double largest)
    {
        const bool isOne = mRadius.isOne();
        const bool ofCandidates = !isOne && mRadius.mode != RadiusMode::kGather;
        const int sums = ofCandidates ? 5 : 4;
        const FilterError filter = setBounds(part, largest, sums);
        if (!isOne) {
            if (mRadius.mode == RadiusMode::kScatter) {
                const auto far = std::make_shared<PageArray<float>>();
                far->resizeDiscarding(part.queries->particleCount());
                std::fill(far->begin(), far->end(), farOf(-1, filter));
                part.queryFar = far;
            } else {
                part.queryFar = farOfSlots(*part.queries, mRadius.ofQueries, filter);
            }
            if (ofCandidates) part.candidateFar = farOfSlots(*part.candidates, mRadius.ofCandidates, filter);
        }
        part.firstRow = static_cast<std::uint32_t>(mSets.rowCount());
        mSets.finiteQueries += part.queries->finiteCount;
        mSets.nonfiniteQueries += part.queries->nonfiniteCount;
        mSets.nonfiniteCandidates = std::max(mSets.nonfiniteCandidates, part.candidates->nonfiniteCount);
        mSets.parts.push_back(std::move(part));
    }

    const ParticleSet &mCandidates, &mQueries;
    const Radius& mRadius;
    const SearchOptions& mOptions;
    GridScratch& mScratch;
    SearchSetsData& mSets;
};

} // namespace

std::uint64_t SearchSetsData::rowCount() const
{
    return parts.empty() ? 0 : parts.back().firstRow + parts.back().queries->particleCount();
}

std::uint64_t SearchSetsData::gridBytes() const
{
    std::uint64_t bytes = 0;
    for (const SearchPart& part : parts) {
        bytes += part.queries->bytes();
        for (const auto& far : {part.queryFar, part.candidateFar}) bytes += far ? far->usedBytes() : 0;
        if (part.candidates != part.queries) bytes += part.candidates->bytes();
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
    for (SearchPart& part : sets->parts) setBounds(part, searchRadius(part.queries->lattice, radius), 4);
    sets->radius.value = sets->largestRadius = radius;
    return SearchSets(sets);
}

SearchSets::SearchSets(const SparseGrid& sparseGrid, double radius)
{
    const std::shared_ptr<const SparseGridData>& grid = sparseGrid.sharedData();
    const auto sets = std::make_shared<SearchSetsData>();
    sets->queries = sets->candidates = grid->view;
    SearchPart part;
    part.queries = part.candidates = grid;
    if (grid->particleCount() > 0 || radius != 0) radius = searchRadius(grid->lattice, radius);
    sets->radius = sets->largestRadius = radius;
    setBounds(part, radius, 4);
    sets->finiteQueries = grid->finiteCount;
    sets->nonfiniteQueries = sets->nonfiniteCandidates = grid->nonfiniteCount;
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
    return mData->parts.front().queries->lattice.cellSize;
}
int SearchSets::reach() const
{
    return mData->parts.front().queries->lattice.reach;
}
std::uint64_t SearchSets::latticeCount() const
{
    return mData->parts.size();
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
    sets.candidateChosen = candidates.chosen;
    sets.radius = radius;
    Sorter sorter(candidates, queries, radius, options, scratch, sets);
    if (radius.isOne()) {
        sets.largestRadius = radius.value;
        sorter.addPart(queries.chosen, radius.value, true);
        return sets;
    }
    RadiusCensus census;
    if (radius.mode != RadiusMode::kScatter) census.add(censusOf(radius.ofQueries, queries.chosen));
    if (radius.mode != RadiusMode::kGather) census.add(censusOf(radius.ofCandidates, candidates.chosen));
    sets.largestRadius = census.largest;
    const double some = census.largest > 0 ? census.largest : smallRadius(queries.view.source());
    const std::vector<RadiusClass> classes =
        radius.mode == RadiusMode::kGather ? classesOf(census) : std::vector<RadiusClass>();
    if (classes.size() <= 1) {
        sorter.addPart(queries.chosen, some, true);
        return sets;
    }
    for (std::size_t k = 0; k < classes.size(); ++k) {
        double largest = 0;
        const bool isLast = k + 1 == classes.size();
        const std::vector<std::uint8_t> members =
            membersOf(classes[k], radius.ofQueries, queries.chosen, isLast, largest);
        sorter.addPart({members.data(), members.size()}, largest > 0 ? largest : classes[k].upTo, false);
    }
    return sets;
}

} // namespace vdb_nns
