// Which neighbors of a query are nearer, in real arithmetic; equal distances by the smaller number.
#pragma once

#include "search_judge.h"

#include <cstdint>
#include <optional>
#include <vector>

namespace vdb_nns::cli {

// Keeps its buffers from row to row; one a thread.
class DistanceOrder {
public:
    explicit DistanceOrder(const SearchJudge& judge) : mJudge(&judge) {}

    // Keeps the nearest `count` of a row of finite candidates, ascending by number.
    void keepNearest(std::uint32_t query, std::uint64_t count, std::vector<std::uint32_t>& row);

    // Sorts a row by distance.
    void sort(std::uint32_t query, std::vector<std::uint32_t>& row);

private:
    struct Entry {
        std::uint32_t number;
        Interval distance;
        std::optional<Dyadic> square; // once it was needed
    };

    void load(std::uint32_t query, const std::vector<std::uint32_t>& row);
    bool isNearer(std::uint32_t query, std::size_t a, std::size_t b);
    const Dyadic& squareOf(std::uint32_t query, Entry& entry);

    const SearchJudge* mJudge;
    std::vector<Entry> mEntries;
    std::vector<std::size_t> mPlaces; // in mEntries
};

} // namespace vdb_nns::cli
