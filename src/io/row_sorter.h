// Sorts rows, one after the other, with the widest vectors of this processor.
#pragma once

#include "cpu/kernels.h"

#include <cstddef>
#include <cstdint>
#include <vector>

namespace vdb_nns {

class RowSorter {
public:
    // Writes the numbers of a row ascending to `out`, and up to kSortOverrun entries behind them that mean nothing.
    void sort(const std::uint32_t* row, std::size_t count, std::uint32_t* out)
    {
        const std::size_t needed = sortScratchEntries(count);
        if (mScratch.size() < needed) mScratch.resize(needed);
        mSort(row, count, out, mScratch.data());
    }

    // Frees what a long row left.
    void releaseLarge()
    {
        for (std::vector<std::uint32_t>* const kept : {&mScratch, &mSorted}) {
            if (kept->capacity() > kKeptEntries) std::vector<std::uint32_t>().swap(*kept);
        }
    }

    // The same, to memory of its own, which is good until the next call.
    std::uint32_t* sorted(const std::uint32_t* row, std::size_t count)
    {
        if (mSorted.size() < count + kSortOverrun) mSorted.resize(count + kSortOverrun);
        sort(row, count, mSorted.data());
        return mSorted.data();
    }

private:
    static constexpr std::size_t kKeptEntries = std::size_t(1) << 20; // 4 MiB

    SortRowFunction mSort = kernelsFor(SimdLevel::kBest).sortRow;
    std::vector<std::uint32_t> mScratch, mSorted;
};

} // namespace vdb_nns
