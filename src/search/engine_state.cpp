// What all searches of an engine have in common: the checks before, the memory of lists, tasks, and the lists at the end.
#include "search/engine_state.h"

#include "grid/lattice.h"
#include "lists/cell_candidates.h"
#include "util/known_value.h"
#include "util/sole_owner.h"
#include "vdb_nns/error.h"

#include <tbb/parallel_reduce.h>
#include <tbb/task_arena.h>

#include <algorithm>
#include <atomic>
#include <limits>
#include <string>

namespace vdb_nns {

namespace {

std::string gigabytes(std::uint64_t bytes)
{
    char text[64];
    std::snprintf(text, sizeof text, "%llu bytes (%.3g GB)", static_cast<unsigned long long>(bytes),
                  static_cast<double>(bytes) * 1e-9);
    return text;
}

// Both are on it.
const Lattice& sharedLattice(const SparseGridData& queries, const SparseGridData& candidates)
{
    if (!shareLattice(queries, candidates)) {
        throw InvalidInput(
            "queries and candidates are sorted on different lattices, or their stored positions "
            "mean different places: build both grids on one lattice");
    }
    return queries.lattice;
}

} // namespace

void checkOptions(const SearchOptions& options)
{
    if (options.radius != 0) checkRadius(options.radius);
    requireKnown(options.encoding, Encoding::kNone, "encoding");
    requireKnown(options.nonfinite, NonFinite::kFail, "treatment of non-finite particles");
    requireKnown(options.simd, SimdLevel::kBest, "instruction set");
    const double size = options.cellSize;
    if (size != 0 && !(size >= SearchOptions::kSmallestCell && size <= SearchOptions::kLargestCell)) {
        throw InvalidInput("cells of " + std::to_string(size) +
                           " radii are not supported: use 0.33 to 4, or 0 to have it chosen");
    }
    if (options.simd != SimdLevel::kBest &&
        static_cast<int>(options.simd) > static_cast<int>(bestSimdLevel())) {
        throw InvalidInput(std::string("this processor has no ") + simdLevelName(options.simd) + ": use " +
                           simdLevelName(bestSimdLevel()) + " or less");
    }
}

CapacityError listsDoNotFit(Encoding encoding, bool counted, std::uint64_t needed, std::uint64_t allowed)
{
    return CapacityError(
        std::string(encoding == Encoding::kIndex ? "index lists" : "mask lists") + " need " +
            (counted ? "" : "at least ") + gigabytes(needed) + ", allowed are " + gigabytes(allowed) + ": " +
            (encoding == Encoding::kIndex ? "use encoding mask, " : "use a smaller cell size, ") +
            "counts alone (encoding none), a smaller radius, or more host memory",
        needed, allowed);
}

SearchRun::SearchRun(const SparseGridData& queriesOfRun, const SparseGridData& candidatesOfRun,
                     const SearchOptions& options)
    : queries(queriesOfRun),
      candidates(candidatesOfRun),
      radius(searchRadius(sharedLattice(queries, candidates), options.radius)),
      context{blockViewOf(candidates),
              makeFilterBounds(radiusInCells(candidates.lattice, radius), candidates.reach(),
                               std::max(queries.coordinateError, candidates.coordinateError)),
              pollOf(cancel)},
      exact(candidates.view, radius),
      kernels(kernelsFor(options.simd)),
      cancel(options.progress, "search"),
      pieces(makePieces(queries))
{
}

SearchTaskFunction SearchRun::rowKernel(Encoding encoding) const
{
    return encoding == Encoding::kIndex  ? kernels.index
           : encoding == Encoding::kMask ? kernels.mask
                                         : kernels.count;
}

void EngineState::beginStatistics(const SearchOptions& options)
{
    for (ThreadState& state : states) state.begin();
    statistics.simd = options.simd == SimdLevel::kBest ? bestSimdLevel() : options.simd;
}

TaskStatistics EngineState::sumStatistics()
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

void EngineState::runTask(const SearchRun& run, SearchTaskFunction kernel, ThreadState& state,
                          const SearchTask& task)
{
    state.decideBy(run.exact, run.cancel);
    kernel(run.context, task, state.exactPredicate(), state.halo, state.sink, state.statistics);
}

// Throws when the lists surely cannot fit. A few queries tell whether there is any doubt; only then all neighbors are
// counted, as far as seconds or four times what fits go, so that the error never rests on an estimate.
void EngineState::checkCapacity(const SearchRun& run, Encoding encoding, std::uint64_t allowed,
                                std::uint32_t* counts)
{
    constexpr std::size_t kProbes = 32;
    constexpr std::uint64_t kMostBytes = std::numeric_limits<std::uint64_t>::max();
    constexpr std::uint64_t kCountedBytes =
        160'000'000'000; // 4e10 pairs: some seconds of counting on two cores
    const std::size_t particles = run.queries.particleCount();
    if (particles == 0) return;
    const auto bytesOf = [&](ThreadState& state, const SearchTask& task) -> std::uint64_t {
        if (encoding == Encoding::kMask) return maskBytes(run.context.block, task);
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
        run.candidates.topology.neighborhoods({&run.queries.leafOrigins[probe.leaf], 1}, &neighborhood);
        expected += static_cast<double>(
            bytesOf(here, {probe.leaf, probe.firstSlot, probe.endSlot, neighborhood.leaf}));
    }
    expected *= static_cast<double>(particles) / static_cast<double>(probes.size());
    here.begin();
    if (expected < 0.5 * static_cast<double>(allowed)) return;
    std::atomic<std::uint64_t> total{0};
    const std::uint64_t enough = std::max(kCountedBytes, std::min(allowed, kMostBytes / 4) * 4);
    forEachTask(run.queries, run.pieces, states, run.cancel, [&](ThreadState& state, const SearchTask& task) {
        if (total <= enough) total += bytesOf(state, task);
    });
    for (ThreadState& state : states) state.begin();
    if (total > allowed) throw listsDoNotFit(encoding, total <= enough, total, allowed);
}

std::shared_ptr<NeighborListsData> EngineState::beginLists(const SparseGrid& sparseGrid, double radius,
                                                           Encoding encoding)
{
    std::shared_ptr<NeighborListsData> result = std::make_shared<NeighborListsData>();
    if (isSoleOwner(lists)) {
        result->slotOf = std::move(lists->slotOf);
        result->rowCount = std::move(lists->rowCount);
        result->rowBegin = std::move(lists->rowBegin);
        result->chunks = std::move(lists->chunks);
    }
    lists.reset();
    result->view = sparseGrid.view();
    result->grid = sparseGrid;
    result->radius = radius;
    result->encoding = encoding;
    return result;
}

std::uint64_t EngineState::allowRows(const SearchRun& run, const SearchOptions& options,
                                     std::uint64_t otherBytes, NeighborListsData& result, ChunkPool& pool)
{
    const std::size_t particles = run.queries.particleCount();
    result.rowCount.resizeDiscarding(particles);
    if (result.encoding == Encoding::kIndex) result.rowBegin.resizeDiscarding(particles);
    const std::uint64_t held =
        run.queries.bytes() + result.rowCount.usedBytes() + result.rowBegin.usedBytes();
    std::uint64_t free = options.hostMemoryBytes
                             ? options.hostMemoryBytes - std::min(held, options.hostMemoryBytes)
                             : availableMemoryBytes() + pool.freeBytes();
    if (!options.hostMemoryBytes) {
        for (const OpenedDevice& opened : devices) free += opened.hostBytes;
    }
    if (otherBytes > free) {
        throw CapacityError("the buffers of the devices need " + gigabytes(otherBytes) +
                                " of host memory, allowed are " + gigabytes(free) +
                                ": allow more host memory or give devices less",
                            otherBytes, free);
    }
    if (result.encoding == Encoding::kNone) return 0;
    const std::uint64_t allowed = free - otherBytes;
    checkCapacity(run, result.encoding, allowed, result.rowCount.data());
    pool.begin(allowed, particles);
    return allowed;
}

void EngineState::makeRows(const SearchRun& run, const SearchTask& task, ThreadState& state, ChunkPool& pool,
                           NeighborListsData& result)
{
    state.pool = &pool;
    state.sink.slotBase = 0;
    state.sink.rowBegin = result.rowBegin.data();
    state.sink.rowCount = result.rowCount.data();
    runTask(run, run.rowKernel(result.encoding), state, task);
    if (result.encoding != Encoding::kMask) return;
    state.maskRuns.push_back({task.firstSlot, state.sink.taskBegin});
    state.maskBytes +=
        static_cast<std::uint64_t>(state.sink.out - state.sink.taskBegin) * sizeof(std::uint32_t);
}

void EngineState::finishLists(const SearchRun& run, ChunkPool& pool, NeighborListsData& result)
{
    for (ThreadState& state : states) state.finishRows();
    result.chunks = pool.release();
    const std::size_t particles = run.queries.particleCount(), all = result.view.size();
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
            run.cancel.check();
            for (std::size_t slot = r.begin(); slot < r.end(); ++slot) {
                const std::uint32_t count = result.rowCount[slot];
                s.min = std::min(s.min, count);
                s.max = std::max(s.max, count);
                s.isolated += count == 0;
                result.slotOf[run.queries.number[slot]] = static_cast<std::uint32_t>(slot);
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

} // namespace vdb_nns
