// Positions of the two sets of a search as kernels of measures read them, by number: of the stored coordinates, so that distances
// are those of PairDistance. 16 bytes a particle; 32 where coordinates are doubles, or where voxels that are a radius apart differ by
// hundreds. Knows nothing of rows.
#pragma once

#include "cpu/measure_rows.h"
#include "util/cancel.h"
#include "util/memory.h"
#include "vdb_nns/particle_view.h"

#include <cstddef>
#include <cstdint>

namespace vdb_nns {

class PairPositions {
public:
    // Copies the positions to `memory`, of candidates and queries; where both are the same, there is one copy. `radius`: the
    // largest. The memory outlives it.
    void read(const ParticleView& queries, const ParticleView& candidates, double radius,
              const CancelCheck& cancel, PageArray<char> (&memory)[2]);

    PositionRecord record() const { return mRecord; }
    const PairMap& map() const { return mMap; }
    const void* query(std::uint32_t number) const { return mQueryData + mRecordBytes * number; }
    const void* candidates() const { return mCandidateData; }

    // Of the copies that read() would make.
    static std::uint64_t bytesFor(const ParticleView& queries, const ParticleView& candidates);

private:
    PositionRecord mRecord = PositionRecord::kFloats;
    std::size_t mRecordBytes = sizeof(FloatPosition);
    PairMap mMap{};
    const char* mQueryData = nullptr;
    const char* mCandidateData = nullptr;
};

} // namespace vdb_nns
