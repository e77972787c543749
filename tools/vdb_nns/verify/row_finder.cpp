#include "row_finder.h"

#include <algorithm>
#include <cmath>

namespace vdb_nns::cli {

std::vector<Bounds> candidateBounds(const SearchJudge& judge, const SearchClouds& clouds)
{
    std::vector<Bounds> bounds;
    const Radius& radius = judge.terms().radius;
    if (radius.isOne() || radius.mode == RadiusMode::kGather) return bounds;
    bounds.resize(clouds.candidates.x.size());
    for (const std::uint32_t j : clouds.candidates.numbers)
        bounds[j] = clouds.bounds(judge.candidateRadius(j));
    return bounds;
}

RowFinder::RowFinder(const SearchJudge& judge, const SearchClouds& clouds, const std::vector<Bounds>& bounds)
    : mJudge(judge), mClouds(clouds), mBounds(bounds)
{
}

const std::vector<std::uint32_t>& RowFinder::findByCells(std::uint32_t query, const HashList& hashes)
{
    const SearchCloud& cloud = mClouds.queries;
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
    const SearchCloud& cloud = mClouds.candidates;
    const Bounds* const bounds = mBounds.empty() ? nullptr : mBounds.data() + begin;
    test(query, cloud.x.data() + begin, cloud.y.data() + begin, cloud.z.data() + begin, bounds, nullptr,
         static_cast<std::uint32_t>(begin), end - begin, found);
}

void RowFinder::gather(const CellHash& hash, const CellKey& cell, Gathered& gathered) const
{
    const SearchCloud& cloud = mClouds.candidates;
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

// Candidate k has the number numbers[k], or firstNumber + k.
void RowFinder::test(std::uint32_t query, const double* x, const double* y, const double* z,
                     const Bounds* bounds, const std::uint32_t* numbers, std::uint32_t firstNumber,
                     std::size_t count, std::vector<std::uint32_t>& found)
{
    const SearchCloud& cloud = mClouds.queries;
    mSquares.resize(count);
    squaredDistances(x, y, z, count, cloud.x[query], cloud.y[query], cloud.z[query], mSquares.data());
    const Bounds own = mClouds.bounds(mJudge.queryRadius(query));
    const bool hasBounds = !mBounds.empty(), isOneSet = mJudge.isOneSet();
    // Every candidate is written, and kept by moving on: no branch to guess wrong.
    const std::size_t before = found.size();
    found.resize(before + count);
    std::uint32_t* out = found.data() + before;
    std::size_t unsure = 0;
    for (std::size_t k = 0; k < count; ++k) {
        const std::uint32_t number = numbers ? numbers[k] : firstNumber + static_cast<std::uint32_t>(k);
        *out = number;
        const double within = hasBounds ? std::max(own.within, bounds[k].within) : own.within;
        const double beyond = hasBounds ? std::max(own.beyond, bounds[k].beyond) : own.beyond;
        const unsigned near = mSquares[k] <= beyond, sure = mSquares[k] <= within;
        const unsigned other = !isOneSet || number != query;
        out += near & other;
        unsure += (near - sure) & other;
    }
    found.resize(static_cast<std::size_t>(out - found.data()));
    if (unsure == 0) return;
    // Drops those of the unsure that exact arithmetic puts outside.
    std::size_t kept = before, next = before;
    for (std::size_t k = 0; k < count && next < found.size(); ++k) {
        const std::uint32_t number = numbers ? numbers[k] : firstNumber + static_cast<std::uint32_t>(k);
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
