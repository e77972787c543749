// How often a kernel asks whether to go on. Knows how many queries and candidates there are, and nothing of what is done
// with them. Internal linkage.
#pragma once

#include "cpu/cell_queries-inl.h"

namespace vdb_nns {
namespace {

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
    void run(Queries queries, std::uint32_t tested, Search&& search)
    {
        std::uint32_t left = queries.count;
        tests += std::uint64_t(left) * tested + kTestsOfCopy * queries.candidates;
        if (tests >= kTestsBetweenPolls) queries.count = beginParts(left, tested);
        for (;;) {
            search(queries);
            left -= queries.count;
            if (left == 0) return;
            cancel.check(cancel.state);
            queries.self += queries.count;
            queries.slot += queries.count;
            if (left < queries.count) queries.count = left;
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

} // namespace
} // namespace vdb_nns
