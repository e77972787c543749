// Random numbers of the scenes: a function of (seed, stream, index), so that any thread can make any particle, and the
// functions around them that libraries round differently. Only integers, + - * / and sqrt: the same bits everywhere
// (compile with -ffp-contract=off). Knows nothing of scenes.
#pragma once

#include <cmath>
#include <cstdint>

namespace vdb_nns::scenes {

// The finaliser of SplitMix64 (Steele, Lea, Flood: Fast Splittable Pseudorandom Number Generators, 2014).
inline std::uint64_t mix64(std::uint64_t z)
{
    z = (z ^ (z >> 30)) * 0xbf58476d1ce4e5b9ULL;
    z = (z ^ (z >> 27)) * 0x94d049bb133111ebULL;
    return z ^ (z >> 31);
}

// One stream of numbers. bits(0), bits(1), ... are SplitMix64 started from a hash of seed and stream.
class Random {
public:
    Random(std::uint64_t seed, std::uint64_t stream)
        : mKey(mix64(mix64(seed * kGamma + 1) ^ (stream * 0xd1342543de82ef95ULL + kGamma)))
    {
    }

    std::uint64_t bits(std::uint64_t index) const { return mix64(mKey + (index + 1) * kGamma); }

    // Uniform in [0, 1), a multiple of 2^-53.
    double uniform(std::uint64_t index) const { return static_cast<double>(bits(index) >> 11) * 0x1p-53; }

    double uniform(std::uint64_t index, double low, double high) const
    {
        return low + (high - low) * uniform(index);
    }

    // Mean 0, variance 1, nearly normal, within +-6: the sum of twelve 16-bit uniforms (Irwin-Hall).
    double normal(std::uint64_t index) const
    {
        std::uint64_t sum = 0;
        for (std::uint64_t k = 0; k < 3; ++k) {
            const std::uint64_t word = bits(3 * index + k);
            for (int shift = 0; shift < 64; shift += 16) sum += (word >> shift) & 0xffff;
        }
        return (static_cast<double>(sum) + 6.0) * 0x1p-16 - 6.0;
    }

private:
    static constexpr std::uint64_t kGamma = 0x9e3779b97f4a7c15ULL; // 2^64 / golden ratio, odd
    std::uint64_t mKey;
};

// e^x for |x| < 700, relative error under 1e-15: 2^k * Taylor series on |r| <= ln(2)/2.
inline double exponential(double x)
{
    const double k = std::floor(x * 1.4426950408889634 + 0.5);
    const double r = (x - k * 0.693147180369123816490) - k * 1.90821492927058770002e-10;
    double term = 1, sum = 1;
    for (int n = 1; n <= 14; ++n) {
        term *= r / n;
        sum += term;
    }
    return std::ldexp(sum, static_cast<int>(k));
}

// A smooth wave of period 1 and amplitude 1, two parabolas in place of a sine.
inline double wave(double t)
{
    const double s = 2 * (t - std::floor(t)) - 1; // [-1, 1)
    return 4 * s * (1 - std::fabs(s));
}

} // namespace vdb_nns::scenes
