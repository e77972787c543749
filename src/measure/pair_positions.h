// Positions of the two sets of a search as kernels of measures read them, by number: of the stored coordinates, so that distances
// are those of PairDistance. 16 bytes a particle; 32 where coordinates are doubles, where those of a grid may be held as doubles, which
// saves a third of the time, or where voxels that are a radius apart differ by hundreds. Knows nothing of rows.
#pragma once

#include "cpu/measure_rows.h"
#include "util/cancel.h"
#include "util/memory.h"
#include "vdb_nns/particle_view.h"

#include <cstddef>
#include <cstdint>

namespace vdb_nns {

class ParticleSource;

class PairPositions {
public:
    // Copies the positions to `memory`, of candidates and queries; where both are the same, there is one copy. `radius`: the
    // largest. `mayBeDoubles`: copies may have 32 bytes a particle. The memory and the views outlive it.
    void read(const ParticleView& queries, const ParticleView& candidates, double radius, bool mayBeDoubles,
              const CancelCheck& cancel, PageArray<char> (&memory)[2]);

    PositionRecord record() const { return mRecord; }
    const PairMap& map() const { return mMap; }
    const void* queries() const { return mQueryData; }
    const void* candidates() const { return mCandidateData; }
    std::size_t recordBytes() const;

    // Whether there is room for the slots of the particles, of which there is one set.
    bool canHaveSlots() const;
    // Notes them; `number`: of the particle in each.
    void setSlots(const PageArray<std::uint32_t>& number, std::size_t slots, const CancelCheck& cancel);

    // Whether differences are of the stored coordinates. Of two sets whose coordinates are not alike they are of rounded positions, and
    // neighbors may be farther apart than the radius by what rounding does.
    bool areStored() const { return mAreStored; }

    // Whether differences from some particles, or to them, come out as NaN: those are to be looked up.
    bool hasUnknown() const { return mHasUnknown; }
    // Candidate less query, with the map, from the stored positions.
    Vec3d lookUp(std::uint32_t query, std::uint32_t candidate) const;

    // Of the copies that read() would make, unless they may be doubles; where offsets stay in their voxels.
    static std::uint64_t bytesFor(const ParticleView& queries, const ParticleView& candidates, double radius);
    // What they would take more if they were doubles.
    static std::uint64_t bytesMoreAsDoubles(const ParticleView& queries, const ParticleView& candidates);

private:
    template <typename Copy>
    Copy copy(PositionRecord record, bool isWorld, const CancelCheck& cancel, PageArray<char> (&memory)[2]);

    const ParticleSource *mQueries = nullptr, *mCandidates = nullptr;
    bool mAreStored = true, mHasUnknown = false;
    PositionRecord mRecord = PositionRecord::kFloats;
    PairMap mMap{};
    const char* mQueryData = nullptr;
    char* mCandidateData = nullptr;
};

} // namespace vdb_nns
