// The particles around a leaf, copied together in the frame of that leaf: cell by cell in (x, y, z) lexicographic order,
// so that the cells that a column of candidates passes stand one after the other.
#pragma once

#include "bench/methods/ablation_kernels.h"
#include "bench/methods/ablation_structure.h"

#include <cstdint>
#include <vector>

namespace vdb_nns::cli {

/// One thread's; grows as needed.
template <typename Real>
class CandidateMemory {
public:
    CandidateArrays<Real> arrays() { return {mReals.data(), axis(1), axis(2), mNumbers.data()}; }

    /// Drops what was there.
    void reserve(std::size_t count)
    {
        if (mStride >= count + kVectorSlack) return;
        mStride = count + count / 2 + kVectorSlack;
        mReals.assign(3 * mStride, Real(0));
        mNumbers.assign(mStride, 0);
    }

private:
    Real* axis(std::size_t k) { return mReals.data() + k * mStride; }

    std::size_t mStride = 0;
    std::vector<Real> mReals;
    std::vector<std::uint32_t> mNumbers;
};

template <AblationFrame kFrame>
class AblationHalo {
public:
    using Real = FrameReal<kFrame>;
    static constexpr int kMostReach = 3, kMostSide = 8 + 2 * kMostReach;

    explicit AblationHalo(const AblationStructure<kFrame>& structure) : mStructure(structure) {}

    /// Takes up the leaf, with the start of every cell of the cube of leaf and halo if kTable. False, and nothing of use
    /// done, when there are more than `most` candidates.
    template <bool kTable>
    bool fill(std::uint32_t leaf, std::uint64_t most);

    CandidateArrays<Real> candidates() { return mMemory.arrays(); }

    /// The cells z - reach to z + reach of the column at (x, y), in cells of the leaf. After fill<true>().
    CandidateRun column(int x, int y, int z) const
    {
        const int reach = mStructure.reach, side = 8 + 2 * reach;
        const std::uint32_t* const start = mStart + ((x + reach) * side + y + reach) * side + z;
        return {start[0], start[2 * reach + 1]};
    }

    /// All cells of x - reach to x + reach.
    CandidateRun slabs(int x) const { return {mSlab[x], mSlab[x + 2 * mStructure.reach + 1]}; }

private:
    // A row of cells along z in leaf and halo.
    struct Row {
        const AblationLeaf* leaf[3]; // null: none
        std::uint64_t words[3];      // occupied cells in reach, of the rows of one x
        int word;
        Real shift[3];
    };

    void reserve(const AblationNeighborhood& around)
    {
        std::size_t most = 0;
        for (const std::uint32_t l : around) {
            if (l != kNoAblationLeaf) most += mStructure.leaves[l].endSlot - mStructure.leaves[l].firstSlot;
        }
        mMemory.reserve(most);
    }

    Row rowOf(const AblationNeighborhood& around, int x, int leafY) const;
    template <bool kTable>
    void fillRow(Row& row, int y);
    void copyRun(std::uint32_t begin, std::uint32_t end, const Real* shift);

    const AblationStructure<kFrame>& mStructure;
    CandidateMemory<Real> mMemory;
    CandidateArrays<Real> mTo{};
    std::uint32_t mCount = 0;
    std::uint32_t* mNextStart = nullptr;
    std::uint32_t mStart[kMostSide * kMostSide * kMostSide + 1] = {};
    std::uint32_t mSlab[kMostSide + 1] = {};
};

template <AblationFrame kFrame>
template <bool kTable>
bool AblationHalo<kFrame>::fill(std::uint32_t leaf, std::uint64_t most)
{
    const AblationNeighborhood& around = mStructure.neighborhoods[leaf];
    reserve(around);
    mTo = mMemory.arrays();
    mCount = 0;
    mNextStart = mStart;
    const int reach = mStructure.reach, side = 8 + 2 * reach;
    for (int x = -reach; x < 8 + reach; ++x) {
        mSlab[x + reach] = mCount;
        for (int leafY = 0; leafY < 3; ++leafY) {
            Row row = rowOf(around, x, leafY);
            const std::uint64_t any = row.words[0] | row.words[1] | row.words[2];
            if (!kTable && !any) continue;
            for (int y = leafY == 0 ? 8 - reach : 0; y < (leafY == 2 ? reach : 8); ++y) {
                if (any >> 8 * y & 255) {
                    fillRow<kTable>(row, y);
                } else if (kTable) {
                    for (int z = 0; z < side; ++z) *mNextStart++ = mCount;
                }
            }
        }
        if (mCount > most) return false;
    }
    mSlab[side] = mCount;
    if (kTable) *mNextStart = mCount;
    return true;
}

template <AblationFrame kFrame>
typename AblationHalo<kFrame>::Row AblationHalo<kFrame>::rowOf(const AblationNeighborhood& around, int x,
                                                               int leafY) const
{
    constexpr std::uint64_t kEachByte = 0x0101010101010101u;
    const std::uint64_t low = kEachByte * ((1u << mStructure.reach) - 1); // z below reach, in each byte
    const std::uint64_t inReach[3] = {low << (8 - mStructure.reach), ~std::uint64_t(0), low};
    const int leafX = (x + 8) >> 3;
    Row row{};
    row.word = x & 7;
    for (int leafZ = 0; leafZ < 3; ++leafZ) {
        const std::uint32_t l = around[static_cast<std::size_t>(leafX * 9 + leafY * 3 + leafZ)];
        row.leaf[leafZ] = l == kNoAblationLeaf ? nullptr : &mStructure.leaves[l];
        row.words[leafZ] = row.leaf[leafZ] ? row.leaf[leafZ]->occupancy[row.word] & inReach[leafZ] : 0;
    }
    row.shift[0] = Real(8 * (leafX - 1));
    row.shift[1] = Real(8 * (leafY - 1));
    return row;
}

template <AblationFrame kFrame>
template <bool kTable>
void AblationHalo<kFrame>::fillRow(Row& row, int y)
{
    const int reach = mStructure.reach;
    for (int leafZ = 0; leafZ < 3; ++leafZ) {
        const int z0 = leafZ == 0 ? 8 - reach : 0, z1 = leafZ == 2 ? reach : 8;
        const std::uint64_t bits = row.words[leafZ] & std::uint64_t(255) << 8 * y;
        if (!bits) {
            for (int z = z0; kTable && z < z1; ++z) *mNextStart++ = mCount;
            continue;
        }
        const AblationLeaf& leaf = *row.leaf[leafZ];
        const std::uint64_t below = leaf.occupancy[row.word] & ((bits & -bits) - 1);
        const std::uint32_t* cell =
            mStructure.cellStart.data() + leaf.firstCell[row.word] + __builtin_popcountll(below);
        const std::uint32_t begin = cell[0], end = cell[__builtin_popcountll(bits)];
        for (int z = z0; kTable && z < z1; ++z) {
            *mNextStart++ = mCount + (*cell - begin); // of the next occupied cell where this one is empty
            cell += bits >> (8 * y + z) & 1;
        }
        row.shift[2] = Real(8 * (leafZ - 1));
        copyRun(begin, end, row.shift);
    }
}

template <AblationFrame kFrame>
void AblationHalo<kFrame>::copyRun(std::uint32_t begin, std::uint32_t end, const Real* shift)
{
    constexpr bool kShifts = kFrame == AblationFrame::kLeafFloat;
    const std::uint32_t count = end - begin;
    const Real* const from[3] = {mStructure.x.data() + begin, mStructure.y.data() + begin,
                                 mStructure.z.data() + begin};
    Real* const to[3] = {mTo.x + mCount, mTo.y + mCount, mTo.z + mCount};
    for (int k = 0; k < 3; ++k) {
        const Real by = kShifts ? shift[k] : Real(0);
        for (std::uint32_t i = 0; i < count; ++i) to[k][i] = kShifts ? from[k][i] + by : from[k][i];
    }
    const std::uint32_t* const number = mStructure.number.data() + begin;
    for (std::uint32_t i = 0; i < count; ++i) mTo.number[mCount + i] = number[i];
    mCount += count;
}

} // namespace vdb_nns::cli
