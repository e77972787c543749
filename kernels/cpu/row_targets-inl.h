// Where rows of numbers go (consume_index-inl.h): to the sink's memory, by way of the caches or past them. Knows the sink and
// the order of rows, and nothing of tests. Internal linkage; see simd.h.
//
// A target: reserve(entries) says where the next rows are to be made, with room for so many; endOf(row, count) is where the row behind
// that one is to be made, up to kPad entries further; commit(entries) takes what stands there and returns where it will be read; finish()
// ends a task.
#pragma once

#include "cpu/search_task.h"
#include "cpu/simd.h"

namespace vdb_nns {
namespace {

// Rows of numbers, straight to the sink's memory.
struct DirectRows {
    DirectRows(const HaloScratch&, RowSink& rowSink) : sink(rowSink) {}

    std::uint32_t* reserve(std::size_t entries)
    {
        if (static_cast<std::size_t>(sink.end - sink.out) < entries) sink.grow(sink, entries);
        return sink.out;
    }

    std::uint32_t* endOf(std::uint32_t* row, std::uint32_t count) const
    {
        if (!sink.isPadded || count == 0) return row + count;
        const Simd::I last = Simd::set(static_cast<std::int32_t>(row[count - 1]));
        for (std::size_t k = 0; k < RowSink::kPad; k += Simd::kLanes) Simd::store(row + count + k, last);
        return row + (count + RowSink::kPad - 1) / RowSink::kPad * RowSink::kPad;
    }

    std::uint32_t* commit(std::size_t entries)
    {
        sink.out += entries;
        return sink.out - entries;
    }

    void finish() {}

    RowSink& sink;
};

// Rows of numbers that go to the sink's memory past the caches. Lists are written once and not read soon, and ordinary
// stores would read every line from memory before overwriting it. Rows are made in a staging buffer in the cache; whole
// lines leave from there, and the part of a line that a task leaves waits in the sink for the next one.
struct StreamedRows {
    static constexpr std::size_t kLine = RowSink::kLine;
    static constexpr std::size_t kFlushAt =
        1024; // entries: 4 KB, and HaloScratch has room for as many past the kept

    StreamedRows(const HaloScratch& scratch, RowSink& rowSink)
        : sink(rowSink), staging(scratch.staging()), staged(rowSink.tailSize)
    {
        for (std::size_t k = 0; k < staged; ++k) staging[k] = sink.tail[k];
    }

    std::uint32_t* reserve(std::size_t entries)
    {
        if (static_cast<std::size_t>(sink.end - sink.out) < staged + entries) {
            finish();
            sink.grow(sink, entries + kLine);
            staged = 0;
        }
        return staging + staged;
    }

    std::uint32_t* endOf(std::uint32_t* row, std::uint32_t count) const { return row + count; }

    std::uint32_t* commit(std::size_t entries)
    {
        std::uint32_t* const row = sink.out + staged;
        staged += entries;
        if (staged >= kFlushAt) flush();
        return row;
    }

    void flush()
    {
        std::size_t i = 0;
        for (; i + kLine <= staged; i += kLine) {
            for (std::size_t k = 0; k < kLine; k += Simd::kLanes) {
                Simd::stream(sink.out + i + k, Simd::load(staging + i + k));
            }
        }
        sink.out += i;
        staged -= i;
        for (std::size_t k = 0; k < staged; ++k) staging[k] = staging[i + k];
    }

    void finish()
    {
        flush();
        for (std::size_t k = 0; k < staged; ++k) sink.tail[k] = staging[k];
        sink.tailSize = static_cast<std::uint32_t>(staged);
        Simd::streamFence();
    }

    RowSink& sink;
    std::uint32_t* staging;
    std::size_t staged;
};

} // namespace
} // namespace vdb_nns
