// The inner loop: the queries of a cell against the candidates of a frame, two at a time and the odd one by itself. What
// becomes of the hits is up to a consumer, a type known at compile time, one file each (consume_*-inl.h). Internal linkage.
//
// A consumer has, see consume_count-inl.h for the smallest:
//
//   static constexpr bool kByCandidate      rows have a place for every candidate of the cells in reach, kept by the ball
//                                           filter or not: `queries.candidates` of them. scratch.keepBits() then says which
//                                           are kept, and sparse leaves are searched like others
//   Consumer(HaloScratch&, RowSink&)        once for a task
//   void reserve(words)                     if kByCandidate: room for rows of so many 32-bit words. Before the first row of a
//                                           task; if it has task.cells, before the rows of each of these cells
//   void finish()                           once for a task, after its last row
//
//   struct Row                              one row in the making: a few words, copied freely, so that they stay in registers
//     void take(numbers, scores, hits)      a vector of candidates: their numbers, the bits of what the filter made of their
//                                           distances, and a bit for each that is a neighbor; the query itself never is one.
//                                           Lanes without a bit hold anything. It may write whole vectors: a row then touches
//                                           up to `tested` + Simd::kLanes entries
//
//   struct Group                            a run of queries; lives in the loop, for the same reason
//     Group(Consumer&, queries, tested)     `tested`: candidates that a row takes
//     void begin(rows)                      the next one or two rows begin
//     Row first(), second()                 each of them, empty. Asked for again where a row is made anew: what was taken
//                                           before counts for nothing
//     std::uint32_t end(row)                the row is complete; returns how many neighbors it has
//     std::uint32_t endPair(a, b)           both rows are
//     void finish()                         the last row has ended
//
// Rows end in the order of slots, each once. Of the sink:
//
//   rowCount[slot - slotBase]               every consumer writes it for every row: lists of all encodings are finished by it
//   grow()                                  may hand out the rows before `nextSlot` and reuse their memory (Kernels::visit):
//                                           a consumer of that kind sets nextSlot as each row ends
#pragma once

#include "cpu/cell_queries-inl.h"
#include "cpu/test_pairs-inl.h"

namespace vdb_nns {
namespace {

// What decides who is a neighbor, throughout a task.
struct RowTest {
    const FilterBounds& bounds;
    const ExactPredicate& exact;
    TaskStatistics& statistics;

    // The last pair of queries had candidates in the band. Then the next one probably has too, as on a lattice: rows go to
    // testBand() at once, until a pair has none.
    bool tied = false;
};

// Not inlined: in the loops around it, it would lack registers (with AVX2 9 to 15 % more instructions for masks and numbers).
// The call is 2 % of a search for counts alone with AVX-512.
// Copies of frame and bounds: what consumers write could change the originals, as far as the compiler knows. Arguments by
// value instead go over the stack, and counts take 6 % longer.
template <typename Consumer, typename Frame>
__attribute__((noinline)) void searchRows(Consumer& consumer, const Frame& given, const Queries& queries,
                                          RowTest& test)
{
    using Row = typename Consumer::Row;
    const Frame frame = given;
    const FilterBounds bounds = test.bounds;
    const auto exactly = [&](std::uint32_t self, const Row& row) {
        return testBand(bounds, frame, self, test.exact, test.statistics, row);
    };
    typename Consumer::Group group(consumer, queries, frame.count);
    std::uint64_t pairs = 0;
    std::uint32_t self = queries.self;
    const std::uint32_t end = self + queries.count;
    for (; self + 1 < end; self += 2) {
        group.begin(2);
        Row a = group.first(), b = group.second();
        const auto take = [&a, &b](Simd::I numbers, Simd::I scoresA, Simd::Mask hitsA, Simd::I scoresB,
                                   Simd::Mask hitsB) {
            a.take(numbers, scoresA, hitsA);
            b.take(numbers, scoresB, hitsB);
        };
        if (test.tied || testPair(bounds, frame, self, take)) {
            const std::uint64_t before = test.statistics.bandPairs;
            a = exactly(self, group.first());
            b = exactly(self + 1, group.second());
            test.tied = test.statistics.bandPairs != before;
        }
        pairs += group.endPair(a, b);
    }
    if (self < end) {
        group.begin(1);
        Row row = group.first();
        const auto take = [&row](Simd::I numbers, Simd::I scores, Simd::Mask hits) {
            row.take(numbers, scores, hits);
        };
        if (test.tied || testQuery(bounds, frame, self, take)) row = exactly(self, group.first());
        pairs += group.end(row);
    }
    group.finish();
    test.statistics.pairs += pairs;
}

} // namespace
} // namespace vdb_nns
