// How long steps tell where they are and are stopped.
#pragma once

namespace vdb_nns {

/// Called from worker threads, possibly several at once: an implementation must be thread-safe and cheap.
/// What it throws leaves the step as it is.
class Progress {
public:
    virtual ~Progress() = default;

    /// @param step a short name of the step that runs, e.g. "grid", "search", "write"; a string literal.
    /// @param fraction of that step that is done, 0 to 1; never decreases within one step for one thread.
    virtual void update(const char* step, double fraction) = 0;

    /// When true is returned, the running step stops within 0.3 s of each thread's work and throws
    /// `Cancelled`. Not so while a device searches a block, or OpenVDB measures, extends or frees a tree of more
    /// than half a million leaves. Writers ask for the last time before the file appears.
    virtual bool cancelled() const { return false; }
};

} // namespace vdb_nns
