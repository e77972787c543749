#include "expected_values.h"

#include <algorithm>
#include <cmath>

namespace vdb_nns::cli {

namespace {

// Sum of weights times coefficients, and its bound (see the header).
class WeightedSum {
public:
    // @param size the largest of the coefficients that are summed at one scale: of a vector's components
    void add(const Weight& weight, Real coefficient, Real coefficientError, Real size)
    {
        mSum += weight.value * coefficient;
        mPropagated += weight.error * std::fabs(coefficient) + weight.most * coefficientError;
        mLargest = std::max(mLargest, weight.most * (size + coefficientError));
        ++mCount;
    }
    void add(const Weight& weight, Real coefficient, Real coefficientError = 0)
    {
        add(weight, coefficient, coefficientError, std::fabs(coefficient));
    }

    Real value() const { return mSum; }
    Real bound() const { return mPropagated + mCount * (0x1p-46L + mCount * 0x1p-60L) * mLargest; }

private:
    Real mSum = 0, mPropagated = 0, mLargest = 0, mCount = 0;
};

Weight weightOf(const Near& near, const MeasureOptions& options)
{
    return smoothingWeight(options.kernel, near.distance, near.radius, near.error);
}

// The quotient of two sums; nothing where the divisor may be 0.
struct Quotient {
    Real value, bound;
};
std::optional<Quotient> quotient(const WeightedSum& sum, const WeightedSum& divisor)
{
    const Real least = divisor.value() - divisor.bound();
    if (!(least > divisor.bound())) return std::nullopt;
    const Real value = sum.value() / divisor.value();
    return Quotient{value, (sum.bound() + std::fabs(value) * divisor.bound()) / least};
}

// Weighted mean and covariance of the points about the query.
struct Moments {
    Vector3 mean{}, meanBound{};
    SymmetricMatrix covariance{};
    Real bound = 0; // of an eigenvalue
    bool isThere = false;
};

Moments momentsOf(const std::vector<Near>& points, const std::vector<Weight>& weights)
{
    Moments moments;
    WeightedSum total;
    std::array<WeightedSum, 3> sums;
    WeightedSum squares; // of distances from the query: all of the covariance is less
    for (std::size_t p = 0; p < points.size(); ++p) {
        const Near& near = points[p];
        total.add(weights[p], 1);
        for (std::size_t k = 0; k < 3; ++k)
            sums[k].add(weights[p], near.offset[k], near.error, near.distance);
        squares.add(weights[p], near.distance * near.distance, 2 * near.distance * near.error);
    }
    for (std::size_t k = 0; k < 3; ++k) {
        const std::optional<Quotient> mean = quotient(sums[k], total);
        if (!mean) return moments;
        moments.mean[k] = mean->value;
        moments.meanBound[k] = mean->bound;
    }
    moments.isThere = true;
    for (std::size_t p = 0; p < points.size(); ++p) {
        Vector3 from{};
        for (std::size_t k = 0; k < 3; ++k) from[k] = points[p].offset[k] - moments.mean[k];
        for (std::size_t a = 0; a < 3; ++a) {
            for (std::size_t b = 0; b < 3; ++b)
                moments.covariance[a][b] += weights[p].value * from[a] * from[b] / total.value();
        }
    }
    moments.bound = 4 * quotient(squares, total)->bound;
    return moments;
}

std::vector<Weight> smoothingWeights(const std::vector<Near>& points, const MeasureOptions& options)
{
    std::vector<Weight> weights;
    for (const Near& near : points) weights.push_back(weightOf(near, options));
    return weights;
}

// The smaller two raised to `anisotropy` times the largest, divided by the cube root of the product.
void setStretch(const Vector3& eigenvalues, Real bound, Real anisotropy, ExpectedValue& stretch)
{
    const Real largest = eigenvalues[0];
    Real product = 1;
    for (std::size_t k = 0; k < 3; ++k) {
        stretch.value[k] = largest > 0 ? std::max(eigenvalues[k], anisotropy * largest) / largest : 1;
        product *= stretch.value[k];
    }
    if (!(largest > 0)) return;
    const Real relative = 4 * bound / (anisotropy * largest);
    stretch.isDetermined = relative < 1e-3L;
    for (std::size_t k = 0; k < 3; ++k) {
        stretch.value[k] /= std::cbrt(product);
        stretch.bound[k] = (relative + 0x1p-48L) * stretch.value[k];
    }
}

void setAxes(const EigenSystem& system, Real bound, ExpectedPca& pca)
{
    for (std::size_t k = 0; k < 3; ++k) {
        pca.axes[k] = system.vectors[k];
        Real gap = system.values[0];
        for (std::size_t other = 0; other < 3; ++other) {
            if (other != k) gap = std::min(gap, std::fabs(system.values[k] - system.values[other]));
        }
        const bool isApart = gap > 1e-4L * system.values[0] && bound < 1e-4L * gap;
        if (isApart) pca.axisBound[k] = 4 * bound / gap + 0x1p-40L;
    }
}

} // namespace

ExpectedValue expectedDensity(const Neighborhood& near, const MeasureOptions& options)
{
    WeightedSum sum;
    for (const Near& point : near.all)
        sum.add(weightOf(point, options),
                options.masses.empty() ? options.mass : options.masses[point.number]);
    ExpectedValue expected;
    expected.value[0] = sum.value();
    expected.bound[0] = sum.bound();
    return expected;
}

ExpectedValue expectedMeanDistance(const Neighborhood& near)
{
    ExpectedValue expected;
    expected.value[0] = -1;
    if (near.neighbors.empty()) return expected;
    WeightedSum sum;
    for (const Near& point : near.neighbors) sum.add({1, 1, 0}, point.distance, point.error);
    const auto count = static_cast<Real>(near.neighbors.size());
    expected.value[0] = sum.value() / count;
    expected.bound[0] = sum.bound() / count;
    return expected;
}

ExpectedValue expectedNearestDistance(const Neighborhood& near)
{
    ExpectedValue expected;
    expected.value[0] = -1;
    const Near* nearest = nullptr;
    for (const Near& point : near.neighbors) {
        expected.bound[0] = std::max(expected.bound[0], point.error);
        if (!nearest || point.distance < nearest->distance) nearest = &point;
    }
    if (nearest) expected.value[0] = nearest->distance;
    return expected;
}

ExpectedValue expectedAverage(const Neighborhood& near, const MeasureOptions& options, std::size_t width,
                              const CandidateValue& value)
{
    ExpectedValue expected;
    WeightedSum total;
    std::array<WeightedSum, 9> sums;
    std::array<double, 9> numbers{};
    bool hasTerms = false;
    for (const Near& point : near.all) {
        if (!value(point.number, numbers.data())) continue;
        const Weight weight = weightOf(point, options);
        hasTerms = true;
        total.add(weight, 1);
        Real size = 0;
        for (std::size_t k = 0; k < width; ++k) size = std::max<Real>(size, std::fabs(numbers[k]));
        for (std::size_t k = 0; k < width; ++k) sums[k].add(weight, numbers[k], 0, size);
    }
    if (!hasTerms) return expected;
    for (std::size_t k = 0; k < width; ++k) {
        const std::optional<Quotient> mean = quotient(sums[k], total);
        expected.isDetermined = mean.has_value();
        if (!mean) break;
        expected.value[k] = mean->value;
        expected.bound[k] = mean->bound;
    }
    return expected;
}

ExpectedValue expectedNormal(const Neighborhood& near, const MeasureOptions& options)
{
    ExpectedValue expected;
    if (near.neighbors.empty()) return expected;
    std::array<WeightedSum, 3> sums;
    Real length = 0, bound = 0, terms = 0;
    for (const Near& point : near.neighbors) {
        const Weight weight = weightOf(point, options);
        terms += weight.value * point.distance;
        for (std::size_t k = 0; k < 3; ++k)
            sums[k].add(weight, -point.offset[k], point.error, point.distance);
    }
    for (const WeightedSum& sum : sums) {
        length += sum.value() * sum.value();
        bound += sum.bound();
    }
    length = std::sqrt(length);
    expected.isDetermined = length > 1e-6L * terms && length > 100 * bound;
    if (!expected.isDetermined) return expected;
    for (std::size_t k = 0; k < 3; ++k) {
        expected.value[k] = sums[k].value() / length;
        expected.bound[k] = 2 * bound / length + 0x1p-48L;
    }
    return expected;
}

ExpectedValue expectedEigenvalues(const Neighborhood& near, const MeasureOptions& options)
{
    ExpectedValue expected;
    if (near.all.empty()) return expected;
    const Moments moments = momentsOf(near.all, smoothingWeights(near.all, options));
    expected.isDetermined = moments.isThere;
    if (!moments.isThere) return expected;
    const EigenSystem system = eigenSystem(moments.covariance);
    for (std::size_t k = 0; k < 3; ++k) {
        expected.value[k] = system.values[k];
        expected.bound[k] = moments.bound;
    }
    return expected;
}

ExpectedPca expectedPca(const Neighborhood& near, const PcaOptions& options)
{
    ExpectedPca pca;
    pca.isEllipsoid = options.threshold > 0 && near.all.size() >= options.threshold;
    for (std::size_t k = 0; k < 3; ++k) {
        pca.stretch.value[k] = options.stretch;
        pca.axes[k] = {};
        pca.axes[k][k] = 1;
        pca.position.value[k] = near.position[k];
        pca.position.bound[k] = near.positionError;
    }
    if (near.all.empty()) return pca;
    std::vector<Weight> weights;
    for (const Near& point : near.all)
        weights.push_back(pcaWeight(point.distance, point.radius, point.error));
    const Moments moments = momentsOf(near.all, weights);
    pca.position.isDetermined = moments.isThere;
    for (std::size_t k = 0; k < 3; ++k) {
        pca.position.value[k] += options.average * moments.mean[k];
        pca.position.bound[k] += 2 * options.average * moments.meanBound[k];
    }
    if (!pca.isEllipsoid) return pca;
    pca.stretch.isDetermined = moments.isThere;
    if (!moments.isThere) return pca;
    const EigenSystem system = eigenSystem(moments.covariance);
    setStretch(system.values, moments.bound, options.anisotropy, pca.stretch);
    setAxes(system, moments.bound, pca);
    return pca;
}

} // namespace vdb_nns::cli
