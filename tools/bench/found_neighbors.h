// What a method found, whoever it is: rows of particle numbers, or counts alone, to be read back by query.
#pragma once

#include "vdb_nns/neighbor_lists.h"

#include <cstdint>
#include <functional>
#include <vector>

namespace vdb_nns::cli {

/// Immutable once made; safe to read from several threads.
class FoundNeighbors {
public:
    virtual ~FoundNeighbors() = default;

    /// Whether there are rows; else there are counts alone.
    virtual bool hasRows() const = 0;

    /// Neighbors listed for a query; 0 for particles that are not finite.
    virtual std::uint64_t count(std::uint32_t query) const = 0;

    /// The row of a query, in any order.
    virtual void row(std::uint32_t query, std::vector<std::uint32_t>& out) const = 0;

    /// Hands `visit` rows, split over the caller's TBB arena: every query once, but for some whose row is empty.
    using RowVisitor = NeighborLists::RowVisitor;
    virtual void visitRows(const RowVisitor& visit) const = 0;

    /// What a count is to be multiplied with to stand for the true one: above 1 where candidates were left out on purpose.
    virtual double countScale() const { return 1; }
};

/// Lists of the engine, in any encoding.
class EngineNeighbors : public FoundNeighbors {
public:
    explicit EngineNeighbors(NeighborLists lists) : mLists(std::move(lists)) {}

    bool hasRows() const override { return mLists.encoding() != Encoding::kNone; }
    std::uint64_t count(std::uint32_t query) const override { return mLists.count(query); }
    void row(std::uint32_t query, std::vector<std::uint32_t>& out) const override
    {
        mLists.neighbors(query, out);
    }
    void visitRows(const RowVisitor& visit) const override { mLists.visitRows(visit); }

private:
    NeighborLists mLists;
};

/// Counts by query, of a method that keeps no rows.
class CountedNeighbors : public FoundNeighbors {
public:
    explicit CountedNeighbors(std::vector<std::uint32_t> counts) : mCounts(std::move(counts)) {}

    bool hasRows() const override { return false; }
    std::uint64_t count(std::uint32_t query) const override { return mCounts[query]; }
    void row(std::uint32_t, std::vector<std::uint32_t>& out) const override { out.clear(); }
    void visitRows(const RowVisitor&) const override {}

private:
    std::vector<std::uint32_t> mCounts;
};

/// Rows as searches on several threads write them: each piece of work appends to a buffer of its own, and a query knows
/// its buffer. Nothing is copied together afterwards.
class RowBuffers : public FoundNeighbors {
public:
    struct Place {
        std::uint64_t begin = 0; ///< in its buffer
        std::uint32_t count = 0;
        std::uint32_t buffer = 0;
    };

    /// To be filled by the method: one place a particle, and the buffers. Kept from run to run by whoever owns this.
    std::vector<Place> places;
    std::vector<std::vector<std::uint32_t>> buffers;
    double scale = 1; ///< countScale()

    bool hasRows() const override { return true; }
    std::uint64_t count(std::uint32_t query) const override { return places[query].count; }
    void row(std::uint32_t query, std::vector<std::uint32_t>& out) const override;
    void visitRows(const RowVisitor& visit) const override;
    double countScale() const override { return scale; }

    std::uint64_t pairCount() const;
    std::uint64_t bytes() const; ///< of places and of what the buffers hold
};

} // namespace vdb_nns::cli
