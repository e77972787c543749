// The exit codes of the command line.
#pragma once

#include "vdb_nns/error.h"

namespace vdb_nns::cli {

enum ExitCode : int {
    kDone = 0,
    kCheckFailed = 1,   // a check that was asked for failed
    kBadUsage = 2,      // bad or contradictory flags, an output that exists
    kBadInput = 3,      // missing, unreadable, truncated or unsupported input
    kNoRoom = 4,        // does not fit the budget or the memory
    kNoDevice = 5,      // the device demanded is not there or failed
    kNotWritten = 6,    // output cannot be written
    kUnexpected = 70,   // a fault of this program
    kHungUp = 129,      // SIGHUP
    kInterrupted = 130, // SIGINT
    kTerminated = 143   // SIGTERM
};

/// A check that was asked for failed: exit code 1.
class CheckFailed : public Error {
public:
    using Error::Error;
};

} // namespace vdb_nns::cli
