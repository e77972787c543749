#include "smoothing.h"

#include <algorithm>

namespace vdb_nns::cli {

namespace {

constexpr Real kPi = 3.14159265358979323846264338327950288L;

// No profile, whose value at 0 is 1, is steeper anywhere than this by q = d / R: cubic 2, Wendland 2.1, poly6 1.8, that of pca 3.
constexpr Real kSteepest = 3;

Real power(Real base, int exponent)
{
    Real result = 1;
    for (int k = 0; k < exponent; ++k) result *= base;
    return result;
}

// W / W(0).
Real profile(SmoothingKernel kernel, Real q)
{
    switch (kernel) {
    case SmoothingKernel::kCubic:
        return q <= 0.5L ? 1 - 6 * power(q, 2) + 6 * power(q, 3) : 2 * power(1 - q, 3);
    case SmoothingKernel::kWendland2:
        return power(1 - q, 4) * (1 + 4 * q);
    case SmoothingKernel::kPoly6:
        return power(1 - q * q, 3);
    case SmoothingKernel::kTophat:
        return 1;
    }
    return 0;
}

// W(0) R^3.
Real height(SmoothingKernel kernel)
{
    switch (kernel) {
    case SmoothingKernel::kCubic:
        return 8 / kPi;
    case SmoothingKernel::kWendland2:
        return 21 / (2 * kPi);
    case SmoothingKernel::kPoly6:
        return 315 / (64 * kPi);
    case SmoothingKernel::kTophat:
        return 3 / (4 * kPi);
    }
    return 0;
}

Real ratio(Real distance, Real radius)
{
    return std::min<Real>(distance / radius, 1);
}

} // namespace

Weight smoothingWeight(SmoothingKernel kernel, Real distance, Real radius, Real distanceError)
{
    const Real most = height(kernel) / power(radius, 3);
    const Real steepest = kernel == SmoothingKernel::kTophat ? 0 : kSteepest * most / radius;
    return {most * profile(kernel, ratio(distance, radius)), most, steepest * distanceError};
}

Weight pcaWeight(Real distance, Real radius, Real distanceError)
{
    return {1 - power(ratio(distance, radius), 3), 1, kSteepest / radius * distanceError};
}

} // namespace vdb_nns::cli
