// A consumer of rows (search_rows-inl.h): the numbers of the neighbors, in the order of the candidates. Knows nothing of where
// they go, which is up to the target (row_targets-inl.h). Internal linkage.
#pragma once

#include "cpu/row_targets-inl.h"
#include "cpu/search_rows-inl.h"

namespace vdb_nns {
namespace {

template <typename Target>
struct IndexRows {
    static constexpr bool kByCandidate = false;

    struct Row {
        std::uint32_t* out;

        // Writes a whole vector; the next one overwrites what is no hit.
        void take(Simd::I numbers, Simd::I, Simd::Mask hits)
        {
            Simd::store(out, Simd::compress(numbers, Simd::order(hits)));
            out += __builtin_popcount(hits);
        }
    };

    // The first row is made where the target wants it, the second beside it, and moved behind the first once that is complete.
    struct Group {
        IndexRows& rows;
        std::uint32_t slot; // of the next row
        std::size_t most;   // entries that making a row may touch
        std::uint32_t* firstBegin = nullptr;
        std::uint32_t* secondBegin;

        Group(IndexRows& indexRows, const Queries& queries, std::uint32_t tested)
            : rows(indexRows),
              slot(queries.slot),
              most(tested + std::size_t(Simd::kLanes)),
              secondBegin(indexRows.scratch.secondRow())
        {
        }

        void begin(int count) { firstBegin = rows.target.reserve(count * most); }
        Row first() const { return {firstBegin}; }
        Row second() const { return {secondBegin}; }

        std::uint32_t end(Row row)
        {
            const auto count = static_cast<std::uint32_t>(row.out - firstBegin);
            rows.note(slot++, rows.target.commit(count), count);
            return count;
        }

        std::uint32_t endPair(Row a, Row b)
        {
            const auto countA = static_cast<std::uint32_t>(a.out - firstBegin);
            const auto countB = static_cast<std::uint32_t>(b.out - secondBegin);
            for (std::size_t k = 0; k < countB; k += Simd::kLanes) {
                Simd::store(a.out + k, Simd::load(secondBegin + k));
            }
            std::uint32_t* const row = rows.target.commit(countA + countB);
            rows.note(slot++, row, countA);
            rows.note(slot++, row + countA, countB);
            return countA + countB;
        }

        void finish() {}
    };

    IndexRows(HaloScratch& haloScratch, RowSink& rowSink)
        : scratch(haloScratch), sink(rowSink), target(haloScratch, rowSink)
    {
    }

    void finish() { target.finish(); }

    void note(std::uint32_t slot, std::uint32_t* row, std::uint32_t count)
    {
        sink.rowBegin[slot - sink.slotBase] = row;
        sink.rowCount[slot - sink.slotBase] = count;
        sink.nextSlot = slot + 1;
    }

    HaloScratch& scratch;
    RowSink& sink;
    Target target;
};

} // namespace
} // namespace vdb_nns
