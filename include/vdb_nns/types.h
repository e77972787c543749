// Plain value types of the public API. Knows nothing but the standard library.
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>

namespace vdb_nns {

using Vec3d = std::array<double, 3>;
using Vec3i = std::array<std::int32_t, 3>;

/// Row-major 3x3 matrix for column vectors: y_k = sum_c m[k][c] * x_c.
using Matrix3 = std::array<std::array<double, 3>, 3>;

/// Row-major 4x4 affine matrix for column vectors; the last row is 0 0 0 1.
using Matrix4 = std::array<std::array<double, 4>, 4>;

/// A view of `size()` contiguous values that somebody else owns.
template <typename T>
class Span {
public:
    constexpr Span() = default;
    constexpr Span(T* data, std::size_t size) : mData(data), mSize(size) {}

    constexpr T* data() const { return mData; }
    constexpr std::size_t size() const { return mSize; }
    constexpr bool empty() const { return mSize == 0; }
    constexpr T* begin() const { return mData; }
    constexpr T* end() const { return mData + mSize; }
    constexpr T& operator[](std::size_t i) const { return mData[i]; }

private:
    T* mData = nullptr;
    std::size_t mSize = 0;
};

} // namespace vdb_nns
