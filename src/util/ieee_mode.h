// Floating-point arithmetic as IEEE 754 has it, whatever a host program has set: programs that render flush denormal numbers to
// zero, and some round in another direction.
#pragma once

#include <xmmintrin.h>

namespace vdb_nns {

// For the thread, as long as it lives.
class IeeeMode {
public:
    IeeeMode() : mBefore(_mm_getcsr()) { _mm_setcsr(kDefault); }
    ~IeeeMode() { _mm_setcsr(mBefore); }
    IeeeMode(const IeeeMode&) = delete;
    IeeeMode& operator=(const IeeeMode&) = delete;

private:
    static constexpr unsigned kDefault = 0x1f80; // to nearest, denormals kept, no traps

    unsigned mBefore;
};

} // namespace vdb_nns
