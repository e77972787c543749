// What measures take in memory, for whoever has to know before they are made. The one formula: measure() itself is held to it.
#pragma once

#include "measure/measure_list.h"
#include "vdb_nns/measure.h"
#include "vdb_nns/search_sets.h"

#include <cstdint>
#include <vector>

namespace vdb_nns {

class MeasureMemory {
public:
    // Of no measures.
    MeasureMemory() = default;

    // Throws InvalidInput for an average of an attribute that is not among the options or has none.
    MeasureMemory(const std::vector<Measure>& measures, const MeasureOptions& options);

    // The values of a query.
    std::uint64_t resultBytesEach() const { return mResultBytesEach; }

    // The values of all queries and what they are made with: positions and averaged attributes as kernels read them.
    std::uint64_t bytes(const SearchSets& sets) const;

    // Masses and averaged attributes, which the caller holds.
    std::uint64_t inputBytes() const { return mInputBytes; }

private:
    std::uint64_t mResultBytesEach = 0, mAveragedBytesEach = 0, mInputBytes = 0;
};

} // namespace vdb_nns
