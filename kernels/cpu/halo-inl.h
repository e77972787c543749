// The particles around a leaf, gathered into the thread's scratch memory. Three ways:
//   fillHalo()  with the start of every cell of the cube of leaf and halo, so that the cells of a column stand together;
//               fillHaloBox() of a part of the cube
//   copyReach() around one cell of it
//   listRuns()  and copyRuns(), without: for leaves so sparse that a table of cells costs more than testing everything
// Internal linkage; see simd.h.
#pragma once

#include "cpu/search_task.h"
#include "cpu/simd.h"

namespace vdb_nns {
namespace {

// Pads candidates to a whole vector: far from everything.
constexpr float kFarAway = 1e30f;

// What the taker of rows reads of candidates is fetched into the second-level cache.
inline void fetchAhead(const HaloScratch& scratch, const std::uint32_t* numbers, std::size_t count)
{
    for (std::size_t i = 0; i < count; ++i)
        __builtin_prefetch(scratch.records + scratch.recordBytes * numbers[i], 0, 2);
}

// Calls f(begin, end) for parts of a run, and asks whether to go on between them.
template <typename F>
__attribute__((always_inline)) inline void inParts(const HaloScratch& scratch, std::uint32_t begin,
                                                   std::uint32_t end, F&& f)
{
    for (;;) { // one call, which is inlined once
        const bool isLast = end - begin <= HaloScratch::kBetweenAsks;
        const std::uint32_t to = isLast ? end : begin + HaloScratch::kBetweenAsks;
        f(begin, to);
        if (isLast) return;
        scratch.ask(scratch);
        begin = to;
    }
}

// To the halo from `at` on. kFar: the candidates have radii; `far` by slot, as SetContext::candidateFar.
template <bool kFar>
inline void copyPart(const BlockView& block, const float* far, HaloScratch& scratch, std::uint32_t at,
                     std::uint32_t begin, std::uint32_t end, const float shift[3])
{
    char* to = scratch.halo() + std::size_t(at) * sizeof(float);
    const std::size_t stride = scratch.stride;
    if (scratch.records) fetchAhead(scratch, block.number + begin, end - begin);
    const Simd::F sx = Simd::set(shift[0]), sy = Simd::set(shift[1]), sz = Simd::set(shift[2]);
    // 64 bits: the last slots are so near 2^32 that a vector's step would wrap.
    for (std::size_t i = begin; i < end; i += Simd::kLanes, to += Simd::kLanes * sizeof(float)) {
        Simd::store(floats(to), Simd::add(Simd::load(block.x + i), sx));
        Simd::store(floats(to + stride), Simd::add(Simd::load(block.y + i), sy));
        Simd::store(floats(to + 2 * stride), Simd::add(Simd::load(block.z + i), sz));
        Simd::store(integers(to + 4 * stride), Simd::load(block.number + i));
        if constexpr (kFar) Simd::store(floats(to + 8 * stride), Simd::load(far + i));
    }
}

template <bool kFar>
inline void copyRun(const BlockView& block, const float* far, HaloScratch& scratch, std::uint32_t at,
                    std::uint32_t begin, std::uint32_t end, const float shift[3])
{
    inParts(scratch, begin, end, [&](std::uint32_t from, std::uint32_t to) {
        copyPart<kFar>(block, far, scratch, at + (from - begin), from, to, shift);
    });
}

// A vector of no candidates at `to`, which is in a halo.
template <bool kFar>
inline void endCandidates(char* to, std::size_t stride)
{
    Simd::store(floats(to), Simd::set(kFarAway));
    if constexpr (kFar) Simd::store(floats(to + 8 * stride), Simd::set(0.0f));
}

// What filling the halo needs to know of one of the 27 leaves.
struct LeafCells {
    std::uint64_t word[8];
    std::uint32_t firstCell[8]; // number of the first occupied cell of each word
};

inline std::size_t readLeaves(const BlockView& block, const std::uint32_t* neighborhood, LeafCells* leaves)
{
    std::size_t particles = 0;
    for (int n = 0; n < kLeavesAround; ++n) {
        LeafCells& leaf = leaves[n];
        if (neighborhood[n] == kNoLeaf) {
            for (int w = 0; w < 8; ++w) leaf.word[w] = 0;
            continue;
        }
        const LeafRecord& record = block.leaves[neighborhood[n]];
        particles += block.leaves[neighborhood[n] + 1].firstSlot - record.firstSlot;
        std::uint32_t cell = record.firstCell;
        for (int w = 0; w < 8; ++w) {
            leaf.word[w] = record.occupancy[w];
            leaf.firstCell[w] = cell;
            cell += static_cast<std::uint32_t>(__builtin_popcountll(leaf.word[w]));
        }
    }
    return particles;
}

template <bool kFar = false>
inline void fillHalo(const BlockView& block, const LeafCells* leaves, HaloScratch& halo,
                     const float* far = nullptr)
{
    const int reach = block.reach, side = 8 + 2 * reach;
    std::uint32_t at = 0, *start = halo.start;
    for (int x = -reach; x < 8 + reach; ++x) {
        const int nx = x < 0 ? 0 : x > 7 ? 2 : 1, w = x & 7;
        for (int ny = 0; ny < 3; ++ny) {
            const int y0 = ny == 0 ? 8 - reach : 0, y1 = ny == 2 ? reach : 8;
            const LeafCells* const column = leaves + nx * 9 + ny * 3;
            if (!(column[0].word[w] | column[1].word[w] | column[2].word[w])) {
                for (int i = (y1 - y0) * side; i > 0; --i) *start++ = at;
                continue;
            }
            for (int y = y0; y < y1; ++y) {
                for (int nz = 0; nz < 3; ++nz) {
                    const int z0 = nz == 0 ? 8 - reach : 0, z1 = nz == 2 ? reach : 8;
                    const std::uint64_t word = column[nz].word[w];
                    const int low = 8 * y + z0;
                    std::uint32_t bits = static_cast<std::uint32_t>(word >> low) & ((1u << (z1 - z0)) - 1);
                    if (!bits) {
                        for (int z = z0; z < z1; ++z) *start++ = at;
                        continue;
                    }
                    const std::uint64_t below = word & ((std::uint64_t(1) << low) - 1);
                    const std::uint32_t* cell =
                        block.cellStart + column[nz].firstCell[w] + __builtin_popcountll(below);
                    const std::uint32_t begin = *cell, offset = at - begin;
                    for (int z = z0; z < z1; ++z, bits >>= 1) {
                        *start++ = *cell + offset; // of the next occupied cell where this one is empty
                        cell += bits & 1;
                    }
                    const float shift[3] = {8.0f * (nx - 1), 8.0f * (ny - 1), 8.0f * (nz - 1)};
                    copyRun<kFar>(block, far, halo, at, begin, *cell, shift);
                    at += *cell - begin;
                }
            }
        }
    }
    *start = at;
}

// A box of cells about a leaf: from `low` to `high` on each axis, -reach to 7 + reach.
struct CellBox {
    int low[3], high[3];
};

// fillHalo() for the cells of a box; of the starts those of its cells and the end of each of its columns. Returns how many
// particles there are.
template <bool kFar>
inline std::uint32_t fillHaloBox(const BlockView& block, const LeafCells* leaves, const CellBox& box,
                                 HaloScratch& halo, const float* far)
{
    const int reach = block.reach, side = 8 + 2 * reach;
    std::uint32_t at = 0;
    for (int x = box.low[0]; x <= box.high[0]; ++x) {
        const int nx = (x + 8) >> 3;
        for (int y = box.low[1]; y <= box.high[1]; ++y) {
            const int ny = (y + 8) >> 3;
            std::uint32_t* start = halo.start + ((x + reach) * side + y + reach) * side + box.low[2] + reach;
            for (int nz = (box.low[2] + 8) >> 3; nz <= (box.high[2] + 8) >> 3; ++nz) {
                const int low = box.low[2] - 8 * (nz - 1), high = box.high[2] - 8 * (nz - 1);
                const int z0 = low > 0 ? low : 0, z1 = high < 7 ? high : 7;
                const LeafCells& leaf = leaves[nx * 9 + ny * 3 + nz];
                const std::uint64_t word = leaf.word[x & 7];
                const int lowest = 8 * (y & 7) + z0;
                std::uint64_t bits = word >> lowest & ((std::uint64_t(2) << (z1 - z0)) - 1);
                if (!bits) {
                    for (int z = z0; z <= z1; ++z) *start++ = at;
                    continue;
                }
                const std::uint64_t below = word & ((std::uint64_t(1) << lowest) - 1);
                const std::uint32_t* cell =
                    block.cellStart + leaf.firstCell[x & 7] + __builtin_popcountll(below);
                const std::uint32_t begin = *cell, offset = at - begin;
                for (int z = z0; z <= z1; ++z, bits >>= 1) {
                    *start++ = *cell + offset;
                    cell += bits & 1;
                }
                const float shift[3] = {8.0f * (nx - 1), 8.0f * (ny - 1), 8.0f * (nz - 1)};
                copyRun<kFar>(block, far, halo, at, begin, *cell, shift);
                at += *cell - begin;
            }
            *start = at;
        }
    }
    return at;
}

// Particles of consecutive cells of one column in one of the 27 leaves.
struct HaloRun {
    std::uint32_t begin, end; // slots
    std::uint16_t leaf;       // of the neighborhood: kOwnLeaf is the task's own
    std::uint16_t slab;       // x + reach: 0 is the lowest slab of the halo
};

// Lists the runs of the leaf and its halo in the order of fillHalo(), and the first particle of each slab of cells of
// one x. Returns their particles, or something larger than `most` as soon as there are more.
inline std::uint32_t listRuns(const BlockView& block, const LeafCells* leaves, std::uint32_t most,
                              HaloRun* runs, std::uint32_t& runCount, std::uint32_t* slabStart)
{
    constexpr std::uint64_t kEachByte = 0x0101010101010101u;
    const int reach = block.reach;
    const std::uint64_t low = kEachByte * ((1u << reach) - 1); // z or y below reach, in each byte
    const std::uint64_t zMask[3] = {low << (8 - reach), ~std::uint64_t(0), low};
    const std::uint64_t yMask[3] = {~std::uint64_t(0) << 8 * (8 - reach), ~std::uint64_t(0),
                                    ~std::uint64_t(0) >> 8 * (8 - reach)};
    std::uint32_t particles = 0;
    runCount = 0;
    for (int x = -reach; x < 8 + reach; ++x) {
        const int nx = x < 0 ? 0 : x > 7 ? 2 : 1, w = x & 7;
        *slabStart++ = particles;
        for (int ny = 0; ny < 3; ++ny) {
            const int column = nx * 9 + ny * 3;
            std::uint64_t words[3], any = 0;
            for (int nz = 0; nz < 3; ++nz)
                any |= words[nz] = leaves[column + nz].word[w] & zMask[nz] & yMask[ny];
            while (any) {
                const int y = __builtin_ctzll(any) & 56; // the first bit of its byte
                const std::uint64_t row = std::uint64_t(255) << y;
                any &= ~row;
                for (int nz = 0; nz < 3; ++nz) {
                    const std::uint64_t bits = words[nz] & row;
                    if (!bits) continue;
                    const LeafCells& leaf = leaves[column + nz];
                    const std::uint64_t below = leaf.word[w] & ((bits & -bits) - 1);
                    const std::uint32_t* const cell =
                        block.cellStart + leaf.firstCell[w] + __builtin_popcountll(below);
                    const std::uint32_t begin = cell[0], end = cell[__builtin_popcountll(bits)];
                    runs[runCount++] = {begin, end, static_cast<std::uint16_t>(column + nz),
                                        static_cast<std::uint16_t>(x + reach)};
                    particles += end - begin;
                    if (particles > most) return particles;
                }
            }
        }
    }
    *slabStart = particles;
    return particles;
}

template <bool kFar = false>
inline void copyRuns(const BlockView& block, const HaloRun* runs, std::uint32_t runCount,
                     HaloScratch& scratch, const float* far = nullptr)
{
    std::uint32_t at = 0;
    for (std::uint32_t r = 0; r < runCount; ++r) {
        const int n = runs[r].leaf;
        const float shift[3] = {8.0f * (n / 9 - 1), 8.0f * (n / 3 % 3 - 1), 8.0f * (n % 3 - 1)};
        copyRun<kFar>(block, far, scratch, at, runs[r].begin, runs[r].end, shift);
        at += runs[r].end - runs[r].begin;
    }
    endCandidates<kFar>(scratch.halo() + std::size_t(at) * sizeof(float), scratch.stride);
}

// Copies the particles of the cells in reach of cell (x, y, z) of the leaf, in visiting order. Returns how many there are;
// `self` is where the cell's own begin.
template <bool kFar = false>
inline std::uint32_t copyReach(const BlockView& block, const LeafCells* leaves, int x, int y, int z,
                               HaloScratch& scratch, std::uint32_t& self, const float* far = nullptr)
{
    const int reach = block.reach;
    char* to = scratch.halo();
    std::uint32_t copied = 0;
    for (int cx = x - reach; cx <= x + reach; ++cx) {
        const int nx = (cx + 8) >> 3;
        for (int cy = y - reach; cy <= y + reach; ++cy) {
            const int ny = (cy + 8) >> 3;
            for (int nz = (z - reach + 8) >> 3; nz <= (z + reach + 8) >> 3; ++nz) {
                const int low = z - reach - 8 * (nz - 1), high = z + reach - 8 * (nz - 1);
                const int z0 = low > 0 ? low : 0, z1 = high < 7 ? high : 7;
                const LeafCells& leaf = leaves[nx * 9 + ny * 3 + nz];
                const std::uint64_t word = leaf.word[cx & 7];
                const int lowest = 8 * (cy & 7) + z0;
                const std::uint64_t bits = word >> lowest & ((std::uint64_t(2) << (z1 - z0)) - 1);
                if (!bits) continue;
                const std::uint64_t below = word & ((std::uint64_t(1) << lowest) - 1);
                const std::uint32_t* const cell =
                    block.cellStart + leaf.firstCell[cx & 7] + __builtin_popcountll(below);
                const std::uint32_t begin = cell[0], end = cell[__builtin_popcountll(bits)];
                if (cx == x && cy == y && nz == 1) {
                    const std::uint64_t under = bits & ((std::uint64_t(1) << (z - z0)) - 1);
                    self = copied + (cell[__builtin_popcountll(under)] - begin);
                }
                const float shift[3] = {8.0f * (nx - 1), 8.0f * (ny - 1), 8.0f * (nz - 1)};
                copyRun<kFar>(block, far, scratch, copied, begin, end, shift);
                copied += end - begin;
            }
        }
    }
    endCandidates<kFar>(to + std::size_t(copied) * sizeof(float), scratch.stride);
    return copied;
}

} // namespace
} // namespace vdb_nns
