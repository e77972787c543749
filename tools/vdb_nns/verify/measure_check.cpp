#include "measure_check.h"

#include "cluster_labels.h"
#include "distance_order.h"
#include "expected_values.h"
#include "measure_claims.h"
#include "row_pass.h"
#include "vdb_nns/error.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <optional>
#include <utility>

namespace vdb_nns::cli {

namespace {

bool isOfFloats(AttributeType type)
{
    return type == AttributeType::kFloat || type == AttributeType::kVec3s || type == AttributeType::kMat3s;
}

// As a number of the type would be stored; beyond its range infinite.
double stored(Real value, AttributeType type)
{
    const bool isFloat = isOfFloats(type);
    const Real largest = isFloat ? std::numeric_limits<float>::max() : std::numeric_limits<double>::max();
    if (std::fabs(value) > largest) return std::copysign(HUGE_VAL, static_cast<double>(value > 0 ? 1 : -1));
    return isFloat ? static_cast<double>(static_cast<float>(value)) : static_cast<double>(value);
}

// ---- comparison -----------------------------------------------------------------------------------------------------

// Keeps the first `most` examples by query.
void keepExample(std::vector<ValueExample>& examples, ValueExample example, std::size_t most)
{
    const auto before = [](const ValueExample& a, const ValueExample& b) { return a.query < b.query; };
    const auto place = std::upper_bound(examples.begin(), examples.end(), example, before);
    if (examples.size() >= most && place == examples.end()) return;
    examples.insert(place, std::move(example));
    if (examples.size() > most) examples.pop_back();
}

class Comparison {
public:
    explicit Comparison(std::size_t maxExamples) : mMaxExamples(maxExamples) {}

    void fail(ValueFinding& finding, ValueExample example) const
    {
        ++finding.count;
        keepExample(finding.examples, std::move(example), mMaxExamples);
    }

    void compareInteger(ValueFinding& finding, std::uint64_t query, const PointAttribute& attribute,
                        std::int64_t expected) const
    {
        ++finding.checked;
        const double value = numberAt(attribute, query, 0), right = static_cast<double>(expected);
        if (value != right) fail(finding, {query, 0, value, right, 0, {}});
    }

    void compareMember(ValueFinding& finding, std::uint64_t query, const PointGroup& group,
                       bool expected) const
    {
        ++finding.checked;
        const bool isMember = group.members.get()[query] != 0;
        if (isMember != expected)
            fail(finding, {query, 0, isMember ? 1.0 : 0.0, expected ? 1.0 : 0.0, 0, {}});
    }

    // Those that are not determined have to be finite.
    void compareNumbers(ValueFinding& finding, std::uint64_t query, const PointAttribute& attribute,
                        const ExpectedValue& expected) const
    {
        ++finding.checked;
        finding.undetermined += !expected.isDetermined;
        for (std::size_t k = 0; k < attributeWidth(attribute.type); ++k) {
            const double value = numberAt(attribute, query, k);
            if (!expected.isDetermined) {
                if (std::isfinite(value)) continue;
                return fail(finding, {query, k, value, std::nan(""), 0, "is not finite"});
            }
            const Real right = expected.value[k], bound = expected.bound[k];
            if (value >= stored(right - bound, attribute.type) &&
                value <= stored(right + bound, attribute.type))
                continue;
            return fail(finding,
                        {query, k, value, static_cast<double>(right), static_cast<double>(bound), {}});
        }
    }

private:
    std::size_t mMaxExamples;
};

// Of `xform`: what is wrong with the nine numbers as a rotation, or nothing.
std::optional<ValueExample> rotationFault(const std::array<double, 9>& m, std::uint64_t query)
{
    constexpr double kMost = 1e-5;
    for (std::size_t a = 0; a < 3; ++a) {
        for (std::size_t b = a; b < 3; ++b) {
            double product = 0;
            for (std::size_t row = 0; row < 3; ++row) product += m[3 * row + a] * m[3 * row + b];
            const double right = a == b ? 1 : 0;
            if (!(std::fabs(product - right) <= kMost))
                return ValueExample{query, 3 * a + b, product, right, kMost, "is a product of two columns"};
        }
    }
    const double determinant = m[0] * (m[4] * m[8] - m[5] * m[7]) - m[1] * (m[3] * m[8] - m[5] * m[6]) +
                               m[2] * (m[3] * m[7] - m[4] * m[6]);
    if (std::fabs(determinant - 1) <= kMost) return std::nullopt;
    return ValueExample{query, 0, determinant, 1, kMost, "is the determinant"};
}

// Whether one component is larger than the others by far, and negative.
bool hasWrongSign(const std::array<double, 9>& m, std::size_t column)
{
    std::array<double, 3> v{m[column], m[3 + column], m[6 + column]};
    std::sort(v.begin(), v.end(), [](double a, double b) { return std::fabs(a) < std::fabs(b); });
    return v[2] < 0 && std::fabs(v[2]) > std::fabs(v[1]) + 1e-4;
}

// What one task found. A query that is not in the file is not looked at.
class MeasureChecker {
public:
    struct Shared {
        const SearchJudge& judge;
        const MeasureClaims& claims;
        const std::vector<Claim>& list;
        Comparison comparison;
    };

    MeasureChecker(const Shared& shared, std::vector<ValueFinding> findings)
        : mShared(&shared), mOrder(shared.judge)
    {
        mReport.findings = std::move(findings);
    }

    void check(std::uint32_t query, const std::vector<std::uint32_t>& within)
    {
        const std::vector<std::uint8_t>& isThere = mShared->claims.isThere;
        if (!isThere.empty() && !isThere[query]) return;
        mRow = within;
        const std::uint64_t nearest = mShared->judge.terms().nearest;
        if (nearest > 0) mOrder.keepNearest(query, nearest, mRow);
        ++mReport.queries;
        mReport.expectedPairs += mRow.size();
        const Neighborhood near = neighborhoodOf(mShared->judge, query, mRow);
        for (const Claim& claim : mShared->list) checkClaim(claim, near);
    }

    void merge(const MeasureChecker& other)
    {
        mReport.queries += other.mReport.queries;
        mReport.expectedPairs += other.mReport.expectedPairs;
        mReport.exactPairs += other.mReport.exactPairs;
        for (std::size_t k = 0; k < mReport.findings.size(); ++k) {
            ValueFinding& own = mReport.findings[k];
            const ValueFinding& more = other.mReport.findings[k];
            own.checked += more.checked;
            own.undetermined += more.undetermined;
            own.count += more.count;
            for (const ValueExample& example : more.examples) keep(own, example);
        }
    }

    void countExactPairs(std::uint64_t pairs) { mReport.exactPairs += pairs; }

    const MeasureReport& report() const { return mReport; }

private:
    void keep(ValueFinding& finding, const ValueExample& example) const
    {
        mShared->comparison.fail(finding, example);
        --finding.count; // it is counted already
    }

    void checkClaim(const Claim& claim, const Neighborhood& near)
    {
        const SearchJudge& judge = mShared->judge;
        const MeasureOptions& options = mShared->claims.options;
        const Comparison& comparison = mShared->comparison;
        ValueFinding& finding = mReport.findings[claim.finding];
        const auto compare = [&](const ExpectedValue& expected) {
            comparison.compareNumbers(finding, near.query, claim.attribute, expected);
        };
        switch (claim.measure) {
        case Measure::kCount:
            return comparison.compareInteger(finding, near.query, claim.attribute,
                                             static_cast<std::int64_t>(near.neighbors.size()));
        case Measure::kDensity:
            return compare(expectedDensity(near, options));
        case Measure::kMeanDistance:
            return compare(expectedMeanDistance(near));
        case Measure::kNearestDistance:
            return compare(expectedNearestDistance(near));
        case Measure::kNearest:
            return comparison.compareInteger(finding, near.query, claim.attribute, nearestOf(near));
        case Measure::kAverage:
            return compare(average(claim.source, near));
        case Measure::kNormal:
            return checkNormal(claim, near, finding);
        case Measure::kEigenvalues:
            return compare(expectedEigenvalues(near, options));
        case Measure::kPca:
            return checkPca(claim, near);
        case Measure::kIsolated:
            return comparison.compareMember(finding, near.query, claim.group,
                                            near.isQuery && near.neighbors.empty());
        case Measure::kNonfinite:
            return comparison.compareMember(finding, near.query, claim.group,
                                            !judge.isFiniteQuery(near.query));
        case Measure::kCluster:
        case Measure::kClusterSize:
            return; // of all points at once
        }
    }

    std::int64_t nearestOf(const Neighborhood& near)
    {
        std::vector<std::uint32_t> row = mRow;
        if (row.empty()) return -1;
        mOrder.keepNearest(near.query, 1, row);
        return row[0];
    }

    ExpectedValue average(const PointAttribute& source, const Neighborhood& near) const
    {
        const std::size_t width = attributeWidth(source.type);
        return expectedAverage(near, mShared->claims.options, width,
                               [&](std::uint32_t candidate, double* numbers) {
                                   bool isFinite = true;
                                   for (std::size_t k = 0; k < width; ++k) {
                                       numbers[k] = numberAt(source, candidate, k);
                                       isFinite &= std::isfinite(numbers[k]);
                                   }
                                   return isFinite;
                               });
    }

    // One without a direction is 0, or of unit length.
    void checkNormal(const Claim& claim, const Neighborhood& near, ValueFinding& finding) const
    {
        const ExpectedValue expected = expectedNormal(near, mShared->claims.options);
        const std::uint64_t before = finding.count;
        mShared->comparison.compareNumbers(finding, near.query, claim.attribute, expected);
        if (expected.isDetermined || finding.count != before) return;
        double length = 0;
        for (std::size_t k = 0; k < 3; ++k)
            length = std::hypot(length, numberAt(claim.attribute, near.query, k));
        if (length == 0 || std::fabs(length - 1) <= 1e-6) return;
        mShared->comparison.fail(finding, {near.query, 0, length, 1, 1e-6, "is the length"});
    }

    void checkPca(const Claim& claim, const Neighborhood& near)
    {
        const Comparison& comparison = mShared->comparison;
        ValueFinding* const findings = &mReport.findings[claim.finding];
        const ExpectedPca pca = expectedPca(near, mShared->claims.options.pca);
        comparison.compareNumbers(findings[0], near.query, claim.attribute, pca.stretch);
        checkXform(claim, near, pca, findings[1]);
        if (mShared->judge.isFiniteQuery(near.query))
            comparison.compareNumbers(findings[2], near.query, claim.position, pca.position);
        comparison.compareMember(findings[3], near.query, claim.group, pca.isEllipsoid);
    }

    void checkXform(const Claim& claim, const Neighborhood& near, const ExpectedPca& pca,
                    ValueFinding& finding) const
    {
        const Comparison& comparison = mShared->comparison;
        std::array<double, 9> m{};
        for (std::size_t k = 0; k < 9; ++k) m[k] = numberAt(claim.xform, near.query, k);
        ++finding.checked;
        if (!pca.isEllipsoid) {
            for (std::size_t k = 0; k < 9; ++k) {
                const double right = k % 4 == 0 ? 1 : 0;
                if (m[k] != right) return comparison.fail(finding, {near.query, k, m[k], right, 0, {}});
            }
            return;
        }
        if (const auto fault = rotationFault(m, near.query)) return comparison.fail(finding, *fault);
        bool isWhole = true;
        for (std::size_t column = 0; column < 3; ++column) {
            if (column < 2 && hasWrongSign(m, column)) {
                return comparison.fail(finding, {near.query, column, m[column], 0, 0,
                                                 "is in a column whose largest component is negative"});
            }
            isWhole &= pca.axisBound[column].has_value();
            if (!pca.axisBound[column]) continue;
            const Vector3& axis = pca.axes[column];
            Real along = 0;
            for (std::size_t row = 0; row < 3; ++row) along += axis[row] * m[3 * row + column];
            const Real sign = along < 0 ? -1 : 1, bound = *pca.axisBound[column] + 0x1p-24L;
            for (std::size_t row = 0; row < 3; ++row) {
                const Real right = sign * axis[row];
                const std::size_t k = 3 * row + column;
                if (std::fabs(m[k] - right) <= bound) continue;
                return comparison.fail(
                    finding,
                    {near.query, k, m[k], static_cast<double>(right), static_cast<double>(bound), {}});
            }
        }
        finding.undetermined += !isWhole;
    }

    const Shared* mShared;
    DistanceOrder mOrder;
    MeasureReport mReport;
    std::vector<std::uint32_t> mRow;
};

bool isOfClusters(const Claim& claim)
{
    return claim.measure == Measure::kCluster || claim.measure == Measure::kClusterSize;
}

// Those that the passes over rows leave out.
void checkClusters(const MeasureChecker::Shared& shared, const ClusterLabels& clusters, MeasureReport& report)
{
    for (const Claim& claim : shared.list) {
        if (!isOfClusters(claim)) continue;
        const auto& expected = claim.measure == Measure::kCluster ? clusters.labels : clusters.sizes;
        for (std::size_t i = 0; i < expected.size(); ++i) {
            if (!shared.claims.isThere.empty() && !shared.claims.isThere[i]) continue;
            shared.comparison.compareInteger(report.findings[claim.finding], i, claim.attribute, expected[i]);
        }
    }
}

void checkClaims(const SearchTerms& terms, const MeasureClaims& claims)
{
    const auto check = [&](std::uint64_t count, std::uint64_t points, const std::string& what) {
        if (count == points) return;
        throw InvalidInput("verify: " + std::to_string(count) + " " + what + " for " +
                           std::to_string(points) + " points");
    };
    const std::uint64_t queries = terms.queries.view.size(), candidates = terms.candidates.view.size();
    if (!claims.isThere.empty()) check(claims.isThere.size(), queries, "marks");
    if (!claims.options.masses.empty()) check(claims.options.masses.size(), candidates, "masses");
    for (const PointAttribute& attribute : claims.options.attributes)
        check(attribute.count, candidates, "values of '" + attribute.name + "'");
}

} // namespace

std::uint64_t MeasureReport::faultCount() const
{
    std::uint64_t count = 0;
    for (const ValueFinding& finding : findings) count += finding.count;
    return count;
}

MeasureReport verifyMeasures(const SearchTerms& terms, const MeasureClaims& claims,
                             const VerifyOptions& options, Progress* progress)
{
    checkRadius(terms);
    checkClaims(terms, claims);
    const SearchJudge judge(terms);
    std::vector<ValueFinding> findings;
    const std::vector<Claim> list = readClaims(claims, judge.queryCount(), judge.candidateCount(), findings);
    const bool hasClusters = std::any_of(list.begin(), list.end(), isOfClusters);
    if (hasClusters && (!terms.isOneSet() || !terms.queries.chosen.empty() ||
                        !terms.candidates.chosen.empty() || terms.nearest > 0))
        throw InvalidInput("verify: clusters are those of one set of points and of all pairs");
    const MeasureChecker::Shared shared{judge, claims, list, Comparison(options.maxExamples)};
    const double end = hasClusters ? 0.5 : 1;
    MeasureReport report = RowPass<MeasureChecker>(judge, MeasureChecker(shared, findings))
                               .run({options.sample, options.seed}, {progress, 0, end})
                               .report();
    if (hasClusters)
        checkClusters(shared, findClusters(judge, claims.options.minNeighbors, progress, end, 1), report);
    return report;
}

} // namespace vdb_nns::cli
