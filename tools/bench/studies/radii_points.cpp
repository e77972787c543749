#include "bench/studies/radii_points.h"

#include "numbers.h"

#include <algorithm>
#include <cmath>
#include <cstddef>

namespace vdb_nns::cli {
namespace {

constexpr double kDecades = 100;    // the largest radius over the smallest
constexpr double kRadiusFactor = 2; // radius over spacing
constexpr double kJitter = 0.2;     // of the spacing, as the scenes have it

// In [0, 1), by number alone.
double uniform(std::uint64_t seed, std::uint64_t index)
{
    return static_cast<double>(mix64(mix64(seed) + index) >> 11) * 0x1p-53;
}

// Shells of 6 n^2 particles at spacings of 2 / n of their distance: the number of shells is ln(100) n / 2, so
// that the spacing across shells is that within them.
struct Grading {
    std::uint64_t edge, shells; // particles along the edge of a face; shells
    double growth;              // of the spacing from shell to shell

    explicit Grading(std::uint64_t count)
    {
        const double wanted = static_cast<double>(count);
        edge = static_cast<std::uint64_t>(
            std::max(1.0, std::round(std::cbrt(wanted / (3 * std::log(kDecades))))));
        const double inShell = 6 * static_cast<double>(edge * edge);
        shells = static_cast<std::uint64_t>(std::max(2.0, std::round(wanted / inShell)));
        growth = std::pow(kDecades, 1 / static_cast<double>(shells - 1));
    }
    std::uint64_t inShell() const { return 6 * edge * edge; }
};

} // namespace

RadiiPoints gradedPoints(std::uint64_t count, double radius, std::uint64_t seed)
{
    const Grading grading(count);
    RadiiPoints points;
    points.name = "graded 1:100";
    points.xyz.reserve(3 * grading.shells * grading.inShell());
    points.radii.reserve(grading.shells * grading.inShell());
    double spacing = radius / std::sqrt(kDecades) / kRadiusFactor;
    for (std::uint64_t shell = 0; shell < grading.shells; ++shell, spacing *= grading.growth) {
        const double half = 0.5 * static_cast<double>(grading.edge) * spacing;
        for (std::uint64_t k = 0; k < grading.inShell(); ++k) {
            const std::uint64_t face = k / (grading.edge * grading.edge),
                                at = k % (grading.edge * grading.edge);
            const std::uint64_t number = points.radii.size();
            const double along[3] = {face % 2 == 0 ? -half : half,
                                     (static_cast<double>(at / grading.edge) + 0.5) * spacing - half,
                                     (static_cast<double>(at % grading.edge) + 0.5) * spacing - half};
            for (std::size_t axis = 0; axis < 3; ++axis) {
                const double jitter = kJitter * (2 * uniform(seed, 3 * number + axis) - 1) * spacing;
                points.xyz.push_back(static_cast<float>(along[(axis + 3 - face / 2) % 3] + jitter));
            }
            points.radii.push_back(kRadiusFactor * spacing);
        }
    }
    points.view = ParticleView::fromArray(points.xyz.data(), points.radii.size());
    return points;
}

RadiiPoints mixedPoints(const BenchPoints& points, double radius, std::uint64_t seed)
{
    RadiiPoints mixed;
    mixed.name = "mixed 1:4";
    mixed.view = points.view;
    mixed.radii.resize(points.view.size());
    for (std::size_t i = 0; i < mixed.radii.size(); ++i)
        mixed.radii[i] = uniform(seed, i) < 0.01 ? 4 * radius : radius;
    return mixed;
}

} // namespace vdb_nns::cli
