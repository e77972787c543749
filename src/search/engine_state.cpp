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

} // namespace

void checkOptions(const SearchOptions& options)
{
    if (options.radius != 0) checkRadius(options.radius);
    requireKnown(options.encoding, Encoding::kNone, "encoding");
    if (options.nearest > 0 && options.encoding == Encoding::kMask) {
        throw InvalidInput("masks hold whole lists, not the nearest " + std::to_string(options.nearest) +
                           ": use encoding index or none");
    }
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

bool isPlainSearch(const SearchSetsData& sets, const SearchPart& part, const SearchOptions& options)
{
    return part.queries == part.own.candidates && sets.radius.isOne() && options.nearest == 0 &&
           !options.includeSelf;
}

namespace {

const RowKernels& kernelsOf(const SearchSetsData& sets, bool isPlain, const SearchOptions& options)
{
    const Kernels& kernels = kernelsFor(options.simd);
    if (isPlain) return kernels.plain;
    const bool byLarger = !sets.radius.isOne() && sets.radius.mode != RadiusMode::kGather;
    const SetKernels& ofSets = byLarger ? kernels.largerRadius : kernels.queryRadius;
    return options.nearest > 0 ? ofSets.nearest : ofSets.whole;
}

// Among the candidates of one layer.
SearchContext contextOf(const SearchSetsData& sets, const SearchPart& part, const SearchLayer& layer,
                        const SearchOptions& options, const CancelCheck& cancel)
{
    SearchContext context{blockViewOf(*layer.candidates), layer.bounds, pollOf(cancel)};
    context.sets.queries = blockViewOf(*part.queries);
    context.sets.queryFar = part.queryFar && layer.octaves == 0 ? part.queryFar->data() : nullptr;
    context.sets.farOfQueries = layer.farOfQueries;
    context.sets.candidateFar = layer.candidateFar ? layer.candidateFar->data() : nullptr;
    context.sets.excludesSelf = sets.areSameParticles() && !options.includeSelf;
    context.sets.addsSelf = options.includeSelf;
    context.sets.nearest = options.nearest;
    context.sets.nearestDoubt = layer.nearestDoubt;
    return context;
}

// One more of the nearest on each lattice than is wanted of all tells whether there are more.
std::vector<LayerRun> layersOf(const SearchSetsData& sets, const SearchPart& part,
                               const SearchOptions& options, const CancelCheck& cancel)
{
    if (part.wider.empty()) return {};
    std::vector<LayerRun> layers;
    const auto add = [&](const SearchLayer& layer) {
        layers.push_back(
            {layer.candidates.get(), layer.octaves, contextOf(sets, part, layer, options, cancel)});
        std::uint32_t& nearest = layers.back().context.sets.nearest;
        if (nearest > 0 && nearest < std::numeric_limits<std::uint32_t>::max()) ++nearest;
    };
    add(part.own);
    for (const SearchLayer& layer : part.wider) add(layer);
    return layers;
}

} // namespace

SearchRun::SearchRun(const SearchSetsData& searchSets, const SearchPart& searchPart,
                     const SearchOptions& options)
    : queries(*searchPart.queries),
      candidates(*searchPart.own.candidates),
      sets(searchSets),
      part(searchPart),
      firstRow(part.firstRow),
      context(contextOf(sets, part, part.own, options, cancel)),
      layers(layersOf(sets, part, options, cancel)),
      exact(sets.queries, sets.candidates, sets.radius, sets.largestRadius),
      kernels(kernelsOf(sets, isPlainSearch(sets, part, options), options)),
      cancel(options.progress, "search"),
      pieces(makePieces(queries)),
      mIsPlain(isPlainSearch(sets, part, options))
{
}

std::uint32_t SearchRun::entriesKept(std::uint32_t slot, std::uint32_t entries) const
{
    const SetContext& how = context.sets;
    if (how.nearest == 0) return entries;
    const std::uint32_t self = how.addsSelf && sets.isCandidate(queries.number[slot]);
    return std::min(entries - self, how.nearest) + self;
}

SearchRuns::SearchRuns(const SearchSets& sets, const SearchOptions& options) : mSets(sets)
{
    const SearchSetsData& data = sets.data();
    if (options.includeSelf && !data.areSameParticles()) {
        throw InvalidInput("a query can stand in its own list only where queries and candidates are the same "
                           "particles: leave includeSelf out");
    }
    for (const SearchPart& part : data.parts) {
        SearchOptions ofPart = options;
        if (options.progress && data.parts.size() > 1) {
            mProgress.push_back(std::make_unique<ProgressShare>(shareOf(part, *options.progress)));
            ofPart.progress = mProgress.back().get();
        }
        mRuns.push_back(std::make_unique<SearchRun>(data, part, ofPart));
    }
}

ProgressShare SearchRuns::shareOf(const SearchPart& part, Progress& whole) const
{
    const double rows = std::max(1.0, static_cast<double>(rowCount()));
    const double from = part.firstRow / rows;
    return {whole, from, from + static_cast<double>(part.queries->particleCount()) / rows};
}

Progress* SearchRuns::progressOf(const SearchRun& run, Progress* whole,
                                 std::optional<ProgressShare>& share) const
{
    if (!whole) return nullptr;
    share.emplace(shareOf(run.part, *whole));
    return &*share;
}

namespace {

SearchTaskFunction kernelOf(const RowKernels& kernels, RowKind kind)
{
    return kind == RowKind::kIndex     ? kernels.index
           : kind == RowKind::kVisit   ? kernels.visit
           : kind == RowKind::kSmaller ? kernels.smaller
           : kind == RowKind::kHalf    ? kernels.half
           : kind == RowKind::kMask    ? kernels.mask
                                       : kernels.count;
}

RowKind kindOf(Encoding encoding)
{
    return encoding == Encoding::kIndex  ? RowKind::kIndex
           : encoding == Encoding::kMask ? RowKind::kMask
                                         : RowKind::kCount;
}

} // namespace

void SearchRun::makeRows(RowKind kind, const SearchTask& task, ThreadState& state, RowSink& sink) const
{
    state.decideBy(exact, cancel);
    if (layers.empty()) {
        kernelOf(kernels, kind)(context, task, state.exactPredicate(), state.halo, sink, state.statistics);
    } else {
        // Other parts of the search may stream their rows to the same memory.
        if (kind == RowKind::kIndex) ThreadState::beginPlainRows(sink);
        state.layered.make(*this, kind, task, state, sink);
        if (kind == RowKind::kIndex) ThreadState::endPlainRows(sink);
    }
}

ListWork listWork(const SearchRun& run, const SearchTask& task)
{
    ListWork work;
    const auto add = [&](const BlockView& candidatesBlock, const SearchTask& ofLayer) {
        forEachCandidateCount(run.context.sets.queries, candidatesBlock, ofLayer,
                              [&](std::uint64_t queries, std::uint64_t candidates) {
                                  work.candidateTests += queries * candidates;
                                  work.maskBytes += queries * maskWords(candidates) * sizeof(std::uint32_t);
                              });
    };
    add(run.context.block, task);
    for (const LayerRun& layer : run.layers) {
        LayerTask layerTask;
        if (layer.octaves > 0 &&
            findLayerTask(run.queries, *layer.candidates, layer.octaves, task, layerTask))
            add(layer.context.block, layerTask.task);
    }
    return work;
}

ListWork countListWork(const SearchRuns& runs, Progress* progress, const char* step)
{
    std::atomic<std::uint64_t> tests{0}, bytes{0};
    ThreadStates states;
    runs.forEach([&](const SearchRun& run) {
        std::optional<ProgressShare> share;
        const CancelCheck cancel(runs.progressOf(run, progress, share), step);
        forEachTask(run.queries, run.candidates, run.pieces, states, cancel,
                    [&](ThreadState&, const SearchTask& task) {
                        const ListWork work = listWork(run, task);
                        tests += work.candidateTests;
                        bytes += work.maskBytes;
                    });
    });
    return {tests, bytes};
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
        sum.shortened += state.statistics.shortened;
        statistics.exactPairs += state.exactPairs;
    }
    statistics.doublePairs = sum.bandPairs;
    return sum;
}

// Throws when the lists surely cannot fit. A few queries tell whether there is any doubt; only then all neighbors are
// counted, as far as seconds or four times what fits go, so that the error never rests on an estimate.
void EngineState::checkCapacity(const SearchRuns& runs, Encoding encoding, std::uint64_t allowed,
                                std::uint32_t* counts)
{
    constexpr std::size_t kProbes = 32;
    constexpr std::uint64_t kMostBytes = std::numeric_limits<std::uint64_t>::max();
    constexpr std::uint64_t kCountedBytes =
        160'000'000'000; // 4e10 pairs: some seconds of counting on two cores
    const auto bytesOf = [&](const SearchRun& run, ThreadState& state,
                             const SearchTask& task) -> std::uint64_t {
        if (encoding == Encoding::kMask) return listWork(run, task).maskBytes;
        const std::uint64_t before = state.statistics.pairs;
        state.sink.slotBase = 0;
        state.sink.rowCount = counts + run.firstRow;
        run.makeRows(RowKind::kCount, task, state, state.sink);
        std::uint64_t pairs = state.statistics.pairs - before;
        if (run.context.sets.nearest > 0) {
            pairs = 0;
            for (std::uint32_t slot = task.firstSlot; slot < task.endSlot; ++slot)
                pairs += run.entriesKept(slot, state.sink.rowCount[slot]);
        }
        return pairs * sizeof(std::uint32_t);
    };
    ThreadState& here = states.local();
    double expected = 0;
    runs.forEach([&](const SearchRun& run) {
        const std::size_t particles = run.queries.particleCount(), probes = std::min(kProbes, particles);
        std::size_t p = 0;
        double sum = 0;
        for (std::size_t k = 0; k < probes; ++k) {
            const auto slot = static_cast<std::uint32_t>(particles * k / probes);
            while (run.pieces[p].endSlot <= slot) ++p;
            run.cancel.check();
            const std::uint32_t leaf = run.pieces[p].leaf;
            LeafNeighborhood neighborhood;
            run.candidates.topology.neighborhoods({&run.queries.leafOrigins[leaf], 1}, &neighborhood);
            sum += static_cast<double>(bytesOf(run, here, {leaf, slot, slot + 1, neighborhood.leaf}));
        }
        if (probes > 0) expected += sum * static_cast<double>(particles) / static_cast<double>(probes);
    });
    here.begin();
    if (expected < 0.5 * static_cast<double>(allowed)) return;
    std::atomic<std::uint64_t> total{0};
    const std::uint64_t enough = std::max(kCountedBytes, std::min(allowed, kMostBytes / 4) * 4);
    runs.forEach([&](const SearchRun& run) {
        forEachTask(run.queries, run.candidates, run.pieces, states, run.cancel,
                    [&](ThreadState& state, const SearchTask& task) {
                        if (total <= enough) total += bytesOf(run, state, task);
                    });
    });
    for (ThreadState& state : states) state.begin();
    if (total > allowed) throw listsDoNotFit(encoding, total <= enough, total, allowed);
}

std::shared_ptr<NeighborListsData> EngineState::beginLists(const SearchSets& sets, Encoding encoding,
                                                           const SearchOptions& options)
{
    std::shared_ptr<NeighborListsData> result = std::make_shared<NeighborListsData>();
    if (isSoleOwner(lists)) {
        result->slotOf = std::move(lists->slotOf);
        result->rowCount = std::move(lists->rowCount);
        result->rowBegin = std::move(lists->rowBegin);
        result->chunks = std::move(lists->chunks);
    }
    lists.reset();
    result->sets = sets;
    result->nearest = options.nearest;
    result->hasSelf = options.includeSelf;
    result->encoding = encoding;
    return result;
}

std::uint64_t EngineState::allowRows(const SearchRuns& runs, const SearchOptions& options,
                                     std::uint64_t otherBytes, NeighborListsData& result, ChunkPool& pool)
{
    const std::size_t particles = runs.rowCount();
    result.rowCount.resizeDiscarding(particles);
    if (result.encoding == Encoding::kIndex) result.rowBegin.resizeDiscarding(particles);
    const std::uint64_t held =
        runs.sets().bytes() + result.rowCount.usedBytes() + result.rowBegin.usedBytes();
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
    checkCapacity(runs, result.encoding, allowed, result.rowCount.data());
    pool.begin(allowed, particles);
    return allowed;
}

void EngineState::makeRows(const SearchRun& run, const SearchTask& task, ThreadState& state, ChunkPool& pool,
                           NeighborListsData& result)
{
    state.pool = &pool;
    state.sink.slotBase = 0;
    state.sink.rowBegin = result.rowBegin.size() > 0 ? result.rowBegin.data() + run.firstRow : nullptr;
    state.sink.rowCount = result.rowCount.data() + run.firstRow;
    run.makeRows(kindOf(result.encoding), task, state, state.sink);
    if (result.encoding != Encoding::kMask) return;
    state.maskRuns.push_back({run.firstRow + task.firstSlot, state.sink.taskBegin});
    state.maskBytes +=
        static_cast<std::uint64_t>(state.sink.out - state.sink.taskBegin) * sizeof(std::uint32_t);
}

namespace {

struct PartStatistics {
    ListStatistics rows;
    std::uint64_t neighbors = 0;

    PartStatistics() { rows.min = std::numeric_limits<std::uint32_t>::max(); }
};

// The way from a query's number to its row, and what the counts of rows add up to. Rows that were only counted are cut here.
PartStatistics finishPart(const SearchRun& run, NeighborListsData& result)
{
    const auto range = tbb::blocked_range<std::size_t>(0, run.queries.particleCount(), 8192);
    const bool isCut = result.nearest > 0 && result.encoding == Encoding::kNone;
    return tbb::parallel_reduce(
        range, PartStatistics(),
        [&](const auto& r, PartStatistics s) {
            run.cancel.check();
            for (std::size_t slot = r.begin(); slot < r.end(); ++slot) {
                const std::uint32_t query = run.queries.number[slot], self = result.selfIn(query);
                std::uint32_t& entries = result.rowCount[run.firstRow + slot];
                if (isCut && entries - self > result.nearest) {
                    entries = result.nearest + self;
                    ++s.rows.shortened;
                }
                const std::uint32_t count = entries - self;
                s.rows.min = std::min(s.rows.min, count);
                s.rows.max = std::max(s.rows.max, count);
                s.rows.isolated += count == 0;
                s.rows.pairs += entries;
                s.neighbors += count;
                result.slotOf[query] = static_cast<std::uint32_t>(run.firstRow + slot);
            }
            return s;
        },
        [](PartStatistics a, const PartStatistics& b) {
            a.rows.min = std::min(a.rows.min, b.rows.min);
            a.rows.max = std::max(a.rows.max, b.rows.max);
            a.rows.isolated += b.rows.isolated;
            a.rows.shortened += b.rows.shortened;
            a.rows.pairs += b.rows.pairs;
            a.neighbors += b.neighbors;
            return a;
        });
}

} // namespace

void EngineState::finishLists(const SearchRuns& runs, ChunkPool& pool, NeighborListsData& result)
{
    for (ThreadState& state : states) state.finishRows();
    result.chunks = pool.release();
    const TaskStatistics sum = sumStatistics();
    result.maskRuns.clear();
    for (const ThreadState& state : states) {
        result.maskRuns.insert(result.maskRuns.end(), state.maskRuns.begin(), state.maskRuns.end());
    }
    std::sort(result.maskRuns.begin(), result.maskRuns.end(),
              [](const MaskRun& a, const MaskRun& b) { return a.firstSlot < b.firstSlot; });
    const std::size_t rows = runs.rowCount(), all = runs.sets().rowCount();
    result.slotOf.resizeDiscarding(all);
    if (rows < all) std::fill(result.slotOf.begin(), result.slotOf.end(), kNoSlot);
    ListStatistics statistics;
    statistics.min = std::numeric_limits<std::uint32_t>::max();
    std::uint64_t neighbors = 0;
    runs.forEach([&](const SearchRun& run) {
        const PartStatistics part = finishPart(run, result);
        statistics.min = std::min(statistics.min, part.rows.min);
        statistics.max = std::max(statistics.max, part.rows.max);
        statistics.pairs += part.rows.pairs;
        statistics.isolated += part.rows.isolated;
        statistics.shortened += part.rows.shortened;
        neighbors += part.neighbors;
    });
    const std::uint64_t finite = runs.sets().finiteQueries();
    if (rows < finite || finite == 0) statistics.min = 0;
    statistics.isolated += finite - rows;
    statistics.shortened += sum.shortened;
    statistics.mean = finite ? static_cast<double>(neighbors) / static_cast<double>(finite) : 0;
    result.statistics = statistics;
    result.rowBytes = 0;
    if (result.encoding == Encoding::kIndex) result.rowBytes = statistics.pairs * 4;
    if (result.encoding == Encoding::kMask) {
        for (const ThreadState& state : states) result.rowBytes += state.maskBytes;
    }
}

} // namespace vdb_nns
