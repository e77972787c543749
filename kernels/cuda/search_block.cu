// Finds the neighbors of the queries of a block. The block comes sorted by cell; nothing is sorted here.
//
// A warp has a group of 32 queries, which stand in one or more cells, one after the other. For each cell it
//   1. reads which slots its candidates have, as runs, one piece of a column to a lane;
//   2. gathers up to kWords * 32 of them into registers, about the cell's centre;
//   3. tests its queries against those, one after the other: each vote of the warp is one word of a mask row.
// Where rows begin is known before they are written: the rows of each group are added up first, by cell counts alone for
// masks and by a counting search for numbers, and summed over the groups before. So every row is written once, where it
// belongs, and results do not depend on the order of warps.
#include "cuda/gpu_config.cuh"
#include "cuda/launcher.cuh"
#include "cuda/search_block.h"
#include "shared/traverse.h"

#include <climits>
#include <cmath>

namespace vdb_nns::cuda {

namespace {

constexpr float kHalfLeaf = 3.5f; // from the centre of a leaf's lowest cell to the leaf's own

// What a pass over the groups makes.
enum class Pass {
    kCount,     // counts of neighbors
    kCountRows, // those, and their sum in each group
    kMeasure,   // the words of mask rows in each group, without a test
    kMasks,     // counts and mask rows
    kNumbers    // rows of numbers, by the counts that are there
};

struct GroupSearch {
    BlockImage image;
    FilterBounds bounds;
    ResultHead* head;
    std::uint64_t* leafRows;
    std::uint32_t* counts;
    std::uint32_t* rows;
    std::uint64_t* groups; // entries of rows of the groups before it in its tile, once they are added up
    std::uint64_t* tiles;  // the same of the tiles before it
    std::uint64_t groupCount, tileCount;
    ResultLayout layout;
    std::uint64_t roomBytes; // of the result, without the scratch
};

// The candidates of a cell: run k has those from first[k] on, at slots that are `offset` more; x, y, z is what brings their
// coordinates, about their leaf's centre, to the cell's centre. Multiples of 1/2, so the sum is the only rounding.
struct RunTable {
    std::uint32_t first[kMostPieces];
    std::uint32_t offset[kMostPieces];
    float x[kMostPieces], y[kMostPieces], z[kMostPieces];
    std::uint32_t begins
        [kWords]; // of the candidates that are gathered at a time: a bit for each with which a run begins
};

struct Candidates {
    std::uint32_t runs = 0, count = 0;
    std::uint32_t ownOffset = 0; // slot less candidate, in the cell's own run
};

// The cell that a warp is at, the same in all lanes.
struct CellCursor {
    std::uint32_t leaf, cell, endCell; // endCell: of the leaf
    LeafRecord record;
    int x;              // word of the occupancy
    std::uint64_t rest; // of that word: the cell's bit and those above it

    __device__ int y() const { return lowestBit(rest) >> 3; }
    __device__ int z() const { return lowestBit(rest) & 7; }

    __device__ void next(const BlockView& block)
    {
        if (++cell == endCell) {
            enter(block, leaf + 1);
        } else {
            rest &= rest - 1;
        }
        skipEmpty();
    }

    __device__ void enter(const BlockView& block, std::uint32_t number)
    {
        leaf = number;
        record = block.leaves[leaf];
        endCell = block.leaves[leaf + 1].firstCell;
        x = 0;
        rest = record.occupancy[0];
    }

    __device__ void skipEmpty()
    {
        while (rest == 0) rest = record.occupancy[++x];
    }
};

__device__ unsigned lane()
{
    return threadIdx.x % kWarpSize;
}

__device__ unsigned lanesBelow()
{
    return (1u << lane()) - 1;
}

template <typename T>
__device__ T fromLane(T value, unsigned source)
{
    return __shfl_sync(kAllLanes, value, static_cast<int>(source));
}

// The sum of the lanes up to this one.
template <typename T>
__device__ T sumUpTo(T value)
{
    for (unsigned step = 1; step < kWarpSize; step *= 2) {
        const T below = __shfl_up_sync(kAllLanes, value, step);
        if (lane() >= step) value += below;
    }
    return value;
}

// The last of n ascending values that is at most `value`; the first one is. By the whole warp, 32 at a time.
template <typename At>
__device__ std::uint32_t findLast(std::uint32_t n, std::uint32_t value, At at)
{
    std::uint32_t low = 0;
    while (n > 1) {
        const std::uint32_t step = (n + kWarpSize - 1) / kWarpSize, probe = lane() * step;
        const unsigned atMost = __ballot_sync(kAllLanes, probe < n && at(low + probe) <= value);
        const std::uint32_t skipped = static_cast<std::uint32_t>(31 - __clz(static_cast<int>(atMost))) * step;
        low += skipped;
        n = n - skipped < step ? n - skipped : step;
    }
    return low;
}

// The cell of an own slot.
__device__ CellCursor findCell(const BlockImage& image, std::uint32_t slot)
{
    const BlockView& block = image.block;
    CellCursor cursor;
    cursor.enter(block,
                 findLast(image.leaves, slot, [&](std::uint32_t l) { return block.leaves[l].firstSlot; }));
    const std::uint32_t* const starts = block.cellStart + cursor.record.firstCell;
    std::uint32_t before =
        findLast(cursor.endCell - cursor.record.firstCell, slot, [&](std::uint32_t c) { return starts[c]; });
    cursor.cell = cursor.record.firstCell + before;
    for (std::uint32_t in; (in = countBits(cursor.rest)) <= before; before -= in) {
        cursor.rest = cursor.record.occupancy[++cursor.x];
    }
    for (; before > 0; --before) cursor.rest &= cursor.rest - 1;
    return cursor;
}

// The runs of the candidates of a cell into the warp's table. The warp has read the last ones.
__device__ Candidates readRuns(const BlockImage& image, const CellCursor& cursor, std::uint32_t cellBegin,
                               RunTable& table)
{
    const BlockView& block = image.block;
    const std::uint32_t* const neighborhood =
        image.neighborhoods + std::size_t(cursor.leaf) * BlockImage::kNeighborhoodSize;
    const int pieces = pieceCount(block.reach), x = cursor.x, y = cursor.y(), z = cursor.z();
    Candidates found;
    for (int base = 0; base < pieces; base += static_cast<int>(kWarpSize)) {
        const int number = base + static_cast<int>(lane());
        SlotRange run{0, 0};
        ColumnPiece piece{0, 0, 0, 1, 0};
        if (number < pieces) piece = pieceOf(x, y, z, block.reach, number);
        if (piece.z0 <= piece.z1) {
            const std::uint32_t leaf = neighborhood[neighborIndex(piece.leafX, piece.leafY, piece.leafZ)];
            const int side = 2 * block.reach + 1, column = number >> 1;
            if (leaf != kNoLeaf) {
                run = columnRange(block, leaf, (x - block.reach + column / side) & 7,
                                  (y - block.reach + column % side) & 7, piece.z0, piece.z1);
            }
        }
        const std::uint32_t size = run.end - run.begin, upTo = sumUpTo(size),
                            first = found.count + upTo - size, offset = run.begin - first;
        const unsigned some = __ballot_sync(kAllLanes, size > 0);
        const unsigned own = __ballot_sync(kAllLanes, run.begin <= cellBegin && cellBegin < run.end);
        if (own) found.ownOffset = fromLane(offset, static_cast<unsigned>(__ffs(static_cast<int>(own)) - 1));
        if (size > 0) {
            const std::uint32_t at = found.runs + static_cast<std::uint32_t>(__popc(some & lanesBelow()));
            table.first[at] = first;
            table.offset[at] = offset;
            table.x[at] = static_cast<float>(8 * piece.leafX - x) + kHalfLeaf;
            table.y[at] = static_cast<float>(8 * piece.leafY - y) + kHalfLeaf;
            table.z[at] = static_cast<float>(8 * piece.leafZ - z) + kHalfLeaf;
        }
        found.count += fromLane(upTo, kWarpSize - 1);
        found.runs += static_cast<std::uint32_t>(__popc(some));
    }
    __syncwarp();
    return found;
}

// kWords * 32 candidates of a cell, one of each word to a lane.
struct Gathered {
    float x[kWords], y[kWords], z[kWords], w[kWords];
    std::uint32_t number[kWords]; // where rows of numbers are made
};

// Marks where runs begin among the candidates [begin, begin + kWords * 32). Returns how many runs begin before those.
__device__ std::uint32_t markRuns(const Candidates& candidates, std::uint32_t begin, RunTable& table)
{
    __syncwarp(); // the last marks are read
    if (lane() < kWords) table.begins[lane()] = 0;
    __syncwarp();
    std::uint32_t before = 0;
    for (std::uint32_t base = 0; base < candidates.runs; base += kWarpSize) {
        const std::uint32_t run = base + lane();
        const bool isRun = run < candidates.runs;
        const std::uint32_t first = isRun ? table.first[run] : 0;
        before += static_cast<std::uint32_t>(__popc(__ballot_sync(kAllLanes, isRun && first < begin)));
        if (isRun && first >= begin && first - begin < kWords * kWarpSize) {
            atomicOr(&table.begins[(first - begin) / 32], 1u << (first - begin) % 32);
        }
    }
    __syncwarp();
    return before;
}

// The run of this lane's candidate of a word; `before`: how many begin before the word.
__device__ std::uint32_t runOf(std::uint32_t begins, std::uint32_t before)
{
    return before + static_cast<std::uint32_t>(__popc(begins & (lanesBelow() << 1 | 1))) - 1;
}

template <bool kWithNumbers>
__device__ void gather(const BlockView& block, RunTable& table, const Candidates& candidates,
                       std::uint32_t begin, Gathered& out)
{
    std::uint32_t before = markRuns(candidates, begin, table);
    const std::uint32_t last = candidates.count - 1;
#pragma unroll
    for (int k = 0; k < kWords; ++k) {
        const std::uint32_t candidate = begin + static_cast<std::uint32_t>(k) * kWarpSize + lane();
        const std::uint32_t begins = table.begins[k], run = runOf(begins, before);
        before += static_cast<std::uint32_t>(__popc(begins));
        if (kFormer && candidate > last) {
            out.x[k] = out.y[k] = out.z[k] = 0;
            out.w[k] = INFINITY;
            continue;
        }
        // Without a branch, so that the loads of all words are under way at once.
        const std::uint32_t slot = (kFormer || candidate < last ? candidate : last) + table.offset[run];
        out.x[k] = block.x[slot] + table.x[run];
        out.y[k] = block.y[slot] + table.y[run];
        out.z[k] = block.z[slot] + table.z[run];
        out.w[k] = kFormer || candidate <= last ? squaredNorm(out.x[k], out.y[k], out.z[k]) : INFINITY;
        if (kWithNumbers) out.number[k] = block.number[slot];
    }
}

// Scores of a query against the first kCount words. Returns the least: whether any candidate is in the band.
template <int kCount>
__device__ std::int32_t scoreWords(const QueryTerms& query, const Gathered& gathered,
                                   std::int32_t (&bits)[kWords])
{
    std::int32_t least = INT_MAX;
#pragma unroll
    for (int k = 0; k < kCount; ++k) {
        bits[k] = scoreBits(query, gathered.x[k], gathered.y[k], gathered.z[k], gathered.w[k]);
        least = bits[k] < least ? bits[k] : least;
    }
    return least;
}

// The votes on the first kCount words, all of them in all lanes.
template <int kCount>
__device__ void voteWords(const std::int32_t (&bits)[kWords], std::uint32_t (&hits)[kWords])
{
#pragma unroll
    for (int k = 0; k < kCount; ++k) hits[k] = __ballot_sync(kAllLanes, bits[k] < 0);
}

// Of kCount words, a power of two, that which has the number of the lane, or of the lane modulo kCount.
template <int kCount>
__device__ std::uint32_t wordOfLane(const std::uint32_t (&words)[kWords])
{
    std::uint32_t chosen[kWords];
#pragma unroll
    for (int k = 0; k < kCount; ++k) chosen[k] = words[k];
#pragma unroll
    for (int step = 1; step < kCount; step *= 2) {
#pragma unroll
        for (int k = 0; k < kCount; k += 2 * step) {
            chosen[k] = lane() & static_cast<unsigned>(step) ? chosen[k + step] : chosen[k];
        }
    }
    return chosen[0];
}

// Lists the candidates of a query that are in the band, of those from `begin` on that are gathered at a time. Rare: once in
// some hundred queries. So it is kept apart, and reads them again.
__device__ __noinline__ void listUndecided(const GroupSearch& search, const RunTable& table,
                                           Candidates candidates, QueryTerms query, std::uint32_t begin,
                                           std::uint32_t queryNumber, std::uint64_t rowBit)
{
    const BlockView& block = search.image.block;
    const std::uint64_t rowBytes = search.head->rowBytes, listBegin = search.layout.undecided(rowBytes);
    auto* const list =
        reinterpret_cast<UndecidedPair*>(reinterpret_cast<std::byte*>(search.head) + listBegin);
    const std::uint64_t most =
        listBegin < search.roomBytes ? (search.roomBytes - listBegin) / sizeof(UndecidedPair) : 0;
    for (std::uint32_t word = 0; word < kWords; ++word) {
        const std::uint32_t candidate = begin + word * kWarpSize + lane();
        std::uint32_t slot = 0;
        bool isInBand = false;
        if (candidate < candidates.count) {
            std::uint32_t run = candidates.runs - 1;
            while (table.first[run] > candidate) --run;
            slot = candidate + table.offset[run];
            const float x = block.x[slot] + table.x[run], y = block.y[slot] + table.y[run],
                        z = block.z[slot] + table.z[run];
            isInBand = scoreBits(query, x, y, z, squaredNorm(x, y, z)) <= search.bounds.bandTop;
        }
        const unsigned band = __ballot_sync(kAllLanes, isInBand);
        if (!band) continue;
        unsigned long long at = 0;
        if (lane() == 0) {
            at = atomicAdd(reinterpret_cast<unsigned long long*>(&search.head->undecided),
                           static_cast<unsigned long long>(__popc(band)));
        }
        at = fromLane(at, 0) + static_cast<unsigned long long>(__popc(band & lanesBelow()));
        if (isInBand && at < most) list[at] = {queryNumber, block.number[slot], rowBit + candidate};
    }
}

// Neighbors of this lane's query, and where its row goes on.
struct OwnQuery {
    std::uint32_t count = 0;
    std::uint64_t next = 0;
};

// Some queries of a cell, and what they share.
struct CellQueries {
    std::uint32_t first, begin, end; // slots: of the group, and of those in the cell
    std::uint64_t firstWord;         // where their mask rows begin
    bool hasRoom;                    // for mask rows
};

// The queries of a cell against `words` words of gathered candidates, which begin with candidate `chunk`. kCount: how many
// words are tested, those that have no candidates included.
template <Pass kPass, int kCount>
__device__ void searchGathered(const GroupSearch& search, const RunTable& table, const Candidates& candidates,
                               const Gathered& gathered, const QueryTerms& ownTerms,
                               const CellQueries& queries, std::uint32_t chunk, OwnQuery& own)
{
    constexpr bool kNumbers = kPass == Pass::kNumbers, kMasks = kPass == Pass::kMasks;
    constexpr bool kListsUndecided = kPass != Pass::kCountRows;
    const std::uint32_t rowWords = (candidates.count + 31) / 32, wordsLeft = rowWords - chunk / 32;
    std::uint64_t row = queries.firstWord + chunk / 32;
    std::uint32_t self = queries.begin - candidates.ownOffset - chunk; // huge where it is of another chunk
    for (std::uint32_t slot = queries.begin; slot < queries.end; ++slot, ++self, row += rowWords) {
        const unsigned owner = slot - queries.first;
        const QueryTerms query{fromLane(ownTerms.ax, owner), fromLane(ownTerms.ay, owner),
                               fromLane(ownTerms.az, owner), fromLane(ownTerms.k, owner)};
        std::int32_t bits[kWords];
        std::uint32_t hits[kWords];
        const std::int32_t least = scoreWords<kCount>(query, gathered, bits);
        voteWords<kCount>(bits, hits);
        if (kNumbers) {
            std::uint64_t next = fromLane(own.next, owner);
#pragma unroll
            for (int k = 0; k < kCount; ++k) {
                const bool hasSelf = self / 32 == static_cast<std::uint32_t>(k);
                const std::uint32_t others = ~(1u << self % 32);
                if (kFormer) {
                    if (hasSelf) hits[k] &= others;
                } else {
                    // Chosen, not branched: for a branch the compiler keeps the words in local memory.
                    hits[k] &= hasSelf ? others : ~0u;
                }
                if (hits[k] >> lane() & 1) {
                    search.rows[next + static_cast<unsigned>(__popc(hits[k] & lanesBelow()))] =
                        gathered.number[k];
                }
                next += static_cast<unsigned>(__popc(hits[k]));
            }
            if (lane() == owner) own.next = next;
        } else {
            std::uint32_t word = wordOfLane<kCount>(hits);
            if (lane() % kCount == self / 32) word &= ~(1u << self % 32);
            int count = __popc(word);
#pragma unroll
            for (int step = 1; step < kCount; step *= 2) count += __shfl_xor_sync(kAllLanes, count, step);
            if (lane() == owner) own.count += static_cast<std::uint32_t>(count);
            if (kMasks && queries.hasRoom && lane() < kCount && lane() < wordsLeft) {
                search.rows[row + lane()] = word;
            }
        }
        if (kListsUndecided && __any_sync(kAllLanes, least <= search.bounds.bandTop)) {
            listUndecided(search, table, candidates, query, chunk, slot - search.image.firstQuery,
                          (row - chunk / 32) * 32);
        }
    }
}

// The queries of a cell against all its candidates.
template <Pass kPass>
__device__ void searchCell(const GroupSearch& search, RunTable& table, const Candidates& candidates,
                           const QueryTerms& ownTerms, const CellQueries& queries, OwnQuery& own)
{
    for (std::uint32_t chunk = 0; chunk < candidates.count; chunk += kWords * kWarpSize) {
        Gathered gathered;
        gather<kPass == Pass::kNumbers>(search.image.block, table, candidates, chunk, gathered);
        const std::uint32_t left = candidates.count - chunk;
        if (left > kWords / 2 * kWarpSize) {
            searchGathered<kPass, kWords>(search, table, candidates, gathered, ownTerms, queries, chunk, own);
        } else if (left > kWords / 4 * kWarpSize) {
            searchGathered<kPass, kWords / 2>(search, table, candidates, gathered, ownTerms, queries, chunk,
                                              own);
        } else {
            searchGathered<kPass, kWords / 4>(search, table, candidates, gathered, ownTerms, queries, chunk,
                                              own);
        }
    }
}

template <Pass kPass>
__device__ void searchGroup(const GroupSearch& search, std::uint64_t group, RunTable& table)
{
    constexpr bool kTests = kPass != Pass::kMeasure, kMasks = kPass == Pass::kMasks,
                   kNumbers = kPass == Pass::kNumbers;
    const BlockImage& image = search.image;
    const BlockView& block = image.block;
    const std::uint32_t first = image.firstQuery + static_cast<std::uint32_t>(group) * kGroupQueries;
    const std::uint32_t end = image.endQuery - first < kGroupQueries ? image.endQuery : first + kGroupQueries;
    const std::uint32_t ownSlot = first + lane();
    const bool hasQuery = ownSlot < end;
    float x = 0, y = 0, z = 0;
    if (kTests && hasQuery) {
        x = block.x[ownSlot];
        y = block.y[ownSlot];
        z = block.z[ownSlot];
    }
    OwnQuery own;
    std::uint64_t entries = 0; // of rows before the cell
    if (kMasks || kNumbers) entries = search.groups[group] + search.tiles[group / kTileGroups];
    const bool hasRoom = search.layout.rows + search.head->rowBytes <= search.roomBytes;
    if (kNumbers) {
        if (!hasRoom) return;
        const std::uint32_t count = hasQuery ? search.counts[ownSlot - image.firstQuery] : 0;
        own.next = entries + sumUpTo(std::uint64_t(count)) - count;
    }
    CellCursor cursor = findCell(image, first);
    for (std::uint32_t slot = first;;) {
        const std::uint32_t cellBegin = block.cellStart[cursor.cell],
                            cellEnd = block.cellStart[cursor.cell + 1];
        const std::uint32_t stop = cellEnd < end ? cellEnd : end;
        const std::uint32_t leafBegin = cursor.record.firstSlot;
        if (kMasks && slot == (leafBegin > image.firstQuery ? leafBegin : image.firstQuery) && lane() == 0) {
            search.leafRows[cursor.leaf] = entries;
        }
        const std::uint64_t* const wanted = image.cellsOf(cursor.leaf);
        if (!wanted || (wanted[cursor.x] & cursor.rest & (~cursor.rest + 1))) {
            const Candidates candidates = readRuns(image, cursor, cellBegin, table);
            if (kTests) {
                const QueryTerms terms =
                    queryTerms(search.bounds, x + (kHalfLeaf - static_cast<float>(cursor.x)),
                               y + (kHalfLeaf - static_cast<float>(cursor.y())),
                               z + (kHalfLeaf - static_cast<float>(cursor.z())));
                searchCell<kPass>(search, table, candidates, terms, {first, slot, stop, entries, hasRoom},
                                  own);
                __syncwarp(); // the table is read
            }
            if (kMasks || !kTests) entries += std::uint64_t(stop - slot) * ((candidates.count + 31) / 32);
        }
        slot = stop;
        if (slot >= end) break;
        cursor.next(block);
    }
    if ((kTests && !kNumbers) && hasQuery) search.counts[ownSlot - image.firstQuery] = own.count;
    if (kPass == Pass::kCountRows) entries = fromLane(sumUpTo(std::uint64_t(own.count)), kWarpSize - 1);
    if ((kPass == Pass::kCountRows || !kTests) && lane() == 0) search.groups[group] = entries;
}

template <Pass kPass>
__global__ void __launch_bounds__(kWarps* kWarpSize, kPass == Pass::kNumbers ? kNumberBlocks : kSearchBlocks)
    searchGroupsKernel(const __grid_constant__ GroupSearch search)
{
    __shared__ RunTable tables[kWarps];
    const unsigned warp = threadIdx.x / kWarpSize;
    const std::uint64_t group = std::uint64_t(blockIdx.x) * kWarps + warp;
    if (group < search.groupCount) searchGroup<kPass>(search, group, tables[warp]);
}

// The sum of `value` over the threads before this one, of kScanThreads; and over all.
__device__ std::uint64_t sumBefore(std::uint64_t value, std::uint64_t& all)
{
    constexpr unsigned kScanWarps = kScanThreads / kWarpSize;
    __shared__ std::uint64_t sums[kScanWarps];
    const std::uint64_t upTo = sumUpTo(value);
    if (lane() == kWarpSize - 1) sums[threadIdx.x / kWarpSize] = upTo;
    __syncthreads();
    std::uint64_t before = upTo - value;
    all = 0;
    for (unsigned w = 0; w < kScanWarps; ++w) {
        if (w < threadIdx.x / kWarpSize) before += sums[w];
        all += sums[w];
    }
    __syncthreads(); // the sums are read
    return before;
}

// A block of threads for each tile.
__global__ void __launch_bounds__(kScanThreads) addGroupsKernel(const GroupSearch search)
{
    constexpr unsigned kEach = kTileGroups / kScanThreads;
    const std::uint64_t begin = std::uint64_t(blockIdx.x) * kTileGroups + threadIdx.x * kEach;
    std::uint64_t entries[kEach], sum = 0, all;
    for (unsigned i = 0; i < kEach; ++i) {
        entries[i] = begin + i < search.groupCount ? search.groups[begin + i] : 0;
        sum += entries[i];
    }
    std::uint64_t before = sumBefore(sum, all);
    for (unsigned i = 0; i < kEach; before += entries[i++]) {
        if (begin + i < search.groupCount) search.groups[begin + i] = before;
    }
    if (threadIdx.x == 0) search.tiles[blockIdx.x] = all;
}

// One thread. A kernel, as results may stand in host memory, which no memset is promised to reach.
__global__ void clearHeadKernel(const __grid_constant__ GroupSearch search)
{
    *search.head = {};
}

// One block of threads for all tiles.
__global__ void __launch_bounds__(kScanThreads) addTilesKernel(const GroupSearch search)
{
    std::uint64_t before = 0, all;
    for (std::uint64_t base = 0; base < search.tileCount; base += kScanThreads, before += all) {
        const std::uint64_t tile = base + threadIdx.x;
        const std::uint64_t entries = tile < search.tileCount ? search.tiles[tile] : 0;
        const std::uint64_t begin = before + sumBefore(entries, all);
        if (tile < search.tileCount) search.tiles[tile] = begin;
    }
    if (threadIdx.x == 0) search.head->rowBytes = before * sizeof(std::uint32_t);
}

template <Pass kPass>
void launchGroupsAsync(const char* label, const GroupSearch& search, cudaStream_t stream)
{
    launch(label, searchGroupsKernel<kPass>, (search.groupCount + kWarps - 1) / kWarps, kWarps * kWarpSize,
           stream, search);
}

void launchSumsAsync(const GroupSearch& search, cudaStream_t stream)
{
    launch("add up groups", addGroupsKernel, search.tileCount, kScanThreads, stream, search);
    launch("add up tiles", addTilesKernel, 1, kScanThreads, stream, search);
}

template <typename... Parameters>
void load(void (*kernel)(Parameters...))
{
    cudaFuncAttributes attributes;
    VDB_NNS_CUDA_CHECK(cudaFuncGetAttributes(&attributes, kernel));
}

} // namespace

void loadKernels()
{
    load(clearHeadKernel);
    load(addGroupsKernel);
    load(addTilesKernel);
    load(searchGroupsKernel<Pass::kCount>);
    load(searchGroupsKernel<Pass::kCountRows>);
    load(searchGroupsKernel<Pass::kMeasure>);
    load(searchGroupsKernel<Pass::kMasks>);
    load(searchGroupsKernel<Pass::kNumbers>);
}

void launchSearchAsync(const BlockSearch& block, cudaStream_t stream)
{
    const std::uint64_t queries = block.image.endQuery - block.image.firstQuery;
    const GroupCounts counts = groupCounts(queries);
    GroupSearch search{};
    search.image = block.image;
    search.bounds = block.bounds;
    search.layout = resultLayout(block.image.leaves, queries, block.encoding);
    search.head = reinterpret_cast<ResultHead*>(block.result);
    search.leafRows = reinterpret_cast<std::uint64_t*>(block.result + search.layout.leafRows);
    search.counts = reinterpret_cast<std::uint32_t*>(block.result + search.layout.counts);
    search.rows = reinterpret_cast<std::uint32_t*>(block.result + search.layout.rows);
    search.roomBytes = resultRoom(block.resultBytes, queries, block.encoding);
    search.groups = reinterpret_cast<std::uint64_t*>(block.result + search.roomBytes);
    search.tiles = search.groups + counts.groups;
    search.groupCount = counts.groups;
    search.tileCount = counts.tiles;
    launch("clear head", clearHeadKernel, 1, 1, stream, search);
    if (queries == 0) return;
    switch (block.encoding) {
    case Encoding::kNone:
        launchGroupsAsync<Pass::kCount>("count neighbors", search, stream);
        break;
    case Encoding::kMask:
        launchGroupsAsync<Pass::kMeasure>("measure masks", search, stream);
        launchSumsAsync(search, stream);
        launchGroupsAsync<Pass::kMasks>("make masks", search, stream);
        break;
    case Encoding::kIndex:
        launchGroupsAsync<Pass::kCountRows>("count neighbors for rows", search, stream);
        launchSumsAsync(search, stream);
        launchGroupsAsync<Pass::kNumbers>("make rows of numbers", search, stream);
        break;
    }
}

} // namespace vdb_nns::cuda
