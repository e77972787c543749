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
struct EstimateFeedback {
    double actualPairs = 0, expectedPairs = 0;    // index rows only: others are not estimated
    double undecidedBytes = 0, undecidedRoom = 0; // that they took, and that they were given
    double bytesDown = 0;                         // as planned
};

// Of a block with so many pairs.
EstimateFeedback feedbackOf(const SparseGridData& grid, const MemoryModel& model, const PendingBlock& block,
                            std::uint64_t pairs, const ResultHead& head);

EstimateFeedback operator+(const EstimateFeedback& a, const EstimateFeedback& b);

// What the blocks that are left are to be taken to need.
Dispatcher::Correction correctionOf(const EstimateFeedback& sum, const MemoryModel& model);

} // namespace vdb_nns
