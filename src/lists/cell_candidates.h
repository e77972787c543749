// The candidates of a cell in visiting order: what the bits of a mask row stand for. Shared by everything that decodes.
#pragma once

#include "grid/search_sets_data.h"
#include "grid/wide_leaf.h"
#include "shared/traverse.h"

#include <cstdint>
#include <vector>

namespace vdb_nns {

// Calls f(first slot, end slot) for each run of candidates of the cell (x, y, z), 0 to 7, of the leaf that `neighborhood`
// surrounds: (dx, dy) lexicographic, z ascending.
template <typename F>
void forEachCandidateRun(const BlockView& block, const LeafNeighborhood& neighborhood, int x, int y, int z,
                         F&& f)
{
    const int reach = block.reach;
    for (int cx = x - reach; cx <= x + reach; ++cx) {
        for (int cy = y - reach; cy <= y + reach; ++cy) {
            for (int part = 0; part < 2; ++part) {
                const ColumnPiece piece = columnPiece(cx, cy, z, reach, part);
                if (piece.z0 > piece.z1) break;
                const std::uint32_t leaf =
                    neighborhood.leaf[neighborIndex(piece.leafX, piece.leafY, piece.leafZ)];
                if (leaf == kNoLeaf) continue;
                const SlotRange range = columnRange(block, leaf, cx & 7, cy & 7, piece.z0, piece.z1);
                if (range.begin != range.end) f(range.begin, range.end);
            }
        }
    }
}

inline BlockView blockViewOf(const SparseGridData& grid)
{
    return {grid.x.data(),      grid.y.data(),         grid.z.data(), grid.number.data(),
            grid.leaves.data(), grid.cellStart.data(), grid.reach()};
}

// An occupied cell of a leaf: its slots, and where it is.
struct QueryCell {
    std::uint32_t begin, end;
    int x, y, z;

    std::uint64_t bit() const { return std::uint64_t(1) << (8 * y + z); } // of word x of the occupancy
};

// Calls f(QueryCell) for each occupied cell of a leaf, in the order of slots.
template <typename F>
void forEachOccupiedCell(const BlockView& queries, std::uint32_t leafIndex, F&& f)
{
    const LeafRecord& leaf = queries.leaves[leafIndex];
    const std::uint32_t* cell = queries.cellStart + leaf.firstCell;
    for (int x = 0; x < 8; ++x) {
        for (std::uint64_t word = leaf.occupancy[x]; word; word &= word - 1, ++cell) {
            const int bit = __builtin_ctzll(word);
            f(QueryCell{cell[0], cell[1], x, bit >> 3, bit & 7});
        }
    }
}

// 32-bit words of a mask row's bits for so many candidates.
inline std::uint64_t maskWords(std::uint64_t candidates)
{
    return (candidates + 31) / 32;
}

// And how many particles the cells in its reach hold.
struct OccupiedCell : QueryCell {
    std::uint64_t candidates;

    std::uint64_t rowWords() const { return maskWords(candidates); }
};

// Calls f(OccupiedCell) for each occupied cell of a leaf of the queries, in the order of slots. `neighborhood`: leaves of the
// candidates around it, or around the leaf of wider cells in which it is at `wide`.
template <typename F>
void forEachOccupiedCell(const BlockView& queries, const BlockView& block, std::uint32_t leafIndex,
                         const LeafNeighborhood& neighborhood, const WidePlace* wide, F&& f)
{
    forEachOccupiedCell(queries, leafIndex, [&](const QueryCell& cell) {
        std::uint64_t candidates = 0;
        const auto add = [&](std::uint32_t begin, std::uint32_t end) { candidates += end - begin; };
        if (wide) {
            forEachCandidateRun(block, neighborhood, wide->wideCell(0, cell.x), wide->wideCell(1, cell.y),
                                wide->wideCell(2, cell.z), add);
        } else {
            forEachCandidateRun(block, neighborhood, cell.x, cell.y, cell.z, add);
        }
        f(OccupiedCell{cell, candidates});
    });
}

// Where the queries are the candidates.
template <typename F>
void forEachOccupiedCell(const BlockView& block, std::uint32_t leafIndex,
                         const LeafNeighborhood& neighborhood, F&& f)
{
    forEachOccupiedCell(block, block, leafIndex, neighborhood, nullptr, f);
}

// What the bits of a mask row stand for: runs of candidates, those of each lattice from a whole word on.
struct CandidateRuns {
    struct Run {
        const std::uint32_t* numbers;
        std::uint32_t count;
        std::uint64_t firstBit;
    };
    std::vector<Run> runs;
    std::vector<std::uint64_t> layerWords; // of each lattice: SearchPart::own, then `wider`
    std::uint64_t words = 0;
};

// Finds them for the cells of queries of a part. For one thread.
class CellCandidates {
public:
    // `part` outlives it.
    explicit CellCandidates(const SearchPart& part) : mPart(part), mWider(part.wider.size()) {}

    // `own`: the leaves of SearchPart::own around a leaf of the queries.
    void beginLeaf(std::size_t leaf, const LeafNeighborhood& own)
    {
        mOwn = own;
        for (std::size_t k = 0; k < mWider.size(); ++k) {
            const SearchLayer& layer = mPart.wider[k];
            const WideLeaf wide = wideLeafOf(mPart.queries->leafOrigins[leaf], layer.octaves);
            layer.candidates->topology.neighborhoods({&wide.origin, 1}, &mWider[k].neighborhood);
            mWider[k].place = wide.place;
        }
    }

    // Of a cell of the leaf. Valid until the next call.
    const CandidateRuns& of(int x, int y, int z)
    {
        mRuns.runs.clear();
        mRuns.layerWords.clear();
        mRuns.words = 0;
        add(*mPart.own.candidates, mOwn, x, y, z);
        for (std::size_t k = 0; k < mWider.size(); ++k) {
            const WidePlace& place = mWider[k].place;
            add(*mPart.wider[k].candidates, mWider[k].neighborhood, place.wideCell(0, x),
                place.wideCell(1, y), place.wideCell(2, z));
        }
        return mRuns;
    }

private:
    struct Wider {
        LeafNeighborhood neighborhood;
        WidePlace place;
    };

    void add(const SparseGridData& grid, const LeafNeighborhood& neighborhood, int x, int y, int z)
    {
        const std::uint64_t firstBit = 32 * mRuns.words;
        std::uint64_t bit = firstBit;
        forEachCandidateRun(blockViewOf(grid), neighborhood, x, y, z,
                            [&](std::uint32_t begin, std::uint32_t end) {
                                mRuns.runs.push_back({grid.number.data() + begin, end - begin, bit});
                                bit += end - begin;
                            });
        mRuns.layerWords.push_back(maskWords(bit - firstBit));
        mRuns.words += mRuns.layerWords.back();
    }

    const SearchPart& mPart;
    LeafNeighborhood mOwn;
    std::vector<Wider> mWider;
    CandidateRuns mRuns;
};

} // namespace vdb_nns
