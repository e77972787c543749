// Numbers m * 2^e with an integer m of any size: what doubles are, and what sums and products of them stay. Slow, a microsecond a
// dozen operations: for the pairs that nothing else decides.
#pragma once

#include <boost/multiprecision/cpp_int.hpp>

#include <cmath>
#include <cstdint>

namespace vdb_nns {

class Dyadic {
public:
    using Integer = boost::multiprecision::cpp_int;

    Dyadic() = default;
    // Finite.
    Dyadic(double value) // NOLINT: a double is one of them
    {
        int exponent = 0;
        const double fraction = std::frexp(value, &exponent);
        mMantissa = static_cast<std::int64_t>(std::ldexp(fraction, 53));
        mExponent = exponent - 53;
    }

    friend Dyadic operator+(Dyadic a, Dyadic b)
    {
        if (a.mMantissa == 0) return b;
        if (b.mMantissa == 0) return a;
        if (a.mExponent < b.mExponent) std::swap(a, b);
        a.mMantissa <<= a.mExponent - b.mExponent;
        b.mMantissa += a.mMantissa;
        return b;
    }
    friend Dyadic operator-(const Dyadic& a, Dyadic b)
    {
        b.mMantissa = -b.mMantissa;
        return a + b;
    }
    friend Dyadic operator*(Dyadic a, const Dyadic& b)
    {
        a.mMantissa *= b.mMantissa;
        a.mExponent += b.mExponent;
        return a;
    }

    // -1, 0 or 1.
    int sign() const { return mMantissa.sign(); }

    // Rounded: within 2^-52 of it relatively, where that is a normal number.
    double toDouble() const
    {
        if (mMantissa == 0) return 0;
        Integer magnitude = abs(mMantissa);
        int exponent = mExponent;
        const auto bits = static_cast<int>(msb(magnitude)) + 1;
        if (bits > 62) {
            magnitude >>= bits - 62;
            exponent += bits - 62;
        }
        const double value = std::ldexp(static_cast<double>(magnitude.convert_to<std::int64_t>()), exponent);
        return mMantissa < 0 ? -value : value;
    }

private:
    Integer mMantissa = 0;
    int mExponent = 0;
};

} // namespace vdb_nns
