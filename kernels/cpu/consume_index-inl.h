// A consumer of rows (search_rows-inl.h): the numbers of the neighbors, in the order of the candidates. Knows nothing of where
// they go, which is up to the target (row_targets-inl.h). Internal linkage.
#pragma once

#include "cpu/row_targets-inl.h"
#include "cpu/search_rows-inl.h"

namespace vdb_nns {
namespace {

// All numbers of a row.
struct AllNumbers {
    std::uint32_t* out;

    AllNumbers(std::uint32_t* begin, const RowSink&, std::uint32_t) : out(begin) {}

    // Writes a whole vector; the next one overwrites what is no hit.
    void take(Simd::I numbers, Simd::I, Simd::Mask hits)
    {
        Simd::store(out, Simd::compress(numbers, Simd::order(hits)));
        out += __builtin_popcount(hits);
    }

    // Returns how many neighbors there are.
    static std::uint32_t note(RowSink& sink, std::uint32_t row, const AllNumbers&, std::uint32_t length)
    {
        return sink.rowCount[row] = length;
    }
};

// Those that are smaller than the number of the query: of pairs that come both ways, each one once.
struct SmallerNumbers {
    std::uint32_t* out;
    std::uint32_t count = 0; // of all
    Simd::I query;

    SmallerNumbers(std::uint32_t* begin, const RowSink& sink, std::uint32_t slot)
        : out(begin), query(Simd::set(static_cast<std::int32_t>(sink.number[slot])))
    {
    }

    void take(Simd::I numbers, Simd::I, Simd::Mask hits)
    {
        const Simd::Mask smaller = hits & Simd::equal(Simd::minUnsigned(numbers, query), numbers);
        Simd::store(out, Simd::compress(numbers, Simd::order(smaller)));
        out += __builtin_popcount(smaller);
        count += static_cast<std::uint32_t>(__builtin_popcount(hits));
    }

    static std::uint32_t note(RowSink& sink, std::uint32_t row, const SmallerNumbers& made,
                              std::uint32_t length)
    {
        sink.rowLength[row] = length;
        return sink.rowCount[row] = made.count;
    }
};

template <typename Target, typename RowType = AllNumbers>
struct IndexRows {
    static constexpr bool kByCandidate = false;

    using Row = RowType;

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
              most(tested + std::size_t(Simd::kLanes) + RowSink::kPad),
              secondBegin(indexRows.scratch.secondRow())
        {
        }

        void begin(int count) { firstBegin = rows.target.reserve(count * most); }
        Row first() const { return Row(firstBegin, rows.sink, slot); }
        Row second() const { return Row(secondBegin, rows.sink, slot + 1); }

        std::uint32_t end(Row row)
        {
            const auto count = static_cast<std::uint32_t>(row.out - firstBegin);
            const std::uint32_t* const next = rows.target.endOf(firstBegin, count);
            return rows.note(slot++, rows.target.commit(static_cast<std::size_t>(next - firstBegin)), row,
                             count);
        }

        std::uint32_t endPair(Row a, Row b)
        {
            const auto countA = static_cast<std::uint32_t>(a.out - firstBegin);
            const auto countB = static_cast<std::uint32_t>(b.out - secondBegin);
            std::uint32_t* const second = rows.target.endOf(firstBegin, countA);
            for (std::size_t k = 0; k < countB; k += Simd::kLanes) {
                Simd::store(second + k, Simd::load(secondBegin + k));
            }
            const std::uint32_t* const next = rows.target.endOf(second, countB);
            std::uint32_t* const row = rows.target.commit(static_cast<std::size_t>(next - firstBegin));
            const std::uint32_t pairs = rows.note(slot++, row, a, countA);
            return pairs + rows.note(slot++, row + (second - firstBegin), b, countB);
        }

        void finish() {}
    };

    IndexRows(HaloScratch& haloScratch, RowSink& rowSink)
        : scratch(haloScratch), sink(rowSink), target(haloScratch, rowSink)
    {
    }

    void finish() { target.finish(); }

    std::uint32_t note(std::uint32_t slot, std::uint32_t* begin, const Row& row, std::uint32_t length)
    {
        sink.rowBegin[slot - sink.slotBase] = begin;
        sink.nextSlot = slot + 1;
        return Row::note(sink, slot - sink.slotBase, row, length);
    }

    HaloScratch& scratch;
    RowSink& sink;
    Target target;
};

} // namespace
} // namespace vdb_nns
