#include "bench/methods/engine_methods.h"

#include "machine.h"
#include "vdb_nns/search.h"
#include "vdb_nns/search_job.h"

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
        find(grid, mOptions, result);
        return result;
    }

    MethodRun runSets(const SetSearch& search, const ProgressSpan& span) override
    {
        discard();
        span.printer.begin("search", span.begin, span.end);
        SearchOptions options = mOptions;
        options.nearest = search.nearest;
        MethodRun result;
        const Stopwatch sortWatch;
        const SearchSets sets = mEngine.sort(search.candidates, search.queries, search.radius, options);
        result.gridSeconds = sortWatch.seconds();
        result.structureBytes = sets.bytes();
        find(sets, options, result);
        return result;
    }

    // As a job makes them beside its lists, or, where rows are not kept, in a pass of their own.
    Measured measure(const SetSearch& search, const std::vector<std::string>& names,
                     const MeasureOptions& measures, const ProgressSpan& span) override
    {
        discard();
        span.printer.begin("measure", span.begin, span.end);
        SearchOptions options = mOptions;
        options.nearest = search.nearest;
        if (mVisits) {
            MeasureOptions own = measures;
            own.search = options;
            return mEngine.measure(mEngine.sort(search.candidates, search.queries, search.radius, options),
                                   names, own);
        }
        JobOptions job;
        job.search = options;
        job.measures = names;
        job.measure = measures;
        JobReport report;
        Measured made;
        made.counts = mEngine.findNeighbors(search.candidates, search.queries, search.radius, job, report);
        made.values = std::move(report.measured);
        made.skipped = std::move(report.measureSkipped);
        return made;
    }

private:
    void find(const SearchSets& sets, const SearchOptions& options, MethodRun& result)
    {
        mVisits ? visit(sets, options, result) : list(sets, options, result);
    }

    void list(const SearchSets& sets, const SearchOptions& options, MethodRun& result)
    {
        const Stopwatch watch;
        const NeighborLists lists = mEngine.search(sets, options);
        result.searchSeconds = watch.seconds();
        result.pairs = lists.pairCount();
        result.listBytes = lists.bytes();
        mFound = std::make_unique<EngineNeighbors>(lists);
    }

    // The least that a visitor can do: it counts. What a solver would sum up instead costs its own.
    void visit(const SearchSets& sets, const SearchOptions& options, MethodRun& result)
    {
        std::vector<std::uint32_t> counts(sets.rowCount());
        const Stopwatch watch;
        mEngine.visitRows(
            sets,
            [&counts](std::uint32_t query, Span<const std::uint32_t> neighbors) {
                counts[query] = static_cast<std::uint32_t>(neighbors.size());
            },
            options);
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
