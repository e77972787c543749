// A finite double is an integer times a power of two; sums and products of such numbers stay such
// numbers, so integers of any length decide.
#include "exact_pair.h"

#include <boost/multiprecision/cpp_bin_float.hpp>

#include <algorithm>
#include <cmath>
#include <limits>

namespace vdb_nns::cli {

namespace {

using boost::multiprecision::cpp_int;

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

Dyadic operator-(const Dyadic& a)
{
    return {-a.mantissa, a.exponent};
}

Dyadic rowTimes(const std::array<double, 3>& row, const Dyadic (&column)[3])
{
    return dyadic(row[0]) * column[0] + dyadic(row[1]) * column[1] + dyadic(row[2]) * column[2];
}

Dyadic squaredNorm(const Dyadic (&v)[3])
{
    return v[0] * v[0] + v[1] * v[1] + v[2] * v[2];
}

// linear * (voxel + offset) + translation
void place(const PlacedPoint& at, Dyadic (&world)[3])
{
    Dyadic stored[3];
    for (std::size_t k = 0; k < 3; ++k) stored[k] = Dyadic{at.point.voxel[k], 0} + dyadic(at.point.offset[k]);
    for (std::size_t k = 0; k < 3; ++k)
        world[k] = rowTimes(at.map->linear[k], stored) + dyadic(at.map->translation[k]);
}

double rounded(const Dyadic& x)
{
    using Float = boost::multiprecision::cpp_bin_float_50;
    return Float(ldexp(Float(x.mantissa), x.exponent)).convert_to<double>();
}

} // namespace

Dyadic squaredDistance(const PlacedPoint& a, const PlacedPoint& b)
{
    Dyadic world[3];
    if (a.map == b.map) {
        Dyadic difference[3];
        for (std::size_t k = 0; k < 3; ++k) {
            difference[k] = Dyadic{b.point.voxel[k] - a.point.voxel[k], 0} + dyadic(b.point.offset[k]) +
                            dyadic(-a.point.offset[k]);
        }
        for (std::size_t k = 0; k < 3; ++k) world[k] = rowTimes(a.map->linear[k], difference);
    } else {
        Dyadic other[3];
        place(b, world);
        place(a, other);
        for (std::size_t k = 0; k < 3; ++k) world[k] = world[k] + -other[k];
    }
    return squaredNorm(world);
}

int compare(const Dyadic& a, const Dyadic& b)
{
    return (a + -b).mantissa.sign();
}

bool withinRadius(const PlacedPoint& a, const PlacedPoint& b, double radius)
{
    const Dyadic limit = dyadic(radius);
    return compare(squaredDistance(a, b), limit * limit) <= 0;
}

bool withinRadius(const StoredPoint& a, const StoredPoint& b, const Matrix3& linear, double radius)
{
    const AffineMap map{linear, {}};
    return withinRadius(PlacedPoint{a, &map}, PlacedPoint{b, &map}, radius);
}

Vec3d worldOffset(const AffineMap& map, const std::int64_t voxel[3], const Vec3d& origin)
{
    Dyadic world[3];
    place({{{voxel[0], voxel[1], voxel[2]}, {0, 0, 0}}, &map}, world);
    Vec3d result;
    for (std::size_t k = 0; k < 3; ++k) result[k] = rounded(world[k] + dyadic(-origin[k]));
    return result;
}

PairDistance describeDistance(const PlacedPoint& a, const PlacedPoint& b, double radius)
{
    using Float = boost::multiprecision::cpp_bin_float_50;
    const Dyadic square = squaredDistance(a, b);
    const Float distance = sqrt(ldexp(Float(square.mantissa), square.exponent));
    if (!(radius > 0 && std::isfinite(radius)))
        return {distance.convert_to<double>(), std::numeric_limits<double>::quiet_NaN()};
    const double ulp = std::nextafter(radius, HUGE_VAL) - radius;
    return {distance.convert_to<double>(), Float((distance - radius) / ulp).convert_to<double>()};
}

PairDistance describeDistance(const StoredPoint& a, const StoredPoint& b, const Matrix3& linear,
                              double radius)
{
    const AffineMap map{linear, {}};
    return describeDistance(PlacedPoint{a, &map}, PlacedPoint{b, &map}, radius);
}

} // namespace vdb_nns::cli
