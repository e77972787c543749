// What a measure of a neighborhood should be, by the formulas of measure.h, each with a bound of what doubles may make of it.
// Shares nothing with the engine.
//
// The bound of a sum of n terms, each a weight times a coefficient, is the sum of what the errors of the distances do to each
// term, and n (2^-46 + n 2^-60) times the largest W(0) |coefficient|, of vectors that of their largest component. The
// evaluation of a weight in doubles takes a few units of 2^-53 of W(0), the engine's integers 2^-50 of the largest term, or
// 2^-61 n of it beyond 4088 neighbors, which is far less; those of mean distances may take all of it, those of moments, which have a
// factor of four, too. What follows from sums, quotients,
// means and eigenvalues, has the bound that follows to the first order, with a factor of two.
#pragma once

#include "neighborhood.h"
#include "vdb_nns/measure.h"

#include <array>
#include <cstddef>
#include <cstdint>
#include <functional>
#include <optional>

namespace vdb_nns::cli {

// Up to 9 numbers. What is not determined is anything finite: a mean of weights that may all be 0, say.
struct ExpectedValue {
    std::array<Real, 9> value{}, bound{};
    bool isDetermined = true;
};

ExpectedValue expectedDensity(const Neighborhood& near, const MeasureOptions& options);
ExpectedValue expectedMeanDistance(const Neighborhood& near);
ExpectedValue expectedNearestDistance(const Neighborhood& near);

// @param value of the attribute, `width` finite numbers, of a candidate; none where they are not finite
using CandidateValue = std::function<bool(std::uint32_t candidate, double* numbers)>;
ExpectedValue expectedAverage(const Neighborhood& near, const MeasureOptions& options, std::size_t width,
                              const CandidateValue& value);

ExpectedValue expectedNormal(const Neighborhood& near, const MeasureOptions& options);
ExpectedValue expectedEigenvalues(const Neighborhood& near, const MeasureOptions& options);

struct ExpectedPca {
    bool isEllipsoid = false;
    ExpectedValue stretch, position;
    // Columns of `xform`, and how far each may be from the right direction; empty where no direction is determined.
    std::array<Vector3, 3> axes{};
    std::array<std::optional<Real>, 3> axisBound{};
};
ExpectedPca expectedPca(const Neighborhood& near, const PcaOptions& options);

} // namespace vdb_nns::cli
