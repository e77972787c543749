// Who is a neighbor by definition: two sets of particles, the radius of each pair, and exact answers about them. Takes the
// positions from ParticleView, which defines them; shares nothing with the engine.
#pragma once

#include "exact_pair.h"
#include "vdb_nns/particle_set.h"

#include <cstdint>

namespace vdb_nns::cli {

// What lists are said to be.
struct SearchTerms {
    // Rows and columns. One set where both have the same view: then nobody is a neighbor of itself. Groups are `chosen`.
    ParticleSet queries, candidates;
    // Between two sets: what comes to linear() * stored position to make a world position.
    Vec3d queryTranslation{}, candidateTranslation{};
    Radius radius;
    std::uint64_t nearest = 0; // of each list no more than so many, by distance; 0: all
    bool byDistance = false;   // rows by distance instead of number
    bool includeSelf = false;  // of one set: a query that is a candidate stands in its own list

    bool isOneSet() const { return &queries.view.source() == &candidates.view.source(); }
};

struct Interval {
    double low, high;
};

// Thread-safe. The terms must outlive it.
class SearchJudge {
public:
    explicit SearchJudge(const SearchTerms& terms);

    const SearchTerms& terms() const { return mTerms; }
    bool isOneSet() const { return mIsOneSet; }
    std::uint64_t queryCount() const { return mTerms.queries.view.size(); }
    std::uint64_t candidateCount() const { return mTerms.candidates.view.size(); }

    // Radii of particles that are NaN, infinite or not positive count as minus infinity, which reaches nobody.
    double radius(std::uint64_t query, std::uint64_t candidate) const;
    double queryRadius(std::uint64_t query) const;         // minus infinity where it is not read
    double candidateRadius(std::uint64_t candidate) const; // likewise

    // All of these of finite points.
    bool within(std::uint32_t query, std::uint32_t candidate) const;
    Dyadic squaredDistance(std::uint32_t query, std::uint32_t candidate) const;
    Interval distance(std::uint64_t query, std::uint64_t candidate) const; // encloses the world distance
    PairDistance describe(std::uint64_t query, std::uint64_t candidate) const;

    bool isFiniteQuery(std::uint64_t query) const;
    bool isFiniteCandidate(std::uint64_t candidate) const;
    bool isQuery(std::uint64_t query) const;         // finite, and of the groups chosen
    bool isCandidate(std::uint64_t candidate) const; // likewise

    const AffineMap& queryMap() const { return mIsOneSet ? mCandidateMap : mQueryMap; }
    const AffineMap& candidateMap() const { return mCandidateMap; }

private:
    PlacedPoint query(std::uint64_t i) const;
    PlacedPoint candidate(std::uint64_t j) const;

    const SearchTerms& mTerms;
    bool mIsOneSet;
    AffineMap mQueryMap, mCandidateMap;
};

} // namespace vdb_nns::cli
