// A consumer of rows (search_rows-inl.h): how many neighbors each query has, and nothing else. Internal linkage.
#pragma once

#include "cpu/search_rows-inl.h"

namespace vdb_nns {
namespace {

struct CountRows {
    static constexpr bool kByCandidate = false;

    struct Row {
        std::uint32_t count = 0;

        void take(Simd::I, Simd::I, Simd::Mask hits)
        {
            count += static_cast<std::uint32_t>(__builtin_popcount(hits));
        }
    };

    struct Group {
        std::uint32_t* counts;

        Group(const CountRows& rows, const Queries& queries, std::uint32_t)
            : counts(rows.sink.rowCount + (queries.slot - rows.sink.slotBase))
        {
        }

        void begin(int) {}
        Row first() const { return {}; }
        Row second() const { return {}; }
        std::uint32_t end(Row row) { return *counts++ = row.count; }
        std::uint32_t endPair(Row a, Row b)
        {
            const std::uint32_t count = end(a);
            return count + end(b);
        }
        void finish() {}
    };

    CountRows(HaloScratch&, RowSink& rowSink) : sink(rowSink) {}
    void finish() {}

    RowSink& sink;
};

} // namespace
} // namespace vdb_nns
