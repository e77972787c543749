// The search of one task, for the instruction set of the including file. Internal linkage throughout, and nothing of the
// standard library that could leave a copy compiled with these flags for other files to use.
//
//   sparse leaves: every query against all particles of the leaf and its halo
//   others:        for each occupied cell, gather() keeps the candidates near the box of the cell's queries;
//                  each query is tested against those, a vector at a time
// Both take candidates in the same order, by cell (x, y, z) lexicographic and by number inside a cell.
#include "execute/gather-inl.h"
#include "execute/halo-inl.h"
#include "execute/membership_simd-inl.h"
#include "execute/row_targets-inl.h"
#include "execute/search_task.h"

namespace vdb_nns {
namespace {

// A leaf is sparse when leaf and halo together hold no more particles than this: then testing them all takes about as
// many vectors a query as a dense cell's kept candidates, and saves the table of cells, boxes and gathering.
constexpr std::uint32_t kSparseMost = 160;

// Tests one query against the candidates of a frame and hands each vector's hits to emit(where the vector is, hits).
// True when some of them are in the band: then the row is to be made again, by testBand().
template <typename Frame, typename Emit>
inline bool testQuery(const FilterBounds& bounds, const Frame& frame, std::uint32_t self, Emit&& emit)
{
    constexpr std::size_t kVector = Simd::kLanes * sizeof(float);
    const std::size_t stride = frame.stride;
    const char* p = frame.base;
    const char* const selfVector = p + std::size_t(self / Simd::kLanes) * kVector;
    const char* const end = p + std::size_t(frame.count) * sizeof(float);
    const typename Frame::Query query(bounds, p + std::size_t(self) * sizeof(float), stride);
    Simd::I least = Simd::set(std::int32_t(0x7fffffff));
    const auto step = [&] {
        const Simd::F score = query.score(p, stride);
        least = Simd::min(least, Simd::bits(score));
        return Simd::movesign(score);
    };
    for (; p < selfVector; p += kVector) emit(p, step());
    emit(p, step() & ~(Simd::Mask(1) << self % Simd::kLanes));
    for (p += kVector; p < end; p += kVector) emit(p, step());
    return Simd::lessEqual(least, Simd::set(bounds.bandTop)) != 0;
}

// testQuery() for a query that has candidates in the band: the judge decides those. Rare, and apart, so that it takes no
// registers from the other.
template <typename Frame, typename Emit>
__attribute__((noinline)) void testBand(const FilterBounds& bounds, Frame frame, std::uint32_t self,
                                        const BandJudge& judge, TaskStatistics& statistics, Emit emit)
{
    const char* const own = frame.base + std::size_t(self) * sizeof(float);
    const typename Frame::Query query(bounds, own, frame.stride);
    const std::uint32_t number = *integers(own + Frame::kNumber * frame.stride);
    for (std::uint32_t j = 0; j < frame.count; j += Simd::kLanes) {
        const char* const p = frame.base + std::size_t(j) * sizeof(float);
        const Simd::F score = query.score(p, frame.stride);
        Simd::Mask hits = Simd::movesign(score);
        if (j == self - self % Simd::kLanes) hits &= ~(Simd::Mask(1) << self % Simd::kLanes);
        Simd::Mask band = hits & Simd::lessEqual(Simd::bits(score), Simd::set(bounds.bandTop));
        for (; band; band &= band - 1) {
            const unsigned lane = static_cast<unsigned>(__builtin_ctz(band));
            ++statistics.bandPairs;
            if (!judge.isNeighbor(judge.state, number, integers(p + Frame::kNumber * frame.stride)[lane])) {
                hits &= ~(Simd::Mask(1) << lane);
            }
        }
        emit(p, hits);
    }
}

// Queries that stand together: the first one's candidate, how many, and their slots.
struct Queries {
    std::uint32_t self, count, slot;
};

template <typename Target>
struct IndexRows {
    static constexpr bool kMasks = false;

    IndexRows(const SearchContext& c, const SearchTask&, const HaloScratch& scratch, RowSink& rowSink)
        : context(c), sink(rowSink), target(scratch, rowSink)
    {
    }

    template <typename Frame>
    void search(const Frame& frame, const Queries& queries, const BandJudge& judge,
                TaskStatistics& statistics)
    {
        const FilterBounds bounds = context.bounds;
        const std::size_t stride = frame.stride, most = frame.count + Simd::kLanes;
        std::uint32_t** const rowBegin = sink.rowBegin + (queries.slot - sink.slotBase);
        std::uint32_t* const rowCount = sink.rowCount + (queries.slot - sink.slotBase);
        std::uint64_t pairs = 0;
        for (std::uint32_t q = 0; q < queries.count; ++q) {
            std::uint32_t* const begin = target.reserve(most);
            std::uint32_t* out = begin;
            const auto emit = [&out, stride](const char* p, Simd::Mask hits) {
                const Simd::I numbers = Simd::load(integers(p + Frame::kNumber * stride));
                Simd::store(out, Simd::compress(numbers, Simd::order(hits)));
                out += __builtin_popcount(hits);
            };
            std::uint32_t count;
            if (testQuery(bounds, frame, queries.self + q, emit)) {
                count = searchBand(frame, queries.self + q, judge, statistics, begin);
            } else {
                count = static_cast<std::uint32_t>(out - begin);
            }
            rowBegin[q] = target.commit(count);
            rowCount[q] = count;
            sink.nextSlot = queries.slot + q + 1;
            pairs += count;
        }
        statistics.pairs += pairs;
    }

    void finish() { target.finish(); }

private:
    template <typename Frame>
    std::uint32_t searchBand(const Frame& frame, std::uint32_t self, const BandJudge& judge,
                             TaskStatistics& statistics, std::uint32_t* begin)
    {
        std::uint32_t* out = begin;
        testBand(context.bounds, frame, self, judge, statistics,
                 [&out, &frame](const char* p, Simd::Mask hits) {
                     const Simd::I numbers = Simd::load(integers(p + Frame::kNumber * frame.stride));
                     Simd::store(out, Simd::compress(numbers, Simd::order(hits)));
                     out += __builtin_popcount(hits);
                 });
        return static_cast<std::uint32_t>(out - begin);
    }

    const SearchContext& context;
    RowSink& sink;
    Target target;
};

struct CountRows {
    static constexpr bool kMasks = false;

    CountRows(const SearchContext& c, const SearchTask&, const HaloScratch&, RowSink& rowSink)
        : context(c), sink(rowSink)
    {
    }

    template <typename Frame>
    void search(const Frame& frame, const Queries& queries, const BandJudge& judge,
                TaskStatistics& statistics)
    {
        const FilterBounds bounds = context.bounds;
        std::uint32_t* const rowCount = sink.rowCount + (queries.slot - sink.slotBase);
        std::uint64_t pairs = 0;
        for (std::uint32_t q = 0; q < queries.count; ++q) {
            std::uint32_t count = 0;
            const auto emit = [&count](const char*, Simd::Mask hits) {
                count += static_cast<std::uint32_t>(__builtin_popcount(hits));
            };
            if (testQuery(bounds, frame, queries.self + q, emit)) {
                count = countBand(frame, queries.self + q, judge, statistics);
            }
            rowCount[q] = count;
            pairs += count;
        }
        statistics.pairs += pairs;
    }

    void finish() {}

private:
    template <typename Frame>
    std::uint32_t countBand(const Frame& frame, std::uint32_t self, const BandJudge& judge,
                            TaskStatistics& statistics)
    {
        std::uint32_t count = 0;
        testBand(context.bounds, frame, self, judge, statistics, [&count](const char*, Simd::Mask hits) {
            count += static_cast<std::uint32_t>(__builtin_popcount(hits));
        });
        return count;
    }

    const SearchContext& context;
    RowSink& sink;
};

// Calls f(lowest, cell, first slot) for each cell with queries of the task; `lowest` points into the halo's cube at the
// cell of the same column that is `reach` below.
template <typename F>
inline void forEachCell(const BlockView& block, const SearchTask& task, const HaloScratch& halo, F&& f)
{
    const int reach = block.reach, side = 8 + 2 * reach;
    const LeafRecord& leaf = block.leaves[task.leaf];
    const std::uint32_t* cellStart = block.cellStart + leaf.firstCell;
    for (int x = 0; x < 8; ++x) {
        for (std::uint64_t word = leaf.occupancy[x]; word; word &= word - 1, ++cellStart) {
            const std::uint32_t begin = cellStart[0] > task.firstSlot ? cellStart[0] : task.firstSlot;
            const std::uint32_t end = cellStart[1] < task.endSlot ? cellStart[1] : task.endSlot;
            if (begin >= end) continue;
            const int bit = __builtin_ctzll(word), y = bit >> 3, z = bit & 7;
            const std::uint32_t* const lowest = halo.start + ((x + reach) * side + y + reach) * side + z;
            CellSearch cell{};
            cell.firstQuery = lowest[reach] + (begin - cellStart[0]);
            cell.queries = end - begin;
            f(lowest, cell, begin);
        }
    }
}

// The lowest bits of `bits`, one for each set bit of `keep`, moved to the places of those.
inline std::uint64_t deposit(std::uint64_t bits, std::uint64_t keep)
{
#if defined(__BMI2__)
    return _pdep_u64(bits, keep);
#else
    std::uint64_t out = 0;
    for (; keep; keep &= keep - 1, bits >>= 1) out |= (bits & 1) * (keep & -keep);
    return out;
#endif
}

// One bit for each candidate of the cells in reach, in visiting order, padded to 32-bit words.
struct MaskRows {
    static constexpr bool kMasks = true;

    MaskRows(const SearchContext& c, const SearchTask& task, const HaloScratch& scratch, RowSink& rowSink)
        : context(c), sink(rowSink), keepBits(scratch.keepBits()), hitBits(scratch.hitBits())
    {
        std::size_t words = 0;
        forEachCell(context.block, task, scratch,
                    [&](const std::uint32_t* lowest, const CellSearch& cell, std::uint32_t) {
                        words += std::size_t(cell.queries) *
                                 ((candidatesOf(context.block.reach, lowest) + 31) / 32);
                    });
        sink.grow(sink, words + 2); // a row is written 64 bits at a time
        sink.taskBegin = sink.out;
    }

    // `candidates` are those of the cells in reach.
    void search(const KeptFrame& frame, const Queries& queries, std::uint32_t candidates,
                const BandJudge& judge, TaskStatistics& statistics)
    {
        const FilterBounds bounds = context.bounds;
        const std::uint32_t rowWords = (candidates + 31) / 32;
        std::uint32_t* const rowCount = sink.rowCount + (queries.slot - sink.slotBase);
        std::uint32_t* out = sink.out;
        std::uint64_t pairs = 0;
        for (std::uint32_t q = 0; q < queries.count; ++q, out += rowWords) {
            BitWriter bits{hitBits};
            const auto emit = [&bits](const char*, Simd::Mask hits) { bits.append(hits, Simd::kLanes); };
            if (testQuery(bounds, frame, queries.self + q, emit)) {
                searchBand(frame, queries.self + q, judge, statistics);
            } else {
                bits.finish();
            }
            const std::uint32_t count = writeRow(rowWords, out);
            rowCount[q] = count;
            pairs += count;
        }
        sink.out = out;
        statistics.pairs += pairs;
    }

    void finish() {}

private:
    void searchBand(const KeptFrame& frame, std::uint32_t self, const BandJudge& judge,
                    TaskStatistics& statistics)
    {
        BitWriter bits{hitBits};
        testBand(context.bounds, frame, self, judge, statistics,
                 [&bits](const char*, Simd::Mask hits) { bits.append(hits, Simd::kLanes); });
        bits.finish();
    }

    std::uint32_t writeRow(std::uint32_t rowWords, std::uint32_t* row) const
    {
        std::uint32_t hit = 0, count = 0;
        for (std::uint32_t w = 0; w < rowWords; w += 2) {
            const std::uint64_t keep = keepBits[w / 2];
            // Two shifts, as one by 64 would be none.
            const std::uint64_t bits = hitBits[hit >> 6] >> (hit & 63) | hitBits[(hit >> 6) + 1]
                                                                             << 1 << (63 - (hit & 63));
            hit += static_cast<std::uint32_t>(__builtin_popcountll(keep));
            const std::uint64_t out = deposit(bits, keep);
            count += static_cast<std::uint32_t>(__builtin_popcountll(out));
            std::memcpy(row + w, &out, sizeof out);
        }
        return count;
    }

    const SearchContext& context;
    RowSink& sink;
    const std::uint64_t* keepBits;
    std::uint64_t* hitBits;
};

// Searches a sparse leaf. False, and nothing done, when it is not sparse.
template <typename Rows>
bool searchSparse(const SearchContext& context, const SearchTask& task, const LeafCells* leaves,
                  const BandJudge& judge, HaloScratch& scratch, RowSink& sink, TaskStatistics& statistics)
{
    if (task.endSlot - task.firstSlot > kSparseMost) return false;
    HaloRun runs[kSparseMost + 1]; // each holds a particle at least
    std::uint32_t runCount = 0;
    const std::uint32_t particles = listRuns(context.block, leaves, kSparseMost, runs, runCount);
    if (particles > kSparseMost) return false;
    copyRuns(context.block, runs, runCount, scratch);
    const HaloFrame frame{scratch.halo(), scratch.stride, particles};
    Rows rows(context, task, scratch, sink);
    std::uint32_t at = 0;
    for (std::uint32_t r = 0; r < runCount; at += runs[r].end - runs[r].begin, ++r) {
        if (runs[r].leaf != 13) continue;
        const std::uint32_t begin = runs[r].begin > task.firstSlot ? runs[r].begin : task.firstSlot;
        const std::uint32_t end = runs[r].end < task.endSlot ? runs[r].end : task.endSlot;
        if (begin < end) {
            rows.search(frame, {at + (begin - runs[r].begin), end - begin, begin}, judge, statistics);
        }
    }
    rows.finish();
    return true;
}

template <typename Rows>
void searchTask(const SearchContext& context, const SearchTask& task, const BandJudge& judge,
                HaloScratch& scratch, RowSink& sink, TaskStatistics& statistics)
{
    LeafCells leaves[27];
    scratch.reserve(scratch, readLeaves(context.block, task.neighborhood, leaves));
    if constexpr (!Rows::kMasks) {
        if (searchSparse<Rows>(context, task, leaves, judge, scratch, sink, statistics)) return;
    }
    fillHalo(context.block, leaves, scratch);
    Rows rows(context, task, scratch, sink);
    forEachCell(context.block, task, scratch,
                [&](const std::uint32_t* lowest, CellSearch& cell, std::uint32_t firstSlot) {
                    gather<Rows::kMasks>(context, scratch, lowest, cell);
                    const KeptFrame frame{scratch.kept(), scratch.stride, cell.kept};
                    const Queries queries{cell.self, cell.queries, firstSlot};
                    if constexpr (Rows::kMasks) {
                        rows.search(frame, queries, cell.candidates, judge, statistics);
                    } else {
                        rows.search(frame, queries, judge, statistics);
                    }
                });
    rows.finish();
}

} // namespace
} // namespace vdb_nns
