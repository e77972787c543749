// How a long-running step reports progress and is cancelled.
#pragma once

namespace vdb_nns {

/// Called from worker threads, possibly several at once: an implementation must be thread-safe and cheap. An
/// exception that it throws leaves the step as it is.
class Progress {
public:
    virtual ~Progress() = default;

    /// @param step short name of the step that runs, e.g. "grid", "search", "write"; a string literal.
    /// @param fraction of that step that is done, 0 to 1; within a step it never decreases for one thread.
    virtual void update(const char* step, double fraction) = 0;

    /// Once this returns true, the running step throws `Cancelled`, within 0.3 s of work of each thread. It
    /// cannot stop a device that searches a block, nor OpenVDB while it measures, extends or frees a tree of
    /// more than half a million leaves. Writers ask for the last time before the file appears.
    virtual bool cancelled() const { return false; }
};

} // namespace vdb_nns
