// The clock on the wall.
#pragma once

#include <chrono>

namespace vdb_nns {

// Seconds since some fixed moment. Never goes back.
inline double wallSeconds()
{
    return std::chrono::duration<double>(std::chrono::steady_clock::now().time_since_epoch()).count();
}

} // namespace vdb_nns
