// Brute force in exact arithmetic; see oracle.h.
#include "oracle.h"

#include <boost/multiprecision/cpp_bin_float.hpp>
#include <boost/multiprecision/cpp_int.hpp>

#include <cmath>
#include <limits>

namespace vdb_nns::testing {

namespace {

using boost::multiprecision::cpp_int;

// x * 2^1074, an integer for every finite double: 2^-1074 is the smallest one.
constexpr int kShift = 1074;

cpp_int fixedPoint(double x)
{
    int exponent = 0;
    const double fraction = std::frexp(x, &exponent); // x = fraction * 2^exponent
    const auto mantissa = static_cast<std::int64_t>(std::ldexp(fraction, 53));
    const int shift = exponent - 53 + kShift;
    const cpp_int magnitude = mantissa < 0 ? -mantissa : mantissa;
    // A denormal's mantissa has zeros where shift is negative: nothing is lost.
    const cpp_int shifted = shift >= 0 ? cpp_int(magnitude << shift) : cpp_int(magnitude >> -shift);
    return mantissa < 0 ? cpp_int(-shifted) : shifted;
}

// Squared distance * 2^(4 * 1074).
cpp_int squaredDistance(const ExactPoint& a, const ExactPoint& b, const Linear& linear)
{
    cpp_int difference[3];
    for (std::size_t k = 0; k < 3; ++k) {
        difference[k] =
            (cpp_int(b.voxel[k] - a.voxel[k]) << kShift) + fixedPoint(b.offset[k]) - fixedPoint(a.offset[k]);
    }
    cpp_int sum = 0;
    for (const auto& row : linear) {
        cpp_int component = 0;
        for (std::size_t c = 0; c < 3; ++c) component += fixedPoint(row[c]) * difference[c];
        sum += component * component;
    }
    return sum;
}

enum class Verdict { kIn, kOut, kUnclear };

// Plain double arithmetic. Each operation errs by at most 2^-53 of a term, or 2^-1074; the margin is 1e-6 of the sum of
// all terms, 10^9 times as much.
Verdict clearCase(const ExactPoint& a, const ExactPoint& b, const Linear& linear, double radius)
{
    double component[3] = {0, 0, 0}, terms = radius;
    for (std::size_t c = 0; c < 3; ++c) {
        const auto voxels = static_cast<double>(b.voxel[c] - a.voxel[c]);
        const double offset = b.offset[c] - a.offset[c];
        for (std::size_t k = 0; k < 3; ++k) {
            component[k] += linear[k][c] * (voxels + offset);
            terms += std::fabs(linear[k][c]) * (std::fabs(voxels) + std::fabs(offset));
        }
    }
    const double distance = std::hypot(component[0], component[1], component[2]);
    const double margin = 1e-6 * terms;
    if (!(terms > 1e-290 && terms < 1e290)) return Verdict::kUnclear;
    if (distance < radius - margin) return Verdict::kIn;
    return distance > radius + margin ? Verdict::kOut : Verdict::kUnclear;
}

} // namespace

bool isFinite(const ExactPoint& point)
{
    return std::isfinite(point.offset[0]) && std::isfinite(point.offset[1]) && std::isfinite(point.offset[2]);
}

bool withinExactly(const ExactPoint& a, const ExactPoint& b, const Linear& linear, double radius)
{
    const cpp_int limit = fixedPoint(radius) << kShift; // radius * 2^(2 * 1074)
    return squaredDistance(a, b, linear) <= limit * limit;
}

Lists oracleLists(const PointSet& set)
{
    Lists lists(set.points.size());
    for (std::size_t i = 0; i < set.points.size(); ++i) {
        if (!isFinite(set.points[i])) continue;
        for (std::size_t j = i + 1; j < set.points.size(); ++j) {
            const ExactPoint &a = set.points[i], &b = set.points[j];
            if (!isFinite(b)) continue;
            const Verdict verdict = clearCase(a, b, set.linear, set.radius);
            const bool within = verdict == Verdict::kUnclear ? withinExactly(a, b, set.linear, set.radius)
                                                             : verdict == Verdict::kIn;
            if (!within) continue;
            lists[i].push_back(static_cast<std::uint32_t>(j));
            lists[j].push_back(static_cast<std::uint32_t>(i)); // i ascends, so row j stays sorted
        }
    }
    return lists;
}

PairReport describePair(const PointSet& set, std::size_t i, std::size_t j)
{
    const ExactPoint &a = set.points[i], &b = set.points[j];
    constexpr double kNaN = std::numeric_limits<double>::quiet_NaN();
    if (!isFinite(a) || !isFinite(b)) return {kNaN, kNaN};
    using Float = boost::multiprecision::cpp_bin_float_100;
    const Float distance = ldexp(sqrt(Float(squaredDistance(a, b, set.linear))), -2 * kShift);
    const double ulp = std::nextafter(set.radius, HUGE_VAL) - set.radius;
    return {distance.convert_to<double>(), Float((distance - set.radius) / ulp).convert_to<double>()};
}

} // namespace vdb_nns::testing
