// The steps of a search job as phases of a command's progress.
#pragma once

#include "progress_printer.h"

#include <atomic>
#include <cstring>
#include <mutex>

namespace vdb_nns::cli {

/// Begins a phase of the printer for each new step: each takes a part of what is left of the span.
class SearchProgress : public Progress {
public:
    explicit SearchProgress(const ProgressSpan& span) : mSpan(span) {}

    /// @throws Cancelled if a signal came
    void update(const char* step, double fraction) override
    {
        const char* const current = mStep;
        if (!current || std::strcmp(current, step) != 0) begin(step);
        mSpan.printer.update(step, fraction);
    }

    bool cancelled() const override { return mSpan.printer.cancelled(); }

private:
    void begin(const char* step)
    {
        const std::lock_guard<std::mutex> lock(mMutex);
        const char* const current = mStep;
        if (current && std::strcmp(current, step) == 0) return; // another thread was first
        // A search that does not fit is followed by other steps, and another search.
        const double share = std::strcmp(step, "search") == 0 ? 0.9 : 1.0 / 3;
        const double end = mSpan.begin + share * (mSpan.end - mSpan.begin);
        mSpan.printer.begin(step, mSpan.begin, end);
        mSpan.begin = end;
        mStep = step;
    }

    ProgressSpan mSpan; // what is left
    std::mutex mMutex;
    std::atomic<const char*> mStep{nullptr};
};

} // namespace vdb_nns::cli
