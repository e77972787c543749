// The search of the part methods, over a AblationStructure: for each cell's queries, or each slab's of a sparse leaf, gather the
// candidates near them once, then test every query against those. One template, so that methods differ in one thing at
// a time: the frame of the coordinates, or what is done with the hits.
//
// The certified limits: PairLimits::within and sure are those of shared/membership.h for coordinates about the leaf's centre
// and this arithmetic (its section 2, sparse leaves): a computed square above `within` is surely no neighbor's, one up to
// `sure` surely a neighbor's. Coordinates here are at most 4 + 4e-6 about their leaf and so round by 2^-22, not 2^-23,
// but are moved only once, by 2^-22: 2^-21 in all, as there.
#pragma once

#include "bench/methods/ablation_halo-inl.h"
#include "bench/methods/row_method.h"
#include "verify/point_cells.h"

#include <algorithm>
#include <cstring>

namespace vdb_nns::cli {

enum class AblationTest {
    kFilter,    ///< the computed square decides
    kCertified, ///< pairs near the radius are decided exactly
    kSampled,   ///< candidates are drawn
    kNearest    ///< the nearest ones are kept
};

struct AblationSettings {
    SimdLevel simd = SimdLevel::kBest;
    std::uint32_t sampleMost = 0xffffffffu; ///< kSampled: see CandidateSample
    std::uint32_t nearest = 0;              ///< kNearest
};

/// One thread's memory.
template <AblationFrame kFrame>
struct AblationScratch {
    using Real = FrameReal<kFrame>;

    AblationScratch(const AblationStructure<kFrame>& structure, RowPool& pool) : halo(structure), rows(pool)
    {
    }

    AblationHalo<kFrame> halo;
    RowWriter rows;
    CandidateMemory<Real> kept;
    std::vector<CandidateRun> runs = std::vector<CandidateRun>(49);
    std::vector<std::uint32_t> numbers; // kNearest
    std::vector<Real> squares;
    std::vector<std::uint64_t> keys;
};

template <AblationFrame kFrame, AblationTest kTest>
class AblationSearch {
public:
    using Real = FrameReal<kFrame>;

    /// @param judge kCertified
    AblationSearch(const AblationStructure<kFrame>& structure, const PairLimits<Real>& limits,
                   const AblationSettings& settings, const PairJudge& judge)
        : mStructure(structure),
          mLimits(limits),
          mSettings(settings),
          mKernels(ablationKernels<Real>(settings.simd)),
          mJudge(judge)
    {
    }

    void searchLeaf(std::uint32_t leaf, AblationScratch<kFrame>& scratch) const;

private:
    // A leaf is sparse when it and its halo hold no more particles: then a table of cells costs more than it saves.
    static constexpr std::uint32_t kSparseMost = 512;

    void searchCells(const AblationLeaf& leaf, AblationScratch<kFrame>& scratch) const;
    void searchGroup(std::uint32_t begin, std::uint32_t end, std::uint32_t runCount,
                     AblationScratch<kFrame>& scratch) const;
    QueryBox<Real> boxOf(std::uint32_t begin, std::uint32_t end) const;
    void writeRow(const QueryPoint<Real>& query, const CandidateArrays<Real>& kept, std::uint32_t count,
                  AblationScratch<kFrame>& scratch) const;
    std::uint32_t decide(const QueryPoint<Real>& query, const CandidateArrays<Real>& kept,
                         std::uint32_t count, std::uint32_t* numbers) const;
    void writeNearest(const QueryPoint<Real>& query, const CandidateArrays<Real>& kept, std::uint32_t count,
                      AblationScratch<kFrame>& scratch) const;

    const AblationStructure<kFrame>& mStructure;
    const PairLimits<Real> mLimits;
    const AblationSettings mSettings;
    const AblationKernels<Real> mKernels;
    const PairJudge& mJudge;
};

template <AblationFrame kFrame, AblationTest kTest>
void AblationSearch<kFrame, kTest>::searchLeaf(std::uint32_t index, AblationScratch<kFrame>& scratch) const
{
    const AblationLeaf& leaf = mStructure.leaves[index];
    AblationHalo<kFrame>& halo = scratch.halo;
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

template <AblationFrame kFrame, AblationTest kTest>
void AblationSearch<kFrame, kTest>::searchCells(const AblationLeaf& leaf,
                                                AblationScratch<kFrame>& scratch) const
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

template <AblationFrame kFrame, AblationTest kTest>
QueryBox<FrameReal<kFrame>> AblationSearch<kFrame, kTest>::boxOf(std::uint32_t begin, std::uint32_t end) const
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

template <AblationFrame kFrame, AblationTest kTest>
void AblationSearch<kFrame, kTest>::searchGroup(std::uint32_t begin, std::uint32_t end,
                                                std::uint32_t runCount,
                                                AblationScratch<kFrame>& scratch) const
{
    std::size_t most = 0;
    for (std::uint32_t r = 0; r < runCount; ++r) most += scratch.runs[r].end - scratch.runs[r].begin;
    scratch.kept.reserve(most);
    const CandidateArrays<Real> kept = scratch.kept.arrays();
    CandidateSample sample;
    if (kTest == AblationTest::kSampled) sample = {sampleHash(begin, 0x2545f491u), mSettings.sampleMost};
    const GatherFunction<Real> gather =
        kTest == AblationTest::kSampled ? mKernels.gatherSample : mKernels.gather;
    const std::uint32_t count =
        gather(scratch.halo.candidates(), scratch.runs.data(), runCount, boxOf(begin, end), sample, kept);
    for (std::uint32_t s = begin; s < end; ++s) {
        const QueryPoint<Real> query{mStructure.x[s], mStructure.y[s], mStructure.z[s], mStructure.number[s]};
        if constexpr (kTest == AblationTest::kNearest) {
            writeNearest(query, kept, count, scratch);
        } else {
            writeRow(query, kept, count, scratch);
        }
    }
}

template <AblationFrame kFrame, AblationTest kTest>
void AblationSearch<kFrame, kTest>::writeRow(const QueryPoint<Real>& query, const CandidateArrays<Real>& kept,
                                             std::uint32_t count, AblationScratch<kFrame>& scratch) const
{
    std::uint32_t* const row = scratch.rows.reserve(std::size_t(count) + kVectorSlack);
    const bool certified = kTest == AblationTest::kCertified;
    const TestFunction<Real> test = certified ? mKernels.testBand : mKernels.test;
    QueryHits hits = test(kept, count, query, mLimits, row, nullptr);
    if (certified && hits.doubtful) hits.count = decide(query, kept, count, row);
    scratch.rows.commit(query.number, hits.count);
}

// Rare: the row once more, pair by pair.
template <AblationFrame kFrame, AblationTest kTest>
std::uint32_t AblationSearch<kFrame, kTest>::decide(const QueryPoint<Real>& query,
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

template <AblationFrame kFrame, AblationTest kTest>
void AblationSearch<kFrame, kTest>::writeNearest(const QueryPoint<Real>& query,
                                                 const CandidateArrays<Real>& kept, std::uint32_t count,
                                                 AblationScratch<kFrame>& scratch) const
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
            static_assert(sizeof(Real) == sizeof bits || kTest != AblationTest::kNearest);
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
