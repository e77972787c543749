// The candidates of one cell's queries: those of the cells in reach that are near the ball of the queries, moved to its
// centre. Internal linkage; see simd.h.
#pragma once

#include "cpu/halo-inl.h"
#include "cpu/membership_simd-inl.h"

namespace vdb_nns {
namespace {

// One cell's queries and the candidates that they keep.
struct CellSearch {
    std::uint32_t firstQuery, queries; // in the halo arrays
    std::uint32_t candidates;          // of the cells in reach
    std::uint32_t kept;
    std::uint32_t self; // kept candidate that is the first query; the others follow
};

// Candidates of the cells in reach of the one whose lowest corner of reach, but for x and y, is `lowest`.
inline std::uint32_t candidatesOf(int reach, const std::uint32_t* lowest)
{
    const int side = 8 + 2 * reach;
    std::uint32_t candidates = 0;
    for (int dx = -reach; dx <= reach; ++dx) {
        for (int dy = -reach; dy <= reach; ++dy) {
            const std::uint32_t* const run = lowest + (dx * side + dy) * side;
            candidates += run[2 * reach + 1] - run[0];
        }
    }
    return candidates;
}

// `x`, `y`, `z`: of the queries, about the centre of their leaf. `reachable`: no neighbor of theirs is farther.
inline QueryBounds boundsOf(float reachable, const float* x, const float* y, const float* z,
                            std::uint32_t count)
{
    // Whole vectors, the last of them overlapping, or one vector filled up with the first query.
    const auto forEachVector = [count](const float* in, auto&& f) {
        if (count < NarrowSimd::kLanes)
            return f(firstLanesOr(NarrowSimd::load(in), count, NarrowSimd::set(*in)));
        for (std::uint32_t i = 0; i + NarrowSimd::kLanes < count; i += NarrowSimd::kLanes)
            f(NarrowSimd::load(in + i));
        f(NarrowSimd::load(in + count - NarrowSimd::kLanes));
    };
    NarrowSimd::F center[3], half[3];
    float middle[3];
    const float* const coordinates[3] = {x, y, z};
    for (int k = 0; k < 3; ++k) {
        NarrowSimd::F low = NarrowSimd::set(*coordinates[k]), high = low;
        forEachVector(coordinates[k], [&](NarrowSimd::F v) {
            low = NarrowSimd::min(low, v);
            high = NarrowSimd::max(high, v);
        });
        // The half size must cover each |fl(q - centre)|; rounding is monotonic, so the ends' own roundings do.
        const float l = minOfLanes(low), h = maxOfLanes(high), c = 0.5f * (l + h), a = h - c, b = c - l;
        middle[k] = c;
        center[k] = NarrowSimd::set(c);
        half[k] = NarrowSimd::set(a > b ? a : b);
    }
    NarrowSimd::F most = NarrowSimd::set(0.0f);
    for (std::uint32_t i = 0;; i += NarrowSimd::kLanes) {
        if (i + NarrowSimd::kLanes >= count) i = count > NarrowSimd::kLanes ? count - NarrowSimd::kLanes : 0;
        const NarrowSimd::F length = squaredLength(NarrowSimd::sub(NarrowSimd::load(x + i), center[0]),
                                                   NarrowSimd::sub(NarrowSimd::load(y + i), center[1]),
                                                   NarrowSimd::sub(NarrowSimd::load(z + i), center[2]));
        most = NarrowSimd::max(
            most, count < NarrowSimd::kLanes ? firstLanesOr(length, count, NarrowSimd::set(0.0f)) : length);
        if (i + NarrowSimd::kLanes >= count) break;
    }
    return {center[0],
            center[1],
            center[2],
            half[0],
            half[1],
            half[2],
            NarrowSimd::set(keepSquared(reachable, maxOfLanes(most))),
            NarrowSimd::set(keepSquared(reachable, 0)),
            {middle[0], middle[1], middle[2]}};
}

// Bits one after the other into 64-bit words. Fewer than 64 at a time.
struct BitWriter {
    std::uint64_t* out;
    std::uint64_t word = 0;
    unsigned filled = 0;

    void append(std::uint64_t bits, unsigned count)
    {
        word |= bits << filled;
        filled += count;
        if (filled >= 64) {
            *out++ = word;
            filled -= 64;
            word = filled ? bits >> (count - filled) : 0;
        }
    }

    void finish() { *out = word; }
};

constexpr NarrowSimd::Mask kAllNarrowLanes = (1u << NarrowSimd::kLanes) - 1;

// What is gathered besides the candidates near the ball.
template <bool kBitsOf, bool kFarOf>
struct Gathered {
    static constexpr bool kBits = kBitsOf; // a bit for each candidate of the cells in reach: kept or not
    static constexpr bool kFar = kFarOf;   // radii of candidates
};

// One vector of candidates at `p`, of which `valid` count: keeps those near the ball, behind `kept`.
template <typename What, bool kBox>
inline char* gatherVector(const QueryBounds& where, const char* p, std::size_t stride, NarrowSimd::Mask valid,
                          unsigned count, char* kept, BitWriter& bits)
{
    const NarrowSimd::F px = NarrowSimd::sub(NarrowSimd::load(floats(p)), where.centerX);
    const NarrowSimd::F py = NarrowSimd::sub(NarrowSimd::load(floats(p + stride)), where.centerY);
    const NarrowSimd::F pz = NarrowSimd::sub(NarrowSimd::load(floats(p + 2 * stride)), where.centerZ);
    const NarrowSimd::F length = squaredLength(px, py, pz);
    const NarrowSimd::Mask mask = where.near<kBox>(px, py, pz, length) & valid;
    if constexpr (What::kBits) bits.append(mask, count);
    const NarrowSimd::Order order = NarrowSimd::order(mask);
    NarrowSimd::store(floats(kept), NarrowSimd::compress(px, order));
    NarrowSimd::store(floats(kept + stride), NarrowSimd::compress(py, order));
    NarrowSimd::store(floats(kept + 2 * stride), NarrowSimd::compress(pz, order));
    NarrowSimd::store(floats(kept + 4 * stride), NarrowSimd::compress(length, order));
    NarrowSimd::store(integers(kept + 8 * stride),
                      NarrowSimd::compress(NarrowSimd::load(integers(p + 4 * stride)), order));
    if constexpr (What::kFar) {
        NarrowSimd::store(floats(kept + 12 * stride),
                          NarrowSimd::compress(NarrowSimd::load(floats(p + 8 * stride)), order));
    }
    return kept + static_cast<std::size_t>(__builtin_popcount(mask)) * sizeof(float);
}

// The candidates of one run of cells. Returns where the next kept one goes.
template <typename What, bool kBox>
inline char* gatherRun(const QueryBounds& where, const char* halo, std::size_t stride, std::uint32_t begin,
                       std::uint32_t end, char* kept, BitWriter& bits)
{
    const char* p = halo + std::size_t(begin) * sizeof(float);
    std::uint32_t left = end - begin;
    for (; left >= NarrowSimd::kLanes; left -= NarrowSimd::kLanes, p += NarrowSimd::kLanes * sizeof(float)) {
        kept = gatherVector<What, kBox>(where, p, stride, kAllNarrowLanes, NarrowSimd::kLanes, kept, bits);
    }
    if (left > 0) kept = gatherVector<What, kBox>(where, p, stride, (1u << left) - 1, left, kept, bits);
    return kept;
}

// Whether runs may be so long that gathering asks whether to go on: a cost that only crowds are worth.
inline bool mayBeLong(int reach, const std::uint32_t* lowest)
{
    const int side = 8 + 2 * reach, most = (reach * side + reach) * side;
    return lowest[most + 2 * reach + 1] - lowest[-most] > HaloScratch::kBetweenAsks;
}

// kSelf: the queries are candidates of the halo, and cell.self is wanted. kAsks: for long runs.
template <typename What, bool kBox, bool kSelf, bool kAsks>
void gatherRuns(const QueryBounds& where, HaloScratch& scratch, int reach, const std::uint32_t* lowest,
                CellSearch& cell)
{
    const int side = 8 + 2 * reach;
    const char* const halo = scratch.halo();
    const std::size_t stride = scratch.stride;
    char* kept = scratch.kept();
    BitWriter bits{scratch.keepBits()};
    const auto keepPart = [&](std::uint32_t begin, std::uint32_t end) {
        kept = gatherRun<What, kBox>(where, halo, stride, begin, end, kept, bits);
    };
    const auto keep = [&](std::uint32_t begin, std::uint32_t end) {
        if constexpr (kAsks) {
            inParts(scratch, begin, end, keepPart);
        } else {
            keepPart(begin, end);
        }
    };
    std::uint32_t candidates = 0;
    for (int dx = -reach; dx <= reach; ++dx) {
        for (int dy = -reach; dy <= reach; ++dy) {
            const std::uint32_t* const run = lowest + (dx * side + dy) * side;
            std::uint32_t begin = run[0];
            const std::uint32_t end = run[2 * reach + 1];
            candidates += end - begin;
            if (kSelf && dx == 0 && dy == 0) {
                // In two parts, to learn where the first query stands among the kept.
                keep(begin, cell.firstQuery);
                cell.self = static_cast<std::uint32_t>((kept - scratch.kept()) / sizeof(float));
                begin = cell.firstQuery;
            }
            keep(begin, end);
        }
    }
    if constexpr (What::kBits) bits.finish();
    Simd::store(floats(kept + 4 * stride), Simd::set(kFarAway)); // tests read whole vectors of these
    if constexpr (What::kFar) Simd::store(floats(kept + 12 * stride), Simd::set(0.0f));
    cell.candidates = candidates;
    cell.kept = static_cast<std::uint32_t>((kept - scratch.kept()) / sizeof(float));
}

// From this many queries on, the box pays: it costs once a cell and saves tests of every query.
constexpr std::uint32_t kBoxQueries = 14;

// `lowest` indexes the halo's cube at the lowest z of the cell's reach.
template <typename What, bool kSelf>
void gatherNear(const QueryBounds& where, HaloScratch& scratch, int reach, const std::uint32_t* lowest,
                CellSearch& cell)
{
    const bool asks = mayBeLong(reach, lowest);
    if (cell.queries >= kBoxQueries) {
        const auto gatherRunsInBox =
            asks ? gatherRuns<What, true, kSelf, true> : gatherRuns<What, true, kSelf, false>;
        gatherRunsInBox(where, scratch, reach, lowest, cell);
    } else {
        const auto gatherRunsInBall =
            asks ? gatherRuns<What, false, kSelf, true> : gatherRuns<What, false, kSelf, false>;
        gatherRunsInBall(where, scratch, reach, lowest, cell);
    }
}

// Of the cells of the leaf itself only those before the queries', which come last: each pair of the leaf is found once.
template <bool kBox>
void gatherHalf(const QueryBounds& where, HaloScratch& scratch, int reach, const std::uint32_t* lowest,
                CellSearch& cell)
{
    using What = Gathered<false, false>;
    const int side = 8 + 2 * reach, at = static_cast<int>(lowest - scratch.start);
    const int x = at / (side * side) - reach, y = at / side % side - reach, z = at % side;
    const int firstInside = z < reach ? reach - z : 0, // of the cells of a run
        endInside = z + reach >= 8 ? 8 + reach - z : 2 * reach + 1;
    const char* const halo = scratch.halo();
    const std::size_t stride = scratch.stride;
    char* kept = scratch.kept();
    BitWriter bits{nullptr};
    const auto keep = [&](std::uint32_t begin, std::uint32_t end) {
        if (begin < end) kept = gatherRun<What, kBox>(where, halo, stride, begin, end, kept, bits);
    };
    for (int dx = -reach; dx <= reach; ++dx) {
        for (int dy = -reach; dy <= reach; ++dy) {
            const std::uint32_t* const run = lowest + (dx * side + dy) * side;
            const std::uint32_t end = run[2 * reach + 1];
            const bool isInside = ((x + dx) | (y + dy)) >> 3 == 0;
            if (!isInside || dx < 0 || (dx == 0 && dy < 0)) {
                keep(run[0], end);
                continue;
            }
            keep(run[0], dx == 0 && dy == 0 ? cell.firstQuery : run[firstInside]);
            keep(run[endInside], end);
        }
    }
    cell.self = static_cast<std::uint32_t>((kept - scratch.kept()) / sizeof(float));
    keep(cell.firstQuery, cell.firstQuery + cell.queries);
    Simd::store(floats(kept + 4 * stride), Simd::set(kFarAway));
    cell.kept = static_cast<std::uint32_t>((kept - scratch.kept()) / sizeof(float));
    cell.candidates = candidatesOf(reach, lowest);
}

// For queries that are candidates of the halo. kHalf: by gatherHalf(), of all queries of the cell.
template <bool kBits, bool kHalf>
void gather(const SearchContext& context, HaloScratch& scratch, const std::uint32_t* lowest, CellSearch& cell)
{
    const float* const x = floats(scratch.halo()) + cell.firstQuery;
    const std::size_t floatsOfStride = scratch.stride / sizeof(float);
    const int reach = context.block.reach;
    const QueryBounds where =
        boundsOf(context.bounds.reachable, x, x + floatsOfStride, x + 2 * floatsOfStride, cell.queries);
    if constexpr (!kHalf) {
        gatherNear<Gathered<kBits, false>, true>(where, scratch, reach, lowest, cell);
    } else if (cell.queries >= kBoxQueries) {
        gatherHalf<true>(where, scratch, reach, lowest, cell);
    } else {
        gatherHalf<false>(where, scratch, reach, lowest, cell);
    }
}

} // namespace
} // namespace vdb_nns
