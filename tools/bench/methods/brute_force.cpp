// All pairs: what needs no structure, and what a structure has to beat. World positions in doubles, radii as
// they are given.
#include "bench/methods/ablation_kernels.h"
#include "bench/methods/peers.h"
#include "machine.h"

#include <tbb/blocked_range.h>
#include <tbb/enumerable_thread_specific.h>
#include <tbb/parallel_for.h>

#include <algorithm>
#include <cstddef>
#include <numeric>
#include <utility>
#include <vector>

namespace vdb_nns::cli {
namespace {

constexpr std::uint32_t kTile = 512;   // candidates: 14 KB, half of the first-level cache
constexpr std::uint32_t kQueries = 32; // that a tile is read for

class BruteForce final : public RowMethod {
private:
    struct Worker {
        explicit Worker(RowPool& pool) : rows(pool), hits(kTile + kVectorSlack), found(kQueries) {}

        RowWriter rows;
        std::vector<std::uint32_t> hits;
        std::vector<std::vector<std::uint32_t>> found; // by query of a task
    };

    void search(const SetSearch& sets, MethodRun& result) override
    {
        if (!sets.isPlain()) return searchSets(sets, result);
        const ParticleView& view = sets.queries.view;
        const double radius = sets.radius.value;
        for (std::vector<double>& axis : mAxes) axis.resize(view.size() + kVectorSlack);
        mNumbers.resize(view.size() + kVectorSlack);
        std::iota(mNumbers.begin(), mNumbers.end(), 0u);
        for (std::size_t i = 0; i < view.size(); ++i) {
            const Vec3d at = view.worldPosition(i);
            for (std::size_t k = 0; k < 3; ++k) mAxes[k][i] = at[k];
        }
        const Stopwatch watch;
        for (Worker& worker : mWorkers) worker.rows.restart();
        tbb::parallel_for(
            tbb::blocked_range<std::uint32_t>(0, static_cast<std::uint32_t>(view.size()), kQueries),
            [&](const tbb::blocked_range<std::uint32_t>& range) {
                throwIfStopped();
                Worker& worker = mWorkers.local();
                for (std::uint32_t q = range.begin(); q < range.end(); q += kQueries) {
                    searchQueries(q, std::min(q + kQueries, range.end()), radius * radius, worker);
                }
            });
        for (const Worker& worker : mWorkers) result.pairs += worker.rows.pairs();
        result.searchSeconds = watch.seconds();
    }

    void searchQueries(std::uint32_t begin, std::uint32_t end, double radiusSquared, Worker& worker)
    {
        const std::uint32_t particles = static_cast<std::uint32_t>(mNumbers.size() - kVectorSlack);
        double *const x = mAxes[0].data(), *const y = mAxes[1].data(), *const z = mAxes[2].data();
        std::uint32_t* const hits = worker.hits.data();
        for (std::vector<std::uint32_t>& row : worker.found) row.clear();
        for (std::uint32_t tile = 0; tile < particles; tile += kTile) {
            const CandidateArrays<double> candidates{x + tile, y + tile, z + tile, mNumbers.data() + tile};
            const std::uint32_t count = std::min(kTile, particles - tile);
            for (std::uint32_t q = begin; q < end; ++q) {
                const std::uint32_t found =
                    mTest(candidates, count, {x[q], y[q], z[q], q}, {radiusSquared, 0}, hits, nullptr).count;
                std::vector<std::uint32_t>& row = worker.found[q - begin];
                if (found > 0) row.insert(row.end(), hits, hits + found);
            }
        }
        for (std::uint32_t q = begin; q < end; ++q) {
            const std::vector<std::uint32_t>& row = worker.found[q - begin];
            worker.rows.append(q, row.data(), row.size());
        }
    }

    // The loop that one writes who has roles, radii of particles or wants the nearest.
    void searchSets(const SetSearch& sets, MethodRun& result)
    {
        const Members<double> members = membersOf<double>(sets.candidates);
        const std::vector<double> queries = worldPositions<double>(sets.queries.view);
        const Stopwatch watch;
        for (Worker& worker : mWorkers) worker.rows.restart();
        tbb::parallel_for(
            tbb::blocked_range<std::size_t>(0, queries.size() / 3, kQueries), [&](const auto& range) {
                throwIfStopped();
                std::vector<std::pair<double, std::uint32_t>> hits; // squared distance and number
                std::vector<std::uint32_t> row;
                for (std::size_t i = range.begin(); i < range.end(); ++i) {
                    if (!sets.hasQuery(i)) continue;
                    findHits(sets, members, i, queries.data() + 3 * i, hits);
                    row.clear();
                    for (const auto& hit : hits) row.push_back(hit.second);
                    mWorkers.local().rows.append(static_cast<std::uint32_t>(i), row.data(), row.size());
                }
            });
        for (const Worker& worker : mWorkers) result.pairs += worker.rows.pairs();
        result.searchSeconds = watch.seconds();
    }

    static void findHits(const SetSearch& sets, const Members<double>& members, std::size_t query,
                         const double* at, std::vector<std::pair<double, std::uint32_t>>& hits)
    {
        hits.clear();
        for (std::size_t k = 0; 3 * k < members.xyz.size(); ++k) {
            const std::uint32_t number = members.number(static_cast<std::uint32_t>(k));
            if (sets.isOneSet() && number == query) continue;
            const double* const p = members.xyz.data() + 3 * k;
            const double dx = p[0] - at[0], dy = p[1] - at[1], dz = p[2] - at[2];
            const double square = dx * dx + dy * dy + dz * dz, radius = sets.pairRadius(query, number);
            if (square <= radius * radius) hits.emplace_back(square, number);
        }
        if (sets.nearest == 0 || hits.size() <= sets.nearest) return;
        std::nth_element(hits.begin(), hits.begin() + static_cast<std::ptrdiff_t>(sets.nearest), hits.end());
        hits.resize(sets.nearest);
    }

    const TestFunction<double> mTest = ablationKernels<double>(SimdLevel::kBest).test;
    std::vector<double> mAxes[3];
    std::vector<std::uint32_t> mNumbers;
    tbb::enumerable_thread_specific<Worker> mWorkers{[this] { return Worker(mPool); }};
};

} // namespace

std::unique_ptr<Method> makeBruteForce()
{
    return std::make_unique<BruteForce>();
}

} // namespace vdb_nns::cli
