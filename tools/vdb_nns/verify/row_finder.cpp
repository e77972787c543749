#include "row_finder.h"

#include <algorithm>
#include <cmath>

namespace vdb_nns::cli {

std::vector<Bounds> candidateBounds(const SearchJudge& judge, const SearchClouds& clouds)
{
    std::vector<Bounds> bounds;
    const Radius& radius = judge.terms().radius;
    if (radius.isOne() || radius.mode == RadiusMode::kGather) return bounds;
    bounds.resize(clouds.candidates->x.size());
    for (const std::uint32_t j : clouds.candidates->numbers)
        bounds[j] = clouds.bounds(judge.candidateRadius(j));
    return bounds;
}

RowFinder::RowFinder(const SearchJudge& judge, const SearchClouds& clouds, const std::vector<Bounds>& bounds)
    : mJudge(judge), mClouds(clouds), mBounds(bounds)
{
}

const std::vector<std::uint32_t>& RowFinder::findByCells(std::uint32_t query, const HashList& hashes)
{
    const SearchCloud& cloud = *mClouds.queries;
    mFound.clear();
    mGathered.resize(std::max(mGathered.size(), hashes.size()));
    for (std::size_t k = 0; k < hashes.size(); ++k) {
        Gathered& near = mGathered[k];
        const auto cellOf = [&](double p) {
            return static_cast<std::int64_t>(std::floor(p / hashes[k]->edge()));
        };
        const CellKey cell{cellOf(cloud.x[query]), cellOf(cloud.y[query]), cellOf(cloud.z[query])};
        if (near.hash != hashes[k] || near.cell != cell) gather(*hashes[k], cell, near);
        test(query, near.x.data(), near.y.data(), near.z.data(), near.bounds.data(), near.numbers.data(), 0,
             near.numbers.size(), mFound);
    }
    std::sort(mFound.begin(), mFound.end());
    return mFound;
}

void RowFinder::findAmong(std::uint32_t query, std::size_t begin, std::size_t end,
                          std::vector<std::uint32_t>& found)
{
    constexpr std::size_t kPart = 256; // whose distances stay in the first-level cache
    const SearchCloud& cloud = *mClouds.candidates;
    for (std::size_t part = begin; part < end; part += kPart) {
        const Bounds* const bounds = mBounds.empty() ? nullptr : mBounds.data() + part;
        test(query, cloud.x.data() + part, cloud.y.data() + part, cloud.z.data() + part, bounds, nullptr,
             static_cast<std::uint32_t>(part), std::min(kPart, end - part), found);
    }
}

const Bounds& RowFinder::boundsOf(std::uint32_t query)
{
    const double radius = mJudge.queryRadius(query);
    if (radius != mRadius) mOwn = mClouds.bounds(radius);
    mRadius = radius;
    return mOwn;
}

void RowFinder::gather(const CellHash& hash, const CellKey& cell, Gathered& gathered) const
{
    const SearchCloud& cloud = *mClouds.candidates;
    gathered.hash = &hash;
    gathered.cell = cell;
    std::vector<std::uint32_t>& numbers = gathered.numbers;
    numbers.clear();
    for (int step = 0; step < 27; ++step) {
        const CellKey key{cell[0] + step / 9 - 1, cell[1] + step / 3 % 3 - 1, cell[2] + step % 3 - 1};
        const std::size_t other = hash.find(key);
        if (other == CellHash::kNone) continue;
        const auto first = hash.numbers().begin();
        numbers.insert(numbers.end(), first + static_cast<std::ptrdiff_t>(hash.begin(other)),
                       first + static_cast<std::ptrdiff_t>(hash.end(other)));
    }
    for (auto* values : {&gathered.x, &gathered.y, &gathered.z}) values->resize(numbers.size());
    gathered.bounds.resize(mBounds.empty() ? 0 : numbers.size());
    for (std::size_t k = 0; k < numbers.size(); ++k) {
        gathered.x[k] = cloud.x[numbers[k]];
        gathered.y[k] = cloud.y[numbers[k]];
        gathered.z[k] = cloud.z[numbers[k]];
        if (!mBounds.empty()) gathered.bounds[k] = mBounds[numbers[k]];
    }
}

namespace {

// Candidates that are tested together: where they are, their squared distances from the query, and the bounds of their own
// radii, or null. Candidate k has the number numbers[k], or firstNumber + k where that is null.
struct Tested {
    const double* squares;
    const Bounds* bounds;
    const std::uint32_t* numbers;
    std::uint32_t firstNumber;
    std::size_t count;

    std::uint32_t number(std::size_t k) const
    {
        return numbers ? numbers[k] : firstNumber + static_cast<std::uint32_t>(k);
    }
    template <bool kHasBounds>
    Bounds boundsOf(std::size_t k, const Bounds& own) const
    {
        if constexpr (!kHasBounds) return own;
        return {std::max(own.within, bounds[k].within), std::max(own.beyond, bounds[k].beyond)};
    }
};

// Writes the numbers of those that are not surely too far and not `self`, and counts those of them that are not surely near.
// Every candidate is written, and kept by moving on: no branch to guess wrong.
template <bool kHasBounds>
std::uint32_t* writeNear(const Tested& tested, const Bounds& own, std::uint32_t self, std::uint32_t* out,
                         std::size_t& unsure)
{
    for (std::size_t k = 0; k < tested.count; ++k) {
        const std::uint32_t number = tested.number(k);
        *out = number;
        const Bounds limit = tested.boundsOf<kHasBounds>(k, own);
        const unsigned near = tested.squares[k] <= limit.beyond, sure = tested.squares[k] <= limit.within;
        const unsigned other = number != self;
        out += near & other;
        unsure += (near - sure) & other;
    }
    return out;
}

} // namespace

void RowFinder::test(std::uint32_t query, const double* x, const double* y, const double* z,
                     const Bounds* bounds, const std::uint32_t* numbers, std::uint32_t firstNumber,
                     std::size_t count, std::vector<std::uint32_t>& found)
{
    constexpr std::uint32_t kNobody = ~std::uint32_t(0); // a view has fewer points
    const SearchCloud& cloud = *mClouds.queries;
    if (mSquares.size() < count) mSquares.resize(count);
    squaredDistances(x, y, z, count, cloud.x[query], cloud.y[query], cloud.z[query], mSquares.data());
    const Bounds own = boundsOf(query);
    const Tested tested{mSquares.data(), bounds, numbers, firstNumber, count};
    const std::uint32_t self = mJudge.isOneSet() ? query : kNobody;
    const bool hasBounds = !mBounds.empty();
    if (!numbers && !hasBounds) { // of all candidates few are near
        int near = 0;
        for (std::size_t k = 0; k < count; ++k) near += mSquares[k] <= own.beyond;
        if (near == 0) return;
    }
    const std::size_t before = found.size();
    std::size_t unsure = 0;
    found.resize(before + count);
    std::uint32_t* const first = found.data() + before;
    const std::uint32_t* const end = hasBounds ? writeNear<true>(tested, own, self, first, unsure)
                                               : writeNear<false>(tested, own, self, first, unsure);
    found.resize(static_cast<std::size_t>(end - found.data()));
    if (unsure == 0) return;
    // Drops those of the unsure that exact arithmetic puts outside.
    std::size_t kept = before, next = before;
    for (std::size_t k = 0; k < count && next < found.size(); ++k) {
        const std::uint32_t number = tested.number(k);
        if (found[next] != number) continue;
        ++next;
        const double within = hasBounds ? std::max(own.within, bounds[k].within) : own.within;
        if (mSquares[k] > within) {
            ++mExactPairs;
            if (!mJudge.within(query, number)) continue;
        }
        found[kept++] = number;
    }
    found.resize(kept);
}

} // namespace vdb_nns::cli
