// Asks a Progress whether to stop. Cheap enough for every batch of work.
#pragma once

#include "util/isolate.h"
#include "vdb_nns/error.h"
#include "vdb_nns/progress.h"

#include <string>

namespace vdb_nns {

class CancelCheck {
public:
    // `step` is a string literal, the name shown to the user. `progress` may be null.
    CancelCheck(Progress* progress, const char* step) : mProgress(progress), mStep(step) {}

    void check() const
    {
        if (mProgress && isolated([this] { return mProgress->cancelled(); }))
            throw Cancelled(std::string("cancelled during step ") + mStep);
    }

    void update(double fraction) const
    {
        check();
        if (mProgress) isolated([&] { mProgress->update(mStep, fraction); });
    }

private:
    Progress* mProgress;
    const char* mStep;
};

} // namespace vdb_nns
