// How the steps of `verify` ask whether to stop.
#pragma once

#include "vdb_nns/error.h"
#include "vdb_nns/progress.h"

namespace vdb_nns::cli {

// `progress` may be null.
inline void throwIfCancelled(const Progress* progress)
{
    if (progress && progress->cancelled()) throw Cancelled("verify: cancelled");
}

} // namespace vdb_nns::cli
