#include "bench/stability/value_ranges.h"

#include "report.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>
#include <limits>
#include <map>
#include <vector>

namespace vdb_nns::cli {
namespace {

constexpr double kRounding = 1e-6; // of lengths and products of a few floats

const PointAttribute* attributeNamed(const Measured& made, const char* name)
{
    for (const PointAttribute& attribute : made.values.attributes) {
        if (attribute.name == name) return &attribute;
    }
    return nullptr;
}

const std::uint8_t* membersOf(const Measured& made, const char* name)
{
    for (const PointGroup& group : made.values.groups) {
        if (group.name == name) return group.members.get();
    }
    return nullptr;
}

template <typename Number>
const Number* numbersOf(const Measured& made, const char* name)
{
    const PointAttribute* const attribute = attributeNamed(made, name);
    return attribute ? static_cast<const Number*>(attribute->values.get()) : nullptr;
}

bool isFinite(const Vec3d& at)
{
    return std::isfinite(at[0]) && std::isfinite(at[1]) && std::isfinite(at[2]);
}

class RangeCheck {
public:
    RangeCheck(const SetSearch& search, const MeasureOptions& options, const Measured& made,
               bool mayPassRange)
        : mSearch(search), mOptions(options), mMade(made), mMayPassRange(mayPassRange)
    {
    }

    RangeFaults run()
    {
        checkCounts();
        checkDistances();
        checkNearest();
        checkSizes("density", 1);
        checkSizes("eigenvalues", 3);
        for (const PointAttribute& attribute : mMade.values.attributes) {
            if (attribute.name.compare(0, 8, "average:") == 0) checkAverage(attribute);
        }
        checkNormals();
        checkEllipsoids();
        checkPositions();
        checkClusters();
        return mFaults;
    }

private:
    std::size_t queryCount() const { return mSearch.queries.view.size(); }

    void require(bool holds, std::size_t query, const std::string& what)
    {
        if (holds) return;
        if (mFaults.count++ == 0) mFaults.first = what + ", particle " + std::to_string(query);
    }

    bool isLegal(double value) const { return std::isfinite(value) || (mMayPassRange && std::isinf(value)); }

    // Those of the lists, which the trial of pairs checks, and the groups that follow.
    void checkCounts()
    {
        const auto* const count = numbersOf<std::int32_t>(mMade, "count");
        const std::uint8_t *const isolated = membersOf(mMade, "isolated"), *const nonfinite =
                                                                               membersOf(mMade, "nonfinite");
        if (!count) return;
        for (std::size_t i = 0; i < queryCount(); ++i) {
            require(count[i] >= 0 && mMade.counts.count(i) == static_cast<std::uint32_t>(count[i]), i,
                    "count is not that of the search");
            if (isolated) require(!isolated[i] || count[i] == 0, i, "isolated has neighbors");
            if (nonfinite) require(!nonfinite[i] || count[i] == 0, i, "nonfinite has neighbors");
        }
    }

    void checkDistances()
    {
        const auto* const count = numbersOf<std::int32_t>(mMade, "count");
        const auto* const mean = numbersOf<float>(mMade, "mean_distance");
        const auto* const nearest = numbersOf<float>(mMade, "nearest_distance");
        if (!count || !mean || !nearest) return;
        constexpr float kInfinity = std::numeric_limits<float>::infinity();
        for (std::size_t i = 0; i < queryCount(); ++i) {
            if (count[i] == 0) {
                require(mean[i] == -1 && nearest[i] == -1, i, "distance without neighbors is not -1");
                continue;
            }
            require(nearest[i] >= 0 && isLegal(static_cast<double>(nearest[i])), i,
                    format("nearest_distance is %g", static_cast<double>(nearest[i])));
            // The mean of equal distances may be rounded to the float below.
            require(std::nextafter(mean[i], kInfinity) >= nearest[i] && isLegal(static_cast<double>(mean[i])),
                    i,
                    format("mean_distance is %g, nearest_distance %g", static_cast<double>(mean[i]),
                           static_cast<double>(nearest[i])));
        }
    }

    void checkNearest()
    {
        const auto* const count = numbersOf<std::int32_t>(mMade, "count");
        const auto* const nearest = numbersOf<std::int32_t>(mMade, "nearest");
        if (!count || !nearest) return;
        const std::size_t candidates = mSearch.candidates.view.size();
        for (std::size_t i = 0; i < queryCount(); ++i) {
            const bool isNone = nearest[i] == -1;
            require(isNone ? count[i] == 0
                           : nearest[i] >= 0 && static_cast<std::size_t>(nearest[i]) < candidates,
                    i, format("nearest is %d", nearest[i]));
            require(!mSearch.isOneSet() || isNone || static_cast<std::size_t>(nearest[i]) != i, i,
                    "nearest is the particle itself");
        }
    }

    // Not negative, and of several numbers the largest first.
    void checkSizes(const char* name, std::size_t width)
    {
        const auto* const values = numbersOf<float>(mMade, name);
        if (!values) return;
        for (std::size_t i = 0; i < queryCount(); ++i) {
            for (std::size_t k = 0; k < width; ++k) {
                const auto value = static_cast<double>(values[width * i + k]);
                require(value >= 0 && isLegal(value), i, format("%s is %g", name, value));
                require(k == 0 || value <= static_cast<double>(values[width * i + k - 1]), i,
                        format("%s are not descending", name));
            }
        }
    }

    // No larger than the values that it is made of.
    void checkAverage(const PointAttribute& average)
    {
        const std::string source = average.name.substr(8);
        for (const PointAttribute& attribute : mOptions.attributes) {
            if (attribute.name != source) continue;
            const double largest = largestOf(attribute);
            const std::size_t width = attributeWidth(average.type);
            for (std::size_t k = 0; k < width * queryCount(); ++k) {
                const double value = numberOf(average, k);
                require(std::isfinite(value) && std::fabs(value) / (1 + kRounding) <= largest, k / width,
                        format("%s is %g", average.name.c_str(), value));
            }
        }
    }

    static double numberOf(const PointAttribute& attribute, std::size_t k)
    {
        const void* const values = attribute.values.get();
        switch (attribute.type) {
        case AttributeType::kDouble:
        case AttributeType::kVec3d:
            return static_cast<const double*>(values)[k];
        case AttributeType::kInt32:
            return static_cast<const std::int32_t*>(values)[k];
        default:
            return static_cast<double>(static_cast<const float*>(values)[k]);
        }
    }

    static double largestOf(const PointAttribute& attribute)
    {
        double largest = 0;
        for (std::size_t k = 0; k < attributeWidth(attribute.type) * attribute.count; ++k) {
            const double value = std::fabs(numberOf(attribute, k));
            if (std::isfinite(value)) largest = std::max(largest, value);
        }
        return largest;
    }

    void checkNormals()
    {
        const auto* const normal = numbersOf<float>(mMade, "normal");
        if (!normal) return;
        for (std::size_t i = 0; i < queryCount(); ++i) {
            const float* const n = normal + 3 * i;
            const double length = std::hypot(n[0], n[1], n[2]);
            require(length == 0 || std::fabs(length - 1) <= kRounding, i,
                    format("normal has length %g", length));
        }
    }

    void checkEllipsoids()
    {
        const auto *const stretch = numbersOf<float>(mMade, "stretch"), *const xform =
                                                                            numbersOf<float>(mMade, "xform");
        const std::uint8_t* const ellipsoids = membersOf(mMade, "ellipsoids");
        if (!stretch || !xform || !ellipsoids) return;
        for (std::size_t i = 0; i < queryCount(); ++i) {
            checkStretch(i, stretch + 3 * i, ellipsoids[i] != 0);
            checkRotation(i, xform + 9 * i);
        }
    }

    void checkStretch(std::size_t i, const float* stretch, bool isEllipsoid)
    {
        const Vec3d s = {static_cast<double>(stretch[0]), static_cast<double>(stretch[1]),
                         static_cast<double>(stretch[2])};
        const PcaOptions& pca = mOptions.pca;
        if (!isEllipsoid) {
            const auto ball = static_cast<double>(static_cast<float>(pca.stretch));
            return require(s == Vec3d{ball, ball, ball}, i, "stretch of no ellipsoid is not that of balls");
        }
        require(pca.threshold > 0, i, "an ellipsoid where there are none");
        require(std::fabs(s[0] * s[1] * s[2] - 1) <= kRounding, i,
                format("stretch has product %g", s[0] * s[1] * s[2]));
        const double least = pca.anisotropy * s[0] * (1 - kRounding);
        require(s[0] >= s[1] && s[0] >= s[2] && s[1] >= least && s[2] >= least, i,
                format("stretch is %g, %g, %g", s[0], s[1], s[2]));
    }

    void checkRotation(std::size_t i, const float* m)
    {
        std::array<Vec3d, 3> column{};
        for (std::size_t k = 0; k < 9; ++k) column[k % 3][k / 3] = static_cast<double>(m[k]);
        for (std::size_t a = 0; a < 3; ++a) {
            const Vec3d &u = column[(a + 1) % 3], &v = column[(a + 2) % 3];
            const double length = std::hypot(column[a][0], column[a][1], column[a][2]);
            require(std::fabs(length - 1) <= kRounding, i, format("an axis of xform has length %g", length));
            for (std::size_t k = 0; k < 3; ++k) {
                const double cross = u[(k + 1) % 3] * v[(k + 2) % 3] - u[(k + 2) % 3] * v[(k + 1) % 3];
                require(std::fabs(cross - column[a][k]) <= kRounding, i, "xform is no rotation");
            }
        }
    }

    void checkPositions()
    {
        const auto* const pws = numbersOf<double>(mMade, "pws");
        if (!pws) return;
        for (std::size_t i = 0; i < queryCount(); ++i) {
            const Vec3d at = {pws[3 * i], pws[3 * i + 1], pws[3 * i + 2]};
            if (isFinite(mSearch.queries.view.worldPosition(i)))
                require(isFinite(at), i, "pws is not finite");
        }
    }

    // Labels without gaps, each as often as its size says.
    void checkClusters()
    {
        const auto* const label = numbersOf<std::int32_t>(mMade, "cluster");
        const auto* const size = numbersOf<std::int32_t>(mMade, "cluster_size");
        if (!label || !size) return;
        std::map<std::int32_t, std::int32_t> points;
        for (std::size_t i = 0; i < queryCount(); ++i) ++points[label[i]];
        const auto leavesGap = [&](std::int32_t l) { return l > 0 && points.count(l - 1) == 0; };
        for (std::size_t i = 0; i < queryCount(); ++i) {
            require(label[i] >= -1 && !leavesGap(label[i]), i, format("cluster is %d", label[i]));
            require(size[i] == (label[i] < 0 ? 0 : points[label[i]]), i,
                    format("cluster_size is %d", size[i]));
        }
    }

    const SetSearch& mSearch;
    const MeasureOptions& mOptions;
    const Measured& mMade;
    const bool mMayPassRange;
    RangeFaults mFaults;
};

} // namespace

RangeFaults findRangeFaults(const SetSearch& search, const MeasureOptions& options, const Measured& made,
                            bool mayPassRange)
{
    return RangeCheck(search, options, made, mayPassRange).run();
}

} // namespace vdb_nns::cli
