// The search of one task, for the instruction set of the including file. Internal linkage throughout, and nothing of the
// standard library that could leave a copy compiled with these flags for other files to use.
//
//   sparse leaves: every query against all particles of the leaf and its halo
//   few cells:     (task.cells) the queries of each against the particles of the cells in its reach
//   others:        for each occupied cell, gather() keeps the candidates near the ball of the cell's queries;
//                  each query is tested against those, a vector at a time
// Both take candidates in the same order, by cell (x, y, z) lexicographic and by number inside a cell.
#include "cpu/gather-inl.h"
#include "cpu/halo-inl.h"
#include "cpu/membership_simd-inl.h"
#include "cpu/row_targets-inl.h"
#include "cpu/search_task.h"

namespace vdb_nns {
namespace {

// A leaf is sparse when leaf and halo together hold no more particles than this: then testing them all takes about as
// many vectors a query as a dense cell's kept candidates, and saves the table of cells, balls and gathering. On spray 256
// is 5 % of the search faster than 160 and as fast as 400.
constexpr std::uint32_t kSparseMost = 512;

// Tests a query and the next one against the candidates of a frame, and hands each vector's hits to
// emit(where the vector is, hits of the first, hits of the second). Two at a time read the candidates once for both.
// True when some are in the band: then both rows are to be made again, by testBand().
template <typename Frame, typename Emit>
inline bool testPair(const FilterBounds& bounds, const Frame& frame, std::uint32_t self, Emit&& emit)
{
    constexpr std::size_t kVector = Simd::kLanes * sizeof(float);
    const std::size_t stride = frame.stride;
    const char* p = frame.base;
    const char* const end = p + std::size_t(frame.count) * sizeof(float);
    const char* const own = p + std::size_t(self) * sizeof(float);
    const typename Frame::Query a(bounds, own, stride), b(bounds, own + sizeof(float), stride);
    Simd::I least = Simd::set(std::int32_t(0x7fffffff));
    const auto step = [&](Simd::Mask withoutA, Simd::Mask withoutB) {
        const typename Frame::Candidates candidates(p, stride);
        const Simd::F scoreA = a.score(candidates), scoreB = b.score(candidates);
        least = Simd::min(least, Simd::min(Simd::bits(scoreA), Simd::bits(scoreB)));
        emit(p, Simd::movesign(scoreA) & ~withoutA, Simd::movesign(scoreB) & ~withoutB);
        p += kVector;
    };
    const char* const selfVector = p + std::size_t(self / Simd::kLanes) * kVector;
    while (p < selfVector) step(0, 0);
    const Simd::Mask selfA = Simd::Mask(1) << self % Simd::kLanes, selfB = selfA << 1 & kAllLanes;
    step(selfA, selfB);
    if (!selfB) step(0, 1); // the second query begins the next vector
    while (p < end) step(0, 0);
    return Simd::lessEqual(least, Simd::set(bounds.bandTop)) != 0;
}

// The same for one query.
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
        const Simd::F score = query.score(typename Frame::Candidates(p, stride));
        least = Simd::min(least, Simd::bits(score));
        return Simd::movesign(score);
    };
    for (; p < selfVector; p += kVector) emit(p, step());
    emit(p, step() & ~(Simd::Mask(1) << self % Simd::kLanes));
    for (p += kVector; p < end; p += kVector) emit(p, step());
    return Simd::lessEqual(least, Simd::set(bounds.bandTop)) != 0;
}

// testQuery() for a query that has candidates in the band: the exact test decides those. Rare, and apart, so that it takes no
// registers from the other.
template <typename Frame, typename Emit>
__attribute__((noinline)) void testBand(const FilterBounds& bounds, Frame frame, std::uint32_t self,
                                        const ExactPredicate& exact, TaskStatistics& statistics, Emit emit)
{
    const char* const own = frame.base + std::size_t(self) * sizeof(float);
    const typename Frame::Query query(bounds, own, frame.stride);
    const std::uint32_t number = *integers(own + Frame::kNumber * frame.stride);
    for (std::size_t j = 0; j < frame.count; j += Simd::kLanes) {
        const char* const p = frame.base + j * sizeof(float);
        const Simd::F score = query.score(typename Frame::Candidates(p, frame.stride));
        Simd::Mask hits = Simd::movesign(score);
        if (j == self - self % Simd::kLanes) hits &= ~(Simd::Mask(1) << self % Simd::kLanes);
        Simd::Mask band = hits & Simd::lessEqual(Simd::bits(score), Simd::set(bounds.bandTop));
        for (; band; band &= band - 1) {
            const unsigned lane = static_cast<unsigned>(__builtin_ctz(band));
            ++statistics.bandPairs;
            if (!exact.isNeighbor(exact.state, number, integers(p + Frame::kNumber * frame.stride)[lane])) {
                hits &= ~(Simd::Mask(1) << lane);
            }
        }
        emit(p, hits);
    }
}

// Where a pair of queries had candidates in the band the next pair probably has too, as on a lattice: rows go to
// testBand() at once (`tied` in the row makers) until a pair has none.

// Queries that stand together: the first one's candidate, how many, and their slots.
struct Queries {
    std::uint32_t self, count, slot;
};

// Asks whether to go on, at the latest after so many tests, some milliseconds of them. The queries of a crowded cell are
// searched in parts for that, of an even number: pairs stay together.
struct Pace {
    static constexpr std::uint64_t kTestsBetweenPolls = std::uint64_t(1) << 23;
    static constexpr std::uint64_t kTestsOfCopy =
        8; // a particle's copy takes as long as so many, in memory never used

    explicit Pace(const SearchContext& context) : cancel(context.cancel) {}

    void copied(std::uint64_t particles)
    {
        tests += kTestsOfCopy * particles;
        if (tests < kTestsBetweenPolls) return;
        tests = 0;
        cancel.check(cancel.state);
    }

    // Calls search(queries) for all of them, which are tested against `tested` of the cell's candidates, just gathered.
    // From one place, so that the compiler makes it part of the caller.
    template <typename Search>
    void run(Queries queries, std::uint32_t candidates, std::uint32_t tested, Search&& search)
    {
        std::uint32_t left = queries.count;
        tests += std::uint64_t(left) * tested + kTestsOfCopy * candidates;
        if (tests >= kTestsBetweenPolls) queries.count = beginParts(left, tested);
        for (;;) {
            search(queries);
            left -= queries.count;
            if (left == 0) return;
            cancel.check(cancel.state);
            queries = {queries.self + queries.count, left < queries.count ? left : queries.count,
                       queries.slot + queries.count};
        }
    }

private:
    // Returns how many queries at once.
    __attribute__((noinline)) std::uint32_t beginParts(std::uint32_t queries, std::uint32_t tested)
    {
        tests = 0;
        cancel.check(cancel.state);
        const std::uint64_t pairs = kTestsBetweenPolls / 2 / (tested + std::uint64_t(1));
        const std::uint64_t most = pairs > 0 ? 2 * pairs : 2;
        return queries < most ? queries : static_cast<std::uint32_t>(most);
    }

    CancelPoll cancel;
    std::uint64_t tests = 0;
};

template <typename Target>
struct IndexRows {
    static constexpr bool kMasks = false;

    IndexRows(const SearchContext& c, const SearchTask&, const HaloScratch& s, RowSink& rowSink)
        : context(c), scratch(s), sink(rowSink), target(s, rowSink)
    {
    }

    template <typename Frame>
    void search(const Frame& frame, const Queries& queries, const ExactPredicate& exact,
                TaskStatistics& statistics)
    {
        const FilterBounds bounds = context.bounds;
        const std::size_t stride = frame.stride, most = frame.count + Simd::kLanes;
        std::uint32_t* const second = scratch.secondRow();
        std::uint32_t q = 0;
        for (; q + 1 < queries.count; q += 2) {
            std::uint32_t* const begin = target.reserve(2 * most);
            std::uint32_t *outA = begin, *outB = second;
            const auto emit = [&outA, &outB, stride](const char* p, Simd::Mask hitsA, Simd::Mask hitsB) {
                const Simd::I numbers = Simd::load(integers(p + Frame::kNumber * stride));
                Simd::store(outA, Simd::compress(numbers, Simd::order(hitsA)));
                Simd::store(outB, Simd::compress(numbers, Simd::order(hitsB)));
                outA += __builtin_popcount(hitsA);
                outB += __builtin_popcount(hitsB);
            };
            std::uint32_t countA, countB;
            if (tied || testPair(bounds, frame, queries.self + q, emit)) {
                const std::uint64_t before = statistics.bandPairs;
                countA = searchBand(frame, queries.self + q, exact, statistics, begin);
                countB = searchBand(frame, queries.self + q + 1, exact, statistics, begin + countA);
                tied = statistics.bandPairs != before;
            } else {
                countA = static_cast<std::uint32_t>(outA - begin);
                countB = static_cast<std::uint32_t>(outB - second);
                for (std::size_t k = 0; k < countB; k += Simd::kLanes) {
                    Simd::store(outA + k, Simd::load(second + k));
                }
            }
            std::uint32_t* const row = target.commit(countA + countB);
            noteRow(queries.slot + q, row, countA, statistics);
            noteRow(queries.slot + q + 1, row + countA, countB, statistics);
        }
        if (q < queries.count) {
            std::uint32_t* const begin = target.reserve(most);
            std::uint32_t* out = begin;
            const auto emit = [&out, stride](const char* p, Simd::Mask hits) {
                const Simd::I numbers = Simd::load(integers(p + Frame::kNumber * stride));
                Simd::store(out, Simd::compress(numbers, Simd::order(hits)));
                out += __builtin_popcount(hits);
            };
            const bool band = tied || testQuery(bounds, frame, queries.self + q, emit);
            const std::uint32_t count = band ? searchBand(frame, queries.self + q, exact, statistics, begin)
                                             : static_cast<std::uint32_t>(out - begin);
            noteRow(queries.slot + q, target.commit(count), count, statistics);
        }
    }

    void finish() { target.finish(); }

private:
    void noteRow(std::uint32_t slot, std::uint32_t* row, std::uint32_t count, TaskStatistics& statistics)
    {
        sink.rowBegin[slot - sink.slotBase] = row;
        sink.rowCount[slot - sink.slotBase] = count;
        sink.nextSlot = slot + 1;
        statistics.pairs += count;
    }

    template <typename Frame>
    std::uint32_t searchBand(const Frame& frame, std::uint32_t self, const ExactPredicate& exact,
                             TaskStatistics& statistics, std::uint32_t* begin)
    {
        std::uint32_t* out = begin;
        testBand(context.bounds, frame, self, exact, statistics,
                 [&out, &frame](const char* p, Simd::Mask hits) {
                     const Simd::I numbers = Simd::load(integers(p + Frame::kNumber * frame.stride));
                     Simd::store(out, Simd::compress(numbers, Simd::order(hits)));
                     out += __builtin_popcount(hits);
                 });
        return static_cast<std::uint32_t>(out - begin);
    }

    const SearchContext& context;
    const HaloScratch& scratch;
    RowSink& sink;
    Target target;
    bool tied = false;
};

struct CountRows {
    static constexpr bool kMasks = false;

    CountRows(const SearchContext& c, const SearchTask&, const HaloScratch&, RowSink& rowSink)
        : context(c), sink(rowSink)
    {
    }

    template <typename Frame>
    void search(const Frame& frame, const Queries& queries, const ExactPredicate& exact,
                TaskStatistics& statistics)
    {
        const FilterBounds bounds = context.bounds;
        std::uint32_t* const rowCount = sink.rowCount + (queries.slot - sink.slotBase);
        std::uint64_t pairs = 0;
        std::uint32_t q = 0;
        for (; q + 1 < queries.count; q += 2) {
            std::uint32_t countA = 0, countB = 0;
            const auto emit = [&countA, &countB](const char*, Simd::Mask hitsA, Simd::Mask hitsB) {
                countA += static_cast<std::uint32_t>(__builtin_popcount(hitsA));
                countB += static_cast<std::uint32_t>(__builtin_popcount(hitsB));
            };
            if (tied || testPair(bounds, frame, queries.self + q, emit)) {
                const std::uint64_t before = statistics.bandPairs;
                countA = countBand(frame, queries.self + q, exact, statistics);
                countB = countBand(frame, queries.self + q + 1, exact, statistics);
                tied = statistics.bandPairs != before;
            }
            rowCount[q] = countA;
            rowCount[q + 1] = countB;
            pairs += countA + countB;
        }
        if (q < queries.count) {
            std::uint32_t count = 0;
            const auto emit = [&count](const char*, Simd::Mask hits) {
                count += static_cast<std::uint32_t>(__builtin_popcount(hits));
            };
            if (tied || testQuery(bounds, frame, queries.self + q, emit)) {
                count = countBand(frame, queries.self + q, exact, statistics);
            }
            rowCount[q] = count;
            pairs += count;
        }
        statistics.pairs += pairs;
    }

    void finish() {}

private:
    template <typename Frame>
    std::uint32_t countBand(const Frame& frame, std::uint32_t self, const ExactPredicate& exact,
                            TaskStatistics& statistics)
    {
        std::uint32_t count = 0;
        testBand(context.bounds, frame, self, exact, statistics, [&count](const char*, Simd::Mask hits) {
            count += static_cast<std::uint32_t>(__builtin_popcount(hits));
        });
        return count;
    }

    const SearchContext& context;
    RowSink& sink;
    bool tied = false;
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

// The hits of one query by kept candidate, as bits. Vectors of 8 lanes and more write whole bytes.
struct HitWriter {
    std::uint64_t* words;
    BitWriter bits{words};
    char* bytes = reinterpret_cast<char*>(words);

    explicit HitWriter(std::uint64_t* out) : words(out) {}

    void append(Simd::Mask hits)
    {
        if constexpr (Simd::kLanes >= 8) {
            std::memcpy(bytes, &hits, Simd::kLanes / 8);
            bytes += Simd::kLanes / 8;
        } else {
            bits.append(hits, Simd::kLanes);
        }
    }

    void finish()
    {
        if constexpr (Simd::kLanes < 8) bits.finish();
    }
};

// One bit for each candidate of the cells in reach, in visiting order, padded to 32-bit words.
struct MaskRows {
    static constexpr bool kMasks = true;

    // For rows of so many words.
    MaskRows(const SearchContext& c, const HaloScratch& scratch, RowSink& rowSink, std::size_t words)
        : context(c),
          sink(rowSink),
          keepBits(scratch.keepBits()),
          hitBits(scratch.hitBits()),
          secondHitBits(scratch.secondHitBits())
    {
        sink.grow(sink, words + 2); // a row is written 64 bits at a time
        sink.taskBegin = sink.out;
    }

    MaskRows(const SearchContext& c, const SearchTask& task, const HaloScratch& scratch, RowSink& rowSink)
        : MaskRows(c, scratch, rowSink, wordsOf(c, task, scratch))
    {
    }

    static std::size_t wordsOf(const SearchContext& context, const SearchTask& task,
                               const HaloScratch& scratch)
    {
        std::size_t words = 0;
        forEachCell(context.block, task, scratch,
                    [&](const std::uint32_t* lowest, const CellSearch& cell, std::uint32_t) {
                        words += std::size_t(cell.queries) *
                                 ((candidatesOf(context.block.reach, lowest) + 31) / 32);
                    });
        return words;
    }

    // `candidates` are those of the cells in reach. Not inlined: in a loop around it, it would lack registers.
    template <typename Frame>
    __attribute__((noinline)) void search(const Frame& frame, const Queries& queries,
                                          std::uint32_t candidates, const ExactPredicate& exact,
                                          TaskStatistics& statistics)
    {
        const FilterBounds bounds = context.bounds;
        const std::uint32_t rowWords = (candidates + 31) / 32;
        std::uint32_t* const rowCount = sink.rowCount + (queries.slot - sink.slotBase);
        std::uint32_t* out = sink.out;
        std::uint64_t pairs = 0;
        const auto commitRow = [&](std::uint32_t q, const std::uint64_t* hits) {
            const std::uint32_t count = writeRow(hits, rowWords, out);
            rowCount[q] = count;
            pairs += count;
            out += rowWords;
        };
        std::uint32_t q = 0;
        for (; q + 1 < queries.count; q += 2) {
            HitWriter writerA(hitBits), writerB(secondHitBits);
            const auto emit = [&writerA, &writerB](const char*, Simd::Mask hitsA, Simd::Mask hitsB) {
                writerA.append(hitsA);
                writerB.append(hitsB);
            };
            if (tied || testPair(bounds, frame, queries.self + q, emit)) {
                const std::uint64_t before = statistics.bandPairs;
                searchBand(frame, queries.self + q, exact, statistics, hitBits);
                searchBand(frame, queries.self + q + 1, exact, statistics, secondHitBits);
                tied = statistics.bandPairs != before;
            } else {
                writerA.finish();
                writerB.finish();
            }
            commitRow(q, hitBits);
            commitRow(q + 1, secondHitBits);
        }
        if (q < queries.count) {
            HitWriter writer(hitBits);
            const auto emit = [&writer](const char*, Simd::Mask hits) { writer.append(hits); };
            if (tied || testQuery(bounds, frame, queries.self + q, emit)) {
                searchBand(frame, queries.self + q, exact, statistics, hitBits);
            } else {
                writer.finish();
            }
            commitRow(q, hitBits);
        }
        sink.out = out;
        statistics.pairs += pairs;
    }

    void finish() {}

private:
    template <typename Frame>
    void searchBand(const Frame& frame, std::uint32_t self, const ExactPredicate& exact,
                    TaskStatistics& statistics, std::uint64_t* hits)
    {
        HitWriter writer(hits);
        testBand(context.bounds, frame, self, exact, statistics,
                 [&writer](const char*, Simd::Mask hits) { writer.append(hits); });
        writer.finish();
    }

    // Moves the hits of kept candidates to the places of these among all candidates.
    std::uint32_t writeRow(const std::uint64_t* hitWords, std::uint32_t rowWords, std::uint32_t* row) const
    {
        const std::uint64_t* const keepWords = keepBits;
        std::uint32_t hit = 0, count = 0;
        for (std::uint32_t w = 0; w < rowWords; w += 2) {
            const std::uint64_t keep = keepWords[w / 2];
            const auto kept = static_cast<std::uint32_t>(__builtin_popcountll(keep));
            std::uint64_t bits;
            std::memcpy(&bits, reinterpret_cast<const char*>(hitWords) + hit / 8, sizeof bits);
            bits >>= hit % 8; // at least 57 are left
            if (kept > 57)
                bits = hitWords[hit / 64] >> hit % 64 | hitWords[hit / 64 + 1] << 1 << (63 - hit % 64);
            hit += kept;
            const std::uint64_t out = deposit(bits, keep);
            count += static_cast<std::uint32_t>(__builtin_popcountll(out));
            std::memcpy(row + w, &out, sizeof out);
        }
        return count;
    }

    const SearchContext& context;
    RowSink& sink;
    bool tied = false;
    const std::uint64_t* keepBits;
    std::uint64_t* hitBits;
    std::uint64_t* secondHitBits;
};

// Searches a sparse leaf. False, and nothing done, when it is not sparse.
template <typename Rows>
bool searchSparse(const SearchContext& context, const SearchTask& task, const LeafCells* leaves,
                  const ExactPredicate& exact, HaloScratch& scratch, RowSink& sink,
                  TaskStatistics& statistics)
{
    if (task.endSlot - task.firstSlot > kSparseMost) return false;
    HaloRun runs[kSparseMost + 1]; // each holds a particle at least
    std::uint32_t runCount = 0, slabStart[HaloScratch::kMaxSide + 1];
    const std::uint32_t particles = listRuns(context.block, leaves, kSparseMost, runs, runCount, slabStart);
    if (particles > kSparseMost) return false;
    copyRuns(context.block, runs, runCount, scratch);
    Rows rows(context, task, scratch, sink);
    std::uint32_t at = 0;
    for (std::uint32_t r = 0; r < runCount; at += runs[r].end - runs[r].begin, ++r) {
        if (runs[r].leaf != kOwnLeaf) continue;
        const std::uint32_t begin = runs[r].begin > task.firstSlot ? runs[r].begin : task.firstSlot;
        const std::uint32_t end = runs[r].end < task.endSlot ? runs[r].end : task.endSlot;
        if (begin >= end) continue;
        // The last vector may hold particles of the next slab: those are out of reach, so the test says no.
        const int slab = runs[r].slab, reach = context.block.reach;
        const std::uint32_t from = slabStart[slab - reach], to = slabStart[slab + reach + 1];
        const HaloFrame frame{scratch.halo() + std::size_t(from) * sizeof(float), scratch.stride, to - from};
        rows.search(frame, {at - from + (begin - runs[r].begin), end - begin, begin}, exact, statistics);
    }
    rows.finish();
    return true;
}

// Searches the cells of task.cells, each by itself: for so few that the halo of the whole leaf would cost more.
template <typename Rows>
void searchCells(const SearchContext& context, const SearchTask& task, const LeafCells* leaves,
                 const ExactPredicate& exact, HaloScratch& scratch, RowSink& sink, TaskStatistics& statistics)
{
    Pace pace(context);
    const std::uint32_t* cellStart = context.block.cellStart + context.block.leaves[task.leaf].firstCell;
    for (int x = 0; x < 8; ++x) {
        for (std::uint64_t word = leaves[kOwnLeaf].word[x]; word; word &= word - 1, ++cellStart) {
            const int bit = __builtin_ctzll(word);
            const std::uint32_t begin = cellStart[0] > task.firstSlot ? cellStart[0] : task.firstSlot;
            const std::uint32_t end = cellStart[1] < task.endSlot ? cellStart[1] : task.endSlot;
            if (!(task.cells[x] >> bit & 1) || begin >= end) continue;
            std::uint32_t self = 0;
            const std::uint32_t candidates =
                copyReach(context.block, leaves, x, bit >> 3, bit & 7, scratch, self);
            const HaloFrame frame{scratch.halo(), scratch.stride, candidates};
            const Queries queries{self + (begin - cellStart[0]), end - begin, begin};
            if constexpr (Rows::kMasks) {
                std::uint64_t* const keep = scratch.keepBits();
                for (std::uint32_t w = 0; w < candidates / 64; ++w) keep[w] = ~std::uint64_t(0);
                keep[candidates / 64] = (std::uint64_t(1) << candidates % 64) - 1;
                Rows rows(context, scratch, sink, std::size_t(queries.count) * ((candidates + 31) / 32));
                pace.run(queries, candidates, candidates, [&](const Queries& part) {
                    rows.search(frame, part, candidates, exact, statistics);
                });
            } else {
                Rows rows(context, task, scratch, sink);
                pace.run(queries, candidates, candidates,
                         [&](const Queries& part) { rows.search(frame, part, exact, statistics); });
                rows.finish();
            }
        }
    }
}

template <typename Rows>
void searchTask(const SearchContext& context, const SearchTask& task, const ExactPredicate& exact,
                HaloScratch& scratch, RowSink& sink, TaskStatistics& statistics)
{
    LeafCells leaves[27];
    const std::size_t particles = readLeaves(context.block, task.neighborhood, leaves);
    scratch.reserve(scratch, particles);
    if (task.cells) return searchCells<Rows>(context, task, leaves, exact, scratch, sink, statistics);
    if constexpr (!Rows::kMasks) {
        if (searchSparse<Rows>(context, task, leaves, exact, scratch, sink, statistics)) return;
    }
    fillHalo(context.block, leaves, scratch);
    Pace pace(context);
    pace.copied(particles);
    Rows rows(context, task, scratch, sink);
    forEachCell(context.block, task, scratch,
                [&](const std::uint32_t* lowest, CellSearch& cell, std::uint32_t firstSlot) {
                    gather<Rows::kMasks>(context, scratch, lowest, cell);
                    const KeptFrame frame{scratch.kept(), scratch.stride, cell.kept};
                    const Queries queries{cell.self, cell.queries, firstSlot};
                    pace.run(queries, cell.candidates, cell.kept, [&](const Queries& part) {
                        if constexpr (Rows::kMasks) {
                            rows.search(frame, part, cell.candidates, exact, statistics);
                        } else {
                            rows.search(frame, part, exact, statistics);
                        }
                    });
                });
    rows.finish();
}

} // namespace
} // namespace vdb_nns
