// Tests of queries against all candidates of a frame, a vector at a time. Knows frames and the membership rule's two steps,
// the filter and the exact test; nothing of what becomes of the hits. Internal linkage; see simd.h.
//
// Each step hands over the numbers of a vector's candidates, the bits of their scores, and which of them are hits. The query
// itself never is one.
#pragma once

#include "cpu/membership_simd-inl.h"
#include "cpu/search_task.h"

namespace vdb_nns {
namespace {

constexpr std::size_t kVectorBytes = Simd::kLanes * sizeof(float);
constexpr std::int32_t kLargestBits = 0x7fffffff; // above the bits of every score

// `stride` is a copy of the frame's: hits may be written where the compiler must think that the original is.
template <typename Frame>
inline Simd::I numbersAt(const char* p, std::size_t stride)
{
    return Simd::load(integers(p + Frame::kNumber * stride));
}

// Tests a query and the next one, and hands each vector's hits to take(numbers, scores and hits of the first, those of the
// second). Two at a time read the candidates once for both. True when some are in the band: then both rows are to be made again, by
// testBand(). Always inlined: rows that `take` refers to are in registers only then.
template <typename Frame, typename Take>
__attribute__((always_inline)) inline bool testPair(const FilterBounds& bounds, const Frame& frame,
                                                    std::uint32_t self, Take&& take)
{
    const std::size_t stride = frame.stride;
    const char* p = frame.base;
    const char* const end = p + std::size_t(frame.count) * sizeof(float);
    const char* const own = p + std::size_t(self) * sizeof(float);
    const typename Frame::Query a(bounds, own, stride), b(bounds, own + sizeof(float), stride);
    Simd::I least = Simd::set(kLargestBits);
    const auto step = [&](Simd::Mask withoutA, Simd::Mask withoutB) {
        const typename Frame::Candidates candidates(p, stride);
        const Simd::F scoreA = a.score(candidates), scoreB = b.score(candidates);
        const Simd::I bitsA = Simd::bits(scoreA), bitsB = Simd::bits(scoreB);
        least = Simd::min(least, Simd::min(bitsA, bitsB));
        take(numbersAt<Frame>(p, stride), bitsA, Simd::movesign(scoreA) & ~withoutA, bitsB,
             Simd::movesign(scoreB) & ~withoutB);
        p += kVectorBytes;
    };
    const char* const selfVector = p + std::size_t(self / Simd::kLanes) * kVectorBytes;
    while (p < selfVector) step(0, 0);
    const Simd::Mask selfA = Simd::Mask(1) << self % Simd::kLanes, selfB = selfA << 1 & kAllLanes;
    if constexpr (Frame::kIsHalf) {
        step(kAllLanes & ~(selfA - 1), selfB ? kAllLanes & ~(selfB - 1) : 0);
    } else {
        step(selfA, selfB);
        if (!selfB) step(0, 1); // the second query begins the next vector
        while (p < end) step(0, 0);
    }
    return Simd::lessEqual(least, Simd::set(bounds.bandTop)) != 0;
}

// The same for one query: take(numbers, scores, hits).
template <typename Frame, typename Take>
__attribute__((always_inline)) inline bool testQuery(const FilterBounds& bounds, const Frame& frame,
                                                     std::uint32_t self, Take&& take)
{
    const std::size_t stride = frame.stride;
    const char* p = frame.base;
    const char* const selfVector = p + std::size_t(self / Simd::kLanes) * kVectorBytes;
    const char* const end = p + std::size_t(frame.count) * sizeof(float);
    const typename Frame::Query query(bounds, p + std::size_t(self) * sizeof(float), stride);
    Simd::I least = Simd::set(kLargestBits);
    const auto step = [&](Simd::Mask without) {
        const Simd::F score = query.score(typename Frame::Candidates(p, stride));
        const Simd::I bits = Simd::bits(score);
        least = Simd::min(least, bits);
        take(numbersAt<Frame>(p, stride), bits, Simd::movesign(score) & ~without);
        p += kVectorBytes;
    };
    while (p < selfVector) step(0);
    const Simd::Mask own = Simd::Mask(1) << self % Simd::kLanes;
    if constexpr (Frame::kIsHalf) {
        step(kAllLanes & ~(own - 1));
    } else {
        step(own);
        while (p < end) step(0);
    }
    return Simd::lessEqual(least, Simd::set(bounds.bandTop)) != 0;
}

// testQuery() for a query that has candidates in the band: the exact test decides those. Hits go to row.take(numbers, scores, hits);
// returns the row. Rare, and apart, so that it takes no registers from the others: the row comes and goes by value, for the
// same reason.
template <typename Frame, typename Row>
__attribute__((noinline)) Row testBand(const FilterBounds& bounds, Frame frame, std::uint32_t self,
                                       const ExactPredicate& exact, TaskStatistics& statistics, Row row)
{
    const char* const own = frame.base + std::size_t(self) * sizeof(float);
    const typename Frame::Query query(bounds, own, frame.stride);
    const std::uint32_t number = *integers(own + Frame::kNumber * frame.stride);
    const std::size_t end = Frame::kIsHalf ? self : frame.count;
    for (std::size_t j = 0; j < end; j += Simd::kLanes) {
        const char* const p = frame.base + j * sizeof(float);
        const Simd::F score = query.score(typename Frame::Candidates(p, frame.stride));
        Simd::Mask hits = Simd::movesign(score);
        if (j == self - self % Simd::kLanes) {
            const Simd::Mask itself = Simd::Mask(1) << self % Simd::kLanes;
            hits &= Frame::kIsHalf ? itself - 1 : ~itself;
        }
        Simd::Mask band = hits & Simd::lessEqual(Simd::bits(score), Simd::set(bounds.bandTop));
        for (; band; band &= band - 1) {
            const unsigned lane = static_cast<unsigned>(__builtin_ctz(band));
            ++statistics.bandPairs;
            if (!exact.isNeighbor(exact.state, number, integers(p + Frame::kNumber * frame.stride)[lane])) {
                hits &= ~(Simd::Mask(1) << lane);
            }
        }
        row.take(numbersAt<Frame>(p, frame.stride), Simd::bits(score), hits);
    }
    return row;
}

} // namespace
} // namespace vdb_nns
