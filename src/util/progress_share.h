// A part of a step of a long run as a share of the whole.
#pragma once

#include "vdb_nns/progress.h"

namespace vdb_nns {

// Tells `whole`, which outlives it, of fractions between two.
class ProgressShare final : public Progress {
public:
    ProgressShare(Progress& whole, double from, double to) : mWhole(whole), mFrom(from), mTo(to) {}

    void update(const char* step, double fraction) override
    {
        mWhole.update(step, mFrom + fraction * (mTo - mFrom));
    }
    bool cancelled() const override { return mWhole.cancelled(); }

private:
    Progress& mWhole;
    const double mFrom, mTo;
};

} // namespace vdb_nns
