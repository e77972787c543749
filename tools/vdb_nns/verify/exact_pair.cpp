// A finite double is an integer times a power of two; sums and products of such numbers stay such
// numbers, so integers of any length decide.
#include "exact_pair.h"

#include <boost/multiprecision/cpp_bin_float.hpp>
#include <boost/multiprecision/cpp_int.hpp>

#include <algorithm>
#include <cmath>

namespace vdb_nns::cli {

namespace {

using boost::multiprecision::cpp_int;

// mantissa * 2^exponent
struct Dyadic {
    cpp_int mantissa;
    int exponent = 0;
};

Dyadic dyadic(double x)
{
    if (x == 0) return {};
    int exponent = 0;
    auto mantissa = static_cast<std::int64_t>(std::ldexp(std::frexp(x, &exponent), 53));
    exponent -= 53;
    for (; mantissa % 2 == 0; mantissa /= 2) ++exponent; // short mantissas keep the products short
    return {mantissa, exponent};
}

Dyadic operator+(const Dyadic& a, const Dyadic& b)
{
    if (a.mantissa == 0) return b;
    if (b.mantissa == 0) return a;
    const int exponent = std::min(a.exponent, b.exponent);
    return {(a.mantissa << (a.exponent - exponent)) + (b.mantissa << (b.exponent - exponent)), exponent};
}

Dyadic operator*(const Dyadic& a, const Dyadic& b)
{
    return {a.mantissa * b.mantissa, a.exponent + b.exponent};
}

Dyadic squaredDistance(const StoredPoint& a, const StoredPoint& b, const Matrix3& linear)
{
    Dyadic difference[3];
    for (std::size_t k = 0; k < 3; ++k) {
        difference[k] = Dyadic{b.voxel[k] - a.voxel[k], 0} + dyadic(b.offset[k]) + dyadic(-a.offset[k]);
    }
    Dyadic sum;
    for (const auto& row : linear) {
        Dyadic component;
        for (std::size_t c = 0; c < 3; ++c) component = component + dyadic(row[c]) * difference[c];
        sum = sum + component * component;
    }
    return sum;
}

} // namespace

bool withinRadius(const StoredPoint& a, const StoredPoint& b, const Matrix3& linear, double radius)
{
    const Dyadic limit = dyadic(radius), square = limit * limit;
    Dyadic excess = squaredDistance(a, b, linear);
    excess.mantissa = -excess.mantissa;
    return (square + excess).mantissa >= 0;
}

PairDistance describeDistance(const StoredPoint& a, const StoredPoint& b, const Matrix3& linear,
                              double radius)
{
    using Float = boost::multiprecision::cpp_bin_float_50;
    const Dyadic square = squaredDistance(a, b, linear);
    const Float distance = sqrt(ldexp(Float(square.mantissa), square.exponent));
    const double ulp = std::nextafter(radius, HUGE_VAL) - radius;
    return {distance.convert_to<double>(), Float((distance - radius) / ulp).convert_to<double>()};
}

} // namespace vdb_nns::cli
