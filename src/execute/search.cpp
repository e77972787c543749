// The search on the CPU: cuts the grid into tasks, runs them on the caller's TBB arena, and keeps memory between runs.
#include "vdb_nns/search.h"

#include "execute/exact_test.h"
#include "execute/kernels.h"
#include "execute/search_task.h"
#include "execute/thread_state.h"
#include "grid/sparse_grid_data.h"
#include "lists/cell_candidates.h"
#include "lists/neighbor_lists_data.h"
#include "util/cancel.h"
#include "vdb_nns/error.h"

#include <tbb/blocked_range.h>
#include <tbb/enumerable_thread_specific.h>
#include <tbb/parallel_for.h>
#include <tbb/parallel_reduce.h>
#include <tbb/task_arena.h>

#include <algorithm>
#include <atomic>
#include <chrono>
#include <cmath>
#include <limits>
#include <string>

namespace vdb_nns {

namespace {

double now()
{
    return std::chrono::duration<double>(std::chrono::steady_clock::now().time_since_epoch()).count();
}

void checkOptions(const SearchOptions& options)
{
    if (options.reach < 0 || options.reach > 3) {
        throw InvalidInput("a reach of " + std::to_string(options.reach) +
                           " cells is not supported: use 1, 2 or 3, or 0 to have it chosen");
    }
    if (options.simd != SimdLevel::kBest &&
        static_cast<int>(options.simd) > static_cast<int>(bestSimdLevel())) {
        throw InvalidInput(std::string("this processor has no ") + simdLevelName(options.simd) + ": use " +
                           simdLevelName(bestSimdLevel()) + " or less");
    }
}

struct Piece {
    std::uint32_t leaf, firstSlot, endSlot;
};

// A leaf each; leaves with many particles in pieces, small enough to keep all threads busy to the end, large enough that
// filling the halo again for each piece stays below a few per cent of its tests.
std::vector<Piece> makePieces(const SparseGridData& grid)
{
    const auto threads = static_cast<std::size_t>(tbb::this_task_arena::max_concurrency());
    const std::size_t most = std::clamp<std::size_t>(grid.particleCount() / (16 * threads), 1024, 16384);
    std::vector<Piece> pieces;
    pieces.reserve(grid.leafCount());
    for (std::uint32_t l = 0; l < grid.leafCount(); ++l) {
        const std::uint64_t first = grid.leaves[l].firstSlot, count = grid.leaves[l + 1].firstSlot - first;
        const std::uint64_t parts = (count + most - 1) / most;
        for (std::uint64_t p = 0; p < parts; ++p) {
            pieces.push_back({l, static_cast<std::uint32_t>(first + count * p / parts),
                              static_cast<std::uint32_t>(first + count * (p + 1) / parts)});
        }
    }
    return pieces;
}

// Runs `run(state, task)` for the pieces, and f(state) after each range of them.
template <typename Run>
void forEachTask(const SparseGridData& grid, const std::vector<Piece>& pieces, ThreadStates& states,
                 const CancelCheck& cancel, Run&& run)
{
    std::atomic<std::uint64_t> done{0};
    const std::size_t grain = std::clamp<std::size_t>(pieces.size() / 4096, 1, 64);
    tbb::parallel_for(tbb::blocked_range<std::size_t>(0, pieces.size(), grain), [&](const auto& range) {
        ThreadState& state = states.local();
        const std::uint32_t firstLeaf = pieces[range.begin()].leaf,
                            endLeaf = pieces[range.end() - 1].leaf + 1;
        state.neighborhoods.resize(endLeaf - firstLeaf);
        grid.topology.neighborhoods({grid.leafOrigins.data() + firstLeaf, endLeaf - firstLeaf},
                                    state.neighborhoods.data());
        std::uint64_t queries = 0;
        for (std::size_t p = range.begin(); p < range.end(); ++p) {
            cancel.check();
            const Piece& piece = pieces[p];
            run(state, SearchTask{piece.leaf, piece.firstSlot, piece.endSlot,
                                  state.neighborhoods[piece.leaf - firstLeaf].leaf});
            queries += piece.endSlot - piece.firstSlot;
        }
        const std::uint64_t total = done.fetch_add(queries) + queries;
        cancel.update(static_cast<double>(total) / static_cast<double>(grid.particleCount()));
    });
}

// Calls f(queries, candidates) for each occupied cell of a leaf that has slots in [first, end): how many of its particles
// are among them, and the particles of the cells in reach.
template <typename F>
void forEachCandidateCount(const SparseGridData& grid, const SearchTask& task, F&& f)
{
    LeafNeighborhood neighborhood;
    std::copy_n(task.neighborhood, 27, neighborhood.leaf);
    forEachOccupiedCell(grid, task.leaf, neighborhood,
                        [&](std::uint32_t cellBegin, std::uint32_t cellEnd, std::uint64_t candidates) {
                            const std::uint32_t begin = std::max(cellBegin, task.firstSlot),
                                                end = std::min(cellEnd, task.endSlot);
                            if (begin < end) f(end - begin, candidates);
                        });
}

std::uint64_t maskBytes(const SparseGridData& grid, const SearchTask& task)
{
    std::uint64_t words = 0;
    forEachCandidateCount(grid, task, [&](std::uint64_t queries, std::uint64_t candidates) {
        words += queries * ((candidates + 31) / 32);
    });
    return words * sizeof(std::uint32_t);
}

std::string gigabytes(std::uint64_t bytes)
{
    char text[64];
    std::snprintf(text, sizeof text, "%llu bytes (%.3g GB)", static_cast<unsigned long long>(bytes),
                  static_cast<double>(bytes) * 1e-9);
    return text;
}

CapacityError listsDoNotFit(Encoding encoding, bool counted, std::uint64_t needed, std::uint64_t allowed)
{
    return CapacityError(std::string(encoding == Encoding::kIndex ? "index lists" : "mask lists") + " need " +
                             (counted ? "" : "at least ") + gigabytes(needed) + ", allowed are " +
                             gigabytes(allowed) + ": " +
                             (encoding == Encoding::kIndex ? "use encoding mask, " : "use ") +
                             "counts alone (encoding none), a smaller radius, or more host memory",
                         needed, allowed);
}

} // namespace

struct SearchEngine::Impl {
    GridScratch scratch;
    std::shared_ptr<SparseGridData> grid;
    std::shared_ptr<NeighborListsData> lists;
    ThreadStates states;
    SearchStatistics statistics;

    // One search: what all its tasks share.
    struct Run {
        const SparseGridData& grid;
        SearchContext context;
        ExactTest exact;
        const Kernels& kernels;
        CancelCheck cancel;
        std::vector<Piece> pieces;

        Run(const SparseGridData& g, const SearchOptions& options)
            : grid(g),
              context{blockViewOf(g), makeFilterBounds(g.radiusCells, g.reach, g.coordinateError)},
              exact(g.view, g.radius),
              kernels(kernelsFor(options.simd)),
              cancel(options.progress, "search"),
              pieces(makePieces(g))
        {
        }
    };

    void beginStatistics(const SearchOptions& options)
    {
        for (ThreadState& state : states) state.begin();
        statistics.simd = options.simd == SimdLevel::kBest ? bestSimdLevel() : options.simd;
    }

    TaskStatistics sumStatistics()
    {
        TaskStatistics sum;
        statistics.exactPairs = 0;
        for (const ThreadState& state : states) {
            sum.pairs += state.statistics.pairs;
            sum.bandPairs += state.statistics.bandPairs;
            statistics.exactPairs += state.exactPairs;
        }
        statistics.doublePairs = sum.bandPairs;
        return sum;
    }

    void runTask(const Run& run, SearchTaskFunction kernel, ThreadState& state, const SearchTask& task)
    {
        state.exact = &run.exact;
        kernel(run.context, task, state.judge(), state.halo, state.sink, state.statistics);
    }

    void checkCapacity(const Run& run, Encoding encoding, std::uint64_t allowed, std::uint32_t* counts);
    void makeRows(const Run& run, const SearchOptions& options, NeighborListsData& result);
    void finish(const Run& run, NeighborListsData& result);
};

// Throws when the lists surely cannot fit. A few queries tell whether there is any doubt; only then all neighbors are
// counted, as far as seconds
// or four times what fits go, so that the error never rests on an estimate.
void SearchEngine::Impl::checkCapacity(const Run& run, Encoding encoding, std::uint64_t allowed,
                                       std::uint32_t* counts)
{
    constexpr std::size_t kProbes = 32;
    constexpr std::uint64_t kMostBytes = std::numeric_limits<std::uint64_t>::max();
    constexpr std::uint64_t kCountedBytes =
        160'000'000'000; // 4e10 pairs: some seconds of counting on two cores
    const std::size_t particles = run.grid.particleCount();
    if (particles == 0) return;
    const auto bytesOf = [&](ThreadState& state, const SearchTask& task) -> std::uint64_t {
        if (encoding == Encoding::kMask) return maskBytes(run.grid, task);
        const std::uint64_t before = state.statistics.pairs;
        state.sink.slotBase = 0;
        state.sink.rowCount = counts;
        runTask(run, run.kernels.count, state, task);
        return (state.statistics.pairs - before) * sizeof(std::uint32_t);
    };
    std::vector<Piece> probes;
    std::size_t p = 0;
    for (std::size_t k = 0; k < std::min(kProbes, particles); ++k) {
        const auto slot = static_cast<std::uint32_t>(particles * k / std::min(kProbes, particles));
        while (run.pieces[p].endSlot <= slot) ++p;
        probes.push_back({run.pieces[p].leaf, slot, slot + 1});
    }
    ThreadState& here = states.local();
    double expected = 0;
    for (const Piece& probe : probes) {
        run.cancel.check();
        LeafNeighborhood neighborhood;
        run.grid.topology.neighborhoods({&run.grid.leafOrigins[probe.leaf], 1}, &neighborhood);
        expected += static_cast<double>(
            bytesOf(here, {probe.leaf, probe.firstSlot, probe.endSlot, neighborhood.leaf}));
    }
    expected *= static_cast<double>(particles) / static_cast<double>(probes.size());
    here.begin();
    if (expected < 0.5 * static_cast<double>(allowed)) return;
    std::atomic<std::uint64_t> total{0};
    const std::uint64_t enough = std::max(kCountedBytes, std::min(allowed, kMostBytes / 4) * 4);
    forEachTask(run.grid, run.pieces, states, run.cancel, [&](ThreadState& state, const SearchTask& task) {
        if (total <= enough) total += bytesOf(state, task);
    });
    for (ThreadState& state : states) state.begin();
    if (total > allowed) throw listsDoNotFit(encoding, total <= enough, total, allowed);
}

void SearchEngine::Impl::makeRows(const Run& run, const SearchOptions& options, NeighborListsData& result)
{
    const std::size_t particles = run.grid.particleCount();
    const bool index = options.encoding == Encoding::kIndex;
    result.rowCount.resizeDiscarding(particles);
    if (index) result.rowBegin.resizeDiscarding(particles);
    std::uint64_t allowed = 0;
    ChunkPool pool(std::move(result.chunks));
    if (options.encoding != Encoding::kNone) {
        const std::uint64_t held =
            run.grid.bytes() + result.rowCount.usedBytes() + result.rowBegin.usedBytes();
        allowed = options.hostMemoryBytes ? options.hostMemoryBytes - std::min(held, options.hostMemoryBytes)
                                          : availableMemoryBytes() + pool.freeBytes();
        checkCapacity(run, options.encoding, allowed, result.rowCount.data());
        pool.begin(allowed, particles);
    }
    const SearchTaskFunction kernel = index                                 ? run.kernels.index
                                      : options.encoding == Encoding::kMask ? run.kernels.mask
                                                                            : run.kernels.count;
    try {
        forEachTask(run.grid, run.pieces, states, run.cancel,
                    [&](ThreadState& state, const SearchTask& task) {
                        state.pool = &pool;
                        state.sink.slotBase = 0;
                        state.sink.rowBegin = result.rowBegin.data();
                        state.sink.rowCount = result.rowCount.data();
                        runTask(run, kernel, state, task);
                        if (kernel == run.kernels.mask)
                            state.maskRuns.push_back({task.firstSlot, state.sink.taskBegin});
                    });
    } catch (const ChunkPool::Exhausted&) {
        throw listsDoNotFit(options.encoding, false, pool.takenBytes(), allowed);
    }
    for (ThreadState& state : states) state.finishRows();
    result.chunks = pool.release();
}

// Statistics, the order of mask rows, and the way from a particle's number to its slot.
void SearchEngine::Impl::finish(const Run& run, NeighborListsData& result)
{
    const std::size_t particles = run.grid.particleCount(), all = result.view.size();
    const TaskStatistics sum = sumStatistics();
    result.maskRuns.clear();
    for (const ThreadState& state : states) {
        result.maskRuns.insert(result.maskRuns.end(), state.maskRuns.begin(), state.maskRuns.end());
    }
    std::sort(result.maskRuns.begin(), result.maskRuns.end(),
              [](const MaskRun& a, const MaskRun& b) { return a.firstSlot < b.firstSlot; });
    result.slotOf.resizeDiscarding(all);
    if (particles < all) std::fill(result.slotOf.begin(), result.slotOf.end(), kNoSlot);
    ListStatistics start;
    start.min = std::numeric_limits<std::uint32_t>::max();
    const auto range = tbb::blocked_range<std::size_t>(0, particles, 8192);
    ListStatistics statistics = tbb::parallel_reduce(
        range, start,
        [&](const auto& r, ListStatistics s) {
            for (std::size_t slot = r.begin(); slot < r.end(); ++slot) {
                const std::uint32_t count = result.rowCount[slot];
                s.min = std::min(s.min, count);
                s.max = std::max(s.max, count);
                s.isolated += count == 0;
                result.slotOf[run.grid.number[slot]] = static_cast<std::uint32_t>(slot);
            }
            return s;
        },
        [](ListStatistics a, const ListStatistics& b) {
            a.min = std::min(a.min, b.min);
            a.max = std::max(a.max, b.max);
            a.isolated += b.isolated;
            return a;
        });
    if (particles < all || all == 0) statistics.min = 0;
    statistics.isolated += all - particles;
    statistics.pairs = sum.pairs;
    statistics.mean = all ? static_cast<double>(sum.pairs) / static_cast<double>(all) : 0;
    result.statistics = statistics;
    result.rowBytes = 0;
    if (result.encoding == Encoding::kIndex) result.rowBytes = sum.pairs * 4;
    if (result.encoding == Encoding::kMask) {
        for (const ThreadState& state : states) result.rowBytes += state.maskBytes;
    }
}

SearchEngine::SearchEngine() : mImpl(std::make_unique<Impl>()) {}
SearchEngine::~SearchEngine() = default;
SearchEngine::SearchEngine(SearchEngine&&) noexcept = default;
SearchEngine& SearchEngine::operator=(SearchEngine&&) noexcept = default;

const SearchStatistics& SearchEngine::statistics() const
{
    return mImpl->statistics;
}

SparseGrid SearchEngine::buildGrid(const ParticleView& view, double radius, const SearchOptions& options)
{
    if (!(radius > 0) || std::isinf(radius)) {
        throw InvalidInput("radius " + std::to_string(radius) + " is not a positive finite number");
    }
    checkOptions(options);
    const double start = now();
    // The last lists hold the last grid; when nobody else reads them they let go of it.
    if (mImpl->lists && mImpl->lists.use_count() == 1) mImpl->lists->grid = SparseGrid();
    if (!mImpl->grid || mImpl->grid.use_count() > 1) mImpl->grid = std::make_shared<SparseGridData>();
    buildSparseGrid(view, radius, options, mImpl->scratch, *mImpl->grid);
    mImpl->statistics.gridSeconds = now() - start;
    return SparseGrid(mImpl->grid);
}

NeighborLists SearchEngine::search(const SparseGrid& grid, const SearchOptions& options)
{
    checkOptions(options);
    const double start = now();
    // Of the engine's own last lists only the memory is used again, and only when nobody else reads them.
    std::shared_ptr<NeighborListsData> result = std::make_shared<NeighborListsData>();
    if (mImpl->lists && mImpl->lists.use_count() == 1) {
        result->slotOf = std::move(mImpl->lists->slotOf);
        result->rowCount = std::move(mImpl->lists->rowCount);
        result->rowBegin = std::move(mImpl->lists->rowBegin);
        result->chunks = std::move(mImpl->lists->chunks);
    }
    mImpl->lists.reset();
    result->view = grid.view();
    result->grid = grid;
    result->encoding = options.encoding;
    const Impl::Run run(grid.data(), options);
    mImpl->beginStatistics(options);
    mImpl->makeRows(run, options, *result);
    mImpl->finish(run, *result);
    mImpl->lists = std::move(result);
    mImpl->statistics.searchSeconds = now() - start;
    return NeighborLists(mImpl->lists);
}

void SearchEngine::visit(const SparseGrid& grid, const NeighborVisitor& visitor, const SearchOptions& options)
{
    checkOptions(options);
    const double start = now();
    const Impl::Run run(grid.data(), options);
    mImpl->beginStatistics(options);
    forEachTask(run.grid, run.pieces, mImpl->states, run.cancel,
                [&](ThreadState& state, const SearchTask& task) {
                    state.beginVisit(run.grid, visitor, task);
                    mImpl->runTask(run, run.kernels.visit, state, task);
                    state.flushVisit();
                });
    mImpl->sumStatistics();
    mImpl->statistics.searchSeconds = now() - start;
}

std::uint64_t countCandidateTests(const SparseGrid& grid)
{
    if (grid.empty()) return 0;
    std::atomic<std::uint64_t> tests{0};
    ThreadStates states;
    forEachTask(grid.data(), makePieces(grid.data()), states, CancelCheck(nullptr, "count"),
                [&](ThreadState&, const SearchTask& task) {
                    std::uint64_t sum = 0;
                    forEachCandidateCount(grid.data(), task,
                                          [&](std::uint64_t queries, std::uint64_t candidates) {
                                              sum += queries * candidates;
                                          });
                    tests += sum;
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
