// The search on the CPU: every task of the grid on the caller's TBB arena. And the engine, which keeps memory between runs.
#include "vdb_nns/search.h"

#include "grid/lattice.h"
#include "grid/lattice_choice.h"
#include "points/pair_geometry.h"
#include "search/engine_state.h"
#include "search/visit_tasks.h"
#include "util/isolate.h"
#include "util/known_value.h"
#include "util/sole_owner.h"
#include "util/wall_clock.h"
#include "vdb_nns/error.h"

#include <string>

namespace vdb_nns {

SearchEngine::SearchEngine() : mImpl(std::make_unique<Impl>()) {}
SearchEngine::~SearchEngine() = default;
SearchEngine::SearchEngine(SearchEngine&&) noexcept = default;
SearchEngine& SearchEngine::operator=(SearchEngine&&) noexcept = default;

void SearchEngine::releaseDevices()
{
    mImpl->devices.clear();
}

const SearchStatistics& SearchEngine::statistics() const
{
    return mImpl->statistics;
}

namespace {

// On a lattice, or on the one that suits a radius.
template <typename LatticeOrRadius>
SparseGrid makeGrid(EngineState& engine, const ParticleView& view, const LatticeOrRadius& where,
                    const SearchOptions& options)
{
    checkOptions(options);
    return isolatedIeee([&] {
        const double start = wallSeconds();
        // The last lists hold the last grid; when nobody else reads them they let go of it.
        if (isSoleOwner(engine.lists)) engine.lists->sets = SearchSets();
        if (!isSoleOwner(engine.grid)) engine.grid = std::make_shared<SparseGridData>();
        buildSparseGrid(view, where, options, engine.scratch, *engine.grid);
        // Under a bound the memory of the sort is better spent on lists.
        if (options.hostMemoryBytes) engine.scratch = GridScratch();
        engine.statistics.gridSeconds = wallSeconds() - start;
        return SparseGrid(engine.grid);
    });
}

} // namespace

SparseGrid SearchEngine::buildGrid(const ParticleView& view, double radius, const SearchOptions& options)
{
    checkRadius(radius);
    return makeGrid(*mImpl, view, radius, options);
}

SparseGrid SearchEngine::buildGrid(const ParticleView& view, const Lattice& lattice,
                                   const SearchOptions& options)
{
    return makeGrid(*mImpl, view, lattice, options);
}

Lattice chooseLattice(const ParticleView& view, double radius, const SearchOptions& options)
{
    checkRadius(radius);
    checkOptions(options);
    return isolatedIeee([&] { return findLattice(view.source(), radius, options); });
}

SearchSets SearchEngine::sort(const ParticleSet& candidates, const ParticleSet& queries, const Radius& radius,
                              const SearchOptions& options)
{
    const bool areOne = &candidates.view.source() == &queries.view.source() && candidates.chosen.empty() &&
                        queries.chosen.empty() && radius.isOne();
    if (areOne) return buildGrid(queries.view, radius.value, options); // in the memory of the last one
    checkOptions(options);
    return isolatedIeee([&] {
        const double start = wallSeconds();
        if (isSoleOwner(mImpl->lists)) mImpl->lists->sets = SearchSets();
        const auto sets =
            std::make_shared<SearchSetsData>(sortSets(candidates, queries, radius, options, mImpl->scratch));
        if (options.hostMemoryBytes) mImpl->scratch = GridScratch();
        mImpl->statistics.gridSeconds = wallSeconds() - start;
        return SearchSets(sets);
    });
}

NeighborLists SearchEngine::search(const SparseGrid& grid, const SearchOptions& options)
{
    return search(SearchSets(grid), options);
}

NeighborLists SearchEngine::search(const ParticleSet& candidates, const ParticleSet& queries,
                                   const Radius& radius, const SearchOptions& options)
{
    return search(sort(candidates, queries, radius, options), options);
}

NeighborLists SearchEngine::search(const SearchSets& sets, const SearchOptions& options)
{
    checkOptions(options);
    return isolatedIeee([&] {
        const double start = wallSeconds();
        const SearchRuns runs(setsWithin(sets, options.radius), options);
        const std::shared_ptr<NeighborListsData> result =
            mImpl->beginLists(runs.sets(), options.encoding, options);
        mImpl->beginStatistics(options);
        ChunkPool pool(std::move(result->chunks));
        const std::uint64_t allowed = mImpl->allowRows(runs, options, 0, *result, pool);
        try {
            runs.forEach([&](const SearchRun& run) {
                forEachTask(run.queries, run.candidates, run.pieces, mImpl->states, run.cancel,
                            [&](ThreadState& state, const SearchTask& task) {
                                mImpl->makeRows(run, task, state, pool, *result);
                            });
            });
        } catch (const ChunkPool::Exhausted&) {
            throw listsDoNotFit(options.encoding, false, pool.takenBytes(), allowed);
        }
        mImpl->finishLists(runs, pool, *result);
        mImpl->lists = result;
        mImpl->statistics.searchSeconds = wallSeconds() - start;
        return NeighborLists(result);
    });
}

namespace {

// Adds the distances of a row.
class DistanceCallback final : public RowCallback {
public:
    DistanceCallback(const SearchRun& run, const NeighborVisitor& visitor, std::vector<double>& distances)
        : mQueries(run.queries),
          mDistance(run.queries.view, run.candidates.view),
          mCancel(run.cancel),
          mVisitor(visitor),
          mDistances(distances)
    {
    }

    void take(const VisitedRows& rows) override
    {
        rows.forEach([&](std::uint32_t slot, const std::uint32_t* neighbors, std::uint32_t count) {
            visit(mQueries.number[slot], neighbors, count);
        });
    }

private:
    static constexpr std::uint32_t kDistancesBetweenChecks = 1u << 18;

    void visit(std::uint32_t query, const std::uint32_t* neighbors, std::uint32_t count)
    {
        if (count >= kDistancesBetweenChecks) mCancel.check();
        mDistances.resize(std::max<std::size_t>(mDistances.size(), count));
        for (std::uint32_t k = 0; k < count; ++k) {
            if ((k + 1) % kDistancesBetweenChecks == 0) mCancel.check();
            mDistances[k] = mDistance(query, neighbors[k]);
        }
        mVisitor(query, {neighbors, count}, {mDistances.data(), count});
    }

    const SparseGridData& mQueries;
    const PairDistance mDistance;
    const CancelCheck& mCancel;
    const NeighborVisitor& mVisitor;
    std::vector<double>& mDistances;
};

class NumberCallback final : public RowCallback {
public:
    NumberCallback(const SparseGridData& queries, const RowVisitor& visitor)
        : mQueries(queries), mVisitor(visitor)
    {
    }

    void take(const VisitedRows& rows) override
    {
        rows.forEach([&](std::uint32_t slot, const std::uint32_t* neighbors, std::uint32_t count) {
            mVisitor(mQueries.number[slot], {neighbors, count});
        });
    }

private:
    const SparseGridData& mQueries;
    const RowVisitor& mVisitor;
};

// Runs all tasks; see visit_tasks.h.
template <typename MakeCallback>
void visitAll(EngineState& engine, const SearchSets& sets, const SearchOptions& given,
              MakeCallback&& makeCallback)
{
    SearchOptions options = given;
    if (options.encoding == Encoding::kMask) options.encoding = Encoding::kIndex; // has no meaning here
    checkOptions(options);
    isolatedIeee([&] {
        const double start = wallSeconds();
        const SearchRuns runs(setsWithin(sets, options.radius), options);
        engine.beginStatistics(options);
        runs.forEach([&](const SearchRun& run) { visitTasks(engine, run, RowKind::kVisit, makeCallback); });
        engine.sumStatistics();
        engine.statistics.searchSeconds = wallSeconds() - start;
    });
}

} // namespace

void SearchEngine::visit(const SearchSets& sets, const NeighborVisitor& visitor, const SearchOptions& options)
{
    visitAll(*mImpl, sets, options, [&](const SearchRun& run, const SearchTask&, ThreadState& state) {
        return DistanceCallback(run, visitor, state.distances);
    });
}

void SearchEngine::visitRows(const SearchSets& sets, const RowVisitor& visitor, const SearchOptions& options)
{
    visitAll(*mImpl, sets, options, [&](const SearchRun& run, const SearchTask&, ThreadState&) {
        return NumberCallback(run.queries, visitor);
    });
}

std::uint64_t countCandidateTests(const SearchSets& sets)
{
    return isolatedIeee(
        [&] { return countListWork(SearchRuns(sets, SearchOptions()), nullptr, "count").candidateTests; });
}

NeighborLists SearchEngine::findNeighbors(const ParticleView& view, double radius,
                                          const SearchOptions& options)
{
    return search(buildGrid(view, radius, options), options);
}

NeighborLists findNeighbors(const ParticleView& view, double radius, const SearchOptions& options)
{
    return SearchEngine().findNeighbors(view, radius, options);
}

NeighborLists search(const ParticleSet& candidates, const ParticleSet& queries, const Radius& radius,
                     const SearchOptions& options)
{
    return SearchEngine().search(candidates, queries, radius, options);
}

std::vector<std::uint32_t> countNeighbors(const ParticleView& view, double radius,
                                          const SearchOptions& options)
{
    SearchOptions counting = options;
    counting.encoding = Encoding::kNone;
    return SearchEngine().findNeighbors(view, radius, counting).counts();
}

void visitNeighbors(const ParticleView& view, double radius, const NeighborVisitor& visitor,
                    const SearchOptions& options)
{
    SearchEngine engine;
    engine.visit(engine.buildGrid(view, radius, options), visitor, options);
}

} // namespace vdb_nns
