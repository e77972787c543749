#include "bench/methods/engine_methods.h"

#include "machine.h"
#include "vdb_nns/search.h"

#include <numeric>
#include <utility>

namespace vdb_nns::cli {
namespace {

class EngineMethod : public MethodWithResult {
public:
    EngineMethod(const SearchOptions& options, bool visits) : mOptions(options), mVisits(visits) {}

    MethodRun run(const ParticleView& view, double radius, const ProgressSpan& span) override
    {
        discard();
        span.printer.begin("search", span.begin, span.end);
        MethodRun result;
        const Stopwatch gridWatch;
        const SparseGrid grid = mEngine.buildGrid(view, radius, mOptions);
        result.gridSeconds = gridWatch.seconds();
        result.structureBytes = grid.bytes();
        mVisits ? visit(grid, result) : list(grid, result);
        return result;
    }

private:
    void list(const SparseGrid& grid, MethodRun& result)
    {
        const Stopwatch watch;
        const NeighborLists lists = mEngine.search(grid, mOptions);
        result.searchSeconds = watch.seconds();
        result.pairs = lists.pairCount();
        result.listBytes = lists.bytes();
        mFound = std::make_unique<EngineNeighbors>(lists);
    }

    // The least that a visitor can do: it counts. What a solver would sum up instead costs its own.
    void visit(const SparseGrid& grid, MethodRun& result)
    {
        std::vector<std::uint32_t> counts(grid.view().size());
        const Stopwatch watch;
        mEngine.visitRows(
            grid,
            [&counts](std::uint32_t query, Span<const std::uint32_t> neighbors) {
                counts[query] = static_cast<std::uint32_t>(neighbors.size());
            },
            mOptions);
        result.searchSeconds = watch.seconds();
        result.pairs = std::accumulate(counts.begin(), counts.end(), std::uint64_t(0));
        result.listBytes = counts.size() * sizeof(counts[0]);
        mFound = std::make_unique<CountedNeighbors>(std::move(counts));
    }

    SearchOptions mOptions;
    bool mVisits;
    SearchEngine mEngine;
};

} // namespace

std::unique_ptr<Method> makeEngineMethod(const MethodSpec& spec, const SearchOptions& options)
{
    SearchOptions own = options;
    own.encoding = spec.encoding;
    return std::make_unique<EngineMethod>(own, spec.visits);
}

} // namespace vdb_nns::cli
