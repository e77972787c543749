// Measures of the particles of a leaf, whose pairs among each other are seen once: a pair is added to both of its particles. For measures
// that are sums of what both see alike, at a scale that is known before. Half of the distances and roots are saved that way.
#pragma once

#include "measure/row_measures.h"

#include <cstdint>
#include <vector>

namespace vdb_nns {

class LeafSums {
public:
    explicit LeafSums(const RowMeasures& measures);

    // Whether they are all that is asked for. The positions then need slots.
    static bool suffice(const RowMeasures& measures);

    // Of the particles in slots from `firstSlot` on.
    void begin(std::uint32_t firstSlot, std::uint32_t particles);

    // Where PairsFunction writes the places of pairs.
    LeafPlaces places(std::uint32_t* out) const { return {mFirstSlot, mParticles, out}; }

    // Rows of queries from `firstSlot` on, with the squares of their distances.
    void add(const PairGroups& groups, const std::uint32_t* places, std::uint32_t firstSlot,
             const double* squares);

    // Writes the values of the particles, and adds the pairs of other rows to the counts; both by slot from the first on. False, and
    // no value is of use, where they must be made row by row.
    bool finish(const std::uint32_t* numbers, std::uint32_t* counts);

private:
    const RowMeasures& mMeasures;
    OncePairs mPairs{};
    const RowScale mWeightScale, mDistanceScale;
    const double mAtZero; // W(0)
    std::uint32_t mFirstSlot = 0, mParticles = 0;
    std::vector<ParticleSums> mSums; // and of the places outside
};

} // namespace vdb_nns
