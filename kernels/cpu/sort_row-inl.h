// Sorts a row of numbers ascending: bitonic networks (Batcher 1968) in registers, and merges of what they sorted for rows that
// registers do not hold, which are mostly a few ascending runs already. No branch depends on the numbers but one for each vector
// that is merged. Internal linkage; see simd.h.
//
// Their steps are always inlined: a call would store the vectors. Networks compare ascending throughout: a
// merge of two runs first compares the one with the other reversed (lane i with i ^ x, all bits of x set),
// then halves with halves. Rows are filled up with 2^32-1, which no particle has for its number.
#pragma once

#include "cpu/kernels.h"
#include "cpu/simd.h"

namespace vdb_nns {
namespace {

constexpr std::ptrdiff_t kSortLanes = Simd::kLanes;
constexpr int kSortRegisters = 8;
constexpr std::ptrdiff_t kSortBlock = kSortRegisters * kSortLanes;
static_assert(kSortBlock <= static_cast<std::ptrdiff_t>(kLargestSortBlock),
              "scratch has room for what is filled up");

constexpr int highestBit(int x)
{
    int bit = 1;
    while (2 * bit <= x) bit *= 2;
    return bit;
}

// Lanes i and i ^ x in order.
template <int kX>
__attribute__((always_inline)) inline Simd::I orderLanes(Simd::I v)
{
    const Simd::I other = Simd::swapLanes<kX>(v);
    return Simd::lanesOf<highestBit(kX)>(Simd::minUnsigned(v, other), Simd::maxUnsigned(v, other));
}

// The halves of each run of 2 kBit lanes, which are bitonic together; then those of its halves.
template <int kBit>
__attribute__((always_inline)) inline Simd::I mergeLanes(Simd::I v)
{
    if constexpr (kBit == 0) {
        return v;
    } else {
        return mergeLanes<kBit / 2>(orderLanes<kBit>(v));
    }
}

// Sorts each run of kRun lanes.
template <int kRun>
__attribute__((always_inline)) inline Simd::I sortLanes(Simd::I v)
{
    if constexpr (kRun == 1) {
        return v;
    } else {
        return mergeLanes<kRun / 4>(orderLanes<kRun - 1>(sortLanes<kRun / 2>(v)));
    }
}

inline void orderVectors(Simd::I& a, Simd::I& b)
{
    const Simd::I low = Simd::minUnsigned(a, b);
    b = Simd::maxUnsigned(a, b);
    a = low;
}

// Sorts what is bitonic.
template <int kCount>
__attribute__((always_inline)) inline void mergeVectors(Simd::I* v)
{
    if constexpr (kCount == 1) {
        v[0] = mergeLanes<kSortLanes / 2>(v[0]);
    } else {
        for (int i = 0; i < kCount / 2; ++i) orderVectors(v[i], v[i + kCount / 2]);
        mergeVectors<kCount / 2>(v);
        mergeVectors<kCount / 2>(v + kCount / 2);
    }
}

// Merges two runs of kCount / 2 vectors.
template <int kCount>
__attribute__((always_inline)) inline void mergeHalves(Simd::I* v)
{
    Simd::I high[kCount / 2];
    for (int i = 0; i < kCount / 2; ++i) {
        const Simd::I other = Simd::swapLanes<kSortLanes - 1>(v[kCount - 1 - i]);
        high[i] = Simd::maxUnsigned(v[i], other);
        v[i] = Simd::minUnsigned(v[i], other);
    }
    for (int i = 0; i < kCount / 2; ++i) v[kCount / 2 + i] = high[i];
    mergeVectors<kCount / 2>(v);
    mergeVectors<kCount / 2>(v + kCount / 2);
}

template <int kCount>
__attribute__((always_inline)) inline void sortVectors(Simd::I* v)
{
    if constexpr (kCount == 1) {
        v[0] = sortLanes<kSortLanes>(v[0]);
    } else if constexpr (kCount == 3) { // as four, without what would be done to a last one that is filled up
        sortVectors<2>(v);
        sortVectors<1>(v + 2);
        const Simd::I other = Simd::swapLanes<kSortLanes - 1>(v[2]);
        v[2] = mergeLanes<kSortLanes / 2>(Simd::maxUnsigned(v[1], other));
        v[1] = Simd::minUnsigned(v[1], other);
        mergeVectors<2>(v);
    } else {
        sortVectors<kCount / 2>(v);
        sortVectors<kCount / 2>(v + kCount / 2);
        mergeHalves<kCount>(v);
    }
}

inline Simd::I loadUpTo(const std::uint32_t* row, std::ptrdiff_t count)
{
    if (count >= kSortLanes) return Simd::load(row);
    return Simd::loadFirst(row, count > 0 ? count : 0);
}

// Rows that kCount vectors hold.
template <int kCount>
inline void sortInRegisters(const std::uint32_t* row, std::ptrdiff_t count, std::uint32_t* out)
{
    Simd::I v[kCount];
    for (int i = 0; i < kCount; ++i) v[i] = loadUpTo(row + i * kSortLanes, count - i * kSortLanes);
    sortVectors<kCount>(v);
    for (int i = 0; i < kCount; ++i) {
        if (i * kSortLanes < count) Simd::store(out + i * kSortLanes, v[i]);
    }
}

inline void copyValues(const std::uint32_t* from, std::ptrdiff_t count, std::uint32_t* to)
{
    __builtin_memcpy(to, from, static_cast<std::size_t>(count) * sizeof(std::uint32_t));
}

// A run that is taken by vectors.
struct SortedRun {
    const std::uint32_t* next;
    std::ptrdiff_t left;

    Simd::I take()
    {
        const Simd::I v = loadUpTo(next, left);
        next += kSortLanes;
        left -= kSortLanes;
        return v;
    }
};

// Two ascending runs into one; none is empty. Up to kSortOverrun entries are written behind it.
inline void mergeRuns(SortedRun a, SortedRun b, std::uint32_t* out)
{
    const std::uint32_t* const end = out + a.left + b.left;
    Simd::I v[2] = {a.take(), b.take()};
    for (;;) {
        mergeHalves<2>(v);
        Simd::store(out, v[0]);
        out += kSortLanes;
        if (a.left <= 0 && b.left <= 0) break;
        // The next vector comes from the run that goes on lower; what is left of the last two is no larger than the other's.
        const bool takesA = b.left <= 0 || (a.left > 0 && *a.next <= *b.next);
        v[0] = (takesA ? a : b).take();
    }
    if (out < end) Simd::store(out, v[1]); // else it only fills up
}

// Ends of the runs of a row.
struct RunEnds {
    static constexpr int kMost = 8;

    std::ptrdiff_t end[kMost];
    int count = 0;

    bool add(std::ptrdiff_t at)
    {
        if (count == kMost) return false;
        end[count++] = at;
        return true;
    }
};

// The ascending runs of a row, which follow from the order of cells: a few, if they are long. False for more than are merged.
inline bool findRuns(const std::uint32_t* row, std::ptrdiff_t count, RunEnds& runs)
{
    std::ptrdiff_t i = 1;
    for (; i + kSortLanes <= count; i += kSortLanes) {
        const Simd::I before = Simd::load(row + i - 1), low = Simd::minUnsigned(before, Simd::load(row + i));
        const auto ascends = static_cast<std::uint32_t>(Simd::lessEqual(before, low)) &
                             static_cast<std::uint32_t>(Simd::lessEqual(low, before));
        for (std::uint32_t descends = ~ascends & static_cast<std::uint32_t>(kAllLanes); descends != 0;
             descends &= descends - 1) {
            if (!runs.add(i + __builtin_ctz(descends))) return false;
        }
    }
    for (; i < count; ++i) {
        if (row[i - 1] > row[i] && !runs.add(i)) return false;
    }
    return runs.add(count);
}

// Merges the runs of a row, two by two.
inline bool sortByRuns(const std::uint32_t* row, std::ptrdiff_t count, std::uint32_t* out,
                       std::uint32_t* scratch)
{
    RunEnds runs;
    if (!findRuns(row, count, runs)) return false;
    const std::uint32_t* from = row;
    std::uint32_t* to = scratch;
    while (runs.count > 1) {
        if (runs.count == 2) to = out;
        std::ptrdiff_t begin = 0;
        int merged = 0;
        for (int r = 0; r < runs.count; r += 2) {
            const std::ptrdiff_t middle = runs.end[r];
            if (r + 1 == runs.count) {
                copyValues(from + begin, middle - begin, to + begin);
                runs.end[merged++] = middle;
                break;
            }
            const std::ptrdiff_t end = runs.end[r + 1];
            mergeRuns({from + begin, middle - begin}, {from + middle, end - middle}, to + begin);
            runs.end[merged++] = begin = end;
        }
        runs.count = merged;
        from = to;
        to = to == scratch ? scratch + count + kSortBlock : scratch;
    }
    if (from == row) copyValues(row, count, out);
    return true;
}

inline void sortLong(const std::uint32_t* row, std::ptrdiff_t count, std::uint32_t* out,
                     std::uint32_t* scratch)
{
    const std::ptrdiff_t filled = (count + kSortBlock - 1) / kSortBlock * kSortBlock;
    std::uint32_t* from = scratch;
    std::uint32_t* to = scratch + filled;
    for (std::ptrdiff_t begin = 0; begin < filled; begin += kSortBlock) {
        Simd::I v[kSortRegisters];
        for (int i = 0; i < kSortRegisters; ++i) {
            const std::ptrdiff_t at = begin + i * kSortLanes;
            v[i] = loadUpTo(row + at, count - at);
        }
        sortVectors<kSortRegisters>(v);
        for (int i = 0; i < kSortRegisters; ++i) Simd::store(from + begin + i * kSortLanes, v[i]);
    }
    for (std::ptrdiff_t run = kSortBlock; run < filled; run *= 2) {
        for (std::ptrdiff_t begin = 0; begin < filled; begin += 2 * run) {
            const std::ptrdiff_t middle = begin + run < filled ? begin + run : filled;
            const std::ptrdiff_t end = middle + run < filled ? middle + run : filled;
            if (middle < end) {
                mergeRuns({from + begin, middle - begin}, {from + middle, end - middle}, to + begin);
            } else {
                copyValues(from + begin, end - begin, to + begin);
            }
        }
        std::uint32_t* const sorted = to;
        to = from;
        from = sorted;
    }
    copyValues(from, count, out);
}

void sortRow(const std::uint32_t* row, std::size_t size, std::uint32_t* out, std::uint32_t* scratch)
{
    const auto count = static_cast<std::ptrdiff_t>(size);
    if (count <= kSortLanes) return sortInRegisters<1>(row, count, out);
    if (count <= 2 * kSortLanes) return sortInRegisters<2>(row, count, out);
    if (count <= 3 * kSortLanes) return sortInRegisters<3>(row, count, out);
    if (count <= 4 * kSortLanes) return sortInRegisters<4>(row, count, out);
    if (count <= kSortBlock) return sortInRegisters<kSortRegisters>(row, count, out);
    if (!sortByRuns(row, count, out, scratch)) sortLong(row, count, out, scratch);
}

} // namespace
} // namespace vdb_nns
