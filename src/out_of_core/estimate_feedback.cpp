#include "out_of_core/estimate_feedback.h"

#include <algorithm>

namespace vdb_nns {

EstimateFeedback feedbackOf(const SparseGridData& grid, const MemoryModel& model, const PendingBlock& block,
                            std::uint64_t pairs, const ResultHead& head)
{
    EstimateFeedback feedback;
    feedback.undecidedBytes = static_cast<double>(head.undecided * sizeof(UndecidedPair));
    feedback.undecidedRoom = static_cast<double>(undecidedRoom(block.queries()));
    feedback.bytesDown = static_cast<double>(block.item.bytes.down);
    if (model.encoding == Encoding::kIndex && block.expectedPairs > 0) {
        feedback.actualPairs = static_cast<double>(pairs);
        feedback.expectedPairs = block.expectedPairs * static_cast<double>(wantedQueries(grid, block.part)) /
                                 static_cast<double>(block.queries());
    }
    return feedback;
}

EstimateFeedback operator+(const EstimateFeedback& a, const EstimateFeedback& b)
{
    return {a.actualPairs + b.actualPairs, a.expectedPairs + b.expectedPairs,
            a.undecidedBytes + b.undecidedBytes, a.undecidedRoom + b.undecidedRoom,
            a.bytesDown + b.bytesDown};
}

Dispatcher::Correction correctionOf(const EstimateFeedback& sum, const MemoryModel& model)
{
    constexpr double kMost = 1e6, kMargin = 1.05;
    Dispatcher::Correction correction;
    if (sum.bytesDown > 0) {
        const double more = (kMargin * sum.undecidedBytes - sum.undecidedRoom) / sum.bytesDown;
        correction.more = std::clamp(more, 0.0, kMost);
    }
    if (sum.expectedPairs > 0) {
        const double ratio = sum.actualPairs / sum.expectedPairs / (1 + model.margin);
        correction.ratio = std::clamp(ratio, 1.0, kMost);
    }
    return correction;
}

} // namespace vdb_nns
