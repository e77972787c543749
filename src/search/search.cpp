// The search on the CPU: every task of the grid on the caller's TBB arena. And the engine, which keeps memory between runs.
#include "vdb_nns/search.h"

#include "grid/lattice.h"
#include "grid/lattice_choice.h"
#include "search/engine_state.h"
#include "util/isolate.h"
#include "util/known_value.h"
#include "util/sole_owner.h"
#include "util/wall_clock.h"
#include "vdb_nns/error.h"

#include <atomic>
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
    return isolated([&] {
        const double start = wallSeconds();
        // The last lists hold the last grid; when nobody else reads them they let go of it.
        if (isSoleOwner(engine.lists)) engine.lists->grid = SparseGrid();
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
    return isolated([&] { return findLattice(view.source(), radius, options); });
}

NeighborLists SearchEngine::search(const SparseGrid& grid, const SearchOptions& options)
{
    checkOptions(options);
    return isolated([&] {
        const double start = wallSeconds();
        const SearchRun run(grid.data(), grid.data(), options);
        const std::shared_ptr<NeighborListsData> result =
            mImpl->beginLists(grid, run.radius, options.encoding);
        mImpl->beginStatistics(options);
        ChunkPool pool(std::move(result->chunks));
        const std::uint64_t allowed = mImpl->allowRows(run, options, 0, *result, pool);
        try {
            forEachTask(run.queries, run.pieces, mImpl->states, run.cancel,
                        [&](ThreadState& state, const SearchTask& task) {
                            mImpl->makeRows(run, task, state, pool, *result);
                        });
        } catch (const ChunkPool::Exhausted&) {
            throw listsDoNotFit(options.encoding, false, pool.takenBytes(), allowed);
        }
        mImpl->finishLists(run, pool, *result);
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
          mView(run.candidates.view),
          mCancel(run.cancel),
          mVisitor(visitor),
          mDistances(distances)
    {
    }

    void take(std::uint32_t slot, const std::uint32_t* neighbors, std::uint32_t count) override
    {
        const std::uint32_t query = mQueries.number[slot];
        if (count >= kDistancesBetweenChecks) mCancel.check();
        mDistances.resize(std::max<std::size_t>(mDistances.size(), count));
        for (std::uint32_t k = 0; k < count; ++k) {
            if ((k + 1) % kDistancesBetweenChecks == 0) mCancel.check();
            mDistances[k] = mView.distance(query, neighbors[k]);
        }
        mVisitor(query, {neighbors, count}, {mDistances.data(), count});
    }

private:
    static constexpr std::uint32_t kDistancesBetweenChecks = 1u << 18;

    const SparseGridData& mQueries;
    const ParticleView& mView;
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

    void take(std::uint32_t slot, const std::uint32_t* neighbors, std::uint32_t count) override
    {
        mVisitor(mQueries.number[slot], {neighbors, count});
    }

private:
    const SparseGridData& mQueries;
    const RowVisitor& mVisitor;
};

// Runs all tasks; makeCallback(run, state) is what takes the rows of a task.
template <typename MakeCallback>
void visitTasks(EngineState& engine, const SparseGrid& grid, const SearchOptions& options,
                MakeCallback&& makeCallback)
{
    checkOptions(options);
    isolated([&] {
        const double start = wallSeconds();
        const SearchRun run(grid.data(), grid.data(), options);
        engine.beginStatistics(options);
        forEachTask(run.queries, run.pieces, engine.states, run.cancel,
                    [&](ThreadState& state, const SearchTask& task) {
                        auto callback = makeCallback(run, state);
                        state.beginCallbacks(callback, task);
                        state.decideBy(run.exact, run.cancel);
                        // Once a task, for the kernel calls the visitor too.
                        isolated([&] {
                            run.kernels.visit(run.context, task, state.exactPredicate(), state.halo,
                                              state.visited, state.statistics);
                            state.flushRows();
                        });
                    });
        engine.sumStatistics();
        engine.statistics.searchSeconds = wallSeconds() - start;
    });
}

} // namespace

void SearchEngine::visit(const SparseGrid& grid, const NeighborVisitor& visitor, const SearchOptions& options)
{
    visitTasks(*mImpl, grid, options, [&](const SearchRun& run, ThreadState& state) {
        return DistanceCallback(run, visitor, state.distances);
    });
}

void SearchEngine::visitRows(const SparseGrid& grid, const RowVisitor& visitor, const SearchOptions& options)
{
    visitTasks(*mImpl, grid, options,
               [&](const SearchRun& run, ThreadState&) { return NumberCallback(run.queries, visitor); });
}

std::uint64_t countCandidateTests(const SparseGrid& grid)
{
    if (grid.empty()) return 0;
    std::atomic<std::uint64_t> tests{0};
    ThreadStates states;
    isolated([&] {
        forEachTask(grid.data(), makePieces(grid.data()), states, CancelCheck(nullptr, "count"),
                    [&](ThreadState&, const SearchTask& task) {
                        std::uint64_t sum = 0;
                        forEachCandidateCount(blockViewOf(grid.data()), task,
                                              [&](std::uint64_t queries, std::uint64_t candidates) {
                                                  sum += queries * candidates;
                                              });
                        tests += sum;
                    });
    });
    return tests;
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
