#include "grid/set_radii.h"

#include "grid/lattice.h"

#include <tbb/blocked_range.h>
#include <tbb/parallel_for.h>
#include <tbb/parallel_reduce.h>

#include <algorithm>

namespace vdb_nns {

namespace {

constexpr std::size_t kGrain = 16384;
constexpr std::size_t kMostClasses = 40;
// Below, halvings of the largest radius may be rounded: the rest is one class.
constexpr double kSmallestBound = 1e-280;
// The smallest class has at least so many particles, or such a share of all.
constexpr double kSmallestClass = 32, kSmallestShare = 1.0 / 1024;

} // namespace

int halvingsOf(double radius, double largest)
{
    int exponent, largestExponent;
    const double fraction = std::frexp(radius, &exponent),
                 largestFraction = std::frexp(largest, &largestExponent);
    return largestExponent - exponent - (fraction > largestFraction ? 1 : 0);
}

double largestRadius(Span<const double> radii, Span<const std::uint8_t> chosen)
{
    return tbb::parallel_reduce(
        tbb::blocked_range<std::size_t>(0, radii.size(), kGrain), 0.0,
        [&](const auto& range, double largest) {
            for (std::size_t i = range.begin(); i < range.end(); ++i) {
                if (reaches(radii[i]) && (chosen.empty() || chosen[i])) largest = std::max(largest, radii[i]);
            }
            return largest;
        },
        [](double a, double b) { return std::max(a, b); });
}

void RadiusCensus::add(Span<const double> radii, Span<const std::uint8_t> chosen)
{
    const Counts counts = tbb::parallel_reduce(
        tbb::blocked_range<std::size_t>(0, radii.size(), kGrain), Counts{},
        [&](const auto& range, Counts sum) {
            for (std::size_t i = range.begin(); i < range.end(); ++i) {
                if (reaches(radii[i]) && (chosen.empty() || chosen[i]))
                    ++sum[static_cast<std::size_t>(halvingsOf(radii[i], mLargest))];
            }
            return sum;
        },
        [](Counts a, const Counts& b) {
            for (std::size_t k = 0; k < a.size(); ++k) a[k] += b[k];
            return a;
        });
    for (std::size_t k = 0; k < counts.size(); ++k) mCounts[k] += counts[k];
}

std::vector<RadiusClass> RadiusCensus::classes() const
{
    std::uint64_t left = 0;
    for (const std::uint64_t count : mCounts) left += count;
    const double least = std::max(kSmallestClass, kSmallestShare * static_cast<double>(left));
    std::vector<RadiusClass> classes;
    for (std::size_t k = 0; left > 0; ++k) {
        if (mCounts[k] == 0) continue;
        left -= mCounts[k];
        const RadiusClass c{static_cast<int>(k), static_cast<int>(k)};
        classes.push_back(c);
        if (static_cast<double>(left) < least || classes.size() == kMostClasses ||
            c.upTo(mLargest) < kSmallestBound)
            break;
    }
    if (!classes.empty()) classes.back().last = RadiusClass::kAllSmaller;
    return classes;
}

ClassMembers membersOf(const RadiusClass& c, double largest, Span<const double> radii,
                       Span<const std::uint8_t> chosen, bool alsoUnreaching)
{
    struct Sum {
        double largest = 0;
        std::size_t count = 0;
    };
    const double upTo = c.upTo(largest),
                 above = c.last == RadiusClass::kAllSmaller ? 0 : std::ldexp(largest, -(c.last + 1));
    ClassMembers members;
    members.chosen.resize(radii.size());
    const Sum sum = tbb::parallel_reduce(
        tbb::blocked_range<std::size_t>(0, radii.size(), kGrain), Sum(),
        [&](const auto& range, Sum s) {
            for (std::size_t i = range.begin(); i < range.end(); ++i) {
                if (!chosen.empty() && !chosen[i]) continue;
                if (!reaches(radii[i])) {
                    members.chosen[i] = alsoUnreaching;
                    s.count += alsoUnreaching;
                    continue;
                }
                if (!(radii[i] > above && radii[i] <= upTo)) continue;
                members.chosen[i] = 1;
                ++s.count;
                s.largest = std::max(s.largest, radii[i]);
            }
            return s;
        },
        [](const Sum& a, const Sum& b) {
            return Sum{std::max(a.largest, b.largest), a.count + b.count};
        });
    members.largest = sum.largest;
    members.count = sum.count;
    return members;
}

RadiusBounds::RadiusBounds(const Lattice& lattice, double radius, double coordinateError, int sums)
{
    const double radiusCells = radiusInCells(lattice, radius);
    error = filterError(radiusCells, lattice.reach, coordinateError, sums);
    bounds = makeFilterBounds(radiusCells, lattice.reach, coordinateError, sums);
    // Twice the error, and what rounding adds to the difference of two scores of at most the square of the radius.
    nearestDoubt = static_cast<float>(2.1 * error.beta + 0x1p-22 * (radiusCells * radiusCells + 1));
}

std::shared_ptr<const PageArray<float>> farOfSlots(const SparseGridData& grid, Span<const double> radii,
                                                   const FilterError& error)
{
    const auto result = std::make_shared<PageArray<float>>();
    PageArray<float>& far = *result;
    far.resizeDiscarding(grid.particleCount());
    tbb::parallel_for(tbb::blocked_range<std::size_t>(0, grid.particleCount(), kGrain),
                      [&](const auto& range) {
                          for (std::size_t slot = range.begin(); slot < range.end(); ++slot) {
                              const double r = radii[grid.number[slot]];
                              far[slot] = farOf(reaches(r) ? radiusInCells(grid.lattice, r) : -1, error);
                          }
                      });
    return result;
}

} // namespace vdb_nns
