#include "radius_classes.h"

#include <algorithm>
#include <cmath>
#include <utility>

namespace vdb_nns::cli {

RadiusClasses::RadiusClasses(const SearchJudge& judge, const SearchClouds& clouds) : mClouds(clouds)
{
    const SearchCloud &queries = *clouds.queries, &candidates = *clouds.candidates;
    if (clouds.largestRadius <= 0 || queries.numbers.empty() || candidates.numbers.empty()) return;
    const auto note = [&](double radius) {
        const unsigned k = classOf(radius);
        if (k != kNone) mLargest[k] = std::max(mLargest[k], clouds.scaled(radius));
        return k;
    };
    std::array<std::vector<std::uint32_t>, kClasses + 1> members; // queries of each class
    for (const std::uint32_t i : queries.numbers) members[note(judge.queryRadius(i))].push_back(i);
    const Radius& radius = judge.terms().radius;
    if (!radius.isOne() && radius.mode != RadiusMode::kGather) {
        for (const std::uint32_t j : candidates.numbers)
            mCandidateClass.push_back(static_cast<std::uint8_t>(note(judge.candidateRadius(j))));
    }
    // Candidates that reach queries of smaller radii, each class by itself.
    HashList larger;
    double smallestEdge = clouds.cellEdge(clouds.largestRadius);
    for (unsigned k = 0; k < kClasses; ++k) {
        if (!members[k].empty()) { // within their radius all others count, and those of their own class
            HashList hashes = larger;
            const std::vector<std::uint32_t> others =
                mCandidateClass.empty() ? candidates.numbers : ofClasses(k, kNone);
            if (const CellHash* const hash = addHash(others, edgeOf(k))) hashes.push_back(hash);
            // All points are both, with radii of one class: the cells of the candidates are those of the queries.
            const bool isSame = clouds.queries == clouds.candidates && others.size() == members[k].size() &&
                                hashes.size() == 1;
            if (isSame) {
                mGroups.push_back({mHashes.back(), hashes});
            } else {
                addGroup(std::move(members[k]), hashes, edgeOf(k));
            }
        }
        if (mCandidateClass.empty()) continue;
        if (const CellHash* const hash = addHash(ofClasses(k, k), edgeOf(k))) {
            larger.push_back(hash);
            smallestEdge = edgeOf(k);
        }
    }
    addGroup(std::move(members[kNone]), larger, smallestEdge);
}

unsigned RadiusClasses::classOf(double radius) const
{
    const double scaled = mClouds.scaled(radius);
    if (!(radius > 0)) return kNone;
    if (scaled <= std::ldexp(mClouds.largestRadius, -static_cast<int>(kClasses))) return kClasses - 1;
    const int octaves = std::ilogb(mClouds.largestRadius) - std::ilogb(scaled);
    return static_cast<unsigned>(std::clamp(octaves, 0, static_cast<int>(kClasses) - 1));
}

std::vector<std::uint32_t> RadiusClasses::ofClasses(unsigned first, unsigned last) const
{
    std::vector<std::uint32_t> numbers;
    for (std::size_t k = 0; k < mCandidateClass.size(); ++k) {
        if (mCandidateClass[k] >= first && mCandidateClass[k] <= last)
            numbers.push_back(mClouds.candidates->numbers[k]);
    }
    return numbers;
}

double RadiusClasses::edgeOf(unsigned radiusClass) const
{
    return mClouds.cellEdge(mLargest[radiusClass]);
}

// The cells of queries that are looked for in none of the hashes are not needed.
void RadiusClasses::addGroup(std::vector<std::uint32_t>&& queries, const HashList& candidates, double edge)
{
    if (queries.empty() || candidates.empty()) return;
    const SearchCloud& cloud = *mClouds.queries;
    mGroups.push_back(
        {std::make_shared<const CellHash>(cloud.x.data(), cloud.y.data(), cloud.z.data(), queries, edge),
         candidates});
}

const CellHash* RadiusClasses::addHash(const std::vector<std::uint32_t>& candidates, double edge)
{
    if (candidates.empty()) return nullptr;
    const SearchCloud& cloud = *mClouds.candidates;
    mHashes.push_back(
        std::make_shared<const CellHash>(cloud.x.data(), cloud.y.data(), cloud.z.data(), candidates, edge));
    return mHashes.back().get();
}

} // namespace vdb_nns::cli
