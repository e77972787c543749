// Progress on stderr: one updating line on a terminal, `PROGRESS nn%` lines elsewhere when asked for.
#pragma once

#include "vdb_nns/progress.h"

#include <atomic>
#include <chrono>
#include <cstddef>
#include <functional>
#include <mutex>
#include <string>

namespace vdb_nns::cli {

enum class ProgressMode { kAuto, kAlways, kNever };

/// A run is a sequence of phases, each a share of the whole; steps that the library names inside a phase move
/// it forward only. Asks running steps to stop once SIGHUP, SIGINT or SIGTERM came.
class ProgressPrinter : public Progress {
public:
    explicit ProgressPrinter(ProgressMode mode);
    /// Prints nothing; tells each percentage that is passed, one at a time.
    explicit ProgressPrinter(std::function<void(int percent)> tell);
    ~ProgressPrinter() override;

    /// Starts a phase that covers the fractions [from, to] of the whole run.
    /// @throws Cancelled if a signal came
    void begin(const char* phase, double from, double to);
    /// The run is complete: reports 100 % and clears the line.
    void finish();

    void update(const char* step, double fraction) override;
    bool cancelled() const override;

private:
    void print(int percent);

    enum class Style { kSilent, kLine, kList, kTold };
    Style mStyle;
    std::function<void(int)> mTell;
    std::atomic<double> mFrom{0}, mTo{1}; // share of the phase that runs
    std::atomic<int> mPercent{-1};        // last one printed
    std::mutex mMutex;                    // guards what follows
    std::string mPhase;
    bool mLineShown = false;
    std::chrono::steady_clock::time_point mLastPrint{};
};

/// Throws Cancelled if one of these signals came: called between steps.
void throwIfStopped();

/// The share of a run that a step is shown as.
struct ProgressSpan {
    ProgressPrinter& printer;
    double begin, end;

    /// The k-th of `count` equal parts.
    ProgressSpan part(std::size_t k, std::size_t count) const
    {
        const double step = (end - begin) / static_cast<double>(count);
        return {printer, begin + step * static_cast<double>(k), begin + step * static_cast<double>(k + 1)};
    }
};

} // namespace vdb_nns::cli
