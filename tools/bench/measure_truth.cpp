#include "bench/measure_truth.h"

#include "vdb_nns/measure.h"
#include "verify/expected_values.h"
#include "verify/neighborhood.h"
#include "verify/search_judge.h"

#include <tbb/blocked_range.h>
#include <tbb/parallel_for.h>

#include <algorithm>
#include <cmath>
#include <cstddef>

namespace vdb_nns::cli {
namespace {

constexpr double kDegrees = 180 / 3.14159265358979323846;

Vec3d rounded(const Real* value)
{
    return {static_cast<double>(value[0]), static_cast<double>(value[1]), static_cast<double>(value[2])};
}

double largestOf(const std::array<Real, 9>& bound)
{
    return static_cast<double>(std::max({bound[0], bound[1], bound[2]}));
}

TrueMeasures measuresOf(const Neighborhood& near)
{
    const MeasureOptions options;
    TrueMeasures result;
    result.query = near.query;
    const ExpectedValue density = expectedDensity(near, options);
    result.density = static_cast<double>(density.value[0]);
    result.densityBound = static_cast<double>(density.bound[0]);
    const ExpectedValue normal = expectedNormal(near, options);
    result.normal = rounded(normal.value.data());
    result.normalBound = largestOf(normal.bound);
    result.hasNormal = normal.isDetermined;
    const ExpectedPca pca = expectedPca(near, options.pca);
    result.isEllipsoid = pca.isEllipsoid;
    result.hasStretch = pca.isEllipsoid && pca.stretch.isDetermined;
    if (!result.hasStretch) return result;
    result.stretch = rounded(pca.stretch.value.data());
    result.stretchBound = largestOf(pca.stretch.bound);
    result.axis = rounded(pca.axes[0].data());
    if (pca.axisBound[0]) result.axisBound = static_cast<double>(*pca.axisBound[0]);
    result.hasAxis =
        pca.axisBound[0].has_value() && result.stretch[1] <= TrueMeasures::kMostSecond * result.stretch[0];
    return result;
}

Vec3d vectorAt(const float* values, std::size_t i)
{
    const float* const v = values + 3 * i;
    return {v[0], v[1], v[2]};
}

double dot(const Vec3d& a, const Vec3d& b)
{
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
}

// Of two that are not 0, in degrees; as exact for small angles as for others.
double angle(const Vec3d& a, const Vec3d& b)
{
    const Vec3d cross{a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]};
    return std::atan2(std::sqrt(dot(cross, cross)), dot(a, b)) * kDegrees;
}

double largestDifference(const Vec3d& a, const Vec3d& b)
{
    return std::max({std::fabs(a[0] - b[0]), std::fabs(a[1] - b[1]), std::fabs(a[2] - b[2])});
}

bool isFinite(const Vec3d& v)
{
    return std::isfinite(v[0]) && std::isfinite(v[1]) && std::isfinite(v[2]);
}

// What rounding to a float changes, denormal or not.
double floatRounding(double value)
{
    return 0x1p-23 * std::fabs(value) + 0x1p-148;
}

class ErrorsOfMeasure {
public:
    ErrorsOfMeasure(const std::string& measure, const MeasureValues& values)
        : mMeasure(measure), mValues(values)
    {
    }

    void add(const TrueMeasures& truth)
    {
        if (mMeasure == "density") {
            addDensity(truth);
        } else if (mMeasure == "normal") {
            addNormal(truth);
        } else {
            addEllipsoid(truth);
        }
    }

    MeasureErrors summary()
    {
        mErrors.value = summarizeErrors(mErrorOfValue);
        if (mMeasure == "pca") mErrors.axis = summarizeErrors(mErrorOfAxis);
        return mErrors;
    }

private:
    void addDensity(const TrueMeasures& truth)
    {
        const double density = mValues.density[truth.query], off = std::fabs(density - truth.density);
        if (!std::isfinite(density)) { // beyond the range of floats it is infinite
            const bool isRight = density > 0 && !std::isfinite(static_cast<float>(truth.density));
            mErrors.oneSided += isRight ? 0 : 1;
            return;
        }
        mErrors.wrong += off > truth.densityBound + floatRounding(truth.density);
        if (truth.density > 0) mErrorOfValue.push_back(off / truth.density);
    }

    void addNormal(const TrueMeasures& truth)
    {
        if (!truth.hasNormal) return;
        const Vec3d normal = vectorAt(mValues.normal, truth.query);
        const bool isThere = isFinite(normal) && dot(normal, normal) > 0;
        const bool isTrue = dot(truth.normal, truth.normal) > 0;
        mErrors.oneSided += isThere != isTrue;
        if (!isThere || !isTrue) return;
        mErrorOfValue.push_back(angle(normal, truth.normal));
        mErrors.wrong += largestDifference(normal, truth.normal) > truth.normalBound + floatRounding(1);
    }

    void addEllipsoid(const TrueMeasures& truth)
    {
        const Vec3d stretch = vectorAt(mValues.stretch, truth.query);
        const bool isThere = mValues.ellipsoids[truth.query] != 0 && isFinite(stretch);
        mErrors.oneSided += isThere != truth.isEllipsoid;
        if (!isThere || !truth.hasStretch) return;
        const double off = largestDifference(stretch, truth.stretch), largest = truth.stretch[0];
        mErrorOfValue.push_back(off / largest);
        const bool isStretchWrong = off > truth.stretchBound + floatRounding(largest);
        mErrors.wrong += isStretchWrong;
        if (!truth.hasAxis) return;
        const float* const xform = mValues.xform + 9 * static_cast<std::size_t>(truth.query);
        Vec3d axis{xform[0], xform[3], xform[6]};
        if (dot(axis, truth.axis) < 0) { // an axis has no sign
            for (double& component : axis) component = -component;
        }
        mErrorOfAxis.push_back(angle(axis, truth.axis));
        const bool isAxisWrong = largestDifference(axis, truth.axis) > truth.axisBound + floatRounding(1);
        mErrors.wrong += isAxisWrong && !isStretchWrong;
    }

    const std::string mMeasure;
    const MeasureValues mValues;
    MeasureErrors mErrors;
    std::vector<double> mErrorOfValue, mErrorOfAxis;
};

} // namespace

std::vector<TrueMeasures> trueMeasures(const ParticleView& view, double radius, const Truth& truth)
{
    const SearchTerms terms{ParticleSet(view), ParticleSet(view), {}, {}, radius};
    const SearchJudge judge(terms);
    std::vector<TrueMeasures> all(truth.queries.size());
    std::vector<std::uint8_t> isFiniteQuery(all.size());
    tbb::parallel_for(tbb::blocked_range<std::size_t>(0, all.size(), 64), [&](const auto& range) {
        std::vector<std::uint32_t> row;
        for (std::size_t k = range.begin(); k < range.end(); ++k) {
            isFiniteQuery[k] = judge.isFiniteQuery(truth.queries[k]);
            if (!isFiniteQuery[k]) continue;
            const Span<const std::uint32_t> neighbors = truth.row(k);
            row.assign(neighbors.begin(), neighbors.end());
            all[k] = measuresOf(neighborhoodOf(judge, truth.queries[k], row));
        }
    });
    std::size_t kept = 0;
    for (std::size_t k = 0; k < all.size(); ++k) {
        if (isFiniteQuery[k]) all[kept++] = all[k];
    }
    all.resize(kept);
    return all;
}

ErrorSummary summarizeErrors(std::vector<double>& errors)
{
    ErrorSummary summary;
    summary.compared = errors.size();
    if (errors.empty()) return summary;
    double squares = 0;
    for (const double error : errors) squares += error * error;
    summary.rms = std::sqrt(squares / static_cast<double>(errors.size()));
    summary.max = *std::max_element(errors.begin(), errors.end());
    const std::size_t rank = (99 * errors.size() + 99) / 100 - 1; // 99 of 100 are at most the one there
    const auto place = errors.begin() + static_cast<std::ptrdiff_t>(rank);
    std::nth_element(errors.begin(), place, errors.end());
    summary.p99 = *place;
    return summary;
}

MeasureErrors findMeasureErrors(const std::string& measure, const MeasureValues& values,
                                const std::vector<TrueMeasures>& truth)
{
    ErrorsOfMeasure errors(measure, values);
    for (const TrueMeasures& each : truth) errors.add(each);
    return errors.summary();
}

} // namespace vdb_nns::cli
