// Rows of lists, copied one behind the other as a search hands them out (VisitedRows): for passes over lists that are there.
#pragma once

#include "search/thread_state.h"
#include "vdb_nns/types.h"

#include <cstddef>
#include <cstdint>
#include <vector>

namespace vdb_nns {

class PaddedRows {
public:
    // Enough for the batches that measures are made of.
    bool isFull() const { return mNumbers.size() >= kNumbers || mQueries.size() >= kNumbers; }

    std::size_t count() const { return mQueries.size(); }

    void add(std::uint32_t query, Span<const std::uint32_t> neighbors)
    {
        mQueries.push_back(query);
        mLengths.push_back(static_cast<std::uint32_t>(neighbors.size()));
        mNumbers.insert(mNumbers.end(), neighbors.begin(), neighbors.end());
        while (mNumbers.size() % RowSink::kPad != 0) mNumbers.push_back(mNumbers.back());
    }

    // f(queries, rows), where rows.firstSlot is 0; then there are none.
    template <typename F>
    void handOut(F&& f)
    {
        if (!mQueries.empty())
            f(mQueries.data(), VisitedRows{0, static_cast<std::uint32_t>(mQueries.size()), mNumbers.data(),
                                           mLengths.data(), mLengths.data(), false});
        mQueries.clear();
        mLengths.clear();
        mNumbers.clear();
    }

private:
    static constexpr std::size_t kNumbers = 16384;
    std::vector<std::uint32_t> mQueries, mNumbers, mLengths;
};

} // namespace vdb_nns
