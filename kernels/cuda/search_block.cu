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

// The candidates of a cell: run k has those from first[k] on, at slots that are `offset` more.
struct RunTable {
    std::uint32_t first[kMostPieces];
    std::uint32_t offset[kMostPieces];
    std::uint32_t leaf[kMostPieces]; // steps to the leaf, plus one, in fields of 2 bits
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
            table.leaf[at] = static_cast<std::uint32_t>((piece.leafX + 1) | (piece.leafY + 1) << 2 |
                                                        (piece.leafZ + 1) << 4);
        }
        found.count += fromLane(upTo, kWarpSize - 1);
        found.runs += static_cast<std::uint32_t>(__popc(some));
    }
    __syncwarp();
    return found;
}

// The run that a candidate is in.
__device__ std::uint32_t runOf(const RunTable& table, std::uint32_t runs, std::uint32_t candidate)
{
    std::uint32_t run = 0;
    for (std::uint32_t step = 1u << (31 - __clz(static_cast<int>(runs))); step > 0; step /= 2) {
        if (run + step < runs && table.first[run + step] <= candidate) run += step;
    }
    return run;
}

// kWords * 32 candidates of a cell, one of each word to a lane.
struct Gathered {
    float x[kWords], y[kWords], z[kWords], w[kWords];
    std::uint32_t number[kWords]; // where rows of numbers are made
};

template <bool kWithNumbers>
__device__ void gather(const BlockView& block, const RunTable& table, const Candidates& candidates,
                       std::uint32_t begin, float centerX, float centerY, float centerZ, Gathered& out)
{
#pragma unroll
    for (int k = 0; k < kWords; ++k) {
        const std::uint32_t candidate = begin + static_cast<std::uint32_t>(k) * kWarpSize + lane();
        out.x[k] = out.y[k] = out.z[k] = 0;
        out.w[k] = INFINITY;
        if (candidate >= candidates.count) continue;
        const std::uint32_t run = runOf(table, candidates.runs, candidate);
        const std::uint32_t slot = candidate + table.offset[run], leaf = table.leaf[run];
        const auto leafStep = [&](int axis) {
            return 8.0f * static_cast<float>(static_cast<int>(leaf >> 2 * axis & 3) - 1);
        };
        out.x[k] = block.x[slot] + leafStep(0) - centerX;
        out.y[k] = block.y[slot] + leafStep(1) - centerY;
        out.z[k] = block.z[slot] + leafStep(2) - centerZ;
        out.w[k] = squaredNorm(out.x[k], out.y[k], out.z[k]);
        if (kWithNumbers) out.number[k] = block.number[slot];
    }
}

// Lists the candidates of a query that are in the band. Rare: once in some hundred queries.
__device__ void listUndecided(const GroupSearch& search, const RunTable& table, const Candidates& candidates,
                              const Gathered& gathered, const QueryTerms& query, std::uint32_t begin,
                              std::uint32_t queryNumber, std::uint64_t rowBit)
{
    const std::uint64_t rowBytes = search.head->rowBytes, listBegin = search.layout.undecided(rowBytes);
    auto* const list =
        reinterpret_cast<UndecidedPair*>(reinterpret_cast<std::byte*>(search.head) + listBegin);
    const std::uint64_t most =
        listBegin < search.roomBytes ? (search.roomBytes - listBegin) / sizeof(UndecidedPair) : 0;
#pragma unroll
    for (int k = 0; k < kWords; ++k) {
        const std::int32_t bits =
            scoreBits(query, gathered.x[k], gathered.y[k], gathered.z[k], gathered.w[k]);
        const unsigned band = __ballot_sync(kAllLanes, bits <= search.bounds.bandTop);
        if (!band) continue;
        unsigned long long at = 0;
        if (lane() == 0) {
            at = atomicAdd(reinterpret_cast<unsigned long long*>(&search.head->undecided),
                           static_cast<unsigned long long>(__popc(band)));
        }
        at = fromLane(at, 0) + static_cast<unsigned long long>(__popc(band & lanesBelow()));
        if (!(band >> lane() & 1) || at >= most) continue;
        const std::uint32_t candidate = begin + static_cast<std::uint32_t>(k) * kWarpSize + lane();
        const std::uint32_t slot = candidate + table.offset[runOf(table, candidates.runs, candidate)];
        list[at] = {queryNumber, search.image.block.number[slot], rowBit + candidate};
    }
}

// Neighbors of this lane's query, and where its row goes on.
struct OwnQuery {
    std::uint32_t count = 0;
    std::uint64_t next = 0;
};

// The queries [begin, end) of a cell against its candidates. `first`: slot of the first query of the group. `firstWord`: where
// the rows of these queries begin, in words, for masks.
template <Pass kPass>
__device__ void searchCell(const GroupSearch& search, const RunTable& table, const Candidates& candidates,
                           const QueryTerms& ownTerms, std::uint32_t first, std::uint32_t begin,
                           std::uint32_t end, float centerX, float centerY, float centerZ,
                           std::uint64_t firstWord, bool hasRoom, OwnQuery& own)
{
    constexpr std::uint32_t kChunk = kWords * kWarpSize;
    constexpr bool kNumbers = kPass == Pass::kNumbers, kMasks = kPass == Pass::kMasks;
    constexpr bool kListsUndecided = kPass != Pass::kCountRows;
    const std::uint32_t rowWords = (candidates.count + 31) / 32;
    for (std::uint32_t chunk = 0; chunk < candidates.count; chunk += kChunk) {
        Gathered gathered;
        gather<kNumbers>(search.image.block, table, candidates, chunk, centerX, centerY, centerZ, gathered);
        const std::uint32_t left = candidates.count - chunk;
        const int words = static_cast<int>(left < kChunk ? (left + 31) / 32 : kWords);
        for (std::uint32_t slot = begin; slot < end; ++slot) {
            const unsigned owner = slot - first;
            const QueryTerms query{fromLane(ownTerms.ax, owner), fromLane(ownTerms.ay, owner),
                                   fromLane(ownTerms.az, owner), fromLane(ownTerms.k, owner)};
            const std::uint32_t self =
                slot - candidates.ownOffset - chunk; // huge where it is of another chunk
            std::int32_t least = INT_MAX;
            std::uint32_t word = 0; // of lane k: word k
            std::uint64_t next = kNumbers ? fromLane(own.next, owner) : 0;
#pragma unroll
            for (int k = 0; k < kWords; ++k) {
                if (k >= words) break;
                const std::int32_t bits =
                    scoreBits(query, gathered.x[k], gathered.y[k], gathered.z[k], gathered.w[k]);
                if (kListsUndecided) least = bits < least ? bits : least;
                unsigned hits = __ballot_sync(kAllLanes, bits < 0);
                if (kNumbers) {
                    if (self / 32 == static_cast<std::uint32_t>(k)) hits &= ~(1u << self % 32);
                    if (hits >> lane() & 1) {
                        search.rows[next + static_cast<unsigned>(__popc(hits & lanesBelow()))] =
                            gathered.number[k];
                    }
                    next += static_cast<unsigned>(__popc(hits));
                } else if (lane() == static_cast<unsigned>(k)) {
                    word = hits;
                }
            }
            if (kNumbers) {
                if (lane() == owner) own.next = next;
            } else {
                if (lane() == self / 32) word &= ~(1u << self % 32);
                int count = __popc(word);
                for (int step = 1; step < kWords; step *= 2) {
                    count += __shfl_xor_sync(kAllLanes, count, step);
                }
                count = fromLane(count, 0);
                if (lane() == owner) own.count += static_cast<std::uint32_t>(count);
            }
            const std::uint64_t row = firstWord + std::uint64_t(slot - begin) * rowWords;
            if (kMasks && hasRoom && static_cast<int>(lane()) < words) {
                search.rows[row + chunk / 32 + lane()] = word;
            }
            if (kListsUndecided && __any_sync(kAllLanes, least <= search.bounds.bandTop)) {
                listUndecided(search, table, candidates, gathered, query, chunk,
                              slot - search.image.firstQuery, row * 32);
            }
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
                const float centerX = static_cast<float>(cursor.x) - 3.5f,
                            centerY = static_cast<float>(cursor.y()) - 3.5f,
                            centerZ = static_cast<float>(cursor.z()) - 3.5f;
                const QueryTerms terms = queryTerms(search.bounds, x - centerX, y - centerY, z - centerZ);
                searchCell<kPass>(search, table, candidates, terms, first, slot, stop, centerX, centerY,
                                  centerZ, entries, hasRoom, own);
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
__global__ void __launch_bounds__(kWarps* kWarpSize, kSearchBlocks)
    searchGroupsKernel(const GroupSearch search)
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

} // namespace

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
    VDB_NNS_CUDA_CHECK(cudaMemsetAsync(search.head, 0, sizeof(ResultHead), stream));
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
