// What measures of rows and of whole leaves have in common: constants of the smoothing kernels, and when sums at a scale that is known
// before their terms are good enough.
#pragma once

#include "cpu/measure_rows.h"
#include "vdb_nns/measure.h"

#include <cstdint>

namespace vdb_nns {

// Sums at a scale for the greatest terms that there can be have errors of up to 2^-50 of those a term. They are good enough where the
// mean term is this share of the greatest: then 2^-46 of the largest term of the row is lost a term; of moments, which sum up three
// products, 2^-44. Other sums are made again, at a scale of their own.
constexpr double kLeastMean = 1.0 / 16, kLeastMoment = kLeastMean / 4;
constexpr std::uint32_t kMostAtOnce = 4088; // pairs: with more the integers would have fewer bits

inline double cube(double x)
{
    return x * x * x;
}

inline PairWeight weightOf(SmoothingKernel kernel)
{
    switch (kernel) {
    case SmoothingKernel::kCubic:
        return PairWeight::kCubic;
    case SmoothingKernel::kWendland2:
        return PairWeight::kWendland2;
    case SmoothingKernel::kPoly6:
        return PairWeight::kPoly6;
    case SmoothingKernel::kTophat:
        break;
    }
    return PairWeight::kTophat;
}

// W(0) of a support of 1.
inline double weightAtZero(SmoothingKernel kernel)
{
    constexpr double kPi = 3.14159265358979323846;
    switch (kernel) {
    case SmoothingKernel::kCubic:
        return 8 / kPi;
    case SmoothingKernel::kWendland2:
        return 21 / (2 * kPi);
    case SmoothingKernel::kPoly6:
        return 315 / (64 * kPi);
    case SmoothingKernel::kTophat:
        break;
    }
    return 3 / (4 * kPi);
}

// W(0).
inline double weightAtZero(SmoothingKernel kernel, double radius)
{
    return weightAtZero(kernel) / cube(radius);
}

// Whether the sum of so many distances up to the radius is good enough.
inline bool isMeanPrecise(double sum, double radius, std::uint32_t count)
{
    return count <= kMostAtOnce && sum >= kLeastMean * radius * count;
}

} // namespace vdb_nns
