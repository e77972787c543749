// The truth of a search of two sets: who is a neighbor with roles, radii of particles, transforms of two sets and the nearest K, by
// brute force over all pairs, in rational arithmetic where long doubles cannot tell. Shares nothing with the engine but the
// definition (docs/cli.md).
#pragma once

#include "oracle.h"

#include <cstdint>
#include <vector>

namespace vdb_nns::testing {

enum class OracleMode { kGather, kScatter, kSymmetric };

struct OracleSet {
    std::vector<ExactPoint> points;
    Linear linear = kIdentity;
    std::array<double, 3> translation{};
    std::vector<char> chosen;  // empty: all
    std::vector<double> radii; // empty: one for all

    bool has(std::size_t i) const { return (chosen.empty() || chosen[i]) && isFinite(points[i]); }
};

struct SetProblem {
    OracleSet queries, candidates;
    bool areSame = true; // number i is the same particle in both
    double radius = 0;   // where there are no radii
    OracleMode mode = OracleMode::kGather;
    std::size_t nearest = 0; // 0: all
    bool includeSelf = false;
};

struct SetAnswer {
    Lists byNumber, byDistance; // a row for each point of the queries
    std::uint64_t shortened = 0, isolated = 0, finiteQueries = 0, neighbors = 0;
    std::uint32_t min = 0, max = 0;
};

SetAnswer setOracle(const SetProblem& problem);

} // namespace vdb_nns::testing
