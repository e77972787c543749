// Where the values of measures go, by number of the query, with what stands there for points that have none.
#pragma once

#include "measure/measure_list.h"
#include "util/memory.h"
#include "vdb_nns/measure.h"

#include <cstddef>
#include <cstdint>
#include <memory>
#include <vector>

namespace vdb_nns {

// Null where not asked for.
struct MeasureTargets {
    std::int32_t* count = nullptr;
    float* density = nullptr;
    float* meanDistance = nullptr;
    float* nearestDistance = nullptr;
    float* normal = nullptr; // three each, as all vectors
    float* eigenvalues = nullptr;
    float* stretch = nullptr; // and the three below
    float* xform = nullptr;   // row by row
    double* pws = nullptr;
    std::uint8_t* ellipsoids = nullptr;
    struct Average {
        std::size_t attribute; // in MeasureOptions::attributes
        AttributeType type;
        void* out;
    };
    std::vector<Average> averages;
    // Integers of 32 or 64 bits.
    void* nearest = nullptr;
    void* cluster = nullptr;
    void* clusterSize = nullptr;
    bool areWide = false;
    std::uint8_t* isolated = nullptr;
    std::uint8_t* nonfinite = nullptr;

    bool wantsRows() const
    {
        return density || meanDistance || nearestDistance || normal || eigenvalues || stretch ||
               !averages.empty();
    }
    bool wantsClusters() const { return cluster || clusterSize; }
};

class MeasureResults {
public:
    // Blocks that results may be in; those that nobody else holds are taken first.
    using Memory = std::vector<std::shared_ptr<PageBlock>>;

    // Of so many queries among so many candidates. Throws InvalidInput for an attribute that is not there.
    MeasureResults(const std::vector<Measure>& measures, const MeasureOptions& options, std::uint64_t queries,
                   std::uint64_t candidates, Memory& memory);

    const MeasureTargets& targets() const { return mTargets; }
    PointValues take() { return std::move(mValues); }

private:
    enum class Fill { kNone, kZeros };

    void* add(const std::string& name, AttributeType type, Fill fill = Fill::kZeros);
    std::uint8_t* addGroup(const std::string& name);
    void addOne(const Measure& measure, const MeasureOptions& options);

    std::shared_ptr<void> block(std::uint64_t bytes, Fill fill);

    std::uint64_t mQueries;
    Memory& mMemory;
    Memory mFree; // of the memory
    PointValues mValues;
    MeasureTargets mTargets;
};

// Writes an integer of 32 or 64 bits.
inline void putInteger(void* out, bool isWide, std::size_t at, std::int64_t value)
{
    if (isWide) {
        static_cast<std::int64_t*>(out)[at] = value;
    } else {
        static_cast<std::int32_t*>(out)[at] = static_cast<std::int32_t>(value);
    }
}

} // namespace vdb_nns
