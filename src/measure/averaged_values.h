// Attributes of the candidates as kernels read them. Knows nothing of neighbors.
#pragma once

#include "measure/chunks.h"
#include "measure/row_batch.h"
#include "util/cancel.h"
#include "util/ieee_mode.h"
#include "util/memory.h"
#include "vdb_nns/point_values.h"

#include <algorithm>
#include <atomic>
#include <cmath>
#include <cstddef>
#include <cstdint>

namespace vdb_nns {

// The numbers of an attribute as kernels read them, and which of its values are finite.
class AveragedValues {
public:
    AveragedValues(const PointAttribute& attribute, const CancelCheck& cancel)
        : mCount(static_cast<std::size_t>(attribute.count)), mCancel(cancel)
    {
        mView.isVector = attributeWidth(attribute.type) == 3;
        const void* const from = attribute.values.get();
        switch (attribute.type) {
        case AttributeType::kFloat:
        case AttributeType::kVec3s:
            read<float>(static_cast<const float*>(from));
            break;
        case AttributeType::kDouble:
        case AttributeType::kVec3d:
            read<double>(static_cast<const double*>(from));
            break;
        case AttributeType::kInt32:
            read<double>(static_cast<const std::int32_t*>(from));
            break;
        case AttributeType::kInt64:
            read<double>(static_cast<const std::int64_t*>(from));
            break;
        case AttributeType::kMat3s:
            break; // averageType() refuses it
        }
    }

    AveragedAttribute view() const { return mView; }
    std::uint64_t skipped() const { return mSkipped; }

private:
    template <typename To, typename From>
    void read(const From* from)
    {
        const std::size_t width = mView.isVector ? 3 : 1, step = mView.isVector ? 4 : 1;
        mView.isDouble = sizeof(To) == sizeof(double);
        mValues.resizeDiscarding(mCount * step * sizeof(To));
        To* const to = reinterpret_cast<To*>(mValues.data());
        // Zeros where one of its numbers is not finite. Returns whether all are.
        const auto copyValue = [=](std::size_t i) {
            bool isFinite = true;
            for (std::size_t c = 0; c < width; ++c) {
                to[step * i + c] = static_cast<To>(from[width * i + c]);
                isFinite &= std::isfinite(to[step * i + c]);
            }
            for (std::size_t c = isFinite ? width : 0; c < step; ++c) to[step * i + c] = 0;
            return isFinite;
        };
        std::atomic<std::uint64_t> skipped{0};
        std::atomic<double> largest{0};
        forEachChunk(mCount, mCancel, [&](std::size_t begin, std::size_t end) {
            std::uint64_t bad = 0;
            for (std::size_t i = begin; i < end; ++i) bad += !copyValue(i);
            skipped += bad;
            double most = 0, seen = largest;
            for (std::size_t k = step * begin; k < step * end; ++k)
                most = std::max(most, std::fabs(static_cast<double>(to[k])));
            while (most > seen && !largest.compare_exchange_weak(seen, most)) {
            }
        });
        mSkipped = skipped;
        mView.values = to;
        if (mSkipped > 0) markValid(copyValue);
        mView.unit = unitOf(largest);
        if (mView.unit == 1) return;
        forEachChunk(mCount, mCancel, [&](std::size_t begin, std::size_t end) {
            for (std::size_t k = step * begin; k < step * end; ++k)
                to[k] = static_cast<To>(static_cast<double>(to[k]) / mView.unit);
        });
    }

    // Sums of numbers near the largest would pass the range of doubles, and those near the smallest are below what sums resolve
    // (kernels/cpu/measure_rows.h). A power of two.
    static double unitOf(double largest)
    {
        const IeeeMode mode;
        if (largest >= 0x1p960) return 0x1p64;
        return largest > 0 && largest < 0x1p-600 ? 0x1p-400 : 1;
    }

    template <typename CopyValue>
    void markValid(const CopyValue& copyValue)
    {
        mValid.resizeDiscarding(mCount);
        forEachChunk(mCount, mCancel, [&](std::size_t begin, std::size_t end) {
            for (std::size_t i = begin; i < end; ++i) mValid[i] = copyValue(i) ? 1 : 0;
        });
        mView.valid = mValid.data();
    }

    const std::size_t mCount;
    const CancelCheck& mCancel;
    PageArray<char> mValues;
    PageArray<double> mValid;
    AveragedAttribute mView;
    std::uint64_t mSkipped = 0;
};

} // namespace vdb_nns
