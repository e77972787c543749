#include "bench/methods/set_methods.h"

#include "bench/methods/row_method.h"
#include "machine.h"
#include "vdb_nns/search.h"

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <map>
#include <tbb/enumerable_thread_specific.h>
#include <utility>
#include <vector>

namespace vdb_nns::cli {
namespace {

class FilteredMethod final : public RowMethod {
public:
    explicit FilteredMethod(const SearchOptions& options) : mOptions(options) {}

private:
    struct Worker {
        explicit Worker(RowPool& pool) : rows(pool) {}

        RowWriter rows;
        std::vector<std::pair<double, std::uint32_t>> kept; // distance and number
    };

    void search(const SetSearch& search, MethodRun& result) override
    {
        for (Worker& worker : mWorkers) worker.rows.restart();
        std::fill(mRows.places.begin(), mRows.places.end(),
                  RowBuffers::Place{}); // not every query is visited
        const Stopwatch sortWatch;
        const SearchSets sets =
            mEngine.sort(search.candidates, search.queries, search.largestRadius(), mOptions);
        result.gridSeconds = sortWatch.seconds();
        result.structureBytes = sets.bytes();
        const Stopwatch searchWatch;
        mEngine.visit(
            sets,
            [&](std::uint32_t query, Span<const std::uint32_t> neighbors, Span<const double> distances) {
                search.nearest > 0 ? cut(search.nearest, query, neighbors, distances)
                                   : filter(search, query, neighbors, distances);
            },
            mOptions);
        for (const Worker& worker : mWorkers) result.pairs += worker.rows.pairs();
        result.searchSeconds = searchWatch.seconds();
    }

    void filter(const SetSearch& search, std::uint32_t query, Span<const std::uint32_t> neighbors,
                Span<const double> distances)
    {
        RowWriter& rows = mWorkers.local().rows;
        std::uint32_t* const row = rows.reserve(neighbors.size());
        std::uint32_t count = 0;
        for (std::size_t k = 0; k < neighbors.size(); ++k) {
            row[count] = neighbors[k];
            count += distances[k] <= search.pairRadius(query, neighbors[k]);
        }
        rows.commit(query, count);
    }

    void cut(std::uint32_t nearest, std::uint32_t query, Span<const std::uint32_t> neighbors,
             Span<const double> distances)
    {
        Worker& worker = mWorkers.local();
        worker.kept.clear();
        for (std::size_t k = 0; k < neighbors.size(); ++k)
            worker.kept.emplace_back(distances[k], neighbors[k]);
        std::sort(worker.kept.begin(), worker.kept.end());
        const std::size_t count = std::min<std::size_t>(nearest, neighbors.size());
        std::uint32_t* const row = worker.rows.reserve(count);
        for (std::size_t k = 0; k < count; ++k) row[k] = worker.kept[k].second;
        worker.rows.commit(query, static_cast<std::uint32_t>(count));
    }

    const SearchOptions mOptions;
    SearchEngine mEngine;
    tbb::enumerable_thread_specific<Worker> mWorkers{[this] { return Worker(mPool); }};
};

// ---- octaves ----------------------------------------------------------------------------------------------

// The particles of an octave of radii; what their lists read stays where it is.
struct Octave {
    std::vector<std::uint8_t> chosen;
    double radius = 0; // the largest
    bool areQueries = true;
};

using Octaves = std::vector<std::unique_ptr<const Octave>>;

void addOctaves(Span<const double> radii, bool areQueries, Octaves& octaves)
{
    std::map<int, std::unique_ptr<Octave>> byExponent;
    for (std::size_t i = 0; i < radii.size(); ++i) {
        if (!(radii[i] > 0) || !std::isfinite(radii[i])) continue;
        std::unique_ptr<Octave>& octave = byExponent[std::ilogb(radii[i])];
        if (!octave) {
            octave = std::make_unique<Octave>();
            octave->chosen.resize(radii.size());
            octave->areQueries = areQueries;
        }
        octave->chosen[i] = 1;
        octave->radius = std::max(octave->radius, radii[i]);
    }
    for (auto& [exponent, octave] : byExponent) octaves.push_back(std::move(octave));
}

Octaves octavesOf(const Radius& radius)
{
    Octaves octaves;
    if (radius.mode != RadiusMode::kScatter) addOctaves(radius.ofQueries, true, octaves);
    if (radius.mode != RadiusMode::kGather) addOctaves(radius.ofCandidates, false, octaves);
    return octaves;
}

// What all searches together found of a query, each number once.
class OctaveNeighbors final : public FoundNeighbors {
public:
    OctaveNeighbors(Octaves octaves, std::vector<NeighborLists> lists)
        : mOctaves(std::move(octaves)), mLists(std::move(lists))
    {
    }

    bool hasRows() const override { return true; }
    std::uint64_t count(std::uint32_t query) const override
    {
        std::vector<std::uint32_t> all;
        row(query, all);
        return all.size();
    }
    void row(std::uint32_t query, std::vector<std::uint32_t>& out) const override
    {
        out.clear();
        for (const NeighborLists& lists : mLists) {
            const Span<const std::uint32_t> some = lists.indices(query);
            out.insert(out.end(), some.begin(), some.end());
        }
        std::sort(out.begin(), out.end());
        out.erase(std::unique(out.begin(), out.end()), out.end());
    }
    void visitRows(const RowVisitor& visit) const override
    {
        std::vector<std::uint32_t> all;
        for (std::size_t query = 0; !mLists.empty() && query < mLists.front().size(); ++query) {
            row(static_cast<std::uint32_t>(query), all);
            visit(static_cast<std::uint32_t>(query), {all.data(), all.size()});
        }
    }

private:
    Octaves mOctaves; // lists read who is chosen
    std::vector<NeighborLists> mLists;
};

class OctaveMethod final : public MethodWithResult {
public:
    explicit OctaveMethod(const SearchOptions& options) : mOptions(options)
    {
        mOptions.encoding = Encoding::kIndex;
    }

    MethodRun run(const ParticleView& view, double radius, const ProgressSpan& span) override
    {
        return runSets({view, radius}, span);
    }

    MethodRun runSets(const SetSearch& search, const ProgressSpan& span) override
    {
        discard();
        span.printer.begin("search", span.begin, span.end);
        Octaves octaves = octavesOf(search.radius);
        std::vector<NeighborLists> found;
        MethodRun result;
        for (const auto& octave : octaves) {
            const Span<const std::uint8_t> chosen{octave->chosen.data(), octave->chosen.size()};
            ParticleSet queries = search.queries, candidates = search.candidates;
            (octave->areQueries ? queries : candidates).chosen = chosen;
            const Stopwatch sortWatch;
            const SearchSets sets = mEngine.sort(candidates, queries, octave->radius, mOptions);
            result.gridSeconds += sortWatch.seconds();
            const Stopwatch searchWatch;
            found.push_back(mEngine.search(sets, mOptions));
            result.searchSeconds += searchWatch.seconds();
            result.pairs += found.back().pairCount();
            result.structureBytes = std::max(result.structureBytes, sets.bytes());
            result.listBytes += found.back().bytes();
        }
        mFound = std::make_unique<OctaveNeighbors>(std::move(octaves), std::move(found));
        return result;
    }

private:
    SearchOptions mOptions;
    SearchEngine mEngine;
};

} // namespace

std::unique_ptr<Method> makeFilteredMethod(const SearchOptions& options)
{
    return std::make_unique<FilteredMethod>(options);
}

std::unique_ptr<Method> makeOctaveMethod(const SearchOptions& options)
{
    return std::make_unique<OctaveMethod>(options);
}

} // namespace vdb_nns::cli
