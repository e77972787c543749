// Tests of queries that need not be candidates: frames whose queries are read from their own block, the radius that decides
// a pair, and the steps of test_pairs-inl.h for them. A query is told by its place among those of a cell, and knows itself by its
// number. Internal linkage; see simd.h.
#pragma once

#include "cpu/membership_simd-inl.h"
#include "cpu/search_task.h"
#include "cpu/test_pairs-inl.h"

namespace vdb_nns {
namespace {

// No particle has it.
constexpr std::uint32_t kNobodysNumber = 0xffffffffu;

// The radius of the query decides.
struct QueryRadius {
    static constexpr bool kOfCandidates = false;
};

// The larger radius of the two decides.
struct LargerRadius {
    static constexpr bool kOfCandidates = true;
};

// Coordinates of a run of queries.
struct QueryPositions {
    const float *x, *y, *z;
};

// The queries of a run of slots, about the centre `center` in the frame of their leaf.
struct SetQueries {
    const float *x, *y, *z, *far; // far: null if all have that of the context
    float farOfAll;
    const std::uint32_t* number;
    float center[3];
    bool excludesSelf;

    SetQueries(const SetContext& sets, std::uint32_t slot, const QueryPositions& positions,
               const float (&theirCenter)[3])
        : x(positions.x),
          y(positions.y),
          z(positions.z),
          far(sets.queryFar ? sets.queryFar + slot : nullptr),
          farOfAll(sets.farOfQueries),
          number(sets.queries.number + slot),
          center{theirCenter[0], theirCenter[1], theirCenter[2]},
          excludesSelf(sets.excludesSelf)
    {
    }

    std::uint32_t ownNumber(std::uint32_t i) const { return excludesSelf ? number[i] : kNobodysNumber; }
    float farOf(std::uint32_t i) const { return far ? far[i] : farOfAll; }
};

// Where the grid of the queries has them.
inline QueryPositions positionsOf(const BlockView& queries, std::uint32_t slot)
{
    return {queries.x + slot, queries.y + slot, queries.z + slot};
}

// What the filter makes of a vector of candidates: negative for neighbors, and what orders them by their distance.
struct SetScores {
    Simd::F score, order;
};

// The candidates that a cell keeps, as KeptFrame.
template <typename Rule>
struct KeptSetFrame {
    static constexpr std::size_t kNumber = 8;

    struct Candidates {
        Simd::F x, y, z, w, far;

        Candidates(const char* p, std::size_t stride)
            : x(Simd::load(floats(p))),
              y(Simd::load(floats(p + stride))),
              z(Simd::load(floats(p + 2 * stride))),
              w(Simd::load(floats(p + 4 * stride))),
              far(Rule::kOfCandidates ? Simd::load(floats(p + 12 * stride)) : w)
        {
        }
    };

    struct Query {
        Simd::F ax, ay, az, k, far, most;
        Simd::I number;

        Query(const FilterBounds& bounds, const KeptSetFrame& frame, std::uint32_t i)
            : far(Simd::set(frame.queries.farOf(i))),
              most(Simd::set(bounds.far)),
              number(Simd::set(static_cast<std::int32_t>(frame.queries.ownNumber(i))))
        {
            const SetQueries& q = frame.queries;
            const float x = q.x[i] - q.center[0], y = q.y[i] - q.center[1], z = q.z[i] - q.center[2];
            ax = Simd::set(-2 * x);
            ay = Simd::set(-2 * y);
            az = Simd::set(-2 * z);
            const Simd::F w = Simd::set(z * z + (y * y + x * x));
            k = Rule::kOfCandidates ? w : Simd::sub(w, far);
        }

        SetScores scores(const Candidates& c) const
        {
            const Simd::F sum =
                Simd::mulAdd(c.z, az, Simd::mulAdd(c.y, ay, Simd::mulAdd(c.x, ax, Simd::add(c.w, k))));
            if constexpr (!Rule::kOfCandidates) return {sum, sum};
            return {Simd::sub(sum, Simd::max(far, c.far)), Simd::sub(sum, most)};
        }
    };

    const char* base;
    std::size_t stride;
    std::uint32_t count;
    SetQueries queries;
};

// A leaf and its halo, as HaloFrame; the centre of the queries is 0.
template <typename Rule>
struct HaloSetFrame {
    static constexpr std::size_t kNumber = 4;

    struct Candidates {
        Simd::F x, y, z, far;

        Candidates(const char* p, std::size_t stride)
            : x(Simd::load(floats(p))),
              y(Simd::load(floats(p + stride))),
              z(Simd::load(floats(p + 2 * stride))),
              far(Rule::kOfCandidates ? Simd::load(floats(p + 8 * stride)) : x)
        {
        }
    };

    struct Query {
        Simd::F x, y, z, far, most;
        Simd::I number;

        Query(const FilterBounds& bounds, const HaloSetFrame& frame, std::uint32_t i)
            : x(Simd::set(frame.queries.x[i])),
              y(Simd::set(frame.queries.y[i])),
              z(Simd::set(frame.queries.z[i])),
              far(Simd::set(frame.queries.farOf(i))),
              most(Simd::set(bounds.far)),
              number(Simd::set(static_cast<std::int32_t>(frame.queries.ownNumber(i))))
        {
        }

        SetScores scores(const Candidates& c) const
        {
            const Simd::F dx = Simd::sub(c.x, x), dy = Simd::sub(c.y, y), dz = Simd::sub(c.z, z);
            const Simd::F square = Simd::mulAdd(dz, dz, Simd::mulAdd(dy, dy, Simd::mul(dx, dx)));
            if constexpr (!Rule::kOfCandidates) {
                const Simd::F score = Simd::sub(square, far);
                return {score, score};
            }
            return {Simd::sub(square, Simd::max(far, c.far)), Simd::sub(square, most)};
        }
    };

    const char* base;
    std::size_t stride;
    std::uint32_t count;
    SetQueries queries;
};

// testPair() of test_pairs-inl.h for the queries `i` and `i` + 1.
template <template <typename> class Frame, typename Rule, typename Take>
__attribute__((always_inline)) inline bool testPair(const FilterBounds& bounds, const Frame<Rule>& frame,
                                                    std::uint32_t i, Take&& take)
{
    using F = Frame<Rule>;
    const std::size_t stride = frame.stride;
    const typename F::Query a(bounds, frame, i), b(bounds, frame, i + 1);
    Simd::I least = Simd::set(kLargestBits);
    const char* p = frame.base;
    for (const char* const end = p + std::size_t(frame.count) * sizeof(float); p < end; p += kVectorBytes) {
        const typename F::Candidates candidates(p, stride);
        const SetScores scoresA = a.scores(candidates), scoresB = b.scores(candidates);
        const Simd::I numbers = numbersAt<F>(p, stride);
        least = Simd::min(least, Simd::min(Simd::bits(scoresA.score), Simd::bits(scoresB.score)));
        take(numbers, Simd::bits(scoresA.order),
             Simd::movesign(scoresA.score) & ~Simd::equal(numbers, a.number), Simd::bits(scoresB.order),
             Simd::movesign(scoresB.score) & ~Simd::equal(numbers, b.number));
    }
    return Simd::lessEqual(least, Simd::set(bounds.bandTop)) != 0;
}

// testQuery() for the query `i`.
template <template <typename> class Frame, typename Rule, typename Take>
__attribute__((always_inline)) inline bool testQuery(const FilterBounds& bounds, const Frame<Rule>& frame,
                                                     std::uint32_t i, Take&& take)
{
    using F = Frame<Rule>;
    const std::size_t stride = frame.stride;
    const typename F::Query query(bounds, frame, i);
    Simd::I least = Simd::set(kLargestBits);
    const char* p = frame.base;
    for (const char* const end = p + std::size_t(frame.count) * sizeof(float); p < end; p += kVectorBytes) {
        const SetScores scores = query.scores(typename F::Candidates(p, stride));
        const Simd::I numbers = numbersAt<F>(p, stride);
        least = Simd::min(least, Simd::bits(scores.score));
        take(numbers, Simd::bits(scores.order),
             Simd::movesign(scores.score) & ~Simd::equal(numbers, query.number));
    }
    return Simd::lessEqual(least, Simd::set(bounds.bandTop)) != 0;
}

// testBand() for the query `i`.
template <template <typename> class Frame, typename Rule, typename Row>
__attribute__((noinline)) Row testBand(const FilterBounds& bounds, Frame<Rule> frame, std::uint32_t i,
                                       const ExactPredicate& exact, TaskStatistics& statistics, Row row)
{
    using F = Frame<Rule>;
    const typename F::Query query(bounds, frame, i);
    const std::uint32_t number = frame.queries.number[i];
    for (std::size_t j = 0; j < frame.count; j += Simd::kLanes) {
        const char* const p = frame.base + j * sizeof(float);
        const SetScores scores = query.scores(typename F::Candidates(p, frame.stride));
        const Simd::I numbers = numbersAt<F>(p, frame.stride);
        Simd::Mask hits = Simd::movesign(scores.score) & ~Simd::equal(numbers, query.number);
        Simd::Mask band = hits & Simd::lessEqual(Simd::bits(scores.score), Simd::set(bounds.bandTop));
        for (; band; band &= band - 1) {
            const unsigned lane = static_cast<unsigned>(__builtin_ctz(band));
            ++statistics.bandPairs;
            if (!exact.isNeighbor(exact.state, number, integers(p + F::kNumber * frame.stride)[lane])) {
                hits &= ~(Simd::Mask(1) << lane);
            }
        }
        row.take(numbers, Simd::bits(scores.order), hits);
    }
    return row;
}

} // namespace
} // namespace vdb_nns
