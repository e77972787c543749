#include "set_oracle.h"

#include <boost/multiprecision/cpp_int.hpp>

#include <algorithm>
#include <cmath>
#include <limits>
#include <map>

namespace vdb_nns::testing {

namespace {

using Rational = boost::multiprecision::cpp_rational;

Rational coordinate(const OracleSet& set, const ExactPoint& p, std::size_t k)
{
    Rational sum(set.translation[k]);
    for (std::size_t c = 0; c < 3; ++c)
        sum += Rational(set.linear[k][c]) * (Rational(p.voxel[c]) + Rational(p.offset[c]));
    return sum;
}

Rational exactSquare(const SetProblem& problem, std::size_t q, std::size_t c)
{
    Rational sum = 0;
    for (std::size_t k = 0; k < 3; ++k) {
        const Rational d = coordinate(problem.candidates, problem.candidates.points[c], k) -
                           coordinate(problem.queries, problem.queries.points[q], k);
        sum += d * d;
    }
    return sum;
}

// Rounded, and a bound on the error that leaves nothing to argue about.
struct Square {
    long double value, error;
};

Square roundedSquare(const SetProblem& problem, std::size_t q, std::size_t c)
{
    long double sum = 0, error = 0;
    for (std::size_t k = 0; k < 3; ++k) {
        long double d = 0, size = 0;
        for (const int side : {0, 1}) {
            const OracleSet& set = side ? problem.candidates : problem.queries;
            const ExactPoint& p = set.points[side ? c : q];
            long double x = set.translation[k];
            size += std::fabs(x);
            for (std::size_t i = 0; i < 3; ++i) {
                const long double term = static_cast<long double>(set.linear[k][i]) *
                                         (static_cast<long double>(p.voxel[i]) + p.offset[i]);
                x += term;
                size += std::fabs(static_cast<long double>(set.linear[k][i])) *
                        (std::fabs(static_cast<long double>(p.voxel[i])) +
                         std::fabs(static_cast<long double>(p.offset[i])));
            }
            d += side ? x : -x;
        }
        const long double e = 1e-17L * size;
        sum += d * d;
        error += 2 * std::fabs(d) * e + e * e;
    }
    return {sum, error + 1e-17L * sum};
}

double radiusOf(const SetProblem& problem, std::size_t q, std::size_t c)
{
    const auto of = [&](const std::vector<double>& radii, std::size_t i) {
        const double r = radii[i];
        return r > 0 && std::isfinite(r) ? r : -std::numeric_limits<double>::infinity();
    };
    const std::vector<double>&mine = problem.queries.radii, &theirs = problem.candidates.radii;
    if (mine.empty() && theirs.empty()) return problem.radius;
    if (problem.mode == OracleMode::kGather) return of(mine, q);
    if (problem.mode == OracleMode::kScatter) return of(theirs, c);
    return std::max(of(mine, q), of(theirs, c));
}

bool isWithin(const SetProblem& problem, std::size_t q, std::size_t c)
{
    const double radius = radiusOf(problem, q, c);
    if (!(radius > 0)) return false;
    const Square square = roundedSquare(problem, q, c);
    const long double r2 = static_cast<long double>(radius) * radius, doubt = square.error + 1e-17L * r2;
    // A square that long doubles cannot hold is left to the exact comparison.
    if (r2 > std::numeric_limits<double>::min() && std::isfinite(square.value)) {
        if (square.value + doubt < r2) return true;
        if (square.value - doubt > r2) return false;
    }
    return exactSquare(problem, q, c) <= Rational(radius) * Rational(radius);
}

} // namespace

SetAnswer setOracle(const SetProblem& problem)
{
    const std::size_t rows = problem.queries.points.size(), columns = problem.candidates.points.size();
    SetAnswer answer;
    answer.byNumber.resize(rows);
    answer.byDistance.resize(rows);
    answer.min = std::numeric_limits<std::uint32_t>::max();
    for (std::size_t q = 0; q < rows; ++q) {
        if (!problem.queries.has(q)) continue;
        std::vector<std::uint32_t> row;
        for (std::size_t c = 0; c < columns; ++c) {
            if (!problem.candidates.has(c) || (problem.areSame && c == q)) continue;
            if (isWithin(problem, q, c)) row.push_back(static_cast<std::uint32_t>(c));
        }
        std::map<std::uint32_t, Rational> exact; // of this query, as far as they are needed
        const auto exactOf = [&](std::uint32_t c) -> const Rational& {
            const auto found = exact.find(c);
            return found != exact.end() ? found->second : exact[c] = exactSquare(problem, q, c);
        };
        std::sort(row.begin(), row.end(), [&](std::uint32_t a, std::uint32_t b) {
            const ExactPoint &toA = problem.candidates.points[a], &toB = problem.candidates.points[b];
            if (toA.voxel == toB.voxel && toA.offset == toB.offset) return a < b;
            const Square x = roundedSquare(problem, q, a), y = roundedSquare(problem, q, b);
            const long double doubt = x.error + y.error;
            if (x.value + doubt < y.value) return true;
            if (y.value + doubt < x.value) return false;
            const Rational &exactX = exactOf(a), &exactY = exactOf(b);
            return exactX != exactY ? exactX < exactY : a < b;
        });
        if (problem.nearest > 0 && row.size() > problem.nearest) {
            row.resize(problem.nearest);
            ++answer.shortened;
        }
        ++answer.finiteQueries;
        answer.isolated += row.empty();
        answer.neighbors += row.size();
        answer.min = std::min(answer.min, static_cast<std::uint32_t>(row.size()));
        answer.max = std::max(answer.max, static_cast<std::uint32_t>(row.size()));
        if (problem.includeSelf && problem.candidates.has(q)) {
            // As near as nothing but its coincident ones.
            auto at = row.begin();
            while (at != row.end() && *at < q && exactSquare(problem, q, *at) == 0) ++at;
            row.insert(at, static_cast<std::uint32_t>(q));
        }
        answer.byDistance[q] = row;
        std::sort(row.begin(), row.end());
        answer.byNumber[q] = std::move(row);
    }
    if (answer.finiteQueries == 0) answer.min = 0;
    return answer;
}

} // namespace vdb_nns::testing
