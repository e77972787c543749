// The whole number below, for code that the compiler makes vectors of. Internal linkage.
#pragma once

namespace vdb_nns {
namespace {

// Of |t| < 2^51. Whole numbers go down to the even one of themselves and the one below. Adding and taking away 1.5 * 2^52 rounds
// to the nearest integer, also where there is no instruction for it.
inline double roundDown(double t)
{
    constexpr double kRound = 6755399441055744.0;
    return (t - 0.5 + kRound) - kRound;
}

} // namespace
} // namespace vdb_nns
