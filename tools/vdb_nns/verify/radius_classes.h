// Cells for radii of any sizes: particles of like radii share a hash of cells, so that a large radius does not make the cells
// of the small ones large. Shares no grid with the engine.
#pragma once

#include "point_cells.h"
#include "search_clouds.h"

#include <array>
#include <cstdint>
#include <memory>
#include <vector>

namespace vdb_nns::cli {

// Hashes of candidates in which a query looks for its neighbors: each of them is in one of these at most, and those that are
// in none do not reach it.
using HashList = std::vector<const CellHash*>;

class RadiusClasses {
public:
    RadiusClasses(const SearchJudge& judge, const SearchClouds& clouds);

    // Queries with one list of hashes, by cells; those that can have no neighbor are in none.
    struct Group {
        std::shared_ptr<const CellHash> queries;
        HashList candidates;
    };
    const std::vector<Group>& groups() const { return mGroups; }

private:
    // Radii of the class k are within a factor of two, and at most 2^-k of the largest one; the last one has the rest.
    static constexpr unsigned kClasses = 25, kNone = kClasses;

    unsigned classOf(double radius) const;
    std::vector<std::uint32_t> ofClasses(unsigned first, unsigned last) const; // candidates, both included
    double edgeOf(unsigned radiusClass) const;
    void addGroup(std::vector<std::uint32_t>&& queries, const HashList& candidates, double edge);
    const CellHash* addHash(const std::vector<std::uint32_t>& candidates, double edge);

    const SearchClouds& mClouds;
    std::vector<std::uint8_t>
        mCandidateClass; // by place in the cloud's numbers; empty where radii of queries alone count
    std::array<double, kClasses> mLargest{}; // radius of each class
    std::vector<std::shared_ptr<const CellHash>> mHashes;
    std::vector<Group> mGroups;
};

} // namespace vdb_nns::cli
