// Compares neighbor lists with the oracle's and says of the first mismatches who, how far apart, and how many ulps from
// the radius. Knows NeighborLists by its public header only.
#pragma once

#include "oracle.h"
#include "vdb_nns/neighbor_lists.h"

#include <gtest/gtest.h>

namespace vdb_nns::testing {

// Success iff every row of `actual` holds the numbers of that row of `expected`, in any order, none twice; prints up to
// ten pairs that are missing, extra or double.
::testing::AssertionResult sameLists(const Lists& actual, const Lists& expected, const PointSet& set);
::testing::AssertionResult sameLists(const NeighborLists& actual, const Lists& expected, const PointSet& set);

// For encodings without lists: every count equals the length of its row.
::testing::AssertionResult sameCounts(const std::vector<std::uint32_t>& actual, const Lists& expected);

// Decodes every row, in the order in which the lists hold it.
Lists decoded(const NeighborLists& lists);

} // namespace vdb_nns::testing
