// The search of the part methods, over a PartStructure: for each cell's queries, or each slab's of a sparse leaf, gather the
// candidates near them once, then test every query against those. One template, so that methods differ in one thing at
// a time: the frame of the coordinates, or what is done with the hits.
//
// The certified limits: PairLimits::within and sure are those of shared/membership.h for coordinates about the leaf's centre
// and this arithmetic (its section 2, sparse leaves): a computed square above `within` is surely no neighbor's, one up to
// `sure` surely a neighbor's. Coordinates here are at most 4 + 4e-6 about their leaf and so round by 2^-22, not 2^-23,
// but are moved only once, by 2^-22: 2^-21 in all, as there.
#pragma once

#include "bench/methods/part_halo-inl.h"
#include "bench/methods/row_method.h"
#include "verify/point_cells.h"

#include <algorithm>
#include <cstring>

namespace vdb_nns::cli {

enum class PartTest {
    kFilter,    ///< the computed square decides
    kCertified, ///< pairs near the radius are decided exactly
    kSampled,   ///< candidates are drawn
    kNearest    ///< the nearest ones are kept
};

struct PartSettings {
    SimdLevel simd = SimdLevel::kBest;
    std::uint32_t sampleMost = 0xffffffffu; ///< kSampled: see CandidateSample
    std::uint32_t nearest = 0;              ///< kNearest
};

/// One thread's memory.
template <PartFrame kFrame>
struct PartScratch {
    using Real = FrameReal<kFrame>;

    PartScratch(const PartStructure<kFrame>& structure, RowPool& pool) : halo(structure), rows(pool) {}

    PartHalo<kFrame> halo;
    RowWriter rows;
    CandidateMemory<Real> kept;
    std::vector<CandidateRun> runs = std::vector<CandidateRun>(49);
    std::vector<std::uint32_t> numbers; // kNearest
    std::vector<Real> squares;
    std::vector<std::uint64_t> keys;
};

template <PartFrame kFrame, PartTest kTest>
class PartSearch {
public:
    using Real = FrameReal<kFrame>;

    /// @param judge kCertified
    PartSearch(const PartStructure<kFrame>& structure, const PairLimits<Real>& limits,
               const PartSettings& settings, const PairJudge& judge)
        : mStructure(structure),
          mLimits(limits),
          mSettings(settings),
          mKernels(partKernels<Real>(settings.simd)),
          mJudge(judge)
    {
    }

    void searchLeaf(std::uint32_t leaf, PartScratch<kFrame>& scratch) const;

private:
    // A leaf is sparse when it and its halo hold no more particles: then a table of cells costs more than it saves.
    static constexpr std::uint32_t kSparseMost = 512;

    void searchCells(const PartLeaf& leaf, PartScratch<kFrame>& scratch) const;
    void searchGroup(std::uint32_t begin, std::uint32_t end, std::uint32_t runCount,
                     PartScratch<kFrame>& scratch) const;
    QueryBox<Real> boxOf(std::uint32_t begin, std::uint32_t end) const;
    void writeRow(const QueryPoint<Real>& query, const CandidateArrays<Real>& kept, std::uint32_t count,
                  PartScratch<kFrame>& scratch) const;
    std::uint32_t decide(const QueryPoint<Real>& query, const CandidateArrays<Real>& kept,
                         std::uint32_t count, std::uint32_t* numbers) const;
    void writeNearest(const QueryPoint<Real>& query, const CandidateArrays<Real>& kept, std::uint32_t count,
                      PartScratch<kFrame>& scratch) const;

    const PartStructure<kFrame>& mStructure;
    const PairLimits<Real> mLimits;
    const PartSettings mSettings;
    const PartKernels<Real> mKernels;
    const PairJudge& mJudge;
};

template <PartFrame kFrame, PartTest kTest>
void PartSearch<kFrame, kTest>::searchLeaf(std::uint32_t index, PartScratch<kFrame>& scratch) const
{
    const PartLeaf& leaf = mStructure.leaves[index];
    PartHalo<kFrame>& halo = scratch.halo;
    if (leaf.endSlot - leaf.firstSlot > kSparseMost || !halo.template fill<false>(index, kSparseMost)) {
        halo.template fill<true>(index, ~std::uint64_t(0));
        return searchCells(leaf, scratch);
    }
    for (int x = 0; x < 8; ++x) {
        if (!leaf.occupancy[x]) continue;
        scratch.runs[0] = halo.slabs(x);
        const std::uint32_t* const cell = mStructure.cellStart.data() + leaf.firstCell[x];
        searchGroup(cell[0], cell[__builtin_popcountll(leaf.occupancy[x])], 1, scratch);
    }
}

template <PartFrame kFrame, PartTest kTest>
void PartSearch<kFrame, kTest>::searchCells(const PartLeaf& leaf, PartScratch<kFrame>& scratch) const
{
    const int reach = mStructure.reach;
    for (int x = 0; x < 8; ++x) {
        const std::uint32_t* cell = mStructure.cellStart.data() + leaf.firstCell[x];
        for (std::uint64_t word = leaf.occupancy[x]; word; word &= word - 1, ++cell) {
            const int bit = __builtin_ctzll(word), y = bit >> 3, z = bit & 7;
            std::uint32_t runs = 0;
            for (int cx = x - reach; cx <= x + reach; ++cx) {
                for (int cy = y - reach; cy <= y + reach; ++cy) {
                    const CandidateRun run = scratch.halo.column(cx, cy, z);
                    scratch.runs[runs] = run;
                    runs += run.begin < run.end;
                }
            }
            searchGroup(cell[0], cell[1], runs, scratch);
        }
    }
}

template <PartFrame kFrame, PartTest kTest>
QueryBox<FrameReal<kFrame>> PartSearch<kFrame, kTest>::boxOf(std::uint32_t begin, std::uint32_t end) const
{
    const Real* const axes[3] = {mStructure.x.data(), mStructure.y.data(), mStructure.z.data()};
    QueryBox<Real> box;
    for (int k = 0; k < 3; ++k) {
        Real low = axes[k][begin], high = low;
        for (std::uint32_t s = begin + 1; s < end; ++s) {
            low = std::min(low, axes[k][s]);
            high = std::max(high, axes[k][s]);
        }
        box.center[k] = low + (high - low) / 2;
        box.half[k] = std::max(high - box.center[k], box.center[k] - low);
    }
    // Far more than the roundings of a distance from the box, which are a few units in the last place of the distance
    // from its centre.
    box.keep = mLimits.within * Real(1.00005);
    return box;
}

template <PartFrame kFrame, PartTest kTest>
void PartSearch<kFrame, kTest>::searchGroup(std::uint32_t begin, std::uint32_t end, std::uint32_t runCount,
                                            PartScratch<kFrame>& scratch) const
{
    std::size_t most = 0;
    for (std::uint32_t r = 0; r < runCount; ++r) most += scratch.runs[r].end - scratch.runs[r].begin;
    scratch.kept.reserve(most);
    const CandidateArrays<Real> kept = scratch.kept.arrays();
    CandidateSample sample;
    if (kTest == PartTest::kSampled) sample = {sampleHash(begin, 0x2545f491u), mSettings.sampleMost};
    const GatherFunction<Real> gather = kTest == PartTest::kSampled ? mKernels.gatherSample : mKernels.gather;
    const std::uint32_t count =
        gather(scratch.halo.candidates(), scratch.runs.data(), runCount, boxOf(begin, end), sample, kept);
    for (std::uint32_t s = begin; s < end; ++s) {
        const QueryPoint<Real> query{mStructure.x[s], mStructure.y[s], mStructure.z[s], mStructure.number[s]};
        if constexpr (kTest == PartTest::kNearest) {
            writeNearest(query, kept, count, scratch);
        } else {
            writeRow(query, kept, count, scratch);
        }
    }
}

template <PartFrame kFrame, PartTest kTest>
void PartSearch<kFrame, kTest>::writeRow(const QueryPoint<Real>& query, const CandidateArrays<Real>& kept,
                                         std::uint32_t count, PartScratch<kFrame>& scratch) const
{
    std::uint32_t* const row = scratch.rows.reserve(std::size_t(count) + kVectorSlack);
    const bool certified = kTest == PartTest::kCertified;
    const TestFunction<Real> test = certified ? mKernels.testBand : mKernels.test;
    QueryHits hits = test(kept, count, query, mLimits, row, nullptr);
    if (certified && hits.doubtful) hits.count = decide(query, kept, count, row);
    scratch.rows.commit(query.number, hits.count);
}

// Rare: the row once more, pair by pair.
template <PartFrame kFrame, PartTest kTest>
std::uint32_t PartSearch<kFrame, kTest>::decide(const QueryPoint<Real>& query,
                                                const CandidateArrays<Real>& kept, std::uint32_t count,
                                                std::uint32_t* numbers) const
{
    std::uint32_t hits = 0;
    for (std::uint32_t i = 0; i < count; ++i) {
        const Real square = squaredDistance(kept.x[i] - query.x, kept.y[i] - query.y, kept.z[i] - query.z);
        if (!(square <= mLimits.within) || kept.number[i] == query.number) continue;
        if (square <= mLimits.sure || mJudge.within(query.number, kept.number[i])) {
            numbers[hits++] = kept.number[i];
        }
    }
    return hits;
}

template <PartFrame kFrame, PartTest kTest>
void PartSearch<kFrame, kTest>::writeNearest(const QueryPoint<Real>& query, const CandidateArrays<Real>& kept,
                                             std::uint32_t count, PartScratch<kFrame>& scratch) const
{
    if (scratch.numbers.size() < count + kVectorSlack) {
        scratch.numbers.resize(2 * std::size_t(count) + kVectorSlack);
        scratch.squares.resize(scratch.numbers.size());
        scratch.keys.resize(scratch.numbers.size());
    }
    std::uint32_t* const numbers = scratch.numbers.data();
    std::uint32_t hits =
        mKernels.testSquares(kept, count, query, mLimits, numbers, scratch.squares.data()).count;
    if (hits > mSettings.nearest) {
        // Squares are not negative: their bits are in the order of their values, and the number breaks ties.
        std::uint64_t* const keys = scratch.keys.data();
        for (std::uint32_t i = 0; i < hits; ++i) {
            std::uint32_t bits;
            static_assert(sizeof(Real) == sizeof bits || kTest != PartTest::kNearest);
            std::memcpy(&bits, &scratch.squares[i], sizeof bits);
            keys[i] = std::uint64_t(bits) << 32 | numbers[i];
        }
        std::nth_element(keys, keys + mSettings.nearest, keys + hits);
        hits = mSettings.nearest;
        for (std::uint32_t i = 0; i < hits; ++i) numbers[i] = static_cast<std::uint32_t>(keys[i]);
    }
    scratch.rows.append(query.number, numbers, hits);
}

} // namespace vdb_nns::cli
