// The voxels of a leaf of a VDB point file, from where the points of each end.
#pragma once

#include <cstdint>

#include <emmintrin.h>

namespace vdb_nns {

// Bit n: voxel n of the 512 holds points. Without branches, since where a spray has points cannot be predicted.
// Returns whether the ends never decrease.
inline bool findOccupied(const std::uint32_t* ends, std::uint64_t* occupied)
{
    const __m128i sign = _mm_set1_epi32(INT32_MIN); // turns unsigned order into signed
    __m128i decreases = _mm_setzero_si128();
    const __m128i* const at = reinterpret_cast<const __m128i*>(ends);
    __m128i before = _mm_setzero_si128(); // its last value is the end of the voxel before
    for (int word = 0; word < 8; ++word) {
        std::uint64_t empty = 0;
        for (int i = 0; i < 16; ++i) {
            const __m128i here = _mm_loadu_si128(at + word * 16 + i);
            const __m128i shifted = _mm_or_si128(_mm_slli_si128(here, 4), _mm_srli_si128(before, 12));
            const int equal = _mm_movemask_ps(_mm_castsi128_ps(_mm_cmpeq_epi32(here, shifted)));
            empty |= static_cast<std::uint64_t>(equal) << (4 * i);
            decreases = _mm_or_si128(
                decreases, _mm_cmpgt_epi32(_mm_xor_si128(shifted, sign), _mm_xor_si128(here, sign)));
            before = here;
        }
        occupied[word] = ~empty;
    }
    return _mm_movemask_epi8(decreases) == 0;
}

} // namespace vdb_nns
