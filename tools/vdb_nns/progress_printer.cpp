#include "progress_printer.h"

#include "signals.h"
#include "vdb_nns/error.h"

#include <algorithm>
#include <cstdio>
#include <unistd.h>
#include <utility>

namespace vdb_nns::cli {

namespace {

constexpr std::chrono::milliseconds kLinePeriod{100}; // a terminal line changes at most this often

} // namespace

ProgressPrinter::ProgressPrinter(ProgressMode mode)
{
    const bool terminal = isatty(STDERR_FILENO) != 0;
    if (mode == ProgressMode::kNever || (mode == ProgressMode::kAuto && !terminal)) {
        mStyle = Style::kSilent;
    } else {
        mStyle = terminal ? Style::kLine : Style::kList;
    }
}

ProgressPrinter::ProgressPrinter(std::function<void(int)> tell) : mStyle(Style::kTold), mTell(std::move(tell))
{
}

ProgressPrinter::~ProgressPrinter()
{
    if (mLineShown) std::fputs("\r\033[K", stderr);
}

void ProgressPrinter::begin(const char* phase, double from, double to)
{
    throwIfStopped();
    {
        const std::lock_guard<std::mutex> lock(mMutex);
        mPhase = phase;
    }
    mFrom.store(from, std::memory_order_relaxed);
    mTo.store(to, std::memory_order_relaxed);
    update(phase, 0);
}

void ProgressPrinter::finish()
{
    if (mStyle == Style::kList && mPercent.load() < 100) print(100);
    if (mLineShown) std::fputs("\r\033[K", stderr);
    mLineShown = false;
}

void ProgressPrinter::update(const char*, double fraction)
{
    if (mStyle == Style::kSilent) return;
    const double from = mFrom.load(std::memory_order_relaxed), to = mTo.load(std::memory_order_relaxed);
    const double whole = from + (to - from) * std::clamp(fraction, 0.0, 1.0);
    const int percent = std::clamp(static_cast<int>(whole * 100), 0, 100);
    if (percent > mPercent.load(std::memory_order_relaxed)) print(percent);
}

void ProgressPrinter::print(int percent)
{
    // A worker never waits for the terminal: whoever holds the lock prints a number about as new.
    const std::unique_lock<std::mutex> lock(mMutex, std::try_to_lock);
    if (!lock || percent <= mPercent.load(std::memory_order_relaxed)) return;
    if (mStyle == Style::kTold) {
        mTell(percent);
    } else if (mStyle == Style::kList) {
        std::fprintf(stderr, "PROGRESS %d%%\n", percent);
    } else {
        const auto now = std::chrono::steady_clock::now();
        if (now - mLastPrint < kLinePeriod) return;
        mLastPrint = now;
        std::fprintf(stderr, "\r\033[K%-8s %3d %%", mPhase.c_str(), percent);
        std::fflush(stderr);
        mLineShown = true;
    }
    mPercent.store(percent, std::memory_order_relaxed);
}

bool ProgressPrinter::cancelled() const
{
    return stopSignal() != 0;
}

void throwIfStopped()
{
    if (stopSignal() != 0) throw Cancelled("stopped by a signal");
}

} // namespace vdb_nns::cli
