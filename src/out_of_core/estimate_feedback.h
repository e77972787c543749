// What blocks that a device is done with teach about those to come: how far expected pairs were from true ones, and how many
// pairs were left to the host. Plain sums and a pure function of them.
#pragma once

#include "out_of_core/block_split.h"
#include "plan/dispatcher.h"
#include "shared/block_result.h"
#include "vdb_nns/planning/schedule.h"

#include <cstdint>

namespace vdb_nns {

// Of some blocks.
struct Lesson {
    double actualPairs = 0, expectedPairs = 0;    // index rows only: others are not estimated
    double undecidedBytes = 0, undecidedRoom = 0; // that they took, and that they were given
    double bytesDown = 0;                         // as planned
};

// Of a block with so many pairs.
Lesson lessonOf(const SparseGridData& grid, const MemoryModel& model, const RunBlock& block,
                std::uint64_t pairs, const ResultHead& head);

Lesson operator+(const Lesson& a, const Lesson& b);

// What the blocks that are left are to be taken to need.
Dispatcher::Correction correctionOf(const Lesson& sum, const MemoryModel& model);

} // namespace vdb_nns
